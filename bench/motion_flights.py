"""Parts of bench_motion.py with pictures: the rendered sample flight, and the cost of navigation."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from point_flight import error
from tables import DATA, Row, at_least, recording, show

from alight.arrays import F64, U8
from alight.geometry import Pose
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.records import Event, Motion, Rig
from alight.settings import Settings, StageSettings, load_settings
from alight.sources import Source

SECOND = 1_000_000_000


@dataclass
class Flown:
    """Result of one pass over a flight."""

    rig: Rig
    online: list[Motion] = field(default_factory=list)
    pairs: list[tuple[Motion, Motion]] = field(default_factory=list)  # oldest and newest keyframe, same posterior
    smoothed: list[Motion] = field(default_factory=list)


def fly(source: Source, settings: Settings) -> Flown:
    """Run tracks, filter and batch over a recording."""
    stages = settings.stages(source.imu_noise)
    lane, out = FilterLane(source.rig, stages), Flown(source.rig)
    for event in source.events():
        navigation = lane.feed(event)
        if navigation is None or navigation.motion is None or navigation.posterior is None:
            continue
        out.online.append(navigation.motion)
        held = navigation.posterior.motions
        if len(held) >= stages.motion.filter.clones:
            out.pairs.append((next(m for m in held if held[-1].t_ns - m.t_ns <= 2 * SECOND), held[-1]))
    out.smoothed = list(lane.finish(lambda share: None).motions)
    return out


def relative_px(a: Motion, b: Motion, truth: Callable[[int], Pose], rig: Rig, depth: float) -> float:
    """Mean squared error in pixels of points at `depth`, transferred from one view to the other."""
    camera, body_from_cam = rig.cameras[0].camera, rig.cameras[0].body_from_cam
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 4))
    points = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2)) * depth
    estimated = (b.world_from_cams[0].inverse @ a.world_from_cams[0]).apply(points)
    true = ((truth(b.t_ns) @ body_from_cam).inverse @ (truth(a.t_ns) @ body_from_cam)).apply(points)
    miss = camera.fu * (estimated[:, :2] / estimated[:, 2:] - true[:, :2] / true[:, 2:])
    return float((miss**2).sum(axis=1).mean())


def posterior_px(flown: Flown, truth: Callable[[int], Pose], depth: float) -> tuple[float, float]:
    """RMS px from the oldest keyframe within 2 s to the newest of every posterior, and their mean distance in s."""
    px = [relative_px(a, b, truth, flown.rig, depth) for a, b in flown.pairs]
    return float(np.sqrt(np.mean(px))), float(np.mean([b.t_ns - a.t_ns for a, b in flown.pairs])) / SECOND


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


def part_sample(_: argparse.Namespace) -> None:
    """The rendered sample flight, 30 m."""
    source = recording(DATA / "sample", Settings())
    if source is None:
        return
    truth, flown = interpolated(source), fly(source, Settings())
    px, length = posterior_px(flown, truth, 30.0)
    show(Row(f"sample flight: consistency of the keyframe posterior over {length:.2f} s, px", px, 0.35, 0.15))
    for name, motions in (("filter", flown.online), ("batch", flown.smoothed)):
        p, r, n = errors(motions, truth)
        pairs = [(a, b) for a in motions for b in motions if 0 <= b.t_ns - a.t_ns - SECOND < SECOND // 100]
        each = np.sqrt(np.mean([relative_px(a, b, truth, flown.rig, 30.0) for a, b in pairs]))
        show(
            Row(f"... {name}: poses given out one by one, over 1 s, px", float(each)),
            Row("... position RMSE, its mean removed, m", float(np.linalg.norm(p.std(axis=0)))),
            Row("... tilt, mean, mrad", 1e3 * float(np.linalg.norm(r.mean(axis=0)[:2]))),
            Row("... NEES (6 expected)", n),
        )


def part_speed(_: argparse.Namespace) -> None:
    """Tracker and filter over the sample flight, 640x480 stereo, and OpenCV's optical flow on the same images."""
    settings = load_settings("", ["tuning.tracks.count=140", "tuning.filter.smooth=false"])
    source = recording(DATA / "sample", settings)
    if source is None:
        return
    events, stages = list(source.events()), settings.stages(source.imu_noise)
    cv2.setNumThreads(1)
    _timed(source.rig, stages, events)  # warm
    ms = _timed(source.rig, stages, events)
    mean, every = ms.mean(axis=0), ms[:, :3].sum(axis=1)
    show(
        Row("tracking and filter over the yardstick, 140 tracks", (mean[1] + mean[2]) / mean[3], 4.0, 2.5),
        Row("... tracking", mean[1] / mean[3]),
        Row("... filter", mean[2] / mean[3]),
        Row("... GPS/INS and IMU rows that came since the exposure before", mean[0] / mean[3]),
        Row("all of navigation, median, ms", float(np.median(every))),
        Row("... 95th percentile, ms", float(np.percentile(every, 95))),
        Row("... yardstick: cv2.calcOpticalFlowPyrLK of 200 points, 4 levels, ms", mean[3]),
        Row("frames a second, in turn on one core, by CPU time", 1e3 / float(every.mean()), at_least(30), at_least(50)),
    )


def _timed(rig: Rig, stages: StageSettings, events: Sequence[Event]) -> F64:
    """CPU (N, 4) ms of each exposure: rows before it, tracking, filter, and the yardstick, in turn under one load."""
    lane, out = FilterLane(rig, stages, history=False), []
    before: U8 | None = None
    for e in events:
        batch = lane.batcher.take(e)
        if batch is None or batch.frame is None or batch.frame.images[0] is None:
            continue
        at = [time.thread_time()]
        lane.take_rows(batch)
        at.append(time.thread_time())
        tracked = lane.tracking.track(batch)
        assert tracked is not None
        at.append(time.thread_time())
        lane.update(tracked)
        at.append(time.thread_time())
        image = cv2.cvtColor(batch.frame.images[0], cv2.COLOR_RGB2GRAY)
        before = image if before is None else before
        corners = cv2.goodFeaturesToTrack(before, 200, 1e-3, 25)
        start = time.thread_time()
        cv2.calcOpticalFlowPyrLK(before, image, corners, None)
        out.append([*np.diff(at), time.thread_time() - start])
        before = image
    return 1e3 * np.array(out[5:])  # at the start nothing is tracked yet
