"""Rows of speed: CPU time of the recursive step on 640 x 480 cells over that of StereoSGBM in the same run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import cv2
from bench_steps import HEIGHT, texture, view
from heights_table import Row

from alight.elevation import Elevation
from alight.geometry import Grid
from alight.parallax import Ring
from alight.settings import Parallax

VIEWS = 7
CELL = HEIGHT / 480.0  # metres: a pixel of the camera
SPACING = 0.8  # metres between exposures, 2 % of the height
REPEATS = 12


def cpu(work: Callable[[], object]) -> float:
    """CPU seconds of all threads."""
    start = time.process_time()
    work()
    return time.process_time() - start


class Flight:
    """A ring that flies on over flat ground, step by step."""

    def __init__(self) -> None:
        self._ground = texture()
        self._ring = Ring(Parallax(ring=VIEWS), CELL, 0.0)
        self._map = Elevation(CELL, 384)
        self._at = 0
        self._next = view(self._ground, 0, -12.0)
        for _ in range(2 * VIEWS + 8):  # until the ring is full and all that it sees is known
            self.step()
            self.advance()

    def advance(self) -> None:
        """Draw the next picture."""
        self._at += 1
        self._next = view(self._ground, self._at, -12.0 + SPACING * self._at)

    def step(self) -> None:
        """One exposure into the ring, one step, its heights into the map."""
        east = round(self._next.centre[0] / CELL) * CELL
        grid = Grid(east - 319.5 * CELL, 239.5 * CELL, CELL, 480, 640)
        self._ring.push([self._next])
        found = self._ring.step(grid, self._map.read(grid), -1.5, 1.5)
        if found is not None:
            self._map.add(found, replace_all=True)


def rows() -> list[Row]:
    """One step, preparation, sigma, flags and map included; the pair by turns with it."""
    cv2.setNumThreads(1)
    flight, ground = Flight(), texture()
    matcher, pair = cv2.StereoSGBM_create(0, 64, 5), [view(ground, i, SPACING * i).image for i in range(2)]
    ratios, steps = [], []
    for _ in range(REPEATS):
        theirs = cpu(lambda: matcher.compute(*pair))
        ours = cpu(flight.step)
        flight.advance()
        ratios.append(ours / theirs)
        steps.append(ours)
    name = f"CPU of a step (7 images, 640x480 cells; {1e3 * statistics.median(steps):.0f} ms) over StereoSGBM(64)"
    return [Row(name, statistics.median(ratios), 0.5, 0.25)]
