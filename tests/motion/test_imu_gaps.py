"""Times without inertial samples: their covariance, and the samples that filter and tracker keep for old states."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from point_flight import NOISE, PointFlight, error, run, seconds

from alight.arrays import F64
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import Preintegral, preintegrate
from alight.pipeline.navigation import filter_lane
from alight.records import Frame, ImuSample, Prediction, Tracks
from alight.settings import FilterSettings, Settings

MS = 1_000_000  # ns
UP = np.array([0.0, 0.0, 9.8])


def sample(ms: float, yaw_rate: float = 0.0) -> ImuSample:
    return ImuSample(round(ms * MS), np.array([0.0, 0.0, yaw_rate]), UP)


def summed(imu: ImuBuffer, start_ms: float, end_ms: float) -> Preintegral:
    return preintegrate(imu, round(start_ms * MS), round(end_ms * MS), np.zeros(6), FilterSettings())


def test_one_piece_has_the_covariance_of_white_acceleration() -> None:
    """Position, velocity and both together over 40 ms: q t^3/3, q t, q t^2/2; so the covariance has an inverse."""
    noise, t = FilterSettings(), 0.04
    C = summed(ImuBuffer([sample(0), sample(40)]), 0, 40).covariance
    q = noise.accelerometer_noise**2
    np.testing.assert_allclose([C[8, 8], C[5, 5], C[5, 8]], [q * t**3 / 3, q * t, q * t**2 / 2])
    unit = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / np.outer(unit, unit)).min() > 0.05


@pytest.mark.parametrize("length", [60, 100, 170])
def test_a_gap_that_has_ended_is_as_uncertain_however_it_is_cut(length: int) -> None:
    imu = ImuBuffer([sample(0), *(sample(length + 5 * k) for k in range(3))])

    def variance(count: int) -> float:
        ends = np.linspace(0, length, count + 1)
        return float(sum(summed(imu, a, b).covariance[2, 2] for a, b in itertools.pairwise(ends)))

    assert variance(1) > 1e-4
    for count in (2, 5):
        assert variance(count) == pytest.approx(variance(1), rel=1e-6)


def test_before_the_first_sample_it_is_as_after_the_last_one() -> None:
    """The angular velocity of the nearest sample holds for 0.2 s, and the rotation is as uncertain."""
    imu = ImuBuffer([sample(0, 0.5)])
    before, after = summed(imu, -2000, 0), summed(imu, 0, 2000)
    np.testing.assert_allclose(before.rotation, after.rotation, atol=1e-12)
    assert before.rotation[1, 0] == pytest.approx(np.sin(0.1), rel=1e-3)
    assert before.covariance[2, 2] == pytest.approx(after.covariance[2, 2])
    assert after.velocity[2] == pytest.approx(2 * UP[2])  # the force of the nearest sample holds for all of it
    parts = [summed(imu, -2000, -150), summed(imu, -150, 0)]
    np.testing.assert_allclose(parts[0].rotation @ parts[1].rotation, before.rotation, atol=1e-12)


def test_the_buffer_takes_newer_finite_samples_only() -> None:
    imu = ImuBuffer([sample(10), sample(20)])
    assert not imu.append(sample(20))
    assert not imu.append(sample(15))
    assert not imu.append(sample(30, np.nan))
    assert imu.append(sample(30))
    assert imu.times.tolist() == [10 * MS, 20 * MS, 30 * MS]
    assert (imu.first_ns, imu.last_ns) == (10 * MS, 30 * MS)


def test_the_buffer_keeps_a_minute_at_the_most() -> None:
    imu = ImuBuffer(sample(1000 * k) for k in range(100))
    imu.forget_before(0)
    assert (imu.last_ns - imu.first_ns) == 60_000 * MS


@pytest.mark.parametrize("step_ms", [20.0, 5.0, 1.0])
def test_the_mean_rate_is_that_of_30_ms(step_ms: float) -> None:
    """A rate that grows evenly has its mean at the middle, to half a sample, whatever the interval of the samples."""
    imu = ImuBuffer(sample(step_ms * k, 1e-3 * step_ms * k) for k in range(500))
    assert imu.mean_rate(round(300.2 * MS), 15 * MS)[2] == pytest.approx(0.3, abs=0.51e-3 * step_ms)


def test_an_old_state_is_carried_on_with_all_samples() -> None:
    """Cameras and GPS/INS are silent for 3.5 s: the attitude follows the IMU, samples of the first seconds included."""
    f = PointFlight(seed=1, seconds=6.0, count=30)
    events = [e for e in f.events if isinstance(e, ImuSample) or not 2.0 < seconds(e) < 5.5]
    motions = run(events, NOISE.model_copy(update={"points": 12, "clones": 6}))[1]
    first = next(m for m in motions if seconds(m) > 5.0)
    e, covariance = error(first, f.truth(first.t_ns))
    assert np.linalg.norm(e[3:]) < 0.02
    assert np.abs(e[3:] / np.sqrt(np.diag(covariance)[3:])).max() < 4.0


class _Spy:
    """Stands for a filter whose newest prediction is of one time; it notes the samples that the prediction is given."""

    def __init__(self, t_ns: int) -> None:
        self.t_ns, self.since = t_ns, list[int]()

    def cameras(self, stamp_ns: int, before_ns: int | None, imu: ImuBuffer) -> Prediction | None:
        self.since.append(imu.first_ns)
        return None

    def predictor(self) -> _Spy:
        return self

    def feed(self, event: ImuSample | Tracks) -> None:
        """Give no motion."""


def test_the_tracker_keeps_the_samples_since_its_prediction(monkeypatch: pytest.MonkeyPatch) -> None:
    """The newest prediction is of 1 s; exposures at 3, 5, 7 s are predicted from there on."""
    spy = _Spy(1000 * MS)
    monkeypatch.setattr(filter_lane, "MotionFilter", lambda *arguments: spy)
    lane = filter_lane.FilterLane(PointFlight().rig, Settings().stages())
    blank: F64 = np.zeros((480, 640))
    for second in (3, 5, 7):
        rows = tuple(sample(1000 * (second - 2) + 10 * k) for k in range(200))
        image = blank.astype(np.uint8)
        lane.take(filter_lane.FrameBatch(Frame(1000 * second * MS, (image, image)), rows))
    assert len(spy.since) == 3
    assert max(spy.since) <= 1000 * MS
