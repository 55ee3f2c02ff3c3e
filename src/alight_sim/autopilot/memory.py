"""What the simulated autopilot stores and gives on request: parameters, fence, rally points."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.arrays import F64
from alight.records.telemetry import FirmwareName

_FENCE, _RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
# parameters as its page recommends them; whole numbers are integers on the autopilot
PARAMETERS: Mapping[FirmwareName, Mapping[str, float]] = {
    "ardupilot": {
        "FS_EKF_ACTION": 1, "FS_THR_ENABLE": 1, "BATT_FS_LOW_ACT": 2, "FLTMODE_CH": 5, "ARMING_CHECK": 1,
        "PLND_ENABLED": 1, "PLND_TYPE": 1, "PLND_STRICT": 0, "LAND_SPEED": 50, "WPNAV_ACCEL": 250.0,
        "FENCE_OPTIONS": 0,
    },
    "px4": {
        "COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 1.0, "COM_DISARM_LAND": 2.0, "COM_RC_OVERRIDE": 3, "RC_MAP_FLTMODE": 5,
        "NAV_RCL_ACT": 2, "COM_LOW_BAT_ACT": 3, "MPC_LAND_SPEED": 0.5,
    },
}  # fmt: skip

# parameters that switch external navigation on, as the page recommends them
EXTERNAL_NAVIGATION: Mapping[FirmwareName, Mapping[str, float]] = {
    "ardupilot": {
        "VISO_TYPE": 1, "VISO_DELAY_MS": 100, "VISO_POS_M_NSE": 0.2, "VISO_QUAL_MIN": 1, "EK3_SRC2_POSXY": 6,
        "EK3_SRC2_VELXY": 6, "EK3_SRC2_POSZ": 1, "EK3_SRC2_VELZ": 0, "EK3_SRC2_YAW": 1,
        "EK3_SRC_OPTIONS": 0,
    },
    "px4": {"EKF2_EV_CTRL": 5, "EKF2_EV_DELAY": 0.0, "EKF2_HGT_REF": 0, "EKF2_DELAY_MAX": 400},
}  # fmt: skip


class MissionItem(NamedTuple):
    """One item of a fence or of the rally points."""

    command: int  # MAV_CMD
    parameter: float  # number of corners of the polygon, or radius in metres
    latitude: float  # degrees
    longitude: float  # degrees


Degrees = Callable[[F64], tuple[float, float, float]]  # converts (3,) metres from home to degrees


def fence_polygon(corners: Sequence[Sequence[float]], degrees: Degrees, keeps_in: bool) -> list[MissionItem]:
    """Return the items of a polygon with `corners`, metres east and north of home, that keeps the vehicle in or out."""
    inclusion = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    command = inclusion if keeps_in else mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
    return [MissionItem(command, len(corners), *degrees(np.array([*corner, 0.0]))[:2]) for corner in corners]


def fence_circle(centre: Sequence[float], radius: float, degrees: Degrees, keeps_in: bool) -> list[MissionItem]:
    """Return the item of a circle about `centre`, metres east and north of home, that keeps the vehicle in or out."""
    inclusion = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
    command = inclusion if keeps_in else mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
    return [MissionItem(command, radius, *degrees(np.array([*centre, 0.0]))[:2])]


@dataclass
class AutopilotMemory:
    """Answers requests of parameters and of plans.

    ArduPilot converts whole numbers to floats, and does not answer for a parameter that it does not have. PX4 sends the
    bytes of an integer in the place of the float, and reports an unknown parameter by a text.
    """

    firmware: FirmwareName
    send: Callable[[Any], None]
    plans: dict[int, list[MissionItem]] = field(default_factory=lambda: {_FENCE: [], _RALLY: []})  # by MAV_MISSION_TYPE
    parameters: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.parameters = dict(PARAMETERS[self.firmware])

    def on_message(self, m: Any) -> None:
        """Answer a request; other messages have no effect."""
        name, them = m.get_type(), (m.get_srcSystem(), m.get_srcComponent())
        if name == "PARAM_REQUEST_READ":
            self._read(m.param_id)
        elif name in ("MISSION_REQUEST_LIST", "MISSION_REQUEST_INT"):
            items = self.plans.get(m.mission_type)
            if items is None:
                refused = mavlink.MAV_MISSION_UNSUPPORTED
                self.send(mavlink.MAVLink_mission_ack_message(*them, refused, m.mission_type))
            elif name == "MISSION_REQUEST_LIST":
                self.send(mavlink.MAVLink_mission_count_message(*them, len(items), m.mission_type))
            elif m.seq < len(items):
                self._item(items[m.seq], m.seq, them, m.mission_type)
            else:
                refused = mavlink.MAV_MISSION_INVALID_SEQUENCE
                self.send(mavlink.MAVLink_mission_ack_message(*them, refused, m.mission_type))

    def _item(self, item: MissionItem, number: int, them: tuple[int, int], kind: int) -> None:
        ardupilot = self.firmware == "ardupilot"
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if ardupilot else mavlink.MAV_FRAME_GLOBAL_INT
        at = round(item.latitude * 1e7), round(item.longitude * 1e7)
        unused = 0.0 if ardupilot else math.nan
        parameters = (item.parameter, unused, unused, unused)
        message = mavlink.MAVLink_mission_item_int_message(
            *them, number, frame, item.command, 0, 1, *parameters, *at, 0.0, kind
        )
        self.send(message)

    def _read(self, name: str) -> None:
        value = self.parameters.get(name)
        if value is None:
            if self.firmware == "px4":
                text = f"unknown param: {name}".encode()
                self.send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_ERROR, text))
            return
        kind = mavlink.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.firmware == "px4":
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        number, count = [*self.parameters].index(name), len(self.parameters)
        self.send(mavlink.MAVLink_param_value_message(name.encode(), float(value), kind, count, number))
