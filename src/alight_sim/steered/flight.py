"""A flight that is steered: set-points in, events out, step by step, over the same worlds and with the same errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import LocalFrame, Pose, so3_exp
from alight.records import Event, InputError, Rig
from alight.settings import ImuNoise
from alight_sim.course import LEAD, ground_at
from alight_sim.faults import Faults
from alight_sim.flight import IMU_BIAS, IMU_NOISE, NAV, START_NS, WIND, flight_notes
from alight_sim.point_mass import FlightLimits, PointMass, Wanted
from alight_sim.scene import Scene
from alight_sim.scene_world import build
from alight_sim.sensors import BiasWalk, ImuErrors, ImuStream, Jump, NavErrors, NavStream, Outage, TrueMotion
from alight_sim.steered.bodies import Body
from alight_sim.steered.cameras import CameraFault, SteeredCameras
from alight_sim.steered.ground import GroundBelow
from alight_sim.steered.sensing import SteeredSensors
from alight_sim.steered.track import TrueTrack
from alight_sim.world import World

NIMBLE = FlightLimits(lag=0.08)
IMU_RATE_HZ = 100.0  # of a flight without an IMU of its own; the vehicle moves in steps of the IMU
STRIKE_STEPS = 5  # samples of the IMU between two checks for things beside
LAST = 1.0  # metres above the ground: lower, a contact is a touchdown
_TRIM = 1.5  # s, time constant with which the autopilot learns a new wind or a lasting gust
_SETTLE = 1.0  # s over which the autopilot smooths its navigation solution


@dataclass(frozen=True)
class TrueBattery:
    """Charge of the battery, and consumption in flight."""

    share: float = 1.0  # left at the start
    endurance: float = 1200.0  # s of hovering with a full one
    climb: float = 1.5e-4  # share for each metre upwards, on top of that


@dataclass(frozen=True, eq=False)
class TrueContact:
    """Contact of the vehicle with the ground or a thing: time, pose, velocity."""

    t_ns: int
    pose: Pose  # world_from_body just then; its origin is `standing` above the ground
    velocity_world: F64  # (3,) m/s just before
    standing: float  # metres from the plane of the feet to the body's origin
    struck: float | None = None  # metres above its feet: top of the thing that it struck in flight; None: a touchdown


@dataclass(frozen=True, eq=False)
class NavigationError:
    """Errors of the navigation solution at one instant."""

    position: F64  # (3,) metres, world
    attitude: F64  # (3, 3) rotation in the body, to the right of the true one
    heading: F64  # (3, 3) rotation in the world, to the left of the true one
    velocity: F64  # (3,) m/s, world
    sigma: F64  # (3,) metres, claimed for the position
    blind: float  # s since the last row with a position


class SteeredFlight:
    """A source of events that follows set-points. The same seed and calls give the same bits.

    Args:
        scene: a built-in scene's name, a scene file, a scene, or a world.
        seed: of all random draws.
        size: of the pictures, pixels; the world's rig is scaled to it.
        stereo: all cameras of the rig, or the first alone.
        rate_hz: exposures a second.
        start: east and north, and metres above the ground there.
        heading: rad clockwise from north.
        limits: of the vehicle; None: `NIMBLE`.
        wind: (3,) m/s, east, north, up: velocity of the air.
        gusts: m/s^2, standard deviation of their acceleration.
        battery: charge and consumption; None: `TrueBattery()`.
        faults, nav, imu: instead of the world's, whose IMU is read `IMU_RATE_HZ` times a second.
        standing: metres from the plane of the feet to the body's origin.
        radius: metres about its middle within which it strikes things higher than its feet; 0: it strikes none.

    Raises:
        InputError: no such scene, or `size` is not of the shape of the rig's pictures.
    """

    kind: Literal["flight"] = "flight"
    georeferenced = True
    schedule = None
    flown_with = None

    def __init__(
        self,
        scene: str | Path | Scene | World = "demo",
        seed: int = 0,
        *,
        size: tuple[int, int] = (320, 240),
        stereo: bool = True,
        rate_hz: float = 5.0,
        start: Sequence[float] = (0.0, 0.0, 40.0),
        heading: float = 0.0,
        limits: FlightLimits | None = None,
        wind: Sequence[float] = (0.0, 0.0, 0.0),
        gusts: float = 0.2,
        battery: TrueBattery | None = None,
        faults: Faults | None = None,
        nav: NavErrors | None = None,
        imu: ImuErrors | None = None,
        standing: float = 0.35,
        radius: float = 0.0,
    ) -> None:
        self.world: World = build(scene, seed) if isinstance(scene, str | Path | Scene) else scene
        self.bodies: list[Body] = []  # that have come on command
        self.seed, self.rate_hz, self.standing = seed, rate_hz, standing
        self.warnings = list(self.world.warnings)
        self._faults = faults or self.world.faults
        self.true_rig = sized_rig(self.world.rig, size, stereo)
        self.rig = self._faults.claimed(self.true_rig)
        self._cameras = SteeredCameras(self.world, self.true_rig, self._faults, rate_hz, self._seeds, self.bodies)
        self._imu_errors = imu or self.world.sensors.imu.model_copy(update={"rate_hz": IMU_RATE_HZ})
        self._nav = NavStream(nav or self.world.sensors.nav, self._seeds(NAV))
        self._track = TrueTrack()
        self._sensors = SteeredSensors(
            ImuStream(self._imu_errors, self._seeds(IMU_NOISE)),
            BiasWalk(self._imu_errors, self._seeds(IMU_BIAS)),
            self._nav,
            self._cameras,
            self._track,
        )
        self._cost = battery or TrueBattery()
        self.battery = self._cost.share
        self.contacts: list[TrueContact] = []
        self._below, self._radius, self._strikes = GroundBelow(self.world, self.bodies, radius), radius, False
        self._air, self._trimmed = np.array(wind, float), np.array(wind, float)
        self._pushes: list[tuple[float, float, F64]] = []
        self._leant = np.zeros(3)  # m/s^2, learned part of the gusts
        self._steps, self._asked_ns = 0, 0
        self._start_vehicle(np.array(start, float), heading, limits or NIMBLE, gusts)
        self._settled = np.zeros(3)  # metres: error of the navigation solution, smoothed

    def _start_vehicle(self, start: F64, heading: float, limits: FlightLimits, gusts: float) -> None:
        ground = ground_at(self.world, start)
        place = np.array([start[0], start[1], ground + start[2] + self.standing])
        seed = int(self._seeds(WIND).generate_state(1)[0])
        self._vehicle = PointMass(limits, self._floor, self._air, gusts, seed=seed, position=place, heading=heading)
        self._stood = self._vehicle.stands

    def _floor(self, east: float, north: float) -> float:
        return self._below.height(east, north) + self.standing

    def _seeds(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=key)

    # -- properties of a source

    @property
    def name(self) -> str:
        """The scene and the seed."""
        return f"{self.world.name}-{self.seed}"

    @property
    def local(self) -> LocalFrame:
        """Local frame of the world: its origin on Earth."""
        return self.world.local

    @property
    def imu_noise(self) -> ImuNoise:
        """Noise densities of the IMU as its maker states them."""
        return ImuNoise(**self._imu_errors.densities)

    @property
    def notes(self) -> dict[str, Any]:
        """Facts for the report."""
        return flight_notes(self.rig, self.world, self._imu_errors)

    @property
    def counts(self) -> dict[str, int]:
        """Exposures so far, the lost ones included."""
        return {"exposures": self._cameras.next}

    # -- truth

    @property
    def seconds(self) -> float:
        """Time of the flight, s, from its first exposure; it begins LEAD before."""
        return self._asked_ns * 1e-9 - LEAD

    @property
    def time_ns(self) -> int:
        """Time of the events' clock, ns."""
        return START_NS - round(LEAD * 1e9) + self._asked_ns

    @property
    def true_pose(self) -> Pose:
        """True `world_from_body`, at most one sample of the IMU ago."""
        return self._vehicle.world_from_body

    @property
    def body(self) -> PointMass:
        """The true vehicle, to be read only."""
        return self._vehicle

    @property
    def true_velocity(self) -> F64:
        """(3,) m/s, world, at most one sample of the IMU ago."""
        return self._vehicle.velocity.copy()

    @property
    def height_above_ground(self) -> float:
        """Metres from the surface below to the plane of the feet."""
        east, north, up = self._vehicle.position
        return float(up - self._floor(float(east), float(north)))

    @property
    def gap(self) -> float:
        """Metres from the highest thing within its radius, or below its middle, up to the plane of its feet."""
        east, north, up = (float(c) for c in self._vehicle.position)
        return up - self.standing - self._below.highest(east, north)

    @property
    def learned_wind(self) -> F64:
        """(3,) m/s: velocity of the air as the autopilot has learned it."""
        return self._trimmed.copy()

    @property
    def wind_speed(self) -> float:
        """Horizontal speed of `learned_wind`, m/s."""
        return math.hypot(self._trimmed[0], self._trimmed[1])

    @property
    def landed(self) -> bool:
        """True if it stands on something."""
        return self._vehicle.stands

    @property
    def navigation(self) -> NavigationError:
        """Errors of the navigation solution now; that of the position is smoothed, as an autopilot's estimate is."""
        seconds = self._steps / self._imu_errors.rate_hz - LEAD
        return NavigationError(
            self._settled, so3_exp(self._nav.attitude_error), self._nav.heading_error(seconds),
            self._nav.velocity_error, self._nav.sigma_position, max(seconds - self._nav.located_at, 0.0),
        )  # fmt: skip

    @property
    def contact(self) -> TrueContact | None:
        """The last contact; None: there has been none."""
        return self.contacts[-1] if self.contacts else None

    def poses(self, t_ns: I64) -> list[Pose]:
        """True `world_from_body` at times (N,) of the last three seconds."""
        turns, places = self._track.poses(1e-9 * np.asarray(t_ns - START_NS, np.float64))
        return [Pose(R, p) for R, p in zip(turns, places, strict=True)]

    # -- time

    def step(self, dt: float, wanted: Wanted | None) -> list[Event]:
        """Fly for `dt` seconds to a true set-point (None: motors off); return the events that arrived, in order."""
        self._asked_ns += round(dt * 1e9)
        while (self._steps + 1) / self._imu_errors.rate_hz <= self._asked_ns * 1e-9 + 1e-9:
            self._advance(wanted)
        return self._sensors.arrived(self.time_ns)

    def _advance(self, wanted: Wanted | None) -> None:
        """Advance by one sample of the IMU."""
        vehicle, h = self._vehicle, 1.0 / self._imu_errors.rate_hz
        start = self._steps * h - LEAD
        self._steps += 1
        self._below.seconds = start
        place = vehicle.world_from_body
        before = TrueMotion(place.translation, vehicle.velocity.copy(), place.rotation, np.zeros(3))
        up = float(vehicle.position[2])
        flown = wanted if self.battery > 0 else None
        vehicle.push_world = self._blown(start, h)
        vehicle.step(h, flown)
        self._settled += max(1.0 - math.exp(-h / _SETTLE), 1.0 / self._steps) * (self._nav.offset - self._settled)
        stood, self._stood = self._stood, vehicle.stands  # of the last step: a body that drives in below it counts, too
        if self._stood and not stood:
            self.contacts.append(
                TrueContact(
                    START_NS + round((start + h) * 1e9), vehicle.world_from_body, before.velocity_world, self.standing
                )
            )
        if self._radius > 0.0 and self._steps % STRIKE_STEPS == 0:
            self._look_beside(start + h)
        self._spend(flown is not None and not vehicle.stands, h, float(vehicle.position[2]) - up)
        motion = self._track.add(start, h, before, vehicle.position.copy(), vehicle.world_from_body.rotation)
        self._sensors.measure(start, h, motion, vehicle.velocity)

    def _look_beside(self, seconds: float) -> None:
        """Record a strike in flight; on the last metre the touchdown is judged instead."""
        gap = self.gap if self.height_above_ground > LAST else math.inf
        if gap < 0.0 and not self._strikes:
            t_ns, pose = START_NS + round(seconds * 1e9), self._vehicle.world_from_body
            self.contacts.append(TrueContact(t_ns, pose, self.true_velocity, self.standing, -gap))
        self._strikes = gap < 0.0

    def _blown(self, now: float, h: float) -> F64:
        """(3,) m/s^2: wind and gusts on command, less the part that the autopilot has learned."""
        learned = 1.0 - math.exp(-h / _TRIM)
        self._trimmed = self._trimmed + learned * (self._air - self._trimmed)
        gusts: F64 = sum((a for start, end, a in self._pushes if start <= now < end), np.zeros(3))
        self._leant = self._leant + learned * (gusts - self._leant)
        return np.asarray(self._vehicle.limits.drag * (self._air - self._trimmed) + gusts - self._leant)

    def _spend(self, flying: bool, h: float, risen: float) -> None:
        cost = (h / self._cost.endurance + max(risen, 0.0) * self._cost.climb) if flying else 0.0
        self.battery = max(0.0, self.battery - cost)

    # -- disturbances and faults on command, from now on

    def park(self, east: float, north: float, *, start: tuple[float, float] | None = None, speed: float = 5.0,
             heading: float = 0.0) -> Body:  # fmt: skip
        """Let a car drive in from `start` (None: it stands there at once, its length at `heading` rad from east)."""
        return self._come(True, east, north, start, speed, heading)

    def walk_in(
        self, east: float, north: float, *, start: tuple[float, float] | None = None, speed: float = 1.4
    ) -> Body:
        """Let a person walk to a spot from `start` (None: from 10 m south of it) and stay."""
        return self._come(False, east, north, start or (east, north - 10.0), speed, 0.0)

    def _come(
        self, car: bool, east: float, north: float, start: tuple[float, float] | None, speed: float, heading: float
    ) -> Body:
        goal = (float(east), float(north))
        body = Body(car, start or goal, goal, self.seconds, speed, heading, self.world.height_at)
        self.bodies.append(body)
        return body

    def gust(self, acceleration: Sequence[float], seconds: float) -> None:
        """Push the vehicle with (3,) m/s^2, world, for `seconds`."""
        self._pushes.append((self.seconds, self.seconds + seconds, np.array(acceleration, float)))

    def wind(self, east: float, north: float, up: float = 0.0) -> None:
        """Set the velocity of the air, m/s."""
        self._air = self._vehicle.wind_world = np.array([east, north, up], float)

    def freeze_camera(self, seconds: float, camera: int | None = None) -> None:
        """Send the last picture again, with new stamps. `camera`: its number; None: all of them."""
        self._camera_fault("freeze", seconds, camera)

    def lose_camera(self, seconds: float, camera: int | None = None) -> None:
        """Lose all pictures for `seconds`. `camera`: its number; None: all of them."""
        self._camera_fault("lose", seconds, camera)

    def cover_camera(self, seconds: float, share: float = 0.98, camera: int | None = None) -> None:
        """Keep a share of the light out for `seconds`. `camera`: its number; None: all of them."""
        self._camera_fault("cover", seconds, camera, share)

    def delay_frames(self, seconds: float, by: float) -> None:
        """Let the exposures of the next `seconds` arrive `by` seconds late, rightly stamped."""
        self._camera_fault("late", seconds, None, by)

    def _camera_fault(self, what: str, seconds: float, camera: int | None, amount: float = 0.0) -> None:
        self._cameras.commanded.append(CameraFault(what, self.seconds, self.seconds + seconds, camera, amount))

    def lose_gps(self, seconds: float, what: Literal["position", "rows"] = "position") -> None:
        """Lose positions or whole rows for `seconds`; the autopilot's own error goes on as before."""
        self._change_nav(outages=(*self._nav.errors.outages, Outage(at=self.seconds, seconds=seconds, what=what)))

    def jump_gps(self, offset: Sequence[float], seconds: float | None = None) -> None:
        """Shift all positions by (3,) metres, unclaimed, for a time (None: for good)."""
        east, north, up = (float(v) for v in offset)
        jump = Jump(at=self.seconds, seconds=seconds, offset=(east, north, up))
        self._change_nav(jumps=(*self._nav.errors.jumps, jump))

    def _change_nav(self, **what: Any) -> None:
        self._nav.errors = self._nav.errors.model_copy(update=what)

    def lose_imu(self, seconds: float) -> None:
        """Lose the samples of the IMU for `seconds`."""
        self._sensors.imu_lost.append((self.seconds, self.seconds + seconds))

    def drain(self, share: float) -> None:
        """Take a share of the charge that is left away."""
        self.battery *= 1.0 - share


def sized_rig(rig: Rig, size: tuple[int, int], stereo: bool) -> Rig:
    """The rig with pictures of another size, all of its cameras or the first alone."""
    cams = []
    for cam in rig.cameras if stereo else rig.cameras[:1]:
        lens = cam.camera.scaled(size[0] / cam.camera.width)
        if (lens.width, lens.height) != tuple(size):
            raise InputError(
                f"size {size[0]} x {size[1]}: the rig's pictures are {cam.camera.width} x {cam.camera.height}; "
                f"keep that shape, as with {lens.width} x {lens.height}"
            )
        cams.append(replace(cam, camera=lens))
    return Rig(tuple(cams))
