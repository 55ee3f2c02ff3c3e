"""Preintegration of inertial measurements between two instants (docs/method/motion.md, M4-M6).

The result does not depend on the pose or velocity, so filter and smoother share it (Lupton and Sukkarieh 2012;
Forster et al. 2017, on-manifold preintegration).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import skew, so3_exp
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.imu_kernels import cut_segments, preintegrate_segments
from alight.settings import FilterSettings

GRAVITY = np.array([0.0, 0.0, -9.80665])  # m/s^2, world; its local error is absorbed by the accelerometer bias
IMU_ROTATION, IMU_VELOCITY, IMU_POSITION = slice(0, 3), slice(3, 6), slice(6, 9)  # errors of a `Preintegral`
_MAX_SAMPLE_INTERVAL = 0.05  # s; samples further apart are a gap in the stream
_HELD_NS = 200_000_000  # ns for which the last angular velocity is held; no turn of a vehicle lasts longer by itself
OPEN_RATE_SIGMA, _OPEN_RATE_TAU = 0.5, 0.25  # rad/s, s: unmeasured angular velocity, and its correlation time


@dataclass(frozen=True, eq=False)
class Segments:
    """N pieces of time without a sample between, with the mean rates of each."""

    dt: F64  # (N,) s
    rates: F64  # (N, 6) rad/s, m/s^2
    interval: F64  # (N,) s between the samples about it; of one beyond the last sample: from that sample to its end


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


def segments(imu: ImuBuffer, start_ns: int, end_ns: int) -> Segments:
    """Cut [start, end] at the samples; each segment has the mean of its ends, beyond the last sample that one holds.

    Its angular velocity holds for 0.2 s: held for 1.7 s, in gusts, it turned the state by 40 degrees.
    """
    n = len(imu) + 1
    dt, rates = np.empty(n), np.empty((n, 6))
    count = cut_segments(imu.times, imu.rates, start_ns, end_ns, dt, rates) if n > 1 and end_ns > start_ns else 0
    dt, rates = dt[:count], rates[:count]
    interval = dt.copy()
    if count:
        interval[0], interval[-1] = _interval_at(imu, start_ns), _interval_at(imu, end_ns - 1)
    if count and end_ns > imu.last_ns:
        interval[-1] = (end_ns - imu.last_ns) * 1e-9
        beyond_ns = max(start_ns, imu.last_ns)
        rates[-1, :3] *= min(max(imu.last_ns + _HELD_NS - beyond_ns, 0) / (end_ns - beyond_ns), 1.0)
    return Segments(dt, rates, interval)


def _interval_at(imu: ImuBuffer, t_ns: int) -> float:
    """Return the time [s] between the samples before and after an instant; 0 outside all samples."""
    after = int(np.searchsorted(imu.times, t_ns, side="right"))
    return float(imu.times[after] - imu.times[after - 1]) * 1e-9 if 0 < after < len(imu) else 0.0


def preintegrate(parts: Segments, gyro_bias: F64, accelerometer_bias: F64, noise: FilterSettings) -> Preintegral:
    """Integrate segments by the midpoint rule (M4), with bias Jacobian (M5) and covariance (M6)."""
    R, v, p, J, C = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((9, 6)), np.empty((9, 9))
    bias = np.concatenate([gyro_bias, accelerometer_bias])
    dt = preintegrate_segments(parts.dt, parts.rates, bias, _variance(parts, noise), R, v, p, J, C)
    return Preintegral(dt, R, v, p, J, C, bias[:3], bias[3:])


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


def _variance(parts: Segments, noise: FilterSettings) -> F64:
    """(N, 2) variance of the mean rates over each piece: density**2 / dt [(rad/s)^2, (m/s^2)^2].

    In a gap the angular velocity wanders as in the constant-velocity model from the last sample on, until it has its
    largest variance: the rotation since then has that model's variance however the gap is cut (M6b).
    """
    dt, since = parts.dt, parts.interval
    out = np.empty((len(dt), 2))
    gap = since > _MAX_SAMPLE_INTERVAL
    wandered = noise.angular_acceleration_sigma**2 * (since**3 - np.maximum(since - dt, 0.0) ** 3) / (3.0 * dt**2)
    out[:, 0] = noise.gyro_noise**2 / dt + gap * np.minimum(wandered, 2.0 * OPEN_RATE_SIGMA**2 * _OPEN_RATE_TAU / dt)
    out[:, 1] = noise.accelerometer_noise**2 / dt + gap * (noise.acceleration_sigma**2 / dt)
    return out
