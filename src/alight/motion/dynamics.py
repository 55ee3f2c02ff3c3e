"""How the core of the state moves between measurements: driven by the IMU, or at constant velocity (M8-M10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.geometry import skew, so3_exp
from alight.motion.ekf.state import ACC, ATT, CORE, GYRO, POS, VEL, FilterState
from alight.motion.preintegration import GRAVITY, Preintegral, right_jacobian
from alight.records import F64
from alight.settings import FilterSettings

LONG = 1.0  # s without IMU after which an angular velocity says nothing more: photos
ANY, RATE = 2.0, 0.5  # rad, rad/s: attitude and angular velocity are then open


@dataclass(frozen=True, eq=False)
class Step:
    """The core after a step, without its covariance."""

    R: F64  # (3, 3) world_from_body
    position: F64  # (3,) m
    velocity: F64  # (3,) m/s


def inertial_step(R: F64, p: F64, v: F64, m: Preintegral) -> Step:
    """Carry a pose and velocity on by what the IMU summed (M8)."""
    return Step(
        R @ m.rotation,
        p + v * m.dt + GRAVITY * (m.dt**2 / 2.0) + R @ m.position,
        v + GRAVITY * m.dt + R @ m.velocity,
    )


def constant_step(R: F64, p: F64, v: F64, rate: F64, dt: float) -> Step:
    """Carry a pose on at constant velocity and angular velocity (M9, the paper's model)."""
    return Step(R if dt > LONG else R @ so3_exp(rate * dt), p + v * dt, v)


def inertial_transition(first: Step, after: Step, m: Preintegral) -> tuple[F64, F64]:
    """Return the (15, 15) transition and noise of (ATT, POS, VEL, GYRO, ACC) for `inertial_step`.

    `first` is the state as predicted, before it was corrected: with first-estimate Jacobians the transitions of
    successive steps multiply to the one of a single step, and yaw and position stay unobservable to the cameras.
    """
    dt, R0 = m.dt, first.R
    F = np.eye(15)
    F[POS, VEL] = np.eye(3) * dt
    F[VEL, ATT] = -skew(after.velocity - first.velocity - GRAVITY * dt)
    F[POS, ATT] = -skew(after.position - first.position - first.velocity * dt - GRAVITY * (dt**2 / 2.0))
    G = np.zeros((15, 9))
    G[ATT, 0:3], G[VEL, 3:6], G[POS, 6:9] = after.R, R0, R0
    F[:, 9:15] += G @ m.bias_jacobian
    return F, G @ m.covariance @ G.T


def constant_transition(R: F64, rate: F64, dt: float, noise: FilterSettings) -> tuple[F64, F64]:
    """Return the (15, 15) transition and noise of `constant_step`; white accelerations drive it."""
    F = np.eye(15)
    F[POS, VEL] = np.eye(3) * dt
    F[ATT, GYRO] = R @ so3_exp(rate * dt) @ right_jacobian(rate * dt) * dt
    Q = np.zeros((15, 15))
    _white(Q, POS, VEL, np.eye(3), noise.acceleration_sigma**2, dt)
    if dt > LONG:
        F[ATT, GYRO], F[GYRO, GYRO] = 0.0, 0.0
        Q[ATT, ATT], Q[GYRO, GYRO] = np.eye(3) * ANY**2, np.eye(3) * RATE**2
        return F, Q
    _white(Q, ATT, GYRO, R, noise.angular_acceleration_sigma**2, dt)
    return F, Q


def _white(Q: F64, value: slice, rate: slice, turn: F64, density: float, dt: float) -> None:
    eye = np.eye(3)
    Q[value, value], Q[rate, rate] = eye * (density * dt**3 / 3.0), eye * (density * dt)
    Q[value, rate] = turn * (density * dt**2 / 2.0)
    Q[rate, value] = Q[value, rate].T


def propagate_covariance(state: FilterState, F: F64, Q: F64, decay: F64, drift: F64) -> None:
    """Carry the covariance on: `F`, `Q` (15, 15) for the motion, `decay`, `drift` (9,) for the GPS/INS errors (M10)."""
    full = np.eye(CORE)
    full[:15, :15] = F
    full[15:24, 15:24] = np.diag(decay)
    state.P[:CORE, :] = full @ state.P[:CORE, :]
    state.P[:, :CORE] = state.P[:, :CORE] @ full.T
    state.P[:15, :15] += Q
    state.P[range(15, 24), range(15, 24)] += drift


def nav_decay(dt: float, sigma: F64, noise: FilterSettings) -> tuple[F64, F64]:
    """Return (9,) decay and (9,) variance added to the Gauss-Markov errors of GPS/INS over `dt` (M10)."""
    tau = np.repeat([noise.nav_position_tau, noise.nav_attitude_tau, noise.nav_velocity_tau], 3)
    a = np.exp(-dt / tau)
    return a, (1.0 - a**2) * sigma**2


def bias_walk(dt: float, noise: FilterSettings) -> F64:
    """Return the (15,) variance that the biases gain over `dt`."""
    out = np.zeros(15)
    out[GYRO], out[ACC] = noise.gyro_walk**2 * dt, noise.accelerometer_walk**2 * dt
    return out
