"""Flights without images: a trajectory, its sensors, and points seen by the rig, all with exact truth.

Errors are drawn from the filter's own models (docs/method/motion.md), so that its covariance can be compared with its
errors; departures from these models are added by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Pose, so3_exp, so3_log
from alight.motion import MotionFilter
from alight.records import Event, ImuSample, Motion, NavSample, Prediction, Rig, RigCamera, Tracks
from alight.settings import FilterSettings

START = 1_700_000_000_000_000_000
DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # body_from_cam of a camera that looks down
CAMERA = Camera(640, 480, 480.0, 480.0, 319.5, 239.5)
RIG = Rig(
    (
        RigCamera("left", CAMERA, Pose(DOWN, [0.1, 0.25, 0.0])),
        RigCamera("right", CAMERA, Pose(DOWN @ so3_exp([0.004, -0.003, 0.002]), [0.1, -0.25, 0.0])),
    )
)
NOISE = FilterSettings(pixel_sigma=0.25, pixel_repeat=1.0, smooth=False)  # noise from which the errors are drawn
UP = np.array([0.0, 0.0, 9.80665])


@dataclass(frozen=True)
class PointFlight:
    """One seeded flight."""

    seed: int = 0
    seconds: float = 6.0
    height: float = 30.0  # m above ground
    speed: float = 5.0  # m/s
    rate_hz: float = 10.0  # of the exposures
    count: int = 120  # points in view
    imu: bool = True
    rig: Rig = RIG
    noise: FilterSettings = NOISE
    sigma_position: tuple[float, float, float] = (1.0, 1.0, 1.5)  # m
    sigma_attitude: tuple[float, float, float] = (0.0087, 0.0087, 0.026)  # rad
    sigma_velocity: float = 0.05  # m/s
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, rotation from the INS to the mounting in the rig
    time_offset: float = 0.0  # s that the exposures' stamps are ahead
    moving: float = 0.0  # share of the points that drift over the ground
    _streams: dict[str, np.random.Generator] = field(default_factory=dict, compare=False)

    def rng(self, *key: int) -> np.random.Generator:
        """The random numbers of one source of error."""
        return np.random.default_rng([self.seed, *key])

    @cached_property
    def _path(self) -> tuple[F64, F64, F64, float]:
        """Amplitudes, angular rates, phases of the weave (6 quantities, 2 waves), and the course."""
        rng = self.rng(0)
        scale = np.array([1.5, 1.5, 0.7, 0.25, 0.05, 0.05])[:, None]  # m m m, rad: yaw, pitch, roll
        rates = rng.uniform(0.4, 1.3, (6, 2)) * np.array([1, 1, 1, 1, 1.5, 1.5])[:, None]
        return scale * rng.normal(size=(6, 2)) * 0.7, rates, rng.uniform(0, 6.28, (6, 2)), float(rng.uniform(0, 6.28))

    def poses(self, t: F64) -> tuple[F64, F64]:
        """(N, 3, 3) world_from_body and (N, 3) positions at (N,) seconds."""
        size, rate, phase, course = self._path
        w = (size * np.sin(rate * np.asarray(t)[:, None, None] + phase)).sum(axis=2)  # (N, 6)
        along = self.speed * np.asarray(t)[:, None] * np.array([np.cos(course), np.sin(course), 0.0])
        p = along + w[:, :3] + np.array([0.0, 0.0, self.height])
        level = np.zeros(len(w))
        yaw = _turns(np.column_stack([level, level, course + w[:, 3]]))
        return yaw @ _turns(np.column_stack([w[:, 5], w[:, 4], level])), p

    def pose(self, t: float) -> Pose:
        """True world_from_body."""
        R, p = self.poses(np.array([t]))
        return Pose(R[0], p[0])

    def truth(self, t_ns: int) -> Pose:
        """True world_from_body at an instant of GPS/INS, or at an exposure of that stamp."""
        return self.pose((t_ns - START) * 1e-9 - self.time_offset)

    @staticmethod
    def seconds_of(e: Event | Tracks) -> float:
        """Seconds since the first exposure."""
        return (e.t_ns - START) * 1e-9

    def _velocity(self, t: F64, h: float = 1e-3) -> F64:
        return (self.poses(t + h)[1] - self.poses(t - h)[1]) / (2 * h)

    def _rates(self, t: F64, h: float = 1e-3) -> F64:
        before, after = self.poses(t - h)[0], self.poses(t + h)[0]
        turn = before.transpose(0, 2, 1) @ after  # small: its odd part is its vector
        return np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) / (2 * h)

    def imu_samples(self) -> list[ImuSample]:
        """IMU samples at 200 Hz, with biases of random walk."""
        t, n, rng = np.arange(-0.5, self.seconds, 0.005), self.noise, self.rng(1)
        R = self.poses(t)[0]
        force = np.einsum("nji,nj->ni", R, (self._velocity(t + 1e-3) - self._velocity(t - 1e-3)) / 2e-3 + UP)
        gyro = self._rates(t) + _bias(rng, len(t), 0.25 * n.gyro_bias_sigma, n.gyro_walk)
        force = force + _bias(rng, len(t), 0.5 * n.accelerometer_bias_sigma, n.accelerometer_walk)
        turn = so3_exp(self.mounting)  # the IMU is the INS's
        gyro, force = gyro @ turn.T, force @ turn.T
        gyro += n.gyro_noise * np.sqrt(200) * rng.normal(size=gyro.shape)
        force += n.accelerometer_noise * np.sqrt(200) * rng.normal(size=gyro.shape)
        return [ImuSample(_ns(a), w, f) for a, w, f in zip(t, gyro, force, strict=True)]

    def nav_samples(self) -> list[NavSample]:
        """GPS/INS samples at 20 Hz, with errors that drift within their sigma."""
        t, n, rng = np.arange(-0.487, self.seconds, 0.05), self.noise, self.rng(2)
        R, p = self.poses(t)
        sigma_p, sigma_a, sigma_v = np.array(self.sigma_position), np.array(self.sigma_attitude), self.sigma_velocity
        at_start = R[0] @ np.diag(sigma_a**2) @ R[0].T  # the bounds are about the body's axes, the drift in the world
        p = p + _drift(rng, t, sigma_p, n.nav_position_tau) + rng.normal(size=p.shape) * n.nav_position_white
        turn = _drift(rng, t, np.sqrt(np.diag(at_start)), n.nav_attitude_tau)
        turn = turn + rng.normal(size=p.shape) * n.nav_attitude_white
        v = self._velocity(t) + _drift(rng, t, np.full(3, sigma_v), n.nav_velocity_tau)
        v = v + rng.normal(size=p.shape) * n.nav_velocity_white
        rate = self._rates(t) + rng.normal(size=p.shape) * n.gyro_bias_sigma
        back, turns = so3_exp(self.mounting).T, _turns(turn)
        return [
            NavSample(
                _ns(t[i]),
                p[i],
                turns[i] @ R[i] @ back,
                v[i],
                rate[i],
                sigma_p,
                sigma_a,
                np.full(3, sigma_v),
            )
            for i in range(len(t))
        ]

    @cached_property
    def _points(self) -> tuple[F64, F64]:
        """Points on rolling ground along the way, and their velocities."""
        rng, course = self.rng(3), self._path[3]
        ahead, wide = np.array([np.cos(course), np.sin(course)]), 1.1 * self.height
        length = self.speed * self.seconds + 2 * wide
        n = int(self.count * length * 2 * wide / (self.height**2 * 640 * 480 / 480**2))
        s, d = rng.uniform(-wide, length - wide, n), rng.uniform(-wide, wide, n)
        xy = s[:, None] * ahead + d[:, None] * np.array([-ahead[1], ahead[0]])
        z = 0.05 * self.height * (np.sin(xy[:, 0] * 5 / self.height) + np.cos(xy[:, 1] * 9 / self.height))
        drift = np.zeros((n, 3))
        drift[: int(self.moving * n), :2] = rng.normal(size=(int(self.moving * n), 2)) * 0.3 + np.array([0.7, 0.0])
        order = rng.permutation(n)
        return np.column_stack([xy, z])[order], drift[order]

    def tracks(self) -> list[Tracks]:
        """Tracks of the points in view; now and then a point is not found again and comes back with another number."""
        t, rng = np.arange(0.0, self.seconds, 1.0 / self.rate_hz), self.rng(4)
        x, drift = self._points
        names = np.arange(len(x))
        out = []
        for a, R, p in zip(t, *self.poses(t), strict=True):
            body, now = Pose(R, p), x + drift * a
            near = np.flatnonzero(np.linalg.norm(now[:, :2] - p[:2], axis=1) < 1.2 * self.height)
            views = [(body @ c.body_from_cam).inverse.apply(now[near]) for c in self.rig.cameras]
            seen = np.stack([CAMERA.project(v) for v in views], axis=1)
            inside = ((seen > 5) & (seen < [634, 474])).all(axis=(1, 2))
            seen, who = seen[inside], near[inside]
            missed = rng.random(len(who)) < 0.02
            names[who[missed]] = names.max() + 1 + np.arange(int(missed.sum()))
            seen = seen[~missed] + rng.normal(0.0, self.noise.pixel_sigma, seen[~missed].shape)
            normalised = (seen - [319.5, 239.5]) / 480.0
            out.append(Tracks(_ns(a + self.time_offset), names[who[~missed]].astype(np.int64), seen, normalised))
        return out

    @cached_property
    def events(self) -> list[Event | Tracks]:
        """All samples and tracks in order of time."""
        out: list[Event | Tracks] = [*self.nav_samples(), *self.tracks(), *(self.imu_samples() if self.imu else [])]
        return sorted(out, key=lambda e: (e.t_ns, isinstance(e, Tracks)))


def _turns(v: F64) -> F64:
    """(N, 3, 3) rotations of (N, 3) rotation vectors (Rodrigues)."""
    angle = np.maximum(np.linalg.norm(v, axis=1), 1e-9)[:, None, None]
    K = np.zeros((len(v), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = v.T
    K = (K - K.transpose(0, 2, 1)) / angle
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def _ns(t: float) -> int:
    return START + round(float(t) * 1e9)


def _bias(rng: np.random.Generator, n: int, start: float, walk: float) -> F64:
    return start * rng.normal(size=3) + np.cumsum(walk * np.sqrt(0.005) * rng.normal(size=(n, 3)), axis=0)


def _drift(rng: np.random.Generator, t: F64, sigma: F64, tau: float) -> F64:
    """(N, 3) stationary first-order Gauss-Markov noise."""
    a, out = np.exp(-(t[1] - t[0]) / tau), np.empty((len(t), 3))
    out[0] = sigma * rng.normal(size=3)
    for i, w in enumerate(rng.normal(size=(len(t) - 1, 3))):
        out[i + 1] = a * out[i] + np.sqrt(1 - a * a) * sigma * w
    return out


Damage = Callable[[Event | Tracks], "Event | Tracks | None"]


def damaged(events: Sequence[Event | Tracks], how: Damage) -> Iterator[Event | Tracks]:
    """The events after the damage `how`, which returns None for a lost one."""
    return (e for e in map(how, events) if e is not None)


def seconds(e: Event | Tracks | Motion) -> float:
    """Seconds since the first exposure."""
    return (e.t_ns - START) * 1e-9


def run(
    events: Iterator[Event | Tracks] | Sequence[Event | Tracks], settings: FilterSettings = NOISE, rig: Rig = RIG
) -> tuple[MotionFilter, list[Motion]]:
    """Feed a filter with events; return it, and the motions that it gave out."""
    f = MotionFilter(rig, settings)
    return f, [m for m in fed(f, events) if m is not None]


def fed(f: MotionFilter, events: Iterable[Event | Tracks]) -> list[Motion | None]:
    """Feed events in their order; return the filter's motion of each exposure, None without one."""
    given = [(e, f.feed(e)) for e in events if isinstance(e, ImuSample | NavSample | Tracks)]
    return [motion for e, motion in given if isinstance(e, Tracks)]


def predicted(f: MotionFilter, stamp_ns: int, before_ns: int | None = None) -> Prediction | None:
    """The camera poses at an exposure, relative to that at `before_ns`, as the tracker gets them."""
    predictor = f.predictor()
    return None if predictor is None else predictor.cameras(stamp_ns, before_ns, f.imu)


def best(m: Motion) -> tuple[F64, F64]:
    """The position in the world, the map's offset added, and its (6, 6) covariance."""
    if m.offset_world is None:
        return m.world_from_body.translation, m.covariance
    covariance = m.covariance.copy()
    covariance[:3, :3] -= np.outer(m.offset_world, m.offset_world)
    return m.world_from_body.translation + m.offset_world, covariance


def error(m: Motion, truth: Pose) -> tuple[F64, F64]:
    """(6,) position [m] and rotation [rad] error in the world, and the covariance claimed."""
    p, covariance = best(m)
    turn = so3_log(m.world_from_body.rotation @ truth.rotation.T)
    return np.concatenate([p - truth.translation, turn]), covariance


def nees(m: Motion, truth: Pose) -> float:
    """Normalised estimation error squared; 6 expected."""
    e, covariance = error(m, truth)
    return float(e @ np.linalg.solve(covariance, e))


def blind(t: Tracks) -> Tracks:
    """The exposure without any feature."""
    return replace(t, ids=t.ids[:0], pixels=t.pixels[:0], normalised=t.normalised[:0])
