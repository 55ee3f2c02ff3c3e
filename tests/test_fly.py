"""A landing as it is flown: orders reach a simulated autopilot, faults lead to the right state, and take-over ends all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pilot_rig import PilotRig
from test_executive import Ground, clearer_from_below

from alight.records import NoticeKind
from alight.records.executive import FlightEvent, FlightState
from alight.runner.fly.orders import SpokenVehicle
from alight.runner.fly.take_off import TakeOff
from alight_sim.autopilot.dialects import Doing

S, E = FlightState, FlightEvent
PLACE = (10.0, 5.0)
BOTH = pytest.mark.parametrize("dialect", ["ardupilot", "px4"])


def rig(dialect: str = "ardupilot", *settings: str, ground: Ground | None = None) -> PilotRig:
    """A vehicle at 30 m, and a landing that has begun."""
    found = PilotRig((ground or Ground({PLACE: clearer_from_below})).seen, dialect, settings)
    found.up_and_flying(30.0)
    found.begin()
    return found


def events(r: PilotRig) -> list[FlightEvent]:
    assert r.pilot is not None
    return [t.event for t in r.pilot.diary.transitions]


def state(r: PilotRig) -> FlightState:
    assert r.pilot is not None
    return r.pilot.state


# -- the loop


@BOTH
def test_it_searches_looks_and_lands_where_it_looked(dialect: str) -> None:
    """The autopilot's place is off by metres; ours is true: the touchdown is where our place is."""
    r = rig(dialect)
    assert r.fly(S.LANDED)
    assert not r.sim.logic.armed
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.3
    assert r.sim.vehicle.touchdown_speed < 0.9
    assert {E.FOUND, E.LOWER, E.CONFIRMED, E.TOUCHED_DOWN} <= set(events(r))
    assert not r.of(NoticeKind.TAKEOVER)
    assert len(r.entries) == len(r.pilot.diary.transitions) + len(r.pilot.diary.looks)  # type: ignore[union-attr]
    assert r.pilot.way_point_times  # type: ignore[union-attr]
    t = r.t
    r.run(5.0)
    assert not r.moving_since(t + 0.1)
