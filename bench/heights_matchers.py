"""Matchers compared on simulated ground: the batch and the ring on the left pictures, StereoSGBM on the same frames.

StereoSGBM gets pairs of the same motion (the median of those that see a point, and the widest pair alone, along the
rays to the points and as a map of cells) and the middle pair of the rig, plain and on pictures four times as wide.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from heights_points import Answer, Mask, Points
from matchers import by_pair, map_of_pair

from alight.arrays import F64
from alight.parallax.views import ground_sampling
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.cell_size import nice_cell
from alight.pipeline.mapping.ground_map import GroundMap
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.records import ElevationMap, View
from alight.settings import Settings

M = TypeVar("M", bound=GroundMap)
Shots = list[list[View]]  # exposures, the left view first
Matcher = Callable[[Shots, Points], Answer]
PAIRS = 5


def mapped(shots: Shots, method: str, tell: int, settings: Settings | None = None) -> ElevationMap | None:
    """The map of the heights stage alone by `batch` or `ring`; about `tell` views serve to find the ground."""
    views, chosen = [v for shot in shots for v in shot], (settings or Settings()).stages()
    some = views[:: max(1, len(views) // tell)]
    if method == "batch":
        batch = _found(BatchMap(chosen), some)
        batch.match_tiles(views, lambda share: None)
        return batch.snapshot()
    recursive = _found(RecursiveMap(chosen), some)
    for shot in shots:
        recursive.step(shot)
    return recursive.snapshot()


def _found(ground: M, views: list[View]) -> M:
    """Find the ground of a map, and return the map."""
    if not ground.find_ground(views):
        raise SystemExit(ground.reason)
    return ground


def on_map(found: ElevationMap | None, points: Points) -> Answer:
    """Heights of a map at the points."""
    if found is None:  # no baseline yet
        return claimless(np.full(len(points.xyz), np.nan), np.zeros(len(points.xyz), bool))
    r, c = (np.rint(i).astype(int) for i in found.grid.index(points.xyz[:, 0], points.xyz[:, 1]))
    ok = (r >= 0) & (r < found.grid.rows) & (c >= 0) & (c < found.grid.cols)
    r, c = r.clip(0, found.grid.rows - 1), c.clip(0, found.grid.cols - 1)
    height = np.where(ok, found.height[r, c], np.nan).astype(np.float64)
    return Answer(height, found.sigma[r, c].astype(np.float64), ok & found.trusted[r, c])


def batch(shots: Shots, points: Points) -> Answer:
    """Heights of Alight's batch."""
    return on_map(mapped([s[:1] for s in shots], "batch", 8), points)


def ring(shots: Shots, points: Points) -> Answer:
    """Heights of Alight's recursive step, exposure by exposure."""
    return on_map(mapped([s[:1] for s in shots], "ring", 8), points)


def claimless(height: F64, given: Mask) -> Answer:
    """Answer of a matcher without sigma."""
    return Answer(height, np.full(len(height), np.nan), given)


def sgbm_motion(shots: Shots, points: Points) -> Answer:
    """StereoSGBM on pairs half the window apart, median of the pairs."""
    views, half = [s[0] for s in shots], len(shots) // 2
    starts = range(0, len(views) - half, max(1, half // PAIRS))
    heights, given = zip(*(by_pair(views[i], views[i + half], points.xyz) for i in starts), strict=True)
    with np.errstate(all="ignore"):
        return claimless(np.nanmedian(heights, axis=0), np.mean(given, axis=0) > 0.5)


def sgbm_widest(shots: Shots, points: Points) -> Answer:
    """StereoSGBM on the first and the last picture."""
    return claimless(*by_pair(shots[0][0], shots[-1][0], points.xyz))


def sgbm_map(shots: Shots, points: Points) -> Answer:
    """StereoSGBM on the widest pair, as a map of cells as large as Alight's."""
    first, last = shots[0][0], shots[-1][0]
    sampling = ground_sampling(first, float(np.median(points.xyz[:, 2])))
    cell = nice_cell(Settings().tuning.mapping.cell_over_pixel * sampling)
    loose, strict = (map_of_pair(first, last, points.xyz, cell, s) for s in (False, True))
    return claimless(np.where(np.isfinite(strict), strict, loose), np.isfinite(strict))


def sgbm_rig(wider: int) -> Matcher:
    """StereoSGBM on the middle stereo pair, its pictures `wider` times as wide."""

    def run(shots: Shots, points: Points) -> Answer:
        left, right = shots[len(shots) // 2][:2]
        return claimless(*by_pair(left, right, points.xyz, wider))

    return run


MATCHERS: dict[str, Matcher] = {
    "batch": batch, "ring": ring, "SGBM motion, median": sgbm_motion, "SGBM motion, widest": sgbm_widest,
    "SGBM motion, map": sgbm_map,
    "SGBM rig": sgbm_rig(1), "SGBM rig x4": sgbm_rig(4),
}  # fmt: skip
