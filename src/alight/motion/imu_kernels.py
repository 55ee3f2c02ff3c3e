"""Kernels for the preintegration of inertial measurements, and for the transition of the state by it (M4-M8)."""

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel
from alight.motion.rotation_kernels import exponential, multiply


@kernel
def _rates_at(times: I64, rates: F64, t_ns: int, out: F64) -> None:
    """Interpolate the rates (M, 6) linearly at `t_ns`; before and after all samples, the nearest one is used."""
    i = int(np.searchsorted(times, t_ns, side="right"))
    a, b = max(i - 1, 0), min(i, len(times) - 1)
    f = 0.0
    if times[b] > times[a] and t_ns >= times[a]:
        f = (t_ns - times[a]) / (times[b] - times[a])
    for j in range(6):
        out[j] = (1.0 - f) * rates[a, j] + f * rates[b, j]


@kernel
def cut_segments(times: I64, rates: F64, start_ns: int, end_ns: int, dt: F64, mean: F64) -> int:
    """Cut [start, end] at the samples; write length (s) and mean rates per segment; return the number of segments."""
    first = int(np.searchsorted(times, start_ns, side="right"))
    last = int(np.searchsorted(times, end_ns, side="right"))
    here, there = np.empty(6), np.empty(6)
    _rates_at(times, rates, start_ns, here)
    count, begin = 0, start_ns
    for i in range(first, last + 1):
        end = times[i] if i < last else end_ns
        if end > begin:
            _rates_at(times, rates, end, there)
            dt[count] = (end - begin) * 1e-9
            for j in range(6):
                mean[count, j] = 0.5 * (here[j] + there[j])
            count += 1
            begin = end
            here[:] = there
    return count


@kernel
def _carry_rows(A_rr: F64, A_vr: F64, t: float, X: F64, out: F64) -> None:
    """Write A X for X (9, n), with the transition A of (rotation, velocity, position) over `t` s (`A_rr`, `A_vr`)."""
    for i in range(3):
        for j in range(X.shape[1]):
            r = A_rr[i, 0] * X[0, j] + A_rr[i, 1] * X[1, j] + A_rr[i, 2] * X[2, j]
            v = A_vr[i, 0] * X[0, j] + A_vr[i, 1] * X[1, j] + A_vr[i, 2] * X[2, j]
            out[i, j], out[3 + i, j] = r, v + X[3 + i, j]
            out[6 + i, j] = 0.5 * t * v + t * X[3 + i, j] + X[6 + i, j]


@kernel
def _turned_force(middle: F64, a: F64, t: float, out: F64) -> None:
    """Write -middle [a]x t, the derivative of a segment's velocity change with respect to its attitude; `a`: force."""
    for i in range(3):
        x, y, z = middle[i, 0], middle[i, 1], middle[i, 2]
        out[i, 0], out[i, 1] = -t * (y * a[2] - z * a[1]), -t * (z * a[0] - x * a[2])
        out[i, 2] = -t * (x * a[1] - y * a[0])


@kernel
def _by_rates(force: F64, middle: F64, w: F64, t: float, B: F64) -> None:
    """Write the (9, 6) derivative of the errors after a segment with respect to its angular rate and specific force.

    `force` is from `_turned_force`, `middle` the attitude at its middle, `w` its angular rate, `t` its length, s.
    """
    B[:] = 0.0
    x, y, z = w[0] * t, w[1] * t, w[2] * t
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    for i in range(3):
        for j in range(3):
            square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            B[i, j] = t * ((1.0 if i == j else 0.0) - W[i, j] / 2.0 + square / 6.0)
            B[3 + i, j], B[6 + i, j] = 0.5 * t * force[i, j], 0.25 * t * t * force[i, j]
            B[3 + i, 3 + j], B[6 + i, 3 + j] = t * middle[i, j], 0.5 * t * t * middle[i, j]


@kernel
def preintegrate_segments(
    dt: F64, mean: F64, bias: F64, variance: F64, R: F64, v: F64, p: F64, J: F64, C: F64
) -> float:
    """Integrate N segments by the midpoint rule (M4), with bias Jacobian (M5) and covariance (M6); return the time, s.

    Args:
        dt: (N,) length of each segment, s.
        mean: (N, 6) mean angular velocity, rad/s, and specific force, m/s^2.
        bias: (6,) bias of the gyro and of the accelerometer.
        variance: (N, 2) variance of the mean angular rate and of the mean specific force.
        R, v, p: (3, 3), (3,), (3,) out: rotation, velocity and position in the earlier frame.
        J: (9, 6) out, bias Jacobian. C: (9, 9) out, covariance.
    """
    half, middle, turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    A_rr, A_vr, force = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    B, w, a = np.empty((9, 6)), np.empty(3), np.empty(3)
    next_J, rows, total = np.empty((9, 6)), np.empty((9, 9)), 0.0
    R[:], v[:], p[:], J[:], C[:] = np.eye(3), 0.0, 0.0, 0.0, 0.0
    for n in range(len(dt)):
        t = dt[n]
        for i in range(3):
            w[i], a[i] = mean[n, i] - bias[i], mean[n, 3 + i] - bias[3 + i]
        exponential(0.5 * t * w[0], 0.5 * t * w[1], 0.5 * t * w[2], half)
        multiply(R, half, middle)
        multiply(middle, half, R)
        multiply(half, half, turn)
        for i in range(3):
            dv = t * (middle[i, 0] * a[0] + middle[i, 1] * a[1] + middle[i, 2] * a[2])
            p[i] += t * (v[i] + 0.5 * dv)
            v[i] += dv
        _turned_force(middle, a, t, force)
        A_rr[:] = turn.T
        multiply(force, half.T, A_vr)
        _by_rates(force, middle, w, t, B)
        _carry_rows(A_rr, A_vr, t, J, next_J)
        for i in range(9):
            for j in range(6):
                J[i, j] = next_J[i, j] - B[i, j]
        _carry_rows(A_rr, A_vr, t, C, rows)
        _carry_rows(A_rr, A_vr, t, rows.T.copy(), C)
        for i in range(9):
            for j in range(9):
                for k in range(6):
                    C[i, j] += B[i, k] * B[j, k] * variance[n, k // 3]
        for i in range(6, 9):  # white acceleration also moves about its mean over the segment
            C[i, i] += variance[n, 1] * t * t * t * t / 12.0
        total += t
    return total


@kernel
def _minus_skew(x: float, y: float, z: float, out: F64) -> None:
    out[0, 1], out[0, 2], out[1, 0], out[1, 2], out[2, 0], out[2, 1] = z, -y, -z, x, y, -x


@kernel
def inertial_transition_into(
    R0: F64, R1: F64, moved: F64, speed_up: F64, dt: float, J: F64, C: F64, F: F64, Q: F64
) -> None:
    """Write the transition and the noise of (attitude, position, velocity, gyro, accelerometer bias) over a step.

    Args:
        R0, R1: (3, 3) attitude before and after the step.
        moved, speed_up: (3,) change of position and velocity, without initial velocity and gravity.
        dt: length of the step, s.
        J, C: (9, 6), (9, 9) bias Jacobian and covariance of the preintegral.
        F, Q: (15, 15) out, transition and noise covariance.
    """
    F[:], Q[:] = np.eye(15), 0.0
    _minus_skew(moved[0], moved[1], moved[2], F[3:6, 0:3])
    _minus_skew(speed_up[0], speed_up[1], speed_up[2], F[6:9, 0:3])
    G = np.zeros((9, 9))  # (attitude, position, velocity) by the preintegral's (rotation, velocity, position)
    for i in range(3):
        F[3 + i, 6 + i] = dt
        for j in range(3):
            G[i, j], G[3 + i, 6 + j], G[6 + i, 3 + j] = R1[i, j], R0[i, j], R0[i, j]
    F[:9, 9:15] += np.dot(G, J)
    Q[:9, :9] = np.dot(np.dot(G, C), G.T)
