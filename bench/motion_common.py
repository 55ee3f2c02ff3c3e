"""Common code of the parts of bench_motion.py: rows of the table, and one pass over a flight."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for each other cost eight times the work here

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from point_flight import error

from alight.arrays import F64
from alight.geometry import Pose
from alight.pipeline.navigation import FilterLane
from alight.records import Motion, Rig
from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources import Source
from alight_sim.flight import SimulatedFlight

SECOND = 1_000_000_000
DATA = Path(os.environ.get("ALIGHT_DATA", Path(__file__).parents[2] / "shared" / "data"))


@dataclass(frozen=True)
class Row:
    """One quantity: its measured value and its limits. Smaller is better unless `least`."""

    name: str
    value: float
    must: float | None = None
    aim: float | None = None
    unit: str = ""
    least: bool = False

    def line(self) -> str:
        """One line of the table."""
        sign = ">=" if self.least else "<="

        def meets(limit: float | None) -> bool:
            return limit is None or (self.value >= limit if self.least else self.value <= limit)

        def wanted(limit: float | None) -> str:
            return "" if limit is None else f"{sign} {limit:g}"

        verdict = (
            "" if self.must is None else "MISS" if not meets(self.must) else "must" if not meets(self.aim) else "aim"
        )
        limits = f"{wanted(self.must):>10s}{wanted(self.aim):>10s}"
        return f"{self.name:66s}{self.value:10.3f} {self.unit:6s}{limits}  {verdict}"


def say(*rows: Row) -> None:
    for row in rows:
        print(row.line(), flush=True)


@dataclass
class Flown:
    """Result of one pass over a flight."""

    rig: Rig
    online: list[Motion] = field(default_factory=list)
    rings: list[tuple[Motion, Motion]] = field(default_factory=list)  # oldest and newest keyframe, same posterior
    smoothed: list[Motion] = field(default_factory=list)
    events: list[object] = field(default_factory=list)  # tracks in place of frames: to fly again without pictures


def fly(source: Source | SimulatedFlight, settings: Settings) -> Flown:
    """Run tracks, filter and batch over a recording."""
    stages = settings.stages(source.imu_noise)
    lane, out = FilterLane(source.rig, stages), Flown(source.rig)
    for event in source.events():
        batch = lane.batcher.take(event)
        if batch is None:
            continue
        out.events += batch.rows
        lane.take_rows(batch)
        tracked = lane.tracking.track(batch)
        if tracked is None:
            continue
        out.events.append(tracked.tracks)
        navigation = lane.update(tracked)
        if navigation is None or navigation.motion is None or navigation.posterior is None:
            continue
        out.online.append(navigation.motion)
        ring = navigation.posterior.motions
        if len(ring) >= stages.motion.filter.clones:
            out.rings.append((next(m for m in ring if ring[-1].t_ns - m.t_ns <= 2 * SECOND), ring[-1]))
    out.smoothed = list(lane.finish(lambda share: None).motions)
    return out


def relative_px(a: Motion, b: Motion, truth: Callable[[int], Pose], rig: Rig, depth: float) -> float:
    """Mean squared error in pixels of points at `depth`, transferred from one view to the other."""
    camera, body_from_cam = rig.cameras[0].camera, rig.cameras[0].body_from_cam
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 4))
    points = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2)) * depth
    said = (b.world_from_cams[0].inverse @ a.world_from_cams[0]).apply(points)
    true = ((truth(b.t_ns) @ body_from_cam).inverse @ (truth(a.t_ns) @ body_from_cam)).apply(points)
    miss = camera.fu * (said[:, :2] / said[:, 2:] - true[:, :2] / true[:, 2:])
    return float((miss**2).sum(axis=1).mean())


def ring_px(flown: Flown, truth: Callable[[int], Pose], depth: float) -> tuple[float, float]:
    """RMS px from the oldest keyframe within 2 s to the newest of every ring, and their mean distance in s."""
    px = [relative_px(a, b, truth, flown.rig, depth) for a, b in flown.rings]
    return float(np.sqrt(np.mean(px))), float(np.mean([b.t_ns - a.t_ns for a, b in flown.rings])) / SECOND


def interpolated(source: Source) -> Callable[[int], Pose]:
    """True body poses by time."""
    assert source.truth_trajectory is not None
    t, poses = np.asarray(source.truth_trajectory[0], dtype=np.float64), source.truth_trajectory[1]

    def at(t_ns: int) -> Pose:
        k = int(np.clip(np.searchsorted(t, t_ns), 1, len(t) - 1))
        return poses[k - 1].interpolate(poses[k], (t_ns - t[k - 1]) / (t[k] - t[k - 1]))

    return at


def errors(motions: Sequence[Motion], truth: Callable[[int], Pose]) -> tuple[F64, F64, float]:
    """Position errors (N, 3) metres, rotation errors (N, 3) rad, in the world, and the mean NEES."""
    found = [error(m, truth(m.t_ns)) for m in motions]
    e = np.array([x for x, _ in found])
    return e[:, :3], e[:, 3:], float(np.mean([x @ np.linalg.solve(c, x) for x, c in found]))


def recording(folder: Path, settings: Settings) -> Source | None:
    """Open a recording; print a line if it is absent."""
    if not folder.is_dir():
        print(f"{folder}: absent, left out; set ALIGHT_DATA to the folder of recordings")
        return None
    return open_source(folder, settings)
