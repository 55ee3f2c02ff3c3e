"""Differences between the simulated autopilots: numbers of modes, requests and refusals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.records.telemetry import FirmwareName


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
    """The properties in which autopilots differ."""

    autopilot: int  # MAV_AUTOPILOT
    lacks: tuple[str, ...]  # messages that it does not send
    modes: Mapping[Doing, tuple[int, int]]  # second and third parameter of MAV_CMD_DO_SET_MODE; the last one counts
    mode_shift: int  # bits, of the first of these in a heartbeat's custom mode
    reports_changes: bool  # sends a heartbeat at once when its mode changes, else every second alone
    needs_setpoints: bool  # leaves guided flight when they stop
    turns_to_course: bool  # turns the nose along the course where no heading is commanded
    speeds_by_command: bool  # guided flight obeys DO_CHANGE_SPEED until its controller starts anew
    returns_at_disarm: bool  # disarming restores the last mode that allows arming
    lands_in_guided: bool  # detects the ground under position set-points too, not under velocities alone
    dead_reckoning: float  # s for which its estimator keeps its position without a receiver's
    target_delay: float  # s of reports before LAND uses a target; LAND waits for the first one; infinite: it uses none

    def number(self, doing: Doing) -> int:
        """The custom mode of a heartbeat."""
        main, sub = self.modes[doing]
        return main << self.mode_shift | sub << 24

    def doing(self, parameters: tuple[float, ...]) -> Doing | None:
        """The mode that MAV_CMD_DO_SET_MODE requests; None: there is no such mode."""
        return {pair: doing for doing, pair in self.modes.items()}.get((round(parameters[1]), round(parameters[2])))


DIALECTS: Mapping[FirmwareName, Dialect] = {
    "ardupilot": Dialect(
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
        lands_in_guided=True,
        dead_reckoning=7.6,  # measured in Copter 4.6.3
        target_delay=2.0,
    ),
    "px4": Dialect(
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
        lands_in_guided=False,  # its land detector needs a set-point of the velocity
        dead_reckoning=5.0,  # EKF2_NOAID_TOUT
        target_delay=math.inf,
    ),
}
