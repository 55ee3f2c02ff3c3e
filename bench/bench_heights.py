"""Heights with true poses against StereoSGBM on the same frames, judged on the same points of simulated ground.

    python bench/bench_heights.py                        # the ladder's test seeds
    python bench/bench_heights.py meadow/50m/test-1      # some rungs

Of every rung, N consecutive exposures about its middle. What is compared: the batch and the ring on the left pictures,
StereoSGBM on pairs of the same motion (median of the pairs that see a point), and on the rig, plain and on pictures
four times as wide. Points: cells of the truth, drawn evenly, that the first and the last exposure see.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from doubt import exposures
from matchers import Rectified, disparity, stands_clear
from numpy.typing import NDArray

from alight.evaluate.report import nmad
from alight.pipeline.terrain_lane import TerrainLane
from alight.records import F64, Terrain, View
from alight.settings import Settings
from alight.simulate import SimulatedFlight
from alight.simulate.ladder import Rung, ladder, rung

COUNTS = (10, 20)  # exposures
SCENES = ("meadow", "farmland", "village", "quarry", "forest", "lakes", "desert", "yard")
POINTS = 20_000
OPEN = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)
STEP, BESIDE = 0.5, 0.5  # metres: of a height step, and beside it
BAD = 0.5  # metres
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Points:
    """Cells of the truth that the exposures see."""

    xyz: F64  # (N, 3) metres
    open: Mask  # ground without a step beside it
    edge: Mask  # within `BESIDE` of a step


@dataclass(frozen=True, eq=False)
class Answer:
    """What a matcher says of the points."""

    height: F64  # (N,) metres, NaN where nothing
    sigma: F64  # (N,) NaN where it claims none
    given: Mask  # what it would give out


def points_of(flight: SimulatedFlight, shots: list[list[View]]) -> Points:
    """Draw the points."""
    truth = flight.truth
    size = 2 * round(BESIDE / truth.grid.cell) + 1
    near = np.ones((size, size), np.uint8)
    rise = cv2.dilate(truth.height, near) - cv2.erode(truth.height, near)
    drawn = np.random.default_rng(0).permutation(truth.height.size)[: 4 * POINTS]
    r, c = np.unravel_index(drawn, truth.height.shape)
    e, n = truth.grid.xy()
    xyz = np.c_[e[c], n[r], truth.height[r, c]].astype(np.float64)
    seen = np.ones(len(xyz), bool)
    for view in (shots[0][0], shots[-1][0]):
        uv = view.camera.project(view.world_from_cam.inverse.apply(xyz))
        with np.errstate(invalid="ignore"):
            seen &= ((uv > 8) & (uv < [view.camera.width - 8, view.camera.height - 8])).all(1)
        seen[seen] &= stands_clear(truth.height, truth.grid, xyz[seen], view)
    seen &= truth.label[r, c] != Terrain.WATER
    k = np.flatnonzero(seen)[:POINTS]
    step = rise[r[k], c[k]] > STEP
    return Points(xyz[k], np.isin(truth.label[r[k], c[k]], OPEN) & ~step, step)


# -- the matchers


def _on_map(lane: TerrainLane, points: Points) -> Answer:
    found = lane.elevation.snapshot() if lane.elevation else None
    assert found is not None
    r, c = (np.rint(i).astype(int) for i in found.grid.index(points.xyz[:, 0], points.xyz[:, 1]))
    ok = (r >= 0) & (r < found.grid.rows) & (c >= 0) & (c < found.grid.cols)
    r, c = r.clip(0, found.grid.rows - 1), c.clip(0, found.grid.cols - 1)
    height = np.where(ok, found.height[r, c], np.nan).astype(np.float64)
    return Answer(height, found.sigma[r, c].astype(np.float64), ok & found.trusted[r, c])


def _lane(views: list[View]) -> TerrainLane:
    lane = TerrainLane(Settings())
    if not lane.learn(views[:: max(1, len(views) // 8)]):
        raise SystemExit(lane.reason)
    return lane


def batch(shots: list[list[View]], points: Points) -> Answer:
    """Alight's batch on the left pictures."""
    views = [s[0] for s in shots]
    lane = _lane(views)
    lane.build(views, lambda share: None)
    return _on_map(lane, points)


def ring(shots: list[list[View]], points: Points) -> Answer:
    """Alight's recursive step, exposure by exposure."""
    lane = _lane([s[0] for s in shots])
    for shot in shots:
        lane.step(shot[:1])
    return _on_map(lane, points)


def _by_pair(a: View, b: View, points: Points, wider: int = 1) -> tuple[F64, Mask]:
    pair = Rectified(a, b)
    uv, z = pair.project(points.xyz)
    near, far = float(z.min()) - 1.0, float(z.max()) + 1.0
    height, given = np.full(len(z), np.nan), np.zeros(len(z), bool)
    for strict in (False, True):
        found = disparity(pair, near, far, strict, wider)
        h, w = found.shape
        col, row = np.rint(uv).astype(int).T
        inside = (col >= 0) & (col < w) & (row >= 0) & (row < h)
        d = np.where(inside, found[row.clip(0, h - 1), col.clip(0, w - 1)], -1e9)
        low = pair.f * pair.baseline / far - 4
        if strict:
            given = d > max(low, 0.0)
        else:
            known = d > max(low, 0.0)
            depth = pair.f * pair.baseline / np.where(known, d, 1.0)
            # along the ray that the point was looked up on; the height is where it ends
            ray = (points.xyz - pair.centre) / z[:, None]
            height = np.where(known, pair.centre[2] + ray[:, 2] * depth, np.nan)
    return height, given


def sgbm_motion(shots: list[list[View]], points: Points) -> Answer:
    """StereoSGBM on pairs half the window apart, median of the pairs."""
    views, half = [s[0] for s in shots], len(shots) // 2
    pairs = [(views[i], views[i + half]) for i in range(0, len(views) - half, max(1, half // 5))]
    heights, given = zip(*(_by_pair(a, b, points) for a, b in pairs), strict=True)
    with np.errstate(all="ignore"):
        return Answer(np.nanmedian(heights, axis=0), np.full(len(points.xyz), np.nan), np.mean(given, axis=0) > 0.5)


def sgbm_widest(shots: list[list[View]], points: Points) -> Answer:
    """StereoSGBM on the first and the last picture."""
    return Answer(*_claimless(*_by_pair(shots[0][0], shots[-1][0], points)))


def sgbm_rig(wider: int) -> Callable[[list[list[View]], Points], Answer]:
    """StereoSGBM on the middle stereo pair, its pictures `wider` times as wide."""

    def run(shots: list[list[View]], points: Points) -> Answer:
        return Answer(*_claimless(*_by_pair(*shots[len(shots) // 2][:2], points, wider)))

    return run


def _claimless(height: F64, given: Mask) -> tuple[F64, F64, Mask]:
    return height, np.full(len(height), np.nan), given


MATCHERS: dict[str, Callable[[list[list[View]], Points], Answer]] = {
    "batch": batch, "ring": ring, "SGBM motion, median": sgbm_motion, "SGBM motion, widest": sgbm_widest,
    "SGBM rig": sgbm_rig(1), "SGBM rig x4": sgbm_rig(4),
}  # fmt: skip


# -- the table


def row(answer: Answer, points: Points, both: Mask, above: float) -> dict[str, float]:
    """Errors of one matcher; `both`: points where all have a height."""
    e = answer.height - points.xyz[:, 2]
    ground, edge = both & points.open, both & points.edge
    out = {
        "open NMAD %": 100 * nmad(e[ground]) / above,
        "open P95 %": 100 * float(np.percentile(np.abs(e[ground] - np.median(e[ground])), 95)) / above,
        "edge bad %": 100 * float((np.abs(e[edge]) > BAD).mean()) if edge.sum() > 50 else np.nan,
        "given %": 100 * float(answer.given.mean()),
        "bad given %": 100 * float((np.abs(e[answer.given]) > BAD).mean()),
    }
    for name, where in (("open", points.open & answer.given), ("edge", points.edge & answer.given)):
        if where.sum() > 50 and np.isfinite(answer.sigma[where]).all():
            off = np.abs(e[where]) / answer.sigma[where]
            out |= {f"{name} 68 %": 100 * float((off < 1).mean()), f"{name} 95 %": 100 * float((off < 1.96).mean())}
    return out


def measure(which: Rung) -> Iterator[tuple[int, dict[str, dict[str, float]]]]:
    """For each N the row of every matcher."""
    flight = which.fly()
    shots = list(exposures(flight))
    for count in COUNTS:
        start = (len(shots) - count) // 2
        some = shots[start : start + count]
        points = points_of(flight, some)
        above = float(some[0][0].centre[2] - np.median(points.xyz[:, 2]))
        answers = {name: work(some, points) for name, work in MATCHERS.items()}
        both = np.all([np.isfinite(a.height) for a in answers.values()], axis=0)
        yield count, {name: row(a, points, both, above) for name, a in answers.items()}


def main() -> None:
    """Print a table a rung."""
    chosen = [rung(name) for name in sys.argv[1:]] or ladder("test", scenes=SCENES, seeds=1)
    for which in chosen:
        for count, rows in measure(which):
            print(f"\n{which.name}, N = {count}", flush=True)
            columns = list(rows["batch"])
            print(f"{'':22s}" + "".join(f"{c:>13s}" for c in columns))
            for name, values in rows.items():
                print(f"{name:22s}" + "".join(f"{values.get(c, np.nan):13.3f}" for c in columns), flush=True)


if __name__ == "__main__":
    main()
