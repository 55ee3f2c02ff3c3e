"""State of the vehicle: messages in, a snapshot out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.firmware import Firmware
from alight.flight.autopilot.place_log import PlaceLog
from alight.flight.autopilot.place_watch import place_of, report_of
from alight.records import PRE_ARM, Battery, FlightMode, GpsQuality, Landed, Place, Telemetry

_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_LANDED_NS = 2_000_000_000  # for which a report of having landed is valid
_NAN = float("nan")


def boot_time_ns(message: Any) -> int | None:
    """Stamp of a message on the autopilot's clock, ns; None: the message has none."""
    stamp = getattr(message, "time_boot_ms", None)
    return None if stamp is None else int(stamp) * 1_000_000


def _measured(value: float, scale: float, unknown: float) -> float:
    return _NAN if value == unknown else value * scale


def gps_quality(m: Any) -> GpsQuality:
    """Quality from GPS_RAW_INT; the accuracies are extensions of MAVLink 2, and 0 where they are not filled."""
    return GpsQuality(
        int(m.fix_type),
        0 if m.satellites_visible == 255 else int(m.satellites_visible),
        _measured(m.h_acc, 1e-3, 0),
        _measured(m.v_acc, 1e-3, 0),
        _measured(m.vel_acc, 1e-3, 0),
        _NAN if m.alt_ellipsoid == 0 else (m.alt_ellipsoid - m.alt) * 1e-3,
    )


class VehicleState:
    """The newest values of everything that was heard from the vehicle."""

    def __init__(self, firmware: Firmware) -> None:
        self.firmware = firmware
        self._now = Telemetry(firmware.name)
        self._heard: dict[str, int] = {}
        self.places = PlaceLog()
        self.sticks: tuple[int, ...] | None = None

    def telemetry(self, now_ns: int) -> Telemetry:
        """Return everything heard so far, with the age in seconds of each message."""
        return replace(self._now, ages={name: (now_ns - t) * 1e-9 for name, t in self._heard.items()})

    @property
    def mode(self) -> FlightMode:
        """Mode of the newest heartbeat."""
        return self._now.mode

    @property
    def place(self) -> Place | None:
        """Newest place, of any age; None: none yet, or unknown after a jump."""
        return self._now.place

    def heard_ns(self, name: str) -> int | None:
        """The instant of our clock at which a message was last heard; None: never."""
        return self._heard.get(name)

    def is_on_ground(self, now_ns: int) -> bool:
        """True if it stands on the ground: disarmed, or landed by its own recent report."""
        said_ns = self._heard.get("EXTENDED_SYS_STATE")
        says_so = self._now.landed is Landed.GROUND and said_ns is not None and now_ns - said_ns < _LANDED_NS
        return says_so or not self._now.armed

    def rebooted(self) -> None:
        """Forget everything but the mode; the vehicle counts as disarmed."""
        self._now = replace(Telemetry(self.firmware.name), armed=False, mode=self._now.mode)
        self.places = PlaceLog()
        self.sticks = None

    def hear(self, name: str, m: Any, now_ns: int) -> bool:
        """Take a message of the vehicle that came at `now_ns` of our clock; False: it is not accepted."""
        self._heard[name] = now_ns
        boot_ns = boot_time_ns(m)
        if boot_ns is not None:
            self._now = replace(self._now, boot_ns=max(boot_ns, self._now.boot_ns))
        take = getattr(self, f"_{name.lower()}", None)
        return take is None or take(m) is not False

    def place_at(self, boot_ns: int) -> Place | None:
        """Return the autopilot's estimate of its position, extrapolated from the nearest report by its velocity.

        A report may be a second and a half old, where reports are late or few.

        Args:
            boot_ns: instant of the autopilot's clock.

        Returns:
            Degrees, and metres above sea level and above the home; None: too far from every report, or its reports
            have jumped.
        """
        return self.places.at(boot_ns)

    def _heartbeat(self, m: Any) -> None:
        mode, name = self.firmware.mode(m.custom_mode)
        self._now = replace(self._now, armed=bool(m.base_mode & _ARMED), mode=mode, mode_name=name)

    def _extended_sys_state(self, m: Any) -> None:
        known = m.landed_state in {state.value for state in Landed}
        self._now = replace(self._now, landed=Landed(m.landed_state) if known else Landed.UNKNOWN)

    def _global_position_int(self, m: Any) -> bool:
        """Take a position; an impossible one is ignored, and after a jump the place is unknown until reports agree."""
        report = report_of(m)
        if report is None:
            return False
        if not self.places.take(report, self._heard["GLOBAL_POSITION_INT"]):
            self._now = replace(self._now, place=None, velocity_world=np.full(3, _NAN))
            return False
        self._now = replace(self._now, place=report.place, velocity_world=border.enu(*report.velocity_ned))
        return True

    def _attitude_quaternion(self, m: Any) -> None:
        self._turn(border.world_from_body_of_quaternion([m.q1, m.q2, m.q3, m.q4]), m)

    def _attitude(self, m: Any) -> None:
        self._turn(border.world_from_body_of_angles(m.roll, m.pitch, m.yaw), m)

    def _turn(self, world_from_body: F64 | None, m: Any) -> None:
        rates = border.flu(m.rollspeed, m.pitchspeed, m.yawspeed)
        self._now = replace(self._now, world_from_body=world_from_body, angular_velocity_body=rates)

    def _gps_raw_int(self, m: Any) -> None:
        self._now = replace(self._now, gps=gps_quality(m))

    def _ekf_status_report(self, m: Any) -> None:
        self._now = replace(self._now, estimator_flags=int(m.flags))

    def _estimator_status(self, m: Any) -> None:
        self._now = replace(self._now, estimator_flags=int(m.flags))

    def _sys_status(self, m: Any) -> None:
        battery = Battery(_measured(m.battery_remaining, 1e-2, -1), _measured(m.voltage_battery, 1e-3, 0xFFFF))
        bits = int(m.onboard_control_sensors_health)
        off = bool(m.onboard_control_sensors_present & PRE_ARM and not m.onboard_control_sensors_enabled & PRE_ARM)
        self._now = replace(self._now, sensors_healthy=bits, checks_off=off, battery=battery)

    def _home_position(self, m: Any) -> None:
        home = place_of(m.latitude, m.longitude, m.altitude, 0)
        self._now = self._now if home is None else replace(self._now, home=home)

    def _wind(self, m: Any) -> None:
        """Take ArduPilot's WIND: the direction from which the wind comes, in degrees, and speeds in m/s."""
        towards = math.radians(m.direction) + math.pi if math.isfinite(m.direction) else _NAN
        self._blow(m.speed * math.cos(towards), m.speed * math.sin(towards), m.speed_z)

    def _wind_cov(self, m: Any) -> None:
        self._blow(m.wind_x, m.wind_y, m.wind_z)

    def _blow(self, *wind_ned: float) -> None:
        known = all(map(math.isfinite, wind_ned))
        self._now = replace(self._now, wind_world=border.enu(*wind_ned) if known else np.full(3, _NAN))

    def _rc_channels(self, m: Any) -> None:
        four = (m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw)
        self.sticks = None if any(s in (0, 0xFFFF) for s in four) else four
