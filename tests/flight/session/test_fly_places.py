"""The autopilot's positions in a flight: late ones are extrapolated, and a jump ends the use of older ones."""

from __future__ import annotations

import numpy as np
import pytest
from autopilot_rig import HERE, accepted, report
from length import EITHER, first, in_turn
from pilot_rig import PLACE, PilotRig, flying, seldom

from alight.flight.autopilot.firmware import ArduPilotFirmware
from alight.flight.autopilot.vehicle_state import VehicleState
from alight.records.executive import FlightState
from alight_sim.autopilot.dialects import Doing

S = FlightState


def modes_of(r: PilotRig) -> list[Doing]:
    """Return a list that records each mode flown from now on."""
    each, found = r.each_step, [r.doing]

    def note() -> None:
        each()
        if r.doing is not found[-1]:
            found.append(r.doing)

    r.each_step = note
    return found


def said(r: PilotRig, word: str) -> int:
    return sum(word in line for line in r.orders)


@pytest.mark.parametrize(("dialect", "slow"), in_turn(2, [["rare"], ["late"]]))
def test_positions_that_are_late_or_rare_land_like_others(dialect: str, slow: str) -> None:
    """With positions 0.4 s late or one a second, the vehicle never holds, and no jump is detected."""
    r = flying(dialect, link={"delay": 0.4} if slow == "late" else None)
    if slow == "rare":
        seldom(r, 1.0)
    modes = modes_of(r)
    assert r.fly(S.LANDED, 200.0)
    assert Doing.HOLD not in modes
    assert not said(r, "jumped")
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.5


@EITHER
def test_positions_that_stop_are_held_only_when_they_are_old(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.APPROACH)
    assert r.run(10.0, lambda: float(np.linalg.norm(r.sim.vehicle.velocity)) > 3.0)
    seldom(r, 1e9)
    t = r.t
    r.run(1.3)
    assert not said(r, "hold")
    assert r.run(4.0, lambda: r.doing is Doing.HOLD)
    assert 1.3 < r.t - t < 4.0  # after a heartbeat


def test_a_position_is_carried_on_for_a_while() -> None:
    """The newest report is extrapolated by its velocity; before the first one, positions belong to another estimate."""
    state = VehicleState(ArduPilotFirmware())
    accepted(state, report(1000, HERE, (500, 0, 0)), report(2000, HERE, (500, 0, 0)))
    for ms, metres in ((2400, 2.0), (3400, 7.0), (1700, -1.5), (1550, 2.75)):
        found = state.positions.at(ms * 1_000_000)
        assert found is not None
        assert (found.latitude - 47.6) * 111_132.0 == pytest.approx(metres, abs=0.01)
    assert state.positions.at(3_600_000_000) is None
    assert state.positions.at(500_000_000) is None


# -- holding a place


@EITHER
@pytest.mark.parametrize("jump", first(1, [[25.0, 0.0, 0.0], [0.0, -8.0, 0.0], [0.0, 0.0, 12.0]]))
def test_a_place_that_is_kept_is_forgotten_when_the_estimate_jumps(dialect: str, jump: list[float]) -> None:
    """Below 55 m a jump is accepted at once: then the old latitude and longitude are another place."""
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.judges = False
    assert r.run(30.0, lambda: r.orders[-1] == "stay")
    r.run(1.0)
    at, t, ways = r.truth(), r.t, [0.0]
    r.sim.estimate.error = r.sim.estimate.error + jump
    while r.t < t + 10.0:
        r.step()
        ways.append(float(np.linalg.norm(r.truth() - at)))
    assert r.state is S.LOOK
    assert max(ways) < 1.2
