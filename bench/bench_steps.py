"""Time of a step, as a ratio to one StereoSGBM match of 640x480 px with 64 disparities on the same machine.

python bench/bench_steps.py
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

from alight.geometry import Camera, Grid, Pose
from alight.hazards import assess
from alight.parallax.batch import Images, match_tile
from alight.records import ElevationMap, Heights, View
from alight.settings import HazardsSettings, Lander, ParallaxSettings

HEIGHT = 40.0  # metres above flat ground
CAMERA = Camera(640, 480, 480.0, 480.0, 319.5, 239.5)
GRID = Grid(-16.0, 12.0, HEIGHT / 480.0, 288, 384)
LOOK_DOWN = np.diag([1.0, -1.0, -1.0])  # world from camera


def texture() -> np.ndarray:
    """Grey ground with detail at every scale, 2048x2048, one texel 4 cm."""
    rng = np.random.default_rng(1)
    scales = [
        cv2.resize(rng.normal(size=(n, n)), (2048, 2048), interpolation=cv2.INTER_CUBIC) for n in (32, 128, 512, 2048)
    ]
    total = sum(scales)
    return np.asarray(np.clip(128 + 28 * total, 0, 255), np.uint8)


def view(ground: np.ndarray, i: int, east: float) -> View:
    """View of a camera over (`east`, 0) of the flat ground."""
    u, v = np.meshgrid(np.arange(640, dtype=np.float32), np.arange(480, dtype=np.float32))
    metres = HEIGHT / 480.0
    x, y = (u - 319.5) * metres + east, (239.5 - v) * metres
    seen = cv2.remap(
        ground, (x / 0.04 + 1024).astype(np.float32), (1024 - y / 0.04).astype(np.float32), cv2.INTER_LINEAR
    )
    return View(i, 0, seen, CAMERA, Pose(LOOK_DOWN, np.array([east, 0.0, HEIGHT])))


def step(views: list[View]) -> Heights | None:
    """Match one tile in batch, the views' preparation included."""
    found = match_tile(Images(views, GRID.cell, 0.0), GRID, -1.5, 1.5, ParallaxSettings())
    return found.heights if found else None


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Median seconds of some runs after one that compiles and warms."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    """Print one line a step."""
    ground = texture()
    views = [view(ground, i, 0.8 * i - 4.4) for i in range(12)]
    sgbm = cv2.StereoSGBM_create(0, 64, 5)
    yardstick = seconds(lambda: sgbm.compute(views[1].image, views[0].image))
    heights = step(views)
    assert heights is not None
    fields = {k: getattr(heights, k) for k in ("height", "sigma", "flags", "views", "rgb", "residual", "sampling")}
    elevation = ElevationMap(GRID, **fields)
    steps = {
        "parallax, batch of 12 views": lambda: step(views),
        "hazards": lambda: assess(elevation, None, Lander(), HazardsSettings()),
    }
    print(f"{'StereoSGBM, 64 disparities':32s} {yardstick * 1e3:8.1f} ms   1.00")
    for name, work in steps.items():
        t = seconds(work)
        print(f"{name:32s} {t * 1e3:8.1f} ms {t / yardstick:6.2f}   {GRID.rows * GRID.cols / t / 1e6:.2f} Mcells/s")


if __name__ == "__main__":
    main()
