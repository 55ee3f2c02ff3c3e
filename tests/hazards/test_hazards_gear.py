"""Gear whose contacts are hardly separated by cells, and a belly with and without gear."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ground import covered, ground, plane, textured
from numpy.testing import assert_allclose
from scipy.special import ndtr

from alight.hazards import assess
from alight.hazards.gear import feet_of, is_coarse
from alight.hazards.touchdown import measured_height, usable_height
from alight.records import Flag, Hazard, HazardMap, Terrain
from alight.settings import HazardsSettings, Lander

EXACT, MATCHED = HazardsSettings(tilt_sigma=0.0, smoothed=False), HazardsSettings()
STEEP = math.radians(30.0)


def square(half: float) -> tuple[tuple[float, float], ...]:
    return ((half, half), (half, -half), (-half, half), (-half, -half))


def on_a_slope(lander: Lander, angle: float, cell: float) -> HazardMap:
    z = plane(41, 41, math.tan(angle), 0.0, cell)
    return assess(ground(z, cell=cell, sigma=0.03), None, lander, EXACT)


@pytest.mark.parametrize(
    ("gear", "radius", "cell"),
    [
        ({"skids": (0.8, 0.6)}, 1.5, 1.0), ({"skids": (4.0, 0.6)}, 2.5, 1.0), ({"skids": (0.8, 4.0)}, 2.5, 1.0),
        ({"skids": (2.9, 2.9), "headings": 1}, 2.5, 1.0), ({"skids": (0.14, 0.12)}, 0.3, 0.2),
        ({"feet": square(0.4)}, 1.5, 1.0), ({"feet": square(0.3)}, 1.5, 1.0), ({"feet": square(0.1)}, 0.3, 0.2),
        ({"feet": square(0.4), "support": "any"}, 1.5, 1.0), ({"feet": ((0.4, 0), (-0.3, 1), (-0.3, -1))}, 2.5, 1.0),
        ({"feet": square(0.4), "foot_contact": "mean", "headings": 1}, 1.5, 1.0),
    ],
)  # fmt: skip
def test_gear_smaller_than_cells_is_never_levelled_by_them(gear: dict[str, object], radius: float, cell: float) -> None:
    lander = Lander(radius=radius, **gear)  # type: ignore[arg-type]
    assert is_coarse(lander, cell)
    h = on_a_slope(lander, STEEP, cell)
    assert Hazard.SLOPE in Hazard(int(h.reasons[20, 20]))
    assert h.slope[20, 20] >= STEEP - 1e-3
    assert not (h.reasons == 0).any()
    level = on_a_slope(lander, 0.0, cell)
    assert_allclose(level.slope[20, 20], 0.0, atol=1e-5)
    assert level.reasons[20, 20] in (0, int(Hazard.DOUBT))


def test_gear_that_cells_tell_apart_bridges_what_the_footprint_does_not() -> None:
    """A hollow between the feet tilts the footprint's plane, but not the lander."""
    lander, z = Lander(radius=0.9, feet=square(0.6), max_roughness=1.0), np.zeros((81, 81))
    z[36:45, 42:46] = -0.8
    assert not is_coarse(lander, 0.1)
    h = assess(ground(z, cell=0.1), None, lander, EXACT)
    assert_allclose(h.slope[40, 40], 0.0, atol=1e-5)


@pytest.mark.parametrize("cell", [0.01, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 1.0, 50.0])
@pytest.mark.parametrize("feet", [square(0.08), square(0.15), ((0.3, 0.0), (-0.2, 0.01), (-0.2, -0.3))])
def test_planes_of_feet_are_finite_on_any_cells(feet: tuple[tuple[float, float], ...], cell: float) -> None:
    found = feet_of(Lander(radius=0.4, feet=feet), cell)
    assert np.isfinite(found.solve).all()
    heights = found.xy[:, found.triples] @ [0.2, -0.1] + 3.0  # (headings, t, 3) of a plane
    planes = np.einsum("htij,htj->hti", found.solve, heights)
    assert_allclose(planes, np.broadcast_to([3.0, 0.2, -0.1], planes.shape), atol=1e-6)


def test_a_belly_counts_only_above_gear() -> None:
    """Without gear the roughness limit holds, and obstacles lower than the belly have to be found."""
    bare, named = Lander(), Lander(belly_clearance=1.0)
    assert named.tallest_obstacle == bare.tallest_obstacle == 0.15
    assert named.judging_cell == bare.judging_cell
    assert Lander(belly_clearance=0.4, skids=(1.2, 1.0)).tallest_obstacle == 0.4
    e = ground(np.random.default_rng(1).normal(0, 0.003, (81, 81)), sigma=0.02)
    e = replace(e, sampling=np.full((81, 81), 0.4, np.float32), fine_sampling=np.full((81, 81), 0.25, np.float32))
    a, b = (assess(e, covered(e, 0.999), k, MATCHED) for k in (bare, named))
    assert_allclose(a.p_safe, b.p_safe)
    assert (a.reasons == b.reasons).all()


def test_the_margin_of_the_belly_is_in_the_probability_of_matched_heights() -> None:
    """A mesa of 0.39 m under a belly at 0.4 m is about as likely safe as not, as for exact heights."""
    shape, cell = (61, 61), 0.05
    r, c = np.mgrid[:61, :61] - 30
    z = np.random.default_rng(2).normal(0, 0.003, shape) + 0.39 * (np.hypot(r, c) * cell < 0.45)
    e = ground(z, cell=cell, sigma=0.02, rgb=textured((150, 140, 120), shape, 0.03, 1))
    e = replace(e, sampling=np.full(shape, 0.03, np.float32), fine_sampling=np.full(shape, 0.015, np.float32))
    lander = Lander(radius=1.0, feet=square(0.6), foot_radius=0.05, belly_clearance=0.4)
    cover = covered(e, 0.999, Terrain.PAVED)
    matched, exact = assess(e, cover, lander, MATCHED), assess(e, cover, lander, EXACT)
    assert 0.3 < exact.p_safe[30, 30] < 0.7
    assert_allclose(matched.p_relief[30, 30], exact.p_safe[30, 30], atol=0.02)
    assert matched.reasons[30, 30] == Hazard.DOUBT
    high = assess(e, cover, lander.model_copy(update={"belly_clearance": 0.6}), MATCHED)
    assert high.p_relief[30, 30] > ndtr(3.0)


def over_a_bump(top: float, width: float, lander: Lander) -> HazardMap:
    """Judge a round bump of this height under the belly, matched from near by; `width`: metres, 1-sigma."""
    shape, cell = (121, 121), 0.03
    r, c = np.mgrid[:121, :121] - 60
    away = np.hypot(r - 12, c - 5) * cell
    z = np.random.default_rng(0).normal(0, 0.003, shape) + top * np.exp(-0.5 * (away / width) ** 2)
    e = ground(z, cell=cell, sigma=0.005, rgb=textured((150, 140, 120), shape, 0.03, 1))
    e = replace(e, sampling=np.full(shape, 0.03, np.float32), fine_sampling=np.full(shape, 0.015, np.float32))
    return assess(e, covered(e, 0.999, Terrain.PAVED), lander, MATCHED)


@pytest.mark.parametrize(("clearance", "top", "width", "safe"), [(0.1, 0.09, 0.06, False), (0.3, 0.16, 0.2, True)])
def test_evidence_of_obstacles_is_over_the_clearance_of_the_belly(
    clearance: float, top: float, width: float, safe: bool
) -> None:
    lander = Lander(radius=0.9, feet=square(0.6), foot_radius=0.05, belly_clearance=clearance)
    h = over_a_bump(top, width, lander)
    assert (h.p_obstacle[60, 60] > 0.95) == safe
    same = over_a_bump(top, width, lander.model_copy(update={"max_roughness": clearance}))
    assert_allclose(h.p_safe, same.p_safe)


def test_doubtful_heights_agree_by_the_clearance_of_the_belly() -> None:
    e = ground(np.zeros((41, 41)), sigma=0.1)
    e.flags[20, 10:30] = Flag.AMBIGUOUS
    e.height[20, 10:30] = 0.04
    low, high = (Lander(feet=square(0.6), belly_clearance=k) for k in (0.06, 0.2))
    assert np.isnan(usable_height(e, low, EXACT)[20, 10:30]).all()
    assert np.isfinite(usable_height(e, high, EXACT)[20, 10:30]).all()
    assert np.isnan(measured_height(e, low, MATCHED)[5, 5])  # vague: a sigma above 1.5 times the clearance
    assert measured_height(e, high, MATCHED)[5, 5] == 0.0


@pytest.mark.parametrize("headings", [1, 2, 4, 8])
@pytest.mark.parametrize("skids", [(0.5, 0.5), (0.9, 0.7), (0.3, 0.5)])
def test_skids_that_cells_round_do_not_level_a_plane(skids: tuple[float, float], headings: int) -> None:
    for azimuth in np.radians([0.0, 35.0, 90.0, 150.0]):
        z = math.tan(math.radians(12)) * plane(41, 41, math.sin(azimuth), math.cos(azimuth))
        h = assess(ground(z), None, Lander(radius=0.6, skids=skids, headings=headings), EXACT)
        assert h.slope[20, 20] > 0.97 * math.radians(12)
        assert Hazard.SLOPE in Hazard(int(h.reasons[20, 20]))


def test_a_belly_on_skids_narrower_than_a_cell_is_kept_clear() -> None:
    z = np.zeros((41, 41))
    z[20, 22] = 0.3
    lander = Lander(radius=0.9, skids=(0.14, 0.12), belly_clearance=0.2)
    h = assess(ground(z, cell=0.2), None, lander, EXACT)
    assert is_coarse(lander, 0.2)
    assert Hazard.CLEARANCE in Hazard(int(h.reasons[20, 20]))
    assert Hazard.CLEARANCE not in Hazard(int(h.reasons[20, 30]))
