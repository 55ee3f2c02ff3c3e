"""How fast tracker and filter are on two threads, as `alight.runner.live` runs them."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Thread
from typing import TypeVar

import cv2
import numpy as np
from motion_common import DATA, Row, recording, say

from alight.arrays import U8
from alight.motion.ekf.prediction import MotionPredictor
from alight.pipeline.navigation import FilterLane, FrameBatch, TrackedFrame
from alight.runner.live.mailbox import Closed, Mailbox
from alight.settings import load_settings

T = TypeVar("T")


class Meter:
    """Calls of a function, and the CPU time of its thread that each took."""

    def __init__(self) -> None:
        self.ms = list[float]()

    def on(self, call: Callable[..., T]) -> Callable[..., T]:
        """The same function, measured."""

        def measured(*given: object) -> T:
            begin = time.thread_time()
            out = call(*given)
            self.ms.append(1e3 * (time.thread_time() - begin))
            return out

        return measured


def part_speed(_: argparse.Namespace) -> None:
    """Tracker and filter on two threads over the sample flight, 640x480 stereo, by the CPU time of each thread.

    CPU time does not mind neighbours much; the yardstick tells how much. GPS/INS and IMU rows come 20 and 200 times a
    second whatever the frame rate: they are taken off the filter's second first.
    """
    settings = load_settings("", ["tuning.tracks.count=140", "tuning.filter.smooth=false"])
    source = recording(DATA / "sample", settings)
    if source is None:
        return
    events = list(source.events())
    cv2.setNumThreads(1)
    predictions = Mailbox[MotionPredictor | None](4)
    lane = FilterLane(source.rig, settings.stages(source.imu_noise), False, predictions)
    track, see, hear = Meter(), Meter(), Meter()
    counts, flow, before = list[int](), Meter(), list[U8]()
    boxes = Mailbox[FrameBatch](2), Mailbox[Callable[[], object]](4)

    def yardstick(tracked: TrackedFrame) -> None:
        """What OpenCV takes on the same thread at the same time."""
        counts.append(len(tracked.tracks.ids))
        if tracked.frame.images[0] is not None:
            before.append(cv2.cvtColor(tracked.frame.images[0], cv2.COLOR_RGB2GRAY))
            corners = cv2.goodFeaturesToTrack(before[0], 200, 1e-3, 25)
            flow.on(cv2.calcOpticalFlowPyrLK)(before[0], before[-1], corners, None)
            del before[:-1]

    def tracking() -> None:
        run = track.on(lane.track)
        with suppress(Closed):
            while True:
                batch = boxes[0].get()
                boxes[1].put(partial(hear.on(lane.hear), batch))
                tracked = run(batch)
                if tracked is not None:
                    yardstick(tracked)
                    boxes[1].put(partial(see.on(lane.update), tracked))
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
        batch = lane.batch(e)
        if batch is not None:
            boxes[0].put(batch)
    boxes[0].close()
    for t in threads:
        t.join()
    frames = len(counts)
    wall, yard = frames / (time.perf_counter() - begin), float(np.median(flow.ms))
    a, b, left = float(np.median(track.ms)), float(np.mean(see.ms)), 1.0 - sum(hear.ms) / (100.0 * frames)
    name = f"frames a second, {np.mean(counts):.0f} tracks:"
    say(
        Row(f"{name} two threads, the slower one by its CPU time", min(1e3 / a, 1e3 * left / b), 50, 100, least=True),
        Row(f"{name} in turn on one core", 1e3 * left / (a + b)),
        Row(f"{name} two threads by the clock, on this machine now", wall),
        Row("... tracking a frame", a, unit="ms"),
        Row("... filter a frame", b, unit="ms"),
        Row("... GPS/INS and IMU rows a second", 1e3 * (1.0 - left), unit="ms"),
        Row("... yardstick: cv2.calcOpticalFlowPyrLK of 200 points, 4 levels", yard, unit="ms"),
        Row("... tracking a frame over the yardstick", a / yard),
        Row("... filter a frame over the yardstick", b / yard),
    )
