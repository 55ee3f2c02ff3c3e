"""The sites of an earlier run are looked at first, in their order, and landed on or refused like any place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from made_up_ground import Flight, Ground, bad_from_below, clearer_from_below, settings
from pilot_rig import PilotRig
from some_run import LOCAL, site

from alight.flight.executive.bounds import Bounds
from alight.flight.executive.executive import Executive
from alight.flight.executive.search import Goal
from alight.geometry.zones import Region, Zone
from alight.outputs.reading import EarlierSite, read_sites
from alight.outputs.vectors import sites_geojson
from alight.records import InputError, Sites
from alight.records.executive import FlightEvent, FlightState

S = FlightState
NEAR, FAR, BAD = (10.0, 5.0), (-18.0, 12.0), (14.0, -16.0)
PLACES: dict[tuple[float, float], Callable[[float], float]] = {
    NEAR: clearer_from_below, FAR: lambda height: clearer_from_below(height) - 0.01, BAD: bad_from_below,
}  # fmt: skip


@pytest.mark.parametrize(
    ("goals", "stands", "ends"),
    [
        ([], NEAR, ["refused"]),  # the best of all from far away is refused
        ([FAR, NEAR], FAR, []),
        ([(-19.0, 12.5)], FAR, []),  # found again a metre beside
        ([BAD, FAR], FAR, ["refused"]),  # by the looks from near by
        ([(0.0, -20.0), FAR], FAR, ["not seen"]),  # no verdict shows anything there
        ([BAD], NEAR, ["refused"]),  # then all is searched
    ],
)
def test_the_goals_come_first_and_in_order(goals: list[Any], stands: tuple[float, float], ends: list[str]) -> None:
    f = Flight(Ground(PLACES), Executive(settings()))
    named = [Goal(f"site {k}", np.array(goal)) for k, goal in enumerate(goals, 1)]
    f.executive.confine(Bounds(settings()), named)
    assert f.fly() is S.LANDED
    assert np.hypot(*(f.position[:2] - stands)) < 0.5
    refused = ["refused"] * f.events.count(FlightEvent.REFUSED)
    assert [look.verdict for look in f.executive.diary.looks if look.verdict == "not seen"] + refused == ends
    if goals:
        reasons = [t.reason for t in f.executive.diary.transitions] + [x.doubt for x in f.executive.diary.looks]
        assert any("site 1: " in reason for reason in reasons)


def test_a_goal_that_is_refused_from_above_is_named() -> None:
    f = Flight(Ground({NEAR: clearer_from_below, FAR: lambda height: 0.0}), Executive(settings()))
    f.executive.confine(Bounds(settings()), [Goal("site 1 of survey", np.array(FAR))])
    assert f.fly() is S.LANDED
    first = f.executive.diary.looks[0]
    assert (first.verdict, first.doubt.split(":")[0]) == ("refused", "site 1 of survey")
    assert np.hypot(*(f.position[:2] - NEAR)) < 0.5


def test_goals_in_another_frame_and_outside_the_region() -> None:
    """The map is off by metres; the plane of the region is the autopilot's."""
    shift, region = np.array([3.0, -4.0]), Region((Zone("pond", shapely.Point(FAR), False, 5.0),))
    f = Flight(Ground(PLACES), Executive(settings()), lambda now, executive: _with(now, shift))
    bounds = Bounds(settings(), region)
    assert bounds.objection(np.array(FAR)) == "outside the fence (pond)"
    assert "200 m away" in bounds.objection(np.array([200.0, 0.0]))
    assert not bounds.objection(np.array(NEAR))
    f.executive.confine(Bounds(settings()), [Goal("site 1", np.array(FAR) + shift)])
    assert f.fly() is S.LANDED
    assert np.hypot(*(f.position[:2] - FAR)) < 0.5


def _with(now: Any, offset: np.ndarray) -> Any:
    return type(now)(**{**vars(now), "offset": offset})


def test_sites_on_earth_are_flown_to_through_the_protocol() -> None:
    r = PilotRig(Ground(PLACES).seen)
    r.up_and_flying(30.0)
    r.begin()
    east, north = FAR
    there = r.sim.home.degrees(np.array([east + 5.0, north + 3.0, 0.0]))  # the receiver was off by metres
    goals = [EarlierSite("site 1", 47.7, 13.4), EarlierSite("site 2", there[0], there[1])]
    r.pilot.begin(r.now_ns, goals=goals)
    assert any("site 1 is left out: 11" in words for words in r.orders)
    assert r.fly(S.APPROACH)
    assert r.pilot.diary.transitions[-1].reason.startswith("site 2: ")
    assert r.pilot.executive.target is not None
    assert (r.pilot.executive.target.east, r.pilot.executive.target.north) == FAR


def written(folder: Path, tree: Any) -> Path:
    (folder / "sites.geojson").write_text(json.dumps(tree), encoding="utf-8")
    return folder


def test_the_sites_of_a_run_are_read_in_order_of_rank(tmp_path: Path) -> None:
    two = [site(rank=2, east=30.0, north=-5.0), site(rank=1, east=10.0, north=20.0)]
    tree = sites_geojson(Sites((two[1],), "", 0, (two[0],)), LOCAL)
    tree["features"].reverse()
    found = read_sites(written(tmp_path, tree))
    assert [s.name for s in found] == [f"site 1 of {tmp_path}", f"site 2 of {tmp_path}"]
    at = LOCAL.to_enu(found[0].latitude, found[0].longitude, LOCAL.height)
    np.testing.assert_allclose(at[:2], [10.0, 20.0], atol=0.1)


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (None, "missing"),
        ({"features": []}, "no site and no candidate"),
        ({"features": [{"geometry": {"type": "Point", "coordinates": [500.0, 0.0, 0.0]}}]}, "damaged"),
        ([], "damaged"),
    ],
)
def test_sites_that_cannot_be_read_are_refused(tree: Any, words: str, tmp_path: Path) -> None:
    if tree is not None:
        written(tmp_path, tree)
    with pytest.raises(InputError, match=words):
        read_sites(tmp_path)
