"""Navigation solution and IMU: exact motion plus errors, each source of noise with a random stream of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alight.geometry import so3_exp
from alight.records import F64, ImuSample, NavSample
from alight.simulate.vehicle import Trajectory


@dataclass(frozen=True)
class NavErrors:
    """GPS/INS: drift (first-order Gauss-Markov) plus white noise; the sigmas that it claims are true."""

    rate_hz: float = 20.0
    position: tuple[float, float, float] = (1.0, 1.0, 1.5)  # metres, east north up, 1-sigma of the drift
    position_tau: float = 60.0  # s
    position_white: float = 0.02  # metres
    attitude: tuple[float, float, float] = (math.radians(0.5), math.radians(0.5), math.radians(1.5))  # roll pitch yaw
    attitude_tau: float = 120.0  # s
    attitude_white: float = math.radians(0.05)
    velocity_white: float = 0.05  # m/s
    rate_white: float = 0.01  # rad/s


@dataclass(frozen=True)
class ImuErrors:
    """MEMS: white noise by density, and biases that walk."""

    rate_hz: float = 200.0
    gyroscope_noise_density: float = 4e-4  # rad/s/sqrt(Hz)
    gyroscope_random_walk: float = 2e-5  # rad/s^2/sqrt(Hz)
    accelerometer_noise_density: float = 2.5e-3  # m/s^2/sqrt(Hz)
    accelerometer_random_walk: float = 2e-4  # m/s^3/sqrt(Hz)
    gyroscope_bias: float = 3e-3  # rad/s, 1-sigma at the start
    accelerometer_bias: float = 0.05  # m/s^2


def gauss_markov(rng: np.random.Generator, t: F64, sigma: F64, tau: float) -> F64:
    """(N, len(sigma)) stationary first-order Gauss-Markov noise at times `t` in seconds."""
    white = rng.standard_normal((len(t), len(sigma)))
    keep = np.exp(-np.diff(t) / tau)
    out = np.empty_like(white)
    out[0] = white[0]
    for i, k in enumerate(keep, 1):
        out[i] = k * out[i - 1] + math.sqrt(1.0 - k * k) * white[i]
    return out * sigma


def nav_samples(
    flight: Trajectory, t_ns: NDArray[np.int64], seconds: F64, errors: NavErrors, seeds: np.random.SeedSequence
) -> Iterator[NavSample]:
    """Yield the navigation solution at times of the clock (`t_ns`) and of the trajectory (`seconds`)."""
    drift, white, turn, turn_white, speed, rate = (np.random.default_rng(s) for s in seeds.spawn(6))
    n = len(seconds)
    position = gauss_markov(drift, seconds, np.array(errors.position), errors.position_tau)
    position += errors.position_white * white.standard_normal((n, 3))
    attitude = gauss_markov(turn, seconds, np.array(errors.attitude), errors.attitude_tau)
    attitude += errors.attitude_white * turn_white.standard_normal((n, 3))
    velocity = errors.velocity_white * speed.standard_normal((n, 3))
    rates = errors.rate_white * rate.standard_normal((n, 3))
    sigma_position = np.hypot(errors.position, errors.position_white)
    sigma_attitude = np.hypot(errors.attitude, errors.attitude_white)
    sigma_velocity = np.full(3, max(errors.velocity_white, 1e-3))
    for i, s in enumerate(seconds):
        pose = flight.pose(float(s))
        yield NavSample(
            int(t_ns[i]),
            pose.translation + position[i],
            pose.rotation @ so3_exp(attitude[i]),
            flight.velocity_world(float(s)) + velocity[i],
            flight.angular_velocity_body(float(s)) + rates[i],
            np.maximum(sigma_position, 1e-3),
            np.maximum(sigma_attitude, 1e-4),
            sigma_velocity,
        )


def imu_biases(n: int, errors: ImuErrors, seeds: np.random.SeedSequence) -> tuple[F64, F64]:
    """(N, 3) gyroscope and (N, 3) accelerometer biases."""
    step = 1.0 / math.sqrt(errors.rate_hz)
    out = []
    for seed, start, walk in zip(
        seeds.spawn(2),
        (errors.gyroscope_bias, errors.accelerometer_bias),
        (errors.gyroscope_random_walk, errors.accelerometer_random_walk),
        strict=True,
    ):
        rng = np.random.default_rng(seed)
        out.append(start * rng.standard_normal(3) + np.cumsum(walk * step * rng.standard_normal((n, 3)), axis=0))
    return out[0], out[1]


def imu_samples(
    flight: Trajectory,
    t_ns: NDArray[np.int64],
    seconds: F64,
    biases: tuple[F64, F64],
    errors: ImuErrors,
    seeds: np.random.SeedSequence,
) -> Iterator[ImuSample]:
    """Yield turn rate and specific force in the body, with bias and noise."""
    gyro, accel = (np.random.default_rng(s) for s in seeds.spawn(2))
    root = math.sqrt(errors.rate_hz)
    for i, s in enumerate(seconds):
        yield ImuSample(
            int(t_ns[i]),
            flight.angular_velocity_body(float(s))
            + biases[0][i]
            + errors.gyroscope_noise_density * root * gyro.standard_normal(3),
            flight.specific_force_body(float(s))
            + biases[1][i]
            + errors.accelerometer_noise_density * root * accel.standard_normal(3),
        )
