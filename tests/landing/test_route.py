"""The route clears everything mapped by its margin, or names the obstacles that it crosses."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import some_run
from ground import ground
from numpy.testing import assert_allclose

from alight.landing import route
from alight.records import ElevationMap, Flag, Route, Site
from alight.settings import RouteSettings, load_settings

SETTINGS = RouteSettings(approach_height=10.0, clearance=3.0)


def site(east: float, north: float, up: float = 0.0) -> Site:
    return replace(some_run.site(1, east, north), up=up, heading=0.5)


def path(r: Route, until: str) -> np.ndarray:
    """Return points of the line, every few centimetres, up to the way-point of that name."""
    names = [w.name for w in r.waypoints]
    corners = [w.position_world for w in r.waypoints[: names.index(until) + 1]]
    pieces = [a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(corners)]
    return np.concatenate(pieces)


def least_gap(r: Route, e: ElevationMap, clearance: float, start_climb: bool) -> float:
    """Smallest height of the line above the ground within `clearance` beside it, until the descent over the site."""
    line = path(r, "approach")
    if start_climb:  # the vehicle's position is given: the climb itself is not judged
        line = line[400:]
    east, north = e.grid.xy()
    x, y = np.meshgrid(east, north)
    top = np.where(e.trusted, e.height + 2 * e.sigma, -np.inf)
    over_site = np.hypot(line[:, 0] - line[-1, 0], line[:, 1] - line[-1, 1]) < 0.05
    gaps = [p[2] - top[np.hypot(x - p[0], y - p[1]) <= clearance].max(initial=-np.inf) for p in line[~over_site][::7]]
    return min(gaps)


@pytest.mark.parametrize("seed", range(6))
def test_the_line_clears_everything_mapped(seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = np.zeros((101, 141))
    for _ in range(12):
        r, c = rng.integers(0, 95), rng.integers(20, 135)
        z[r : r + 6, c : c + 6] = rng.uniform(0, 18)
    z[40:61, 110:131] = 0.0
    e = ground(z, cell=0.5, sigma=0.1)
    start = np.array([5.0, rng.uniform(5, 45), rng.uniform(2, 25)])
    got = route.plan_route(site(60.0, 25.0), e, start, SETTINGS)
    climbs = any(w.name == "climb" for w in got.waypoints)
    assert least_gap(got, e, SETTINGS.clearance, climbs) >= SETTINGS.clearance - 0.1  # half a cell of sideways rounding
    assert_allclose(got.waypoints[-1].position_world, [60.0, 25.0, 0.0])


def test_from_above_the_line_slopes_straight_to_the_approach() -> None:
    e = ground(np.zeros((101, 141)), cell=0.5)
    got = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 30.0]), SETTINGS)
    assert [w.name for w in got.waypoints] == ["start", "approach", "inspect", "touchdown"]
    assert_allclose([w.position_world[2] for w in got.waypoints], [30.0, 10.0, 5.0, 0.0])
    assert [w.look for w in got.waypoints] == [False, True, True, False]
    assert got.warnings == ()
    length = math.hypot(55.0, 20.0)
    assert_allclose([w.t for w in got.waypoints], np.array([0, length / 5, length / 5 + 5, length / 5 + 10]))
    assert_allclose(got.waypoints[1].heading, math.pi / 2)
    assert_allclose(got.waypoints[-1].heading, 0.5)  # straight down: the site's own heading
    assert [w.speed for w in got.waypoints] == [0.0, 5.0, 1.0, 1.0]


def test_a_tree_on_the_way_keeps_the_line_level() -> None:
    z = np.zeros((101, 141))
    z[48:53, 80:84] = 20.0
    e = ground(z, cell=0.5)
    got = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 30.0]), SETTINGS)
    assert_allclose(got.waypoints[1].position_world, [60.0, 25.0, 30.0])
    low = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 8.0]), SETTINGS)
    assert low.waypoints[1].name == "climb"
    assert_allclose(low.waypoints[1].position_world, [5.0, 25.0, 23.0])
    assert "climbs 15.0 m" in low.warnings[0]


@pytest.mark.parametrize(("height", "beside", "told"), [(6.5, 2.5, True), (2.0, 2.5, False), (6.5, 4.5, False)])
def test_a_way_down_beside_what_is_tall_is_warned_of(height: float, beside: float, told: bool) -> None:
    """The vehicle drifts while it comes down, so that 3 m are required also beside the last leg."""
    z = np.zeros((101, 141))
    z[50, round((60.0 + beside) / 0.5)] = height
    got = route.plan_route(site(60.0, 25.0), ground(z, cell=0.5), np.array([5.0, 25.0, 30.0]), SETTINGS)
    assert any("m high is what stands within 3 m of the way down" in w for w in got.warnings) is told


def test_unknown_ground_may_be_as_high_as_anything_known() -> None:
    z = np.zeros((101, 141))
    z[5:8, 5:8] = 40.0  # far off the track
    z[:, 60:70] = np.nan
    got = route.plan_route(site(60.0, 25.0), ground(z, cell=0.5), np.array([5.0, 25.0, 30.0]), SETTINGS)
    assert any("not mapped" in w for w in got.warnings)
    assert max(w.position_world[2] for w in got.waypoints) >= 43.0


@pytest.mark.parametrize("flag", [Flag.SATURATED, Flag.UNSEEN])
def test_unknown_ground_beside_the_way_counts_as_well(flag: Flag) -> None:
    """A tower of 2 x 2.5 m, 1 m beside the way, has no measured height; something of 40 m stands far off."""
    z = np.zeros((101, 141))
    z[5:8, 5:8] = 40.0
    e = ground(z, cell=0.5)
    e.flags[43:48, 80:84] |= np.uint16(flag)
    e.height[43:48, 80:84] = np.nan if flag == Flag.UNSEEN else 18.0
    got = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 14.0]), SETTINGS)
    assert any("not mapped" in w for w in got.warnings)
    assert max(w.position_world[2] for w in got.waypoints) >= 43.0


@pytest.mark.parametrize("hole", [(slice(45, 46), slice(80, 84)), (slice(30, 43), slice(60, 100))])
def test_small_holes_beside_the_way_and_holes_farther_off_change_nothing(hole: tuple[slice, slice]) -> None:
    e = ground(np.zeros((101, 141)), cell=0.5)
    e.flags[hole] |= np.uint16(Flag.UNSEEN)
    e.height[hole] = np.nan
    got = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 14.0]), SETTINGS)
    assert got.warnings == ()
    assert [w.name for w in got.waypoints] == ["start", "approach", "inspect", "touchdown"]


def test_the_rim_of_the_map_beyond_both_ends_changes_nothing() -> None:
    """The map ends 1 m behind the vehicle and 1 m behind the site; 1 m beside the way, its rim counts."""
    e = ground(np.zeros((101, 141)), cell=0.5)
    beyond = route.plan_route(site(69.0, 25.0), e, np.array([1.0, 25.0, 14.0]), SETTINGS)
    assert beyond.warnings == ()
    beside = route.plan_route(site(60.0, 1.0), e, np.array([5.0, 1.0, 14.0]), SETTINGS)
    assert any("not mapped" in w for w in beside.warnings)


def test_a_vehicle_over_the_site_only_descends() -> None:
    e = ground(np.zeros((101, 101)), cell=0.5)
    got = route.plan_route(site(25.0, 25.0), e, np.array([25.0, 25.0, 20.0]), SETTINGS)
    heights = [w.position_world[2] for w in got.waypoints]
    assert heights == sorted(heights, reverse=True)
    assert all(w.speed == 1.0 for w in got.waypoints[1:])
    assert_allclose(got.waypoints[-1].t, 20.0)


# -- wind


@pytest.mark.parametrize(("wind", "speed"), [((-8.0, 0.0), 2.0), ((8.0, 0.0), 5.0), ((0.0, 6.0), 5.0), (None, 5.0)])
def test_against_the_wind_it_flies_slower_over_the_ground(wind: tuple[float, float] | None, speed: float) -> None:
    """Of ten metres a second through the air, two are left against a wind of eight."""
    settings = SETTINGS.model_copy(update={"wind": wind, "air_speed": 10.0})
    e = ground(np.zeros((101, 141)), cell=0.5)
    got = route.plan_route(site(60.0, 25.0), e, np.array([5.0, 25.0, 10.0]), settings)
    assert got.waypoints[1].speed == pytest.approx(speed)
    assert got.waypoints[1].t == pytest.approx(55.0 / speed)
    assert any("against the wind" in w for w in got.warnings) is (speed < 5.0)


def test_a_recording_is_given_its_wind_by_a_setting() -> None:
    assert load_settings("", ["route.wind=[3,-1.5]"]).stages().route.wind == (3.0, -1.5)


def test_no_line_leads_down_with_the_wind_from_behind() -> None:
    """The route is level to above the site and then straight down; against the wind, or in a light one, it slopes."""
    e, start = ground(np.zeros((101, 141)), cell=0.5), np.array([5.0, 25.0, 30.0])
    for wind, names in {
        (4.0, 0.0): ["start", "transit", "approach", "inspect", "touchdown"],
        (-4.0, 0.0): ["start", "approach", "inspect", "touchdown"],
        (1.5, 0.0): ["start", "approach", "inspect", "touchdown"],
    }.items():
        got = route.plan_route(site(60.0, 25.0), e, start, SETTINGS.model_copy(update={"wind": wind}))
        assert [w.name for w in got.waypoints] == names
        for a, b in pairwise(got.waypoints):
            way = b.position_world - a.position_world
            assert way[2] > -0.1 or np.hypot(*way[:2]) < 0.1 or wind[0] < 2.0


@pytest.mark.parametrize("clearance", [0.01, 0.1, 0.24])
def test_a_clearance_below_half_a_cell_is_a_way_one_cell_wide(clearance: float) -> None:
    settings = SETTINGS.model_copy(update={"clearance": clearance})
    e, start = ground(np.zeros((101, 101)), cell=0.5), np.array([5.0, 5.0, 30.0])
    got = route.plan_route(site(30.0, 25.0), e, start, settings)
    assert [w.name for w in got.waypoints] == ["start", "approach", "inspect", "touchdown"]
    assert got.warnings == ()
