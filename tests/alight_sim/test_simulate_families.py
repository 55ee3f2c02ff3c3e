"""Families of scenes: random choices by the seed, the size law of stones, and touchdowns on their objects."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from length import first

from alight.records import InputError, Terrain
from alight_sim.groups import GROUPS, group_of
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.scene import built_in, parse_scene, read_scene
from alight_sim.scene_world import SceneWorld, build
from alight_sim.things.stones import share_above
from alight_sim.truth import SceneTruth
from alight_sim.variation import resolve

FAMILIES = tuple(name for name, path in built_in().items() if "\ndraw:" in path.read_text(encoding="utf-8"))


def flat(*layers: dict[str, Any], size: float = 20.0, seed: int = 0, **ground: Any) -> SceneWorld:
    tree = {"ground": {"cell": 0.05, "size": [size, size], "relief": [{"height": 0}], "layers": list(layers), **ground}}
    return build(parse_scene(tree, "test.yaml"), seed)


def at(truth: SceneTruth, east: float, north: float) -> tuple[float, Terrain, bool]:
    """Return height, class and safety of the cell at a place."""
    r, c = (int(np.rint(v)) for v in truth.grid.index(np.array(east), np.array(north)))
    return float(truth.height[r, c]), Terrain(int(truth.label[r, c])), bool(truth.safe()[r, c])


# -- random choices


def test_draws_are_put_in_by_name_and_differ_from_seed_to_seed() -> None:
    tree = {
        "draw": {
            "sun": {"between": [10, 20]},
            "size": {"between": [1, 100], "log": True},
            "more": {"one_of": [[{"thing": "roughness", "height": "$sun"}]]},
            "none": {"one_of": [None]},
            "colour": {"one_of": [[1, 2, 3]]},
        },
        "a": ["$none", "$more", {"b": "$colour", "c": ["$size", 5]}],
    }
    found = [resolve(tree, seed, "x") for seed in range(40)]
    for one in found:
        assert set(one) == {"a"}
        assert one["a"][0]["thing"] == "roughness"
        assert 10 <= one["a"][0]["height"] <= 20
        assert one["a"][1]["b"] == [1, 2, 3]
        assert 1 <= one["a"][1]["c"][0] <= 100
        assert one["a"][1]["c"][1] == 5
    assert len({one["a"][0]["height"] for one in found}) == 40
    assert 5 < np.median([one["a"][1]["c"][0] for one in found]) < 20
    assert found[7] == resolve(tree, 7, "x")


def test_a_further_draw_moves_none_of_the_others() -> None:
    draw = {"a": {"between": [0, 1]}}
    more = {"b": {"between": [0, 1]}, **draw}
    assert resolve({"draw": draw, "x": "$a"}, 3, "")["x"] == resolve({"draw": more, "x": "$a"}, 3, "")["x"]


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        ({"a": {"between": [1]}}, "draw.a: must be"),
        ({"a": {"one_of": []}}, "draw.a: must be"),
        ({"a": {"between": [0, 1], "log": True}}, "draw.a: must be"),
        ([1], "draw: must be names"),
        ({"b": {"one_of": [1]}}, "nothing of this name is drawn; use one of: b"),
    ],
)
def test_wrong_draws_are_refused(draw: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_scene({"draw": draw, "flight": {"height": "$a"}}, "my.yaml")


def test_values_that_name_each_other_in_a_circle_are_refused() -> None:
    with pytest.raises(InputError, match="nothing of this name"):
        resolve({"draw": {"a": {"one_of": ["$b"]}, "b": {"one_of": ["$a"]}}, "x": "$a"}, 0, "x")


@pytest.mark.parametrize("name", first(1, FAMILIES))
def test_a_family_can_be_read_for_every_seed_and_its_sun_is_low_and_high(name: str) -> None:
    scenes = [read_scene(built_in()[name], seed) for seed in range(1, 60)]
    sun = np.array([s.light.elevation_deg for s in scenes])
    assert 12 <= sun.min() < 20
    assert 57 < sun.max() <= 65
    assert len({str(s.ground.layers) for s in scenes}) == len(scenes)
    assert read_scene(built_in()[name], 5) == scenes[4]


def test_a_family_that_is_written_down_makes_the_same_ground_again() -> None:
    world = build("depot", 4)
    assert world.scene is not None
    again = build(parse_scene(world.scene.model_dump(mode="json"), "again.yaml"), 4)
    box = (-6.0, -6.0, 6.0, 6.0)
    assert np.array_equal(world.truth(box).height, again.truth(box).height)
    assert np.array_equal(world.truth(box).label, again.truth(box).label)


def test_every_family_is_in_one_of_ten_groups_of_three_or_more() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted([*grouped, "demo", "hopeless"]) == list(built_in())
    assert len(GROUPS) == 10
    assert min(len(names) for names in GROUPS.values()) >= 3
    assert (group_of("bog"), group_of("yard")) == ("water", "ruin")
    with pytest.raises(KeyError):
        group_of("demo")


# -- stones


@pytest.mark.parametrize("form", ["round", "angular"])
@pytest.mark.parametrize("k", [0.03, 0.2])
def test_the_share_of_the_ground_under_stones_follows_the_law(form: str, k: float) -> None:
    layer = {"thing": "stones", "share": k, "form": form, "rock_from": 0.3}
    world = flat(layer, size=76.0, seed=2, cover="bare")
    source: Any = world.source
    things = source.lays[0].things(world.extent)
    things = things[(np.abs(things[:, [Column.EAST, Column.NORTH]]) < 38.0).all(axis=1)]
    for diameter in (0.1, 0.2, 0.3, 0.5, 0.8):
        many = things[things[:, Column.EXTRA] >= diameter]
        area = math.pi * many[:, Column.HALF_U] * many[:, Column.HALF_V]
        law = share_above(diameter, k) - share_above(2.0, k)
        sampling = math.sqrt(float((area**2).sum()) + diameter**4) / 76.0**2
        assert area.sum() / 76.0**2 == pytest.approx(law, abs=3.5 * sampling), diameter
    truth = world.truth()
    found = (truth.label == Terrain.ROCK).mean()  # stones partly hide each other
    law = 1.0 - math.exp(-(share_above(0.3, k) - share_above(2.0, k)))
    assert found == pytest.approx(law, rel=0.2)
    covered = 1.0 - math.exp(-(share_above(0.1, k) - share_above(2.0, k)))
    assert (truth.height > 0.0).mean() == pytest.approx(covered, rel=0.2)


def test_stones_lie_denser_here_than_there_and_the_large_ones_are_thinned_more() -> None:
    world = flat({"thing": "stones", "share": [0.01, 0.2], "patch": 15, "height": [0.4, 0.6]}, size=150.0, seed=4)
    source: Any = world.source
    lay = source.lays[0]
    things = lay.things(world.extent)
    k = lay.layer.share_at(things[:, Column.EAST], things[:, Column.NORTH], lay.seed)
    rng = np.random.default_rng(0)
    ground = rng.uniform(-75, 75, (40_000, 2))
    everywhere = lay.layer.share_at(ground[:, 0], ground[:, 1], lay.seed)
    for low, high in pairwise((0.01, 0.03, 0.08, 0.2)):
        here, inside = (k >= low) & (k < high), (everywhere >= low) & (everywhere < high)
        metres = inside.mean() * 150.0**2
        law = np.mean([share_above(0.15, v) - share_above(2.0, v) for v in everywhere[inside][:4000]])
        large = things[here & (things[:, Column.EXTRA] >= 0.15)]
        area = math.pi * large[:, Column.HALF_U] * large[:, Column.HALF_V]
        assert area.sum() / metres == pytest.approx(law, rel=0.25), (low, high)


def test_a_stone_is_as_high_as_its_size_says_and_a_touchdown_on_it_is_unsafe() -> None:
    stone = {"thing": "stones", "size": 0.3, "height": 0.6}
    for form in ("round", "angular"):
        truth = flat({**stone, "at": [[0, 0]], "form": form}).truth()
        high, kind, safe = at(truth, 0.0, 0.0)
        assert kind == Terrain.ROCK
        assert high == pytest.approx(0.18, rel=0.2)
        assert not safe
        area = (truth.label == Terrain.ROCK).sum() * 0.05**2
        assert area == pytest.approx(0.25 * math.pi * 0.3**2, rel=0.25)
        assert at(truth, 1.3, 0.0) == (0.0, Terrain.SHORT_GRASS, False)
        assert at(truth, 2.0, 0.0) == (0.0, Terrain.SHORT_GRASS, True)


def test_a_small_stone_is_ground_with_its_true_height() -> None:
    truth = flat({"thing": "stones", "at": [[0, 0]], "size": 0.18, "height": 0.5}, cover="bare").truth()
    high, kind, safe = at(truth, 0.0, 0.0)
    assert (kind, safe) == (Terrain.BARE, True)
    assert high == pytest.approx(0.09, rel=0.25)


def test_stones_look_like_the_ground_that_they_lie_on_or_as_they_are_told() -> None:
    ground = {"cover": "bare", "look": "fine_gravel", "tint": [0.5, 0.6, 0.7]}
    world = flat({"thing": "stones", "share": 0.2, "shades": 0.1}, **ground)
    patch = world.patch((-5, -5, 5, 5))
    assert patch.look is not None
    assert patch.tint is not None
    assert len(np.unique(patch.look)) == 1
    stones = patch.label == Terrain.ROCK
    assert stones.mean() > 0.05
    hue = patch.tint[stones] / patch.tint[stones][:, :1]
    assert hue == pytest.approx(np.broadcast_to([1.0, 1.2, 1.4], hue.shape), rel=1e-5)
    assert 0.03 < np.log(patch.tint[stones][:, 0] / 0.5).std() < 0.2
    told = flat({"thing": "stones", "share": 0.2, "look": "rock", "hidden": 0.5}, **ground).patch((-5, -5, 5, 5))
    assert told.look is not None
    of_rock = (told.look != patch.look.flat[0])[told.label == Terrain.ROCK].mean()
    assert 0.2 < of_rock < 0.8  # the rest has the look of the ground


def test_stones_keep_off_a_cleared_track() -> None:
    road = {"thing": "road", "path": [[-30, 0], [30, 0]], "width": 4, "kind": "bare", "look": "packed_gravel"}
    stones = {"thing": "stones", "share": 0.2, "not_on": ["packed_gravel"]}
    truth = flat(road, stones, cover="bare").truth((-8, -1.5, 8, 1.5))
    assert truth.height.max() < 1e-6
    assert flat(road, {**stones, "not_on": []}, cover="bare").truth((-8, -1.5, 8, 1.5)).height.max() > 0.1


@pytest.mark.parametrize(
    ("keys", "words"),
    [({"per_hectare": 5}, "leave per_hectare out"), ({"share": 0.7}, "no more than 0.6")],
)
def test_stones_that_cannot_be_are_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        flat({"thing": "stones", **keys})


# -- bars, sheets, raised patches, painted lines


def test_a_bundle_has_its_bars_side_by_side_and_a_stack_is_as_high_as_its_rows() -> None:
    bars = {"thing": "bars", "at": [[0, 0]], "length": 4, "turn_deg": 0}
    bundle = flat({**bars, "thickness": 0.02, "gap": 0.5, "count": 5}).truth()
    column = (bundle.label == Terrain.STRUCTURE)[:, 200]
    assert (np.diff(column.astype(int)) == 1).sum() == 5
    assert bundle.height[bundle.label == Terrain.STRUCTURE].max() <= 0.02
    stack = flat({**bars, "thickness": 0.4, "count": 4, "rows": 3}).truth()
    assert stack.height.max() == pytest.approx(0.4 * (1 + 2 * 0.87), rel=0.01)
    assert (stack.label == Terrain.STRUCTURE).sum() * 0.05**2 == pytest.approx(4 * 1.6, rel=0.15)


def test_bars_on_end_stand_apart_as_high_as_they_are_long() -> None:
    truth = flat({"thing": "bars", "at": [[0, 0]], "upright": True, "length": 0.7, "gap": 1, "count": 3}).truth()
    steel = truth.label == Terrain.STRUCTURE
    assert 3 <= steel.sum() <= 27
    assert 0.35 <= truth.height[steel].max() <= 0.7
    assert not truth.safe()[steel].any()


def test_a_sheet_lies_over_the_ground_and_over_low_things() -> None:
    pallet = {"thing": "crates", "at": [[0, 0]], "size": 1, "height": 0.15}
    sheet = {"thing": "tarpaulins", "at": [[0, 0]], "size": 4, "folds": 0.03}
    truth = flat(pallet, sheet).truth()
    covered = truth.label == Terrain.STRUCTURE
    assert covered.sum() * 0.05**2 == pytest.approx(16, rel=0.1)
    assert truth.height[covered].min() > 0.005
    assert truth.height.max() == pytest.approx(0.17, abs=0.03)


@pytest.mark.parametrize("veins", [False, True])
@pytest.mark.parametrize("up", [0.3, -0.4])
def test_raised_patches_cover_their_share_and_have_flanks(veins: bool, up: float) -> None:
    patches = {"thing": "patches", "share": 0.2, "size": 4, "up": up, "flank": 0.3, "veins": veins}
    truth = flat(patches, size=80.0, cell=0.1).truth()
    there = truth.label == Terrain.BARE
    assert there.mean() == pytest.approx(0.2, abs=0.05)
    assert (truth.height[~there] == 0.0).all()
    high = truth.height[there] / up
    assert 0.0 <= high.min() < 0.2
    assert (high > 0.99).mean() > 0.3
    assert high.max() == pytest.approx(1.0)


def test_a_raised_patch_is_an_island_in_water() -> None:
    patches = {"thing": "patches", "share": 0.3, "size": 4, "up": 0.2, "upon": ["water"]}
    world = flat({"thing": "water", "level": 1}, patches, cell=0.1)
    patch = world.patch(world.extent)
    assert ((patch.light[..., 4] > 0) == (patch.label == Terrain.WATER)).all()
    assert patch.height[patch.label == Terrain.BARE].min() >= 1.0


def test_a_line_is_moved_and_turned_as_a_whole() -> None:
    wall = {"thing": "wall", "height": 1, "look": "white"}
    moved = flat({**wall, "path": [[-2, 1], [3, 1]], "at": [4, 2], "turn_deg": 90}).truth()
    plain = flat({**wall, "path": [[3, 0], [3, 5]]}).truth()
    assert np.allclose(moved.height, plain.height, atol=1e-6)


def test_ruts_hold_water_for_their_share_and_lanes_are_painted() -> None:
    road = {"thing": "road", "path": [[-90, 0], [90, 0]], "width": 3, "ruts": 0.12, "ragged": 0, "flooded": 0.4}
    truth = flat(road, size=160.0, cell=0.1).truth()
    wet = truth.label == Terrain.WATER
    assert wet.any(axis=0).mean() == pytest.approx(0.4, abs=0.2)
    assert truth.height[wet].max() < 0.0
    track = flat({"thing": "road", "path": [[-90, 0.02], [90, 0.02]], "width": 6.1, "marks": "lanes", "look": "plain"})
    patch = track.patch((-1, -3, 1, 3))
    assert patch.tint is not None
    white = (patch.tint[:, 20, 0] > 2.0).astype(int)
    assert (np.diff(white) == 1).sum() in (5, 6)


def test_dunes_lie_as_they_are_turned() -> None:
    dunes = {"height": 1, "longest": 6, "shortest": 6, "form": "dunes"}
    plain, turned = (flat(relief=[{**dunes, "turn_deg": k}], cell=0.1).truth().height for k in (0, 90))
    for height, steep in ((plain, 1), (turned, 0)):
        slopes = [np.abs(np.diff(height, axis=axis)).mean() for axis in (0, 1)]
        assert slopes[steep] > 2.0 * slopes[1 - steep]


# -- water that looks like ground, wires, posts


@pytest.mark.parametrize("covered", [0.0, 1.0])
def test_a_canal_is_level_water_below_both_banks_whatever_covers_it(covered: float) -> None:
    canal = {"thing": "canal", "path": [[-60, 0], [60, 0]], "width": 4, "below": 0.7, "bank": 1.0, "covered": covered}
    waves = [{"height": 0.1, "longest": 60, "shortest": 20}]
    world = flat(canal, relief=waves, size=30.0, cell=0.1)
    truth = world.truth()
    water = truth.label == Terrain.WATER
    assert water.mean() == pytest.approx(4.0 / 30.0, rel=0.1)
    rows = np.flatnonzero(water.any(axis=1))
    assert (np.diff(rows) == 1).all()
    for side in (0, -1):
        assert water[:, side].any()  # it leaves the map at both ends
    north = truth.grid.xy()[1]
    bank = (np.abs(north) > 3.4) & (np.abs(north) < 4.0)
    for column in range(0, 300, 25):
        level = truth.height[water[:, column], column]
        assert np.ptp(level) < 0.01
        both = truth.height[bank, column]
        assert both.min() > level.max() + 0.3
    assert not truth.safe()[np.abs(north) < 3.0].any()
    patch = world.patch((-10, -1.5, 10, 1.5))
    assert patch.look is not None
    looks = patch.look[patch.label == Terrain.WATER]
    assert (looks == Look.DUCKWEED).all() if covered else (looks != Look.DUCKWEED).all()


def test_a_canal_covered_in_part_is_open_in_part() -> None:
    canal = {"thing": "canal", "path": [[-60, 0], [60, 0]], "width": 12, "covered": 0.5, "cover_size": 2}
    patch = flat(canal, size=60.0, cell=0.1).patch((-25, -4, 25, 4))
    assert patch.look is not None
    found = (patch.look == Look.DUCKWEED)[patch.label == Terrain.WATER]
    assert found.mean() == pytest.approx(0.5, abs=0.15)


def test_a_winding_line_keeps_its_width_and_strays_as_it_is_told() -> None:
    hose = {"thing": "wall", "path": [[-60, 0], [60, 0]], "height": 0.06, "thickness": 0.2, "wander": 1.5}
    truth = flat(hose, size=60.0).truth()
    there = truth.label == Terrain.STRUCTURE
    assert there.any(axis=0).all()
    north = truth.grid.xy()[1]
    middle = np.array([north[column].mean() for column in there.T])
    assert 0.5 < middle.std() < 3.0
    steep = np.hypot(1.0, np.gradient(middle, 0.05))
    width = there.sum(axis=0) * 0.05 / steep
    assert np.median(width) == pytest.approx(0.2, abs=0.05)
    assert truth.height[there].max() == pytest.approx(0.06, abs=1e-3)


def test_wire_between_posts_is_unsafe_though_it_raises_nothing() -> None:
    fence = {"thing": "wall", "path": [[-60, 0], [60, 0]], "height": 1.2, "thickness": 0.1, "posts": 3.0}
    wired, plain = flat({**fence, "wire": True}).truth(), flat(fence).truth()
    assert np.array_equal(wired.height, plain.height)
    assert (wired.label == Terrain.STRUCTURE).any(axis=0).all()
    row = int(np.rint(wired.grid.index(np.array(0.0), np.array(0.0))[0]))
    assert not wired.safe()[row - 10 : row + 10].any()
    assert (plain.label == Terrain.STRUCTURE).any(axis=0).mean() < 0.1


def test_puddles_cover_their_share_and_their_mud_is_water_too() -> None:
    puddles = {"thing": "puddles", "share": 0.2, "size": 3, "mud": 0.4, "look": "still_water"}
    patch = flat(puddles, size=80.0, cell=0.1).patch((-39, -39, 39, 39))
    assert patch.look is not None
    open_water = patch.look == Look.STILL_WATER
    assert open_water.mean() == pytest.approx(0.2, abs=0.04)
    mud = patch.look == Look.MUD
    assert 0.03 < mud.mean() < 0.2
    assert np.array_equal(patch.label == Terrain.WATER, open_water | mud)
    assert np.ptp(patch.height[open_water]) < 1e-6
    assert patch.height[open_water].max() < patch.height.max() - 0.03


@pytest.mark.parametrize("name", first(1, sorted(FAMILIES)))
def test_a_family_has_safe_places_and_dangers_over_its_seeds(name: str) -> None:
    shares = []
    for seed in (1, 2, 3):
        truth = build(name, seed).truth((-20.0, -20.0, 20.0, 20.0))
        shares.append(truth.safe()[30:-30, 30:-30].mean())
    assert max(shares) > 0.01
    assert max(shares) < 0.9


def test_grass_is_tall_from_a_height_on() -> None:
    grass = {"thing": "tall_grass", "share": 0.4, "height": 0.5, "size": 3}
    all_tall, some = (flat({**grass, "tall_from": k}, cell=0.1).truth() for k in (0.0, 0.12))
    assert np.array_equal(all_tall.height, some.height)
    grown = all_tall.label == Terrain.TALL_VEGETATION
    tall = some.label == Terrain.TALL_VEGETATION
    assert np.array_equal(tall, grown & (some.height >= np.float32(0.12)))
    assert 0 < tall.sum() < grown.sum()
