"""Hazard judgement: hazard terrains with truth, and speed. Flights: bench/ground_domains.py.

Run: python bench/bench_ground.py               (hazards and speed)
     python bench/bench_ground.py hazards [--data ../shared/data/hazard-contest]
     python bench/bench_ground.py speed
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.hazards import assess
from alight.hazards.sharpen import sharpen
from alight.landing.sites import Observer, choose_sites
from alight.pipeline.judging import find_land_cover
from alight.records import ElevationMap, HazardMap
from alight.settings import HazardsSettings, Lander, Settings
from alight.settings.tuning.hazards import SharpenTuning
from alight.sources.appearance import read_model

CELL = 0.2  # metres, dem.raw
RIM = 21  # pixels at the rim that the truth calls unsafe: rows 0 to 20 and the last 21
BEYOND = 8  # pixels by which the ground is continued, so that feet at the rim stand on something

# The rule in the data's README, every heading; its open points are settled by comparison with the truth: plate and feet
# a pixel further out than half of 3.4 m (terrain 1: single rocks), planes on which the lander rests, a foot on the mean
# of the ground 0.4 m about it (terrain 3: slopes). The same program made every terrain of the contest.
RING = 1.8
CONTEST = Lander(
    radius=1.83,
    feet=((RING, 0.0), (0.0, RING), (-RING, 0.0), (0.0, -RING)),
    foot_radius=0.4,
    foot_contact="mean",
    headings=72,
    belly_clearance=0.39,
    max_slope=math.radians(10.0),
)
# one survey: no tilt beyond the uncertainty of its pixels, and no smoothing
SURVEY = HazardsSettings(tilt_sigma=0.001, noise_length=0.2, bridge=0.0, smoothed=False)

Pixels = NDArray[np.uint8]


def read_terrain(folder: Path) -> tuple[ElevationMap, Pixels, NDArray[np.bool_]]:
    """The coarse heights as a map, the image, and the mask of truly safe touchdowns."""
    dem = np.fromfile(folder / "dem.raw", ">f4").reshape(500, 500).astype(np.float32)
    image, safe = (np.asarray(cv2.imread(str(folder / n), cv2.IMREAD_GRAYSCALE)) for n in ("image.pgm", "safe.pgm"))
    return as_map(dem, CELL, np.full(dem.shape, 0.001, np.float32)), image, safe > 0


def as_map(height: NDArray[np.float32], cell: float, sigma: NDArray[np.float32]) -> ElevationMap:
    """Make a map of heights, all of them seen."""
    none = np.zeros(height.shape, np.float32)
    grey = np.full((*height.shape, 3), 128, np.uint8)
    grid = Grid(0.0, cell * (height.shape[0] - 1), cell, *height.shape)
    return ElevationMap(grid, height, sigma, none.astype(np.uint16), none.astype(np.uint8) + 9, grey, none, none + cell)


def judge(fine: ElevationMap, settings: HazardsSettings = SURVEY) -> tuple[HazardMap, slice]:
    """The hazard map of a map continued beyond its rim, and the slice of the map itself in it."""
    height, sigma = (np.pad(a, BEYOND, mode="edge") for a in (fine.height, fine.sigma))
    return assess(as_map(height, fine.grid.cell, sigma), None, CONTEST, settings), slice(BEYOND, -BEYOND)


def scores(p: NDArray[np.float32], least: float, truth: NDArray[np.bool_]) -> str:
    """Accuracy, false share of the declared safe cells, missed share of the truly safe cells, in percent."""
    said = p >= least
    said[:RIM] = said[-RIM:] = said[:, :RIM] = said[:, -RIM:] = False
    wrong, missed = (said & ~truth).sum() / max(said.sum(), 1), (truth & ~said).sum() / truth.sum()
    return f"accuracy {100 * (said == truth).mean():6.2f}  false {100 * wrong:5.2f}  missed {100 * missed:5.2f}"


def hazards(data: Path) -> None:
    """Judge the contest terrains from dem.raw and image.pgm alone."""
    for folder in sorted(p for p in data.iterdir() if (p / "dem.raw").exists()):
        coarse, image, truth = read_terrain(folder)
        start = time.perf_counter()
        fine = sharpen(coarse, image, SharpenTuning())
        seconds = time.perf_counter() - start
        assert fine is not None
        found, inner = judge(fine)
        p = np.nan_to_num(found.p_safe[inner, inner])
        print(f"{folder.name}: sharpened in {seconds:.1f} s, {100 * truth.mean():.1f} % safe in truth")
        for least in (0.5, 0.9, 0.99):
            print(f"  P >= {least:<5} {scores(p, least, truth)}")


def rolling(cells: int) -> ElevationMap:
    """Rolling ground with 400 rocks on 0.1 m cells, with a picture on pixels of half that."""
    rng = np.random.default_rng(0)
    z = 8 * cv2.GaussianBlur(rng.normal(0, 1, (cells, cells)), (0, 0), 30) + rng.normal(0, 0.01, (cells, cells))
    for row, col in rng.integers(0, cells, (400, 2)):
        cv2.circle(z, (int(col), int(row)), int(rng.integers(1, 5)), float(z[row, col] + rng.uniform(0.1, 0.5)), -1)
    return as_map(z.astype(np.float32), 0.1, np.full(z.shape, 0.02, np.float32))


def speed(cells: int = 600) -> None:
    """CPU of the whole verdict of 60 x 60 m: land cover, hazards, sites; and over StereoSGBM(64) of 640 x 480."""
    e, s, model = rolling(cells), Settings().stages(), read_model()
    rng = np.random.default_rng(1)
    grey = cv2.GaussianBlur(rng.normal(120, 60, (2 * cells, 2 * cells)), (0, 0), 1.5).clip(1, 255).astype(np.uint8)
    fine = np.repeat(grey[..., None], 3, axis=2)
    fine[..., 0] //= 2
    e = replace(
        e, rgb=np.ascontiguousarray(fine[::2, ::2]), fine=fine, fine_sampling=np.full(e.grid.shape, 0.05, np.float32)
    )
    above = Observer(np.array([e.grid.east, e.grid.north, 40.0]), 40.0, 480.0, True)
    pair = [np.ascontiguousarray(grey[:480, k : k + 640]) for k in (20, 0)]
    matcher = cv2.StereoSGBM_create(0, 64, 5)

    def once() -> tuple[float, float, float, float]:
        at = [time.process_time()]
        cover = find_land_cover(e, s.terrain, model)
        at.append(time.process_time())
        danger = assess(e, cover, s.lander, s.hazards)
        at.append(time.process_time())
        choose_sites(danger, cover, e, s.sites, s.lander, above)
        at.append(time.process_time())
        matcher.compute(*pair)
        at.append(time.process_time())
        return tuple(np.diff(at))  # type: ignore[return-value]

    once()  # compile
    took = np.median([once() for _ in range(7)], axis=0)
    parts = ", ".join(f"{n} {t:.2f}" for n, t in zip(("land cover", "hazards", "sites"), took, strict=False))
    print(f"verdict of {cells / 10:g} x {cells / 10:g} m: {took[:3].sum():.2f} s of CPU ({parts}), "
          f"{took[:3].sum() / took[3]:.1f} x StereoSGBM(64) of 640 x 480")  # fmt: skip


def main() -> None:
    """Run one part of the benchmark, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="all", choices=["all", "hazards", "speed"])
    parser.add_argument("--data", type=Path, default=Path("../shared/data/hazard-contest"))
    arguments = parser.parse_args()
    if arguments.part in ("all", "hazards") and arguments.data.is_dir():
        hazards(arguments.data)
    if arguments.part in ("all", "speed"):
        speed()


if __name__ == "__main__":
    main()
