"""Batch smoother of a recorded flight: all poses, points, biases and GPS/INS errors by least squares (M18-M22).

Measurements and noise are those of the filter, but every pose depends on all measurements, later ones included, and
Jacobians are taken at the solution: the poses of one flight come from one consistent estimate.
"""

from __future__ import annotations

import logging
from bisect import bisect_right
from dataclasses import dataclass, field, replace

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
    NAV_ATT,
    NAV_POS,
    NAV_VEL,
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
from alight.motion.smoother.track_segments import TrackSegments
from alight.records import ImuSample, KeyframePosterior, Motion, NavSample, RefinedMotions, Rig, Tracks
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
_ENOUGH = np.repeat([5e-5, 1e-3], 3)  # rad, m: steps of all poses below which it has converged


@dataclass(eq=False)
class RecordedFlight:
    """Input of the filter during a flight, and its motions."""

    rig: Rig
    settings: FilterSettings
    imu: list[ImuSample] = field(default_factory=list)
    nav: list[NavSample] = field(default_factory=list)
    exposures: list[tuple[Motion, Tracks, F64]] = field(default_factory=list)  # motion, tracks, core of the state


def smooth_flight(recording: RecordedFlight) -> RefinedMotions:
    """Smooth all exposures; an empty result where that is not possible (fewer than three exposures, no solution)."""
    if len(recording.exposures) < 3:
        return RefinedMotions((), None)
    try:
        return _Batch(recording).run()
    except np.linalg.LinAlgError:
        return RefinedMotions((), None)


@dataclass(frozen=True, eq=False)
class _NavRow:
    """One GPS/INS row: the exposure before it, the preintegral up to it, its noise."""

    k: int
    dt: float
    preintegral: Preintegral | None
    sample: NavSample
    white: F64  # (9,)


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
        self._nav_sigma = sigmas(r.nav[-1], r.settings) if r.nav else np.ones(9)
        imu = ImuBuffer(r.imu)
        self._imu_motion = self._preintegrals(imu)
        self._nav_rows = [row for s in r.nav if (row := self._nav_row(s, imu)) is not None]

    def _preintegrals(self, imu: ImuBuffer) -> list[Preintegral | None]:
        if not len(imu):
            return [None] * (len(self._t) - 1)
        return [self._preintegrated(imu, k, b) for k, b in enumerate(self._t[1:])]

    def _preintegrated(self, imu: ImuBuffer, k: int, end_ns: int) -> Preintegral:
        return preintegrate(segments(imu, self._t[k], end_ns), self._x[k, GYRO], self._x[k, ACC], self._settings)

    def _nav_row(self, sample: NavSample, imu: ImuBuffer) -> _NavRow | None:
        k = bisect_right(self._t, sample.t_ns) - 1
        if k < 0:
            return None
        white = whites(sigmas(sample, self._settings), self._settings)
        dt = (sample.t_ns - self._t[k]) * 1e-9
        return _NavRow(k, dt, self._preintegrated(imu, k, sample.t_ns) if len(imu) else None, sample, white)

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
        misfit = self._segments.median_misfit(*self._rigs())  # infinite without observations: nothing to inflate
        factor = max(1.0, self._settings.smoother_repeat * misfit) if np.isfinite(misfit) else 1.0
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
        information[NAV] = 1.0 / self._nav_sigma**2
        if self._imu_motion[0] is not None:
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
            a, b = self._x[k], self._x[k + 1]
            decay, drift = nav_decay(dt, self._nav_sigma, self._settings)
            e = b - a
            e[ATT], e[NAV] = so3_log(self._R[k + 1] @ after.R.T), b[NAV] - decay * a[NAV]
            e[POS], e[VEL] = b[POS] - after.position, b[VEL] - after.velocity
            J = np.zeros((_SIZE, 2 * _SIZE))
            J[:, _SIZE:] = np.eye(_SIZE)
            J[MOTION, MOTION], J[NAV, NAV] = -F, -np.diag(decay)
            W = np.zeros((_SIZE, _SIZE))
            W[MOTION, MOTION] = np.linalg.inv(Q + _MIN_VARIANCE * np.eye(len(Q)))
            W[NAV, NAV] = np.diag(1.0 / drift)
            rows = np.arange(2 * _SIZE) + k * _SIZE
            system.add(rows, J.T @ W @ J, -J.T @ W @ e)

    def _add_nav(self, system: BlockTridiagonal, row: _NavRow) -> None:
        """A GPS/INS row at the exposure before it (M14-M16), each of its quantities with a Cauchy weight."""
        after, F, _ = self._propagated(row.k, row.dt, row.preintegral)
        x, z = self._x[row.k], row.sample
        parts: list[tuple[slice, slice, F64, F64]] = []
        if z.position_world is not None:
            parts.append((POS, NAV_POS, z.position_world - after.position - x[NAV_POS], row.white[POSITION_ROWS]))
        if z.world_from_body is not None:
            e = so3_log(z.world_from_body @ (so3_exp(x[NAV_ATT]) @ after.R).T)
            parts.append((ATT, NAV_ATT, e, row.white[ATTITUDE_ROWS]))
        if z.velocity_world is not None:
            parts.append((VEL, NAV_VEL, z.velocity_world - after.velocity - x[NAV_VEL], row.white[VELOCITY_ROWS]))
        if row.preintegral is None and z.angular_velocity_body is not None:
            rate = z.angular_velocity_body - x[GYRO]
            parts.append((GYRO, GYRO, rate, np.full(3, self._settings.nav_rate_white)))
        rows = np.arange(_SIZE) + row.k * _SIZE
        for value, drift, e, white in parts:
            J = np.zeros((3, _SIZE))
            J[:, MOTION] = F[value]
            J[:, drift] = np.eye(3)
            W = cauchy(((e / white) ** 2).sum(keepdims=True), _NAV_SCALE)[0] / white**2
            system.add(rows, (J.T * W) @ J, J.T @ (W * e))

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


def _own(covariance: F64, k: int, span: int) -> F64:
    i = slice((k % span) * _SIZE, (k % span + 1) * _SIZE)
    return np.asarray(covariance[k // span, i, i])
