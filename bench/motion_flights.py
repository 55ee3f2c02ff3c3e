"""Parts of bench_motion.py with pictures: the rendered sample flight, the ladder, and the cost of navigation."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import ladder
import numpy as np
from point_flight import error
from tables import DATA, Row, at_least, recording, show

from alight.arrays import F64, U8
from alight.geometry import Pose
from alight.motion import MotionFilter
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.records import Event, ImuSample, Motion, MotionState, NavSample, Rig, Tracks
from alight.settings import FilterSettings, Settings, StageSettings, load_settings
from alight.sources import Source
from alight_sim.flight import SimulatedFlight

SECOND = 1_000_000_000
SKIPPED = 5  # exposures at the start, when nothing is tracked yet


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


def part_sample(_: argparse.Namespace) -> None:
    """The rendered sample flight, 30 m."""
    source = recording(DATA / "sample", Settings())
    if source is None:
        return
    truth, flown = interpolated(source), fly(source, Settings())
    px, length = ring_px(flown, truth, 30.0)
    show(Row(f"sample flight: consistency of the ring over {length:.2f} s, px", px, 0.35, 0.15))
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


@dataclass(frozen=True)
class Climbed:
    """Numbers of one rung of the ladder."""

    height: int
    ring: float  # px, RMS
    seconds: float  # that a ring spans
    lost: int  # exposures
    nees: float
    alone: float  # % of the way, GPS/INS off after the first second
    cameras: float  # % of the way, and no IMU either

    @classmethod
    def of(cls, rung: ladder.Rung) -> Climbed:
        """Fly a rung and measure it."""
        flight = rung.fly()
        flown = fly(flight, load_settings("", ["tuning.filter.smooth=false"]))
        px, length = ring_px(flown, flight.pose, float(rung.height))
        lost = sum(m.state is MotionState.LOST for m in flown.online)
        mean = errors(flown.online, flight.pose)[2]
        return cls(rung.height, px, length, lost, mean, _alone(flown, flight, True), _alone(flown, flight, False))


def part_ladder(options: argparse.Namespace) -> None:
    """The standard ladder with pictures, flights without a part in tuning: ring, states, vision alone beside it."""
    scenes, heights = options.scenes.split(","), [int(h) for h in options.heights.split(",")]
    print(f"{'':34s}{'ring px':>9s}{'over s':>8s}{'lost':>6s}{'NEES':>7s}{'no GPS/INS %':>14s}{'nor IMU %':>11s}")
    found = []
    for r in ladder.ladder("test", scenes=scenes, heights=heights, seeds=options.seeds):
        c = Climbed.of(r)
        found.append(c)
        print(
            f"{r.name:34s}{c.ring:9.3f}{c.seconds:8.2f}{c.lost:6d}{c.nees:7.1f}{c.alone:14.2f}{c.cameras:11.2f}",
            flush=True,
        )
    for h in heights:
        some = [c for c in found if c.height == h]
        kept = 100 * float(np.mean([c.lost == 0 for c in some]))
        rings = np.array([c.ring for c in some])
        show(
            Row(f"ladder {h} m, {len(some)} flights: completed without `lost`, %", kept, at_least(100), at_least(100)),
            Row("... ring, RMS over the flights, px", float(np.sqrt(np.mean(rings**2))), 0.35, 0.15),
            Row("... ring, the worst flight, px", float(rings.max())),
            Row("... NEES, mean (6 expected)", float(np.mean([c.nees for c in some]))),
            Row("... GPS/INS off after 1 s: drift of the way, median, %", float(np.median([c.alone for c in some]))),
            Row("... and no IMU: cameras alone, median, %", float(np.median([c.cameras for c in some]))),
        )


def _alone(flown: Flown, flight: SimulatedFlight, imu: bool) -> float:
    """Percent of the way by which vision drifts when GPS/INS falls silent after the first second."""
    estimator, motions = MotionFilter(flown.rig, FilterSettings(smooth=False)), []
    begin = int(flight.frame_times[0]) + SECOND
    for e in flown.events:
        if isinstance(e, Tracks):
            motions += [m] if (m := estimator.feed_tracks(e)) else []
        elif isinstance(e, NavSample) and e.t_ns < begin:
            estimator.feed_nav(e)
        elif isinstance(e, ImuSample) and imu:
            estimator.feed_imu(e)
    first = next(m for m in motions if m.t_ns >= begin)
    off = [m.world_from_body.translation - flight.pose(m.t_ns).translation for m in (first, motions[-1])]
    way = flight.pose(motions[-1].t_ns).translation - flight.pose(first.t_ns).translation
    return 100 * float(np.linalg.norm(off[1] - off[0]) / np.linalg.norm(way))


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
    return 1e3 * np.array(out[SKIPPED:])
