"""Maps of the heights stage alone with true poses, and their errors at points of simulated ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, Mask
from alight.geometry import Grid
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.records import ElevationMap, Terrain, View
from alight.settings import Settings
from alight.spread import nmad
from alight_sim import SimulatedFlight

POINTS = 20_000
LEAST = 50  # least number of points of a percentage
OPEN = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)
STEP, BESIDE = 0.5, 0.5  # metres: of a height step, and beside it
BAD = 0.5  # metres
BORDER = 8  # px
METHODS = ("batch", "recursive")
Numbers = dict[str, float]
Shots = list[list[View]]  # exposures, the left view first


def mapped(shots: Shots, method: str, found_by: int) -> ElevationMap | None:
    """The map of the heights stage alone by `batch` or `recursive`; about `found_by` views serve to find the ground."""
    views = [v for shot in shots for v in shot]
    ground = (BatchMap if method == "batch" else RecursiveMap)(Settings().stages())
    if not ground.find_ground(views[:: max(1, len(views) // found_by)]):
        raise SystemExit(ground.reason)
    if isinstance(ground, BatchMap):
        ground.match_tiles(views, lambda share: None)
    else:
        for shot in shots:
            ground.step(shot)
    return ground.snapshot()


@dataclass(frozen=True, eq=False)
class Points:
    """Cells of the truth, drawn evenly, that the first and the last exposure see."""

    xyz: F64  # (N, 3) metres
    open: Mask  # ground without a step beside it
    edge: Mask  # within `BESIDE` of a step
    above: float  # metres, the first camera over the points


@dataclass(frozen=True, eq=False)
class Answer:
    """Heights of a matcher at the points."""

    height: F64  # (N,) metres, NaN = no height
    sigma: F64  # (N,) NaN = no claim
    given: Mask  # heights that it would give out


def inside(view: View, xyz: F64) -> Mask:
    """Mask (N,) of the points (N, 3) that lie in a picture, `BORDER` pixels away from its end."""
    uv = view.camera.project(view.world_from_cam.inverse.apply(xyz))
    with np.errstate(invalid="ignore"):
        return np.asarray(((uv > BORDER) & (uv < [view.camera.width - BORDER, view.camera.height - BORDER])).all(1))


def stands_clear(surface: F32, grid: Grid, xyz: F64, view: View) -> Mask:
    """Mask (N,) of the points (N, 3) that no part of a surface hides from a camera."""
    clear, way = np.ones(len(xyz), bool), view.centre - xyz
    for rise in np.arange(0.2, float(np.nanmax(surface)) - float(np.nanmin(surface)), 0.2):
        p = xyz + way * (rise / way[:, 2:])
        r, c = (np.rint(i).astype(int) for i in grid.index(p[:, 0], p[:, 1]))
        clear &= ~(surface[r.clip(0, grid.rows - 1), c.clip(0, grid.cols - 1)] > p[:, 2] + 0.1)
    return clear


def points_of(flight: SimulatedFlight, shots: Shots) -> Points:
    """Draw the points, none of them on water."""
    truth = flight.truth
    size = 2 * round(BESIDE / truth.grid.cell) + 1
    near = np.ones((size, size), np.uint8)
    rise = cv2.dilate(truth.height, near) - cv2.erode(truth.height, near)
    drawn = np.random.default_rng(0).permutation(truth.height.size)[: 4 * POINTS]
    r, c = np.unravel_index(drawn, truth.height.shape)
    e, n = truth.grid.xy()
    xyz = np.c_[e[c], n[r], truth.height[r, c]].astype(np.float64)
    seen = truth.label[r, c] != Terrain.WATER
    for view in (shots[0][0], shots[-1][0]):
        seen &= inside(view, xyz)
        seen[seen] &= stands_clear(truth.height, truth.grid, xyz[seen], view)
    k = np.flatnonzero(seen)[:POINTS]
    step = rise[r[k], c[k]] > STEP
    above = float(shots[0][0].centre[2] - np.median(xyz[k, 2]))
    return Points(xyz[k], np.isin(truth.label[r[k], c[k]], OPEN) & ~step, step, above)


def on_map(found: ElevationMap | None, points: Points) -> Answer:
    """Heights of a map at the points."""
    if found is None:  # no baseline yet
        return claimless(np.full(len(points.xyz), np.nan))
    r, c = (np.rint(i).astype(int) for i in found.grid.index(points.xyz[:, 0], points.xyz[:, 1]))
    ok = (r >= 0) & (r < found.grid.rows) & (c >= 0) & (c < found.grid.cols)
    r, c = r.clip(0, found.grid.rows - 1), c.clip(0, found.grid.cols - 1)
    height = np.where(ok, found.height[r, c], np.nan).astype(np.float64)
    return Answer(height, found.sigma[r, c].astype(np.float64), ok & found.trusted[r, c])


def claimless(height: F64) -> Answer:
    """Answer of a matcher that neither refuses a height nor claims a sigma."""
    return Answer(height, np.full(len(height), np.nan), np.isfinite(height))


def percent(part: Mask) -> float:
    """Share of a mask in percent, NaN of too few."""
    return 100 * float(part.mean()) if part.size > LEAST else np.nan


def errors(answer: Answer, points: Points, both: Mask) -> Numbers:
    """One matcher's row; `both`: points where all matchers have a height.

    `open 68 %` and so on: of the points given out, those within 1 (and 1.96) of the claimed sigma.
    """
    e = answer.height - points.xyz[:, 2]
    ground, edge = e[both & points.open], e[both & points.edge]
    out = {
        "open NMAD %": 100 * nmad(ground) / points.above if ground.size > LEAST else np.nan,
        "edge bad %": percent(np.abs(edge) > BAD),
        "given %": 100 * float(answer.given.mean()),
        "bad given %": percent(np.abs(e[answer.given]) > BAD),
    }
    for name, where in (("open", points.open & answer.given), ("edge", points.edge & answer.given)):
        if where.sum() > LEAST and np.isfinite(answer.sigma[where]).all():
            off = np.abs(e[where]) / answer.sigma[where]
            out |= {f"{name} 68 %": percent(off < 1), f"{name} 95 %": percent(off < 1.96)}
    return out


def compare(answers: Mapping[str, Answer], points: Points) -> dict[str, Numbers]:
    """The row of every matcher, errors on the points where all have a height."""
    both = np.all([np.isfinite(a.height) for a in answers.values()], axis=0)
    return {name: errors(a, points, both) for name, a in answers.items()}
