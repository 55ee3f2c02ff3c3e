"""Rows of speed: CPU time of the recursive step on 640 x 480 cells over StereoSGBM's in the same run, one thread each.

python bench/heights_step.py      # CPU time of the parts of a step
"""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numba
import numpy as np
from bench_steps import HEIGHT, texture, view
from heights_table import Row

from alight.elevation import TiledElevation
from alight.geometry import Grid
from alight.parallax import blocks, window
from alight.parallax import gauss_newton as refine
from alight.parallax import plane_sweep as sweep
from alight.parallax import recursive as ring
from alight.parallax import temporal_consistency as witness
from alight.parallax import uncertainty as trust
from alight.parallax import views as pictures
from alight.parallax.recursive import RecursiveParallax
from alight.parallax.views import Buffers, Prepared, prepare_view
from alight.records import ElevationMap, View
from alight.settings import ParallaxSettings

VIEWS = 7
CELL = HEIGHT / 480.0  # metres: a pixel of the camera
SPACING = 0.8  # metres between exposures, 2 % of the height
REPEATS = 12
PARTS = {  # functions that are timed separately, outer before inner
    "prepare the newest picture": (pictures, "prepare_view"),
    "which views see what": (refine, "view_geometry"),
    "what to do": (blocks.Blocks, "plan"),
    "sweeps of new cells, all of them": (ring, "sweep_unseen"),
    "... their cost": (sweep.kernels, "sweep_cost"),
    "... their aggregation": (sweep.kernels, "aggregate"),
    "rectangles, all of them": (window.Refiner, "refined"),
    "... rays that the map stops": (refine.Skyline, "visible"),
    "... Gauss-Newton": (refine, "gauss_newton"),
    "...... its samples": (refine, "stack"),
    "...... its normal equations": (refine.kernels, "normal_equations"),
    "...... its solution": (refine.kernels, "solve_window"),
    "...... its plane prior": (refine.visibility_kernels, "plane_prior"),
    "... sigma and flags": (trust, "judged"),
    "... fuse with the map": (window, "fused"),
    "... what moves": (witness, "moving"),
    "the map: read": (TiledElevation, "read"),
    "the map: add": (TiledElevation, "add"),
}


@contextmanager
def one_thread() -> Iterator[None]:
    """Use one thread: threads that wait for each other cost CPU as well, by an amount that depends on the machine."""
    before = cv2.getNumThreads(), numba.get_num_threads()
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before[0])
        numba.set_num_threads(before[1])


def cpu(work: Callable[[], object]) -> float:
    """CPU seconds of all threads."""
    start = time.process_time()
    work()
    return time.process_time() - start


class Flight:
    """A ring that flies on over flat ground, step by step."""

    def __init__(self) -> None:
        self._ground = texture()
        self._ring = RecursiveParallax(ParallaxSettings(ring=VIEWS), CELL, 0.0)
        self._map = TiledElevation(CELL, 384)
        self._at = 0
        self._next = view(self._ground, 0, -12.0)
        for _ in range(2 * VIEWS + 8):  # until the ring is full and all that it sees is known
            self.step()
            self.advance()

    def advance(self) -> None:
        """Draw the next picture."""
        self._at += 1
        self._next = view(self._ground, self._at, -12.0 + SPACING * self._at)

    def seen(self) -> tuple[list[View], Grid, ElevationMap]:
        """The last pictures, the window under the newest of them, and the map there."""
        views = [view(self._ground, i, -12.0 + SPACING * i) for i in range(self._at - VIEWS + 1, self._at + 1)]
        return views, self.window(), self._map.read(self.window())

    def window(self) -> Grid:
        """The 640 x 480 cells under the next picture."""
        east = round(self._next.centre[0] / CELL) * CELL
        return Grid(east - 319.5 * CELL, 239.5 * CELL, CELL, 480, 640)

    def step(self) -> None:
        """One exposure into the ring, one step, its heights into the map."""
        grid = self.window()
        self._ring.push([self._next])
        for part in self._ring.step(grid, self._map.read(grid), -1.5, 1.5):
            self._map.add(part, replace_all=True)


def one_step(kept: list[Prepared], newest: View, grid: Grid, known: ElevationMap, buffers: Buffers) -> None:
    """Parts of a step without the sweep of new cells and the map: preparation, Gauss-Newton, sigma, flags."""
    fine = [*kept, prepare_view(newest, CELL, 0.0)]
    seen = refine.view_geometry(fine, grid, known.height, 0.0)
    per_px = refine.enlarged(seen.metres_per_px, grid, refine.SEEN_BLOCK)
    t = ParallaxSettings()
    visible = refine.visible_from(fine, grid, known.height, per_px, t.refinement.occlusion_px)
    fit = refine.gauss_newton(fine, grid, known.height, per_px, visible, t.recursive.steps, t.refinement, buffers)
    ratio = np.full((grid.rows // 2, grid.cols // 2), t.recursive.unknown_ratio, np.float32)
    sampling = refine.enlarged(seen.sampling, grid, refine.SEEN_BLOCK)
    trust.judged(fine[-1:], grid, fit, ratio, (-1.5, 1.5), sampling, known.rgb, t.uncertainty)


def lone_step(flight: Flight) -> Callable[[], None]:
    """`one_step` at the present position of a flight, with all but the newest picture prepared."""
    views, grid, known = flight.seen()
    kept, buffers = [prepare_view(v, CELL, 0.0) for v in views[:-1]], Buffers()
    return lambda: one_step(kept, views[-1], grid, known, buffers)


@one_thread()
def rows() -> list[Row]:
    """Rows of a step alone, and of a whole keyframe; the pair of StereoSGBM by turns with each."""
    flight, ground = Flight(), texture()
    matcher, pair = cv2.StereoSGBM_create(0, 64, 5), [view(ground, i, SPACING * i).image for i in range(2)]
    step, alone, whole = lone_step(flight), [], []
    for _ in range(REPEATS):
        theirs = cpu(lambda: matcher.compute(*pair))
        alone.append(cpu(step) / theirs)
        whole.append(cpu(flight.step) / theirs)
        flight.advance()
    return [
        Row("CPU of a refinement of all cells (7 images, 640x480 cells, preparation and sigma) over StereoSGBM(64)",
            statistics.median(alone), 0.5, 0.25),
        Row("... all that a keyframe costs: a quarter of the cells refined, first looks, map, mean of a flight",
            statistics.mean(whole), 0.6, 0.3),
    ]  # fmt: skip


@one_thread()
def profile() -> None:
    """Print CPU time and share of each part of a step."""
    spent, flight = Counter[str](), Flight()

    def timed(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def run(*given: Any, **named: Any) -> Any:
            start = time.process_time()
            try:
                return work(*given, **named)
            finally:
                spent[name] += time.process_time() - start

        return run

    for name, (owner, attribute) in PARTS.items():
        setattr(owner, attribute, timed(name, getattr(owner, attribute)))
    whole = 0.0
    for _ in range(REPEATS):
        whole += cpu(flight.step)
        flight.advance()
    for name, seconds in {"one step": whole, **spent}.items():
        print(f"{name:36s} {1e3 * seconds / REPEATS:6.1f} ms {100 * seconds / whole:5.0f} %")


if __name__ == "__main__":
    profile()
