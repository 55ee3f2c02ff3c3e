"""Probability of detection: curves, the share that stays unseen, and the pixel that settles a doubt."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from alight.hazards.detection import LARGEST, STEEP, WIDE, Detection, read_detection
from alight.hazards.factors import PIXELS_A_SAMPLE, SETTLED, pixel_that_settles
from alight.settings import HazardsSettings, Lander

SIZES = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
CURVES = Detection(SIZES, np.array([0.0, 0.1, 0.5, 0.9, 1.0]), np.array([0.0, 0.3, 0.8, 1.0, 1.0]))


def test_an_obstacle_is_missed_where_neither_heights_nor_pixels_show_it() -> None:
    missed = CURVES.missed(np.array([0.4]), np.array([0.1]), np.array([0.2]))
    assert_allclose(missed, (1 - 0.5) * (1 - 0.3))


def test_the_unseen_share_is_the_integral_over_the_sizes() -> None:
    """The share agrees with plain sums over a fine grid of widths, weighted by the frequency of each."""
    limit, g, p = 0.15, 0.12, 0.06
    width = np.linspace(WIDE * limit, LARGEST * WIDE * limit, 20001)
    weight = width**-STEEP
    want = np.average(CURVES.missed(width, np.array(g), np.array(p)), weights=weight)
    got = CURVES.unseen_share(limit, np.array([[g]], np.float32), np.array([[p]], np.float32))
    assert_allclose(got, want, atol=0.02)


def test_the_curves_of_the_package_rise_from_0_to_1() -> None:
    curves = read_detection()
    for curve in (curves.heights, curves.pixels):
        assert curve.shape == curves.sizes.shape
        assert (np.diff(curve) >= 0).all()
        assert curve[0] >= 0
        assert curve[-1] <= 1


def test_coarser_pictures_leave_more_unseen() -> None:
    curves = read_detection()
    g = np.geomspace(0.01, 1.0, 40).astype(np.float32)[None]
    unseen = curves.unseen_share(0.15, 2 * g, g)[0]
    assert (np.diff(unseen) >= -1e-6).all()
    assert unseen[0] < 0.05
    assert unseen[-1] > 0.5


def test_nothing_known_of_the_sampling_leaves_all_unseen_that_can_be() -> None:
    nothing = np.full((1, 1), np.nan, np.float32)
    assert CURVES.unseen_share(0.15, nothing, nothing) > 0.9


def test_the_smallest_obstacle_found_grows_with_the_pixel() -> None:
    one, two = (CURVES.smallest_found(0.95, np.full(1, g, np.float32), np.full(1, g, np.float32)) for g in (0.02, 0.04))
    assert_allclose(two, 2 * one, rtol=1e-5)
    widths = np.linspace(0.02, 0.3, 20001)  # by plain search
    missed = CURVES.missed(widths, np.array(0.02), np.array(0.02))
    assert_allclose(one, widths[np.argmax(missed <= 0.05)] / WIDE, rtol=0.03)


@pytest.mark.parametrize("limit", [0.05, 0.15, 0.3])
def test_the_pixel_that_settles_is_the_largest_with_which_quiet_ground_is_sure_enough(limit: float) -> None:
    lander, settings, curves = Lander(max_roughness=limit), HazardsSettings(), read_detection()
    pixel = pixel_that_settles(curves, lander, settings)
    area = math.pi * lander.radius**2

    def expected(at: float) -> float:
        g = np.full((1, 1), at, np.float32)
        return float(area * settings.unseen_bare * curves.unseen_share(limit, np.float32(PIXELS_A_SAMPLE) * g, g)[0, 0])

    assert expected(pixel) <= -SETTLED * math.log(settings.p_safe) < expected(1.3 * pixel)
    assert 0.05 < pixel / limit < 1.0


def test_without_a_least_probability_any_pixel_settles() -> None:
    settings = HazardsSettings(p_safe=0.0)
    assert pixel_that_settles(read_detection(), Lander(), settings) == pytest.approx(2.0 * Lander().max_roughness)
