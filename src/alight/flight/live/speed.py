"""Speed of this computer: the lanes of a flight over drawn ground, before the flight."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import NamedTuple

import numpy as np

from alight.arrays import F64, U8
from alight.flight.executive.table import JUDGE_EVERY
from alight.flight.live.health import POSE, STEP
from alight.flight.live.lane_process import LaneLost
from alight.flight.live.live import JUDGING, MAPPING, Live, LiveOptions
from alight.flight.live.run import for_flight
from alight.parallax.views import on_level
from alight.pipeline import FlightPolicy
from alight.records import Frame, NavSample, Rig, RigCamera
from alight.records.executive import FlightState, Need
from alight.runs import appearance_of
from alight.settings import Settings

LASTS = 20.0  # s, longest measurement; two verdicts end it


class Speed(NamedTuple):
    """Median times of the lanes, s; NaN: none was measured in `LASTS` seconds."""

    frame: float  # from an exposure to its pose
    step: float  # of the map
    verdict: float


@contextmanager
def measuring_speed(rig: Rig, settings: Settings, rate: float) -> Iterator[Future[Speed]]:
    """Measure the speed of this computer meanwhile, at most until the end of the context; see `measure_speed`."""
    over = threading.Event()
    with ThreadPoolExecutor(1) as meanwhile:
        try:
            yield meanwhile.submit(measure_speed, rig, settings, rate, over.is_set)
        finally:
            over.set()


def measure_speed(rig: Rig, settings: Settings, rate: float, is_over: Callable[[], bool] = lambda: False) -> Speed:
    """Return the times of the lanes on this computer, as it is loaded now, with the verdicts that a landing needs.

    Args:
        rig, settings: of the flight.
        rate: exposures per second.
        is_over: returns whether to stop before two verdicts have come.
    """
    policy = FlightPolicy(every=0)
    policy.need = Need(JUDGE_EVERY[FlightState.COMMIT])
    live = Live(rig, for_flight(settings), LiveOptions(policy=policy, appearance=appearance_of(settings)))
    timings = live.watch.timings.stages
    try:
        live.wait_until_ready()
        with suppress(LaneLost):  # a lane that does not start has no time
            live.lanes[MAPPING].wait_until_ready()
            live.lanes[JUDGING].wait_until_ready()
        begin = time.monotonic()
        for due, (row, frame) in enumerate(_flight(rig, settings, rate)):
            live.feed(row)
            live.feed(frame)
            time.sleep(max(begin + due / rate - time.monotonic(), 0.0))
            if is_over() or time.monotonic() - begin > LASTS or len(timings.get("verdict", ())) > 1:
                break
    finally:
        live.close()
    return Speed(*(statistics.median_low(timings.get(name, [np.nan])) for name in (POSE, STEP, "verdict")))


def _flight(rig: Rig, settings: Settings, rate: float) -> Iterator[tuple[NavSample, Frame]]:
    """Yield exposures of level flight at the height of the search above flat ground of blotches."""
    height, speed = settings.executive.search_height, settings.executive.search_speed
    blotches = np.random.default_rng(0).integers(0, 256, (512, 512), np.uint8)
    grounds = [_ground(c, height) for c in rig.cameras]
    for k in range(int(LASTS * rate) + 1):
        flown = np.array([k * speed / rate, 0.0, 0.0])
        t_ns = round(k * 1e9 / rate)
        sigma = np.full(3, 0.5)
        row = NavSample(t_ns, flown, np.eye(3), np.array([speed, 0.0, 0.0]), np.zeros(3), sigma, sigma / 50, sigma / 5)
        yield row, Frame(t_ns, tuple(_picture(blotches, g + flown[:2], height) for g in grounds))


def _ground(camera: RigCamera, height: float) -> F64:
    """Return where each pixel sees level ground, (H, W, 2) metres from the body; see `on_level` for flat rays."""
    c, (R, offset) = camera.camera, (camera.body_from_cam.rotation, camera.body_from_cam.translation)
    pixels = np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), axis=-1).reshape(-1, 2)
    return on_level(np.asarray(c.rays(pixels)) @ R.T, offset, -height).reshape(c.height, c.width, 2)


def _picture(blotches: U8, at: F64, height: float) -> U8:
    cell = height / 200  # m, some pixels
    index = (at / cell).astype(np.int64) % len(blotches)
    return np.ascontiguousarray(blotches[index[..., 1], index[..., 0]])
