"""How good the estimated motion of a flight log is against its truth: filter, ring of keyframes, batch.

python bench/motion.py ../shared/data/sample
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for each other cost eight times the work here

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from alight.geometry import Camera, Pose, so3_log
from alight.motion import MotionFilter
from alight.records import F64, Frame, ImuSample, Motion, MotionState, NavSample
from alight.settings import Settings
from alight.sources import Source, open_source
from alight.tracks import Tracker

SECOND = 1_000_000_000


@dataclass
class Truth:
    """True body poses by time, interpolated."""

    t: F64
    poses: list[Pose]

    def at(self, t_ns: int) -> Pose:
        k = int(np.clip(np.searchsorted(self.t, t_ns), 1, len(self.t) - 1))
        return self.poses[k - 1].interpolate(self.poses[k], (t_ns - self.t[k - 1]) / (self.t[k] - self.t[k - 1]))


@dataclass
class Flown:
    """What one pass over a flight gave."""

    online: list[Motion] = field(default_factory=list)
    rings: list[tuple[Motion, Motion]] = field(default_factory=list)  # oldest and newest keyframe, same posterior
    smoothed: list[Motion] = field(default_factory=list)
    seconds: tuple[float, float] = (0.0, 0.0)  # CPU of tracks and filter, of the batch


def fly(source: Source, settings: Settings) -> Flown:
    """Run tracks, filter and batch over a recording."""
    tracker, estimator, out = (
        Tracker(source.rig, settings.tracks),
        MotionFilter(source.rig, settings.motion.filter),
        Flown(),
    )
    start = time.process_time()
    for event in source.events():
        if isinstance(event, ImuSample):
            estimator.feed_imu(event)
        elif isinstance(event, NavSample):
            estimator.feed_nav(event)
        elif isinstance(event, Frame):
            motion = estimator.feed_tracks(tracker.feed(event, estimator.predict(event.t_ns)))
            ring = estimator.ring()
            out.online += [motion] if motion else []
            out.rings += [(ring[0], ring[-1])] if len(ring) >= settings.motion.filter.clones else []
    middle = time.process_time()
    out.smoothed = estimator.smoothed()
    out.seconds = middle - start, time.process_time() - middle
    return out


def relative_px(a: Motion, b: Motion, truth: Truth, camera: Camera, body_from_cam: Pose, depth: float) -> float:
    """Mean squared pixels by which points at `depth`, carried from one view to the other, miss."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 4))
    points = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2)) * depth
    said = (b.world_from_cams[0].inverse @ a.world_from_cams[0]).apply(points)
    true = ((truth.at(b.t_ns) @ body_from_cam).inverse @ (truth.at(a.t_ns) @ body_from_cam)).apply(points)
    miss = camera.fu * (said[:, :2] / said[:, 2:] - true[:, :2] / true[:, 2:])
    return float((miss**2).sum(axis=1).mean())


def errors(motions: Sequence[Motion], truth: Truth) -> tuple[F64, F64, float]:
    """Position errors (N, 3) metres, rotation errors (N, 3) rad, both in the world, and the mean NEES."""
    true = [truth.at(m.t_ns) for m in motions]
    p = np.array([m.world_from_body.translation - q.translation for m, q in zip(motions, true, strict=True)])
    r = np.array([so3_log(m.world_from_body.rotation @ q.rotation.T) for m, q in zip(motions, true, strict=True)])
    e = np.hstack([p, r])
    nees = float(np.mean([x @ np.linalg.solve(m.covariance, x) for x, m in zip(e, motions, strict=True)]))
    return p, r, nees


def row(name: str, values: F64, unit: str) -> None:
    print(f"  {name:34s}" + " ".join(f"{v:9.3f}" for v in np.atleast_1d(values)) + f"  {unit}")


def table(name: str, motions: Sequence[Motion], truth: Truth) -> None:
    """Print one block."""
    p, r, nees = errors(motions, truth)
    print(
        f"{name}: {len(motions)} exposures, "
        + ", ".join(f"{s.name} {sum(m.state is s for m in motions)}" for s in MotionState)
    )
    row("position, RMSE", np.sqrt((p**2).mean(axis=0)), "m east north up")
    row("... constant offset removed", p.std(axis=0), "m")
    row("attitude, RMSE", 1e3 * np.sqrt((r**2).mean(axis=0)), "mrad about east north up")
    row("... constant offset removed", 1e3 * r.std(axis=0), "mrad")
    row("tilt, mean about east and north", 1e3 * r.mean(axis=0)[:2], "mrad")
    row("NEES (6 expected)", np.array(nees), "")


def main(folder: str, depth: float = 30.0) -> None:
    """Print the table of one flight."""
    settings = Settings()
    source = open_source(Path(folder), settings)
    if source.truth_trajectory is None:
        sys.exit(f"{folder}: has no state_groundtruth_estimate0 to compare with")
    truth = Truth(np.asarray(source.truth_trajectory[0], dtype=np.float64), source.truth_trajectory[1])
    left, flown = source.rig.cameras[0], fly(source, settings)
    print(f"CPU: tracks and filter {flown.seconds[0]:.1f} s, batch {flown.seconds[1]:.1f} s")
    for name, motions in (("filter, as given out", flown.online), ("batch", flown.smoothed)):
        table(name, motions, truth)
        pairs = [(a, b) for a in motions for b in motions if 0 <= b.t_ns - a.t_ns - SECOND < SECOND // 100]
        px = [relative_px(a, b, truth, left.camera, left.body_from_cam, depth) for a, b in pairs]
        row(f"relative over 1 s, RMS at {depth:.0f} m", np.sqrt(np.mean(px)), "px")
    px = [relative_px(a, b, truth, left.camera, left.body_from_cam, depth) for a, b in flown.rings]
    row("ring, oldest to newest, RMS", np.sqrt(np.mean(px)), "px")
    row("... its length", np.mean([b.t_ns - a.t_ns for a, b in flown.rings]) / SECOND, "s")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "../shared/data/sample")
