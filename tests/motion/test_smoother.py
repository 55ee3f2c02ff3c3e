"""The smoother over gaps of the IMU, sparse exposures and guessed attitudes: flights without images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from point_flight import NOISE, PointFlight, error, run, seconds

from alight.arrays import F64
from alight.geometry import Pose
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import Preintegral, preintegrate
from alight.motion.smoother import smoother
from alight.motion.smoother.block_tridiagonal import BlockTridiagonal
from alight.motion.smoother.track_segments import TrackSegments
from alight.records import Event, ImuSample, Motion, NavSample, Tracks
from alight.settings import FilterSettings

SMOOTH = NOISE.model_copy(update={"smooth": True, "points": 12, "clones": 6})
Keep = Callable[[Event | Tracks], bool]


def smoothed(f: PointFlight, keep: Keep = lambda e: True) -> list[Motion]:
    return list(run([e for e in f.events if keep(e)], SMOOTH)[0].refined().motions)


def relative(f: PointFlight, motions: list[Motion]) -> F64:
    """(K, 6) errors of position [m] and attitude [rad] less those of the middle exposure."""
    e = np.array([error(m, f.truth(m.t_ns))[0] for m in motions])
    return np.asarray(e - e[len(e) // 2])


def imu(within: Callable[[float], bool]) -> Keep:
    """Keep all events but inertial samples at other times."""
    return lambda e: not isinstance(e, ImuSample) or within(seconds(e))


@pytest.mark.parametrize(
    "within",
    [
        lambda t: not 1.02 < t < 1.25,
        lambda t: t < 1.5,
        lambda t: t > 0.15,
        lambda t: round(t * 200) % 25 == 0,
    ],
    ids=["gap of 0.23 s", "ends early", "starts late", "8 Hz"],
)
def test_exposures_without_an_inertial_sample_between_are_smoothed(within: Callable[[float], bool]) -> None:
    """One piece between two exposures: its covariance has an inverse, and the flight stays one consistent one."""
    f = PointFlight(seed=1, seconds=2.0, count=40)
    motions = smoothed(f, imu(within))
    assert len(motions) == 20
    assert np.linalg.norm(relative(f, motions)[:, 3:], axis=1).max() < 5e-3


@pytest.mark.parametrize("seed", [1, 3])
def test_before_the_first_inertial_sample_the_motion_is_that_without_imu(seed: int) -> None:
    """The IMU starts a second late: what stands in place of the bias before is the angular velocity."""
    f = PointFlight(seed=seed, seconds=2.0, count=40)
    motions = smoothed(f, imu(lambda t: t > 1.0))
    assert np.linalg.norm(relative(f, motions)[:, 3:], axis=1).max() < 5e-3


def test_the_imu_drives_no_exposure_well_before_its_first_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exposures more than 0.05 s before the first sample have the constant velocity of the filter there. At a later
    one, the filter had an angular velocity where the smoother has a bias: that starts from zero."""
    f, begins, biases = PointFlight(seed=1, seconds=2.0, count=40), list[float](), list[F64]()

    def summed(samples: ImuBuffer, start_ns: int, end_ns: int, bias: F64, noise: FilterSettings) -> Preintegral:
        begins.append((start_ns - samples.first_ns) * 1e-9)
        biases.append(bias[:3].copy())
        return preintegrate(samples, start_ns, end_ns, bias, noise)

    monkeypatch.setattr(smoother, "preintegrate", summed)
    smoothed(f, imu(lambda t: t > 1.03))
    before = np.array(begins) < 0.0
    assert len(begins) > 9
    assert before.any()
    assert min(begins) >= -0.05
    assert not np.array(biases)[before].any()
    assert np.array(biases)[~before].any()


def test_rows_between_sparse_exposures_have_the_noise_of_the_motion_model() -> None:
    """Without IMU and with 2 s between exposures: rows do not pull the exposures before them out of shape."""
    f = PointFlight(seed=2, seconds=12.0, count=60, imu=False, speed=2.0, height=40.0)
    motions = smoothed(f, lambda e: not isinstance(e, Tracks) or round(seconds(e) * 10) % 20 == 0)
    shape = relative(f, motions)
    assert len(motions) == 6
    assert np.linalg.norm(shape[:, 3:], axis=1).max() < 3e-3


def test_rows_long_after_the_last_exposure_change_nothing() -> None:
    f = PointFlight(seed=1, seconds=6.0, count=40, imu=False)

    def until(end: float) -> F64:
        out = smoothed(f, lambda e: seconds(e) < (1.55 if isinstance(e, Tracks) else end))
        return np.array([np.concatenate([m.world_from_body.matrix.ravel(), m.covariance.ravel()]) for m in out])

    np.testing.assert_array_equal(until(1.6), until(6.0))


def test_a_guessed_attitude_is_as_uncertain_as_in_the_filter() -> None:
    """A flight without attitude starts from a camera that is taken to look down within 0.1 rad (M26)."""
    f = PointFlight(seed=2, seconds=3.0, count=40, imu=False)
    bare = {"world_from_body": None, "velocity_world": None, "angular_velocity_body": None}
    events = [replace(e, **bare) if isinstance(e, NavSample) else e for e in f.events]  # type: ignore[arg-type]
    motions = run(events, SMOOTH)[0].refined().motions
    tilts = np.array([np.sqrt(np.diag(m.covariance)[3:5]).max() for m in motions])
    assert len(motions) > 20
    assert tilts.min() > 0.06


def test_gps_that_becomes_better_places_the_flight_better() -> None:
    """The first rows claim 10 m, all others 0.1 m: so does the result."""
    f = PointFlight(seed=4, seconds=2.0, count=40, sigma_position=(0.1, 0.1, 0.1))
    poor = np.full(3, 10.0)
    events = [replace(e, sigma_position=poor) if isinstance(e, NavSample) and seconds(e) < 0.3 else e for e in f.events]
    motions = run(events, SMOOTH)[0].refined().motions
    assert np.sqrt(np.diag(motions[-1].covariance)[:3]).max() < 0.2


def test_points_behind_the_cameras_count_as_misfit() -> None:
    """Most segments have a point behind a camera: the misfit is that of the worst other one, not nothing."""
    z = np.zeros((3, 1, 2))
    tracks = [Tracks(k, np.arange(3), z[:, 0], z) for k in range(4)]
    some = TrackSegments(tracks, np.full(12, 1e-3), (Pose(np.eye(3), np.zeros(3)),), 10)
    R, p = np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3))
    some.points = np.array([[0.0, 0.0, -5.0], [0.0, 0.0, -5.0], [0.01, 0.0, 5.0]])
    assert some.median_misfit(R, p) == pytest.approx(4 * 2.0**2 / 5)


def test_a_block_tridiagonal_system_is_solved_as_the_dense_one() -> None:
    """The solution, the diagonal blocks of the inverse, and the inverse at any unknowns in any blocks."""
    rng, size, count = np.random.default_rng(2), 4, 5
    A, g, system = np.zeros((20, 20)), np.zeros(20), BlockTridiagonal(count, size)
    for b in range(count):
        rows = np.arange(size * b, min(size * (b + 2), 20))
        root = rng.normal(size=(len(rows), len(rows) + 3))
        A[np.ix_(rows, rows)] += root @ root.T
        g[rows] += root.sum(axis=1)
        system.add(rows, root @ root.T, root.sum(axis=1))
    system.factorise()
    rows, inverse, own = np.array([1, 2, 5, 9, 10, 17, 18]), np.linalg.inv(A), system.covariance()
    np.testing.assert_allclose(system.solution(), np.linalg.solve(A, g), rtol=1e-8)
    np.testing.assert_allclose(own, [inverse[4 * b : 4 * b + 4, 4 * b : 4 * b + 4] for b in range(5)], atol=1e-12)
    np.testing.assert_allclose(system.joint(rows, own), inverse[np.ix_(rows, rows)], atol=1e-12)
