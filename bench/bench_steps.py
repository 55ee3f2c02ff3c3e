"""CPU of a keyframe of the recursive map over one StereoSGBM match of 640x480 px, 64 disparities, on the same machine.

    python bench/bench_steps.py

bench_heights.py prints the same rows. Speed of the hazards: bench_ground.py speed.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import numba
import numpy as np
from tables import Row, show

from alight.elevation import TiledElevation
from alight.geometry import Camera, Grid, Pose
from alight.parallax.recursive import RecursiveParallax
from alight.records import KeyframePosterior, Motion, View
from alight.settings import ParallaxSettings

HEIGHT = 40.0  # metres above flat ground
CAMERA = Camera(640, 480, 480.0, 480.0, 319.5, 239.5)
GRID = Grid(-16.0, 12.0, HEIGHT / 480.0, 288, 384)
VIEWS = 7
SPACING = 0.8  # metres between exposures, 2 % of the height
REPEATS = 12
POSE_SIGMA, OWN_SIGMA = np.repeat([0.05, np.radians(0.2)], 3), np.repeat([0.01, 3e-4], 3)  # all together; one by one
HELD = 8  # poses of a filter's posterior
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
    """A recursive map that flies on over flat ground, step by step."""

    def __init__(self, poses: int = 0) -> None:
        """Fly until all that is seen is known; poses are refined in a joint posterior of so many, 0: not refined."""
        self._ground, self._held, self._motions = texture(), poses, list[Motion]()
        self._ring = RecursiveParallax(ParallaxSettings(ring=VIEWS), GRID.cell, 0.0)
        self._map = TiledElevation(GRID.cell, 384)
        self._at = 0
        self._next = view(self._ground, 0, -12.0)
        for _ in range(2 * VIEWS + 8):
            self.step()
            self.advance()

    def advance(self) -> None:
        """Draw the next picture."""
        self._at += 1
        self._next = view(self._ground, self._at, -12.0 + SPACING * self._at)

    def window(self) -> Grid:
        """The 640 x 480 cells under the next picture."""
        east = round(self._next.centre[0] / GRID.cell) * GRID.cell
        return Grid(east - 319.5 * GRID.cell, 239.5 * GRID.cell, GRID.cell, 480, 640)

    def step(self) -> None:
        """One exposure, one step, its heights into the map."""
        grid = self.window()
        self._ring.push([self._next], *([self._posterior()] if self._held else []))
        found = self._ring.step(grid, self._map.read(grid), -1.5, 1.5)
        if self._held:
            self._map.add_plane(self._ring.alignment.plane, self._ring.alignment.about)
        for part in found:
            self._map.add(part, replace_all=True)

    def _posterior(self) -> KeyframePosterior:
        pose, common = self._next.world_from_cam, np.diag(POSE_SIGMA**2)
        self._motions = [*self._motions, Motion(self._next.t_ns, pose, (pose,), common)][-self._held :]
        n = len(self._motions)
        own = np.kron(np.eye(n), np.diag(OWN_SIGMA**2)) if n > 1 else 0.0
        return KeyframePosterior(tuple(self._motions), np.kron(np.ones((n, n)), common) + own)


@one_thread()
def keyframe_rows() -> list[Row]:
    """CPU of keyframes with 640x480 cells and 7 images, by turns with a pair of StereoSGBM."""
    ground, out = texture(), []
    matcher, pair = cv2.StereoSGBM_create(0, 64, 5), [view(ground, i, SPACING * i).image for i in range(2)]
    kinds = {"true poses": 0, "a filter's poses, refined": HELD, "each pose off by 5 cm and 0.2 deg, refined": 1}
    for name, poses in kinds.items():
        flight, whole = Flight(poses), []
        for _ in range(REPEATS):
            theirs = cpu(lambda: matcher.compute(*pair))
            whole.append(cpu(flight.step) / theirs)
            flight.advance()
        what = f"CPU of a keyframe over StereoSGBM(64), mean of a flight, {name}"
        out.append(Row(what, statistics.mean(whole), 0.6, 0.3))
    return out


def main() -> None:
    """Print the rows."""
    show(*keyframe_rows(), title="A keyframe")


if __name__ == "__main__":
    main()
