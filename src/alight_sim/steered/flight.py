"""A flight that is steered step by step: set-points in, events out, over the same worlds and with the same errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import LocalFrame, Pose, so3_exp
from alight.records import Event, InputError, Rig
from alight.settings import ImuNoise
from alight_sim.autopilot.estimate import NavigationError
from alight_sim.course import LEAD, ground_at
from alight_sim.faults import Faults
from alight_sim.flight import START_NS, Stream, flight_notes
from alight_sim.point_mass import FlightLimits, PointMass, Wanted
from alight_sim.scene import Scene
from alight_sim.scene_world import build
from alight_sim.sensors import BiasWalk, ImuErrors, ImuStream, Jump, NavErrors, NavStream, Outage, TrueMotion
from alight_sim.steered.bodies import Body
from alight_sim.steered.cameras import CameraFault, SteeredCameras
from alight_sim.steered.ground import ContactWatch, GroundBelow, TrueContact
from alight_sim.steered.sensing import SteeredSensors
from alight_sim.world import World

NIMBLE = FlightLimits(lag=0.08)
IMU_RATE_HZ = 100.0  # of a flight without an IMU of its own; the vehicle moves in steps of the IMU
_TRIM = 1.5  # s, time constant with which the autopilot learns a new wind or a lasting gust
_SETTLE = 1.0  # s over which the autopilot smooths its navigation solution


@dataclass(frozen=True)
class TrueBattery:
    """Charge of the battery, and consumption in flight."""

    share: float = 1.0  # left at the start
    endurance: float = 1200.0  # s of hovering with a full battery
    climb: float = 1.5e-4  # additional share per metre of climb


@dataclass
class MovingAir:
    """Wind and gusts on command, and the part of them that the autopilot has learned."""

    velocity: F64  # (3,) m/s
    learned: F64  # (3,) m/s, learned part of the velocity
    pushes: list[tuple[float, float, F64]] = field(default_factory=list)  # s from and to, m/s^2
    leant: F64 = field(default_factory=lambda: np.zeros(3))  # m/s^2, learned part of the pushes

    def push(self, now: float, h: float, drag: float) -> F64:
        """Return the acceleration by wind and gusts less the learned part, (3,) m/s^2; learn for `h` s from `now`.

        `drag`: 1/s, deceleration per m/s of air speed.
        """
        share = 1.0 - math.exp(-h / _TRIM)
        self.learned = self.learned + share * (self.velocity - self.learned)
        gusts: F64 = sum((a for start, end, a in self.pushes if start <= now < end), np.zeros(3))
        self.leant = self.leant + share * (gusts - self.leant)
        return np.asarray(drag * (self.velocity - self.learned) + gusts - self.leant)


class SteeredFlight:
    """A flight that follows set-points and yields events; also the vehicle of a simulated autopilot (`TrueVehicle`).

    The same seed and calls give the same bits.

    Args:
        scene: a built-in scene's name, a scene file, a scene, or a world.
        size: width and height of the pictures, pixels; the world's rig is scaled to it.
        stereo: whether all cameras of the rig are used, or only the first.
        start: east and north (m), and metres above the ground there.
        limits: limits of the vehicle; None: `NIMBLE`.
        wind: (3,) m/s, east, north, up: velocity of the air.
        gusts: m/s^2, standard deviation of the acceleration by gusts.
        battery: charge and consumption; None: `TrueBattery()`.
        faults, nav, imu: replace the world's own; None: the world's, with an IMU rate of `IMU_RATE_HZ`.
        standing: height of the body's origin above the plane of the feet, metres.
        radius: metres around the vehicle within which it strikes objects higher than its feet; 0: it strikes none.

    Raises:
        InputError: the scene does not exist, or `size` has another aspect ratio than the rig's pictures.
    """

    kind: Literal["flight"] = "flight"
    georeferenced = True

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
        self.bodies: list[Body] = []  # that appeared on command
        self.seed, self.rate_hz, self.standing = seed, rate_hz, standing
        self.warnings = list(self.world.warnings)
        faults = faults or self.world.faults
        self.true_rig = sized_rig(self.world.rig, size, stereo)
        self.rig = faults.claimed(self.true_rig)
        self.cameras = SteeredCameras(self.world, self.true_rig, faults, rate_hz, self._seeds, self.bodies)
        self._imu_errors = imu or self.world.sensors.imu.model_copy(update={"rate_hz": IMU_RATE_HZ})
        imu_stream = ImuStream(self._imu_errors, self._seeds(Stream.IMU_NOISE))
        biases = BiasWalk(self._imu_errors, self._seeds(Stream.IMU_BIAS))
        nav_stream = NavStream(nav or self.world.sensors.nav, self._seeds(Stream.NAV))
        self.sensors = SteeredSensors(imu_stream, biases, nav_stream, self.cameras)
        self._cost = battery or TrueBattery()
        self.battery = self._cost.share
        self.air = MovingAir(np.array(wind, float), np.array(wind, float))
        below = GroundBelow(self.world, self.bodies, radius)
        east, north, up = (float(v) for v in start)
        place = np.array([east, north, ground_at(self.world, np.array(start, float)) + up + standing])
        self._vehicle = PointMass(
            limits or NIMBLE, lambda east, north: below.height(east, north) + standing, self.air.velocity, gusts,
            seed=int(self._seeds(Stream.WIND).generate_state(1)[0]), position=place, heading=heading,
        )  # fmt: skip
        self._contacts = ContactWatch(below, standing, self._vehicle)
        self._steps, self._elapsed_ns = 0, 0
        self._settled = np.zeros(3)  # metres: error of the navigation solution, smoothed

    def _seeds(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=key)

    # -- description of a source

    @property
    def name(self) -> str:
        """Name of the scene and seed of the flight."""
        return f"{self.world.name}-{self.seed}"

    @property
    def local(self) -> LocalFrame:
        """Local frame of the world, with its origin on Earth."""
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
        """Number of exposures so far, including the lost ones."""
        return {"exposures": self.cameras.next}

    # -- truth

    @property
    def seconds(self) -> float:
        """Time since the first exposure, s; the flight begins LEAD before it."""
        return self._elapsed_ns * 1e-9 - LEAD

    @property
    def time_ns(self) -> int:
        """Time of the events' clock, ns."""
        return START_NS - round(LEAD * 1e9) + self._elapsed_ns

    @property
    def true_pose(self) -> Pose:
        """True `world_from_body`, at most one IMU sample old."""
        return self._vehicle.world_from_body

    @property
    def body(self) -> PointMass:
        """The true vehicle; do not change it."""
        return self._vehicle

    @property
    def height_above_ground(self) -> float:
        """Height of the plane of the feet above the surface below, metres."""
        return self._contacts.height

    @property
    def gap(self) -> float:
        """Height of the feet's plane above the highest ground or object within the radius, metres."""
        return self._contacts.gap

    @property
    def wind_world(self) -> F64:
        """(3,) m/s, velocity of the air as estimated by the autopilot."""
        return self.air.learned.copy()

    @property
    def wind_speed(self) -> float:
        """Horizontal speed of `wind_world`, m/s."""
        return math.hypot(self.air.learned[0], self.air.learned[1])

    @property
    def imu(self) -> tuple[F64, F64] | None:
        """Measured angular rate (3,) rad/s and specific force (3,) m/s^2 in the body; None: no sample for 30 ms."""
        sample = self.sensors.newest_imu
        if sample is None or self.time_ns - sample.t_ns > 30_000_000:
            return None
        return sample.angular_velocity_body, sample.specific_force_body

    @property
    def landed(self) -> bool:
        """Whether the vehicle stands on something."""
        return self._vehicle.stands

    @property
    def navigation(self) -> NavigationError:
        """Present errors of the navigation solution; the position error is smoothed, as in an autopilot's estimate."""
        seconds = self._steps / self._imu_errors.rate_hz - LEAD
        nav = self.sensors.nav
        return NavigationError(
            self._settled, so3_exp(nav.attitude_error), nav.heading_error(seconds), nav.velocity_error,
            nav.sigma_position, max(seconds - nav.located_at, 0.0),
        )  # fmt: skip

    @property
    def contacts(self) -> list[TrueContact]:
        """Contacts with the ground and with objects so far."""
        return self._contacts.found

    @property
    def contact(self) -> TrueContact | None:
        """The last contact with the ground or an object; None: no contact so far."""
        return self.contacts[-1] if self.contacts else None

    def poses(self, t_ns: I64) -> list[Pose]:
        """Return the true `world_from_body` at times (N,) ns within the last three seconds."""
        turns, places = self.sensors.track.poses(1e-9 * np.asarray(t_ns - START_NS, np.float64))
        return [Pose(R, p) for R, p in zip(turns, places, strict=True)]

    # -- time

    def step(self, dt: float, wanted: Wanted | None) -> list[Event]:
        """Fly for `dt` s to a set-point in true coordinates (None: motors off); return the arrived events in order."""
        self._elapsed_ns += round(dt * 1e9)
        while (self._steps + 1) / self._imu_errors.rate_hz <= self._elapsed_ns * 1e-9 + 1e-9:
            self._advance(wanted)
        return self.sensors.arrived(self.time_ns)

    def _advance(self, wanted: Wanted | None) -> None:
        vehicle, h = self._vehicle, 1.0 / self._imu_errors.rate_hz
        start = self._steps * h - LEAD
        self._steps += 1
        self._contacts.below.seconds = start
        place = vehicle.world_from_body
        before = TrueMotion(place.translation, vehicle.velocity.copy(), place.rotation, np.zeros(3))
        up = float(vehicle.position[2])
        flown = wanted if self.battery > 0 else None
        vehicle.push_world = self.air.push(start, h, vehicle.limits.drag)
        vehicle.step(h, flown)
        self._settled += max(1.0 - math.exp(-h / _SETTLE), 1.0 / self._steps) * (
            self.sensors.nav.offset - self._settled
        )
        self._contacts.observe(START_NS + round((start + h) * 1e9), before.velocity_world)
        if flown is not None and not vehicle.stands:
            risen = max(float(vehicle.position[2]) - up, 0.0)
            spent = h / self._cost.endurance + risen * self._cost.climb
            self.battery = max(0.0, self.battery - spent)
        motion = self.sensors.track.add(start, h, before, vehicle.position.copy(), vehicle.world_from_body.rotation)
        self.sensors.measure(start, h, motion, vehicle.velocity)

    # -- disturbances and faults on command, from now on

    def park(self, east: float, north: float, *, start: tuple[float, float] | None = None, speed: float = 5.0,
             heading: float = 0.0) -> Body:  # fmt: skip
        """Let a car drive from `start` to a position and park; return the car.

        If `start` is None, the car is at its position at once, with `heading`, rad from east to north.
        """
        return self._come(True, east, north, start, speed, heading)

    def walk_in(
        self, east: float, north: float, *, start: tuple[float, float] | None = None, speed: float = 1.4
    ) -> Body:
        """Let a person walk from `start` (None: 10 m south) to a position and stay there; return the person."""
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
        self.air.pushes.append((self.seconds, self.seconds + seconds, np.array(acceleration, float)))

    def wind(self, east: float, north: float, up: float = 0.0) -> None:
        """Set the velocity of the air, m/s, from now on."""
        self.air.velocity = self._vehicle.wind_world = np.array([east, north, up], float)

    def freeze_camera(self, seconds: float, camera: int | None = None) -> None:
        """Repeat the last picture with new stamps for `seconds`, in one camera (by index) or in all (None)."""
        self._camera_fault("freeze", seconds, camera)

    def lose_camera(self, seconds: float, camera: int | None = None) -> None:
        """Lose all pictures for `seconds`, of one camera (by index) or of all (None)."""
        self._camera_fault("lose", seconds, camera)

    def cover_camera(self, seconds: float, share: float = 0.98, camera: int | None = None) -> None:
        """Keep a share of the light out for `seconds`, in one camera (by index) or in all (None)."""
        self._camera_fault("cover", seconds, camera, share)

    def delay_frames(self, seconds: float, by: float) -> None:
        """Let the exposures of the next `seconds` arrive late by `by` seconds; their stamps stay right."""
        self._camera_fault("late", seconds, None, by)

    def _camera_fault(self, what: str, seconds: float, camera: int | None, amount: float = 0.0) -> None:
        self.cameras.commanded.append(CameraFault(what, self.seconds, self.seconds + seconds, camera, amount))

    def lose_gps(self, seconds: float, what: Literal["position", "rows"] = "position") -> None:
        """Lose the positions or the whole rows of GPS/INS for `seconds`."""
        self._change_nav(
            outages=(*self.sensors.nav.errors.outages, Outage(at=self.seconds, seconds=seconds, what=what))
        )

    def jump_gps(self, offset: Sequence[float], seconds: float | None = None) -> None:
        """Shift all GPS positions by (3,) metres, with unchanged sigmas, for the next `seconds` (None: permanently)."""
        east, north, up = (float(v) for v in offset)
        jump = Jump(at=self.seconds, seconds=seconds, offset=(east, north, up))
        self._change_nav(jumps=(*self.sensors.nav.errors.jumps, jump))

    def lead_gps(self, speed: Sequence[float], seconds: float | None = None) -> None:
        """Lead all GPS positions away by (3,) m/s, velocities too, for the next `seconds` (None: to the end)."""
        east, north, up = (float(v) for v in speed)
        led = Jump(at=self.seconds, seconds=seconds, offset=(0.0, 0.0, 0.0), speed=(east, north, up))
        self._change_nav(jumps=(*self.sensors.nav.errors.jumps, led))

    def _change_nav(self, **what: Any) -> None:
        self.sensors.nav.errors = self.sensors.nav.errors.model_copy(update=what)

    def lose_imu(self, seconds: float) -> None:
        """Lose the samples of the IMU for `seconds`."""
        self.sensors.imu_lost.append((self.seconds, self.seconds + seconds))

    def drain(self, share: float) -> None:
        """Remove a share (0 to 1) of the battery's remaining charge."""
        self.battery *= 1.0 - share


class FlownEstimate:
    """Errors of a flight's navigation solution, as an `Estimate` for its autopilot."""

    def __init__(self, flight: SteeredFlight) -> None:
        self._flight = flight
        self.now = flight.navigation

    def step(self, dt: float) -> None:
        """Read the present errors of the flight's navigation; `dt` is not used, because the flight advances them."""
        self.now = self._flight.navigation


def sized_rig(rig: Rig, size: tuple[int, int], stereo: bool) -> Rig:
    """Return a rig scaled to pictures of `size` (width, height); `stereo`: keep all cameras, not only the first."""
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
