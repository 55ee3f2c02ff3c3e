"""Motion models between measurements: driven by the IMU, or at constant velocity (M8-M10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp
from alight.motion.ekf.state import ACC, ATT, GYRO, MOTION, POS, VEL, FilterState
from alight.motion.ekf.state_kernels import propagate_errors
from alight.motion.imu_kernels import inertial_transition_into
from alight.motion.preintegration import GRAVITY, OPEN_RATE_SIGMA, Preintegral, right_jacobian
from alight.settings import FilterSettings

MAX_RATE_AGE = 1.0  # s; after a longer gap without IMU, as between photos, the angular velocity is not used
_OPEN_ATTITUDE_SIGMA = 2.0  # rad, after such a gap
_MOTION_SIZE = MOTION.stop - MOTION.start


@dataclass(frozen=True, eq=False)
class Step:
    """Pose and velocity after a step of the motion model."""

    R: F64  # (3, 3) world_from_body
    position: F64  # (3,) m
    velocity: F64  # (3,) m/s

    @classmethod
    def at(cls, state: FilterState) -> Step:
        """Return pose and velocity of a state, copied."""
        return cls(state.R, state.core[POS].copy(), state.core[VEL].copy())


def inertial_step(R: F64, p: F64, v: F64, m: Preintegral) -> Step:
    """Propagate pose and velocity by preintegrated inertial measurements (M8; Forster et al. 2017)."""
    return Step(
        R @ m.rotation,
        p + v * m.dt + GRAVITY * (m.dt**2 / 2.0) + R @ m.position,
        v + GRAVITY * m.dt + R @ m.velocity,
    )


def constant_step(R: F64, p: F64, v: F64, rate: F64, dt: float) -> Step:
    """Propagate a pose at constant velocity and angular velocity (M9, the model of the paper)."""
    return Step(R if dt > MAX_RATE_AGE else R @ so3_exp(rate * dt), p + v * dt, v)


def inertial_transition(first: Step, after: Step, m: Preintegral) -> tuple[F64, F64]:
    """Return the (15, 15) transition and noise of (ATT, POS, VEL, GYRO, ACC) for `inertial_step`.

    `first` is the state as predicted, before it was corrected. With these first-estimates Jacobians (Huang et al. 2008)
    the transitions of successive steps multiply to that of one long step, and yaw and position stay unobservable to the
    cameras.
    """
    dt = m.dt
    moved = after.position - first.position - first.velocity * dt - GRAVITY * (dt**2 / 2.0)
    speed_up = after.velocity - first.velocity - GRAVITY * dt
    F, Q = np.empty((_MOTION_SIZE, _MOTION_SIZE)), np.empty((_MOTION_SIZE, _MOTION_SIZE))
    inertial_transition_into(first.R, after.R, moved, speed_up, dt, m.bias_jacobian, m.covariance, F, Q)
    return F, Q


def constant_transition(R: F64, rate: F64, dt: float, noise: FilterSettings) -> tuple[F64, F64]:
    """Return the (15, 15) transition and noise of `constant_step`, driven by white accelerations."""
    F = np.eye(_MOTION_SIZE)
    F[POS, VEL] = np.eye(3) * dt
    F[ATT, GYRO] = R @ so3_exp(rate * dt) @ right_jacobian(rate * dt) * dt
    Q = np.zeros((_MOTION_SIZE, _MOTION_SIZE))
    _add_white_noise(Q, POS, VEL, np.eye(3), noise.acceleration_sigma**2, dt)
    if dt > MAX_RATE_AGE:
        F[ATT, GYRO], F[GYRO, GYRO] = 0.0, 0.0
        Q[ATT, ATT], Q[GYRO, GYRO] = np.eye(3) * _OPEN_ATTITUDE_SIGMA**2, np.eye(3) * OPEN_RATE_SIGMA**2
        return F, Q
    _add_white_noise(Q, ATT, GYRO, R, noise.angular_acceleration_sigma**2, dt)
    return F, Q


def _add_white_noise(Q: F64, value: slice, rate: slice, rotation: F64, density: float, dt: float) -> None:
    """Set the noise of a value and its rate over `dt` for white noise of a density on the derivative of the rate."""
    eye = np.eye(3)
    Q[value, value], Q[rate, rate] = eye * (density * dt**3 / 3.0), eye * (density * dt)
    Q[value, rate] = rotation * (density * dt**2 / 2.0)
    Q[rate, value] = Q[value, rate].T


def propagate_covariance(state: FilterState, F: F64, Q: F64, decay: F64, drift: F64) -> None:
    """Propagate the covariance in place (M10).

    Args:
        state: with the covariance `P`.
        F, Q: (15, 15) transition and noise of the motion.
        decay, drift: (9,) transition and noise variance of the GPS/INS errors.
    """
    propagate_errors(state.P, F, Q, decay, drift)


def nav_decay(dt: float, sigma: F64, noise: FilterSettings) -> tuple[F64, F64]:
    """Return the (9,) decay and (9,) added variance of the first-order Gauss-Markov errors of GPS/INS over `dt`."""
    tau = np.repeat([noise.nav_position_tau, noise.nav_attitude_tau, noise.nav_velocity_tau], 3)
    a = np.exp(-dt / tau)
    return a, (1.0 - a**2) * sigma**2


def bias_walk(dt: float, noise: FilterSettings) -> F64:
    """Return the (15,) variance of the random walk of the biases over `dt`."""
    out = np.zeros(_MOTION_SIZE)
    out[GYRO], out[ACC] = noise.gyro_walk**2 * dt, noise.accelerometer_walk**2 * dt
    return out
