"""Size of a map in memory, checked before it is allocated."""

from __future__ import annotations

import math

from alight.records import SettingsError

BYTES_A_CELL = 22.0  # of a map: height, sigma, flags, views, colour, residual, sampling
BYTES_A_STEP = 150.0  # of a cell while a step of the recursive map works on it
MOST_BYTES = 25e9
WISHED_BYTES = 1e9


def refuse_too_large(low: tuple[float, float], high: tuple[float, float], cell: float, each: float) -> None:
    """Refuse a map that would need more than `MOST_BYTES`.

    Args:
        low, high: its corners, east and north, metres.
        cell: metres.
        each: bytes a cell.

    Raises:
        SettingsError: with the number, and the cell that would need `WISHED_BYTES`.
    """
    width, length = high[0] - low[0], high[1] - low[1]
    needed = each * (width / cell) * (length / cell)
    if needed <= MOST_BYTES:
        return
    better = float(f"{math.sqrt(each * width * length / WISHED_BYTES):.1g}")
    raise SettingsError(
        f"cells of {cell:g} m: a map of {width:,.0f} x {length:,.0f} m needs about {needed / 1e9:,.0f} GB; "
        f"parallax.cell={better:g} would need {each * (width / better) * (length / better) / 1e9:.1f} GB"
    )
