"""Zones on the map: touchdowns, ranks, names, and the way to the site."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
import some_run
from ground import ground
from hypothesis import given
from hypothesis import strategies as st

from alight.hazards import assess
from alight.landing.route import plan_route
from alight.landing.sites import choose_sites
from alight.landing.zones import MapZones
from alight.records import GroundZone, Hazard, HazardMap, Sites, ZonesOnPlane
from alight.settings import HazardsSettings, Lander, RouteSettings, SitesSettings

LANDER = Lander(radius=1.0)
FLAT = ground(np.zeros((101, 151)), sigma=0.01)  # 15 m to the east, 10 m to the north
BARE = assess(FLAT, None, LANDER, HazardsSettings(tilt_sigma=0.0, smoothed=False))
LEFT, RIGHT, ALL = shapely.box(-9, -9, 7, 19), shapely.box(8, -9, 30, 19), shapely.box(-99, -99, 99, 99)


def zone(use: Any, shape: shapely.Geometry, **more: Any) -> GroundZone:
    return GroundZone(more.pop("name", "A"), use, shape, **more)


def judged(*zones: GroundZone, hazards: HazardMap = BARE) -> tuple[HazardMap, Sites]:
    on_map = MapZones(ZonesOnPlane(zones), LANDER.reach)
    found = on_map.judged(hazards)
    return found, on_map.named(choose_sites(found, None, FLAT, SitesSettings(separation=2.0), LANDER))


@given(
    st.floats(0.0, 3.0),
    st.floats(0.0, 2.0),
    st.lists(st.tuples(st.floats(1, 14), st.floats(1, 9)), min_size=3, max_size=6),
)
def test_no_touchdown_has_its_disc_in_a_keep_out_zone(margin: float, reach: float, corners: list[Any]) -> None:
    shape = shapely.MultiPoint(corners).convex_hull
    found, sites = judged(zone("keep-out", shape, margin=margin, reach=reach))
    east, north = np.meshgrid(*FLAT.grid.xy())
    away = shapely.distance(shape, shapely.points(east, north)) - margin - reach - LANDER.reach
    refused = (found.reasons & Hazard.ZONE) != 0
    assert refused[away < -0.02].all()
    assert not refused[away > 0.02].any()
    for s in sites.sites:
        assert shape.distance(shapely.Point(s.east, s.north)) > margin + reach + LANDER.reach
        assert s.zone is not None
        assert s.zone.distance == pytest.approx(shape.distance(shapely.Point(s.east, s.north)) - reach)
        to = np.array([s.east, s.north]) + (s.zone.distance + reach) * np.array(
            [math.sin(s.zone.bearing), math.cos(s.zone.bearing)]
        )
        assert shape.distance(shapely.Point(to)) < 1e-6


def test_a_hole_of_a_zone_holds_sites() -> None:
    _, sites = judged(zone("keep-out", ALL.difference(shapely.box(3, 3, 7, 7))))
    assert len(sites.sites) == 1
    assert 3.0 < sites.sites[0].east < 7.0


@pytest.mark.parametrize("use", ["landing", "search"])
def test_only_such_zones_hold_sites(use: Any) -> None:
    found, sites = judged(zone(use, shapely.box(2, 2, 6, 6), name="pad"), zone(use, RIGHT, margin=1.0))
    assert sites.sites
    for s in sites.sites:
        assert max(shapely.box(3, 3, 5, 5).distance(shapely.Point(s.east, s.north)), 0.0) < 0.01 or s.east > 10.0
    _, none = judged(zone(use, shapely.Polygon(), name="far"))
    assert not none.sites
    assert f"100 % is refused by a zone (outside {use} zone far)" in none.reason
    np.testing.assert_array_equal(found.p_safe, BARE.p_safe)  # the chance that the lander stands does not change


def test_an_avoided_place_is_the_last_candidate_or_the_only_site() -> None:
    _, both = judged(zone("avoid", LEFT, name="road"))
    assert both.sites
    assert all(s.east > 8.0 and not s.avoid for s in both.sites)
    assert both.candidates
    assert {(c.doubt, c.avoid) for c in both.candidates} == {("zone", "avoid zone road")}
    _, alone = judged(zone("avoid", ALL, name="road"))
    assert alone.sites
    assert not alone.candidates
    assert all(s.avoid == "avoid zone road" and s.kind == "site" for s in alone.sites)
    assert alone.sites[0].zone is not None
    assert alone.sites[0].zone.distance == 0.0


def test_keep_out_wins_over_all_others() -> None:
    found, sites = judged(
        zone("landing", LEFT), zone("prefer", LEFT), zone("avoid", LEFT), zone("keep-out", ALL, name="B")
    )
    assert not sites.listed
    assert set(found.reasons.ravel() & Hazard.AVOID) == {0}
    assert "(keep-out zone B)" in sites.reason


@pytest.mark.parametrize("part", [LEFT, RIGHT])
def test_preferred_sites_rank_first(part: shapely.Geometry) -> None:
    _, sites = judged(zone("prefer", part))
    inside = [part.contains(shapely.Point(s.east, s.north)) for s in sites.sites]
    assert inside == sorted(inside, reverse=True)
    assert inside[0]
    assert not inside[-1]


def test_a_map_that_lies_aside_is_judged_where_it_is() -> None:
    on_map = MapZones(ZonesOnPlane((zone("keep-out", LEFT),)), LANDER.reach)
    found = on_map.judged(BARE, (100.0, 0.0))
    assert not (found.reasons & Hazard.ZONE).any()
    named = on_map.named(Sites((some_run.site(1, 5.0, 5.0),)), (20.0, 0.0))
    assert named.sites[0].zone is not None
    assert named.sites[0].zone.distance == pytest.approx(18.0)
    assert named.sites[0].zone.bearing == pytest.approx(math.radians(270.0))


@pytest.mark.parametrize(("floor", "level"), [(0.0, 20.0), (12.0, 20.0), (40.0, 40.0)])
@pytest.mark.parametrize("where", [7.0, -40.0])
def test_a_route_crosses_a_zone_from_its_floor_up(floor: float, level: float, where: float) -> None:
    """On the map, and beyond it, between the vehicle and the site."""
    strip = zone("keep-out", shapely.LineString([(where, -500), (where, 500)]), reach=2.0, floor=floor)
    zones = MapZones(ZonesOnPlane((strip,)), LANDER.reach)
    site, start = some_run.site(1, 12.0, 5.0), np.array([-80.0 if where < 0 else 1.0, 5.0, 20.0])
    route = plan_route(site, FLAT, start, RouteSettings(approach_height=6.0), (), zones)
    at = [w.position_world for w in route.waypoints]
    line = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(at)])
    lowest = line[np.abs(line[:, 0] - where) < strip.reach + LANDER.reach, 2].min()
    assert lowest >= floor
    assert lowest <= level + 3.0  # the ground beyond the map may be as high as the site, 2.1 m
    assert ("crosses keep-out zone A" in " ".join(route.warnings)) == (floor > 0.0)


def test_without_zones_nothing_changes() -> None:
    found, sites = judged()
    np.testing.assert_array_equal(found.reasons, BARE.reasons)
    np.testing.assert_array_equal(found.clearance, BARE.clearance)
    assert {s.zone for s in sites.listed} == {None}
