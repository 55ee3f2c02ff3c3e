"""Zones of the user in a flight: where the vehicle searches, flies and lands, and the check before it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from autopilot_rig import LOCAL
from length import in_turn
from made_up_ground import Ground, clearer_from_below
from pilot_rig import PLACE, WRONG, PilotRig

from alight.checks.result import Judged
from alight.flight.session import preflight as p
from alight.landing.zones import MapZones
from alight.records import GroundZone, Zones, ZonesOnPlane
from alight.records.executive import FlightState, MapVerdict
from alight.records.telemetry import FirmwareName
from alight.settings import Settings

S = FlightState
DISC = 1.5  # m, lander.radius
OVER = 2.5  # m, above a floor, from where a flight at the height of the search crosses it surely


def keep_out(shape: shapely.Geometry, floor: float = 0.0, **more: float) -> GroundZone:
    return GroundZone(f"{floor:g} m", "keep-out", shape, floor=floor, **more)


def cutting(rng: np.random.Generator, places: np.ndarray) -> list[GroundZone]:
    """Keep-out zones about half of the places, and two strips across the area; half of them with a floor.

    The vehicle begins in none that it may not begin in.
    """
    zones = list[GroundZone]()
    for k, place in enumerate(places[: len(places) // 2]):
        floor = (0.0, float(rng.uniform(8.0, 50.0)))[k % 2]
        zones.append(
            keep_out(shapely.Point(place).buffer(rng.uniform(1.0, 4.0), 4), floor, margin=rng.uniform(0.0, 1.0))
        )
    for k in range(2):
        angle, beside = rng.uniform(0.0, np.pi), rng.uniform(5.0, 18.0) * rng.choice([-1.0, 1.0])
        along, aside = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        line = shapely.LineString([beside * aside - 200.0 * along, beside * aside + 200.0 * along])
        zones.append(keep_out(line, (0.0, float(rng.choice([12.0, 25.0, 60.0])))[k], reach=rng.uniform(1.0, 3.0)))
    start = shapely.Point(WRONG[:2])
    return [z for z in zones if z.floor < 25.0 or shapely.distance(z.shape, start) > z.reach + z.margin + DISC + 1.0]


def rig(
    places: np.ndarray, zones: list[GroundZone], dialect: FirmwareName = "ardupilot", height: float = 30.0
) -> PilotRig:
    """A flight over good places, which has begun."""
    r = PilotRig(Ground({tuple(place): clearer_from_below for place in places}).seen, dialect)
    r.zones = ZonesOnPlane(tuple(zones))
    r.up_and_flying(height)
    r.begin()
    return r


def fly(r: PilotRig, zones: list[GroundZone]) -> float:
    """Fly to the end of the landing; return the least room of the disc to zones below whose floor it is, metres."""
    rooms, step = [math.inf], r.each_step

    def watched() -> None:
        step()
        if r.state in (S.RETURN, S.HANDED_OVER):
            return  # the autopilot's own flight
        at, up = shapely.Point(r.sim.estimated[:2]), float(r.truth()[2])
        lands = r.state is S.LANDED or up < 0.1
        shut = [z for z in zones if z.use == "keep-out" and (lands or up < z.floor)]
        rooms.extend(shapely.distance(z.shape, at) - z.reach - z.margin - DISC for z in shut)

    r.each_step = watched
    assert r.run(500.0, lambda: r.pilot.over or r.state is S.RETURN)
    return min(rooms)


@pytest.mark.parametrize(("dialect", "seed"), in_turn(3, [(seed,) for seed in range(20)]))
def test_the_disc_stands_in_no_zone_and_crosses_none_below_its_floor(dialect: FirmwareName, seed: int) -> None:
    """Good places lie in zones and outside. Zones are measured by the autopilot's position, which is off by `WRONG`."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-24.0, 24.0, (6, 2))
    zones = cutting(rng, places)
    r = rig(places, zones, dialect)
    assert fly(r, zones) > 0.0
    at = shapely.points(places + WRONG[:2])
    room = np.min([shapely.distance(z.shape, at) - z.reach - z.margin - DISC for z in zones], axis=0).max()
    if room < 0.0:
        assert r.state is S.RETURN
    if room > 5.0 and all(z.floor < 30.0 - OVER for z in zones):
        assert r.state is S.LANDED


@pytest.mark.parametrize(("floor", "ends"), [(0.0, S.LANDED), (20.0, S.LANDED), (60.0, S.RETURN)])
def test_a_strip_is_crossed_above_its_floor_only(floor: float, ends: FlightState) -> None:
    """The only place lies beyond a strip without end: there is no way around."""
    strip = keep_out(shapely.LineString([(12.0, -300.0), (12.0, 300.0)]), floor, reach=3.0)
    r = rig(np.array([[20.0, 4.0]]), [strip])
    assert fly(r, [strip]) > 0.0
    assert r.state is ends
    if ends is S.RETURN:
        assert "outside the zones" in r.pilot.diary.transitions[-1].reason


def test_a_place_refused_low_down_gives_way_to_one_beyond_a_zone_with_a_floor() -> None:
    """The vehicle looks at the first place from 4 m up, climbs, and crosses the strip above its floor."""
    strip = keep_out(shapely.LineString([(0.0, -300.0), (0.0, 300.0)]), 20.0, reach=2.0)
    places = {(-9.0, 3.0): lambda h: 0.0 if h < 7.0 else 0.9, (12.0, 3.0): clearer_from_below}
    r = PilotRig(Ground(places).seen)
    r.zones = ZonesOnPlane((strip,))
    r.up_and_flying(30.0)
    r.begin()
    assert fly(r, [strip]) > 0.0
    assert r.state is S.LANDED
    assert {look.place[0] < 0.0 for look in r.pilot.diary.looks} == {True, False}


def test_where_zones_leave_nothing_it_returns_and_names_them() -> None:
    zone = keep_out(shapely.Point(PLACE).buffer(5.0))
    r = rig(np.array([PLACE]), [zone])
    fly(r, [zone])
    assert r.state is S.RETURN
    assert "1 are outside the zones (keep-out zone 0 m)" in r.pilot.diary.transitions[-1].reason
    assert not r.pilot.diary.looks


@pytest.mark.parametrize("begins_inside", [True, False])
def test_it_searches_and_lands_inside_search_zones_only(begins_inside: bool) -> None:
    field = shapely.box(-8.0 if begins_inside else 8.0, -12.0, 30.0, 12.0)
    r = rig(np.array([[20.0, 4.0], [-15.0, 3.0]]), [GroundZone("field", "search", field)])
    flown, step = list[shapely.Point](), r.each_step

    def watched() -> None:
        step()
        flown.append(shapely.Point(r.sim.estimated[:2]))

    r.each_step = watched
    assert r.run(500.0, lambda: r.pilot.over)
    assert r.state is S.LANDED
    begin = next(k for k, at in enumerate(flown) if field.contains(at))
    assert begin == 0 or not begins_inside
    assert all(field.contains(at.buffer(DISC - 0.5)) for at in flown[begin + 30 :])


def judged(zone: GroundZone, height: float) -> p.CheckResult:
    r = PilotRig(Ground({}).seen)
    r.up_and_flying(height)
    degrees = shapely.transform(zone.shape, lambda at: np.array([r.sim.home.degrees([*p, 0.0])[1::-1] for p in at]))
    fields = {**vars(zone), "shape": degrees}
    return p.judge_zones(r.vehicle, Zones("zones.geojson", (GroundZone(**fields),)), LOCAL, Settings())


@pytest.mark.parametrize(
    ("zone", "height", "verdict", "words"),
    [
        (keep_out(shapely.box(20, 20, 30, 30), 60.0), 20.0, Judged.GOOD, "zones.geojson: 1 keep-out; 9"),
        (keep_out(shapely.box(-5, -5, 5, 5), 60.0), 20.0, Judged.BAD, "below the floor of keep-out zone 60 m"),
        (keep_out(shapely.box(-5, -5, 5, 5), 12.0), 20.0, Judged.GOOD, "1 keep-out"),
        (keep_out(shapely.box(-5, -5, 5, 5)), 20.0, Judged.GOOD, "1 keep-out"),
        (keep_out(shapely.box(3, -300, 300, 300), 60.0), 20.0, Judged.BAD, "below the floor"),
        (keep_out(shapely.box(6, -300, 300, 300), 60.0), 20.0, Judged.WARNING, "% of the search area are left"),
        (GroundZone("far", "search", shapely.box(900, 900, 950, 950)), 20.0, Judged.BAD, "; 0 % of the search area"),
    ],
)
def test_the_check_before_a_flight_names_the_zone(zone: GroundZone, height: float, verdict: Judged, words: str) -> None:
    found = judged(zone, height)
    assert (found.verdict, words in found.evidence) == (verdict, True), found


def test_where_zones_refuse_all_ground_of_the_map_it_returns_and_names_them() -> None:
    """No place is listed then: the map's own verdict has the zones."""
    plain = Ground({})

    def see(number: int, t: float, at: np.ndarray) -> MapVerdict:
        found = plain.seen(number, t, at)
        field = ZonesOnPlane((GroundZone("farm", "keep-out", shapely.box(-900, -900, 900, 900)),))
        return replace(found, hazards=MapZones(field, DISC).judged(found.hazards))

    r = PilotRig(see, settings=("executive.search_side=30",))
    r.up_and_flying(30.0)
    r.begin()
    assert r.fly(S.RETURN)
    assert "ground is refused by keep-out zone farm" in r.pilot.diary.transitions[-1].reason


@pytest.mark.parametrize("seed", range(3))
def test_a_search_from_lower_crosses_no_zone_below_its_floor(seed: int) -> None:
    """From 120 m the vehicle may search above every zone, from 60 and 30 m beside some of them only."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-25.0, 25.0, (6, 2))
    zones = [z for z in cutting(rng, places) if z.floor != 0.0]
    zones += [keep_out(shapely.Point(*rng.uniform(8.0, 25.0, 2)), floor, reach=4.0) for floor in (45.0, 90.0)]
    shown = {tuple(place): lambda h: clearer_from_below(h) if h < 45.0 else 0.0 for place in places}
    r = PilotRig(Ground(shown, sees=99.0).seen, settings=("executive.search_height=120", "executive.time_budget=600"))
    r.zones = ZonesOnPlane(tuple(zones))
    r.up_and_flying(120.0)
    r.begin()
    assert fly(r, zones) > 0.0
    assert r.pilot.executive.state is S.LANDED
