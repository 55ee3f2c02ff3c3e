"""The estimator of the simulated autopilot: sources, delays, rejection, resets, and a position that is lost."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.records.telemetry import FirmwareName
from alight_sim.autopilot import DIALECTS, EstimateError, SimulatedAutopilot
from alight_sim.autopilot.dialects import Doing
from alight_sim.autopilot.memory import EXTERNAL_NAVIGATION

STEP = 0.05  # s
BOTH = pytest.mark.parametrize("firmware", ["ardupilot", "px4"])


class Sender:
    """A vehicle in the air, and a sender of odometry beside it."""

    def __init__(self, firmware: FirmwareName = "ardupilot", **parameters: float) -> None:
        self.sim = SimulatedAutopilot(DIALECTS[firmware], estimate=EstimateError((2.0, -1.0, 0.5)))
        self.sim.memory.parameters |= {**EXTERNAL_NAVIGATION[firmware], **parameters}
        self.sim.vehicle.body.position = np.array([5.0, 3.0, 30.0])
        self.sim.step(STEP)
        self.sim.hover()
        self.shift, self.resets, self.quality = np.array([2.0, -1.0, 0.0]), 0, 90  # metres, of what is sent
        self.late = 0.1  # s from the measurement to its arrival
        self._waiting: list[tuple[float, mavlink.MAVLink_odometry_message]] = []

    def run(self, seconds: float, sends: bool = True) -> None:
        frame = self.sim.dialect.firmware == "px4"
        for _ in range(round(seconds / STEP)):
            self.sim.step(STEP)
            at, v = self.sim.vehicle.body.position + self.shift, self.sim.vehicle.body.velocity
            message = mavlink.MAVLink_odometry_message(
                round(self.sim.boot * 1e6), mavlink.MAV_FRAME_LOCAL_NED if frame else mavlink.MAV_FRAME_LOCAL_FRD,
                mavlink.MAV_FRAME_BODY_FRD, at[1], at[0], -at[2], [1, 0, 0, 0], v[1], v[0], -v[2], 0, 0, 0,
                [0.01, *[0.0] * 20], [0.01, *[0.0] * 20], self.resets, mavlink.MAV_ESTIMATOR_TYPE_VISION, self.quality,
            )  # fmt: skip
            self._waiting.append((self.sim.boot + self.late, message))
            for due, m in [x for x in self._waiting if x[0] <= self.sim.boot]:
                self._waiting.remove((due, m))
                if sends:
                    self.sim.receive(bytes(m.pack(mavlink.MAVLink(None, 1, 191))))

    @property
    def error(self) -> float:
        """Level distance of the estimate from what is sent, metres."""
        return float(np.hypot(*(self.sim.estimator.error - self.shift)[:2]))

    def use_odometry(self) -> None:
        if self.sim.dialect.firmware == "ardupilot":
            number = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
            assert self.sim.execute(number, (2.0, 0, 0, 0, 0, 0, 0)) == mavlink.MAV_RESULT_ACCEPTED


@BOTH
def test_with_gps_odometry_changes_nothing(firmware: FirmwareName) -> None:
    s = Sender(firmware)
    s.shift = np.array([20.0, 10.0, 0.0])
    s.run(3.0)
    assert np.array_equal(s.sim.estimator.error, [2.0, -1.0, 0.5])


@BOTH
def test_without_gps_it_keeps_its_position_by_odometry(firmware: FirmwareName) -> None:
    s = Sender(firmware)
    s.run(2.0)
    s.sim.estimate.receives = False
    s.use_odometry()
    s.run(20.0)
    assert s.sim.located
    assert s.error < 0.05
    s.shift = s.shift + np.array([0.3, 0.0, 0.0])  # it follows a small change slowly
    s.run(0.2)
    assert s.error > 0.1
    s.run(3.0)
    assert s.error < 0.05


@BOTH
def test_without_either_it_is_lost_and_lands(firmware: FirmwareName) -> None:
    s = Sender(firmware)
    s.run(2.0)
    s.sim.estimate.receives = False
    s.run(4.0, sends=False)
    assert s.sim.located
    s.run(5.0, sends=False)
    assert not s.sim.located
    assert (s.sim.logic.doing, s.sim.logic.failsafe) == (Doing.LAND, True)


@pytest.mark.parametrize(("late", "held"), [(0.25, True), (0.35, False)])
def test_px4_drops_odometry_that_is_later_than_its_parameter(late: float, held: bool) -> None:
    """A real PX4 with its default of 200 ms lost its position on a busy computer, and with 400 ms it did not."""
    s = Sender("px4", EKF2_DELAY_MAX=200.0)
    s.sim.estimator.on_timesync(s.sim.boot, s.sim.boot, s.sim.boot)
    s.late, s.sim.estimate.receives = late, False
    s.run(10.0)
    assert s.sim.located is held


def test_px4_learns_the_difference_and_does_not_jump() -> None:
    s = Sender("px4")
    s.shift = np.array([30.0, 0.0, 0.0])
    s.run(2.0)
    s.sim.estimate.receives = False
    s.run(10.0)
    assert np.linalg.norm(s.sim.estimator.error - [2.0, -1.0, 0.5]) < 0.05


def test_a_jump_without_a_reset_is_rejected_until_it_lasts() -> None:
    s = Sender()
    s.use_odometry()
    s.run(2.0)
    s.shift = s.shift + np.array([8.0, 0.0, 0.0])
    s.run(2.0)
    assert s.sim.estimator.rejected > 10
    assert s.error > 7.0
    s.resets += 1
    s.run(0.5)
    assert s.error < 0.05


def test_a_quality_of_failed_is_not_fused() -> None:
    s = Sender()
    s.use_odometry()
    s.run(1.0)
    s.quality = -1
    s.run(9.0)
    assert not s.sim.located


def behind(delay: float) -> float:
    """Median error, metres, of a flight at 4 m/s with a delay as its parameter, ms."""
    s, found = Sender(VISO_DELAY_MS=delay), []
    s.use_odometry()
    for _ in range(40):
        s.sim.vehicle.body.velocity = np.array([4.0, 0.0, 0.0])
        s.run(STEP)
        found.append(s.error)
    return float(np.median(found))


def test_ardupilot_takes_the_least_delay_for_none() -> None:
    """So its parameter must be the whole delay; else the estimate is behind by the way of that time."""
    assert behind(100.0) + 0.05 < behind(0.0)


def test_sets_of_sources_are_ardupilots() -> None:
    assert not Sender("px4").sim.estimator.select(2.0)
    assert not Sender().sim.estimator.select(4.0)
