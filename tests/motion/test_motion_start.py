"""Starts without attitude (M26) or with a poor one, and exposures without keyframes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from point_flight import DOWN, NOISE, RIG, PointFlight, blind, error, fed, run, seconds

from alight.arrays import F64
from alight.geometry import Pose, so3_exp, so3_log
from alight.motion import MotionFilter
from alight.motion.ekf.initial_attitude import CourseAttitude, attitude_from_course
from alight.records import Event, Motion, MotionState, NavSample, Tracks

SMALL = NOISE.model_copy(update={"points": 12, "clones": 6})
CAM = Pose(DOWN, [0.1, 0.25, 0.0])


def bare(e: Event | Tracks) -> Event | Tracks:
    """The event; a row of GPS/INS has its position only."""
    if not isinstance(e, NavSample):
        return e
    return replace(e, world_from_body=None, sigma_attitude=None, velocity_world=None, angular_velocity_body=None)


def course(tilt: F64, way: F64, way_sigma: float = 0.0, seed: int = 0) -> tuple[CourseAttitude | None, F64]:
    """The attitude by a way at 30 m between a level exposure and a tilted one, and the true one there."""
    rng, turn = np.random.default_rng(seed), so3_exp([0.0, 0.0, 0.7])
    bodies = Pose(turn, [0.0, 0.0, 30.0]), Pose(so3_exp(tilt) @ turn, way + np.array([0.0, 0.0, 30.0]))
    x = np.column_stack([rng.uniform(-15, 15, (80, 2)), rng.normal(size=80) * 0.5])
    seen = []
    for body in bodies:
        q = (body @ CAM).inverse.apply(x)
        z = (q[:, :2] / q[:, 2:] + 5e-4 * rng.normal(size=(80, 2)))[:, None]
        seen.append(Tracks(0, np.arange(80), z, z))
    return attitude_from_course(seen[0], seen[1], way[:2], way_sigma, CAM), turn


def heading_error(found: CourseAttitude, true: F64) -> float:
    return float(so3_log(found.R @ true.T)[2])


@pytest.mark.parametrize("seed", range(4))
def test_a_change_of_the_tilt_is_not_taken_for_a_way(seed: int) -> None:
    """The camera tilts by 50 mrad while it flies 2 m: its image shifts as much as by the flight."""
    found, true = course(np.array([0.03, 0.04, 0.0]), np.array([1.2, 1.6, 0.0]), seed=seed)
    assert found is not None
    assert abs(heading_error(found, true)) < 0.2
    assert abs(heading_error(found, true)) < 3.0 * found.sigma[2]


def test_the_heading_is_as_sure_as_way_and_shift() -> None:
    """The claimed sigma follows the error of GPS over the way, and that of the shift over the shift."""
    sure, _ = course(np.zeros(3), np.array([6.0, 8.0, 0.0]))
    vague, _ = course(np.zeros(3), np.array([6.0, 8.0, 0.0]), way_sigma=2.0)
    short, _ = course(np.zeros(3), np.array([0.3, 0.4, 0.0]))
    assert sure is not None
    assert vague is not None
    assert short is not None
    assert sure.sigma[2] == pytest.approx(0.05, rel=0.1)
    assert vague.sigma[2] == pytest.approx(0.2, rel=0.1)
    assert short.sigma[2] > 1.25 * sure.sigma[2]


@pytest.mark.parametrize("white", [0.05, 0.5])
def test_a_start_from_the_course_is_within_its_sigma(white: float) -> None:
    """Without IMU and attitude, over six flights; with a poor GPS the filter waits for a longer way."""
    noise, ratios, starts = SMALL.model_copy(update={"nav_position_white": white}), [], []
    for seed in range(1, 7):
        f = PointFlight(seed=seed, seconds=1.6, count=40, imu=False, noise=noise)
        motions = run([bare(e) for e in f.events], noise)[1]
        e, covariance = error(motions[0], f.truth(motions[0].t_ns))
        ratios.append(e[5] / np.sqrt(covariance[5, 5]))
        starts.append(seconds(motions[0]))
    assert float(np.sqrt(np.mean(np.square(ratios)))) < 2.0
    assert (max(starts) > 0.35) == (white > 0.1)


def test_a_photo_is_levelled_at_its_own_time() -> None:
    """Photos 3 s apart; the last GPS row is 0.19 s older. Taken as level at the photo, its tilt is known to 0.1 rad."""
    f = PointFlight(seed=3, seconds=7.0, count=150, imu=False, speed=2.0)
    events = [bare(e) for e in f.events if not isinstance(e, Tracks) or round(seconds(e) * 10) % 30 == 0]
    late = [e for e in events if isinstance(e, Tracks) or (3.0 - seconds(e)) % 3.0 > 0.18]
    motions = run(late, SMALL)[1]
    assert len(motions) == 2
    assert float(np.sqrt(np.diag(motions[1].covariance)[3:5]).max()) < 0.105


def test_a_row_that_claims_little_starts_no_map_of_its_own() -> None:
    """GPS/INS claims a tilt to 0.25 rad: that is lost at first, but each row is not a new start."""
    f = PointFlight(seed=1, seconds=2.0, imu=False, count=40)
    poor = np.array([0.25, 0.25, 0.5])
    motions = run([replace(e, sigma_attitude=poor) if isinstance(e, NavSample) else e for e in f.events], SMALL)[1]
    assert motions[0].state is MotionState.LOST
    assert motions[-1].state is not MotionState.LOST
    assert motions[-1].frame_id <= 1


def test_an_exposure_without_keyframes_has_a_posterior() -> None:
    """A blank exposure at the start, and one at which all clones were dropped: the pose by itself, with its error."""
    f = PointFlight(seed=1, seconds=1.0, count=30)
    estimator = MotionFilter(RIG, SMALL)
    assert estimator.clone_window() is None
    motion: Motion | None = None
    for e in f.events:
        event = blind(e) if isinstance(e, Tracks) else e
        (motion,) = fed(estimator, [event]) or [motion]
        if motion is not None:
            break
    window, state = estimator.clone_window(), estimator.state
    assert motion is not None
    assert window is not None
    assert state is not None
    found = window.posterior()
    assert [m.t_ns for m in found.motions] == [motion.t_ns]
    np.testing.assert_allclose(found.covariance[3:, 3:], state.P[:3, :3])
    np.testing.assert_allclose(found.motions[0].world_from_body.matrix, motion.world_from_body.matrix, atol=1e-9)
