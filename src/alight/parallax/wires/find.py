"""Wires over the mapped ground, from the views of a map (docs/method/wires.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alight.arrays import F32, Mask
from alight.geometry import Grid
from alight.parallax.views import ground_sampling
from alight.parallax.wires.residuals import plane_views
from alight.parallax.wires.segments import LineSums, Pieces
from alight.parallax.wires.strands import STEEPEST, Strand, strands
from alight.raster import nearest_known
from alight.records import ElevationMap, Flag, View
from alight.records.wires import Wire

MOST_VIEWS = 16
SHOWN_BY = 3  # every so many views give lines that the others confirm
PIXELS = 2.6  # of the views across a cell, at least: thinner than that, wires are as clear and cost more
LOWEST = 2.5  # metres above the ground, of what is looked for
HIGH = 3.0  # metres above the ground, of what is called a wire: lower lines are fences and rims of hedges
PIECES = 2.0  # of a strand's evidence, for the logarithm of the number of its pieces
EVENS = 16.0  # evidence of which half are wires: on drawn flights
LEAST_CHANCE = 0.25  # that a strand is a wire, below which it is left out


def chosen_views(views: Sequence[View], most: int) -> list[View]:
    """Return up to `most` views of one camera, evenly over the times of all."""
    first = min((v.cam for v in views), default=0)
    times = sorted({v.t_ns for v in views if v.cam == first})
    at = {times[k] for k in np.unique(np.rint(np.linspace(0, len(times) - 1, min(most, len(times)))).astype(int))}
    return [v for v in views if v.cam == first and v.t_ns in at]


def ground_of(elevation: ElevationMap, views: Sequence[View]) -> tuple[Grid, F32, Mask, float]:
    """Return the grid on which wires are looked for, ground height on it (metres up), seen cells, and median height."""
    known = np.isfinite(elevation.height)
    plane = float(np.median(elevation.height[known]))
    pixel = float(np.median([ground_sampling(v, plane) for v in views]))
    e, cell = elevation.grid, max(elevation.grid.cell, PIXELS * pixel)
    shift, shape = 0.5 * (cell - e.cell), (int(n * e.cell / cell) for n in e.shape)
    grid = Grid(e.east + shift, e.north - shift, cell, *shape)
    height = nearest_known(elevation.height, known)
    seen = (elevation.flags & np.uint16(Flag.UNSEEN)) == 0
    return grid, e.nearest_on(grid, height, plane), e.nearest_on(grid, seen), plane


def all_segments(sums: LineSums) -> Pieces | None:
    """Return the pieces that any view shows and others confirm; None: there are none."""
    parts = [sums.segments(k, LOWEST) for k in range(0, len(sums.views), SHOWN_BY)]
    return Pieces.joined(parts) if parts else None


def _chance(one: Strand, s: Pieces, sums: LineSums) -> float:
    """Return the probability that a strand is a wire."""
    if one.height < HIGH or abs(one.slope) > STEEPEST:
        return 0.0
    evidence = one.evidence(s, sums) + PIECES * math.log(one.members.sum())
    return 1 / (1 + math.exp(min(EVENS - evidence, 50.0)))


def find_wires(views: Sequence[View], elevation: ElevationMap) -> tuple[Wire, ...]:
    """Find wires that hang over the mapped ground.

    Args:
        views: views with the poses from which the map was made.
        elevation: the map.
    """
    views = chosen_views(views, MOST_VIEWS)
    if len(views) < 3 or not np.isfinite(elevation.height).any():
        return ()
    grid, height, seen, plane = ground_of(elevation, views)
    sums = LineSums(plane_views(views, grid, height, seen, plane))
    found = all_segments(sums)
    if found is None:
        return ()
    out = []
    for one in strands(found, sums.views):
        if (chance := _chance(one, found, sums)) >= LEAST_CHANCE:
            start, end = one.followed(found, sums).ends(0.0) + np.array([0.0, 0.0, plane])
            out.append(Wire(start, end, chance))
    return tuple(out)
