"""A descent from 100 m to 5 m in one run: accuracy of the recursive map at every height, and steps where cells change.

    python bench/bench_descent.py                        # desert, test seed
    python bench/bench_descent.py --scene meadow --seed 1 --picture out/descent.png

True poses, the left camera, keyframes 2 % of the height apart; the map is judged in the inner two thirds of the ground
in the newest picture, against the simulator's truth.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from heights_table import Row, head, kept
from numpy.typing import NDArray

from alight.arrays import F64
from alight.elevation import TiledElevation
from alight.geometry import Grid
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.pipeline.mapping.view_geometry import footprint
from alight.records import ElevationMap, View
from alight.settings import Settings
from alight.spread import nmad
from alight_sim import SimulatedFlight, fly
from alight_sim.patterns import FlightPlan

HIGH, LOW, SHARE = 100.0, 5.0, 0.02
STAGES = (80, 70, 60, 50, 42, 35, 30, 25, 20, 17, 14, 12, 10, 8.5, 7, 6, 5.2)  # metres above ground
INNER = 0.67


@dataclass(frozen=True)
class Stage:
    """The map under the vehicle at one height; shares in %, errors in % of the height."""

    height: float
    cell: float
    known: float
    bias: float
    spread: float
    p95: float
    covered: float  # within 1.96 sigma


def flight(scene: str, seed: int) -> SimulatedFlight:
    """Simulate the descent, with a slant of a third."""
    plan = FlightPlan(pattern="descent", height=HIGH, end_height=LOW, speed=5.0)
    return fly(scene, seed, plan=plan, rate_hz=50.0)


def keyframes(f: SimulatedFlight) -> Iterator[View]:
    """Pictures of the left camera, `SHARE` of the height apart, with their true poses."""
    ground = f.world.height_at(*f.pose(int(f.frame_times[-1])).translation[:2])
    last, cam = np.full(3, np.inf), f.true_rig.cameras[0]
    for k, t_ns in enumerate(f.frame_times):
        body = f.pose(int(t_ns))
        if np.linalg.norm(body.translation - last) >= SHARE * (body.translation[2] - ground):
            last = body.translation
            yield View(int(t_ns), 0, f.image(k, 0), cam.camera, body @ cam.body_from_cam)


def truth_on(f: SimulatedFlight, grid: Grid) -> F64:
    """True heights of the cells, metres, NaN outside the truth."""
    row, col = f.truth.grid.index(*grid.xy())
    at = [np.asarray(v, dtype=np.float32) for v in np.meshgrid(col, row)]
    edge = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": np.nan}
    return np.asarray(cv2.remap(f.truth.height.astype(np.float32), *at, cv2.INTER_LINEAR, **edge), dtype=np.float64)


def under(elevation: TiledElevation, view: View, ground: float, level: int) -> ElevationMap:
    """The map in the inner part of the ground in a picture."""
    seen = footprint(view, ground)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, half = (low + high) / 2, INNER * (high - low) / 2
    (west, south), (east, north) = middle - half, middle + half
    return elevation.read(elevation.window((west, east), (south, north), level))


def stage_of(f: SimulatedFlight, m: ElevationMap, up: float) -> Stage:
    """Accuracy of a map, with the vehicle `up` metres above ground."""
    e = (m.height - truth_on(f, m.grid))[m.trusted]
    sigma = m.sigma[m.trusted][np.isfinite(e)]
    e = e[np.isfinite(e)]
    size, covered = 100 * np.abs(e) / up, 100 * float((np.abs(e) < 1.96 * sigma).mean())
    bias, p95 = 100 * float(np.median(e)) / up, float(np.percentile(size, 95))
    return Stage(up, m.grid.cell, 100 * float(m.trusted.mean()), bias, 100 * nmad(e) / up, p95, covered)


def descend(f: SimulatedFlight) -> tuple[RecursiveMap, list[Stage], list[float]]:
    """Fly the descent: the map, its stages, and at every change of the cell the median step of the map in sigmas."""
    views = list(keyframes(f))
    lane = RecursiveMap(Settings().stages())
    if not lane.find_ground(views[:8]):
        raise SystemExit(lane.reason)
    assert lane.elevation is not None
    stages, steps, left, level = [], [], list(STAGES), 0
    for v in views:
        ground = lane.ground_below
        assert ground is not None
        before = under(lane.elevation, v, ground, level)
        lane.step([v])
        if lane.level != level:
            after, level = lane.elevation.read(before.grid), lane.level
            both = before.trusted & after.trusted
            steps.append(float(np.median((np.abs(after.height - before.height) / before.sigma)[both])))
        up = float(v.centre[2] - (lane.ground_here or ground))
        if left and up < left[0]:
            left = [h for h in left if h <= up]
            m = under(lane.elevation, v, lane.ground_here or ground, level)
            if m.trusted.sum() > 200:
                stages.append(stage_of(f, m, up))
    return lane, stages, steps


def rows(scene: str = "desert", seed: int = 1001) -> list[Row]:
    """The worst of all stages."""

    def work() -> dict[str, float]:
        _, stages, steps = descend(flight(scene, seed))
        low = [s for s in stages if s.height < 60]
        return {
            "NMAD, % of height": max(s.spread for s in low),
            "P95, % of height": max(s.p95 for s in low),
            "least share given, %": min(s.known for s in low),
            "95 % interval covers at least, %": min(s.covered for s in low),
            "step where the cell changes, median in sigma": max(steps),
        }

    found = kept(f"descent {scene} {seed}", work)
    return [Row(f"descent 100 m to 5 m, {scene}, worst height: {k}", v) for k, v in found.items()]


def picture(lane: RecursiveMap, f: SimulatedFlight) -> NDArray[np.uint8]:
    """The map in three squares about its end: colours, heights, true heights, error over six sigma; (H, W, 3)."""
    assert lane.elevation is not None
    end, out = f.pose(int(f.frame_times[-1])).translation, []
    for half in (32.0, 8.0, 2.0):
        level = max(lane.level, round(np.log2(2 * half / 400 / lane.elevation.cell)))
        grid = lane.elevation.window((end[0] - half, end[0] + half), (end[1] - half, end[1] + half), level)
        m, truth = lane.elevation.read(grid), truth_on(f, grid)
        low, high = np.nanpercentile(truth, [1, 99])
        tall = painted((m.height - low) / (high - low), m.trusted)
        true = painted((truth - low) / (high - low), np.isfinite(truth))
        wrong = painted(0.5 + (m.height - truth) / (6 * m.sigma), m.trusted)
        parts = [cv2.resize(p, (400, 400), interpolation=cv2.INTER_AREA) for p in (m.rgb, tall, true, wrong)]
        out.append(np.hstack(parts))
    return np.vstack(out)


def painted(values: NDArray[np.floating], where: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Colours of values from 0 to 1; grey where `where` is False."""
    level = (np.clip(np.nan_to_num(values), 0, 1) * 255).astype(np.uint8)
    return np.where(where[..., None], cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1], 90).astype(np.uint8)


def main() -> None:
    """Print a line a stage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="desert")
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    f = flight(options.scene, options.seed)
    lane, stages, steps = descend(f)
    print(head("height: cell, given, bias, NMAD, P95 (% of height), 95 % interval covers")[:78])
    for s in stages:
        size = f"{s.height:7.2f} m {s.cell:8.4f} m {s.known:7.1f} %"
        print(f"{size} {s.bias:8.3f} {s.spread:7.3f} {s.p95:7.3f} {s.covered:7.1f} %")
    print("steps where the cell changes, median in sigma:", ", ".join(f"{v:.2f}" for v in steps))
    if options.picture:
        options.picture.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(options.picture), picture(lane, f)[..., ::-1])


if __name__ == "__main__":
    main()
