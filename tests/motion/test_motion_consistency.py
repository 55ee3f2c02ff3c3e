"""The filter against its own claims: seeded flights without images, and the properties of its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from length import first
from point_flight import NOISE, PointFlight, error, nees, run
from pose_window import ALIKE, CAMS, clone_slice, ground, moved, row_of_poses, seen_from, window_at
from scipy.stats import chi2

from alight.arrays import F64
from alight.geometry import skew, so3_exp, so3_log
from alight.motion.ekf.health import MAX_REJECTIONS
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.state import AT, CORE, FilterState, Landmarks
from alight.motion.ekf.visual_update import reject_moving
from alight.motion.gps_ins import Quantity, measurements
from alight.motion.points import marginalise_points, triangulate_window, unit_noise_rows
from alight.motion.robust import robust_pose_weights
from alight.records import Motion, NavSample, Tracks

SMALL = NOISE.model_copy(update={"points": 12, "clones": 6})


@pytest.fixture(scope="module", params=first(1, [25, 50]))
def flights(request: pytest.FixtureRequest) -> list[tuple[PointFlight, list[Motion]]]:
    out = []
    for seed in range(request.param):
        f = PointFlight(seed=seed, seconds=2.0, count=40, imu=seed % 5 != 0)
        out.append((f, run(f.events, SMALL)[1]))
    return out


def test_nees_of_the_pose_stays_in_its_band(flights: list[tuple[PointFlight, list[Motion]]]) -> None:
    """Over 25 or 50 flights, one in five without IMU, the mean NEES lies in its 95 % band at nine of ten exposures."""
    found = np.array([[nees(m, f.truth(m.t_ns)) for m in motions] for f, motions in flights]).mean(axis=0)
    n = len(flights)
    low, high = chi2.ppf([0.025, 0.975], 6 * n) / n  # of the mean over the flights, 6 expected
    assert len(found) == 20
    assert np.mean((found > low) & (found < high)) >= 0.9


def test_each_part_of_the_pose_is_as_good_as_it_claims(flights: list[tuple[PointFlight, list[Motion]]]) -> None:
    """Position and attitude, each axis: errors at the end over their sigma have a spread of about one."""
    found = [error(motions[-1], f.truth(motions[-1].t_ns)) for f, motions in flights]
    spread = np.sqrt(np.mean([e**2 / np.diag(c) for e, c in found], axis=0))
    assert spread.min() > 0.7
    assert spread.max() < 1.35


# -- parts ---------------------------------------------------------------------------------------------------------

angles = st.floats(-0.3, 0.3)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_rays_meet_in_their_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, x = row_of_poses(rng), ground(rng)
    np.testing.assert_allclose(triangulate_window(seen_from(poses, x, rng), poses, CAMS), x, atol=1e-5)


@given(st.integers(0, 1000), st.tuples(angles, angles, angles))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_turning_and_moving_everything_is_not_seen(seed: int, turn: tuple[float, float, float]) -> None:
    """A rigid motion of all poses (about any axis) leaves every eliminated row unchanged: it cannot be observed."""
    rng = np.random.default_rng(seed)
    poses, x = row_of_poses(rng), ground(rng)
    found = marginalise_points(seen_from(poses, x, rng, 1e-3), poses, CAMS, x)
    A, b = found.information(np.ones(len(x)))
    move = np.concatenate(
        [np.concatenate([turn, np.cross(turn, p) + np.array([0.1, -0.2, 0.3])]) for p in poses.first_p]
    )
    assert np.abs(A @ move).max() < 1e-6 * np.abs(A).max()
    assert abs(b @ move) < 1e-5 * np.linalg.norm(b) * np.linalg.norm(move)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_misfits_follow_the_poses(seed: int) -> None:
    """Misfits predicted for slightly moved poses agree with those computed anew at these poses."""
    rng = np.random.default_rng(seed)
    poses, x = row_of_poses(rng), ground(rng)
    observations, error = seen_from(poses, x, rng, 1e-3), 1e-4 * rng.normal(size=24) * np.tile([1, 1, 1, 20, 20, 20], 4)
    there = marginalise_points(observations, moved(poses, error), CAMS).misfit
    predicted = marginalise_points(observations, poses, CAMS).misfit_at(error)
    np.testing.assert_allclose(predicted, there, rtol=0.05, atol=0.2)


def test_features_that_drift_together_get_little_weight() -> None:
    """A third of the features drifts by a sigma from pose to pose, as water does, which passes every gate.

    They get little weight, and the poses are less than twice as far off as with the others alone. With equal weights
    they are three times as far off as that.
    """
    rng, drift = np.random.default_rng(9), np.array([1.0, 0.4]) * 1e-3
    off: dict[str, list[float]] = {"all": [], "still": [], "alike": []}
    for _ in range(10):
        poses, x = row_of_poses(rng, 6), ground(rng, 60)
        observations = seen_from(poses, x, rng, 3e-4)
        moves = np.arange(60) < 20
        observations.normalised[moves] += np.arange(6)[:, None, None] * drift
        state = window_at(poses, 4e-6, 1e-2)
        found = marginalise_points(observations, poses, CAMS)
        weight = robust_pose_weights(found, state.P[CORE:, CORE:], np.ones(60, bool), np.zeros(36))[0]
        assert weight[moves].mean() < 0.25 * weight[~moves].mean()
        for name, some in (("all", observations), ("still", observations.select(~moves))):
            p = CloneWindow.of(state, some, CAMS, ALIKE).refined().clones.p - poses.p
            off[name].append(float(np.linalg.norm(p[-1] - p[0])))
        A, b = found.information(np.ones(60))
        e = (np.linalg.solve(np.eye(36) + state.P[CORE:, CORE:] @ A, state.P[CORE:, CORE:] @ b)).reshape(-1, 6)
        off["alike"].append(float(np.linalg.norm(e[-1, 3:] - e[0, 3:])))
    rms = {k: float(np.sqrt(np.mean(np.square(v)))) for k, v in off.items()}
    assert rms["all"] < 2.0 * rms["still"], rms
    assert rms["alike"] > 3.0 * rms["all"], rms


def test_a_point_that_lags_behind_is_dropped() -> None:
    """The point's residuals are always on one side; those of others are nearly as large, and on any side."""
    rng = np.random.default_rng(2)
    points, all_of_them = Landmarks.new(np.arange(12), np.zeros((12, 3)), np.zeros((12, 3)), 4), np.arange(12)
    for _ in range(12):
        residual = 0.5 * rng.normal(size=(12, 4)) / 2.0
        residual[0] = 0.4 * np.array([1.0, -1.0, 1.0, -1.0]) + 0.02 * rng.normal(size=4)
        points = reject_moving(points, all_of_them, residual)
    assert (points.rejections >= MAX_REJECTIONS).tolist() == [True] + [False] * 11


def test_gps_and_ins_rows_agree_with_differences() -> None:
    """The Jacobians of M14 to M16 by every part of the core agree with differences of the residuals."""
    rng = np.random.default_rng(4)
    state = FilterState(0, so3_exp(rng.normal(size=3)), rng.normal(size=CORE), np.eye(CORE))
    state.core[AT.nav_att] *= 1e-3  # degrees at most: H replaces the error of a turned frame by that of the frame
    sample = NavSample(0, rng.normal(size=3), state.R @ so3_exp([1e-3, 2e-3, -1e-3]), rng.normal(size=3))
    sigma, h = np.ones(9), 1e-6

    def left(error: F64) -> F64:
        R = so3_exp(error[:3]) @ state.R
        core = np.concatenate([state.core[:3], state.core[3:] + error[3:]])
        return np.concatenate(
            [z.residual for z in measurements(FilterState(0, R, core, state.P), sample, sigma, NOISE, True)]
        )

    H = np.concatenate([z.H for z in measurements(state, sample, sigma, NOISE, True)])
    numeric = np.column_stack([(left(h * e) - left(-h * e)) / (2 * h) for e in np.eye(CORE)])
    np.testing.assert_allclose(-H, numeric, atol=5e-3)


def test_a_new_clone_agrees_with_differences() -> None:
    """The derivatives of a clone by attitude and mounting agree with differences of the rig's pose."""
    rng, h = np.random.default_rng(6), 1e-6
    state = FilterState(0, so3_exp(rng.normal(size=3)), np.zeros(CORE), np.diag(rng.uniform(1.0, 2.0, CORE)))
    state.core[AT.mount], state.P[AT.time, AT.time] = 1e-3 * rng.normal(size=3), 0.0
    before = np.maximum(state.P.diagonal(), 1.0)
    state.add_clone(0)
    J = state.P[clone_slice(0), :CORE] / before
    for part in (AT.att, AT.mount):
        for k, e in enumerate(h * np.eye(3)):
            R = so3_exp(e) @ state.R if part is AT.att else state.R
            mount = state.core[AT.mount] + (e if part is AT.mount else 0.0)
            turned = so3_log(R @ so3_exp(mount) @ state.rig.T) / h
            np.testing.assert_allclose(J[:3, part][:, k], turned, atol=2e-3)
    np.testing.assert_allclose(J[3:, AT.pos], np.eye(3), atol=1e-12)


def test_eliminated_rows_agree_with_differences() -> None:
    """The numerical gradient of the misfit by the poses, with points at their best, is -2 b."""
    rng = np.random.default_rng(5)
    poses, x = row_of_poses(rng, 3), ground(rng, 6)
    observations = seen_from(poses, x, rng, 1e-3)

    def misfit(d: F64) -> float:
        return float(marginalise_points(observations, moved(poses, d), CAMS).misfit.sum())

    _, b = marginalise_points(observations, poses, CAMS).information(np.ones(6))
    h = 1e-6
    numeric = np.array([(misfit(h * e) - misfit(-h * e)) / (2 * h) for e in np.eye(18)])
    np.testing.assert_allclose(-2.0 * b, numeric, rtol=1e-3, atol=2e-3 * np.abs(b).max())


def test_rows_of_unit_noise_have_the_information() -> None:
    rng = np.random.default_rng(6)
    J = rng.normal(size=(9, 12))
    A, b = J.T @ J, J.T @ rng.normal(size=9)  # rank 9 of 12
    r, H = unit_noise_rows(A, b)
    assert len(r) == 9
    np.testing.assert_allclose(H.T @ H, A, atol=1e-9)
    np.testing.assert_allclose(H.T @ r, b, atol=1e-9)


def test_a_correction_is_that_of_least_squares() -> None:
    """Covariance and mean after a measurement are those of the information form."""
    rng = np.random.default_rng(7)
    L = rng.normal(size=(CORE, CORE))
    P, H, r = L @ L.T, rng.normal(size=(4, 3)), rng.normal(size=4)
    columns, full = np.array([3, 16, 28]), np.zeros((4, CORE))
    full[:, columns] = H
    state = FilterState(0, np.eye(3), np.zeros(CORE), P.copy())
    state.correct(r, H, columns)
    np.testing.assert_allclose(state.P, np.linalg.inv(np.linalg.inv(P) + full.T @ full), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(state.core[3:], (state.P @ full.T @ r)[3:], rtol=1e-6, atol=1e-8)


def test_the_refined_keyframes_are_those_of_one_large_adjustment() -> None:
    """With a loose prior of the poses and many observations, errors are small and fit their covariance."""
    rng = np.random.default_rng(8)
    true, x = row_of_poses(rng, 4), ground(rng, 40)
    state = FilterState(0, true.R[0], np.zeros(CORE), np.eye(CORE) * 1e-12)
    state.core[3:6] = true.p[0]
    for k in range(4):  # the first is exact, the others have errors as by their prior
        off = np.zeros(6) if k == 0 else rng.normal(size=6) * np.repeat([2e-3, 0.2], 3)
        state.R, state.core[3:6] = so3_exp(off[:3]) @ true.R[k], true.p[k] + off[3:]
        state.add_clone(k)
        at = clone_slice(k)
        state.P[at, :], state.P[:, at] = 0.0, 0.0
        state.P[at, at] = np.diag(np.repeat([4e-6, 4e-2], 3) if k else np.full(6, 1e-12))
    found = CloneWindow.of(state, seen_from(true, x, rng, 1e-3), CAMS, ALIKE).refined()
    e = (found.clones.p - true.p).ravel()
    assert np.abs(e).max() < 0.15
    sigma = np.sqrt(np.diag(found.P).reshape(4, 6)[1:, 3:]).ravel()
    assert 0.4 < np.sqrt(np.mean((e[3:] / sigma) ** 2)) < 1.6


def test_keyframes_claim_less_where_observations_disagree() -> None:
    """With residuals of five sigmas and ten observations that count as one, poses relative to the last one get 10 x 25
    times the variance, and the covariance of the last one stays."""
    rng, wide = np.random.default_rng(8), ALIKE.model_copy(update={"pixel_repeat": 10.0})
    true, x = row_of_poses(rng, 4), ground(rng, 200)
    state = window_at(true, 4e-2, 100.0)
    observations = seen_from(true, x, rng, 5e-3)
    tight, loose = (CloneWindow.of(state, observations, CAMS, s).refined() for s in (ALIKE, wide))
    np.testing.assert_array_equal(loose.clones.p, tight.clones.p)
    np.testing.assert_allclose(loose.P[-6:, -6:], tight.P[-6:, -6:])
    seen = []
    for found in (tight, loose):
        as_seen = np.eye(24)[:6] - np.eye(24)[-6:]
        as_seen[3:, -6:-3] = skew(found.clones.p[0] - found.clones.p[-1])
        seen.append(as_seen @ found.P @ as_seen.T)
    np.testing.assert_allclose(seen[1], seen[0] * (seen[1][0, 0] / seen[0][0, 0]), rtol=1e-6, atol=1e-12)
    assert 0.8 * 250.0 < seen[1][0, 0] / seen[0][0, 0] < 1.2 * 250.0


def test_observations_that_contradict_the_poses_as_a_whole_move_none_of_them() -> None:
    """Half a turn lies between two exposures, as if the lines of a car park were confused: all observations are wrong
    alike, so that none stands out from the median."""
    rng = np.random.default_rng(8)
    true, x = row_of_poses(rng, 4), ground(rng, 40)
    state = window_at(true, 4e-6, 4e-2)
    good = seen_from(true, x, rng, 1e-3)
    turned = good.normalised.copy()
    turned[:, 2:] *= -1.0
    for observations, moves in ((good, True), (replace(good, normalised=turned), False)):
        window = CloneWindow.of(state, observations, CAMS, ALIKE)
        found = window.refined()
        assert (np.abs(found.clones.p - true.p).max() > 0.0) == moves
        assert (found.P[-1, -1] < window.P[-1, -1]) == moves
    np.testing.assert_array_equal(found.P, window.P)


@pytest.mark.parametrize("wrong", [None, Quantity.POSITION, Quantity.VELOCITY])
def test_each_quantity_of_a_row_has_a_gate_of_its_own(wrong: Quantity | None) -> None:
    """A position 100 m off, or a velocity 30 m/s off, is rejected alone; health and state follow the others."""
    f = PointFlight(seed=3, seconds=2.0, count=40)
    estimator, motions = run([e for e in f.events if f.seconds_of(e) < 1.5], SMALL)
    last = motions[-1].world_from_body.translation
    for k, row in enumerate(e for e in f.events if isinstance(e, NavSample) and f.seconds_of(e) >= 1.5):
        assert row.position_world is not None
        assert row.velocity_world is not None
        if wrong is Quantity.POSITION:
            row = replace(row, position_world=row.position_world + np.array([100.0, 0.0, 0.0]))
        if wrong is Quantity.VELOCITY:
            row = replace(row, velocity_world=row.velocity_world + np.array([0.0, 30.0, 0.0]))
        estimator.feed(row)
        state = estimator.state
        assert state is not None
        assert np.linalg.norm(state.core[AT.pos] - last) < 5.0
        if k == 2:
            break
    motion = estimator.feed(next(e for e in f.events if isinstance(e, Tracks) and e.t_ns > state.t_ns))
    assert motion is not None
    assert ("GPS is at odds" in motion.why) == (wrong is Quantity.POSITION)
