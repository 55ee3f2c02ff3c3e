"""State of the vehicle: messages in, a snapshot out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.firmware import Firmware
from alight.flight.autopilot.positions import PositionLog, place_of, report_of
from alight.records import PRE_ARM, Battery, GpsQuality, Landed, Telemetry


def boot_time_ns(message: Any) -> int | None:
    """Return the stamp of a message on the autopilot's clock, ns; None: the message has no stamp."""
    stamp = getattr(message, "time_boot_ms", None)
    return None if stamp is None else int(stamp) * 1_000_000


def attitude_of(m: Any) -> tuple[F64 | None, F64]:
    """Return the attitude (3, 3) of ATTITUDE or ATTITUDE_QUATERNION, None if invalid, and the FLU rates (3,), rad/s."""
    rates = border.flu(m.rollspeed, m.pitchspeed, m.yawspeed)
    if hasattr(m, "q1"):
        return border.world_from_body_of_quaternion([m.q1, m.q2, m.q3, m.q4]), rates
    return border.world_from_body_of_angles(m.roll, m.pitch, m.yaw), rates


def gps_quality(m: Any) -> GpsQuality:
    """Return the quality of a GPS_RAW_INT; NaN for accuracies that are not set (extensions of MAVLink 2)."""
    return GpsQuality(
        int(m.fix_type),
        0 if m.satellites_visible == 255 else int(m.satellites_visible),
        _measured(m.h_acc, 1e-3, 0),
        _measured(m.v_acc, 1e-3, 0),
        _measured(m.vel_acc, 1e-3, 0),
        math.nan if m.alt_ellipsoid == 0 else border.separation_of(m.alt_ellipsoid * 1e-3, m.alt * 1e-3),
    )


def _measured(value: float, scale: float, unknown: float) -> float:
    return math.nan if value == unknown else value * scale


def _attitude(m: Any) -> dict[str, Any]:
    return dict(zip(("world_from_body", "angular_velocity_body"), attitude_of(m), strict=True))


def _sys_status(m: Any) -> dict[str, Any]:
    battery = Battery(_measured(m.battery_remaining, 1e-2, -1), _measured(m.voltage_battery, 1e-3, 0xFFFF))
    off = bool(m.onboard_control_sensors_present & PRE_ARM and not m.onboard_control_sensors_enabled & PRE_ARM)
    return {"sensors_healthy": int(m.onboard_control_sensors_health), "checks_off": off, "battery": battery}


def _home(m: Any) -> dict[str, Any]:
    home = place_of(m.latitude, m.longitude, m.altitude, 0)
    return {} if home is None else {"home": home}


def _wind(m: Any) -> dict[str, Any]:
    """Return the telemetry's `wind_world` from ArduPilot's WIND; its `direction`, degrees, is where wind comes from.

    A Copter without `EK3_DRAG_...` parameters reports a speed of exactly 0 in any wind: the wind is unknown then.
    """
    if m.speed == 0:
        return _wind_ned(math.nan)
    towards = math.radians(m.direction) + math.pi if math.isfinite(m.direction) else math.nan
    return _wind_ned(m.speed * math.cos(towards), m.speed * math.sin(towards), m.speed_z)


def _wind_ned(*wind_ned: float) -> dict[str, Any]:
    known = all(map(math.isfinite, wind_ned))
    return {"wind_world": border.enu(*wind_ned) if known else np.full(3, math.nan)}


_FIELDS: Mapping[str, Callable[[Any], dict[str, Any]]] = {  # fields of the telemetry, by message
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude,
    "EKF_STATUS_REPORT": lambda m: {"estimator_flags": int(m.flags)},
    "ESTIMATOR_STATUS": lambda m: {"estimator_flags": int(m.flags)},
    "GPS_RAW_INT": lambda m: {"gps": gps_quality(m)},
    "HOME_POSITION": _home,
    "SYS_STATUS": _sys_status,
    "WIND": _wind,
    "WIND_COV": lambda m: _wind_ned(m.wind_x, m.wind_y, m.wind_z),
}


class VehicleState:
    """The newest values of everything that was received from the vehicle."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self.newest = Telemetry(firmware.name)  # without the ages of its messages
        self._received_ns: dict[str, int] = {}
        self._ground_ns: int | None = None  # first of the last consecutive reports of the ground
        self.positions = PositionLog()
        self.sticks: tuple[int, ...] | None = None
        # newest local position: the autopilot's clock, ns; (3,) metres and (3,) m/s, east, north, up
        self.local: tuple[int, F64, F64] | None = None

    def telemetry(self, now_ns: int) -> Telemetry:
        """Return everything received so far, with the age in seconds of each message."""
        return replace(self.newest, ages={name: (now_ns - t) * 1e-9 for name, t in self._received_ns.items()})

    def is_on_ground(self, now_ns: int) -> bool:
        """Whether the vehicle is disarmed, or was reported on the ground within the last two seconds."""
        reported_ns = self._received_ns.get("EXTENDED_SYS_STATE")
        recent = reported_ns is not None and now_ns - reported_ns < 2_000_000_000
        return (recent and self.newest.landed is Landed.GROUND) or not self.newest.armed

    def rebooted(self) -> None:
        """Forget everything but the mode; the vehicle is treated as disarmed."""
        self.newest = replace(Telemetry(self._firmware.name), mode=self.newest.mode)
        self.positions, self._ground_ns = PositionLog(), None
        self.sticks = self.local = None

    def on_message(self, name: str, m: Any, now_ns: int) -> bool:
        """Process a message of the vehicle that came at `now_ns` of our clock; return whether it is accepted."""
        self._received_ns[name] = now_ns
        boot_ns = boot_time_ns(m)
        if boot_ns is not None:
            self.newest = replace(self.newest, boot_ns=max(boot_ns, self.newest.boot_ns))
        if name == "GLOBAL_POSITION_INT":
            return self._on_position(m, now_ns)
        if name == "HEARTBEAT":
            mode, mode_name = self._firmware.mode(m.custom_mode)
            armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            failsafe = m.system_status in (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY)
            self.newest = replace(self.newest, armed=armed, mode=mode, mode_name=mode_name, failsafe=failsafe)
        elif name == "LOCAL_POSITION_NED" and boot_ns is not None:
            self.local = boot_ns, border.enu(m.x, m.y, m.z), border.enu(m.vx, m.vy, m.vz)
        elif name == "EXTENDED_SYS_STATE":
            self._on_landed_state(m.landed_state, now_ns)
        elif name == "RC_CHANNELS":
            four = (m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw)
            self.sticks = None if any(s in (0, 0xFFFF) for s in four) else four
        elif name in _FIELDS:
            self.newest = replace(self.newest, **_FIELDS[name](m))
        return True

    def _on_landed_state(self, state: int, now_ns: int) -> None:
        landed = Landed(state) if state in {s.value for s in Landed} else Landed.UNKNOWN
        first_ns = now_ns if self._ground_ns is None else self._ground_ns
        self._ground_ns = first_ns if landed is Landed.GROUND else None
        grounded = 0.0 if self._ground_ns is None else (now_ns - self._ground_ns) * 1e-9
        self.newest = replace(self.newest, landed=landed, grounded=grounded)

    def _on_position(self, m: Any, now_ns: int) -> bool:
        """Process a position; return whether it is accepted. After a jump, no position is until the reports agree."""
        report = report_of(m)
        if report is None:
            return False
        accepted = self.positions.add(report, now_ns)
        place, velocity = (report.place, border.enu(*report.velocity_ned)) if accepted else (None, np.full(3, math.nan))
        self.newest = replace(self.newest, place=place, velocity_world=velocity)
        return accepted
