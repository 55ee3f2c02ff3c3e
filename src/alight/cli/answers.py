"""The answer of a run on stdout, its warnings on stderr, its folder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from alight.cli.app import complain, say, tell_answer
from alight.records import RunResult


def _place(result: RunResult, position: Sequence[float]) -> str:
    """Position in degrees, or in metres from the origin where the place on Earth is unknown."""
    if not result.georeferenced:
        return f"east {position[0]:.2f} m north {position[1]:.2f} m"
    latitude, longitude, _ = result.local.to_geodetic(position)
    return f"{float(latitude):.7f} {float(longitude):.7f}"


def tell_result(result: RunResult) -> None:
    """Print the answer on stdout, the warnings on stderr."""
    from alight.report import warnings

    for w in warnings(result):
        complain(f"warning: {w}", "yellow")
    tell_answer(result.sites, partial(_place, result))
    if "prior_dem" in result.notes:
        say(f"PRIOR DEM  {result.notes['prior_dem']}")


def leave_result(result: RunResult, out: Path, force: bool) -> None:
    """Print the answer first, in case the folder cannot be written; then write it and print its report's path."""
    from alight.outputs import write_run

    tell_result(result)
    write_run(result, out, force)
    say(f"report: {out / 'report.html'}")
