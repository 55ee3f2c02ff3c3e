"""The simulator against its requirements: speed, time to make a world, geometry, reproducibility.

    python bench/bench_simulator.py            # `make bench-simulator` goes on to the realism table

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
from exactness import LENSES, errors

import alight_sim as simulate
from alight_sim.flight import SimulatedFlight

SCENE = "meadow"
PAIRS = 12
HEIGHTS = (20.0, 100.0)


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


def same(threads: int) -> bytes:
    """The bytes of a short flight's truth and pictures, drawn by some threads."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    try:
        flight = simulate.fly(SCENE, 5, 1.0, height=30.0)
        parts = [flight.truth.height, flight.truth.label, *pair(flight, 3), *pair(flight, 0)]
        return b"".join(np.ascontiguousarray(p).tobytes() for p in parts)
    finally:
        numba.set_num_threads(before)


def show(what: str, must: str, aim: str, got: str, well: bool) -> None:
    """Print one row of the table."""
    print(f"| {what} | {must} | {aim} | {got if well else f'**{got}**'} |", flush=True)


def main() -> None:
    """Print the table."""
    print(f"\n### The simulator: {numba.get_num_threads()} threads, scene {SCENE}\n")
    print("| | must | aim | got |\n| --- | --- | --- | --- |")
    simulate.fly(SCENE, 0, 1.0).image(0, 0)  # compiles
    for height in HEIGHTS:
        rate, ratio, busy = speed(height)
        show(f"stereo pairs a second, 640x480, {height:.0f} m", "4", "10", f"{rate:.1f}", rate >= 4)
        show("... a pair over one StereoSGBM(64) match of it", "", "", f"{ratio:.2f}", True)
        show("... CPU time of a pair, ms", "", "", f"{1e3 * busy:.0f}", True)
    for whole, what in ((True, "every tile of it"), (False, "the tiles that are seen")):
        t = statistics.median(first_frame(100 + k, whole) for k in range(3))
        show(f"200 x 200 m at 10 cm, from seed to first pair, {what}, s", "10", "4", f"{t:.2f}", t <= 10)
    for lens, px in ((name, errors(lens)) for name, lens in LENSES.items()):
        got = ", ".join(f"{k} {v:.5f}" for k, v in px.items())
        show(f"geometry through a lens `{lens}`, largest error, px", "0.02", "0.005", got, max(px.values()) <= 0.02)
    equal = same(1) == same(numba.get_num_threads())
    show("same seed, 1 and 2 threads, fresh worlds", "bit-equal", "", "bit-equal" if equal else "DIFFERS", equal)


if __name__ == "__main__":
    main()
