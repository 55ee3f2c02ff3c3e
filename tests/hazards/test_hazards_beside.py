"""Hazards beside the footprint: the circle of the rotors (G6), and gear that reaches beyond the radius (G6a)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ground import covered, ground, plane, textured
from numpy.testing import assert_allclose
from scipy.special import ndtr

from alight.hazards import assess
from alight.hazards.touchdown import ring_share
from alight.records import ElevationMap, Flag, Hazard, HazardMap, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander

NOTHING = Flag(0)
CELL, HALF = 0.05, 60
MID = (HALF, HALF)
SHAPE = (2 * HALF + 1, 2 * HALF + 1)
ROWS, COLS = np.mgrid[: SHAPE[0], : SHAPE[1]] - HALF
AWAY = np.hypot(ROWS, COLS) * CELL  # metres from the middle
SECTOR = np.abs(np.arctan2(ROWS, COLS)) < 1.0
RING = SECTOR & (AWAY > 1.15) & (AWAY < 1.95)
POST = np.hypot(ROWS, COLS - 33) * CELL < 0.17  # 1.65 m away
NARROW, WIDE = Lander(radius=1.0), Lander(radius=1.0, rotor_radius=2.0)
EXACT, MATCHED = HazardsSettings(tilt_sigma=0.0, smoothed=False), HazardsSettings()
OUTSIDE = Lander(radius=0.4, feet=((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)), foot_radius=0.1)


def even(sigma: float = 0.005) -> ElevationMap:
    """Level ground seen from near by."""
    z = np.random.default_rng(0).normal(0, 0.003, SHAPE)
    e = ground(z, cell=CELL, sigma=sigma, rgb=textured((150, 140, 120), SHAPE, 0.03, 1))
    return replace(e, sampling=np.full(SHAPE, 0.03, np.float32), fine_sampling=np.full(SHAPE, 0.015, np.float32))


def raised(where: np.ndarray, height: float, flag: Flag = NOTHING, sigma: float = 0.005) -> ElevationMap:
    """Return the level ground with an object on it."""
    e = even()
    return replace(
        e,
        height=np.where(where, np.float32(height), e.height),
        flags=np.where(where, np.uint16(flag), e.flags).astype(np.uint16),
        sigma=np.where(where, np.float32(sigma), e.sigma),
    )


def paved(e: ElevationMap, where: np.ndarray | None = None, label: Terrain = Terrain.TREE) -> TerrainMap:
    """Return paved land cover, with `label` at the marked cells."""
    cover = covered(e, 0.999, Terrain.PAVED)
    if where is not None:
        cover.label[where], cover.landable[where] = label, 0.0
    return cover


def judged(e: ElevationMap, lander: Lander = WIDE, cover: TerrainMap | None = None, **more: np.ndarray) -> HazardMap:
    return assess(e, cover or paved(e), lander, MATCHED, **more)  # type: ignore[arg-type]


def refused(h: HazardMap) -> Hazard:
    return Hazard(int(h.reasons[MID]))


def test_even_ground_is_as_sure_under_wide_rotors() -> None:
    e = even()
    assert refused(judged(e)) == Hazard(0)
    assert_allclose(judged(e).p_safe[MID], judged(e, NARROW).p_safe[MID], atol=1e-6)


@pytest.mark.parametrize("flag", [NOTHING, Flag.UNSURE, Flag.AMBIGUOUS, Flag.MOVING | Flag.INCONSISTENT])
@pytest.mark.parametrize(("where", "height"), [(POST, 2.0), (RING, 3.0)], ids=["post", "wall"])
def test_what_stands_under_the_rotors_is_refused_though_its_height_is_in_doubt(
    where: np.ndarray, height: float, flag: Flag
) -> None:
    e = raised(where, height, flag)
    assert flag == NOTHING or refused(judged(e, NARROW)) == Hazard(0)
    h = judged(e)
    assert Hazard.CLEARANCE in refused(h)
    assert not h.p_safe[MID] > 0.0
    assert Hazard.CLEARANCE in Hazard(int(assess(e, None, WIDE, EXACT).reasons[MID]))


def test_single_doubtful_heights_under_the_rotors_are_wrong_matches() -> None:
    lone = (AWAY > 1.2) & (ROWS % 5 == 0) & (COLS % 5 == 0)
    assert refused(judged(raised(lone, 2.0, Flag.UNSURE))) == Hazard(0)
    assert Hazard.CLEARANCE in refused(judged(raised(lone, 2.0)))  # each trusted cell counts by itself


def test_a_vague_doubtful_height_near_the_ground_does_not_refuse() -> None:
    h = judged(raised(POST, 0.02, Flag.UNSURE, sigma=1.0))
    assert refused(h) in (Hazard(0), Hazard.DOUBT)
    assert_allclose(h.p_relief[MID], ndtr((0.3 - 0.02) / 0.15), atol=0.01)


def test_ground_under_the_rotors_that_was_not_seen_is_unknown() -> None:
    unseen = np.where(RING, np.nan, even().height)
    e = ground(unseen, cell=CELL, sigma=0.005)
    assert refused(judged(e, NARROW)) == Hazard(0)
    assert Hazard.UNKNOWN in refused(judged(e))
    gap = np.where((np.abs(np.arctan2(ROWS, COLS)) < 0.1) & (AWAY > 1.15) & (AWAY < 1.95), np.nan, 0.0)
    assert Hazard.UNKNOWN in Hazard(int(assess(ground(gap, cell=CELL), None, WIDE, EXACT).reasons[MID]))


@pytest.mark.parametrize(
    ("label", "why"),
    [(Terrain.TREE, Hazard.TERRAIN), (Terrain.STRUCTURE, Hazard.TERRAIN), (Terrain.TALL_VEGETATION, Hazard(0)),
     (Terrain.WATER, Hazard(0))],
)  # fmt: skip
def test_land_cover_that_stands_up_is_refused_under_the_rotors(label: Terrain, why: Hazard) -> None:
    """Rotors pass over water and over low plants."""
    e = even()
    assert refused(judged(e, WIDE, paved(e, RING, label))) == why
    assert refused(judged(e, NARROW, paved(e, RING, label))) == Hazard(0)


def test_tall_plants_of_unknown_height_are_refused_under_the_rotors() -> None:
    e = raised(RING, 0.0, Flag.UNSURE)
    assert Hazard.TERRAIN not in refused(judged(e))
    assert Hazard.TERRAIN in refused(judged(e, WIDE, paved(e, RING, Terrain.TALL_VEGETATION)))


@pytest.mark.parametrize("lander", [WIDE, OUTSIDE], ids=["rotor", "feet"])
def test_whoever_stands_or_passes_beside_the_footprint_refuses_it(lander: Lander) -> None:
    person = np.hypot(ROWS, COLS - 26) * CELL < 0.15  # 1.3 m away
    for told in ("came", "passed"):
        assert refused(judged(even(), lander, **{told: person})) == Hazard.TRAFFIC
    assert refused(judged(even(), Lander(radius=0.4), came=person)) == Hazard(0)


def test_a_rise_near_the_limit_under_the_rotors_costs_probability() -> None:
    """The trusted wall is 0.28 m high, sigma 0.02 m, and the rotors clear 0.3 m: one sigma."""
    e = raised(RING, 0.28, sigma=0.02)
    h, narrow = judged(e), judged(e, NARROW)
    assert_allclose(h.p_relief[MID] / narrow.p_relief[MID], ndtr(1.0), atol=0.02)
    assert refused(h) == Hazard.DOUBT
    assert_allclose(assess(e, None, WIDE, EXACT).p_safe[MID], ndtr(1.0), atol=0.02)


def test_the_ring_is_what_one_disc_has_more_than_another() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[MID], mask[HALF, HALF + 30] = True, True
    ring = (AWAY > 1.0 + 1e-9) & (AWAY <= 2.0 + 1e-9)
    assert_allclose(ring_share(mask, 1.0, 2.0, CELL)[MID], 1 / ring.sum(), rtol=1e-4)
    assert (ring_share(mask, 1.0, 1.001, CELL) == 0).all()  # the ring holds no cell centre


def test_feet_beyond_the_radius_do_not_stand_on_water() -> None:
    e, wet = even(), AWAY > 1.05
    assert refused(judged(e, Lander(radius=0.4), paved(e, wet, Terrain.WATER))) == Hazard(0)
    assert Hazard.TERRAIN in refused(judged(e, OUTSIDE, paved(e, wet, Terrain.WATER)))
    far = replace(e, sampling=np.full(SHAPE, 0.2, np.float32), fine_sampling=np.full(SHAPE, 0.1, np.float32))
    doubtful = paved(far)
    doubtful.landable[wet] = 0.6
    p, inner, whole = (
        judged(far, k, doubtful).p_ground[MID] for k in (OUTSIDE, Lander(radius=0.4), Lander(radius=OUTSIDE.reach))
    )
    assert_allclose(p, whole, atol=1e-4)
    assert p < 0.8 * inner


def test_feet_beyond_the_radius_are_judged_where_ground_was_not_seen_and_at_the_edge() -> None:
    gap = np.where((np.abs(np.arctan2(ROWS, COLS) - 0.35) < 0.2) & (AWAY > 0.6), np.nan, 0.0)  # between headings
    lander = OUTSIDE.model_copy(update={"headings": 1})
    assert Hazard.UNKNOWN in refused(judged(ground(gap, cell=CELL, sigma=0.005), lander))
    h = judged(even(), lander)
    assert Hazard.EDGE in Hazard(int(h.reasons[HALF, 25]))
    assert Hazard.EDGE not in Hazard(int(h.reasons[HALF, 32]))  # 1.6 m, and feet reach 1.514 m


def test_the_reach_of_gear_is_that_of_its_farthest_part() -> None:
    assert Lander().ground_reach == Lander().reach == 1.5
    assert_allclose(OUTSIDE.ground_reach, math.sqrt(2) + 0.1)
    assert_allclose(Lander(radius=0.4, skids=(1.2, 0.9)).ground_reach, 0.75)
    assert_allclose(Lander(radius=0.4, skids=(1.2, 0.9), rotor_radius=2.0).reach, 2.0)


def test_rotors_over_a_slope_are_judged_against_its_plane() -> None:
    e = ground(plane(*SHAPE, 0.15, 0.0, CELL), cell=CELL, sigma=0.005)
    assert Hazard.CLEARANCE not in Hazard(int(assess(e, None, WIDE, EXACT).reasons[MID]))
