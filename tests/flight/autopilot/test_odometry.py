"""ODOMETRY: frames, signs, covariances and stamps, read back by pymavlink and by what it stands for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import EITHER
from numpy.testing import assert_allclose
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.rotmat import Vector3
from scipy.spatial.transform import Rotation

from alight.flight.autopilot import ExternalPose
from alight.geometry import so3_exp
from alight.records import NavSample

UP, EAST, NORTH = np.eye(3)[2], np.eye(3)[0], np.eye(3)[1]


def pose_of(**changes: object) -> ExternalPose:
    """Return a pose 3 m east, 5 m north, 7 m up, the nose east and level, that flies north at 2 m/s and climbs at 1."""
    given = {
        "t_ns": 5_000_000_000, "position": np.array([3.0, 5.0, 7.0]), "world_from_body": np.eye(3),
        "velocity_world": np.array([0.0, 2.0, 1.0]), "angular_velocity_body": np.array([0.1, 0.2, 0.3]),
        "covariance": np.diag(np.arange(1.0, 10.0)), "quality": 0.5, "resets": 3, **changes,
    }  # fmt: skip
    return ExternalPose(**given)  # type: ignore[arg-type]


def decoded(pose: ExternalPose) -> mavlink.MAVLink_odometry_message:
    """Return the message as pymavlink reads its bytes."""
    made = pose.message(123_456, mavlink.MAV_FRAME_LOCAL_FRD)
    (found,) = mavlink.MAVLink(None).parse_buffer(bytes(made.pack(mavlink.MAVLink(None, 1, 191)))) or ()
    return found


def test_frames_and_signs_by_hand() -> None:
    m = decoded(pose_of())
    assert (m.time_usec, m.frame_id, m.child_frame_id) == (123_456, mavlink.MAV_FRAME_LOCAL_FRD, 12)
    assert_allclose((m.x, m.y, m.z), (5.0, 3.0, -7.0))  # north, east, down
    assert_allclose((m.vx, m.vy, m.vz), (0.0, -2.0, -1.0))  # forward, right, down: north is to the left
    assert_allclose((m.rollspeed, m.pitchspeed, m.yawspeed), (0.1, -0.2, -0.3), rtol=1e-6)
    assert_allclose(np.abs(m.q), [math.sqrt(0.5), 0, 0, math.sqrt(0.5)], atol=1e-6)  # yaw of 90 degrees from north
    assert m.q[0] * m.q[3] > 0
    assert (m.reset_counter, m.estimator_type, m.quality) == (3, mavlink.MAV_ESTIMATOR_TYPE_VISION, 50)


@pytest.mark.parametrize("seed", range(5))
def test_any_attitude_and_its_covariance(seed: int) -> None:
    """The quaternion turns body axes (forward, right, down) into north, east, down; so do covariances."""
    rng = np.random.default_rng(seed)
    R, A = so3_exp(rng.normal(size=3)), rng.normal(size=(9, 9))
    pose = pose_of(world_from_body=R, covariance=A @ A.T, velocity_world=rng.normal(size=3))
    m = decoded(pose)
    ned_from_frd = Rotation.from_quat([*m.q[1:], m.q[0]]).as_matrix()
    forward, right, down = R[:, 0], -R[:, 1], -R[:, 2]
    for axis, k in ((forward, 0), (right, 1), (down, 2)):
        assert_allclose(ned_from_frd[:, k], [axis @ NORTH, axis @ EAST, -axis @ UP], atol=1e-6)
    v = ned_from_frd @ [m.vx, m.vy, m.vz]
    assert_allclose(v, [pose.velocity_world @ NORTH, pose.velocity_world @ EAST, -pose.velocity_world @ UP], atol=1e-6)
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = m.pose_covariance
    north_and_down = np.array([1.0, 0, 1.0])  # NED; the variance of north minus up, by hand
    n = np.array([0.0, 1.0, -1.0]) @ pose.covariance[:3, :3] @ [0.0, 1.0, -1.0]
    full = P + np.triu(P, 1).T
    assert_allclose(north_and_down @ full[:3, :3] @ north_and_down, n, rtol=1e-5)
    assert_allclose(full[3, 3], pose.covariance[4, 4], rtol=1e-5)  # about north
    V = np.asarray(m.velocity_covariance)
    assert_allclose(V[0], forward @ pose.covariance[6:, 6:] @ forward, rtol=1e-5)
    assert_allclose(V[6], right @ pose.covariance[6:, 6:] @ right, rtol=1e-5)
    assert_allclose(V[11], down @ pose.covariance[6:, 6:] @ down, rtol=1e-5)
    assert np.isnan(V[15])


def test_pymavlinks_own_rotation_agrees() -> None:
    """Its Matrix3 is body to earth, as in MAVProxy."""
    from pymavlink.quaternion import Quaternion

    R = so3_exp([0.2, -0.3, 1.1])
    m = decoded(pose_of(world_from_body=R))
    velocity = Quaternion(list(m.q)).dcm * Vector3(m.vx, m.vy, m.vz)
    assert_allclose((velocity.x, velocity.y, velocity.z), (2.0, 0.0, -1.0), atol=1e-5)


@pytest.mark.parametrize(("quality", "percent"), [(1.0, 100), (0.001, 1), (0.0, -1)])
def test_quality_is_1_to_100_or_failed(quality: float, percent: int) -> None:
    assert decoded(pose_of(quality=quality)).quality == percent


def test_the_reset_counter_wraps() -> None:
    assert decoded(pose_of(resets=257)).reset_counter == 1


@EITHER
def test_stamps_are_of_the_clock_that_the_autopilot_expects(dialect: str) -> None:
    """ArduPilot's clock began at its boot. PX4 converts stamps of ours itself, as it converts all stamps."""
    r = Rig(dialect)  # type: ignore[arg-type]
    r.ready()
    sent: list[mavlink.MAVLink_odometry_message] = []
    receive = r.sim.receive
    reader = mavlink.MAVLink(None)

    def listen(data: bytes) -> None:
        sent.extend(m for m in reader.parse_buffer(data) or () if m.get_type() == "ODOMETRY")
        receive(data)

    r.sim.receive = listen  # type: ignore[method-assign]
    assert r.vehicle.odometry.send(pose_of(t_ns=r.now_ns))
    theirs = r.sim.boot
    r.run(0.2)
    expected = r.now_ns / 1000 - 200_000 if dialect == "px4" else theirs * 1e6
    assert sent[0].time_usec == pytest.approx(expected, abs=60_000)
    assert sent[0].frame_id == (mavlink.MAV_FRAME_LOCAL_NED if dialect == "px4" else mavlink.MAV_FRAME_LOCAL_FRD)


def test_its_local_position_is_known_where_it_is_requested() -> None:
    r = Rig(rates={"LOCAL_POSITION_NED": 10.0})
    r.up_and_flying(10.0)
    place = r.vehicle.odometry.place_at(r.now_ns)
    assert place is not None
    assert_allclose(place, LOCAL.to_enu(*LOCAL.to_geodetic(r.truth())), atol=0.3)


def test_by_sight_its_position_does_not_come_back_as_a_measurement() -> None:
    """Its estimate is then ours. What is measured is the receiver's position, the height, and the attitude."""
    r = Rig(odometry=True)
    r.up_and_flying(10.0)
    r.answered(r.vehicle.fly_by_sight(True) or 0)
    r.run(1.0)
    r.samples.clear()
    r.run(2.0)
    rows = [s for s in r.samples if isinstance(s, NavSample)]
    solution = [s for s in rows if s.world_from_body is not None]
    received = [s for s in rows if s.position_world is not None]
    assert len(solution) + len(received) == len(rows)
    assert len(solution) > 10
    assert all(s.velocity_world is None and s.position_world is None for s in solution)
    assert_allclose([s.height_world for s in solution], r.truth()[2], atol=0.2)
    assert len(received) > 5
    assert_allclose([s.position_world for s in received], [r.truth()] * len(received), atol=0.2)
    assert all(s.velocity_world is None and s.sigma_position is not None for s in received)
    r.sim.estimate.receives = False
    r.run(1.0)
    r.samples.clear()
    r.run(1.0)
    assert not [s for s in r.samples if isinstance(s, NavSample) and s.position_world is not None]
