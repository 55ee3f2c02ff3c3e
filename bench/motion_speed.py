"""Cost of navigation: CPU time in turn on one core, and rate in real time on two threads."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from threading import Thread
from typing import TypeVar

import cv2
import numpy as np
from motion_common import DATA, Row, recording, say

from alight.arrays import U8
from alight.flight.live.mailbox import Closed, Mailbox
from alight.motion.ekf.prediction import MotionPredictor
from alight.pipeline.navigation import FilterLane, FrameBatch, Navigation
from alight.records import Event, Rig
from alight.settings import StageSettings, load_settings

T = TypeVar("T")
_SKIPPED = 5  # exposures at the start, when nothing is tracked yet


class Meter:
    """Calls of a function, and the CPU time of its thread that each took."""

    def __init__(self) -> None:
        self.ms = list[float]()

    def on(self, call: Callable[..., T]) -> Callable[..., T]:
        """Wrap a function so that its calls are measured."""

        def measured(*given: object) -> T:
            begin = time.thread_time()
            out = call(*given)
            self.ms.append(1e3 * (time.thread_time() - begin))
            return out

        return measured


def part_speed(_: argparse.Namespace) -> None:
    """Tracker and filter over the sample flight, 640x480 stereo, and OpenCV's optical flow on the same images."""
    settings = load_settings("", ["tuning.tracks.count=140", "tuning.filter.smooth=false"])
    source = recording(DATA / "sample", settings)
    if source is None:
        return
    events, stages = list(source.events()), settings.stages(source.imu_noise)
    cv2.setNumThreads(1)
    _in_turn(source.rig, stages, events)  # warm
    _say_in_turn(source.rig, stages, events)
    say(Row("frames a second, two threads by the clock, on this machine now", _threaded(source.rig, stages, events)))


def _in_turn(rig: Rig, stages: StageSettings, events: Sequence[Event]) -> tuple[dict[str, Meter], list[int]]:
    """One pass in turn: every exposure is followed by the yardstick, so that both have the same load of the machine."""
    lane, before, counts = FilterLane(rig, stages, history=False), list[U8](), list[int]()
    parts = {name: Meter() for name in ("rows", "tracking", "filter", "posterior", "yardstick")}
    posterior: Callable[[Navigation], object] = lambda n: n.posterior  # noqa: E731
    for e in events:
        batch = lane.batcher.take(e)
        if batch is None or batch.frame is None or batch.frame.images[0] is None:
            continue
        parts["rows"].on(lane.take_rows)(batch)
        tracked = parts["tracking"].on(lane.tracking.track)(batch)
        assert tracked is not None
        navigation = parts["filter"].on(lane.update)(tracked)
        if navigation is not None:
            parts["posterior"].on(posterior)(navigation)
        counts.append(len(tracked.tracks.ids))
        before.append(cv2.cvtColor(batch.frame.images[0], cv2.COLOR_RGB2GRAY))
        corners = cv2.goodFeaturesToTrack(before[0], 200, 1e-3, 25)
        parts["yardstick"].on(cv2.calcOpticalFlowPyrLK)(before[0], before[-1], corners, None)
        del before[:-1]
    return parts, counts


def _say_in_turn(rig: Rig, stages: StageSettings, events: Sequence[Event]) -> None:
    parts, counts = _in_turn(rig, stages, events)
    ms = {name: np.array(m.ms[_SKIPPED:]) for name, m in parts.items()}
    yard, both = float(ms["yardstick"].mean()), ms["tracking"] + ms["filter"]
    every = both + ms["rows"]
    say(
        Row(f"tracking and filter over the yardstick, {np.mean(counts):.0f} tracks", both.mean() / yard, 4.0, 2.5),
        Row("... tracking", ms["tracking"].mean() / yard),
        Row("... filter", ms["filter"].mean() / yard),
        Row("... GPS/INS and IMU rows that came since the exposure before", ms["rows"].mean() / yard),
        Row("... posterior of a keyframe, in the mapping lane", ms["posterior"].mean() / yard),
        Row("all of navigation, median", float(np.median(every)), unit="ms"),
        Row("... 95th percentile", float(np.percentile(every, 95)), unit="ms"),
        Row("... yardstick: cv2.calcOpticalFlowPyrLK of 200 points, 4 levels", yard, unit="ms"),
        Row("frames a second, in turn on one core, by CPU time", 1e3 / float(every.mean()), 30, 50, least=True),
    )


def _threaded(rig: Rig, stages: StageSettings, events: Sequence[Event]) -> float:
    """Frames a second in real time, with the two halves as in `alight.flight.live`."""
    predictions = Mailbox[MotionPredictor | None](4)
    lane = FilterLane(rig, stages, False, predictions)
    boxes = Mailbox[FrameBatch](2), Mailbox[Callable[[], object]](4)
    frames = list[int]()

    def tracking() -> None:
        with suppress(Closed):
            while True:
                batch = boxes[0].get()
                boxes[1].put(partial(lane.take_rows, batch))
                tracked = lane.tracking.track(batch)
                if tracked is not None:
                    frames.append(tracked.frame.t_ns)
                    boxes[1].put(partial(lane.update, tracked))
        boxes[1].close()
        predictions.close()

    def filtering() -> None:
        with suppress(Closed):
            while True:
                boxes[1].get()()

    threads = [Thread(target=f) for f in (tracking, filtering)]
    begin = time.perf_counter()
    for t in threads:
        t.start()
    for e in events:
        batch = lane.batcher.take(e)
        if batch is not None:
            boxes[0].put(batch)
    boxes[0].close()
    for t in threads:
        t.join()
    return len(frames) / (time.perf_counter() - begin)
