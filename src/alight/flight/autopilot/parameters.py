"""Parameters of the autopilot that a landing needs: the table behind the checks before a flight and behind the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

ANY = -math.inf, math.inf  # listed on the page, but not judged


class WantedParameter(NamedTuple):
    """A parameter with the value to set, the values that are accepted, and the reason."""

    name: str
    value: str
    accepted: tuple[float, float]  # least and greatest
    why: str
    needed: bool = False  # whether no flight begins with another value
    restart: bool = False  # whether a new value counts only after a restart
    odometry: bool = False  # whether it matters only where odometry is sent

    @property
    def judged(self) -> bool:
        """Whether the value is read and judged before a flight."""
        return self.accepted != ANY

    def is_accepted(self, value: float) -> bool:
        """Whether a value may be flown with."""
        return self.accepted[0] <= value <= self.accepted[1]

    @property
    def remedy(self) -> str:
        """How to set it, in words."""
        return f"set {self.name} to {self.value}{', then restart the autopilot' if self.restart else ''}"

    @property
    def row(self) -> str:
        """The row of the table on the page."""
        return f"| `{self.name}` | {self.value}{', restart' if self.restart else ''} | {self.level} | {self.why} |"

    @property
    def level(self) -> str:
        """What another value does to a flight, in one word: refused, warning or not judged."""
        level = "refused" if self.needed else "warning" if self.judged else "not judged"
        return f"{level}, `--odometry`" if self.odometry else level


W = WantedParameter
PARAMETERS: Mapping[str, tuple[WantedParameter, ...]] = {  # by name of the firmware
    "ArduPilot": (
        W("FS_EKF_ACTION", "1", (1, 3), "without a position the autopilot lands by itself", needed=True),
        W("FS_THR_ENABLE", "1", (1, 7), "a lost receiver ends the flight, as nobody could take over"),
        W("BATT_FS_LOW_ACT", "2", (1, 4), "a low battery ends the flight even if this computer fails"),
        W("FS_OPTIONS", "24", ANY, "a failsafe low in a landing goes on down; else it climbs to return"),
        W("FLTMODE_CH", "5", (1, 16), "the mode switch is the takeover"),
        W("ARMING_CHECK", "1", (1, math.inf), "the autopilot's own checks before arming"),
        W("PLND_ENABLED", "1", (1, 1), "LAND comes down on the reported target", restart=True),
        W("PLND_TYPE", "1", (1, 1), "targets come over MAVLink", restart=True),
        W("PLND_STRICT", "0", (0, 0), "with 1 it climbs when reports stop, as they do to go straight down"),
        W("LAND_SPEED", "50", (20, 60), "cm/s; the touchdown is planned at 0.5 m/s"),
        W("WPNAV_ACCEL", "250", (250, math.inf), "cm/s²; with less it flies slower than ordered"),
        W(
            "EK3_DRAG_BCOEF_X",
            "by flight test, with `_Y`",
            ANY,
            "without it no wind is reported, and its limit cannot act",
        ),
        W("VISO_TYPE", "1", (1, 1), "odometry comes over MAVLink", needed=True, restart=True, odometry=True),
        W("EK3_SRC2_POSXY", "6", (6, 6), "the second set of sources flies by odometry", needed=True, odometry=True),
        W("EK3_SRC2_VELXY", "6", (6, 6), "its velocity too", needed=True, odometry=True),
        W("EK3_SRC2_POSZ", "1", (1, 1), "heights stay those of the barometer", needed=True, odometry=True),
        W("EK3_SRC2_YAW", "1", (1, 1), "the heading stays that of the compass", needed=True, odometry=True),
        W("EK3_SRC_OPTIONS", "0", (0, 0), "with 1 velocities of GPS count by sight too", needed=True, odometry=True),
        W("VISO_DELAY_MS", "as the check `odometry` shows", ANY, "it takes the least delay for none", odometry=True),
    ),
    "PX4": (
        W("COM_OBL_RC_ACT", "5", (3, 5), "lost set-points end in Hold; with 0 to 2 it may sink blindly", needed=True),
        W("COM_OF_LOSS_T", "1", (0.5, 3.0), "seconds without set-points until then", needed=True),
        W("COM_DISARM_LAND", "2", (0.1, 20.0), "seconds from the touchdown until the motors stop"),
        W("COM_RC_OVERRIDE", "3", (2, 3), "the sticks take over in Offboard too"),
        W("RC_MAP_FLTMODE", "the channel", (1, 18), "the mode switch is the takeover"),
        W("NAV_RCL_ACT", "2", (1, 3), "a lost receiver ends the flight, as nobody could take over"),
        W("COM_LOW_BAT_ACT", "3", (2, 3), "a low battery ends the flight even if this computer fails"),
        W("MPC_LAND_SPEED", "0.5", (0.2, 0.7), "m/s; the touchdown is planned at that speed"),
        W("NAV_DLL_ACT", "0", ANY, "above 0 it arms only while a ground station is connected; Alight is none"),
        W("COM_RC_IN_MODE", "4", ANY, "only without a receiver"),
        W("COM_RCL_EXCEPT", "4", ANY, "only without a receiver, for Offboard"),
        W("EKF2_EV_CTRL", "5", (5, 5), "its position and velocity are fused", needed=True, odometry=True),
        W("EKF2_HGT_REF", "0", (0, 0), "heights are those of the barometer", odometry=True),
        W("EKF2_EV_DELAY", "0", (0, 20), "stamps are converted by TIMESYNC", odometry=True),
        W("EKF2_DELAY_MAX", "400", (300, 1000), "ms; it drops odometry that comes later", restart=True, odometry=True),
    ),
}


def judged_parameters(firmware: str, odometry: bool = False) -> dict[str, WantedParameter]:
    """Return the parameters that are judged before a flight, by name; `firmware` is a key of `PARAMETERS`.

    `odometry`: whether it is sent.
    """
    return {p.name: p for p in PARAMETERS[firmware] if p.judged and (odometry or not p.odometry)}


def parameters_table(firmware: str) -> str:
    """Return the table of the page in Markdown; `firmware` is a key of `PARAMETERS`."""
    head = ["| parameter | set | otherwise | why |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *(p.row for p in PARAMETERS[firmware])])
