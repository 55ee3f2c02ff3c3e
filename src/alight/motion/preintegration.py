"""Preintegration of inertial measurements between two instants (docs/method/motion.md, M4-M6).

The result does not depend on the pose or velocity, so filter and smoother share it (Lupton and Sukkarieh 2012; Forster
et al. 2017, on-manifold preintegration).
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
_MAX_SAMPLE_INTERVAL = 0.05  # s; samples farther apart are a gap in the stream
_HELD_NS = 200_000_000  # ns for which the last angular velocity is held; no turn of a vehicle lasts longer by itself
OPEN_RATE_SIGMA, _OPEN_RATE_TAU = 0.5, 0.25  # rad/s, s: unmeasured angular velocity, and its correlation time


@dataclass(frozen=True, eq=False)
class Segments:
    """N segments of time between samples, with the mean rates of each segment."""

    dt: F64  # (N,) s
    rates: F64  # (N, 6) angular velocity, rad/s, and specific force, m/s^2
    interval: F64  # (N,) s between the samples before and after; if one is missing: from the other to the far end
    since: F64  # (N,) s from the sample before to the segment's end; if missing: from its begin to the first sample


@dataclass(frozen=True, eq=False)
class Preintegral:
    """Motion of the body from one instant to a later one, by the IMU.

    Its errors are ordered (rotation, velocity, position): rotation in the later body frame, the others in the earlier.
    """

    dt: float  # s
    rotation: F64  # (3, 3) earlier_from_later
    velocity: F64  # (3,) m/s in the earlier body frame, without gravity
    position: F64  # (3,) m in the earlier body frame, without gravity
    bias_jacobian: F64  # (9, 6) of the errors with respect to the (gyro, accelerometer) bias
    covariance: F64  # (9, 9)
    bias: F64  # (6,) bias of gyro [rad/s] and accelerometer [m/s^2] at which it was integrated


def right_jacobian(phi: F64) -> F64:
    """Return the right Jacobian (3, 3) of SO(3) at the rotation vector `phi` (3,), rad, to second order."""
    W = skew(phi)
    return np.asarray(np.eye(3) - W / 2.0 + W @ W / 6.0)


def segments(imu: ImuBuffer, start_ns: int, end_ns: int) -> Segments:
    """Cut the time from `start_ns` to `end_ns` at the samples; each segment has the mean of the rates at its ends.

    Outside all samples, the nearest rates hold; the angular velocity only for 0.2 s, because a longer hold in gusts
    turned the state by 40 degrees.
    """
    n = len(imu) + 1
    dt, rates = np.empty(n), np.empty((n, 6))
    count = cut_segments(imu.times, imu.rates, start_ns, end_ns, dt, rates) if n > 1 and end_ns > start_ns else 0
    dt, rates = dt[:count], rates[:count]
    interval, since = dt.copy(), dt.copy()
    if count:
        for k, begin_ns in ((0, start_ns), (-1, end_ns - round(dt[-1] * 1e9))):
            interval[k], since[k] = _samples_about(imu, begin_ns, begin_ns + round(dt[k] * 1e9))
        if end_ns > imu.last_ns:
            begin_ns = max(start_ns, imu.last_ns)
            rates[-1, :3] *= _held(begin_ns - imu.last_ns, end_ns - begin_ns)
        if start_ns < imu.first_ns:
            last_ns = min(end_ns, imu.first_ns)
            rates[0, :3] *= _held(imu.first_ns - last_ns, last_ns - start_ns)
    return Segments(dt, rates, interval, since)


def _held(away_ns: int, length_ns: int) -> float:
    """Return the share of a gap in which the rate of the nearest sample is held.

    `away_ns`: time from that sample to the gap. `length_ns`: duration of the gap.
    """
    return min(max(_HELD_NS - away_ns, 0) / length_ns, 1.0)


def _samples_about(imu: ImuBuffer, begin_ns: int, end_ns: int) -> tuple[float, float]:
    times = imu.times
    after = int(np.searchsorted(times, begin_ns, side="right"))
    if after == 0:
        return (imu.first_ns - begin_ns) * 1e-9, (imu.first_ns - begin_ns) * 1e-9
    since = (end_ns - int(times[after - 1])) * 1e-9
    return (int(times[after]) - int(times[after - 1])) * 1e-9 if after < len(times) else since, since


def preintegrate(imu: ImuBuffer, start_ns: int, end_ns: int, bias: F64, noise: FilterSettings) -> Preintegral:
    """Integrate from `start_ns` to `end_ns` by the midpoint rule (M4), with bias Jacobian (M5) and covariance (M6).

    `bias` (6,) is that of the gyro [rad/s], then of the accelerometer [m/s^2].
    """
    parts, bias = segments(imu, start_ns, end_ns), bias.copy()
    R, v, p, J, C = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((9, 6)), np.empty((9, 9))
    dt = preintegrate_segments(parts.dt, parts.rates, bias, _variance(parts, noise), R, v, p, J, C)
    return Preintegral(dt, R, v, p, J, C, bias)


def corrected(m: Preintegral, bias: F64) -> Preintegral:
    """Return the preintegral for another bias (6,), to first order (M5)."""
    d = m.bias_jacobian @ (bias - m.bias)
    return replace(
        m, rotation=m.rotation @ so3_exp(d[:3]), velocity=m.velocity + d[3:6], position=m.position + d[6:],
        bias=bias.copy(),
    )  # fmt: skip


def _variance(parts: Segments, noise: FilterSettings) -> F64:
    """Return the (N, 2) variance of the mean rates of each segment, (rad/s)^2 and (m/s^2)^2 (M6b)."""
    # in a gap, the angular velocity drifts as in the constant-velocity model, until it has its largest variance
    dt, since = parts.dt, parts.since
    out = np.empty((len(dt), 2))
    gap = parts.interval > _MAX_SAMPLE_INTERVAL
    wandered = noise.acceleration_sigma**2 * (since**3 - np.maximum(since - dt, 0.0) ** 3) / (3.0 * dt**2)
    out[:, 0] = noise.gyro_noise**2 / dt + gap * np.minimum(wandered, 2.0 * OPEN_RATE_SIGMA**2 * _OPEN_RATE_TAU / dt)
    out[:, 1] = noise.accelerometer_noise**2 / dt + gap * (noise.acceleration_sigma**2 / dt)
    return out
