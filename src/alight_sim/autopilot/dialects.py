"""Differences between the simulated autopilots: mode numbers, supported messages and behaviour."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.constants import g

from alight.records.telemetry import FirmwareName
from alight_sim.point_mass import FlightLimits


class Doing(Enum):
    """Flight modes of the simulated autopilot."""

    PILOT = "pilot"
    GUIDED = "guided"
    TAKE_OFF = "take off"
    LAND = "land"
    HOLD = "hold"
    RETURN = "return"


@dataclass(frozen=True)
class Dialect:
    """The properties in which autopilots differ.

    If two `modes` have equal parameters, a command with them selects the last one. Unless `target_delay` is infinite,
    LAND first waits for a target, 7 s at most.
    """

    firmware: FirmwareName
    autopilot: int  # MAV_AUTOPILOT
    lacks: tuple[str, ...]  # messages that it does not send
    modes: Mapping[Doing, tuple[int, int]]  # parameters 2 and 3 of MAV_CMD_DO_SET_MODE per mode
    mode_shift: int  # bits by which parameter 2 is shifted to the left in a heartbeat's custom mode
    reports_changes: bool  # whether it sends a heartbeat at once when its mode changes, not only every second
    needs_setpoints: bool  # whether it leaves guided flight when set-points stop
    turns_to_course: bool  # whether it turns the nose along the course if no heading is commanded
    speeds_by_command: bool  # whether guided flight obeys DO_CHANGE_SPEED, until its controller restarts
    returns_at_disarm: bool  # whether disarming restores the last mode that allows arming
    lift_off_delay: float  # s from the lift-off until the landed state reports it
    arms_with_throttle_down: bool  # whether it refuses to arm with the throttle stick above its lower end
    lands_in_guided: bool  # whether it detects the ground under position set-points too, not only under velocities
    dead_reckoning: float  # s for which its estimator keeps the position without the receiver
    target_delay: float  # s for which a target must be reported before LAND uses it; infinite: LAND ignores targets

    def number(self, doing: Doing) -> int:
        """Return the custom mode with which a heartbeat reports a mode."""
        main, sub = self.modes[doing]
        return main << self.mode_shift | sub << 24

    def doing(self, parameters: tuple[float, ...]) -> Doing | None:
        """Return the mode that MAV_CMD_DO_SET_MODE requests by its seven parameters; None: there is no such mode."""
        return {pair: doing for doing, pair in self.modes.items()}.get((round(parameters[1]), round(parameters[2])))


PX4_CONTROLLER = FlightLimits(  # PX4's position controller: MPC_TILTMAX_AIR is its only limit of the acceleration
    speed=12.0, climb=3.0, sink=1.5, acceleration=g * math.tan(math.radians(45.0)), reaction=1.0 / 1.8,
    approach=0.95, lag=0.1,
)  # fmt: skip
DIALECTS: Mapping[FirmwareName, Dialect] = {
    "ardupilot": Dialect(
        "ardupilot",
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        ("ESTIMATOR_STATUS", "WIND_COV"),
        {
            Doing.PILOT: (mavlink.COPTER_MODE_LOITER, 0),
            Doing.TAKE_OFF: (mavlink.COPTER_MODE_GUIDED, 0),
            Doing.GUIDED: (mavlink.COPTER_MODE_GUIDED, 0),
            Doing.LAND: (mavlink.COPTER_MODE_LAND, 0),
            Doing.HOLD: (mavlink.COPTER_MODE_BRAKE, 0),
            Doing.RETURN: (mavlink.COPTER_MODE_RTL, 0),
        },
        mode_shift=0,
        reports_changes=True,
        needs_setpoints=False,
        turns_to_course=True,
        speeds_by_command=True,
        returns_at_disarm=False,
        lift_off_delay=3.3,  # measured in Copter 4.6.3
        arms_with_throttle_down=True,
        lands_in_guided=True,
        dead_reckoning=7.6,  # measured in Copter 4.6.3
        target_delay=2.0,
    ),
    "px4": Dialect(
        "px4",
        mavlink.MAV_AUTOPILOT_PX4,
        ("EKF_STATUS_REPORT", "WIND"),
        {
            Doing.PILOT: (3, 0),  # POSCTL
            Doing.GUIDED: (6, 0),
            Doing.TAKE_OFF: (4, 2),
            Doing.HOLD: (4, 3),
            Doing.RETURN: (4, 5),
            Doing.LAND: (4, 6),
        },
        mode_shift=16,
        reports_changes=False,
        needs_setpoints=True,
        turns_to_course=False,
        speeds_by_command=False,
        returns_at_disarm=True,  # since 1.14
        lift_off_delay=0.0,
        arms_with_throttle_down=False,
        lands_in_guided=False,  # its land detector needs a velocity set-point
        dead_reckoning=5.0,  # EKF2_NOAID_TOUT
        target_delay=math.inf,
    ),
}
