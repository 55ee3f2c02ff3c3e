"""Kernels of the filter's state, landmarks and IMU, and of predicted pixels, against plain NumPy."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from pose_window import CAMS, project, scene
from twins_motion import picture

from alight.arrays import F64
from alight.geometry import Camera, Pose, skew, so3_exp
from alight.motion.constraint_kernels import largest_eigenvalues
from alight.motion.ekf.landmark_kernels import (
    gate_distances,
    innovation_of,
    linearise_points,
    project_covariance,
)
from alight.motion.ekf.state_kernels import insert_rows, keep_rows, mirror_lower, propagate_errors, squared_distance
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.imu_kernels import inertial_transition_into
from alight.motion.observations import cameras_at, positions
from alight.motion.points import marginalise_points
from alight.motion.preintegration import preintegrate, segments
from alight.motion.rotation_kernels import exponential, move_poses
from alight.motion.smoother.track_segments import in_camera, jacobians
from alight.records import ImuSample
from alight.settings import FilterSettings, TracksSettings
from alight.tracks.patches import FeaturePatches, follow_patches
from alight.tracks.transfer_kernels import carry_points
from alight.tracks.view_transfer import epipolar_distance, inverse_depth, pixel_covariance

RNG = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def same_numbers() -> None:
    """Each test draws the same numbers, alone or after others."""
    RNG.bit_generator.state = np.random.default_rng(0).bit_generator.state


def covariance(n: int) -> F64:
    J = RNG.normal(size=(n, n))
    return J @ J.T


# -- the state


def test_a_step_carries_the_covariance_on() -> None:
    """The state has fifteen errors of the motion, nine of GPS/INS, and thirty constant ones."""
    P, F, Q = covariance(54), RNG.normal(size=(15, 15)), covariance(15)
    decay, drift = RNG.uniform(0.5, 1.0, 9), RNG.uniform(0.0, 1.0, 9)
    full, noise = np.eye(54), np.zeros((54, 54))
    full[:15, :15], full[15:24, 15:24] = F, np.diag(decay)
    noise[:15, :15], noise[15:24, 15:24] = Q, np.diag(drift)
    wanted = full @ P @ full.T + noise
    propagate_errors(P, F, Q, decay, drift)
    np.testing.assert_allclose(P, wanted, rtol=1e-12, atol=1e-12)


def test_rows_come_and_go() -> None:
    P, own, cross = covariance(20), covariance(3), RNG.normal(size=(3, 20))
    for at in (0, 7, 20):
        out = np.empty((23, 23))
        insert_rows(P, at, cross, own, out)
        old, new = np.r_[0:at, at + 3 : 23], np.arange(at, at + 3)
        np.testing.assert_array_equal(out[np.ix_(old, old)], P)
        np.testing.assert_array_equal(out[np.ix_(new, new)], own)
        np.testing.assert_array_equal(out[np.ix_(new, old)], cross)
        np.testing.assert_array_equal(out[np.ix_(old, new)], cross.T)
        back = np.empty((20, 20))
        keep_rows(out, old, back)
        np.testing.assert_array_equal(back, P)


@pytest.mark.parametrize("n", [1, 16, 41])
def test_the_lower_half_is_copied_to_the_upper_one(n: int) -> None:
    P = RNG.normal(size=(n, n))
    wanted = np.tril(P) + np.tril(P, -1).T
    mirror_lower(P)
    np.testing.assert_array_equal(P, wanted)


@pytest.mark.parametrize("m", [1, 3, 4])
def test_a_distance_is_that_of_the_inverse(m: int) -> None:
    S, r = covariance(m), RNG.normal(size=m)
    assert squared_distance(r, S) == pytest.approx(float(r @ np.linalg.solve(S + np.eye(m), r)))


def test_small_rotations_and_moved_poses() -> None:
    for length in (0.0, 1e-9, 1e-6, 0.3, 3.0):
        v, out = RNG.normal(size=3), np.empty((3, 3))
        v *= length / np.linalg.norm(v)
        exponential(*v, out)
        np.testing.assert_allclose(out, so3_exp(v), atol=1e-15)
    R, p, e = so3_exp(RNG.normal(size=(4, 3))), RNG.normal(size=(4, 3)), RNG.normal(size=(4, 6))
    moved_R, moved_p = np.empty_like(R), np.empty_like(p)
    move_poses(R, p, e.ravel(), moved_R, moved_p)
    np.testing.assert_allclose(moved_R, so3_exp(e[:, :3]) @ R, atol=1e-14)
    np.testing.assert_allclose(moved_p, p + e[:, 3:])


def test_cameras_stand_where_the_rig_has_them() -> None:
    R, p = so3_exp(RNG.normal(size=(3, 3))), RNG.normal(size=(3, 3))
    rotations, centres = cameras_at(R, p, CAMS)
    for k in range(3):
        for c, cam in enumerate(CAMS):
            there = Pose(R[k], p[k]) @ cam
            np.testing.assert_allclose(rotations[k, c], there.rotation, atol=1e-14)
            np.testing.assert_allclose(centres[k, c], there.translation, atol=1e-14)


def test_places_of_numbers() -> None:
    ascending = np.array([2, 3, 9])
    np.testing.assert_array_equal(positions(ascending, np.array([9, 1, 3, 10, 2])), [2, -1, 1, -1, 0])
    np.testing.assert_array_equal(positions(ascending[:0], np.array([9, 1])), [-1, -1])


# -- landmarks


def test_landmarks_are_linearised_gated_and_gathered() -> None:
    """Results agree with `project`, `jacobians` and dense products, with a point behind and missing observations."""
    n, size, pose = 6, 40, 9
    points = 15 + 3 * RNG.permutation(8)[:n]
    R, p = so3_exp([0.02, -0.03, 0.4]), np.array([1.0, 2.0, 30.0])
    first_R, first_p = so3_exp([1e-3, 2e-3, -1e-3]) @ R, p + 0.01
    x = np.column_stack([RNG.uniform(-5, 5, (n, 2)), RNG.uniform(-1, 1, n)])
    x[2, 2] = 60.0  # behind
    first_x, sigma = x + 0.01 * RNG.normal(size=(n, 3)), RNG.uniform(1e-3, 2e-3, n)
    z = np.stack([project(R, p, c, x) for c in CAMS], axis=1) + 1e-3 * RNG.normal(size=(n, 2, 2))
    z[0, 1] = np.nan
    z[1] = np.nan
    (now, at), (first, first_at) = cameras_at(R[None], p[None], CAMS), cameras_at(first_R[None], first_p[None], CAMS)
    residual, by_pose, by_point = np.empty((n, 4)), np.empty((n, 4, 6)), np.empty((n, 4, 3))
    count = np.empty(n, np.int64)
    linearise_points(
        x, first_x, z, sigma, now[0], at[0], first[0], first_at[0], first_p, 0.1, residual, by_pose, by_point, count
    )
    np.testing.assert_array_equal(count, [2, 0, 0, 4, 4, 4])
    for k in range(n):
        for c, cam in enumerate(CAMS):
            rows, seen = (
                slice(2 * c, 2 * c + 2),
                np.isfinite(z[k, c, 0]) and in_camera(R[None], p[None], cam, x[[k]])[0, 2] > 0.1,
            )
            J, X = np.zeros((2, 6)), np.zeros((2, 3))
            if seen:
                (J,), (X,) = jacobians(first_R[None], first_p[None], cam, first_x[[k]])
            e = z[k, c] - project(R, p, cam, x[k]) if seen else np.zeros(2)
            np.testing.assert_allclose(residual[k, rows], e / sigma[k], rtol=1e-7, atol=1e-9)
            np.testing.assert_allclose(by_pose[k, rows], J / sigma[k], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(by_point[k, rows], X / sigma[k], rtol=1e-9, atol=1e-9)
    P, H = 1e-4 * covariance(size), np.zeros((n, 4, size))
    H[:, :, pose : pose + 6] = by_pose
    for k in range(n):
        H[k, :, points[k] : points[k] + 3] = by_point[k]
    HP, distance = np.empty((n, 4, size)), np.empty(n)
    project_covariance(P, pose, points, by_pose, by_point, HP)
    np.testing.assert_allclose(HP, H @ P, rtol=1e-9, atol=1e-9)
    gate_distances(HP, pose, points, by_pose, by_point, residual, distance)
    for k in range(n):
        wanted = residual[k] @ np.linalg.solve(H[k] @ P @ H[k].T + np.eye(4), residual[k])
        assert distance[k] == pytest.approx(wanted, rel=1e-8)
    used, scale = np.array([[3, 0], [3, 3], [5, 1], [0, 0]]), RNG.uniform(0.2, 1.0, n)
    rows, S, innovation = np.empty((4, size)), np.zeros((4, 4)), np.empty(4)
    innovation_of(HP, pose, points, by_pose, by_point, residual, used, scale, rows, S, innovation)
    h = np.array([scale[k] * H[k, r] for k, r in used])
    np.testing.assert_allclose(rows, h @ P, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(S, np.tril(h @ P @ h.T), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(innovation, [scale[k] * residual[k, r] for k, r in used])


@pytest.mark.parametrize("seed", range(2))
def test_constraints_are_summed_and_gated_as_dense_matrices(seed: int) -> None:
    observations, poses = scene(seed)
    found = marginalise_points(observations, poses, CAMS)
    n, k = found.b.shape[:2]
    A = np.zeros((n, k, 6, k, 6))
    for i in range(k):
        A[:, i, :, i] = found.A[:, i]
    V = found.V.reshape(n, 6 * k, 3)
    A = A.reshape(n, 6 * k, 6 * k) - V @ V.transpose(0, 2, 1)
    b, weight, error = found.b.reshape(n, 6 * k), RNG.uniform(0, 1, n), 1e-3 * RNG.normal(size=6 * k)
    weight[3] = 0.0
    total, right = found.information(weight)
    scale = np.abs(total).max()
    np.testing.assert_allclose(total, np.einsum("n,nij->ij", weight, A), rtol=1e-9, atol=1e-12 * scale)
    np.testing.assert_allclose(right, weight @ b, rtol=1e-9, atol=1e-9 * np.abs(right).max())
    wanted = found.misfit - 2.0 * b @ error + np.einsum("i,nij,j->n", error, A, error)
    np.testing.assert_allclose(found.misfit_at(error), wanted, rtol=1e-6, atol=1e-6)
    P = 1e-5 * covariance(6 * k)
    y = np.linalg.solve(np.eye(6 * k) + A @ P, b[..., None])[..., 0]
    np.testing.assert_allclose(
        found.mahalanobis(P), found.misfit - np.einsum("ni,ij,nj->n", b, P, y), rtol=1e-5, atol=1e-5
    )


def test_largest_eigenvalues() -> None:
    """Eigenvalues agree with NumPy for random matrices, a ball, a line, and zero."""
    line = np.outer([1.0, -2.0, 0.5], [1.0, -2.0, 0.5])
    A = np.array(
        [*(covariance(3) for _ in range(20)), 4.0 * np.eye(3), line, np.zeros((3, 3)), np.diag([1e-9, 1, 1e9])]
    )
    out = np.empty(len(A))
    largest_eigenvalues(A, out)
    np.testing.assert_allclose(out, np.linalg.eigvalsh(A)[:, -1], rtol=1e-9, atol=1e-12)


# -- inertial measurements


def samples(count: int, step_ns: int = 5_000_000) -> list[ImuSample]:
    return [ImuSample(k * step_ns, RNG.normal(size=3), 5.0 * RNG.normal(size=3)) for k in range(count)]


def test_segments_are_cut_at_the_samples() -> None:
    """Segments begin inside, before the first sample, or end beyond the last one; none exist for an empty interval."""
    some = samples(4)
    found = segments(ImuBuffer(some), 2_000_000, 12_000_000)
    np.testing.assert_allclose(found.dt, [3e-3, 5e-3, 2e-3])
    rates = np.array([[*s.angular_velocity_body, *s.specific_force_body] for s in some])
    at = [0.6 * rates[0] + 0.4 * rates[1], rates[1], rates[2], 0.6 * rates[2] + 0.4 * rates[3]]
    np.testing.assert_allclose(found.rates, [(a + b) / 2 for a, b in itertools.pairwise(at)])
    outside = segments(ImuBuffer(some), -5_000_000, 20_000_000)
    np.testing.assert_allclose(outside.dt, [5e-3] * 5)
    np.testing.assert_allclose(outside.rates[[0, -1]], rates[[0, -1]])
    assert len(segments(ImuBuffer(some), 7, 7).dt) == len(segments(ImuBuffer(), 0, 9).dt) == 0


def test_a_gap_is_as_uncertain_however_it_is_cut() -> None:
    """The variance of 1 s beyond the last sample is that of one piece, of tenths, and of pieces shorter than a gap."""
    noise = FilterSettings()
    imu = ImuBuffer([ImuSample(0, np.zeros(3), np.array([0.0, 0.0, 9.8]))])

    def variance(count: int) -> float:
        ends = np.linspace(0, 10**9, count + 1).round().astype(int)
        pieces = (preintegrate(imu, a, b, np.zeros(6), noise) for a, b in itertools.pairwise(ends))
        return float(sum(m.covariance[0, 0] for m in pieces))

    assert variance(1) == pytest.approx(0.125, rel=1e-4)
    assert variance(10) == pytest.approx(0.125, rel=0.15)
    assert variance(40) == pytest.approx(variance(10), rel=0.1)


def test_the_buffer_keeps_what_is_new() -> None:
    """The buffer grows beyond its first size, while old samples are forgotten."""
    buffer = ImuBuffer()
    for s in samples(5000):
        buffer.append(s)
        buffer.forget_before(s.t_ns - 1_500 * 5_000_000)
    assert len(buffer) == 1501
    assert buffer.last_ns == 4999 * 5_000_000
    np.testing.assert_array_equal(np.diff(buffer.times), 5_000_000)


def test_preintegration_is_that_of_numpy() -> None:
    """Preintegration agrees with M4 to M6 in dense matrices; one gap of 80 ms lies among the segments."""
    noise = FilterSettings()
    some = [*samples(6), ImuSample(105000000, RNG.normal(size=3), RNG.normal(size=3))]
    bias = 0.1 * RNG.normal(size=6)
    imu, ends = ImuBuffer(some), (1_000_000, 104_000_000)
    pieces, m = segments(imu, *ends), preintegrate(imu, *ends, bias, noise)
    R, v, p, J, C = np.eye(3), np.zeros(3), np.zeros(3), np.zeros((9, 6)), np.zeros((9, 9))
    for t, interval, since, rates in zip(pieces.dt, pieces.interval, pieces.since, pieces.rates, strict=True):
        w, a = rates[:3] - bias[:3], rates[3:] - bias[3:]
        half = so3_exp(w * t / 2)
        middle = R @ half
        A, B, W = np.eye(9), np.zeros((9, 6)), skew(w * t)
        A[:3, :3], force = (half @ half).T, -middle @ skew(a) * t
        A[3:6, :3], A[6:, :3], A[6:, 3:6] = force @ half.T, force @ half.T * t / 2, np.eye(3) * t
        B[:3, :3] = (np.eye(3) - W / 2 + W @ W / 6) * t
        B[3:6, :3], B[6:, :3], B[3:6, 3:], B[6:, 3:] = force * t / 2, force * t * t / 4, middle * t, middle * t * t / 2
        gap = interval > 0.05
        wandered = noise.acceleration_sigma**2 * (since**3 - (since - t) ** 3) / (3.0 * t**2)
        gyro = noise.gyro_noise**2 / t + gap * min(wandered, 2.0 * 0.5**2 * 0.25 / t)
        accelerometer = noise.accelerometer_noise**2 / t + gap * noise.acceleration_sigma**2 / t
        J, C = A @ J - B, A @ C @ A.T + B @ np.diag(np.repeat([gyro, accelerometer], 3)) @ B.T
        C[6:, 6:] += np.eye(3) * accelerometer * t**4 / 12
        dv = middle @ a * t
        R, p, v = middle @ half, p + (v + dv / 2) * t, v + dv
    assert m.dt == pytest.approx(0.103)
    for found, wanted in ((m.rotation, R), (m.velocity, v), (m.position, p), (m.bias_jacobian, J), (m.covariance, C)):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)
    R0, R1, moved, speed_up = so3_exp([0.1, 0.2, 0.3]), so3_exp([0.3, 0.1, 0.0]), RNG.normal(size=3), RNG.normal(size=3)
    F, Q = np.empty((15, 15)), np.empty((15, 15))
    inertial_transition_into(R0, R1, moved, speed_up, m.dt, J, C, F, Q)
    full, G = np.eye(15), np.zeros((15, 9))
    full[3:6, 6:9], full[6:9, :3], full[3:6, :3] = np.eye(3) * m.dt, -skew(speed_up), -skew(moved)
    G[:3, :3], G[6:9, 3:6], G[3:6, 6:] = R1, R0, R0
    full[:, 9:] += G @ J
    np.testing.assert_allclose(F, full, atol=1e-12)
    np.testing.assert_allclose(Q, G @ C @ G.T, rtol=1e-9, atol=1e-15)


# -- predicted pixels


LENSES = [
    Camera(320, 240, 300.0, 310.0, 159.5, 119.5),
    Camera(320, 240, 300.0, 310.0, 159.5, 119.5, "radial-tangential", (-0.1, 0.02, 1e-3, -5e-4, 1e-3)),
    Camera(320, 240, 200.0, 210.0, 159.5, 119.5, "equidistant", (-0.02, 0.01, -0.003, 1e-3)),
]


@pytest.mark.parametrize("camera", LENSES, ids=lambda c: c.model)
def test_points_are_carried_to_another_view(camera: Camera) -> None:
    """Points on the axis, beside it, and behind the camera are transferred."""
    rays, depth = RNG.uniform(-0.5, 0.5, (12, 2)), RNG.uniform(5.0, 40.0, 12)
    other_from_first = Pose(so3_exp([0.02, -0.03, 0.4]), [0.5, 0.1, -10.0])
    points, pixels = np.empty((12, 3)), np.empty((12, 2))
    R, t = other_from_first.rotation, other_from_first.translation
    depth[0], rays[1] = 3.0, 0.0
    lens = np.array([camera.fu, camera.fv, camera.cu, camera.cv])
    carry_points(rays, depth, R, t, lens, camera.code, camera.coefficients, points, pixels)
    wanted = other_from_first.apply(np.column_stack([rays, np.ones(12)]) * depth[:, None])
    np.testing.assert_allclose(points, wanted, atol=1e-12)
    np.testing.assert_allclose(pixels, camera.project(wanted), atol=1e-9)
    assert np.isnan(pixels[0]).all()


def test_covariance_of_predicted_pixels() -> None:
    """The covariance agrees with rotations and shifts of the points, each projected by differences."""
    points, by_depth, Q = np.array([[1.0, -2.0, 20.0], [0.0, 0.0, 5.0]]), RNG.normal(size=(2, 3)), 1e-4 * covariance(6)
    found = pixel_covariance(points, by_depth, 300.0, Q)

    def pixels(x: F64) -> F64:
        return 300.0 * x[:, :2] / x[:, 2:]

    def moved(motion: F64) -> F64:
        h = 1e-6
        return (pixels(points + h * motion) - pixels(points - h * motion)) / (2 * h)

    J = np.stack(
        [moved(np.cross(e, points)) for e in np.eye(3)] + [moved(np.tile(e, (2, 1))) for e in np.eye(3)], axis=2
    )
    u = moved(by_depth)
    np.testing.assert_allclose(found, J @ Q @ J.transpose(0, 2, 1) + u[:, :, None] * u[:, None], rtol=1e-6)
    np.testing.assert_allclose(pixel_covariance(points, by_depth, 300.0, None), u[:, :, None] * u[:, None], rtol=1e-6)


def test_two_views_give_depth_and_distance_from_the_line() -> None:
    """Depth and distance are right for exact matches, matches beside the line, and missing ones."""
    other_from_first = Pose(so3_exp([0.01, 0.02, -0.01]), [0.5, 0.05, 0.02])
    x = np.column_stack([RNG.uniform(-5, 5, (8, 2)), RNG.uniform(10, 30, 8)])
    there = other_from_first.apply(x)
    first, other = x[:, :2] / x[:, 2:], there[:, :2] / there[:, 2:]
    w, arm = inverse_depth(first, other, other_from_first)
    np.testing.assert_allclose(w, 1.0 / x[:, 2], rtol=1e-9)
    np.testing.assert_allclose(epipolar_distance(first, other, other_from_first), 0.0, atol=1e-12)
    t, R = other_from_first.translation, other_from_first.rotation
    rays = np.column_stack([other, np.ones(8)])
    np.testing.assert_allclose(arm, np.linalg.norm(np.cross(t, rays), axis=1))
    other[0] += [0.0, 1e-3]
    other[1] = np.nan
    lines = np.column_stack([first, np.ones(8)]) @ (skew(t) @ R).T
    wanted = np.abs((lines[0] * [*other[0], 1.0]).sum()) / np.hypot(*lines[0, :2])
    found = epipolar_distance(first, other, other_from_first)
    assert found[0] == pytest.approx(wanted)
    assert np.isnan(found[1])
    assert np.isnan(inverse_depth(first, other, other_from_first)[0][1])


# -- patches


def test_features_are_followed_from_picture_to_picture() -> None:
    """A shift by a part of a pixel is found from a start half a pixel off. No match is found at the edge or on another
    picture."""
    image = picture(4)
    map_ = np.array([[1.0, 0.0, 2.3], [0.0, 1.0, -1.6]])
    moved = cv2.warpAffine(image, map_, (160, 120), flags=cv2.INTER_LINEAR)
    moved[60:] = picture(8)[60:]
    pixels = np.array([[40.0, 30.0], [100.0, 40.0], [80.0, 95.0], [4.0, 40.0]])
    start = (pixels + map_[:, 2] + 0.6).astype(np.float32)
    found, good = follow_patches(image, moved, pixels, start, TracksSettings(window_px=15))
    assert good.tolist() == [True, True, False, False]
    np.testing.assert_allclose(found[:2], pixels[:2] + map_[:, 2], atol=0.05)


def test_new_patches_leave_held_ones_as_they_are() -> None:
    """Held patches stay unchanged while others go and new ones come."""
    image, rng = picture(1), np.random.default_rng(2)
    held = (
        FeaturePatches.none(15)
        .with_new(image, np.arange(200), rng.uniform(25, 90, (200, 2)), Pose())
        .select(np.arange(0, 200, 2))
    )
    before = held.grey[held.slots].copy()
    for number, count in ((1, 100), (2, 300)):
        ids = 1000 * number + np.arange(count)
        more = held.with_new(255 - image, ids, rng.uniform(25, 90, (count, 2)), Pose())
        assert len(set(more.slots.tolist())) == 100 + count
        assert (np.diff(more.ids) > 0).all()
        np.testing.assert_array_equal(more.grey[more.slots[:100]], before)
        k = 100 + count // 2
        row, col = (np.rint(more.pixels[k] - more.places[k]).astype(int) + 5)[::-1]
        assert more.grey[more.slots[k], 5, 5] == 255 - image[row, col]
