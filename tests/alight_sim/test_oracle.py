"""The true lander on the true surface: closed forms, bodies, and the share of places that is safe."""

import math

import numpy as np
import pytest

from alight.geometry import Grid, Pose
from alight.records import Terrain
from alight.settings import Settings
from alight_sim import world_of
from alight_sim.campaign import campaign_worlds
from alight_sim.oracle import OracleLander, judge_touchdown, safe_places
from alight_sim.steered import Body

CELL, HALF = 0.1, 60  # metres, cells on either side of the middle
GRID = Grid(-HALF * CELL, HALF * CELL, CELL, 2 * HALF + 1, 2 * HALF + 1)
EAST, NORTH = np.meshgrid(*GRID.xy())
FEET = ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))  # around
LEGGED = OracleLander(radius=0.8, feet=FEET, belly_clearance=0.25, max_slope=math.radians(10.0))
SKIDDED = OracleLander(radius=0.8, skids=(1.6, 1.0), belly_clearance=0.25)


def ground(height, label=None):
    codes = np.full(GRID.shape, Terrain.BARE, np.uint8)
    if label is not None:
        codes[label] = Terrain.WATER
    return world_of(GRID, np.broadcast_to(height, GRID.shape).astype(np.float32), codes)


def down_at(east=0.0, north=0.0, heading=0.0):
    """Body pose at a place, with the nose `heading` clockwise from north."""
    s, c = math.sin(heading), math.cos(heading)
    return Pose(np.array([[s, -c, 0.0], [c, s, 0.0], [0.0, 0.0, 1.0]]), np.array([east, north, 0.3]))


@pytest.mark.parametrize("lander", [OracleLander(), LEGGED, SKIDDED], ids=["disc", "feet", "skids"])
@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_a_plane_has_its_slope_and_nothing_else(lander, heading):
    for slope_deg, safe in ((9.5, True), (10.5, False)):
        world = ground(math.tan(math.radians(slope_deg)) * (0.6 * EAST + 0.8 * NORTH))
        got = judge_touchdown(world, lander, down_at(0.33, -0.21, heading))
        assert math.degrees(got.tilt) == pytest.approx(slope_deg, abs=1e-3)
        assert got.roughness < 1e-5
        assert got.belly_gap == pytest.approx(lander.belly_clearance or 0.0, abs=1e-5)
        assert (got.safe, got.reasons) == ((True, ()) if safe else (False, ("slope",)))


def test_a_step_under_one_foot_rocks_about_the_diagonal_through_it():
    """The lander stands on the raised foot and the opposite one, and tips to another one: the tilt of that plane."""
    step = 0.12
    world = ground(np.where((EAST > 0.3) & (NORTH > 0.3), step, 0.0))
    got = judge_touchdown(world, LEGGED, down_at())
    # feet at (0.5, 0.5) up, two more on the ground: the plane through them rises along one side alone
    assert math.tan(got.tilt) == pytest.approx(step / 1.0, rel=1e-6)
    assert got.safe
    assert not judge_touchdown(ground(np.where((EAST > 0.3) & (NORTH > 0.3), 0.2, 0.0)), LEGGED, down_at()).safe


def test_four_feet_that_straddle_a_diagonal_rest_on_three():
    world = ground(np.where((EAST > 0.3) & (NORTH > 0.0), 0.1, 0.0))  # one side is high in front: north-eastern foot
    level = judge_touchdown(ground(np.where(EAST > 0.0, 0.1, 0.0)), LEGGED, down_at())
    assert math.tan(level.tilt) == pytest.approx(0.1, rel=1e-6)  # both eastern feet: 0.1 m over 1 m, no rocking
    assert judge_touchdown(world, LEGGED, down_at()).tilt == pytest.approx(level.tilt, rel=1e-6)


@pytest.mark.parametrize("lander", [LEGGED, SKIDDED], ids=["feet", "skids"])
def test_a_stone_under_the_belly_counts_by_the_clearance(lander):
    for stone, safe in ((0.24, True), (0.26, False)):
        height = np.zeros(GRID.shape)
        height[HALF, HALF] = stone  # one cell: a stone of 0.1 m
        got = judge_touchdown(ground(height), lander, down_at(0.03, 0.04))
        assert got.belly_gap == pytest.approx(0.25 - stone, abs=1e-6)
        assert got.safe == safe
        assert got.reasons == (() if safe else ("belly",))


def test_skids_rock_over_a_ridge_between_their_ends_and_both_ends_are_judged():
    ridge = 0.1
    world = ground(np.where(np.abs(NORTH) < 0.04, ridge, 0.0))
    got = judge_touchdown(world, SKIDDED, down_at())
    assert math.tan(got.tilt) == pytest.approx(ridge / 0.8, rel=1e-3)  # tilted until an end of the rails is down


def test_without_gear_the_roughness_of_the_whole_footprint_counts():
    height = np.zeros(GRID.shape)
    height[HALF + 3, HALF - 4] = 0.17
    got = judge_touchdown(ground(height), OracleLander(), down_at())
    assert got.reasons == ("roughness",)
    assert 0.15 < got.roughness < 0.17
    assert judge_touchdown(ground(height), OracleLander(), down_at(3.0, 3.0)).safe


def test_what_stands_beside_the_footprint_is_for_the_rotor():
    post = np.zeros(GRID.shape)
    post[HALF, HALF + 10] = 0.5  # 1 m to the east
    wide = OracleLander(radius=0.8, feet=FEET, belly_clearance=0.25, rotor_radius=1.2)
    got = judge_touchdown(ground(post), wide, down_at())
    assert got.reasons == ("rotor",)
    assert got.rotor_rise == pytest.approx(0.5, abs=1e-6)
    assert judge_touchdown(ground(post), LEGGED, down_at()).safe


def test_water_bears_no_foot_but_may_lie_below_the_belly():
    puddle = np.hypot(EAST, NORTH) < 0.3
    assert judge_touchdown(ground(0.0, puddle), LEGGED, down_at()).safe
    got = judge_touchdown(ground(0.0, puddle), LEGGED, down_at(0.5, 0.5))
    assert got.reasons == ("ground",)
    assert judge_touchdown(ground(0.0, puddle), OracleLander(), down_at()).reasons == ("ground",)


def test_sink_and_drift_have_limits_of_their_own():
    world = ground(0.0)
    assert judge_touchdown(world, LEGGED, down_at(), (0.3, 0.3, -0.9)).safe
    assert judge_touchdown(world, LEGGED, down_at(), (0.0, 0.0, -1.1)).reasons == ("sink",)
    assert judge_touchdown(world, LEGGED, down_at(), (0.4, 0.4, -0.5)).reasons == ("drift",)


def test_bodies_are_there_when_they_are_there():
    world, car = ground(0.0), [Body(True, (0.0, 0.0), (0.0, 0.0), 5.0, 5.0, 0.0, lambda e, n: 0.0)]
    assert judge_touchdown(world, LEGGED, down_at(0.0, 1.5), seconds=4.0, bodies=car).safe
    got = judge_touchdown(world, LEGGED, down_at(0.0, 1.5), seconds=6.0, bodies=car)
    assert "belly" in got.reasons  # the car is 1.8 m wide: beside two feet
    assert judge_touchdown(world, LEGGED, down_at(0.0, 2.0), seconds=6.0, bodies=car).safe


def test_a_grid_of_places_says_what_single_touchdowns_say():
    rng = np.random.default_rng(3)
    world = ground(0.12 * rng.random(GRID.shape) * (EAST > 0) + 0.3 * (NORTH > 2.0))
    for lander in (OracleLander(), LEGGED, SKIDDED):
        places = safe_places(world, (-3.0, -3.0, 3.0, 3.0), lander, step=1.0, headings=2)
        for r, north in enumerate(places.north):
            for c, east in enumerate(places.east):
                one = [judge_touchdown(world, lander, down_at(east, north, h)).safe for h in places.headings]
                assert one == places.safe_at[r, c].tolist()
        assert places.safe.any()
        assert not places.safe.all()


def test_a_margin_takes_the_places_beside_unsafe_ones_away():
    places = safe_places(ground(0.0, EAST > 1.0), (-4.0, -4.0, 4.0, 4.0), OracleLander(), step=0.5)
    edge = places.east[places.safe.any(axis=0)].max()
    assert edge == pytest.approx(-0.5)  # 1.5 m from the water
    inner = places.with_margin(1.0)
    assert places.east[inner.any(axis=0)].max() == pytest.approx(edge - 1.0)
    assert inner.sum() < places.safe.sum()


@pytest.mark.parametrize("name", ["lake", "rubble", "closed_forest", "tall_grass", "meadow"])
def test_kinds_without_a_safe_place_have_none(name):
    kind = campaign_worlds()[name]
    places = safe_places(kind.build(3), (-20.0, -20.0, 20.0, 20.0), OracleLander(radius=1.0), step=2.0)
    assert places.safe.any() == kind.safe


def test_a_step_has_a_limit_of_its_own_where_one_is_set():
    world = ground(np.where(EAST > 0.3, 0.08, 0.0))
    for most, reasons in ((None, ()), (0.1, ()), (0.05, ("step",))):
        assert judge_touchdown(world, OracleLander(max_step=most), down_at()).reasons == reasons
        beside = judge_touchdown(world, OracleLander(max_step=most), down_at(east=-1.4))
        assert beside.safe  # the step is beyond the rim
    ramp = ground(0.1 * EAST)
    assert judge_touchdown(ramp, OracleLander(max_step=0.011), down_at()).safe
    assert not judge_touchdown(ramp, OracleLander(max_step=0.009), down_at()).safe


def test_every_limit_of_a_lander_is_judged_or_left_aside_by_name():
    """A new limit is not ignored silently."""
    with pytest.raises(TypeError):
        OracleLander.of({"radius": 0.9, "max_hum": 3.0})
    assert OracleLander.of(Settings().lander.model_dump()).max_step is None


def test_settings_of_a_lander_are_taken_by_name():
    numbers = {"radius": 0.9, "feet": FEET, "foot_contact": "highest", "headings": 8, "max_step": None}
    lander = OracleLander.of(numbers, max_sink=0.7)
    assert (lander.radius, lander.feet, lander.max_sink) == (0.9, FEET, 0.7)
