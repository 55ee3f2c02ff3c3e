"""The vehicle: a smooth flight through way-points, and the attitude that a multirotor needs to fly it.

Position, heading and jitter are uniform B-splines, so that velocity, acceleration and turn rate are exact derivatives.
The control points lie on the time-parametrised line through the way-points; a spline's derivatives stay within those
of its control points, so the limits of speed and acceleration hold by construction (wind jitter comes on top).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from alight.geometry import Pose, so3_log
from alight.records import F64

GRAVITY = 9.80665  # m/s^2
UPWARDS = np.array([0.0, 0.0, GRAVITY])  # what holds a vehicle against gravity, world
KNOT = 0.25  # s between control points
DEGREE = 5


@dataclass(frozen=True)
class Limits:
    """What the vehicle does at most, and how much the air shakes it."""

    speed: float = 5.0  # m/s
    acceleration: float = 2.5  # m/s^2
    wobble: float = math.radians(0.7)  # rad, standard deviation of roll, pitch and heading in gusts
    drift: float = 0.02  # metres, standard deviation of the control points in gusts


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where the vehicle is at any time of the flight, seconds from its start."""

    position: BSpline  # (3,) metres, world
    heading: BSpline  # rad, counter-clockwise from east
    lean: BSpline  # (2,) tilt of the thrust by gusts, rad about
    duration: float

    @cached_property
    def _derivatives(self) -> tuple[BSpline, BSpline]:
        return self.position.derivative(1), self.position.derivative(2)

    def acceleration_world(self, t: float) -> F64:
        """(3,) m/s^2, gravity not included."""
        return np.asarray(self._derivatives[1](t))

    def velocity_world(self, t: float) -> F64:
        """(3,) m/s."""
        return np.asarray(self._derivatives[0](t))

    def pose(self, t: float) -> Pose:
        """`world_from_body`: the rotors push against gravity, for the acceleration, and lean in gusts."""
        thrust = self.acceleration_world(t) + UPWARDS
        thrust[:2] += GRAVITY * self.lean(t)
        up = thrust / np.linalg.norm(thrust)
        psi = float(self.heading(t))
        left = _cross(up, np.array([math.cos(psi), math.sin(psi), 0.0]))
        left /= np.linalg.norm(left)
        return Pose(np.column_stack([_cross(left, up), left, up]), self.position(t))

    def angular_velocity_body(self, t: float, h: float = 1e-4) -> F64:
        """(3,) rad/s, central difference of the rotation (error below 1e-7)."""
        before, after = self.pose(t - h).rotation, self.pose(t + h).rotation
        return so3_log(before.T @ after) / (2.0 * h)

    def specific_force_body(self, t: float) -> F64:
        """(3,) m/s^2: what an accelerometer feels."""
        return np.asarray(self.pose(t).rotation.T @ (self.acceleration_world(t) + UPWARDS))


def _cross(a: F64, b: F64) -> F64:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _leg(length: float, start: float, end: float, limits: Limits) -> tuple[F64, F64]:
    """Times and distances along one leg, as fast as the limits let it: speed up, cruise, slow down."""
    v, a = limits.speed, limits.acceleration
    peak = min(v, math.sqrt(max(a * length + 0.5 * (start**2 + end**2), 1e-12)))
    t_up, t_down = max(peak - start, 0.0) / a, max(peak - end, 0.0) / a
    d_up, d_down = 0.5 * (start + peak) * t_up, 0.5 * (peak + end) * t_down
    cruise = max(length - d_up - d_down, 0.0) / peak
    t = np.linspace(0.0, t_up + cruise + t_down, 400)
    d = np.where(t < t_up, start * t + 0.5 * a * t * t, d_up + peak * (t - t_up))
    late = np.maximum(t - t_up - cruise, 0.0)
    return t, np.clip(d - 0.5 * a * late**2, 0.0, length)


def _timed_line(points: F64, limits: Limits, rolling: bool) -> tuple[F64, F64]:
    """Times (N,) and places (N, 3) along straight legs, slowed at corners to what one knot's blending can turn."""
    legs = np.diff(points, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    units = legs / lengths[:, None]
    turn = [0.5 * math.acos(float(np.clip(a @ b, -1, 1))) for a, b in pairwise(units)]
    bend = [min(limits.speed, limits.acceleration * KNOT / max(2.0 * math.sin(half), 1e-9)) for half in turn]
    edge = limits.speed if rolling else 0.0
    speeds = np.array([edge, *bend, edge])
    for order in (range(len(legs)), range(len(legs) - 1, -1, -1)):  # what can be reached, forwards and backwards
        for k in order:
            i, j = (k, k + 1) if order.step > 0 else (k + 1, k)
            speeds[j] = min(speeds[j], math.sqrt(speeds[i] ** 2 + 2 * limits.acceleration * lengths[k]))
    times, places, now = [], [], 0.0
    for k in range(len(legs)):
        t, d = _leg(float(lengths[k]), float(speeds[k]), float(speeds[k + 1]), limits)
        times.append(now + t)
        places.append(points[k] + d[:, None] * units[k])
        now += float(t[-1])
    return np.concatenate(times), np.concatenate(places)


def fly_through(
    waypoints: Sequence[Sequence[float]],
    limits: Limits,
    rng: np.random.Generator,
    heading: float | None = None,
    rolling: bool = False,
) -> Trajectory:
    """Plan a flight through way-points (east, north, up in metres), corners rounded.

    `heading` (rad, counter-clockwise from east) is held; None: towards the last way-point. `rolling`: pass the
    first and last way-point at full speed instead of starting and ending at rest.

    Raises:
        ValueError: fewer than two way-points, or two that coincide.
    """
    points = np.asarray(waypoints, dtype=np.float64)
    if len(points) < 2 or np.linalg.norm(np.diff(points, axis=0), axis=1).min() < 1e-6:
        raise ValueError("a flight needs two way-points or more, each apart from the one before")
    t, places = _timed_line(points, limits, rolling)
    duration = float(t[-1])
    centres: F64 = KNOT * np.arange(-DEGREE - 3.0, math.ceil(duration / KNOT) + DEGREE + 4.0)  # room before and after
    control = np.column_stack([np.interp(centres, t, places[:, k]) for k in range(3)])
    if rolling:
        for outside, place, side in ((centres < 0, points[0], 0), (centres > duration, points[-1], -1)):
            velocity = limits.speed * (points[1] - points[0] if side == 0 else points[-1] - points[-2])
            velocity /= np.linalg.norm(points[1] - points[0] if side == 0 else points[-1] - points[-2])
            control[outside] = place + (centres[outside] - (0.0 if side == 0 else duration))[:, None] * velocity
    psi = math.atan2(*(points[-1] - points[0])[[1, 0]]) if heading is None else heading
    return Trajectory(
        _spline(centres, control + limits.drift * _gusts(rng, len(centres), 3)),
        _spline(centres, psi + limits.wobble * _gusts(rng, len(centres), 1)[:, 0]),
        _spline(centres, limits.wobble * _gusts(rng, len(centres), 2)),
        duration,
    )


def _spline(centres: F64, control: F64) -> BSpline:
    """Uniform B-spline whose control points belong to the times `centres`."""
    knots = centres[0] + KNOT * (np.arange(len(centres) + DEGREE + 1) - 0.5 * (DEGREE + 1))
    return BSpline(knots, control, DEGREE)


def _gusts(rng: np.random.Generator, count: int, width: int) -> F64:
    """(count, width) of unit deviation, correlated over some knots (about a second)."""
    white = rng.standard_normal((count + 30, width))
    out = np.empty_like(white)
    out[0] = white[0]
    for i in range(1, len(out)):
        out[i] = 0.75 * out[i - 1] + math.sqrt(1 - 0.75**2) * white[i]
    return out[30:]
