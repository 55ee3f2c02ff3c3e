"""Navigation solution and IMU: exact motion plus errors, each source of noise with a random stream of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from alight.geometry import so3_exp
from alight.records import F64, ImuSample, NavSample
from alight_sim.faults import Span
from alight_sim.section import Section
from alight_sim.vehicle import SimulatedPath

Times = NDArray[np.int64]
Triple = tuple[float, float, float]


class Jump(Section):
    """The position is off by a step for a while: a wrong satellite, a changed solution."""

    at: float = Field(description="s after the first exposure")
    seconds: float | None = Field(None, gt=0, description="s that it lasts; to the end without it")
    offset: Triple = Field(description="metres east, north, up")


class Outage(Span):
    """GPS/INS is gone for a while."""

    what: Literal["position", "rows"] = Field(
        "position", description="only the position is empty, or whole rows are missing"
    )


class NavErrors(Section):
    """GPS/INS: drift (first-order Gauss-Markov) plus white noise, whose sigmas it claims, and what it does not know."""

    rate_hz: float = Field(20.0, gt=0, le=1000, description="rows a second")
    position: Triple = Field((1.0, 1.0, 1.5), description="metres east, north, up: standard deviation of the drift")
    position_tau: float = Field(60.0, gt=0, description="s, its correlation time")
    position_white: float = Field(0.02, ge=0, description="metres")
    attitude_deg: Triple = Field((0.5, 0.5, 1.5), description="degrees roll, pitch, yaw: drift")
    attitude_tau: float = Field(120.0, gt=0, description="s, its correlation time")
    attitude_white_deg: float = Field(0.05, ge=0, description="degrees")
    velocity: float = Field(0.0, ge=0, description="m/s: drift")
    velocity_tau: float = Field(30.0, gt=0, description="s, its correlation time")
    velocity_white: float = Field(0.05, ge=0, description="m/s")
    rate_white_deg: float = Field(0.573, ge=0, description="degrees a second")
    yaw_start_deg: float = Field(0.0, description="degrees clockwise that the heading is wrong at the start, unclaimed")
    yaw_tau: float | None = Field(None, gt=0, description="s in which that error fades to a third; never without it")
    latency: float = Field(0.0, ge=0, le=0.9, description="s: a row tells what was true so long before its stamp")
    jumps: tuple[Jump, ...] = Field((), description="steps of the position, unclaimed")
    outages: tuple[Outage, ...] = Field((), description="times without position or rows")


class ImuErrors(Section):
    """MEMS: white noise by density, biases that walk, scale and misalignment."""

    rate_hz: float = Field(200.0, gt=0, le=10000, description="samples a second")
    gyroscope_noise_density: float = Field(4e-4, ge=0, description="rad/s/sqrt(Hz)")
    gyroscope_random_walk: float = Field(2e-5, ge=0, description="rad/s^2/sqrt(Hz)")
    accelerometer_noise_density: float = Field(2.5e-3, ge=0, description="m/s^2/sqrt(Hz)")
    accelerometer_random_walk: float = Field(2e-4, ge=0, description="m/s^3/sqrt(Hz)")
    gyroscope_bias: float = Field(3e-3, ge=0, description="rad/s, standard deviation at the start")
    accelerometer_bias: float = Field(0.05, ge=0, description="m/s^2, standard deviation at the start")
    gyroscope_scale: float = Field(0.0, ge=0, le=0.2, description="standard deviation of the scale of each axis")
    accelerometer_scale: float = Field(0.0, ge=0, le=0.2, description="standard deviation of the scale of each axis")
    misalignment_deg: float = Field(0.0, ge=0, le=10, description="degrees, standard deviation between the axes")

    @property
    def densities(self) -> dict[str, float]:
        """What a maker states, by the keys of imu0/sensor.yaml."""
        names = [f"{s}_{n}" for s in ("gyroscope", "accelerometer") for n in ("noise_density", "random_walk")]
        return {k: float(getattr(self, k)) for k in names}


class Sensors(Section):
    """What measures besides the cameras."""

    nav: NavErrors = Field(NavErrors(), description="GPS/INS")
    imu: ImuErrors = Field(ImuErrors(), description="IMU")


def gauss_markov(rng: np.random.Generator, t: F64, sigma: F64, tau: float) -> F64:
    """(N, len(sigma)) stationary first-order Gauss-Markov noise at times `t` in seconds."""
    white = rng.standard_normal((len(t), len(sigma)))
    keep = np.exp(-np.diff(t) / tau)
    out = np.empty_like(white)
    out[0] = white[0]
    for i, k in enumerate(keep, 1):
        out[i] = k * out[i - 1] + math.sqrt(1.0 - k * k) * white[i]
    return out * sigma


def _jumped(errors: NavErrors, seconds: F64) -> F64:
    out = np.zeros((len(seconds), 3))
    for jump in errors.jumps:
        end = math.inf if jump.seconds is None else jump.at + jump.seconds
        out[(seconds >= jump.at) & (seconds < end)] += jump.offset
    return out


def _turned(errors: NavErrors, seconds: F64) -> F64:
    """(N, 3, 3) by which the heading is wrong, in the world."""
    fade = 1.0 if errors.yaw_tau is None else np.exp(-np.maximum(seconds, 0.0) / errors.yaw_tau)
    angles = -math.radians(errors.yaw_start_deg) * fade * np.ones(len(seconds))
    return np.stack([so3_exp([0.0, 0.0, a]) for a in angles])


def _claimed(*parts: Triple | float, least: float) -> F64:
    return np.asarray(np.maximum(np.sqrt(sum(np.square(np.broadcast_to(p, 3)) for p in parts)), least))


def simulated_nav(
    flight: SimulatedPath, t_ns: Times, seconds: F64, errors: NavErrors, seeds: np.random.SeedSequence
) -> Iterator[NavSample]:
    """Yield the navigation solution at times of the clock (`t_ns`) and of the trajectory (`seconds`)."""
    drift, white, turn, turn_white, speed, rate, wind = (np.random.default_rng(s) for s in seeds.spawn(7))
    n, then = len(seconds), seconds - errors.latency
    position = gauss_markov(drift, seconds, np.array(errors.position), errors.position_tau)
    position += errors.position_white * white.standard_normal((n, 3)) + _jumped(errors, seconds)
    attitude = gauss_markov(turn, seconds, np.radians(errors.attitude_deg), errors.attitude_tau)
    attitude += math.radians(errors.attitude_white_deg) * turn_white.standard_normal((n, 3))
    velocity = gauss_markov(wind, seconds, np.full(3, errors.velocity), errors.velocity_tau)
    velocity += errors.velocity_white * speed.standard_normal((n, 3))
    position += flight.place_world(then)
    velocity += flight.velocity_world(then)
    rates = flight.angular_velocity_body(then) + math.radians(errors.rate_white_deg) * rate.standard_normal((n, 3))
    rotations = _turned(errors, seconds) @ flight.rotations(then)
    sigma_position = _claimed(errors.position, errors.position_white, least=1e-3)
    in_radians = np.radians(errors.attitude_deg), math.radians(errors.attitude_white_deg)
    sigma_attitude = np.maximum(np.hypot(*in_radians), 1e-4)
    sigma_velocity = _claimed(errors.velocity, errors.velocity_white, least=1e-3)
    gone = {what: _out(errors, seconds, what) for what in ("position", "rows")}
    for i in np.flatnonzero(~gone["rows"]):
        here = not gone["position"][i]
        yield NavSample(
            int(t_ns[i]),
            position[i] if here else None,
            rotations[i] @ so3_exp(attitude[i]),
            velocity[i],
            rates[i],
            sigma_position if here else None,
            sigma_attitude,
            sigma_velocity,
        )


def _out(errors: NavErrors, seconds: F64, what: str) -> NDArray[np.bool_]:
    gone = np.zeros(len(seconds), bool)
    for outage in errors.outages:
        if outage.what == what:
            gone |= outage.holds(seconds)
    return gone


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


def _bent(rng: np.random.Generator, scale: float, misalignment: float) -> F64:
    """(3, 3) measured from true: scales on the diagonal, small angles beside it."""
    M = np.diag(1.0 + scale * rng.standard_normal(3))
    return np.asarray(M + misalignment * rng.standard_normal((3, 3)) * (1.0 - np.eye(3)))


def simulated_imu(
    flight: SimulatedPath,
    t_ns: Times,
    seconds: F64,
    biases: tuple[F64, F64],
    errors: ImuErrors,
    seeds: np.random.SeedSequence,
) -> Iterator[ImuSample]:
    """Yield turn rate and specific force in the body, with scale, misalignment, bias and noise."""
    gyro, accel, gyro_axes, accel_axes = (np.random.default_rng(s) for s in seeds.spawn(4))
    root, n, lean = math.sqrt(errors.rate_hz), len(seconds), math.radians(errors.misalignment_deg)
    rates = flight.angular_velocity_body(seconds) @ _bent(gyro_axes, errors.gyroscope_scale, lean).T + biases[0]
    rates += errors.gyroscope_noise_density * root * gyro.standard_normal((n, 3))
    forces = flight.specific_force_body(seconds) @ _bent(accel_axes, errors.accelerometer_scale, lean).T + biases[1]
    forces += errors.accelerometer_noise_density * root * accel.standard_normal((n, 3))
    for t, rate, force in zip(t_ns, rates, forces, strict=True):
        yield ImuSample(int(t), rate, force)
