"""Looks from near by: the conditions for them, and the use of doubtful heights (docs/method/p-safe.md, G7f)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ground import covered, ground
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.hazards.evidence import NEAR_PIXELS, NEAR_SAMPLES, nearness
from alight.records import ElevationMap, Flag, HazardMap, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander

LIMIT = 0.15
MID = (40, 40)


def near(sampling: float, pixel: float) -> float:
    return float(nearness(np.full((1, 1), sampling, np.float32), np.full((1, 1), pixel, np.float32), LIMIT)[0, 0])


def test_a_footprint_is_seen_from_near_by_where_samples_and_pixels_both_are_fine() -> None:
    (sample, far_sample), (pixel, far_pixel) = (LIMIT * np.array(v) for v in (NEAR_SAMPLES, NEAR_PIXELS))
    assert near(0.9 * sample, 0.9 * pixel) == 1.0
    assert near(0.9 * sample, 1.01 * far_pixel) == near(1.01 * far_sample, 0.9 * pixel) == 0.0


def test_nearness_falls_with_the_pixel() -> None:
    shares = [near(0.01, p) for p in np.geomspace(0.02, 0.12, 30)]
    assert (np.diff(shares) <= 0).all()
    assert shares[0] == 1.0
    assert shares[-1] == 0.0
    assert_allclose(near(0.01, LIMIT * float(np.sqrt(np.prod(NEAR_PIXELS)))), 0.5, atol=1e-5)


def rough_ground(height: float) -> np.ndarray:
    """Heights (81, 81) in metres: bumps a decimetre wide, the largest of this height."""
    bumps = cv2.GaussianBlur(np.random.default_rng(3).normal(0, 1, (81, 81)).astype(np.float32), (0, 0), 3.0)
    return np.asarray(height / np.abs(bumps).max() * bumps)


def looked_at(
    height: np.ndarray,
    pixel: float,
    doubtful: np.ndarray | None = None,
    cover: TerrainMap | None = None,
    sampling: float | None = None,
) -> HazardMap:
    """Judge spotted ground with these heights and pixels of this size."""
    grey = ground(height, sigma=0.005, rgb=(150, 150, 150))
    n, sample = grey.grid.shape, 2 * pixel if sampling is None else sampling
    spots = cv2.GaussianBlur(np.random.default_rng(4).normal(0, 1, (2 * n[0], 2 * n[1])), (0, 0), 1.5)
    light = (150 * np.exp(0.2 / spots.std() * spots)).clip(0, 255).astype(np.uint8)
    e: ElevationMap = replace(
        grey, fine=np.repeat(light[..., None], 3, axis=2),
        sampling=np.full(n, sample, np.float32), fine_sampling=np.full(n, pixel, np.float32),
    )  # fmt: skip
    if doubtful is not None:
        flags = e.flags.copy()
        flags[doubtful] = Flag.UNSURE
        e = replace(e, flags=flags)
    return assess(e, cover, Lander(radius=1.0), HazardsSettings())


def plants(bears: float) -> TerrainMap:
    """Tall plants with this probability of bearing, whose class refuses nothing."""
    shape = (81, 81)
    return covered(ground(np.zeros(shape)), bears, Terrain.TALL_VEGETATION)


def test_even_ground_that_hardly_bears_is_no_site_from_near_by_and_a_footprint_of_half_a_chance_costs_nothing() -> None:
    ground_of = [looked_at(np.zeros((81, 81)), 0.02, cover=plants(p)).p_ground[MID] for p in (0.21, 0.35, 0.5, 0.9)]
    assert ground_of[0] < 0.6
    assert ground_of[0] < ground_of[1] < 0.95 < ground_of[2] <= ground_of[3]


@pytest.mark.parametrize(("bears", "low", "high"), [(0.9, 0.95, 1.0), (0.65, 0.7, 0.95), (0.5, 0.3, 0.8)])
def test_a_patch_that_bears_less_than_the_ground_about_it_is_in_doubt(bears: float, low: float, high: float) -> None:
    """A puddle of 1.2 m on asphalt, where the land cover is not sure."""
    cover = plants(0.98)
    assert cover.bears is not None
    rows, cols = np.indices((81, 81)) - 40
    cover.bears[np.hypot(rows, cols) * cover.grid.cell < 0.6] = bears
    p = looked_at(np.zeros((81, 81)), 0.02, cover=cover).p_ground[MID]
    assert low < p <= high


def test_ground_that_is_alike_all_over_is_no_patch() -> None:
    p = [looked_at(np.zeros((81, 81)), 0.02, cover=plants(b)).p_ground[MID] for b in (0.6, 0.9)]
    assert p[0] > 0.95
    assert p[1] > 0.95


def test_what_hardly_bears_all_over_counts_more_than_one_cell_of_it() -> None:
    one = plants(0.9)
    assert one.bears is not None
    one.bears[MID] = 0.21
    all_over, single = (looked_at(np.zeros((81, 81)), 0.02, cover=c).p_ground[MID] for c in (plants(0.21), one))
    assert single > 0.9 > all_over


def test_a_bump_of_fine_heights_counts_whatever_the_picture_shows() -> None:
    bump = np.zeros((81, 81))
    bump[MID] = 0.13
    fine, coarse = (looked_at(bump, pixel, sampling=0.04).p_obstacle[MID] for pixel in (0.02, 0.075))
    assert fine < 0.7
    assert coarse < 0.7


def test_level_ground_is_surer_from_near_by() -> None:
    p = [looked_at(np.zeros((81, 81)), pixel).p_safe[MID] for pixel in (0.02, 0.06, 0.1)]
    assert p[0] > p[1] > p[2]


@pytest.mark.parametrize("height", [0.15, 0.3])
def test_doubtful_heights_that_stand_up_cost_probability_from_near_by(height: float) -> None:
    """The heights of a tuft are in doubt, so that no limit uses them; but they were measured, and cost probability."""
    tuft = np.zeros((81, 81), np.bool_)
    tuft[38:43, 38:43] = True
    flat, tall = rough_ground(0.05), rough_ground(0.05)
    tall[39:42, 39:42] += height
    near, afar = (-np.log([looked_at(z, px, tuft).p_obstacle[MID] for z in (flat, tall)]) for px in (0.02, 0.1))
    assert near[1] > 1.5 * near[0]
    assert_allclose(afar[1], afar[0], rtol=0.01)


def test_the_same_bumps_cost_more_the_higher_they_are() -> None:
    """In the footprint the largest is half as high as on the map: 1 to 10 cm, and the lander allows 15."""
    p = [looked_at(rough_ground(h), 0.02).p_obstacle[MID] for h in (0.02, 0.05, 0.08, 0.11, 0.14, 0.17, 0.2)]
    assert (np.diff(p) <= 0).all()
    assert -np.log(p[-1]) > 3 * -np.log(p[0])


def test_a_measured_deviation_alone_is_enough_for_doubt() -> None:
    """Smooth grey ground, as under a cloudy sky, has no shadow and no spot; heights of the stone are doubtful."""
    stone = np.zeros((81, 81), np.bool_)
    stone[38:43, 38:43] = True
    p = []
    for rise in (0.0, 0.06, 0.13, 0.2):
        height = np.zeros((81, 81), np.float32)
        height[39:42, 39:42] = rise
        p.append(float(looked_at(height, 0.02, stone).p_obstacle[MID]))
    assert p[1] > 0.95
    assert p[2] < 0.75
    assert p[3] == pytest.approx(np.exp(-0.78), abs=0.02)
