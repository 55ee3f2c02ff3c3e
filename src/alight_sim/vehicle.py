"""The vehicle: a smooth flight along a planned line, and the attitude that flies it in wind.

Position, heading, gusts and wobble are uniform B-splines. So velocity, acceleration and angular rate are exact
derivatives, and the noise-free IMU integrates back to the trajectory. A spline's derivatives stay within those of its
control points, so the limits of speed, acceleration, climb, sink and turn rate hold by construction. The effect of
gusts is added. The attitude follows from the thrust that balances the motion, gravity and the drag of the air.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import Field
from scipy.constants import g
from scipy.interpolate import BSpline
from scipy.linalg import expm
from scipy.signal import lfilter, ss2tf

from alight.arrays import F64
from alight.geometry import Pose
from alight_sim.section import Section

UPWARDS = np.array([0.0, 0.0, g])  # m/s^2, balances gravity, world
KNOT = 0.25  # s between control points
DEGREE = 5
HOLD, DAMPING = 1.2, 0.7  # rad/s and share of critical damping: an autopilot that holds its position against a gust
SHARP = 8  # the tilt limit bends in within a few per cent of it: (1 + (tilt / limit)^16)^(-1/16)


class Limits(Section):
    """Limits of the vehicle's motion; gusts may exceed them, except for the tilt."""

    acceleration: float = Field(2.5, gt=0, le=8.0, description="m/s^2, in all directions together")
    tilt_deg: float = Field(30.0, gt=1.0, lt=80.0, description="degrees from level, wind and gusts included")
    turn_deg_per_s: float = Field(45.0, gt=0, description="degrees a second of heading")
    climb: float = Field(3.0, gt=0, description="m/s upwards")
    sink: float = Field(2.5, gt=0, description="m/s downwards")

    @property
    def steepest(self) -> float:
        """Tangent of the tilt limit."""
        return math.tan(math.radians(self.tilt_deg))


class Air(Section):
    """The wind in which the vehicle flies."""

    wind: float = Field(2.0, ge=0, description="m/s, steady")
    from_deg: float = Field(250.0, description="degrees clockwise from north that the wind comes from")
    gusts: float = Field(0.6, ge=0, description="m/s, standard deviation along each axis (Gauss-Markov)")
    gust_time: float = Field(2.0, ge=0.5, description="s, correlation time of the gusts")
    wobble_deg: float = Field(0.4, ge=0, description="degrees, standard deviation of what small eddies turn")

    @property
    def wind_world(self) -> F64:
        """(3,) m/s, velocity of the air."""
        bearing = math.radians(self.from_deg)
        return -self.wind * np.array([math.sin(bearing), math.cos(bearing), 0.0])


CALM = Air(wind=0.0, gusts=0.0, wobble_deg=0.0)


@dataclass(frozen=True)
class SimulatedVehicle:
    """Properties of a kind of aircraft."""

    drag: float  # 1/s: deceleration per m/s of air speed
    lean_left: float = 0.0  # rad: against the side force of a tail rotor
    vibration: tuple[tuple[float, float], ...] = ()  # (Hz, m/s^2) of the rotor's vibration


VEHICLES = {
    "multirotor": SimulatedVehicle(drag=0.2),
    "helicopter": SimulatedVehicle(drag=0.07, lean_left=math.radians(2.5), vibration=((24.0, 1.2), (48.0, 0.6))),
}


@dataclass(frozen=True, eq=False)
class TrueTrajectory:
    """True motion of the vehicle, as functions of a time or times (N,) in seconds from the flight's start."""

    position: BSpline  # (3,) metres, world, without vibration
    heading: BSpline  # rad, counter-clockwise from east
    wobble: BSpline  # (2,) rad, about: tilt of the thrust by small eddies
    gusts: BSpline  # (3,) m/s, world
    wind: F64  # (3,) m/s, world
    vehicle: SimulatedVehicle
    steepest: float  # tangent of the tilt limit
    duration: float  # s

    @cached_property
    def _derivatives(self) -> tuple[BSpline, BSpline]:
        return self.position.derivative(1), self.position.derivative(2)

    def _shaken(self, t: F64 | float, order: int) -> F64:
        """Return the `order`-th derivative of the (..., 3) vibration, m, along (1, 0.6, 0.8) of the world."""
        t = np.asarray(t, dtype=np.float64)[..., None]
        out: F64 = np.zeros(3)
        for hertz, acceleration in self.vehicle.vibration:
            w = 2.0 * math.pi * hertz
            phases = w * t + np.array([0.0, 1.9, 4.1]) + order * math.pi / 2.0
            out = out + acceleration * w ** (order - 2.0) * np.array([1.0, 0.6, 0.8]) * np.sin(phases)
        return out

    def place_world(self, t: F64 | float) -> F64:
        """Return the (..., 3) positions in the world, metres."""
        return np.asarray(self.position(t)) + self._shaken(t, 0)

    def velocity_world(self, t: F64 | float) -> F64:
        """Return the (..., 3) velocities in the world, m/s."""
        return np.asarray(self._derivatives[0](t)) + self._shaken(t, 1)

    def acceleration_world(self, t: F64 | float) -> F64:
        """Return the (..., 3) accelerations in the world without gravity, m/s^2."""
        return np.asarray(self._derivatives[1](t)) + self._shaken(t, 2)

    def rotations(self, t: F64 | float) -> F64:
        """Return the (..., 3, 3) `world_from_body`: up along the required thrust, forward along the heading."""
        push = np.asarray(self._derivatives[1](t)) + UPWARDS
        push += self.vehicle.drag * (np.asarray(self._derivatives[0](t)) - self.wind - self.gusts(t))
        psi = np.asarray(self.heading(t))
        c, s = np.cos(psi), np.sin(psi)
        slant = push[..., :2] / push[..., 2:] + self.wobble(t)
        slant += math.tan(self.vehicle.lean_left) * np.stack([-s, c], axis=-1)
        share = (slant**2).sum(axis=-1, keepdims=True) / self.steepest**2
        slant *= (1.0 + share**SHARP) ** (-0.5 / SHARP)
        up = np.concatenate([slant, np.ones_like(slant[..., :1])], axis=-1)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        left = np.cross(up, np.stack([c, s, np.zeros_like(c)], axis=-1))
        left /= np.linalg.norm(left, axis=-1, keepdims=True)
        return np.stack([np.cross(left, up), left, up], axis=-1)

    def pose(self, t: float) -> Pose:
        """Return the true `world_from_body` at one time."""
        return Pose(self.rotations(t), self.place_world(t))

    def angular_velocity_body(self, t: F64 | float, h: float = 1e-4) -> F64:
        """Return the (..., 3) rates in the body, rad/s, by central differences over +- `h` s (error below 1e-7)."""
        t = np.asarray(t, dtype=np.float64)
        turn = np.swapaxes(self.rotations(t - h), -1, -2) @ self.rotations(t + h)
        skew = turn - np.swapaxes(turn, -1, -2)
        sine = 0.5 * np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
        return np.asarray(sine * (1.0 + (sine**2).sum(axis=-1, keepdims=True) / 6.0) / (2.0 * h))

    def specific_force_body(self, t: F64 | float) -> F64:
        """Return the (..., 3) specific force in the body, m/s^2, as an ideal accelerometer measures it."""
        force = self.acceleration_world(t) + UPWARDS
        return np.asarray((np.swapaxes(self.rotations(t), -1, -2) @ force[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class _Line:
    """A polyline timed within the limits: positions as a function of time, and its duration."""

    points: F64  # (N, 3)
    speeds: F64  # (N,) m/s at the points
    peaks: F64  # (N - 1,) m/s, highest in each leg
    push: float  # m/s^2 along the line

    @cached_property
    def _legs(self) -> tuple[F64, F64, F64, F64, F64]:
        legs = np.diff(self.points, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        up, down = (self.peaks - self.speeds[:-1]) / self.push, (self.peaks - self.speeds[1:]) / self.push
        ramps = 0.5 * (self.speeds[:-1] + self.peaks) * up + 0.5 * (self.peaks + self.speeds[1:]) * down
        cruise = np.maximum(lengths - ramps, 0.0) / self.peaks
        return legs / lengths[:, None], lengths, up, cruise, np.cumsum(up + cruise + down)

    @property
    def duration(self) -> float:
        return float(self._legs[4][-1])

    def at(self, t: F64) -> F64:
        """Return the (M, 3) positions at times (M,); before the start and after the end the line continues straight."""
        units, lengths, up, cruise, ends = self._legs
        k = np.clip(np.searchsorted(ends, t, side="right"), 0, len(ends) - 1)
        local = t - np.concatenate([[0.0], ends[:-1]])[k]
        start, peak = self.speeds[:-1][k], self.peaks[k]
        rising = np.clip(local, 0.0, up[k])
        falling = np.maximum(local - up[k] - cruise[k], 0.0)
        d = start * np.minimum(local, 0.0) + start * rising + 0.5 * self.push * rising**2
        d += peak * np.maximum(local - up[k], 0.0) - 0.5 * self.push * falling**2
        over = np.maximum(t - ends[-1], 0.0)
        d = np.where(over > 0, lengths[k] + self.speeds[-1] * over, d)
        return np.asarray(self.points[k] + d[:, None] * units[k])


def _timed(points: F64, speed: float, limits: Limits, most: float, rolling: bool) -> _Line:
    """Return a polyline through points (N, 3), flown at up to `speed` m/s within `most` m/s^2.

    `rolling`: whether its ends are passed at full speed instead of at rest.
    """
    legs = np.diff(points, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    units = legs / lengths[:, None]
    rise = units[:, 2]
    with np.errstate(divide="ignore"):
        leg_speeds = np.minimum(speed, np.where(rise > 0, limits.climb, limits.sink) / np.abs(rise))
    push = 0.7 * most  # along the line; as much is left for turning
    edge = 1.0 if rolling else 0.0
    speeds = np.concatenate(
        [[edge * leg_speeds[0]], np.minimum(leg_speeds[:-1], leg_speeds[1:]), [edge * leg_speeds[-1]]]
    )
    bends = np.linalg.norm(np.diff(units, axis=0), axis=1)
    around = 0.5 * (lengths[:-1] + lengths[1:])
    with np.errstate(divide="ignore"):
        corner = KNOT * np.maximum(most / bends - 0.5 * push, 0.15 * most)  # one corner within a knot's blending
        curve = np.sqrt(push * around / bends)  # many corners: v^2 / r
    speeds[1:-1] = np.minimum(speeds[1:-1], np.minimum(corner, curve))
    for k in range(len(legs)):  # speeds that can be reached, forwards and backwards
        speeds[k + 1] = min(speeds[k + 1], math.sqrt(speeds[k] ** 2 + 2 * push * lengths[k]))
    for k in range(len(legs) - 1, -1, -1):
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + 2 * push * lengths[k]))
    reach = np.sqrt(push * lengths + 0.5 * (speeds[:-1] ** 2 + speeds[1:] ** 2))
    return _Line(points, speeds, np.maximum(np.minimum(leg_speeds, reach), np.maximum(speeds[:-1], speeds[1:])), push)


def push_left(speed: float, limits: Limits, air: Air, vehicle: SimulatedVehicle) -> float:
    """Return the acceleration, m/s^2, possible within the tilt limit at `speed` in the wind; negative: too fast."""
    slant = limits.steepest - math.tan(vehicle.lean_left)
    drag = vehicle.drag * (speed + air.wind)
    return float(min(limits.acceleration, (slant * g - drag) / (1.0 + slant)))  # a faster sink reduces the thrust


def fly_through(
    points: F64,
    speed: float,
    rng: np.random.Generator,
    limits: Limits | None = None,
    *,
    air: Air = CALM,
    vehicle: SimulatedVehicle = VEHICLES["multirotor"],
    heading: float | None = None,
    rolling: bool = False,
    hold: float = 0.0,
) -> TrueTrajectory:
    """Fly along a line of (N, 3) positions (east, north, up in metres), with rounded corners.

    Args:
        heading: constant heading, rad counter-clockwise from east; None: it follows the course as fast as allowed.
        rolling: whether the ends are passed at full speed instead of at rest.
        hold: duration of the hover for a single point, s.

    Raises:
        ValueError: there is no point, two points coincide, or wind and speed exceed the tilt limit.
    """
    bounds = limits or Limits()
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 1:
        raise ValueError("there is no way-point; a flight needs at least one")
    if (same := np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-6)).size:
        raise ValueError(f"way-points {same[0] + 1} and {same[0] + 2} are at the same place; leave one out")
    cruise = speed if len(points) > 1 else 0.0
    most = push_left(cruise, bounds, air, vehicle)
    if most < 0.1:
        raise ValueError(
            f"{cruise:g} m/s in {air.wind:g} m/s of wind leans it over the tilt limit of {bounds.tilt_deg:g} degrees; "
            "fly slower, in less wind, or raise it"
        )
    line = _timed(points, speed, bounds, most, rolling) if len(points) > 1 else None
    duration = line.duration if line else hold
    centres: F64 = KNOT * np.arange(-DEGREE - 3.0, math.ceil(duration / KNOT) + DEGREE + 4.0)  # room before and after
    control = line.at(centres) if line else np.repeat(points, len(centres), axis=0)
    psi = _nose(control, centres, bounds) if heading is None else np.full(len(centres), heading)
    air_rng, eddies = rng.spawn(2)
    gusts = air.gusts * correlated(air_rng, len(centres), 3, KNOT / air.gust_time)
    wobble = math.radians(air.wobble_deg) * correlated(eddies, len(centres), 3, 0.29)
    return TrueTrajectory(
        _spline(centres, control + _blown(vehicle.drag * gusts)),
        _spline(centres, psi + wobble[:, 2]),
        _spline(centres, wobble[:, :2]),
        _spline(centres, gusts),
        air.wind_world,
        vehicle,
        bounds.steepest,
        duration,
    )


def _nose(control: F64, centres: F64, limits: Limits) -> F64:
    """Return the heading at control points (N, 3), rad from east: along the course, turned no faster than allowed."""
    velocity = np.gradient(control[:, :2], KNOT, axis=0)
    moving = np.hypot(*velocity.T) > 0.3
    if not moving.any():
        return np.zeros(len(centres))
    nearest = np.maximum.accumulate(np.where(moving, np.arange(len(centres)), -1))
    nearest[nearest < 0] = np.flatnonzero(moving)[0]
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])[nearest])
    most = math.radians(limits.turn_deg_per_s) * KNOT
    for i in range(1, len(course)):
        course[i] = course[i - 1] + np.clip(course[i] - course[i - 1], -most, most)
    return np.asarray(course)


def _spline(centres: F64, control: F64) -> BSpline:
    """Return the uniform B-spline of control points (N, ...) that belong to the times `centres` (N,), s."""
    knots = centres[0] + KNOT * (np.arange(len(centres) + DEGREE + 1) - 0.5 * (DEGREE + 1))
    return BSpline(knots, control, DEGREE)


def correlated(rng: np.random.Generator, count: int, width: int, step: float) -> F64:
    """Return (count, width) Gauss-Markov noise of unit deviation; `step` is the time step over the correlation time."""
    keep = math.exp(-step)
    white = rng.standard_normal((count, width))
    white[1:] *= math.sqrt(1.0 - keep * keep)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))


def _blown(push: F64) -> F64:
    """Return the (N, 3) displacement (m) of a vehicle that holds its position against pushes (N, 3), m/s^2."""
    A = np.array([[0.0, 1.0, 0.0], [-(HOLD**2), -2.0 * DAMPING * HOLD, 1.0], [0.0, 0.0, 0.0]])
    step = expm(A * KNOT)  # exact for a push that is constant between knots
    top, bottom = ss2tf(step[:2, :2], step[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    return np.asarray(lfilter(top[0], bottom, push, axis=0))
