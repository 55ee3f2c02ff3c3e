"""PX4's own position controller under our set-points: it tilts by the step of the velocity alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import first_rows

from alight.flight.autopilot import Setpoint
from alight.records import FlightMode
from alight_sim.autopilot import PX4_CONTROLLER, PointMass


class Offboard(Rig):
    """A vehicle under PX4's controller, guided to a goal; it records its tilt in still air, degrees."""

    def __init__(self, delay: float) -> None:
        self.body = PointMass(PX4_CONTROLLER)
        super().__init__("px4", vehicle=self.body, link={"delay": delay})
        self.up_and_flying(15.0)
        assert self.run(3.0, lambda: self.telemetry.mode is FlightMode.GUIDED)
        self.goal, self.tilts, self.places = self.truth(), [0.0], [self.truth()]
        self.each_step = self.guide

    def guide(self) -> None:
        tie = self.vehicle.tie(LOCAL, self.truth(), self.now_ns)
        assert tie is not None
        self.vehicle.guide(Setpoint(self.goal, speed=7.0, sink=1.0), tie)
        self.tilts.append(math.degrees(math.acos(min(1.0, self.body.world_from_body.rotation[2, 2]))))
        self.places.append(self.truth())


@pytest.mark.parametrize(("away", "delay"), first_rows(2, [(7.0, 0.0), (40.0, 0.1), (7.0, 0.1), (40.0, 0.0)]))
def test_offboard_tilts_little_and_does_not_overshoot(away: float, delay: float) -> None:
    """A real PX4 was tilted by 47 degrees by its first set-point, 7.4 m ahead."""
    r = Offboard(delay)
    begin = r.truth()
    r.goal = begin + np.array([away, 0.0, 0.0])
    assert r.run(25.0, lambda: float(np.linalg.norm(r.truth() - r.goal)) < 0.3)
    r.run(3.0)
    assert max(r.tilts) < 15.0
    assert max(p[0] for p in r.places) < begin[0] + away + 0.5
    assert np.linalg.norm(r.truth() - r.goal) < 0.3


def test_a_vehicle_in_fast_flight_is_stopped_with_little_tilt() -> None:
    r = Offboard(0.0)
    r.goal = r.truth() + np.array([100.0, 0.0, 0.0])
    assert r.run(12.0, lambda: float(np.linalg.norm(r.body.velocity)) > 6.0)
    r.goal = r.truth()
    r.run(15.0)
    assert max(r.tilts) < 15.0
    assert np.linalg.norm(r.truth() - r.goal) < 0.3
