"""A vehicle as a point mass with limits: set-points in, true pose and velocity out. ENU, FLU, metres from the home."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose
from alight.records import Event
from alight_sim.vehicle import UPWARDS

_BRAKING = 0.7  # share of the acceleration that is planned for braking
_STAND = 0.02  # m above the ground within which the vehicle stands


@dataclass(frozen=True)
class FlightLimits:
    """Limits of the vehicle's motion."""

    speed: float = 8.0  # m/s over the ground
    climb: float = 2.5  # m/s
    sink: float = 1.5  # m/s
    acceleration: float = 3.0  # m/s^2
    reaction: float = 0.25  # s, time in which a commanded velocity is reached if the other limits allow it
    approach: float = 0.9  # 1/s, speed per metre of remaining distance
    turn: float = 1.0  # rad/s
    drag: float = 0.15  # 1/s, deceleration per m/s of air speed, which the lean into the wind balances
    lag: float = 0.0  # s, of each of two lags of the thrust behind its command; 0: it leans at once


@dataclass(frozen=True, eq=False)
class Wanted:
    """Set-point of the vehicle; a field that is None is not commanded."""

    position: F64 | None = None  # (3,) metres
    velocity: F64 | None = None  # (3,) m/s; with a position: added to the velocity towards it
    heading: float | None = None  # rad, clockwise from north
    speed: float = math.inf  # m/s, a limit below the vehicle's own
    sink: float = math.inf  # m/s, limit downwards


@dataclass
class PointMass:
    """The true vehicle. Only `step` moves it.

    `ground` returns the height of the ground at a position (east, north). Gusts are a Gauss-Markov acceleration.
    """

    limits: FlightLimits = FlightLimits()
    ground: Callable[[float, float], float] = lambda east, north: 0.0
    wind_world: F64 = field(default_factory=lambda: np.zeros(3))  # (3,) m/s, velocity of the air
    gusts: float = 0.0  # m/s^2, standard deviation of their acceleration
    push_world: F64 = field(default_factory=lambda: np.zeros(3))  # (3,) m/s^2, external, in addition to the gusts
    seed: int = 0
    position: F64 = field(default_factory=lambda: np.zeros(3))
    velocity: F64 = field(default_factory=lambda: np.zeros(3))
    heading: float = 0.0
    touchdown_speed: float = 0.0  # m/s, downwards, of the last contact
    battery: float = 1.0  # share of a full charge
    endurance: float = 1200.0  # s of flight with a full battery

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._gust = np.zeros(3)
        self._acceleration = np.zeros(3)
        self._thrust = np.zeros(3)
        self._rates = np.zeros(3)
        self._aloft = False
        self.position = np.array(self.position, dtype=np.float64)
        self.position[2] = max(self.position[2], self._floor)

    @property
    def _floor(self) -> float:
        return float(self.ground(float(self.position[0]), float(self.position[1])))

    @property
    def body(self) -> PointMass:
        """This object itself, as the interface `TrueVehicle` requires."""
        return self

    @property
    def stands(self) -> bool:
        """Whether the vehicle is on the ground."""
        return bool(self.position[2] - self._floor < _STAND)

    @property
    def world_from_body(self) -> Pose:
        """The true pose, with thrust that balances weight, drag and acceleration."""
        return Pose(self._attitude(), self.position.copy())

    @property
    def angular_velocity_body(self) -> F64:
        """Angular velocity in the body during the last step, (3,) rad/s."""
        return self._rates.copy()

    @property
    def imu(self) -> tuple[F64, F64]:
        """Angular rate (3,) rad/s and specific force (3,) m/s^2 in the body, as an ideal IMU measures them."""
        return self.angular_velocity_body, np.asarray(self._attitude().T @ (self._acceleration + UPWARDS))

    def step(self, dt: float, wanted: Wanted | None) -> Sequence[Event]:
        """Move for `dt` seconds towards a set-point (None: motors off); return no events, because it has no sensors."""
        before = self._attitude()
        if wanted is None:
            self._fall(dt)
        else:
            self._fly(dt, wanted)
            self.battery = max(0.0, self.battery - dt / self.endurance)
        self._meet_ground()
        turn = before.T @ self._attitude()
        self._rates = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2 * dt)
        return ()

    def _fly(self, dt: float, wanted: Wanted) -> None:
        most = self.limits.acceleration
        commanded = (self._wanted_velocity(wanted) - self.velocity) / self.limits.reaction
        commanded *= min(1.0, most / max(float(np.linalg.norm(commanded)), 1e-9))
        decay = math.exp(-dt / 2.0)
        self._gust = decay * self._gust + math.sqrt(1 - decay**2) * self.gusts * self._rng.standard_normal(3)
        self._follow(dt, commanded + self._gust + self.push_world)
        self.position = self.position + self.velocity * dt + 0.5 * self._acceleration * dt**2
        self.velocity = self.velocity + self._acceleration * dt
        if wanted.heading is not None:
            left = math.remainder(wanted.heading - self.heading, 2 * math.pi)
            self.heading += max(-self.limits.turn * dt, min(self.limits.turn * dt, left))

    def _follow(self, dt: float, commanded: F64) -> None:
        """Follow an acceleration, (3,) m/s^2, for `dt` seconds, with two lags so that the turn rate is continuous."""
        keep = math.exp(-dt / self.limits.lag) if self.limits.lag > 0 else 0.0
        self._thrust = commanded + keep * (self._thrust - commanded)
        self._acceleration = self._thrust + keep * (self._acceleration - self._thrust)

    def _fall(self, dt: float) -> None:
        self._acceleration = np.zeros(3) if self.stands else -UPWARDS
        self.position = self.position + self.velocity * dt
        self.velocity = np.zeros(3) if self.stands else self.velocity + self._acceleration * dt

    def _wanted_velocity(self, wanted: Wanted) -> F64:
        out = np.zeros(3) if wanted.velocity is None else np.array(wanted.velocity, dtype=np.float64)
        if wanted.position is not None:
            left = wanted.position - self.position
            away = max(float(np.linalg.norm(left)), 1e-9)
            brakes = math.sqrt(2 * _BRAKING * self.limits.acceleration * away)
            out = out + left * min(self.limits.approach, brakes / away)
        over = float(np.hypot(out[0], out[1]))
        out[:2] *= min(1.0, min(self.limits.speed, wanted.speed) / max(over, 1e-9))
        out[2] = min(max(out[2], -self.limits.sink, -wanted.sink), self.limits.climb)
        return out

    def _meet_ground(self) -> None:
        floor = self._floor
        if self.position[2] > floor + _STAND:
            self._aloft = True
        if self.position[2] <= floor:
            if self._aloft:
                self.touchdown_speed, self._aloft = float(-self.velocity[2]), False
            self.position[2] = floor
            self.velocity = np.array([0.0, 0.0, max(self.velocity[2], 0.0)])

    def _attitude(self) -> F64:
        """Return the (3, 3) rotation, world from body: z along the thrust, x towards the heading."""
        push = self._acceleration + self.limits.drag * (self.velocity - self.wind_world) + UPWARDS
        if self.stands or push[2] < 1.0:
            push = np.array([0.0, 0.0, 1.0])
        zx, zy, zz = (float(v) for v in push / math.sqrt(float(push @ push)))
        east, north = math.sin(self.heading), math.cos(self.heading)
        yx, yy, yz = -zz * north, zz * east, zx * north - zy * east  # z x heading
        length = math.sqrt(yx * yx + yy * yy + yz * yz)
        yx, yy, yz = yx / length, yy / length, yz / length
        return np.array([[yy * zz - yz * zy, yx, zx], [yz * zx - yx * zz, yy, zy], [yx * zy - yy * zx, yz, zz]])
