"""Batch smoother of a recorded flight: all poses, points, biases and GPS/INS errors by least squares (M18-M22).

Measurements and noise are those of the filter, but every pose depends on all measurements, later ones included, and
Jacobians are taken at the solution: the poses of one flight come from one consistent estimate.
"""

from __future__ import annotations

import logging
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, so3_exp, so3_log
from alight.motion.dynamics import (
    Step,
    bias_walk,
    constant_step,
    constant_transition,
    inertial_step,
    inertial_transition,
    nav_decay,
)
from alight.motion.ekf.keyframe_posterior import relative_inflation
from alight.motion.ekf.prediction import instant
from alight.motion.ekf.state import (
    ACC,
    ATT,
    GYRO,
    MOTION,
    MOUNT,
    NAV,
    OFFSET,
    POS,
    VEL,
)
from alight.motion.gps_ins import ATTITUDE_ROWS, POSITION_ROWS, VELOCITY_ROWS, sigmas, whites
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import Preintegral, corrected, preintegrate, segments
from alight.motion.projection import POSITION_FIRST, observation_sigma
from alight.motion.robust import cauchy
from alight.motion.smoother.block_tridiagonal import BlockTridiagonal, Factors
from alight.motion.smoother.recorded_flight import LEAST_EXPOSURES, RecordedFlight
from alight.motion.smoother.track_segments import TrackSegments
from alight.records import KeyframePosterior, Motion, NavSample, RefinedMotions
from alight.settings import FilterSettings

log = logging.getLogger(__name__)

_SIZE = NAV.stop  # unknowns an exposure: the core of the filter's state up to the GPS/INS errors
_POSE = POS.stop  # of these: attitude and position
_NAV_SCALE = np.sqrt(27.0)  # sigmas, Cauchy scale of a quantity of GPS/INS
_OPEN_INFORMATION = 1e-8  # of unknowns without a measurement (the accelerometer bias without IMU): they are held
_MIN_VARIANCE = 1e-14  # added to the noise of the motion model, so that it has an inverse
_ITERATIONS = 12
_LONG = 1500  # exposures; longer flights get shorter pieces of tracks, so that memory (0.6 MB each) stays bounded
_SHORTEST = 5  # exposures in a piece
_MOST_JOINT = 240  # exposures whose joint covariance is given out: 17 MB; between them errors are interpolated
_LEAD_NS = 50_000_000  # ns by which an exposure may lie before the first inertial sample for the IMU to drive it
_BIASES = slice(GYRO.start, ACC.stop)
_ENOUGH = np.repeat([5e-5, 1e-3], 3)  # rad, m: steps of all poses below which it has converged


def smooth_flight(recording: RecordedFlight) -> RefinedMotions:
    """Smooth all exposures; an empty result where that is not possible (too few exposures, no solution)."""
    if len(recording.exposures) < LEAST_EXPOSURES:
        return RefinedMotions((), None)
    try:
        return _Batch(recording).run()
    except np.linalg.LinAlgError as e:
        log.warning("batch: the normal equations have no solution (%s)", e)
        return RefinedMotions((), None)


@dataclass(frozen=True, eq=False)
class _NavRow:
    """One GPS/INS row: the exposure before it, the preintegral up to it, its errors."""

    k: int
    dt: float
    preintegral: Preintegral | None  # None: without IMU
    sample: NavSample
    decay: F64  # (9,) of the slow errors from the exposure to the row
    variance: F64  # (9,) of the white errors and of the drift of the slow ones


class _Batch:
    """The unknowns and the factors between them."""

    def __init__(self, r: RecordedFlight) -> None:
        self._settings, self._motions = r.settings, [m for m, _, _ in r.exposures]
        self._t = [instant(m.t_ns, r.exposures[-1][2]) for m in self._motions]
        self._R = np.array([m.world_from_body.rotation for m in self._motions])
        self._x = np.array([core[:_SIZE] for _, _, core in r.exposures])  # (K, 24); ATT is zero
        self._x[:, POS] += r.exposures[-1][2][OFFSET]
        self._mount = so3_exp(r.exposures[-1][2][MOUNT])
        self._cams = tuple(c.body_from_cam for c in r.rig.cameras)
        self._span = max(_SHORTEST, min(r.settings.track_span, r.settings.track_span * _LONG // len(self._t)))
        tracks = [t for _, t, _ in r.exposures]
        sigma = np.concatenate([observation_sigma(t, r.rig.cameras[0].camera, r.settings) for t in tracks])
        self._segments = TrackSegments(tracks, sigma, self._cams, self._span)
        self._nav_sigma = _nav_sigmas(r.nav, self._t, r.settings)
        imu = ImuBuffer(r.imu)
        self._inertial = bisect_left(self._t, imu.first_ns - _LEAD_NS) if len(imu) else len(self._t)
        if len(imu):  # the filter had no bias before the first sample
            self._x[self._inertial : bisect_left(self._t, imu.first_ns), _BIASES] = 0.0
        self._imu_motion = self._preintegrals(imu)
        self._nav_rows = [row for s in r.nav if (row := self._nav_row(s, imu)) is not None]

    def _preintegrals(self, imu: ImuBuffer) -> list[Preintegral | None]:
        return [self._preintegrated(imu, k, b) for k, b in enumerate(self._t[1:])]

    def _preintegrated(self, imu: ImuBuffer, k: int, end_ns: int) -> Preintegral | None:
        """Return the IMU sum from exposure k to a later time; None before there is an IMU."""
        if k < self._inertial:
            return None
        return preintegrate(segments(imu, self._t[k], end_ns), self._x[k, GYRO], self._x[k, ACC], self._settings)

    def _nav_row(self, sample: NavSample, imu: ImuBuffer) -> _NavRow | None:
        """Return a row with the exposure before it; None: before the first one, or an interval after the last one."""
        k = bisect_right(self._t, sample.t_ns) - 1
        if k < 0 or sample.t_ns - self._t[-1] > np.median(np.diff(self._t)):
            return None
        dt, sigma = (sample.t_ns - self._t[k]) * 1e-9, sigmas(sample, self._settings)
        decay, drift = nav_decay(dt, sigma, self._settings)
        variance = whites(sigma, self._settings) ** 2 + drift
        return _NavRow(k, dt, self._preintegrated(imu, k, sample.t_ns), sample, decay, variance)

    def run(self) -> RefinedMotions:
        """Gauss-Newton on all unknowns; the weights of observations follow the residuals."""
        self._segments.triangulate(*self._rigs())
        for i in range(_ITERATIONS):
            rms = self._segments.reweigh(*self._rigs())
            factors = self._iterate()
            step = self._step(factors)
            log.debug("batch %d: observations %.3f sigma, step %.2g", i, rms, np.abs(step[:, :_POSE]).max())
            if (np.abs(step[:, :_POSE]) < _ENOUGH).all():
                break
        covariance, span = factors.covariance(), self._span
        motions = tuple(self._motion(k, _own(covariance, k, span)) for k in range(len(self._t)))
        return RefinedMotions(motions, self._joint(motions, factors, covariance))

    def _joint(self, motions: tuple[Motion, ...], factors: Factors, own: F64) -> KeyframePosterior:
        """Joint posterior of the exposures, or of `_MOST_JOINT` of them, evenly spaced (M22b).

        As in the keyframe posterior (M23), tracking errors are correlated: the covariance of the poses relative to the
        middle one is inflated by the median residual and by `smoother_repeat`; the middle one keeps its own.
        """
        K = len(motions)
        some = np.unique(np.linspace(0, K - 1, min(K, _MOST_JOINT)).round().astype(int))
        rows = (some[:, None] * _SIZE + np.arange(_POSE)).ravel()
        order = (_POSE * np.arange(len(some))[:, None] + POSITION_FIRST).ravel()
        factor = max(1.0, self._settings.smoother_repeat * self._segments.median_misfit(*self._rigs()))
        inflation = relative_inflation(self._x[some, POS], factor, len(some) // 2)
        covariance = inflation @ factors.joint(rows, own) @ inflation.T
        return KeyframePosterior(tuple(motions[k] for k in some), covariance[np.ix_(order, order)])

    def _rigs(self) -> tuple[F64, F64]:
        return self._R @ self._mount, self._x[:, POS]

    def _iterate(self) -> Factors:
        """Factorise the normal equations at the present values."""
        span, K = self._span, len(self._t)
        blocks = -(-K // span)
        system = BlockTridiagonal(blocks, span * _SIZE)
        self._linear = self._segments.linearise(*self._rigs())
        for b in range(blocks):
            last = b == blocks - 1  # unknowns of the last block beyond the flight are held at zero
            H, g = self._linear.reduced(b * span, (b + 1) * span, span)
            rows = (np.arange(b * span, (b + 2) * span)[:, None] * _SIZE + np.arange(_POSE)).ravel()
            keep = slice(0, _POSE * span if last else None)
            system.add(rows[keep], H[keep, keep], g[keep])
        self._add_priors(system, blocks * span)
        self._add_motion(system)
        for row in self._nav_rows:
            self._add_nav(system, row)
        return system.factorise()

    def _step(self, factors: Factors) -> F64:
        """Take the (K, 24) step, points included."""
        step = factors.solution().reshape(-1, _SIZE)[: len(self._t)]
        self._linear.move_points(step[:, :_POSE])
        self._R = so3_exp(step[:, ATT]) @ self._R
        self._x[:, ATT.stop :] += step[:, ATT.stop :]
        return step

    def _add_priors(self, system: BlockTridiagonal, padded: int) -> None:
        s, information = self._settings, np.zeros(_SIZE)
        information[NAV] = 1.0 / self._nav_sigma[0] ** 2
        if not self._inertial:
            information[GYRO], information[ACC] = 1 / s.gyro_bias_sigma**2, 1 / s.accelerometer_bias_sigma**2
        system.add(np.arange(_SIZE), np.diag(information), -information * self._x[0])
        for k in range(len(self._t), padded):
            system.add(np.arange(_SIZE) + k * _SIZE, np.eye(_SIZE), np.zeros(_SIZE))
        weak = np.eye(_SIZE) * _OPEN_INFORMATION
        for k in range(len(self._t)):
            system.add(np.arange(_SIZE) + k * _SIZE, weak, np.zeros(_SIZE))

    def _propagated(self, k: int, dt: float, m: Preintegral | None) -> tuple[Step, F64, F64]:
        """Propagate exposure k by `dt`: the step, its transition and noise (15, 15)."""
        R, x, s = self._R[k], self._x[k], self._settings
        if m is None:
            F, Q = constant_transition(R, x[GYRO], dt, s)
            Q[ACC, ACC] = np.eye(3)  # unused: any positive number keeps the equations regular
            return constant_step(R, x[POS], x[VEL], x[GYRO], dt), F, Q
        m = corrected(m, x[GYRO], x[ACC])
        after = inertial_step(R, x[POS], x[VEL], m)
        F, Q = inertial_transition(Step(R, x[POS], x[VEL]), after, m)
        Q[np.diag_indices(MOTION.stop)] += bias_walk(dt, s)
        return after, F, Q

    def _add_motion(self, system: BlockTridiagonal) -> None:
        """Factors between successive exposures: the motion model (M8, M9) and the GPS/INS errors (M10)."""
        for k, m in enumerate(self._imu_motion):
            dt = (self._t[k + 1] - self._t[k]) * 1e-9
            after, F, Q = self._propagated(k, dt, m)
            if k + 1 == self._inertial:
                self._begin_biases(F, Q)
            a, b = self._x[k], self._x[k + 1]
            decay, drift = self._nav_drift(k, dt)
            e = np.empty(_SIZE)
            e[ATT], e[NAV] = so3_log(self._R[k + 1] @ after.R.T), b[NAV] - decay * a[NAV]
            e[POS], e[VEL] = b[POS] - after.position, b[VEL] - after.velocity
            e[_BIASES] = b[_BIASES] - F[_BIASES, _BIASES] @ a[_BIASES]
            J = np.zeros((_SIZE, 2 * _SIZE))
            J[:, _SIZE:] = np.eye(_SIZE)
            J[MOTION, MOTION], J[NAV, NAV] = -F, -np.diag(decay)
            W = np.zeros((_SIZE, _SIZE))
            W[MOTION, MOTION] = np.linalg.inv(Q + _MIN_VARIANCE * np.eye(len(Q)))
            W[NAV, NAV] = np.diag(1.0 / drift)
            rows = np.arange(2 * _SIZE) + k * _SIZE
            system.add(rows, J.T @ W @ J, -J.T @ W @ e)

    def _begin_biases(self, F: F64, Q: F64) -> None:
        """Give the biases at the first exposure with an IMU their prior: until there, GYRO is the angular velocity."""
        F[_BIASES], Q[_BIASES], Q[:, _BIASES] = 0.0, 0.0, 0.0
        sigma = np.repeat([self._settings.gyro_bias_sigma, self._settings.accelerometer_bias_sigma], 3)
        Q[_BIASES, _BIASES] = np.diag(sigma**2)

    def _nav_drift(self, k: int, dt: float) -> tuple[F64, F64]:
        """Return the (9,) decay and added variance of the GPS/INS errors from exposure k to the next (M10).

        Their variance is what the rows claim at both. Where they claim less, the error becomes smaller with them.
        """
        before, after = self._nav_sigma[k], self._nav_sigma[k + 1]
        decay = nav_decay(dt, before, self._settings)[0] * np.minimum(after / before, 1.0)
        return decay, after**2 - (decay * before) ** 2

    def _add_nav(self, system: BlockTridiagonal, row: _NavRow) -> None:
        """A GPS/INS row at the exposure before it (M14-M16), each of its quantities with a Cauchy weight.

        Its noise is its own white part, and the motion model's and the drift of its slow error from there to it.
        """
        after, F, Q = self._propagated(row.k, row.dt, row.preintegral)
        z, nav = row.sample, row.decay * self._x[row.k, NAV]
        parts: list[tuple[slice, slice, F64]] = []
        if z.position_world is not None:
            parts.append((POS, POSITION_ROWS, z.position_world - after.position - nav[POSITION_ROWS]))
        if z.world_from_body is not None:
            e = so3_log(z.world_from_body @ (so3_exp(nav[ATTITUDE_ROWS]) @ after.R).T)
            parts.append((ATT, ATTITUDE_ROWS, e))
        if z.velocity_world is not None:
            parts.append((VEL, VELOCITY_ROWS, z.velocity_world - after.velocity - nav[VELOCITY_ROWS]))
        for value, of, e in parts:
            J = np.zeros((3, _SIZE))
            J[:, MOTION] = F[value]
            J[:, NAV][:, of] = np.diag(row.decay[of])
            self._add_row(system, row.k, J, e, row.variance[of] + np.diag(Q[value, value]))
        if row.preintegral is None and z.angular_velocity_body is not None:
            J = np.zeros((3, _SIZE))
            J[:, GYRO] = np.eye(3)
            variance = self._settings.nav_rate_white**2 + np.diag(Q[GYRO, GYRO])
            self._add_row(system, row.k, J, z.angular_velocity_body - self._x[row.k, GYRO], variance)

    @staticmethod
    def _add_row(system: BlockTridiagonal, k: int, J: F64, e: F64, variance: F64) -> None:
        """A quantity of GPS/INS at exposure k with its residual e (3,), J (3, 24) and variance (3,)."""
        W = cauchy((e**2 / variance).sum(keepdims=True), _NAV_SCALE)[0] / variance
        system.add(np.arange(_SIZE) + k * _SIZE, (J.T * W) @ J, J.T @ (W * e))

    def _motion(self, k: int, covariance: F64) -> Motion:
        old, order = self._motions[k], np.r_[POS, ATT]
        body = Pose(self._R[k], self._x[k, POS])
        rig = Pose(self._R[k] @ self._mount, self._x[k, POS])
        return replace(
            old,
            world_from_body=body,
            world_from_cams=tuple(rig @ c for c in self._cams),
            covariance=covariance[np.ix_(order, order)],
            offset_world=None,
            velocity_world=self._x[k, VEL].copy(),
        )


def _nav_sigmas(nav: Sequence[NavSample], times: Sequence[int], settings: FilterSettings) -> F64:
    """Return the (K, 9) sigma of GPS/INS at each time: of the last row with that quantity, before any of the first."""
    if not nav:
        return np.ones((len(times), 9))
    out = np.tile(sigmas(nav[0], settings), (len(times), 1))
    for name, part in (
        ("position_world", POSITION_ROWS),
        ("world_from_body", ATTITUDE_ROWS),
        ("velocity_world", VELOCITY_ROWS),
    ):
        if some := [s for s in nav if getattr(s, name) is not None]:
            last = np.searchsorted([s.t_ns for s in some], times, side="right") - 1
            out[:, part] = np.array([sigmas(s, settings)[part] for s in some])[np.maximum(last, 0)]
    return out


def _own(covariance: F64, k: int, span: int) -> F64:
    i = slice((k % span) * _SIZE, (k % span + 1) * _SIZE)
    return np.asarray(covariance[k // span, i, i])
