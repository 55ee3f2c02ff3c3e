"""Preintegration of inertial measurements between two instants (docs/method/motion.md, M4-M6).

The result does not depend on the pose or velocity, so filter and smoother share it (Lupton and Sukkarieh 2012;
Forster et al. 2017, on-manifold preintegration).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import skew, so3_exp
from alight.records import ImuSample
from alight.settings import FilterSettings

GRAVITY = np.array([0.0, 0.0, -9.80665])  # m/s^2, world; its local error is taken up by the accelerometer bias
IMU_ROTATION, IMU_VELOCITY, IMU_POSITION = slice(0, 3), slice(3, 6), slice(6, 9)  # errors of a `Preintegral`
_MAX_SAMPLE_INTERVAL = 0.05  # s; samples further apart are a gap in the stream
Segment = tuple[float, F64, F64]  # s, rad/s, m/s^2


@dataclass(frozen=True, eq=False)
class Preintegral:
    """Motion from one instant to a later one by the IMU.

    Errors: `IMU_ROTATION` in the later body frame, `IMU_VELOCITY` and `IMU_POSITION` in the earlier one.
    """

    dt: float  # s
    rotation: F64  # (3, 3) earlier_from_later
    velocity: F64  # (3,) m/s in the earlier body frame, without gravity
    position: F64  # (3,) m in the earlier body frame, without gravity
    bias_jacobian: F64  # (9, 6) of the errors by (gyro, accelerometer) bias
    covariance: F64  # (9, 9)
    gyro_bias: F64  # (3,) rad/s, at which it was integrated
    accelerometer_bias: F64  # (3,) m/s^2


def right_jacobian(phi: F64) -> F64:
    """Return the right Jacobian of SO(3) to second order, enough for the small angles between samples."""
    W = skew(phi)
    return np.asarray(np.eye(3) - W / 2.0 + W @ W / 6.0)


def segments(samples: Sequence[ImuSample], start_ns: int, end_ns: int) -> list[Segment]:
    """Cut [start, end] at the samples; each segment has the mean of its ends, beyond the last sample that one holds."""
    if not samples or end_ns <= start_ns:
        return []
    times = [s.t_ns for s in samples]
    first, last = bisect_right(times, start_ns), bisect_right(times, end_ns)
    cuts = [start_ns, *times[first:last], end_ns]
    rates = [_interpolated(samples, times, t) for t in cuts]
    return [
        ((b - a) * 1e-9, (u[0] + v[0]) / 2.0, (u[1] + v[1]) / 2.0)
        for a, b, u, v in zip(cuts, cuts[1:], rates, rates[1:], strict=False)
        if b > a
    ]


def _interpolated(samples: Sequence[ImuSample], times: list[int], t_ns: int) -> tuple[F64, F64]:
    i = bisect_right(times, t_ns)
    a, b = samples[max(i - 1, 0)], samples[min(i, len(samples) - 1)]
    f = (t_ns - a.t_ns) / (b.t_ns - a.t_ns) if b.t_ns > a.t_ns and t_ns >= a.t_ns else 0.0
    return (
        (1 - f) * a.angular_velocity_body + f * b.angular_velocity_body,
        (1 - f) * a.specific_force_body + f * b.specific_force_body,
    )


def preintegrate(
    parts: Sequence[Segment], gyro_bias: F64, accelerometer_bias: F64, noise: FilterSettings
) -> Preintegral:
    """Integrate segments by the midpoint rule (M4), with bias Jacobian (M5) and covariance (M6)."""
    R, v, p, J, C = np.eye(3), np.zeros(3), np.zeros(3), np.zeros((9, 6)), np.zeros((9, 9))
    if not parts:
        return Preintegral(0.0, R, v, p, J, C, gyro_bias.copy(), accelerometer_bias.copy())
    dt = np.array([s[0] for s in parts])
    w = np.array([s[1] for s in parts]) - gyro_bias
    a = np.array([s[2] for s in parts]) - accelerometer_bias
    half = so3_exp(w * (dt[:, None] / 2.0))
    middle = np.empty_like(half)  # attitude at the middle of each segment
    for i, h in enumerate(half):
        middle[i] = R @ h
        R = middle[i] @ h
    dv = np.einsum("nij,nj->ni", middle, a) * dt[:, None]
    A, B = _error_transitions(dt, w, a, half, middle)
    Q = (B * _variance(dt, noise)[:, None, :]) @ B.transpose(0, 2, 1)
    for i in range(len(dt)):
        J = A[i] @ J - B[i]
        C = A[i] @ C @ A[i].T + Q[i]
    v = dv.sum(axis=0)
    p = ((np.cumsum(dv, axis=0) - 0.5 * dv) * dt[:, None]).sum(axis=0)
    return Preintegral(float(dt.sum()), R, v, p, J, C, gyro_bias.copy(), accelerometer_bias.copy())


def _error_transitions(dt: F64, w: F64, a: F64, half: F64, middle: F64) -> tuple[F64, F64]:
    """Derivatives of the errors after each of N segments: (N, 9, 9) by those before it, (N, 9, 6) by rate and force.

    Args:
        dt: (N,) s.
        w, a: (N, 3) angular velocity and specific force, biases removed.
        half: (N, 3, 3) rotation over half a segment.
        middle: (N, 3, 3) attitude at the middle of each segment.
    """
    n, t, eye = len(dt), dt[:, None, None], np.eye(3)
    A, B = np.zeros((n, 9, 9)), np.zeros((n, 9, 6))
    A[:] = np.eye(9)
    A[:, IMU_ROTATION, IMU_ROTATION] = (half @ half).transpose(0, 2, 1)
    force_by_rotation = -(middle @ skew(a)) * t  # at the midpoint
    A[:, IMU_VELOCITY, IMU_ROTATION] = force_by_rotation @ half.transpose(0, 2, 1)
    A[:, IMU_POSITION, IMU_ROTATION] = A[:, IMU_VELOCITY, IMU_ROTATION] * (t / 2.0)
    A[:, IMU_POSITION, IMU_VELOCITY] = eye * t
    W = skew(w * dt[:, None])
    rate, force = slice(0, 3), slice(3, 6)
    B[:, IMU_ROTATION, rate] = (eye - W / 2.0 + W @ W / 6.0) * t
    B[:, IMU_VELOCITY, rate] = force_by_rotation * (t / 2.0)
    B[:, IMU_POSITION, rate] = force_by_rotation * (t * t / 4.0)
    B[:, IMU_VELOCITY, force] = middle * t
    B[:, IMU_POSITION, force] = middle * (t * t / 2.0)
    return A, B


def corrected(m: Preintegral, gyro_bias: F64, accelerometer_bias: F64) -> Preintegral:
    """Return the preintegral at other biases, to first order (M5)."""
    d = m.bias_jacobian @ np.concatenate([gyro_bias - m.gyro_bias, accelerometer_bias - m.accelerometer_bias])
    return replace(
        m,
        rotation=m.rotation @ so3_exp(d[IMU_ROTATION]),
        velocity=m.velocity + d[IMU_VELOCITY],
        position=m.position + d[IMU_POSITION],
        gyro_bias=gyro_bias.copy(),
        accelerometer_bias=accelerometer_bias.copy(),
    )


def _variance(dt: F64, noise: FilterSettings) -> F64:
    """(N, 6) variance of the mean rates over each piece: density**2 / dt [(rad/s)^2, (m/s^2)^2]."""
    gyro, accelerometer = noise.gyro_noise**2 / dt, noise.accelerometer_noise**2 / dt
    gap = dt > _MAX_SAMPLE_INTERVAL  # not measured: as uncertain as the constant-velocity model
    gyro = gyro + np.where(gap, noise.angular_acceleration_sigma**2 * dt, 0.0)
    accelerometer = accelerometer + np.where(gap, noise.acceleration_sigma**2 / dt, 0.0)
    return np.repeat(np.stack([gyro, accelerometer], axis=1), 3, axis=1)
