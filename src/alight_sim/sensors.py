"""Navigation solution and IMU: exact motion plus errors. Each source of noise has its own random stream."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64, I64
from alight.geometry import so3_exp
from alight.records import ImuSample, NavSample
from alight_sim.faults import Span
from alight_sim.section import Section
from alight_sim.vehicle import TrueTrajectory

Triple = tuple[float, float, float]


class Jump(Section):
    """A step of the position for some time, as by a wrong satellite, or a position that is led away."""

    at: float = Field(description="s after the first exposure")
    seconds: float | None = Field(None, gt=0, description="s that it lasts; to the end without it")
    offset: Triple = Field(description="metres east, north, up")
    speed: Triple = Field((0.0, 0.0, 0.0), description="m/s east, north, up by which the offset grows; velocities too")


class Outage(Span):
    """An outage of GPS/INS."""

    what: Literal["position", "rows"] = Field(
        "position", description="only the position is empty, or whole rows are missing"
    )


class NavErrors(Section):
    """Errors of GPS/INS. Its sigmas cover the drifts (first-order Gauss-Markov) and the white noise, nothing else."""

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
    latency: float = Field(0.0, ge=0, le=0.9, description="s: a row holds what was true so long before its stamp")
    jumps: tuple[Jump, ...] = Field((), description="steps of the position, unclaimed")
    outages: tuple[Outage, ...] = Field((), description="times without position or rows")


class ImuErrors(Section):
    """Errors of a MEMS IMU: white noise by density, random walk of the biases, scale and misalignment."""

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
        """Noise densities and random walks as the IMU's maker states them, by the keys of imu0/sensor.yaml."""
        names = [f"{s}_{n}" for s in ("gyroscope", "accelerometer") for n in ("noise_density", "random_walk")]
        return {k: float(getattr(self, k)) for k in names}


class Sensors(Section):
    """Sensors besides the cameras."""

    nav: NavErrors = Field(NavErrors(), description="GPS/INS")
    imu: ImuErrors = Field(ImuErrors(), description="IMU")


class MarkovNoise:
    """Stationary first-order Gauss-Markov noise with deviations `sigma` (N,) and correlation time `tau` (s)."""

    def __init__(self, rng: np.random.Generator, sigma: F64, tau: float) -> None:
        self._rng, self._sigma, self._tau = rng, sigma, tau
        self._state: tuple[float, F64] | None = None

    def at(self, seconds: float) -> F64:
        """Return the (N,) noise at a time (s), which must be later than the last call's time."""
        white = self._rng.standard_normal(len(self._sigma))
        if self._state is not None:
            keep = math.exp(-(seconds - self._state[0]) / self._tau)
            white = keep * self._state[1] + math.sqrt(1.0 - keep * keep) * white
        self._state = seconds, white
        return np.asarray(white * self._sigma)


def _claimed(*parts: Triple | float, least: float) -> F64:
    return np.asarray(np.maximum(np.sqrt(sum(np.square(np.broadcast_to(p, 3)) for p in parts)), least))


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """Motion of the body at an instant: the quantities that the sensors measure."""

    position_world: F64  # (3,) metres
    velocity_world: F64  # (3,) m/s
    world_from_body: F64  # (3, 3) rotation
    angular_velocity_body: F64  # (3,) rad/s


class NavStream:
    """Source of the GPS/INS rows of one flight, with their errors."""

    def __init__(self, errors: NavErrors, seeds: np.random.SeedSequence) -> None:
        drift, self._white, turn, self._turn_white, self._speed, self._rate, wind = (
            np.random.default_rng(s) for s in seeds.spawn(7)
        )
        self.errors = errors
        self.offset = np.zeros(3)  # metres: error of the last row without its white noise, even if the row was lost
        self.attitude_error, self.velocity_error = np.zeros(3), np.zeros(3)  # rad in the body, m/s: of the last row
        self.located_at = -math.inf  # s, of the last row with a position
        self._drift = MarkovNoise(drift, np.array(errors.position), errors.position_tau)
        self._turn = MarkovNoise(turn, np.radians(errors.attitude_deg), errors.attitude_tau)
        self._wind = MarkovNoise(wind, np.full(3, errors.velocity), errors.velocity_tau)
        self.sigma_position = _claimed(errors.position, errors.position_white, least=1e-3)
        in_radians = np.radians(errors.attitude_deg), math.radians(errors.attitude_white_deg)
        self._sigma_attitude = np.asarray(np.maximum(np.hypot(*in_radians), 1e-4))
        self._sigma_velocity = _claimed(errors.velocity, errors.velocity_white, least=1e-3)

    def sample(self, t_ns: int, seconds: float, true: TrueMotion) -> NavSample | None:
        """Return the row of stamp `t_ns` at a time (s) of the flight; None: it is missing.

        `true`: motion `errors.latency` seconds earlier.
        """
        e = self.errors
        jump, led = self._jump(seconds)
        drift = self._drift.at(seconds)
        self.offset = drift + jump
        position = drift + (e.position_white * self._white.standard_normal(3) + jump) + true.position_world
        attitude = self._turn.at(seconds) + math.radians(e.attitude_white_deg) * self._turn_white.standard_normal(3)
        self.attitude_error = attitude
        self.velocity_error = led + self._wind.at(seconds) + e.velocity_white * self._speed.standard_normal(3)
        rates = true.angular_velocity_body + math.radians(e.rate_white_deg) * self._rate.standard_normal(3)
        if self._gone("rows", seconds):
            return None
        here = not self._gone("position", seconds)
        self.located_at = seconds if here else self.located_at
        return NavSample(
            t_ns,
            position if here else None,
            self.heading_error(seconds) @ true.world_from_body @ so3_exp(attitude),
            self.velocity_error + true.velocity_world,
            rates,
            self.sigma_position if here else None,
            self._sigma_attitude,
            self._sigma_velocity,
        )

    def _jump(self, seconds: float) -> tuple[F64, F64]:
        """Return the offset of the positions, (3,) metres, and of the velocities, (3,) m/s, by the present jumps."""
        out, led = np.zeros(3), np.zeros(3)
        for jump in self.errors.jumps:
            if jump.at <= seconds < (math.inf if jump.seconds is None else jump.at + jump.seconds):
                out += jump.offset + (seconds - jump.at) * np.array(jump.speed)
                led += jump.speed
        return out, led

    def heading_error(self, seconds: float) -> F64:
        """Return the heading error at a time (s) as a rotation (3, 3) in the world."""
        tau = self.errors.yaw_tau
        fade = 1.0 if tau is None else math.exp(-max(seconds, 0.0) / tau)
        return so3_exp([0.0, 0.0, -math.radians(self.errors.yaw_start_deg) * fade])

    def _gone(self, what: str, seconds: float) -> bool:
        return any(o.what == what and o.at <= seconds < o.at + o.seconds for o in self.errors.outages)


def simulated_nav(
    flight: TrueTrajectory, t_ns: I64, seconds: F64, errors: NavErrors, seeds: np.random.SeedSequence
) -> Iterator[NavSample]:
    """Yield the GPS/INS rows, except lost ones, with stamps `t_ns` (N,) at times `seconds` (N,) of the trajectory."""
    then, stream = seconds - errors.latency, NavStream(errors, seeds)
    places, velocities = flight.place_world(then), flight.velocity_world(then)
    turns, rates = flight.rotations(then), flight.angular_velocity_body(then)
    for i, t in enumerate(t_ns):
        true = TrueMotion(places[i], velocities[i], turns[i], rates[i])
        row = stream.sample(int(t), float(seconds[i]), true)
        if row is not None:
            yield row


def _bent(rng: np.random.Generator, scale: float, misalignment: float) -> F64:
    """Return a random (3, 3) matrix from true to measured vectors; `scale`, `misalignment` (rad): 1-sigma."""
    M = np.diag(1.0 + scale * rng.standard_normal(3))
    return np.asarray(M + misalignment * rng.standard_normal((3, 3)) * (1.0 - np.eye(3)))


class BiasWalk:
    """Random walk of the biases of gyroscope and accelerometer."""

    def __init__(self, errors: ImuErrors, seeds: np.random.SeedSequence) -> None:
        self._rngs = [np.random.default_rng(s) for s in seeds.spawn(2)]
        walks = errors.gyroscope_random_walk, errors.accelerometer_random_walk
        self._steps = [walk * (1.0 / math.sqrt(errors.rate_hz)) for walk in walks]
        starts = errors.gyroscope_bias, errors.accelerometer_bias
        self._starts = [s * rng.standard_normal(3) for s, rng in zip(starts, self._rngs, strict=True)]
        self._walked = [np.zeros(3), np.zeros(3)]

    def next(self) -> tuple[F64, F64]:
        """Return the (3,) gyroscope and (3,) accelerometer biases of the next sample, rad/s and m/s^2."""
        for k, (rng, step) in enumerate(zip(self._rngs, self._steps, strict=True)):
            self._walked[k] = self._walked[k] + step * rng.standard_normal(3)
        return self._starts[0] + self._walked[0], self._starts[1] + self._walked[1]


def imu_biases(n: int, errors: ImuErrors, seeds: np.random.SeedSequence) -> tuple[F64, F64]:
    """Draw (n, 3) gyroscope biases, rad/s, and (n, 3) accelerometer biases, m/s^2, of `n` successive samples."""
    walk = BiasWalk(errors, seeds)
    both = np.array([walk.next() for _ in range(n)])
    return both[:, 0], both[:, 1]


class ImuStream:
    """Source of the IMU samples of one flight, with their errors."""

    def __init__(self, errors: ImuErrors, seeds: np.random.SeedSequence) -> None:
        self._gyro, self._accel, gyro_axes, accel_axes = (np.random.default_rng(s) for s in seeds.spawn(4))
        root, lean = math.sqrt(errors.rate_hz), math.radians(errors.misalignment_deg)
        self._axes = _bent(gyro_axes, errors.gyroscope_scale, lean), _bent(accel_axes, errors.accelerometer_scale, lean)
        self._sigmas = errors.gyroscope_noise_density * root, errors.accelerometer_noise_density * root

    def sample(self, t_ns: int, rate: F64, force: F64, biases: tuple[F64, F64]) -> ImuSample:
        """Return the measured sample of a true angular rate (3,) and specific force (3,) in the body.

        `biases`: gyroscope, rad/s, and accelerometer, m/s^2, both (3,).
        """
        measured = self._axes[0] @ rate + biases[0] + self._sigmas[0] * self._gyro.standard_normal(3)
        felt = self._axes[1] @ force + biases[1] + self._sigmas[1] * self._accel.standard_normal(3)
        return ImuSample(t_ns, measured, felt)


def simulated_imu(
    flight: TrueTrajectory,
    t_ns: I64,
    seconds: F64,
    biases: tuple[F64, F64],
    errors: ImuErrors,
    seeds: np.random.SeedSequence,
) -> Iterator[ImuSample]:
    """Yield the IMU samples with stamps `t_ns` (N,) at times `seconds` (N,) of the trajectory.

    `biases`: gyroscope, rad/s, and accelerometer, m/s^2, both (N, 3).
    """
    stream = ImuStream(errors, seeds)
    rates, forces = flight.angular_velocity_body(seconds), flight.specific_force_body(seconds)
    for i, t in enumerate(t_ns):
        yield stream.sample(int(t), rates[i], forces[i], (biases[0][i], biases[1][i]))
