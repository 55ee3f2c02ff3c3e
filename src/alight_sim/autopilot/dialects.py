"""Differences between the simulated autopilots: numbers of modes, requests and refusals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Protocol


class Doing(Enum):
    """Flight modes of the simulated autopilot."""

    PILOT = "pilot"
    GUIDED = "guided"
    TAKE_OFF = "take off"
    LAND = "land"
    HOLD = "hold"
    RETURN = "return"


class Dialect(Protocol):
    """Interface of a dialect: the properties in which autopilots differ."""

    autopilot: int  # MAV_AUTOPILOT
    estimator_message: int  # EKF_STATUS_REPORT or ESTIMATOR_STATUS
    wind_message: int
    needs_setpoints: bool  # leaves guided flight when they stop
    turns_to_course: bool  # turns the nose along the course where no heading is commanded
    speeds_by_command: bool  # guided flight obeys DO_CHANGE_SPEED until its controller starts anew
    returns_at_disarm: bool  # disarming restores the last mode that allows arming
    lands_in_guided: bool  # detects the ground under position set-points too, not under velocities alone
    dead_reckoning: float  # s for which its estimator keeps its position without a receiver's
    target_delay: float  # s of reports before LAND uses a target; LAND waits for the first one; infinite: it uses none

    def number(self, doing: Doing) -> int:
        """The custom mode of a heartbeat."""

    def doing(self, parameters: tuple[float, ...]) -> Doing | None:
        """The mode that MAV_CMD_DO_SET_MODE requests; None: there is no such mode."""


class SpokenArduPilot:
    """ArduPilot's Copter."""

    autopilot = 3
    estimator_message = 193
    wind_message = 168
    needs_setpoints = False
    turns_to_course = True
    speeds_by_command = True
    returns_at_disarm = False
    lands_in_guided = True
    dead_reckoning = 7.6  # measured in Copter 4.6.3
    target_delay = 2.0
    _numbers: Mapping[Doing, int] = {
        Doing.PILOT: 5,  # LOITER
        Doing.GUIDED: 4,
        Doing.TAKE_OFF: 4,
        Doing.LAND: 9,
        Doing.HOLD: 17,
        Doing.RETURN: 6,
    }

    def number(self, doing: Doing) -> int:
        """The custom mode of a heartbeat."""
        return self._numbers[doing]

    def doing(self, parameters: tuple[float, ...]) -> Doing | None:
        """The mode by its number in the second parameter; None: there is no such mode."""
        wanted = {n: d for d, n in self._numbers.items() if d is not Doing.TAKE_OFF}
        return wanted.get(round(parameters[1]))


class SpokenPx4:
    """PX4's multicopter."""

    autopilot = 12
    estimator_message = 230
    wind_message = 231
    needs_setpoints = True
    turns_to_course = False
    speeds_by_command = False
    returns_at_disarm = True  # since 1.14
    lands_in_guided = False  # its land detector needs a set-point of the velocity
    dead_reckoning = 5.0  # EKF2_NOAID_TOUT
    target_delay = math.inf
    _numbers: Mapping[Doing, tuple[int, int]] = {
        Doing.PILOT: (3, 0),  # POSCTL
        Doing.GUIDED: (6, 0),
        Doing.TAKE_OFF: (4, 2),
        Doing.HOLD: (4, 3),
        Doing.RETURN: (4, 5),
        Doing.LAND: (4, 6),
    }

    def number(self, doing: Doing) -> int:
        """The custom mode of a heartbeat: main mode in the third byte, sub-mode in the fourth."""
        main, sub = self._numbers[doing]
        return main << 16 | sub << 24

    def doing(self, parameters: tuple[float, ...]) -> Doing | None:
        """The mode by main mode and sub-mode, the second and third parameters; None: there is no such mode."""
        return {pair: d for d, pair in self._numbers.items()}.get((round(parameters[1]), round(parameters[2])))
