"""Worlds: pure functions of scene, seed and place; things as described; rasters; errors; truth by brute force."""

import math
import re

import numpy as np
import pytest
import rasterio

from alight.geometry import Grid, LocalFrame
from alight.records import InputError, Terrain
from alight_sim.kernels.layers import BLOCK, ReliefForm, add_fractal, along_line, box_mean, sun_margin, tile_block_tops
from alight_sim.kernels.noise import gradient_noise
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.scene import Scene, built_in, parse_scene, read_scene, things
from alight_sim.scene_world import build, world_of
from alight_sim.truth import TrueFootprint, safe_mask

FLAT = [{"height": 0.0}]


def scene(layers=(), cell=0.1, size=(40, 40), relief=FLAT, **ground):
    tree = {"ground": {"cell": cell, "size": list(size), "relief": relief, "layers": list(layers), **ground}}
    return parse_scene(tree, "test.yaml")


def truth_of(*layers, seed=0, **ground):
    return build(scene(layers, **ground), seed).truth()


def at(truth, east, north):
    """Return height and class of the cell at a place."""
    r, c = (int(np.rint(v)) for v in truth.grid.index(np.array(east), np.array(north)))
    return float(truth.height[r, c]), Terrain(int(truth.label[r, c]))


MIXED = [
    {"thing": "craters", "per_hectare": 40, "radius": [1, 4]},
    {"thing": "ponds", "per_hectare": 8, "radius": [3, 5]},
    {"thing": "pads", "per_hectare": 8, "radius": 3},
    {"thing": "road", "path": [[-40, 3], [5, -4], [40, 10]], "width": 4, "marks": "dashed", "ruts": 0.05},
    {"thing": "fields", "parcel": [20, 14], "within": [-30, -30, 0, 0]},
    {"thing": "tall_grass", "share": 0.3},
    {"thing": "wall", "path": [[-20, -20], [-3, 15]]},
    {"thing": "hedge", "path": [[-25, 10], [20, 14]]},
    {"thing": "houses", "per_hectare": 20},
    {"thing": "cars", "per_hectare": 60},
    {"thing": "crates", "per_hectare": 60},
    {"thing": "trees", "per_hectare": 60},
    {"thing": "shrubs", "per_hectare": 200},
    {"thing": "rocks", "per_hectare": 600},
    {"thing": "logs", "per_hectare": 40},
    {"thing": "mounds", "per_hectare": 100},
]


@pytest.fixture(scope="module")
def mixed():
    return scene(MIXED, cell=0.2, relief=[{"height": 0.5, "longest": 30}])


BOX = (-45.0, 1.0, 45.0, 45.0)  # of two tiles


@pytest.fixture(scope="module")
def whole(mixed):
    """A patch of a world of which nothing was asked before."""
    return build(mixed, 5).patch(BOX)


def same(a, b):
    parts = zip((a.height, a.label, a.light, a.look, a.tint), (b.height, b.label, b.light, b.look, b.tint), strict=True)
    return a.grid == b.grid and all(np.array_equal(x, y) for x, y in parts)


def test_a_patch_does_not_depend_on_what_was_asked_before(mixed, whole):
    other = build(mixed, 5)
    for box in ((30, 30, 31, 31), (-40, 10, -39, 12), (0, -40, 1, 2)):
        other.patch(box)
    other.height_at(200.0, -300.0)
    assert same(whole, other.patch(BOX))
    assert len(np.unique(whole.label)) == 8


def test_a_patch_does_not_depend_on_threads(mixed, on_one_and_all):
    one, other = on_one_and_all(lambda: build(mixed, 5).patch((-20, 1, 20, 20)))
    assert same(one, other)


def test_small_and_large_patches_agree_on_every_cell(mixed, whole):
    large, small = whole, build(mixed, 5).patch((1, 1, 10, 10))
    r, c = (round(float(v)) for v in large.grid.index(np.array(small.grid.east), np.array(small.grid.north)))
    cut = np.s_[r : r + small.grid.rows, c : c + small.grid.cols]
    assert small.height.size < large.height.size
    for name in ("height", "label", "light", "look", "tint"):
        assert np.array_equal(getattr(large, name)[cut], getattr(small, name)), name


def test_memory_is_bounded_and_what_fell_out_comes_back_the_same():
    world = build(scene([{"thing": "rocks", "per_hectare": 50}], cell=0.2), 5)
    first = world.patch((0, 0, 1, 1)).height.copy()
    world._tiles.limit = world._patches.limit = 3_000_000
    for k in range(1, 5):
        world.patch((60.0 * k, 0, 60.0 * k + 1, 1))
        for store in (world._tiles, world._patches):
            assert store.used <= store.limit or len(store._held) == 1
    assert np.array_equal(world.patch((0, 0, 1, 1)).height, first)


def test_seeds_differ_and_another_kind_of_thing_moves_none_of_the_others():
    rocks = {"thing": "rocks", "per_hectare": 300}
    plain, other = truth_of(rocks), truth_of(rocks, seed=1)
    more = truth_of({"thing": "roughness", "upon": ["rock"]}, rocks)
    assert not np.array_equal(plain.height, other.height)
    assert np.array_equal(plain.height, more.height)


def test_things_are_where_they_are_whatever_the_cell():
    layers = [{"thing": "rocks", "per_hectare": 200, "radius": [0.5, 1.0]}]
    found = [build(scene(layers, cell=c), 2).source.lays[0].things((-20, -20, 20, 20)) for c in (0.1, 0.2)]
    assert len(found[0]) > 10
    inside = [f[(np.abs(f[:, [Column.EAST, Column.NORTH]]) < 18).all(axis=1)] for f in found]
    assert np.array_equal(inside[0], inside[1])


def test_the_extent_is_what_was_asked_for_and_the_ground_goes_on():
    world = build(scene(size=(30, 20)), 0)
    truth = world.truth()
    assert world.extent == pytest.approx((-15.0, -10.0, 15.0, 10.0))
    assert truth.grid == Grid(pytest.approx(-14.95), pytest.approx(9.95), 0.1, 200, 300)
    assert math.isfinite(world.height_at(500.0, -900.0))
    part = world.truth((-1.0, -2.0, 3.0, 4.0))
    assert part.height.shape == (60, 40)


def test_height_at_is_bilinear_between_centres(mixed):
    world = build(mixed, 5)
    patch = world.patch((1, 1, 20, 20))
    east, north = patch.grid.east + 0.2 * 70.25, patch.grid.north - 0.2 * 31.5
    h = patch.height[31:33, 70:72].astype(float)
    assert world.height_at(east, north) == pytest.approx(np.array([0.5, 0.5]) @ h @ np.array([0.75, 0.25]), abs=1e-5)


@pytest.mark.parametrize("name", ["demo", "hopeless", "village"])
def test_heights_lie_within_the_bounds_that_a_world_claims(name):
    world = build(name, 3)
    box = (-25.0, -25.0, 25.0, 25.0)
    height = world.truth(box).height
    for low, high in ((world.low, world.high), world.range(box)):
        assert low <= height.min()
        assert height.max() <= high
    assert world.high - world.low < 60.0


# -- things


def test_relief_has_its_deviation_and_slope_falls_where_it_says():
    rolling = truth_of(relief=[{"height": 0.7, "longest": 8, "shortest": 1}], size=(100, 100), cell=0.2)
    assert rolling.height.std() == pytest.approx(0.7, rel=0.15)
    steep = truth_of(slope_deg=10, downhill_deg=90)
    assert at(steep, 10.05, 3.05)[0] - at(steep, -9.95, 3.05)[0] == pytest.approx(-20 * math.tan(math.radians(10)))


def test_rocks_keep_their_size_distribution():
    layers = [{"thing": "rocks", "per_hectare": 4000, "radius": [0.2, 5.0], "exponent": 2.5}]
    radius = build(scene(layers), 1).source.lays[0].things((-100, -100, 100, 100))[:, Column.HALF_U]
    assert len(radius) > 10_000
    found = 1.0 / np.log(radius[radius > 0.3] / 0.3).mean()  # the maximum-likelihood (Hill) exponent
    assert found == pytest.approx(2.5, abs=0.15)
    assert radius.min() >= 0.2
    assert radius.max() <= 5.0


def test_rocks_and_trees_stand_as_high_as_they_say():
    rock = truth_of({"thing": "rocks", "at": [[0, 0]], "radius": 2.0, "flatness": 0.5})
    h, kind = at(rock, 0.05, 0.05)
    assert (h, kind) == (pytest.approx(1.0, abs=0.45), Terrain.ROCK)
    assert (rock.label == Terrain.ROCK).sum() * 0.01 == pytest.approx(0.8 * math.pi * 4.0, rel=0.3)
    for form in ("round", "conifer", "bare"):
        tree = truth_of({"thing": "trees", "at": [[0, 0]], "radius": 3, "height": 9, "form": form})
        crown = tree.height[tree.label == Terrain.TREE]
        assert crown.max() == pytest.approx(9.0, abs=1.0)
        assert (tree.label == Terrain.TREE).sum() * 0.01 < 1.35 * math.pi * 9
        assert (tree.height[tree.label != Terrain.TREE] == 0).all()


def test_a_crown_is_ragged_with_holes():
    tree = truth_of({"thing": "trees", "at": [[0, 0]], "radius": 4, "height": 9})
    crown = tree.label == Terrain.TREE
    edge = (crown[1:] != crown[:-1]).sum() + (crown[:, 1:] != crown[:, :-1]).sum()
    assert edge > 1.3 * 4.0 / math.sqrt(math.pi) * math.sqrt(crown.sum()) * math.sqrt(math.pi)  # a disc would have 1


def test_a_house_has_sheer_walls_and_a_roof_of_its_pitch():
    house = {"thing": "houses", "at": [[0, 0]], "length": 10, "width": 6, "walls": 3, "turn_deg": 0}
    truth = truth_of({**house, "pitch_deg": 30})
    assert at(truth, -4.95, -2.95)[0] == pytest.approx(3.0 + 0.05 * math.tan(math.radians(30)), abs=1e-4)
    assert at(truth, -2.95, 0.05)[0] == pytest.approx(3.0 + 2.95 * math.tan(math.radians(30)), abs=1e-4)
    assert at(truth, -2.95, -3.05) == (0.0, Terrain.SHORT_GRASS)  # one cell beyond the wall
    assert (truth.label == Terrain.STRUCTURE).sum() == 100 * 60


def test_a_wall_askew_has_a_straight_edge():
    """The half-height contour of a roof that is turned against the grid deviates by less than a tenth of a cell."""
    house = {"thing": "houses", "at": [[0, 0]], "length": 20, "width": 12, "walls": 4, "roof": "flat", "turn_deg": 17}
    truth = truth_of(house, size=(60, 60))
    east, north = truth.grid.xy()
    c, s = math.cos(math.radians(17)), math.sin(math.radians(17))
    stray = []
    for k in range(260, 340):  # columns through the middle of the upper wall
        column = truth.height[:, k].astype(float)
        r = int(np.argmax(column > 2.0))
        t = (2.0 - column[r - 1]) / (column[r] - column[r - 1])
        y = north[r - 1] - 0.1 * t
        stray.append(c * y - s * east[k] - 6.0)
    assert np.abs(stray).max() < 0.02


def test_a_wall_on_a_slope_keeps_its_height_and_lets_no_cell_through():
    truth = truth_of({"thing": "wall", "path": [[-10, -5], [10, 7]], "height": 2.0, "thickness": 0.1}, slope_deg=8)
    bare = truth_of(slope_deg=8)
    wall = truth.label == Terrain.STRUCTURE
    assert np.abs((truth.height - bare.height)[wall] - 2.0).max() < 1e-5
    rows = np.flatnonzero(wall.any(axis=1))
    assert (np.diff(rows) == 1).all()  # goes through every row between its ends
    assert not np.array_equal(truth.height, bare.height)


def test_water_is_level_and_deep_where_the_ground_is_low():
    relief = [{"height": 1.0, "longest": 20, "shortest": 2}]
    layers = [{"thing": "water", "level": 0.2}]
    wet, dry = build(scene(layers, relief=relief), 4), build(scene(relief=relief), 4)
    truth, bed = wet.truth(), dry.truth()
    water = truth.label == Terrain.WATER
    assert 0.2 < water.mean() < 0.95
    assert (truth.height[water] == np.float32(0.2)).all()
    assert np.array_equal(water, bed.height < np.float32(0.2))
    patch = wet.patch(wet.extent)
    depth = patch.light[..., 4]
    assert ((depth > 0) == (patch.label == Terrain.WATER)).all()


def test_a_pad_is_level_and_its_kerb_is_sheer():
    relief = [{"height": 0.6, "longest": 12, "shortest": 1}]
    pad = {"thing": "pads", "at": [[0, 0]], "size": [8, 6], "up": 0.5, "bank": 2, "look": "concrete"}
    world = build(scene([pad], relief=relief), 1)
    truth = world.truth((-3.9, -2.9, 3.9, 2.9))
    assert np.ptp(truth.height) < 1e-6
    assert (truth.label == Terrain.PAVED).all()
    assert abs(world.height_at(0.0, 2.95) - world.height_at(0.0, 3.05)) == pytest.approx(0.5, abs=0.1)
    patch = world.patch((-1, -1, 1, 1))
    assert patch.look[(patch.label == Terrain.PAVED)].min() == Look.CONCRETE


def test_terraces_have_level_treads_and_steep_risers():
    truth = truth_of({"thing": "terraces", "step": 1.0, "riser": 0.05, "tilt": 0.0}, slope_deg=10)
    treads = truth.label != Terrain.ROCK
    assert np.abs(truth.height[treads] - np.round(truth.height[treads])).max() < 1e-5
    assert 0.03 < 1.0 - treads.mean() < 0.08
    assert len(np.unique(np.round(truth.height[treads]))) > 5


def test_a_crater_is_as_deep_as_it_says_and_has_a_rim():
    truth = truth_of({"thing": "craters", "at": [[0, 0]], "radius": 5, "depth": 0.3})
    assert at(truth, 0.05, 0.05)[0] == pytest.approx(-1.5, abs=0.05)
    assert truth.height.max() == pytest.approx(0.3, abs=0.05)
    assert at(truth, 12.0, 0.0)[0] == 0.0


def test_fields_have_rows_of_their_spacing_and_tall_crops():
    crop = {"kind": "tall_vegetation", "height": 1.5, "spacing": 2.0, "width": 0.5, "ridge": 0.0}
    truth = truth_of({"thing": "fields", "parcel": [500, 500], "turn_deg": 0, "crops": [crop]})
    tall = truth.label == Terrain.TALL_VEGETATION
    assert tall.mean() == pytest.approx(0.5, abs=0.15)
    assert truth.height[tall].mean() == pytest.approx(1.2, abs=0.25)
    assert (truth.height[~tall] == 0.0).all()
    column = tall[:, 150].astype(float) - tall[:, 150].mean()
    spectrum = np.abs(np.fft.rfft(column))
    assert np.argmax(spectrum) / 40.0 == pytest.approx(0.5, abs=0.03)  # rows a metre


def test_tall_grass_covers_its_share_up_to_its_height():
    truth = truth_of({"thing": "tall_grass", "share": 0.4, "size": 5, "height": 0.8}, size=(80, 80), cell=0.2)
    tall = truth.label == Terrain.TALL_VEGETATION
    assert tall.mean() == pytest.approx(0.4, abs=0.08)
    assert 0.3 < truth.height[tall].mean() < 0.5
    assert truth.height.max() <= 0.81


def test_a_road_is_level_across_and_its_marks_are_brighter():
    relief = [{"height": 1.0, "longest": 15, "shortest": 3}]
    road = {"thing": "road", "path": [[-60, 0.03], [60, 0.03]], "width": 6, "ragged": 0.0, "marks": "edges"}
    world = build(scene([road], relief=relief), 2)
    across = world.truth((3.0, -2.8, 3.1, 2.8))
    assert np.ptp(across.height) < 0.01
    assert (across.label == Terrain.PAVED).all()
    patch = world.patch((-20, -3, 20, 3))
    assert 0.005 < (patch.tint[..., 0] > 2).mean() < 0.05


def test_random_things_stand_only_where_they_may():
    pond = {"thing": "ponds", "at": [[0, 0]], "radius": 8}
    trees = {"thing": "trees", "per_hectare": 800, "radius": [0.8, 1.2], "upon": ["short_grass"], "apart": False}
    world = build(scene([pond, trees]), 0)
    truth = world.truth((-4.0, -4.0, 4.0, 4.0))
    assert (truth.label == Terrain.WATER).all()
    assert (world.truth().label == Terrain.TREE).mean() > 0.05
    boxed = build(scene([{**trees, "within": [5, 5, 20, 20]}]), 0).truth((-20, -20, 3.0, 3.0))
    assert not (boxed.label == Terrain.TREE).any()


def test_houses_and_cars_keep_clear_of_each_other():
    layers = [
        {"thing": "houses", "per_hectare": 60, "upon": ["short_grass"]},
        {"thing": "cars", "per_hectare": 300, "upon": ["short_grass"]},
    ]
    lays = build(scene(layers), 1).source.lays
    box = (-60, -60, 60, 60)
    houses, cars = (lay.things(box) for lay in lays)
    assert len(houses) > 20
    assert len(cars) > 30
    for a, b in ((houses, houses), (houses, cars), (cars, cars)):
        away = np.hypot(a[:, None, Column.EAST] - b[:, Column.EAST], a[:, None, Column.NORTH] - b[:, Column.NORTH])
        reach = a[:, None, 3] + b[:, 3]
        assert (away[away > 0] >= reach[away > 0] - 1e-9).all()


def test_parking_fills_its_share_of_the_bays():
    parking = {"thing": "parking", "at": [[0, 0]], "size": [25, 16], "full": 1.0}
    full = truth_of(parking)
    assert (full.label == Terrain.STRUCTURE).sum() * 0.01 == pytest.approx(20 * 4.3 * 1.78, rel=0.1)
    assert not (truth_of({**parking, "full": 0.0}).label == Terrain.STRUCTURE).any()


def test_every_thing_of_the_list_can_be_used_with_its_defaults():
    needed = {"road": {"path": [[-9, 0], [9, 1]]}, "parking": {"at": [[0, 0]]}}
    needed["wall"] = needed["hedge"] = needed["canal"] = needed["power_line"] = needed["road"]
    needed["stones"] = {"share": 0.1}
    relief = [{"height": 2.0, "longest": 20, "shortest": 2}]
    plain = build(scene(cell=0.05, relief=relief), 0).source.tile(0, 0)
    for name, kind in things().items():
        fields = kind.model_fields
        more = needed.get(name) or ({"per_hectare": 200} if "per_hectare" in fields else {})
        if "upon" in fields:
            more = {**more, "upon": ["short_grass"]}
        a = build(scene([{"thing": name, **more}], cell=0.05, relief=relief), 0).source.tile(0, 0)
        assert not (np.array_equal(a.height, plain.height) and np.array_equal(a.label, plain.label)), name
        assert all(f.description for f in fields.values() if f is not fields["thing"]), name


# -- built-in scenes


@pytest.mark.parametrize("name", list(built_in()))
def test_built_in_scenes_are_sound(name):
    spec = read_scene(built_in()[name])
    assert spec.name == name
    assert 20 < len(spec.description) <= 100
    truth = build(spec, 1).truth((0.5, 0.5, 12.5, 12.5))
    assert np.isfinite(truth.height).all()
    safe = truth.safe(spec.lander.footprint).mean()
    assert safe == 0.0 if name in ("hopeless", "tall_grass") else safe < 0.95


def test_a_scene_says_again_what_it_read(mixed):
    again = Scene.model_validate(mixed.model_dump(mode="json"))
    assert again == mixed


# -- light


def test_shadow_margin_agrees_with_numpy():
    rng = np.random.default_rng(5)
    height = rng.uniform(0, 1, (22, 35)).astype(np.float32)
    height[8:12, 20:23] += 2.0
    tops = np.empty([-(-n // BLOCK) for n in height.shape], np.float32)
    tile_block_tops(height, tops)
    step, limit, out = np.array([0.7, -0.6, 0.08]), 0.5, np.empty((12, 15), np.float32)
    sun_margin(height, tops, 10, 3, float(height.max()), step, limit, out)
    for r in range(12):
        for c in range(15):
            k = np.arange(1, 90)
            x, y, z = 3 + c + k * step[0], 10 + r + k * step[1], float(height[10 + r, 3 + c]) + k * step[2]
            used = (x >= 0) & (y >= 0) & (x <= 34) & (y <= 21) & (z - step[2] < height.max())
            x, y, z = x[used], y[used], z[used]
            i, j = np.minimum(y.astype(int), 20), np.minimum(x.astype(int), 33)
            v, u, h = y - i, x - j, height.astype(float)
            ground = (h[i, j] * (1 - u) + h[i, j + 1] * u) * (1 - v) + (h[i + 1, j] * (1 - u) + h[i + 1, j + 1] * u) * v
            expected = min([limit, *(z - ground)])
            assert out[r, c] == pytest.approx(max(expected, -limit), abs=1e-5)


def test_box_mean_agrees_with_numpy():
    values = np.random.default_rng(2).normal(0, 3, (17, 23)).astype(np.float32)
    out = np.empty_like(values)
    box_mean(values, 3, out)
    for r, c in ((0, 0), (8, 11), (16, 22), (2, 20)):
        part = values[max(r - 3, 0) : r + 4, max(c - 3, 0) : c + 4]
        assert out[r, c] == pytest.approx(part.mean(), abs=1e-5)


def test_fractal_agrees_with_noise_summed_one_by_one():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-900, 900, (2, 5, 4))
    lengths, gains = np.array([7.0, 3.5, 1.75]), np.array([1.0, 0.6, 0.3])
    for form in (ReliefForm.HILLS, ReliefForm.RIDGES):
        out = np.ones_like(x)
        add_fractal(x, y, lengths, gains, form, 17, out)
        expected, c, s = np.ones_like(x), 1.0, 0.0
        for k in range(3):
            u, v = (c * x - s * y) / lengths[k], (s * x + c * y) / lengths[k]
            n = np.vectorize(lambda a, b, k=k: gradient_noise(a, b, 17 + 101 * k)[0])(u, v)
            expected += gains[k] * (n if form == ReliefForm.HILLS else 1.9 * (0.7 - np.abs(n)))
            c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s
        assert np.abs(out - expected).max() < 2e-3  # single precision, some hundred lattice steps apart in a row


def test_the_way_from_a_line_agrees_with_geometry():
    line = np.array([[0.0, 0.0, 0.0, 1.0], [10.0, 0.0, 10.0, 3.0], [10.0, 10.0, 20.0, 3.0]])
    x, y = np.array([[5.0, 12.0, -3.0, 5.0]]), np.array([[2.0, 5.0, 4.0, -60.0]])
    out = np.empty((1, 4, 3))
    along_line(x, y, line, 20.0, out)
    assert np.allclose(out[0, :3, 0], [-2.0, 2.0, -5.0])
    assert np.allclose(out[0, :3, 1], [5.0, 15.0, 0.0])
    assert np.allclose(out[0, :3, 2], [2.0, 3.0, 1.0])
    assert abs(out[0, 3, 0]) == 20.0


# -- truth


def plane_by_plane(height, label, cell, footprint):
    """NumPy twin of `safe_mask`: one least-squares fit a cell."""
    k = int(footprint.radius / cell + 1e-9)
    r, c = np.mgrid[-k : k + 1, -k : k + 1]
    inside = np.hypot(r, c) * cell <= footprint.radius + 1e-9
    arms = np.column_stack([np.ones(inside.sum()), c[inside] * cell, -r[inside] * cell])
    safe = np.zeros(height.shape, bool)
    for i in range(k, height.shape[0] - k):
        for j in range(k, height.shape[1] - k):
            part = np.s_[i - k : i + k + 1, j - k : j + k + 1]
            h = height[part][inside].astype(float)
            if not np.isin(label[part][inside], footprint.classes).all() or not np.isfinite(h).all():
                continue
            fit = np.linalg.lstsq(arms, h, rcond=None)[0]
            steep = math.hypot(fit[1], fit[2]) <= math.tan(footprint.max_slope)
            safe[i, j] = steep and np.abs(h - arms @ fit).max() <= footprint.max_roughness
    return safe


def test_safe_cells_agree_with_a_fit_for_every_cell():
    rng = np.random.default_rng(8)
    x, y = np.meshgrid(np.arange(70) * 0.2, np.arange(60) * 0.2)
    height = (0.16 * x * (x > 5) + 0.1 * np.sin(2 * y) + 400.0 + rng.normal(0, 0.03, x.shape)).astype(np.float32)
    label = np.where(rng.random(x.shape) < 0.004, Terrain.ROCK, Terrain.BARE).astype(np.uint8)
    height[50, 20] = np.nan
    foot = TrueFootprint(radius=0.9, max_slope=math.radians(8.0), max_roughness=0.14)
    mask = safe_mask(height, label, 0.2, foot)
    assert 0.05 < mask.mean() < 0.7
    assert np.array_equal(mask, plane_by_plane(height, label, 0.2, foot))


def test_truth_in_bands_is_truth_in_one(monkeypatch):
    truth = truth_of({"thing": "rocks", "per_hectare": 300}, relief=[{"height": 0.4, "longest": 8}])
    whole = safe_mask(truth.height, truth.label, 0.1, TrueFootprint())
    monkeypatch.setattr("alight_sim.truth.BAND", 37)
    assert np.array_equal(whole, safe_mask(truth.height, truth.label, 0.1, TrueFootprint()))
    assert 0 < whole.mean() < 1


# -- rasters


def put(path, values, crs="EPSG:32633", res=0.5, corner=(400000.0, 5200000.0), **more):
    bands = np.asarray(values) if np.ndim(values) == 3 else np.asarray(values)[None]
    shape = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype.name}
    profile = {
        "driver": "GTiff",
        "crs": crs,
        "transform": rasterio.Affine(res, 0.0, corner[0], 0.0, -res, corner[1]),
        **shape,
        **more,
    }
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(bands)
    return path


@pytest.fixture
def hill():
    y, x = np.mgrid[:200, :240] * 0.5
    return (500.0 + 0.05 * x + 2.0 * np.sin(y / 9.0)).astype(np.float32)


def raster_scene(raster, **more):
    ground = {"raster": {k: str(v) for k, v in raster.items()}, **more.pop("ground", {})}
    return parse_scene({"ground": ground, **more}, "mine.yaml")


def test_a_height_raster_is_a_world(tmp_path, hill):
    local = LocalFrame(47.0, 13.0, 500.0)
    path = put(tmp_path / "h.tif", hill, local.crs, corner=(-60.0, 50.0))
    world = build(raster_scene({"height": path}, origin={"latitude": 47.0, "longitude": 13.0, "height": 500.0}), 0)
    assert world.extent == pytest.approx((-60.0, -50.0, 60.0, 50.0), abs=0.11)
    for east, north in ((0.0, 0.0), (13.3, -20.1), (-41.0, 30.7)):
        x, y = (east + 60.0), (50.0 - north)  # the raster's formula counts from the first cell's centre
        expected = 0.05 * (x - 0.25) + 2.0 * math.sin((y - 0.25) / 9.0)
        assert world.height_at(east, north) == pytest.approx(expected, abs=2e-3)
    assert (world.truth().label == Terrain.BARE).all()
    assert "no classes" in world.warnings[0]


def test_a_world_written_as_a_raster_comes_back(tmp_path):
    first = build("demo", 3)
    box = (-20.0, -20.0, 20.0, 20.0)
    truth, local = first.truth(box), first.local
    e, n = truth.grid.xy()
    fall = (e[None] ** 2 + n[:, None] ** 2) / (2 * 6371008.8)
    corner = (e[0] - 0.05, n[0] + 0.05)
    height = put(tmp_path / "h.tif", (truth.height + local.height + fall).astype(np.float32), local.crs, 0.1, corner)
    classes = put(tmp_path / "c.tif", truth.label, local.crs, 0.1, corner, nodata=0)
    origin = {"latitude": local.latitude, "longitude": local.longitude, "height": local.height}
    again = build(raster_scene({"height": height, "classes": classes}, origin=origin), 0).truth()
    r, c = (round(float(v)) for v in truth.grid.index(np.array(again.grid.east), np.array(again.grid.north)))
    cut = np.s_[r : r + again.grid.rows, c : c + again.grid.cols]
    assert again.height.size > 0.95 * truth.height.size
    assert np.abs(again.height - truth.height[cut]).max() < 2e-4  # heights of 500 m in float32
    assert np.array_equal(again.label, truth.label[cut])


def test_a_raster_in_degrees_lies_where_it_says(tmp_path, hill):
    world = build(raster_scene({"height": put(tmp_path / "d.tif", hill, "EPSG:4326", 5e-6, (13.0, 47.0))}), 0)
    assert world.local.latitude == pytest.approx(47.0 - 100 * 5e-6)
    assert world.local.longitude == pytest.approx(13.0 + 120 * 5e-6)
    width, height = world.extent[2] - world.extent[0], world.extent[3] - world.extent[1]
    assert width == pytest.approx(240 * 5e-6 * 111_320 * math.cos(math.radians(47.0)), abs=1.0)
    assert height == pytest.approx(200 * 5e-6 * 111_170, abs=1.0)


def test_an_orthophoto_colours_the_world_and_things_stand_on_it(tmp_path, hill):
    photo = np.zeros((3, 200, 240), np.uint8)
    photo[0], photo[1], photo[2] = 200, 100, 50
    raster = {"height": put(tmp_path / "h.tif", hill), "image": put(tmp_path / "i.tif", photo)}
    ground = {"size": [30, 30], "layers": [{"thing": "rocks", "at": [[0, 0]], "radius": 1.5}]}
    world = build(raster_scene(raster, ground=ground), 0)
    patch = world.patch((-10, -10, 10, 10))
    plain = patch.look == Look.PLAIN
    assert plain.mean() > 0.9
    assert np.allclose(patch.tint[plain], (np.array([200, 100, 50]) / 255.0) ** 2.2, atol=1e-3)
    assert at(world.truth(), 0.05, 0.05)[1] == Terrain.ROCK


def test_holes_are_filled_or_refused(tmp_path, hill):
    hill[100:104, 100:110] = np.nan
    world = build(raster_scene({"height": put(tmp_path / "few.tif", hill)}), 0)
    truth = world.truth()
    assert np.isfinite(truth.height).all()
    assert 0 < (truth.label == Terrain.UNKNOWN).mean() < 0.01
    assert any("holes" in w for w in world.warnings)
    hill[:, :120] = np.nan
    with pytest.raises(InputError, match=r"many.tif: .* have no height; set a smaller ground.size"):
        build(raster_scene({"height": put(tmp_path / "many.tif", hill)}), 0)


def test_rasters_that_cannot_be_a_world_are_refused_in_one_line(tmp_path, hill):
    good = put(tmp_path / "h.tif", hill)
    far = {"latitude": 10.0, "longitude": 20.0}
    codes = np.full((200, 240), 12, np.uint8)
    cases = [
        ({"height": tmp_path / "none.tif"}, {}, "none.tif: the height raster cannot be read"),
        ({"height": put(tmp_path / "nocrs.tif", hill, None)}, {}, "nocrs.tif: the height raster has no coordinate"),
        ({"height": good}, {"origin": far}, "h.tif: the height raster is far from the scene's origin"),
        ({"height": good}, {"origin": far, "ground": {"size": [40, 40]}}, "h.tif: the height raster does not cover"),
        ({"height": good, "classes": put(tmp_path / "c.tif", codes)}, {}, "c.tif: holds codes that are no classes"),
        ({"height": good, "image": good}, {}, "h.tif: the orthophoto is float32"),
    ]
    for raster, more, message in cases:
        with pytest.raises(InputError, match=re.escape(message)) as e:
            build(raster_scene(raster, **more), 0)
        assert "\n" not in str(e.value)


# -- errors


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({"groud": {}}, "my.yaml: groud: there is no such key; use one of: name, description"),
        ({"ground": {"cells": 1}}, "my.yaml: ground.cells: there is no such key; use one of: size, cell"),
        ({"ground": {"cell": 3}}, "my.yaml: ground.cell: must be at most 0.2, not 3"),
        ({"ground": {"cell": "x"}}, "my.yaml: ground.cell: must be a number"),
        ({"ground": {"cover": "gras"}}, "ground.cover: must be 'bare', 'short_grass'"),
        ({"ground": {"look": "gras"}}, "ground.look: must be one of: by_class, meadow"),
        ({"ground": {"layers": [{"thing": "rokcs"}]}}, "ground.layers.1: no thing is called 'rokcs'; use one of: rou"),
        ({"ground": {"layers": [{"per_hectare": 1}]}}, "ground.layers.1: a layer needs `thing: name`; use one of"),
        (
            {"ground": {"layers": [{"thing": "rocks", "radii": 1}]}},
            "radii: there is no such key; use one of: at, per_h",
        ),
        ({"ground": {"layers": [{"thing": "rocks", "radius": [3, 1]}]}}, "must be one number or [smallest, largest]"),
        ({"ground": {"layers": [{"thing": "trees", "radius": [1.6, "1e200"]}]}}, "radius: must be at most 200"),
        ({"ground": {"layers": [{"thing": "pads", "size": ["1e5", 8.5]}]}}, "size.1: must be at most"),
        ({"ground": {"layers": [{"thing": "road", "path": [[0, 0]]}]}}, "needs two places or more"),
        ({"ground": {"layers": [{"thing": "road", "path": [[0, 0], [1e9, 0]]}]}}, "at most 20000"),
        ({"ground": {"layers": [{"thing": "road", "path": [[0, 0], [2e4, 0]] * 6}]}}, "is longer than 200 km"),
        ({"light": {"elevation_deg": -5}}, "my.yaml: light.elevation_deg: must be more than 3, not -5"),
    ],
)
def test_mistakes_in_a_scene_are_named_in_one_line(tree, message):
    with pytest.raises(InputError, match=re.escape(message)) as e:
        parse_scene(tree, "my.yaml")
    assert "\n" not in str(e.value)


def test_scene_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"no scene is called 'atlantis'; use one of: .*demo"):
        build("atlantis")
    with pytest.raises(InputError, match=r"none.yaml: cannot be read"):
        build(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("ground:\n  size: [1, 2\nlight: {}\n")
    with pytest.raises(InputError, match=r"bad.yaml: not valid YAML at line"):
        build(tmp_path / "bad.yaml")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(InputError, match=r"list.yaml: holds a list"):
        build(tmp_path / "list.yaml")


def test_an_empty_scene_file_is_a_world(tmp_path):
    (tmp_path / "plain.yaml").write_text("")
    world = build(tmp_path / "plain.yaml", 1)
    assert world.name == "plain"
    assert math.isfinite(world.height_at(0.0, 0.0))


def test_a_patch_without_an_area_is_refused():
    world = world_of(Grid(0.0, 0.0, 0.1, 5, 5), np.zeros((5, 5), np.float32))
    for box in ((0.0, 0.0, -1.0, 1.0), (0.0, 0.0, math.inf, 1.0)):
        with pytest.raises(InputError, match="cannot be"):
            world.patch(box)
