"""Frames, signs, altitudes and numbers at the border, against hand-made numbers and pymavlink's own tables."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pymavlink import mavextra, mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.quaternion import Quaternion
from telemetry_messages import attitude, fed, gps, position

from alight.flight.autopilot import EstimateTie, Setpoint, TelemetryEvents, metres_between
from alight.flight.autopilot.border import enu, flu, frd, ned, world_from_body_of_angles, world_from_body_of_quaternion
from alight.flight.autopilot.firmware import ArduPilotFirmware, Firmware, Px4Firmware
from alight.flight.autopilot.setpoints import Target
from alight.flight.autopilot.vehicle_state import VehicleState
from alight.geometry import LocalFrame
from alight.records import FlightMode, ImuSample, NavSample, Place, Telemetry

LOCAL = LocalFrame(47.6, 13.4, 550.0)
NORTH, EAST, UP = (np.array(v) for v in ([0.0, 1, 0], [1.0, 0, 0], [0.0, 0, 1]))
MS = 1_000_000


def test_axes() -> None:
    assert_allclose(enu(1, 2, 3), [2, 1, -3])
    assert_allclose(ned([2, 1, -3]), [1, 2, 3])
    assert_allclose(flu(1, 2, 3), [1, -2, -3])
    assert_allclose(frd(flu(1, 2, 3)), [1, 2, 3])


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "forward", "left"),
    [
        (0.0, 0.0, 0.0, NORTH, -EAST),
        (0.0, 0.0, math.pi / 2, EAST, NORTH),
        (0.0, math.pi / 6, 0.0, math.cos(math.pi / 6) * NORTH + 0.5 * UP, -EAST),  # nose up
        (math.pi / 6, 0.0, 0.0, NORTH, -math.cos(math.pi / 6) * EAST + 0.5 * UP),  # right wing down
    ],
)
def test_attitude_by_hand(roll: float, pitch: float, yaw: float, forward: np.ndarray, left: np.ndarray) -> None:
    R = world_from_body_of_angles(roll, pitch, yaw)
    q = world_from_body_of_quaternion(Quaternion([roll, pitch, yaw]).q)  # pymavlink's own
    assert R is not None
    assert q is not None
    assert_allclose(R[:, 0], forward, atol=1e-12)
    assert_allclose(R[:, 1], left, atol=1e-12)
    assert_allclose(q, R, atol=1e-12)


def test_what_is_no_rotation_is_unknown() -> None:
    assert world_from_body_of_quaternion([0, 0, 0, 0]) is None
    assert world_from_body_of_quaternion([math.nan, 0, 0, 1]) is None
    assert world_from_body_of_angles(0.0, math.nan, 0.0) is None


def heard(firmware: Firmware, *messages: object) -> Telemetry:
    state = VehicleState(firmware)
    for m in messages:
        state.on_message(m.get_type(), m, 0)  # type: ignore[attr-defined]
    return state.telemetry(0)


@pytest.mark.parametrize(
    ("msl_mm", "ellipsoid_mm", "separation"),
    [(512000, 558000, 46.0), (-50000, -20000, 30.0), (512000, 0, math.nan), (0, 0, math.nan),
     (512000, 512000, math.nan), (512000, 12000, math.nan), (0, 121000, math.nan), (0, -106000, -106.0)],
)  # fmt: skip
def test_the_receivers_heights_give_a_separation_only_where_they_are_two(
    msl_mm: int, ellipsoid_mm: int, separation: float
) -> None:
    message = mavlink.MAVLink_gps_raw_int_message(0, 3, 0, 0, msl_mm, 0, 0, 0, 0, 9, alt_ellipsoid=ellipsoid_mm)
    assert heard(ArduPilotFirmware(), message).gps.separation == pytest.approx(separation, nan_ok=True)


def test_telemetry_by_hand() -> None:
    got = heard(
        ArduPilotFirmware(),
        mavlink.MAVLink_heartbeat_message(2, 3, 1 | 128, 4, 4, 3),
        mavlink.MAVLink_global_position_int_message(5000, 476000000, 134000000, 512340, 12340, 100, 200, -300, 9000),
        mavlink.MAVLink_attitude_message(5000, 0.0, 0.0, math.pi / 2, 0.1, 0.2, 0.3),
        mavlink.MAVLink_gps_raw_int_message(
            0, 6, 1, 2, 512000, 100, 100, 0, 0, 17, alt_ellipsoid=558000, h_acc=14, v_acc=25, vel_acc=90
        ),
        mavlink.MAVLink_extended_sys_state_message(0, 2),
        mavlink.MAVLink_home_position_message(475900000, 133900000, 500000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        mavlink.MAVLink_wind_message(270.0, 5.0, 0.0),
        mavlink.MAVLink_sys_status_message(0, 0, 0x10000000, 0, 12345, 0, 81, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_ekf_status_report_message(831, 0, 0, 0, 0, 0),
    )
    assert (got.firmware, got.mode, got.mode_name, got.armed) == ("ArduPilot", FlightMode.GUIDED, "GUIDED", True)
    assert got.place == Place(pytest.approx(47.6), pytest.approx(13.4), 512.34, 12.34)
    assert_allclose(got.velocity_world, [2.0, 1.0, 3.0])
    assert got.world_from_body is not None
    assert_allclose(got.world_from_body[:, 0], EAST, atol=1e-12)
    assert_allclose(got.angular_velocity_body, [0.1, -0.2, -0.3], atol=1e-7)
    assert (got.gps.fix, got.gps.horizontal, got.gps.vertical, got.gps.separation) == (6, 0.014, 0.025, 46.0)
    assert_allclose(got.wind_world, [5.0, 0.0, 0.0], atol=1e-9)  # a west wind blows to the east
    assert (got.battery.share, got.battery.voltage) == (0.81, pytest.approx(12.345))
    assert got.home == Place(pytest.approx(47.59), pytest.approx(13.39), 500.0, 0.0)
    assert got.ready
    assert not got.is_down


@pytest.mark.parametrize(
    ("health", "flags", "ready"),
    [(0x10000000, 831, True), (0, 831, False), (0x10000000, 167, False), (0x10000000, 831 | 1024, False)],
)
def test_ready_needs_both(health: int, flags: int, ready: bool) -> None:
    got = heard(
        Px4Firmware(),
        mavlink.MAVLink_sys_status_message(0, 0, health, 0, 0xFFFF, 0, -1, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_estimator_status_message(0, flags, 0, 0, 0, 0, 0, 0, 0.4, 0.6),
    )
    assert got.ready is ready
    assert math.isnan(got.battery.share)
    assert math.isnan(got.battery.voltage)


def test_modes_of_copter_are_those_of_pymavlink() -> None:
    firmware = ArduPilotFirmware()
    for number, name in mavutil.mode_mapping_acm.items():
        assert firmware.mode(number)[1] == name
    assert firmware.mode(3) == (FlightMode.MISSION, "AUTO")
    assert firmware.mode(99) == (FlightMode.OTHER, "99")
    wanted = {
        "GUIDED": FlightMode.GUIDED,
        "LAND": FlightMode.LAND,
        "BRAKE": FlightMode.HOLD,
    }
    numbers = {name: n for n, name in mavutil.mode_mapping_acm.items()}
    for name, mode in {**wanted, "RTL": FlightMode.RETURN}.items():
        assert firmware.parameters[mode] == (numbers[name],)


def test_modes_of_px4_are_those_of_pymavlink() -> None:
    firmware = Px4Firmware()
    names = {"OFFBOARD": FlightMode.GUIDED, "LOITER": FlightMode.HOLD,
             "RTL": FlightMode.RETURN, "TAKEOFF": FlightMode.TAKE_OFF, "LAND": FlightMode.LAND}  # fmt: skip
    for name, mode in names.items():
        _, main, sub = mavutil.px4_map[name]
        assert firmware.parameters[mode] == (main, sub)
        assert firmware.mode(main << 16 | sub << 24)[0] is mode
    assert firmware.mode(4 << 16 | 4 << 24) == (FlightMode.MISSION, "AUTO.MISSION")
    assert firmware.mode(4 << 16 | 9 << 24) == (FlightMode.LAND, "AUTO.PRECLAND")
    assert firmware.mode(3 << 16) == (FlightMode.PILOT, "POSCTL")


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-65, 65), st.floats(-179, 179), st.floats(-300, 300), st.floats(-300, 300), st.floats(-50, 50),
    st.floats(-8, 8), st.floats(-8, 8),
)  # fmt: skip
def test_targets_keep_their_place_relative_to_the_vehicle(
    lat: float, lon: float, east: float, north: float, up: float, wrong_lat_m: float, wrong_alt: float
) -> None:
    """The vector to a target stays the same for any error of the autopilot's position, measured by pymavlink."""
    local = LocalFrame(lat, lon, 120.0)
    ours = np.array([20.0, -10.0, 30.0])
    at = local.to_geodetic(ours)
    theirs = Place(float(at[0]) + wrong_lat_m / 111_000, float(at[1]), 400.0 + wrong_alt, 30.0)
    got = EstimateTie(local, ours, theirs).place_of(ours + np.array([east, north, up]))
    distance = mavextra.distance_lat_lon(theirs.latitude, theirs.longitude, got.latitude, got.longitude)
    assert distance == pytest.approx(math.hypot(east, north), rel=0.006, abs=0.01)  # on a sphere
    bearing_north = (got.latitude - theirs.latitude) * 111_195
    assert bearing_north == pytest.approx(north, rel=0.006, abs=0.02)
    fall = (east**2 + north**2) / 2 / 6.37e6 + (east * 20 + north * -10) / 6.37e6
    assert got.altitude_msl - theirs.altitude_msl == pytest.approx(up + fall, abs=2e-3)
    assert got.above_home - theirs.above_home == pytest.approx(up + fall, abs=2e-3)


def tie() -> EstimateTie:
    """Return a tie of a place 3 m east of the autopilot's estimate; its home is 40 m below."""
    return EstimateTie(LOCAL, np.array([3.0, 0.0, 40.0]), Place(47.6, 13.4, 540.0, 40.0))


def test_setpoints_by_hand() -> None:
    target = Target.of(Setpoint(np.array([3.0, 111.19, 30.0]), np.array([1.0, 2.0, 3.0]), -math.pi / 2), tie())
    m = target.message(5 * MS, 7, 1)
    assert (m.get_type(), m.target_system, m.coordinate_frame) == ("SET_POSITION_TARGET_GLOBAL_INT", 7, 5)
    assert m.type_mask == 448 | 2048  # acceleration and yaw rate are not used; all else is
    assert (m.lat_int - 476000000) * 0.0111 == pytest.approx(111.19, rel=2e-3)
    assert m.lon_int == pytest.approx(134000000, abs=1)
    assert m.alt == pytest.approx(530.0, abs=0.01)
    assert (m.vx, m.vy, m.vz) == (2.0, 1.0, -3.0)
    assert m.yaw == pytest.approx(-math.pi / 2)
    velocity = Target.of(Setpoint(velocity_world=np.array([1.0, 0.0, -0.5])), None).message(0, 7, 1)
    assert (velocity.get_type(), velocity.coordinate_frame) == ("SET_POSITION_TARGET_LOCAL_NED", 1)
    assert velocity.type_mask == 7 | 448 | 1024 | 2048
    assert (velocity.vx, velocity.vy, velocity.vz) == (0.0, 1.0, 0.5)


@pytest.mark.parametrize(
    "setpoint", [Setpoint(), Setpoint(np.array([0, np.nan, 0])), Setpoint(velocity_world=np.ones(3), heading=math.inf)]
)
def test_a_setpoint_without_sense_is_refused(setpoint: Setpoint) -> None:
    with pytest.raises(ValueError, match="set-point"):
        Target.of(setpoint, tie())
    with pytest.raises(ValueError, match="one instant"):
        Target.of(Setpoint(np.zeros(3)), None)
    with pytest.raises(ValueError, match="speeds above 0"):
        Target.of(Setpoint(np.zeros(3), speed=0.0), tie())


def test_a_setpoint_ahead_is_as_far_as_its_speed_allows() -> None:
    """30 m to the north and 10 m down, at 2 m/s and 0.5 m/s: at 0.5 1/s the set-point is 4 m ahead and 1 m lower."""

    class Plain(ArduPilotFirmware):
        def reach(self, speed: float, upright: bool) -> float:
            return speed / 0.5

    here = Place(47.6, 13.4, 540.0, 40.0)
    far = Target.of(Setpoint(np.array([3.0, 30.0, 30.0]), speed=2.0, sink=0.5), tie())
    near = far.near(here, np.zeros(3), np.zeros(3), Plain()).place
    assert near is not None
    assert (near.latitude - here.latitude) * 111_132 == pytest.approx(4.0, abs=0.01)
    assert (near.longitude, near.altitude_msl) == (pytest.approx(13.4, abs=1e-9), pytest.approx(539.0))
    assert near.above_home == pytest.approx(39.0)
    up = Target.of(Setpoint(np.array([3.0, 1.0, 42.0]), speed=2.0, sink=0.5), tie())
    same = up.near(here, np.zeros(3), np.zeros(3), Plain()).place
    assert same is not None
    assert up.place is not None
    assert_allclose(astuple(same), astuple(up.place), rtol=1e-12)
    higher = Target.of(Setpoint(np.array([3.0, 0.0, 90.0]), speed=2.0, sink=0.5), tie())
    high = higher.near(here, np.zeros(3), np.zeros(3), Plain()).place
    assert high is not None
    assert high.altitude_msl == pytest.approx(546.0)  # no set-point lets it climb faster than 3 m/s


def test_landing_targets_by_hand() -> None:
    """For a level vehicle with the nose to the east, a target 10 m below and 1 m north is 1 m left of the nose."""
    R = world_from_body_of_angles(0.0, 0.0, math.pi / 2)
    assert R is not None
    m = ArduPilotFirmware().landing_target(7 * MS, np.array([0.0, 1.0, -10.0]), R)
    assert (m.frame, m.position_valid, m.time_usec) == (12, 1, 7000)
    assert_allclose([m.x, m.y, m.z], [0.0, -1.0, 10.0], atol=1e-9)
    assert m.angle_x == pytest.approx(math.atan(-0.1))  # right of the centre is positive
    assert m.angle_y == pytest.approx(0.0, abs=1e-9)
    assert m.distance == pytest.approx(math.sqrt(101))
    ahead = ArduPilotFirmware().landing_target(0, np.array([1.0, 0.0, -10.0]), R)
    assert ahead.angle_y == pytest.approx(-math.atan(0.1))  # above the centre is negative
    assert Px4Firmware().landing_target(0, np.array([0.0, 1.0, -10.0]), R) is None


def test_a_row_has_the_attitude_of_its_own_instant() -> None:
    got = fed(TelemetryEvents(LOCAL), gps(), attitude(1000, 0.0), position(1025), attitude(1050, 0.1))
    (row,) = got
    assert isinstance(row, NavSample)
    assert row.t_ns == 1525 * MS
    assert row.world_from_body is not None
    forward = row.world_from_body[:, 0]
    assert math.atan2(forward[0], forward[1]) == pytest.approx(0.05, abs=1e-6)  # half-way
    assert row.position_world is not None
    assert_allclose(row.position_world, [0, 0, 46.0], atol=1e-6)  # 550 m above the sea are 596 above the ellipsoid
    assert row.velocity_world is not None
    assert_allclose(row.velocity_world, [2.0, 1.0, 3.0])
    assert_allclose(row.sigma_position, [0.5, 0.5, 0.9])
    assert_allclose(row.sigma_velocity, [0.2, 0.2, 0.2])


def test_an_attitude_is_carried_on_by_its_rate_but_not_far() -> None:
    got = fed(
        TelemetryEvents(LOCAL), gps(), position(990), attitude(1000, 0.0, 1.0), position(1500), attitude(2000, 1.0)
    )
    near, far = got
    assert isinstance(near, NavSample)
    assert isinstance(far, NavSample)
    assert near.world_from_body is not None
    assert math.atan2(*near.world_from_body[:2, 0]) == pytest.approx(-0.01, abs=1e-6)  # yaw grows to the right
    assert far.world_from_body is None
    assert far.position_world is not None


def test_no_position_is_made_up() -> None:
    flags = mavlink.MAVLink_ekf_status_report_message(167, 0, 0, 0, 0, 0)
    cases = {
        "3D fix": (TelemetryEvents(LOCAL), [gps(fix=2)]),
        "absolute": (TelemetryEvents(LOCAL), [gps(), flags]),
        "ellipsoid": (TelemetryEvents(LOCAL), [gps(ellipsoid=0.0)]),
    }
    for word, (events, first) in cases.items():
        (row,) = fed(events, *first, position(1000), attitude(1000, 0.0))
        assert isinstance(row, NavSample)
        assert row.position_world is None
        assert word in events.missing
    events = TelemetryEvents(LOCAL, separation=50.0)
    (row,) = fed(events, gps(ellipsoid=0.0), position(1000), attitude(1000, 0.0))
    assert isinstance(row, NavSample)
    assert row.position_world is not None
    assert_allclose(row.position_world, [0, 0, 50.0], atol=1e-6)


def test_a_place_off_the_earth_is_none() -> None:
    wild = mavlink.MAVLink_global_position_int_message(1000, 2_000_000_000, 134000000, 550000, 0, 0, 0, 0, 0)
    (row,) = fed(TelemetryEvents(), gps(), wild, attitude(1000, 0.0))
    assert isinstance(row, NavSample)
    assert row.position_world is None


def test_the_first_good_position_is_the_origin_where_none_is_given() -> None:
    events = TelemetryEvents()
    (row,) = fed(events, gps(), position(1000), attitude(1000, 0.0))
    assert isinstance(row, NavSample)
    assert events.local is not None
    found = (events.local.latitude, events.local.longitude, events.local.height)
    assert found == pytest.approx((47.6, 13.4, 596.0), abs=1e-9)
    assert_allclose(row.position_world, np.zeros(3), atol=1e-9)


def test_positions_without_attitudes_do_not_pile_up() -> None:
    got = fed(TelemetryEvents(LOCAL), gps(), *(position(1000 + 100 * k) for k in range(60)))
    assert len(got) == 40
    assert all(isinstance(s, NavSample) and s.world_from_body is None for s in got)


def test_imu_samples_by_hand() -> None:
    """At rest and level, the accelerometer measures one g upwards."""
    messages = [
        mavlink.MAVLink_highres_imu_message(1_000_000, 0, 0, -9.80665, 0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_scaled_imu_message(1000, 0, 0, -1000, 100, 200, 300, 0, 0, 0),
        mavlink.MAVLink_raw_imu_message(1_000_000, 0, 0, -1000, 100, 200, 300, 0, 0, 0),
    ]
    for message in messages:
        (s,) = fed(TelemetryEvents(LOCAL), message)
        assert isinstance(s, ImuSample)
        assert s.t_ns == 1500 * MS
        assert_allclose(s.specific_force_body, [0, 0, 9.80665], atol=1e-6)
        assert_allclose(s.angular_velocity_body, [0.1, -0.2, -0.3], atol=1e-7)


@pytest.mark.parametrize("nan", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_do_no_harm(nan: float) -> None:
    events = TelemetryEvents(LOCAL)
    messages = [
        mavlink.MAVLink_attitude_quaternion_message(1000, nan, 0, 0, 0, nan, 0, 0),
        mavlink.MAVLink_highres_imu_message(1000, nan, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_local_position_ned_message(1000, nan, 0, 0, 0, 0, 0),
        mavlink.MAVLink_wind_message(nan, nan, nan),
    ]
    assert not fed(events, *messages)
    state = heard(ArduPilotFirmware(), *messages)
    assert state.world_from_body is None
    assert np.isnan(state.wind_world).all()


def test_two_places_are_as_near_across_the_date_line_as_elsewhere() -> None:
    here = Place(-17.0, 179.99999, 5.0, 5.0)
    assert metres_between(here, Place(-17.0, -179.99999, 5.0, 5.0)) == pytest.approx(2.126, abs=0.01)
    assert metres_between(here, Place(-17.0, 179.99999, 9.0, 9.0)) == pytest.approx(4.0)


def test_a_reported_wind_of_exactly_zero_is_unknown() -> None:
    """A Copter without drag parameters reports WIND(-180, 0, 0) in 8 m/s of wind."""
    state = VehicleState(ArduPilotFirmware())
    for speed, known in ((5.0, True), (0.0, False), (0.1, True)):
        state.on_message("WIND", mavlink.MAVLink_wind_message(-180.0, speed, 0.0), 0)
        assert np.isfinite(state.newest.wind_world).all() == known
