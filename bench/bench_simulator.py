"""The simulator against its requirements: speed, time to make a world, and a steered landing.

    python bench/bench_simulator.py

The yardstick is one StereoSGBM match (64 disparities) of the same pair in the same run, so that the ratio holds on
another machine and beside busy neighbours.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import cv2
import numba
import numpy as np
from tables import Row, at_least, show

import alight_sim as simulate
from alight.records import Frame
from alight_sim.flight import SimulatedFlight
from alight_sim.steered import SteeredFlight, Wanted

SCENE = "meadow"
PAIRS = 12
HEIGHTS = (20.0, 100.0)
SURVEY, HEIGHT, SPEED, SINK = 80.0, 40.0, 3.0, 1.1  # s, m, m/s, m/s: forth and back, then down to the ground
SETTLE, LONGEST = 3.0, 120.0  # s


def seconds(work: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def pair(flight: SimulatedFlight, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures of one exposure."""
    return flight.image(index, 0), flight.image(index, 1)


def speed(height: float) -> tuple[float, float, float]:
    """Stereo pairs a second (one sample a pixel, sun shadow), a pair over StereoSGBM, and its CPU seconds."""
    flight = simulate.fly(SCENE, 1, 4.0, height=height, speed=0.1 * height)
    left, right = (cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in pair(flight, 0))
    for k in range(0, flight.length, 4):
        pair(flight, k)  # the tiles under the way: a world is made once, a flight sees it many times
    busy = time.process_time()
    t = statistics.median(seconds(lambda k=k: pair(flight, k)) for k in range(1, PAIRS + 1))  # type: ignore[misc]
    busy = (time.process_time() - busy) / PAIRS
    sgbm = cv2.StereoSGBM_create(0, 64, 5)
    yardstick = statistics.median(seconds(lambda: sgbm.compute(left, right)) for _ in range(5))
    return 1.0 / t, t / yardstick, busy


def first_frame(seed: int, whole: bool) -> float:
    """Seconds from a seed to the first pair over a world of 200 x 200 m at 10 cm, with all tiles or the seen ones."""
    scene = simulate.read_scene(simulate.built_in()[SCENE])
    ground = scene.ground.model_copy(update={"size": (200.0, 200.0)})
    scene = scene.model_copy(update={"ground": ground})

    def work() -> None:
        flight = simulate.fly(scene, seed)
        if whole:
            flight.world.patch(flight.world.extent)
        pair(flight, 0)

    return seconds(work)


def wanted(seconds: float) -> Wanted:
    """Set-points of the flight."""
    if seconds < SURVEY:
        east = SPEED if int(seconds / 20.0) % 2 == 0 else -SPEED
        return Wanted(velocity=np.array([east, 0.3 * SPEED, 0.0]))
    return Wanted(velocity=np.array([0.0, 0.0, -SINK if seconds > SURVEY + SETTLE else 0.0]))


def landing(scene: str = SCENE) -> tuple[float, float]:
    """CPU seconds a stereo pair of 320x240 of a steered landing, and its ratio to StereoSGBM(64) of the pair."""
    start, pairs, matched, times = time.process_time(), 0, 0.0, 0
    flight = SteeredFlight(scene, 1, start=(-10.0, -30.0, HEIGHT), wind=(3.0, 1.0, 0.0))
    matcher = cv2.StereoSGBM_create(0, 64, 5)
    while flight.seconds < LONGEST and not flight.landed:
        for event in flight.step(0.1, wanted(flight.seconds)):
            if isinstance(event, Frame):
                pairs += 1
                if pairs % 20 == 0:
                    before = time.process_time()
                    matcher.compute(*(image for image in event.images if image is not None))
                    matched, times = matched + time.process_time() - before, times + 1
    used = (time.process_time() - start - matched) / pairs
    return used, used * times / matched


def main() -> None:
    """Print the table."""
    show(title=f"The simulator: {numba.get_num_threads()} threads, scene {SCENE}")
    simulate.fly(SCENE, 0, 1.0).image(0, 0)  # compiles
    for height in HEIGHTS:
        rate, ratio, busy = speed(height)
        show(
            Row(f"stereo pairs a second, 640x480, {height:.0f} m", rate, at_least(4.0), at_least(10.0)),
            Row("... a pair over one StereoSGBM(64) match of it", ratio),
            Row("... CPU time of a pair, ms", 1e3 * busy),
        )
    for whole, what in ((True, "every tile of it"), (False, "the tiles that are seen")):
        t = statistics.median(first_frame(100 + k, whole) for k in range(3))
        show(Row(f"200 x 200 m at 10 cm, from seed to first pair, {what}, s", t, 10.0, 4.0))
    busy, ratio = landing()
    show(
        Row("a landing of two minutes with all else: CPU of a pair of 320x240, ms", 1e3 * busy),
        Row("... over StereoSGBM(64) of it", ratio),
    )


if __name__ == "__main__":
    main()
