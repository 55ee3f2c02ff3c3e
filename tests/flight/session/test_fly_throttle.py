"""The throttle stick: down to arm, then raised in the climb, which is no takeover; afterwards its move is one."""

from __future__ import annotations

import pytest
from made_up_ground import Ground
from pilot_rig import PilotRig

from alight.checks.result import Judged
from alight.flight.session import preflight
from alight.flight.session.take_off import TakeOff
from alight.records.executive import FlightState

S = FlightState


def climbing() -> tuple[PilotRig, TakeOff]:
    """Return a rig that has climbed 3 m of 12."""
    r = PilotRig(Ground({}).seen)
    climb = r.take_off(12.0)
    assert r.run(30, lambda: r.sim.estimated[2] > 3.0)
    return r, climb


@pytest.mark.parametrize(("stick", "flown"), [(2, True), (0, False)])
def test_the_throttle_alone_may_be_raised_in_the_climb(stick: int, flown: bool) -> None:
    """A real flight ended as `somebody else flies now` when the pilot raised the stick, as he should."""
    r, climb = climbing()
    assert "middle" in climb.hint
    r.sim.reports.sticks[stick] += 400
    assert r.run(30, lambda: climb.done or bool(climb.failed))
    assert climb.done is flown
    assert r.vehicle.in_control is flown


def test_a_throttle_that_moves_in_the_search_is_a_takeover() -> None:
    r, climb = climbing()
    r.sim.reports.sticks[2] = 1500
    assert r.run(30, lambda: climb.done)
    r.each_step = r.fly_on
    r.begin(flying=True)
    r.run(3.0)
    assert r.state is S.SEARCH
    r.sim.reports.sticks[2] = 1700
    assert r.fly(S.HANDED_OVER, 3.0)


@pytest.mark.parametrize(("throttle", "verdict"), [(1500, Judged.GOOD), (1100, Judged.WARNING)])
def test_a_throttle_that_is_down_in_the_air_is_a_warning(throttle: int, verdict: Judged) -> None:
    r = PilotRig(Ground({}).seen)
    r.ready()
    assert not preflight.judge_throttle(r.vehicle)
    r.up_and_flying(20.0)
    r.sim.reports.sticks[2] = throttle
    r.run(1.0)
    assert [c.verdict for c in preflight.judge_throttle(r.vehicle)] == [verdict]
