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
from alight.motion.dynamics import Step, add_bias_walk, nav_decay, propagate
from alight.motion.ekf.filter import RecordedFlight
from alight.motion.ekf.keyframe_posterior import relative_inflation
from alight.motion.ekf.prediction import instant
from alight.motion.ekf.state import AT, POSITION_FIRST
from alight.motion.gps_ins import SLOW, Quantity, sigmas, whites
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.observations import observation_sigma
from alight.motion.points import MIN_POSES
from alight.motion.preintegration import Preintegral, corrected, preintegrate
from alight.motion.robust import cauchy
from alight.motion.smoother.block_tridiagonal import BlockTridiagonal
from alight.motion.smoother.track_segments import LinearisedSegments, TrackSegments
from alight.records import KeyframePosterior, Motion, NavSample, RefinedMotions
from alight.settings import FilterSettings

log = logging.getLogger(__name__)

_SIZE = AT.nav.stop  # unknowns per exposure: the core of the filter's state up to the GPS/INS errors
_POSE = AT.pos.stop  # unknowns of these that are attitude and position
_NAV_SCALE = np.sqrt(27.0)  # sigmas, Cauchy scale of a quantity of GPS/INS
_ITERATIONS = 12
_LONG = 1500  # exposures; tracks of longer flights are cut shorter, so that memory (0.6 MB per exposure) stays bounded
_SHORTEST = 5  # exposures in a piece
_MOST_JOINT = 240  # exposures whose joint covariance is returned: 17 MB; between them errors are interpolated
_LEAD_NS = 50_000_000  # ns by which an exposure may lie before the first inertial sample for the IMU to drive it
_ENOUGH = np.repeat([5e-5, 1e-3], 3)  # rad, m: the solution has converged if all steps of poses are smaller


def smooth_flight(recording: RecordedFlight) -> RefinedMotions:
    """Smooth all exposures; the result is empty if there are too few exposures or no solution."""
    if len(recording.exposures) < MIN_POSES:
        return RefinedMotions((), None)
    try:
        return _Batch(recording).run()
    except np.linalg.LinAlgError as e:
        log.warning("batch: the normal equations have no solution (%s)", e)
        return RefinedMotions((), None)


@dataclass(frozen=True, eq=False)
class _NavRow:
    """One row of GPS/INS, with the exposure before it, the preintegral up to it, and its errors."""

    k: int  # index of the exposure before the row
    dt: float  # s from that exposure to the row
    preintegral: Preintegral | None  # None: without IMU
    sample: NavSample
    decay: F64  # (9,) decay of the slow errors from the exposure to the row
    variance: F64  # (9,) variance of the white errors and of the drift of the slow ones


class _Batch:
    def __init__(self, r: RecordedFlight) -> None:
        self._settings, self._motions = r.settings, [m for m, _, _ in r.exposures]
        self._t = [instant(m.t_ns, r.exposures[-1][2]) for m in self._motions]
        self._R = np.array([m.world_from_body.rotation for m in self._motions])
        self._x = np.array([core[:_SIZE] for _, _, core in r.exposures])  # (K, 24); AT.att is zero
        self._x[:, AT.pos] += r.exposures[-1][2][AT.offset]
        self._mount = so3_exp(r.exposures[-1][2][AT.mount])
        self._cams = tuple(c.body_from_cam for c in r.rig.cameras)
        self._span = max(_SHORTEST, min(r.settings.track_span, r.settings.track_span * _LONG // len(self._t)))
        tracks = [t for _, t, _ in r.exposures]
        sigma = np.concatenate([observation_sigma(t, r.rig.cameras[0].camera, r.settings) for t in tracks])
        self._segments = TrackSegments(tracks, sigma, self._cams, self._span)
        self._nav_sigma = _nav_sigmas(r.nav, self._t, r.settings)
        imu = ImuBuffer(r.imu)
        self._inertial = bisect_left(self._t, imu.first_ns - _LEAD_NS) if len(imu) else len(self._t)
        if len(imu):  # the filter had no bias before the first sample
            self._x[self._inertial : bisect_left(self._t, imu.first_ns), AT.biases] = 0.0
        self._imu_motion = [self._preintegrated(imu, k, b) for k, b in enumerate(self._t[1:])]
        self._nav_rows = [row for s in r.nav if (row := self._nav_row(s, imu)) is not None]

    def _preintegrated(self, imu: ImuBuffer, k: int, end_ns: int) -> Preintegral | None:
        """Return the preintegral from exposure `k` to the time `end_ns`; None before there is an IMU."""
        if k < self._inertial:
            return None
        return preintegrate(imu, self._t[k], end_ns, self._x[k, AT.biases], self._settings)

    def _nav_row(self, sample: NavSample, imu: ImuBuffer) -> _NavRow | None:
        """Return a GPS/INS row with the exposure before it; None before the first exposure or long after the last."""
        k = bisect_right(self._t, sample.t_ns) - 1
        if k < 0 or sample.t_ns - self._t[-1] > np.median(np.diff(self._t)):
            return None
        dt, sigma = (sample.t_ns - self._t[k]) * 1e-9, sigmas(sample, self._settings)
        decay, drift = nav_decay(dt, sigma, self._settings)
        variance = whites(sigma, self._settings) ** 2 + drift
        return _NavRow(k, dt, self._preintegrated(imu, k, sample.t_ns), sample, decay, variance)

    def run(self) -> RefinedMotions:
        """Solve for all unknowns by iteratively reweighted Gauss-Newton; return the refined motions."""
        self._segments.triangulate(*self._rigs())
        for i in range(_ITERATIONS):
            rms = self._segments.reweigh(*self._rigs())
            linear = self._segments.linearise(*self._rigs())
            system = self._factorised(linear)
            step = self._step(system, linear)
            log.debug("batch %d: observations %.3f sigma, step %.2g", i, rms, np.abs(step[:, :_POSE]).max())
            if (np.abs(step[:, :_POSE]) < _ENOUGH).all():
                break
        covariance, order = system.covariance(), POSITION_FIRST[:, None]
        of = ((k, _SIZE * (k % self._span)) for k in range(len(self._t)))
        motions = tuple(self._motion(k, covariance[k // self._span][at + order, at + POSITION_FIRST]) for k, at in of)
        return RefinedMotions(motions, self._joint(motions, system, covariance))

    def _joint(self, motions: tuple[Motion, ...], system: BlockTridiagonal, own: F64) -> KeyframePosterior:
        """Return the joint posterior of the exposures, or of `_MOST_JOINT` evenly spaced ones (M22b).

        Because tracking errors are correlated, the covariance relative to the middle pose is inflated by the median
        residual and by `smoother_repeat`. `own` is the result of `system.covariance`.
        """
        K = len(motions)
        some = np.unique(np.linspace(0, K - 1, min(K, _MOST_JOINT)).round().astype(int))
        rows = (some[:, None] * _SIZE + np.arange(_POSE)).ravel()
        order = (_POSE * np.arange(len(some))[:, None] + POSITION_FIRST).ravel()
        factor = max(1.0, self._settings.smoother_repeat * self._segments.median_misfit(*self._rigs()))
        inflation = relative_inflation(self._x[some, AT.pos], factor, len(some) // 2)
        covariance = inflation @ system.joint(rows, own) @ inflation.T
        return KeyframePosterior(tuple(motions[k] for k in some), covariance[np.ix_(order, order)])

    def _rigs(self) -> tuple[F64, F64]:
        return self._R @ self._mount, self._x[:, AT.pos]

    def _factorised(self, linear: LinearisedSegments) -> BlockTridiagonal:
        span, K = self._span, len(self._t)
        blocks = -(-K // span)
        system = BlockTridiagonal(blocks, span * _SIZE)
        for b in range(blocks):
            last = b == blocks - 1  # unknowns of the last block beyond the flight are held at zero
            H, g = linear.reduced(b * span, (b + 1) * span, span)
            rows = (np.arange(b * span, (b + 2) * span)[:, None] * _SIZE + np.arange(_POSE)).ravel()
            keep = slice(0, _POSE * span if last else None)
            system.add(rows[keep], H[keep, keep], g[keep])
        self._add_priors(system, blocks * span)
        self._add_motion(system)
        for row in self._nav_rows:
            self._add_nav(system, row)
        system.factorise()
        return system

    def _step(self, system: BlockTridiagonal, linear: LinearisedSegments) -> F64:
        """Return the step of the unknowns, (K, 24), after it was applied to them and to the points of `linear`."""
        step = system.solution().reshape(-1, _SIZE)[: len(self._t)]
        linear.move_points(step[:, :_POSE])
        self._R = so3_exp(step[:, AT.att]) @ self._R
        self._x[:, AT.att.stop :] += step[:, AT.att.stop :]
        return step

    def _add_priors(self, system: BlockTridiagonal, padded: int) -> None:
        s, information = self._settings, np.zeros(_SIZE)
        information[AT.nav] = 1.0 / self._nav_sigma[0] ** 2
        if not self._inertial:
            information[AT.gyro], information[AT.acc] = 1 / s.gyro_bias_sigma**2, 1 / s.accelerometer_bias_sigma**2
        system.add(np.arange(_SIZE), np.diag(information), -information * self._x[0])
        for k in range(len(self._t), padded):
            system.add(np.arange(_SIZE) + k * _SIZE, np.eye(_SIZE), np.zeros(_SIZE))
        weak = np.eye(_SIZE) * 1e-8  # fixes unknowns without a measurement, such as the accelerometer bias without IMU
        for k in range(len(self._t)):
            system.add(np.arange(_SIZE) + k * _SIZE, weak, np.zeros(_SIZE))

    def _propagated(self, k: int, dt: float, m: Preintegral | None) -> tuple[Step, F64, F64]:
        x, s = self._x[k], self._settings
        m = None if m is None else corrected(m, x[AT.biases])
        after, F, Q = propagate(Step(self._R[k], x[AT.pos], x[AT.vel]), x[AT.gyro], m, dt, s)
        if m is None:
            Q[AT.acc, AT.acc] = np.eye(3)  # unused: any positive number keeps the equations regular
        else:
            add_bias_walk(Q, dt, s)
        return after, F, Q

    def _add_motion(self, system: BlockTridiagonal) -> None:
        """Add the factors between successive exposures: the motion model (M8, M9) and the GPS/INS errors (M10)."""
        for k, m in enumerate(self._imu_motion):
            dt = (self._t[k + 1] - self._t[k]) * 1e-9
            after, F, Q = self._propagated(k, dt, m)
            if k + 1 == self._inertial:  # until here, one bias is the angular velocity: now both have their prior
                s = self._settings
                F[AT.biases], Q[AT.biases], Q[:, AT.biases] = 0.0, 0.0, 0.0
                sigma = np.repeat([s.gyro_bias_sigma, s.accelerometer_bias_sigma], 3)
                Q[AT.biases, AT.biases] = np.diag(sigma**2)
            a, b = self._x[k], self._x[k + 1]
            decay, drift = self._nav_drift(k, dt)
            e = np.empty(_SIZE)
            e[AT.att], e[AT.nav] = so3_log(self._R[k + 1] @ after.R.T), b[AT.nav] - decay * a[AT.nav]
            e[AT.pos], e[AT.vel] = b[AT.pos] - after.position, b[AT.vel] - after.velocity
            e[AT.biases] = b[AT.biases] - F[AT.biases, AT.biases] @ a[AT.biases]
            J = np.zeros((_SIZE, 2 * _SIZE))
            J[:, _SIZE:] = np.eye(_SIZE)
            J[AT.motion, AT.motion], J[AT.nav, AT.nav] = -F, -np.diag(decay)
            W = np.zeros((_SIZE, _SIZE))
            W[AT.motion, AT.motion] = np.linalg.inv(Q + 1e-14 * np.eye(len(Q)))  # now the sum has an inverse
            W[AT.nav, AT.nav] = np.diag(1.0 / drift)
            rows = np.arange(2 * _SIZE) + k * _SIZE
            system.add(rows, J.T @ W @ J, -J.T @ W @ e)

    def _nav_drift(self, k: int, dt: float) -> tuple[F64, F64]:
        """Return the (9,) decay and added variance of GPS/INS errors from exposure `k` to the next, `dt` s later."""
        # where later rows claim a smaller variance, the errors become smaller
        before, after = self._nav_sigma[k], self._nav_sigma[k + 1]
        decay = nav_decay(dt, before, self._settings)[0] * np.minimum(after / before, 1.0)
        return decay, after**2 - (decay * before) ** 2

    def _add_nav(self, system: BlockTridiagonal, row: _NavRow) -> None:
        """Add a GPS/INS row at the exposure before it (M14-M16), each of its quantities with a Cauchy weight."""
        after, F, Q = self._propagated(row.k, row.dt, row.preintegral)
        z, nav = row.sample, row.decay * self._x[row.k, AT.nav]
        parts = list[tuple[Quantity, F64]]()
        if z.position_world is not None:
            parts.append((Quantity.POSITION, z.position_world - after.position - nav[Quantity.POSITION.rows]))
        if z.world_from_body is not None:
            expected = so3_exp(nav[Quantity.ATTITUDE.rows]) @ after.R
            parts.append((Quantity.ATTITUDE, so3_log(z.world_from_body @ expected.T)))
        if z.velocity_world is not None:
            parts.append((Quantity.VELOCITY, z.velocity_world - after.velocity - nav[Quantity.VELOCITY.rows]))
        for quantity, e in parts:
            J, value, of = np.zeros((3, _SIZE)), quantity.state, quantity.rows
            J[:, AT.motion] = F[value]
            J[:, AT.nav][:, of] = np.diag(row.decay[of])
            self._add_row(system, row.k, J, e, row.variance[of] + np.diag(Q[value, value]))
        if row.preintegral is None and z.angular_velocity_body is not None:
            J = np.zeros((3, _SIZE))
            J[:, AT.gyro] = np.eye(3)
            variance = self._settings.gyro_bias_sigma**2 + np.diag(Q[AT.gyro, AT.gyro])
            self._add_row(system, row.k, J, z.angular_velocity_body - self._x[row.k, AT.gyro], variance)

    @staticmethod
    def _add_row(system: BlockTridiagonal, k: int, J: F64, e: F64, variance: F64) -> None:
        """Add a quantity of GPS/INS at exposure `k`: Jacobian `J` (3, 24), residual `e` (3,) and its variance (3,)."""
        W = cauchy((e**2 / variance).sum(keepdims=True), _NAV_SCALE)[0] / variance
        system.add(np.arange(_SIZE) + k * _SIZE, (J.T * W) @ J, J.T @ (W * e))

    def _motion(self, k: int, covariance: F64) -> Motion:
        body = Pose(self._R[k], self._x[k, AT.pos])
        rig = Pose(self._R[k] @ self._mount, self._x[k, AT.pos])
        return replace(
            self._motions[k],
            world_from_body=body,
            world_from_cams=tuple(rig @ c for c in self._cams),
            covariance=covariance,
            offset_world=None,
            velocity_world=self._x[k, AT.vel].copy(),
        )


def _nav_sigmas(nav: Sequence[NavSample], times: Sequence[int], settings: FilterSettings) -> F64:
    """Return the (K, 9) 1-sigma of GPS/INS at `times` (K,), ns, from the last row with a quantity, else the first."""
    if not nav:
        return np.ones((len(times), 9))
    out = np.tile(sigmas(nav[0], settings), (len(times), 1))
    for quantity in SLOW:
        if some := [s for s in nav if quantity.of(s) is not None]:
            last = np.searchsorted([s.t_ns for s in some], times, side="right") - 1
            rows = quantity.rows
            out[:, rows] = np.array([sigmas(s, settings)[rows] for s in some])[np.maximum(last, 0)]
    return out
