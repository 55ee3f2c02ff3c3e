"""Looks from near by: when they count, and what doubtful heights tell (docs/method/p-safe.md, G7f)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ground import ground
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.hazards.evidence import FAR_PIXEL, FAR_SAMPLING, NEAR_PIXEL, NEAR_SAMPLING, nearness
from alight.records import ElevationMap, Flag, HazardMap
from alight.settings import HazardsSettings, Lander

LIMIT = 0.15
MID = (40, 40)


def near(sampling: float, pixel: float) -> float:
    return float(nearness(np.full((1, 1), sampling, np.float32), np.full((1, 1), pixel, np.float32), LIMIT)[0, 0])


def test_a_footprint_is_seen_from_near_by_where_samples_and_pixels_both_are_fine() -> None:
    fine, coarse = (0.9 * NEAR_SAMPLING * LIMIT, 0.9 * NEAR_PIXEL * LIMIT), (FAR_SAMPLING * LIMIT, FAR_PIXEL * LIMIT)
    assert near(*fine) == 1.0
    assert near(fine[0], 1.01 * coarse[1]) == near(1.01 * coarse[0], fine[1]) == 0.0


def test_nearness_falls_with_the_pixel() -> None:
    shares = [near(0.01, p) for p in np.geomspace(0.02, 0.12, 30)]
    assert (np.diff(shares) <= 0).all()
    assert shares[0] == 1.0
    assert shares[-1] == 0.0
    assert_allclose(near(0.01, LIMIT * float(np.sqrt(NEAR_PIXEL * FAR_PIXEL))), 0.5, atol=1e-5)


def looked_at(height: np.ndarray, pixel: float, doubtful: np.ndarray | None = None) -> HazardMap:
    grey = ground(height, sigma=0.005, rgb=(150, 150, 150))
    n = grey.grid.shape
    e: ElevationMap = replace(
        grey, fine=np.full((2 * n[0], 2 * n[1], 3), 150, np.uint8),
        sampling=np.full(n, 2 * pixel, np.float32), fine_sampling=np.full(n, pixel, np.float32),
    )  # fmt: skip
    if doubtful is not None:
        flags = e.flags.copy()
        flags[doubtful] = Flag.UNSURE
        e = replace(e, flags=flags)
    return assess(e, None, Lander(radius=1.0), HazardsSettings())


def test_level_ground_is_surer_from_near_by() -> None:
    p = [looked_at(np.zeros((81, 81)), pixel).p_safe[MID] for pixel in (0.02, 0.06, 0.1)]
    assert p[0] > p[1] > p[2]


@pytest.mark.parametrize("height", [0.12, 0.3])
def test_doubtful_heights_that_stand_up_cost_probability_from_near_by(height: float) -> None:
    """A tuft: its heights are in doubt, so that no limit counts them, and yet they were measured."""
    z, tuft = np.zeros((81, 81)), np.zeros((81, 81), np.bool_)
    tuft[38:43, 38:43] = True
    z[39:42, 39:42] = height
    lower = looked_at(np.zeros((81, 81)), 0.02, tuft).p_obstacle[MID]
    assert looked_at(z, 0.02, tuft).p_obstacle[MID] < lower - 0.02
    assert_allclose(looked_at(z, 0.1, tuft).p_obstacle[MID], looked_at(np.zeros((81, 81)), 0.1, tuft).p_obstacle[MID])


def test_the_same_bumps_cost_more_the_higher_they_are() -> None:
    rng = np.random.default_rng(3)
    bumps = cv2.GaussianBlur(rng.normal(0, 1, (81, 81)).astype(np.float32), (0, 0), 3.0)
    bumps /= np.abs(bumps).max()
    p = [looked_at(h * bumps, 0.02).p_obstacle[MID] for h in (0.02, 0.05, 0.08, 0.11)]
    assert (np.diff(p) < 0).all()
