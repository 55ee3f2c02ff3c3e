"""Messages of an autopilot, and the GPS/INS rows and IMU samples that are made of them."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import TelemetryEvents
from alight.flight.autopilot.clock import VehicleClock
from alight.records import ImuSample, NavSample

MS = 1_000_000


def known_clock() -> VehicleClock:
    clock = VehicleClock()
    clock.add_answer(clock.request(1000 * MS), 500 * MS, 1000 * MS)  # ours is half a second ahead
    return clock


def gps(ellipsoid: float = 596.0, fix: int = 3) -> object:
    return mavlink.MAVLink_gps_raw_int_message(
        0, fix, 0, 0, 550000, 0, 0, 0, 0, 9, alt_ellipsoid=round(ellipsoid * 1e3), h_acc=500, v_acc=900, vel_acc=200
    )


def position(boot_ms: int) -> object:
    return mavlink.MAVLink_global_position_int_message(boot_ms, 476000000, 134000000, 550000, 0, 100, 200, -300, 0)


def attitude(boot_ms: int, yaw: float, rate: float = 0.0) -> object:
    return mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, yaw, 0.0, 0.0, rate)


def fed(events: TelemetryEvents, *messages: object) -> list[NavSample | ImuSample]:
    clock = known_clock()
    return [s for m in messages for s in events.feed(m.get_type(), m, clock)]  # type: ignore[attr-defined]
