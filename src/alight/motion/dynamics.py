"""Motion models between measurements: driven by the IMU, or at constant velocity (M8-M10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp
from alight.motion.ekf.state import AT, FilterState
from alight.motion.imu_kernels import inertial_transition_into
from alight.motion.preintegration import GRAVITY, OPEN_RATE_SIGMA, Preintegral, right_jacobian
from alight.settings import FilterSettings

MAX_RATE_AGE = 1.0  # s; after a longer step without IMU, as between photos, the angular velocity is not used
_OPEN_ATTITUDE_SIGMA = 2.0  # rad, attitude noise of such a step
_SHAPE = (AT.motion.stop, AT.motion.stop)


@dataclass(frozen=True, eq=False)
class Step:
    """Pose and velocity before or after a step of the motion model."""

    R: F64  # (3, 3) world_from_body
    position: F64  # (3,) m
    velocity: F64  # (3,) m/s

    @classmethod
    def at(cls, state: FilterState) -> Step:
        """Return a copy of the pose and velocity of a state."""
        return cls(state.R, state.core[AT.pos].copy(), state.core[AT.vel].copy())


def propagate(
    here: Step, rate: F64, m: Preintegral | None, dt: float, noise: FilterSettings, first: Step | None = None
) -> tuple[Step, F64, F64]:
    """Propagate by `dt` s; return pose and velocity, transition (15, 15), and noise covariance without `add_bias_walk`.

    Args:
        here: pose and velocity before the step.
        rate: (3,) angular velocity, rad/s; used only without an IMU.
        m: inertial measurements over `dt`; None: without IMU.
        noise: settings of the noise.
        first: first estimate of `here`, at which Jacobians are taken, so that yaw and position stay unobservable to the
            cameras (Huang et al. 2008); None: `here`.
    """
    return _constant(here, rate, dt, noise) if m is None else _inertial(here, m, first or here)


def _inertial(here: Step, m: Preintegral, first: Step) -> tuple[Step, F64, F64]:
    """Propagate by inertial measurements `m` (M8; Forster et al. 2017); see `propagate` for arguments and result."""
    dt = m.dt
    after = Step(
        here.R @ m.rotation,
        here.position + here.velocity * dt + GRAVITY * (dt**2 / 2.0) + here.R @ m.position,
        here.velocity + GRAVITY * dt + here.R @ m.velocity,
    )
    moved = after.position - first.position - first.velocity * dt - GRAVITY * (dt**2 / 2.0)
    speed_up = after.velocity - first.velocity - GRAVITY * dt
    F, Q = np.empty(_SHAPE), np.empty(_SHAPE)
    inertial_transition_into(first.R, after.R, moved, speed_up, dt, m.bias_jacobian, m.covariance, F, Q)
    return after, F, Q


def _constant(here: Step, rate: F64, dt: float, noise: FilterSettings) -> tuple[Step, F64, F64]:
    """Propagate at constant velocity and angular velocity, with white accelerations as noise (M9); see `propagate`."""
    turn = so3_exp(rate * dt)
    F, Q = np.eye(_SHAPE[0]), np.zeros(_SHAPE)
    F[AT.pos, AT.vel] = np.eye(3) * dt
    _add_white_noise(Q, AT.pos, AT.vel, np.eye(3), noise.acceleration_sigma**2, dt)
    if dt > MAX_RATE_AGE:
        F[AT.gyro, AT.gyro] = 0.0
        Q[AT.att, AT.att], Q[AT.gyro, AT.gyro] = np.eye(3) * _OPEN_ATTITUDE_SIGMA**2, np.eye(3) * OPEN_RATE_SIGMA**2
    else:
        F[AT.att, AT.gyro] = here.R @ turn @ right_jacobian(rate * dt) * dt
        _add_white_noise(Q, AT.att, AT.gyro, here.R, noise.acceleration_sigma**2, dt)
    R = here.R if dt > MAX_RATE_AGE else here.R @ turn
    return Step(R, here.position + here.velocity * dt, here.velocity), F, Q


def _add_white_noise(Q: F64, value: slice, rate: slice, rotation: F64, density: float, dt: float) -> None:
    """Set, in the noise `Q` (15, 15), the covariance of a value and its rate after `dt` s of white noise.

    `value`, `rate`: their rows in `Q`. `rotation`: (3, 3) from the axes of the rate to those of the value.
    `density`: spectral density of the noise on the derivative of the rate.
    """
    eye = np.eye(3)
    Q[value, value], Q[rate, rate] = eye * (density * dt**3 / 3.0), eye * (density * dt)
    Q[value, rate] = rotation * (density * dt**2 / 2.0)
    Q[rate, value] = Q[value, rate].T


def add_bias_walk(Q: F64, dt: float, noise: FilterSettings) -> None:
    """Add the variance of the biases' random walk over `dt` seconds to the noise `Q` (15, 15), in place."""
    walk = np.zeros(len(Q))
    walk[AT.gyro], walk[AT.acc] = noise.gyro_walk**2 * dt, noise.accelerometer_walk**2 * dt
    Q[np.diag_indices(len(Q))] += walk


def nav_decay(dt: float, sigma: F64, noise: FilterSettings) -> tuple[F64, F64]:
    """Return decay (9,) and added variance (9,) of slow GPS/INS errors of 1-sigma `sigma` (9,) over `dt` seconds."""
    tau = np.repeat([noise.nav_position_tau, noise.nav_attitude_tau, noise.nav_velocity_tau], 3)
    a = np.exp(-dt / tau)
    return a, (1.0 - a**2) * sigma**2
