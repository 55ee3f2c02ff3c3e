"""Size of the map's cells (docs/method/elevation), and of the map in memory, checked before it is allocated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alight.arrays import F64
from alight.parallax.views import ground_sampling
from alight.records import SettingsError, View
from alight.settings import StageSettings

BYTES_A_CELL = 22.0  # of a map: height, sigma, flags, views, colour, residual, sampling
BYTES_A_STEP = 150.0  # of a cell while a step of the recursive map works on it
# of each `parallax.quality`: cells over those of 1.8 pixels, and their least size over the cell that the lander is
# judged on
QUALITY = {"fast": (2.0, 1.0), "normal": (1.0, 0.5), "fine": (1.0, 0.0)}


def cell_size(view: View, ground: float, settings: StageSettings, by_quality: bool) -> float:
    """Size of a cell that suits a view of the ground, metres: 1.8 pixels, unless the settings want larger ones.

    Args:
        view: with its pose.
        ground: metres, height of the ground below it.
        settings: a fixed `parallax.cell` wins.
        by_quality: for a map of a whole recording, which takes `parallax.quality` into account.
    """
    if settings.parallax.cell is not None:
        return settings.parallax.cell
    pixels, least = QUALITY[settings.parallax.quality if by_quality else "fine"]
    size = settings.mapping.cell_over_pixel * (pixels * ground_sampling(view, ground))
    return max(size, least * settings.lander.judging_cell)


def first_cell(views: Sequence[View], ground: float, settings: StageSettings, by_quality: bool) -> float:
    """Size of the cells of level 0, metres: a round number, or a fixed `parallax.cell`."""
    fixed = settings.parallax.cell
    return fixed or nice_cell(float(np.median([cell_size(v, ground, settings, by_quality) for v in views])))


def nice_cell(size: float) -> float:
    """The round cell size nearest to a size, metres."""
    decade = 10.0 ** np.floor(np.log10(size))
    sizes: F64 = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0]) * decade
    return float(np.round(sizes[np.argmin(np.abs(np.log(sizes / size)))], 6))


def level_for(size: float, first: float, now: int, slack: float) -> int:
    """Level whose cells suit a size (eq. 16a).

    Args:
        size: of a cell, metres.
        first: metres, of the cells of level 0; they double from level to level.
        now: the level in use, which stays while it suits.
        slack: octaves beyond half of one within which it suits.
    """
    exact = math.log2(size / first)
    return now if abs(exact - now) <= 0.5 + slack else round(exact)


def refuse_too_large(low: tuple[float, float], high: tuple[float, float], cell: float, each: float) -> None:
    """Refuse a map that would need more than 25 GB.

    Args:
        low, high: its corners, east and north, metres.
        cell: metres.
        each: bytes a cell.

    Raises:
        SettingsError: with the number, and the cell that would need 1 GB.
    """
    width, length = high[0] - low[0], high[1] - low[1]
    needed = each * (width / cell) * (length / cell)
    if needed <= 25e9:
        return
    better = float(f"{math.sqrt(each * width * length / 1e9):.1g}")
    raise SettingsError(
        f"cells of {cell:g} m: a map of {width:,.0f} x {length:,.0f} m needs about {needed / 1e9:,.0f} GB; "
        f"parallax.cell={better:g} would need {each * (width / better) * (length / better) / 1e9:.1f} GB"
    )
