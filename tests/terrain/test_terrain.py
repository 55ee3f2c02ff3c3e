"""Terrain: hazardous ground is refused, and similar but safe ground stays possible."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ground import BROWN, GREEN, GREY, POND, ground, land_cover, textured
from numpy.testing import assert_allclose

from alight.geometry import Grid
from alight.hazards import assess
from alight.records import ElevationMap, Flag, Terrain
from alight.settings import HazardsSettings, Lander, TerrainSettings
from alight.terrain import classify, open_water
from alight.terrain.appearance import appearance
from alight.terrain.classify import without_pits
from alight.terrain.relief import ground_under, open_to_rim, relief, standing_water
from alight.terrain.water import WaterSigns, flooded, wetness

SHAPE = (240, 240)
SETTINGS = TerrainSettings()
R, C = np.mgrid[: SHAPE[0], : SHAPE[1]]


def bowl(depth: float, radius_m: float = 6.0, centre: tuple[int, int] = (120, 120)) -> np.ndarray:
    away = np.hypot(R - centre[0], C - centre[1]) * 0.1
    return np.where(away < radius_m, -depth * (1 - (away / radius_m) ** 2), 0.0)


def noise(sigma: float, seed: int = 0) -> np.ndarray:
    n = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE), (0, 0), 2.0)
    return n * (sigma / n.std())


def scene(height: np.ndarray, inside: np.ndarray, colour: tuple[int, int, int], contrast: float) -> ElevationMap:
    """Return short grass around a patch of another colour and texture."""
    rgb = textured(GREEN, SHAPE, 0.05, 1)
    rgb[inside] = textured(colour, SHAPE, contrast, 2)[inside]
    return ground(height, sigma=0.04, rgb=rgb)


def pond(depth: float, centre: tuple[int, int] = (120, 120)) -> tuple[ElevationMap, np.ndarray]:
    """Return a pond whose bed was matched: a smooth surface of low sigma below the shore; and its cells."""
    water = np.hypot(R - centre[0], C - centre[1]) < 60
    return scene(bowl(depth, centre=centre) + noise(0.03), water, POND, 0.02), water


def test_a_pond_with_a_visible_bed_is_refused() -> None:
    e, water = pond(0.7)
    t = classify(e, SETTINGS)
    assert (t.landable[water] < 0.5).mean() > 0.98
    assert (t.label[water] == Terrain.WATER).mean() > 0.97
    shore = np.hypot(R - 120, C - 120) > 70
    assert (t.landable[shore] > 0.5).mean() > 0.99


def test_ground_bears_where_it_may_be_landed_on_and_where_it_is_rock() -> None:
    """The probability of bearing is nowhere below P(landable): a tree lowers both beside it."""
    e, water = pond(0.7)
    t = classify(e, SETTINGS)
    assert t.bears is not None
    assert (t.bears >= t.landable - 1e-6).all()
    assert (t.bears[water] < 0.5).mean() > 0.95


def test_a_pond_that_the_map_cuts_is_refused_too() -> None:
    e, water = pond(0.7, centre=(120, 10))
    t = classify(e, SETTINGS)
    assert (t.landable[water] < 0.5).mean() > 0.97


def test_a_grassy_hollow_is_no_pond() -> None:
    e = scene(bowl(0.7) + noise(0.03), np.zeros(SHAPE, bool), POND, 0.0)
    t = classify(e, SETTINGS)
    assert (t.landable > 0.5).mean() > 0.99
    assert not (t.label == Terrain.WATER).any()


def test_a_grey_flat_slab_stays_possible_in_sun_and_shade() -> None:
    slab = (np.abs(R - 120) < 60) & (np.abs(C - 120) < 60)
    for colour in (GREY, (45, 50, 62)):
        t = classify(scene(noise(0.02), slab, colour, 0.02), SETTINGS)
        assert (t.landable[slab] > 0.5).mean() > 0.9  # the rim of the slab is an edge


def test_restless_water_without_a_basin_is_refused() -> None:
    water = np.hypot(R - 120, C - 120) < 60
    e = scene(noise(0.03), water, POND, 0.02)
    e.flags[water & (np.random.default_rng(0).random(SHAPE) < 0.8)] = Flag.MOVING
    t = classify(e, SETTINGS)
    core = np.hypot(R - 120, C - 120) < 50
    assert (t.landable[core] < 0.5).all()


def test_tall_grass_is_refused_by_texture_colour_and_height() -> None:
    tall = np.hypot(R - 120, C - 120) < 40
    height = np.where(tall, 0.4 + noise(0.12, 3), noise(0.02))
    t = classify(scene(height, tall, (80, 105, 50), 0.35), SETTINGS)
    core = np.hypot(R - 120, C - 120) < 36
    assert (t.landable[core] < 0.5).mean() > 0.93
    assert (t.label[core] == Terrain.TALL_VEGETATION).mean() > 0.9
    assert (t.landable[np.hypot(R - 120, C - 120) > 55] > 0.5).mean() > 0.98


def test_a_tree_and_a_wall_stand_on_the_ground_and_a_hill_does_not() -> None:
    height = noise(0.02)
    tree, wall = np.hypot(R - 60, C - 60) < 20, (np.abs(R - 180) < 3) & (np.abs(C - 120) < 60)
    height[tree] += 5.0
    height[wall] += 1.2
    hill = 1.0 * np.exp(-(((R - 80) ** 2 + (C - 180) ** 2) * 0.01) / 50.0)
    e = scene(height + hill, wall, BROWN, 0.05)
    t = classify(e, SETTINGS)
    assert (t.label[tree] == Terrain.TREE).mean() > 0.95
    assert (t.landable[tree | wall] < 0.5).mean() > 0.95
    top = np.hypot(R - 80, C - 180) < 30
    assert (t.landable[top] > 0.5).all()


def test_ground_beside_a_tall_crown_is_refused_by_its_height_even_if_the_crown_is_doubtful() -> None:
    height = noise(0.02)
    away = np.hypot(R - 120, C - 120) * 0.1
    height[away < 1.5] += 5.0  # 4.5 m and more: 2.25 m kept to it
    e = scene(height, np.zeros(SHAPE, bool), GREEN, 0.0)
    e.flags[away < 1.5] = Flag.AMBIGUOUS
    t = classify(e, SETTINGS)
    assert (t.landable[(away > 1.6) & (away < 3.5)] < 0.5).all()
    assert (t.landable[away > 4.2] > 0.5).mean() > 0.99
    near = classify(e, TerrainSettings(overhang=0.0))
    assert (near.landable[away > 2.6] > 0.5).mean() > 0.99


def test_nothing_seen_is_unknown_and_no_evidence() -> None:
    height = noise(0.02)
    height[:, :100] = np.nan
    e = ground(height, rgb=textured(GREEN, SHAPE, 0.05, 1))
    t = classify(e, SETTINGS)
    assert (t.label[:, :100] == Terrain.UNKNOWN).all()
    assert np.isnan(t.landable[:, :100]).all()
    assert np.isfinite(t.landable[:, 100:]).all()


def pit(side: int, level: int, fine: bool, plain: Flag = Flag.SATURATED) -> ElevationMap:
    """Return lawn with a patch of `side` cells of one grey level; with or without a finest picture beside the map."""
    rgb, inside = textured(GREEN, SHAPE, 0.05, 1), (slice(100, 100 + side),) * 2
    rgb[inside] = level
    e = ground(noise(0.02), rgb=rgb)
    e.flags[inside] |= np.uint16(plain)
    return replace(e, fine=np.maximum(rgb, 1).repeat(2, axis=0).repeat(2, axis=1)) if fine else e


def test_black_ground_is_seen_ground() -> None:
    """A dark pit of 0.5 m has the class of the darkest grey."""
    black, dark = (classify(pit(5, level, fine=True), SETTINGS) for level in (0, 1))
    assert_allclose(black.landable, dark.landable, atol=1e-3)
    assert_allclose(black.novelty, dark.novelty, rtol=1e-2)
    assert (black.label == dark.label).all()


@pytest.mark.parametrize("side", [4, 5])
def test_black_ground_of_which_no_picture_shows_more_is_like_nothing_known(side: int) -> None:
    """Such ground has no class and no certainty, and so no site. A gap in the map's colours is not black ground."""
    e, gap = pit(side, 0, fine=False), pit(side, 0, fine=False, plain=Flag(0))
    blank, inside = classify(e, SETTINGS), (slice(100, 100 + side),) * 2
    assert (blank.label[inside] == Terrain.UNKNOWN).all()
    assert blank.bears is not None
    assert blank.novelty is not None
    assert (blank.bears[inside] == 0.5).all()
    assert (blank.landable[inside] == 0.5).all()
    assert (blank.novelty[inside] == 20.0).all()
    lander, settings = Lander(radius=1.0), HazardsSettings()
    assert assess(e, blank, lander, settings).p_ground[102, 102] < settings.p_safe
    assert np.isnan(classify(gap, SETTINGS).landable[inside]).all()


def test_ground_without_a_colour_has_the_class_that_its_finest_picture_shows() -> None:
    """A map built view by view has the colours of the newest view; the orthophoto also has those of earlier views."""
    gap = (slice(60, 180), slice(100, 140))
    e, water = pond(0.7)
    bare = e.rgb.copy()
    bare[gap] = 0
    whole, partly = classify(e, SETTINGS), classify(replace(e, rgb=bare, fine=e.rgb), SETTINGS)
    assert (partly.label == whole.label).all()
    assert_allclose(partly.landable, whole.landable, atol=0.05)
    assert (partly.landable[gap][water[gap]] < 0.5).mean() > 0.95


def test_an_empty_map_is_classified_without_a_complaint() -> None:
    t = classify(ground(np.full((30, 40), np.nan)), SETTINGS)
    assert not t.label.any()


def test_grey_images_say_nothing_by_colour() -> None:
    e, _ = pond(0.0)
    grey = np.repeat(e.rgb.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    t = classify(ground(noise(0.02), rgb=grey), SETTINGS)
    assert (t.landable > 0.5).all()


def test_the_ground_under_a_plane_is_the_plane() -> None:
    z = (0.02 * C - 0.05 * R).astype(np.float32)[:60, :60]
    rock = z.copy()
    rock[30, 30] += 2.0
    inner = (slice(10, 50), slice(10, 50))
    assert_allclose(ground_under(rock, 8.0)[inner], z[inner], atol=0.06)
    assert_allclose(ground_under(z, 8.0)[inner], z[inner], atol=1e-5)


def test_a_height_is_taken_back_where_the_patch_is_water_not_where_that_is_the_likeliest_hazard() -> None:
    label = np.full((20, 30), Terrain.BARE, np.uint8)
    label[2:12, 2:12] = label[2:12, 15:25] = label[15:18, 2:8] = Terrain.WATER
    p = np.full((20, 30), 0.1, np.float32)
    p[2:12, 2:12] = 0.9
    p[5, 5] = 0.2  # a doubtful cell of a pond
    p[2:12, 15:25] = 0.4  # a shadow beside a bush
    p[3, 16] = 0.9
    cover = land_cover(Grid(0.0, 0.0, 0.1, 20, 30), label, np.zeros((20, 30), np.float32), water=p)
    wet = open_water(cover)
    assert wet[2:12, 2:12].all()
    assert wet.sum() == 100


def test_water_stands_to_the_brim_and_runs_off_where_the_ground_is_not_known() -> None:
    z = np.ones((21, 21), np.float32)
    z[5:16, 5:16] = 0.0
    dry = np.zeros(z.shape, bool)
    depth, level = standing_water(z, dry)
    assert_allclose(depth[5:16, 5:16], 1.0)
    assert_allclose(level, 1.0)
    open_side = z.copy()
    open_side[10, :5] = np.nan
    assert_allclose(standing_water(open_side, dry)[0][5:16, 5:16], 0.0)
    hole = z.copy()
    hole[10, 10] = np.nan
    assert_allclose(np.nan_to_num(standing_water(hole, dry)[0], nan=1.0)[5:16, 5:16], 1.0)
    cut = z[:, 10:]
    assert_allclose(standing_water(cut, np.zeros(cut.shape, bool))[0], 0.0)
    wet = cut < 0.5
    assert_allclose(standing_water(cut, wet)[0][5:16, :6], 1.0)


def test_only_unknown_ground_that_reaches_the_rim_is_outside() -> None:
    unknown = np.zeros((9, 9), bool)
    unknown[4, 4] = unknown[0:3, 7] = True
    assert (open_to_rim(unknown) == (unknown & (C[:9, :9] == 7))).all()


def rolling() -> ElevationMap:
    """Grey plain with a hollow that leaves the map at both ends, a closed hollow, and grass on one side."""
    hollow = 0.5 * (1 - np.exp(-(((C - 90) / 25) ** 2))) + 0.0005 * (R - 120)
    rgb = textured(POND, SHAPE, 0.02, 2)
    rgb[:, 225:] = textured(GREEN, SHAPE, 0.05, 1)[:, 225:]
    return ground(hollow + noise(0.02) + bowl(0.6, 2.5, (120, 185)), sigma=0.04, rgb=rgb)


def test_a_grey_plain_that_looks_like_water_all_over_is_none_where_the_ground_lets_it_out() -> None:
    """Under a grey sky all bare ground looks like water. The rim of the map is a shore only for ponds."""
    e = rolling()
    shape = relief(e, wetness(e, appearance(e)), SETTINGS)
    assert (shape.depth[:, 80:100] > 0.2).mean() > 0.9  # as if the rim retained the water
    assert (shape.walled[:, 80:100] < 0.05).all()
    found = classify(e, SETTINGS)
    assert (found.landable[:, :140] > 0.5).mean() > 0.95
    assert (found.landable[110:130, 175:195] < 0.5).all()


def test_a_car_park_on_a_slope_is_no_pond() -> None:
    """A car park looks like water, which would run down the meadow. Level or moving ground may be water."""
    slab = (np.abs(R - 120) < 30) & (np.abs(C - 120) < 30)
    seed = np.where(np.hypot(R - 120, C - 120) < 20, 2.0, -2.0).astype(np.float32)

    def water(slope: float, moving: float) -> np.ndarray:
        e = scene(noise(0.02) + slope * 0.1 * (SHAPE[0] - R), slab, POND, 0.02)
        wet = wetness(e, appearance(e))
        moves, bed = np.full(SHAPE, moving, np.float32), e.height.astype(np.float32)
        return flooded(WaterSigns(seed, seed, wet, moves, bed, np.zeros(SHAPE, bool)), 0.1, 0.2)

    assert not water(0.08, moving=0.1).any()
    assert water(0.0, moving=0.1)[slab].mean() > 0.5
    assert water(0.08, moving=0.8)[slab].mean() > 0.5


def test_ground_without_any_picture_may_be_anything_and_is_no_site() -> None:
    gap = (slice(60, 180), slice(60, 180))
    rgb = textured(GREEN, SHAPE, 0.05, 1)
    rgb[gap] = 0
    e = ground(noise(0.002), sigma=0.005, rgb=rgb)
    t, lander = classify(e, SETTINGS), Lander(radius=1.0)
    assert t.bears is not None
    assert t.novelty is not None
    assert (t.bears[gap] == 0.5).all()
    assert (t.novelty[gap] == 20.0).all()
    assert assess(e, t, lander, HazardsSettings()).p_ground[120, 120] < 0.1
    assert np.isfinite(t.bears[:60]).all()
    assert (t.novelty[:50] < 20.0).all()


@pytest.mark.parametrize(("cell", "widest"), [(0.1, 3), (0.12, 2), (0.15, 2), (0.2, 1), (0.25, 1), (0.4, 0)])
def test_refused_ground_of_up_to_a_third_of_a_metre_is_left_to_the_geometry(cell: float, widest: int) -> None:
    for width in (1, 2, 3, 4):
        share = np.ones((41, 41), np.float32)
        share[:, 20 : 20 + width] = 0.1
        share[10:14] = np.minimum(share[10:14], 0.2)  # wide: it stays
        left = without_pits(share, cell)
        assert (left[25] < 0.5).sum() == (0 if width <= widest else width)
        assert (left[11:13] < 0.5).all()
        assert (left[15:30, :18] == 1.0).all()


@pytest.mark.parametrize("shape", [(1, 50), (50, 1), (2, 3), (1, 1)])
def test_a_map_of_few_rows_is_classified(shape: tuple[int, int]) -> None:
    t = classify(ground(np.zeros(shape), cell=0.2, sigma=0.01), SETTINGS)
    assert t.novelty is not None
    assert t.novelty.shape == shape
