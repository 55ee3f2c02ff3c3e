"""A simulated flight: a source of events like a recording, with the truth."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import ValidationError

from alight.arrays import F64, I64, U8
from alight.geometry import LocalFrame, Pose
from alight.records import NO_ZONES, Event, Frame, ImuSample, InputError, NavSample, Rig, ZonesOnPlane
from alight.settings import ImuNoise
from alight_sim.cameras import Eye, Shutter
from alight_sim.course import LEAD, Extent, chart
from alight_sim.exposure import Imaging, Sensor, gains
from alight_sim.faults import Exposures, Faults, exposures
from alight_sim.patterns import FlightPlan
from alight_sim.rigs import RigModel
from alight_sim.scene import Scene, explain
from alight_sim.scene_world import SceneWorld, build
from alight_sim.section import Section
from alight_sim.sensors import ImuErrors, NavErrors, imu_biases, simulated_imu, simulated_nav
from alight_sim.truth import SceneTruth
from alight_sim.vehicle import Limits, TrueTrajectory
from alight_sim.world import Poses, World

START_NS = 1_700_000_000_000_000_000
NAV_OFFSET_NS = 13_000_000  # offset of the GPS/INS rows, which do not coincide with exposures
METER = 16  # width in pixels of the picture that exposure control meters
S = TypeVar("S", bound=Section)


class Stream(IntEnum):
    """Random stream of each source of randomness; append new ones."""

    WIND = 0
    NAV = 1
    IMU_BIAS = 2
    IMU_NOISE = 3
    IMAGE = 4
    FAULTS = 5
    GAIN = 6
    FLAWS = 7


@dataclass(frozen=True, eq=False)
class SimulatedFlight:
    """A flight over a world, used like a recording; every call of `events` gives the same events."""

    world: SceneWorld
    trajectory: TrueTrajectory
    seed: int
    true_rig: Rig  # the rig that draws the pictures
    scene: Scene  # the scene as flown: the world's, with the arguments of `fly`
    repeatable: bool = True  # the scene and the seed alone reproduce this flight
    georeferenced: bool = True
    warnings: list[str] = field(default_factory=list)
    kind: Literal["flight"] = "flight"

    @property
    def name(self) -> str:
        """Name of the scene, and seed of the flight."""
        return f"{self.world.name}-{self.seed}"

    @property
    def local(self) -> LocalFrame:
        """Local frame of the world, with its origin on Earth."""
        return self.world.local

    @cached_property
    def rig(self) -> Rig:
        """The rig as the calibration claims it."""
        return self.faults.claimed(self.true_rig)

    @property
    def plan(self) -> FlightPlan:
        """The plan of the flight."""
        return self.scene.flight

    @property
    def imaging(self) -> Imaging:
        """Settings of lens and sensor."""
        return self.scene.imaging

    @property
    def faults(self) -> Faults:
        """Faults between the shutter and the log."""
        return self.scene.faults

    @property
    def seconds(self) -> float:
        """Duration of the trajectory from the first exposure, seconds."""
        return self.trajectory.duration

    @property
    def rate_hz(self) -> float:
        """Exposures per second."""
        return self.imaging.rate_hz

    @property
    def nav(self) -> NavErrors:
        """The errors of GPS/INS."""
        return self.scene.sensors.nav

    @property
    def imu(self) -> ImuErrors:
        """The errors of the IMU."""
        return self.scene.sensors.imu

    @property
    def length(self) -> int:
        """Number of exposures with a picture of at least one camera."""
        return len(self.exposures.order)

    @property
    def counts(self) -> dict[str, int]:
        """Number of exposures that arrive, and of lost images by camera if there are any."""
        lost = {
            f"{cam.name} images lost": int((~self.exposures.seen[:, k]).sum())
            for k, cam in enumerate(self.true_rig.cameras)
        }
        return {"exposures": self.length, **{k: n for k, n in lost.items() if n}}

    @property
    def notes(self) -> dict[str, Any]:
        """Facts for the report."""
        return flight_notes(self.rig, self.world, self.imu)

    @property
    def imu_noise(self) -> ImuNoise:
        """Noise densities of the IMU as its maker states them."""
        return ImuNoise(**self.imu.densities)

    @property
    def schedule(self) -> None:
        """None, because the flight was not flown live."""

    @property
    def photos(self) -> tuple[()]:
        """Empty: a flight has no photos."""
        return ()

    @property
    def flown_with(self) -> None:
        """None, because the flight was not flown live."""

    @property
    def zones(self) -> ZonesOnPlane:
        """None, because the flight was not flown live."""
        return NO_ZONES

    # -- time

    @cached_property
    def exposures(self) -> Exposures:
        """True times, stamps and arrivals of the exposures, and the lost pictures."""
        beats = np.arange(int(self.seconds * self.rate_hz + 1e-9) + 1)
        beat_ns = START_NS + np.round(beats * 1e9 / self.rate_hz).astype(np.int64)
        return exposures(self.faults, beat_ns, len(self.true_rig.cameras), self.seeds(Stream.FAULTS))

    @property
    def frame_times(self) -> I64:
        """(N,) ns, true times of all exposures, including the lost ones."""
        return self.exposures.true_ns

    @cached_property
    def imu_times(self) -> I64:
        """(N,) ns, times of the inertial samples."""
        return self._clock(self.imu.rate_hz, 0)

    @cached_property
    def nav_times(self) -> I64:
        """(N,) ns, times of the GPS/INS rows."""
        return self._clock(self.nav.rate_hz, NAV_OFFSET_NS)

    def _clock(self, rate_hz: float, offset_ns: int) -> I64:
        n = math.floor((self.seconds + 2 * LEAD) * rate_hz) + 1
        return START_NS - int(LEAD * 1e9) + offset_ns + np.round(np.arange(n) * 1e9 / rate_hz).astype(np.int64)

    @staticmethod
    def since(t_ns: I64) -> F64:
        """Convert times (N,) ns to seconds of the trajectory."""
        return np.asarray((t_ns - START_NS).astype(np.float64) * 1e-9)

    # -- truth

    @cached_property
    def seen(self) -> Extent:
        """West, south, east, north (m) of a box in the world that contains all ground seen by the cameras."""
        return seen_box(self)

    @cached_property
    def truth(self) -> SceneTruth:
        """True ground within the box `seen`."""
        return self.world.truth(self.seen)

    @cached_property
    def truth_trajectory(self) -> tuple[I64, list[Pose]]:
        """Times (ns) of all inertial samples and exposures, and the true body poses at these times."""
        t = np.union1d(self.imu_times, self.frame_times)
        s = self.since(t)
        return t, [
            Pose(R, p) for R, p in zip(self.trajectory.rotations(s), self.trajectory.place_world(s), strict=True)
        ]

    def pose(self, t_ns: int) -> Pose:
        """Return the true `world_from_body` at a time."""
        return self.trajectory.pose((t_ns - START_NS) * 1e-9)

    def camera_at(self, cam: int) -> Poses:
        """Return the true poses of camera `cam` as a function of times (N,), seconds of the trajectory."""
        body_from_cam = self.true_rig.cameras[cam].body_from_cam

        def poses(seconds: F64) -> tuple[F64, F64]:
            turns, places = self.trajectory.rotations(seconds), self.trajectory.place_world(seconds)
            return turns @ body_from_cam.rotation, places + turns @ body_from_cam.translation

        return poses

    @cached_property
    def biases(self) -> tuple[F64, F64]:
        """True gyroscope biases, rad/s, and accelerometer biases, m/s^2, at `imu_times`, both (N, 3)."""
        return imu_biases(len(self.imu_times), self.imu, self.seeds(Stream.IMU_BIAS))

    # -- events

    def events(self) -> Iterator[Event]:
        """Yield navigation and inertial samples and frames in order of arrival; pictures are drawn on demand.

        Frames carry the time that the cameras claim. Only late frames are out of the order of stamps.
        """
        path, seeds = self.trajectory, self.seeds
        nav = simulated_nav(path, self.nav_times, self.since(self.nav_times), self.nav, seeds(Stream.NAV))
        seconds = self.since(self.imu_times)
        imu = simulated_imu(path, self.imu_times, seconds, self.biases, self.imu, seeds(Stream.IMU_NOISE))
        streams: list[Iterator[tuple[int, NavSample | ImuSample | int]]] = [
            ((e.t_ns, e) for e in nav), ((e.t_ns, e) for e in imu),
            ((int(self.exposures.arrival_ns[k]), int(k)) for k in self.exposures.order),
        ]  # fmt: skip
        for _, event in heapq.merge(*streams, key=lambda pair: pair[0]):
            yield self._frame(event) if isinstance(event, int) else event

    def _frame(self, k: int) -> Frame:
        x = self.exposures
        images = tuple(self.image(k, cam) if seen else None for cam, seen in enumerate(x.seen[k]))
        return Frame(int(x.stamp_ns[k]), images, str(x.true_ns[k]))

    def image(self, index: int, cam: int) -> U8:
        """Draw the picture (H, W, 3), RGB, of exposure `index` and camera `cam`, even if it was lost."""
        seconds = float(self.since(self.frame_times[index : index + 1])[0])
        light = self.eyes[cam].radiance(self.world, self.camera_at(cam), seconds, Shutter.of(self.imaging))
        key = int(self.seeds(Stream.IMAGE, index, cam).generate_state(1, np.uint64)[0])
        return self._glass[cam].expose(light, self._gains[cam][index], key, self.faults.cover(seconds, cam))

    @cached_property
    def eyes(self) -> tuple[Eye, ...]:
        """The cameras with their undistorted rays."""
        return tuple(Eye(c.camera, self.imaging.samples) for c in self.true_rig.cameras)

    @cached_property
    def _glass(self) -> tuple[Sensor, ...]:
        return tuple(
            Sensor.of(c.camera, self.imaging, self.seeds(Stream.FLAWS, k)) for k, c in enumerate(self.true_rig.cameras)
        )

    @cached_property
    def _gains(self) -> list[F64]:
        seconds = self.since(self.frame_times)
        cams = range(len(self.true_rig.cameras))
        return [gains(self.imaging, seconds, self.seeds(Stream.GAIN, cam), self._metered(cam, seconds)) for cam in cams]

    def _metered(self, cam: int, seconds: F64) -> F64 | None:
        """Return the (N,) mean light of a camera at times (N,), from tiny pictures; None: exposure control is off."""
        if not self.imaging.auto:
            return None
        lens, at = self.true_rig.cameras[cam].camera, self.camera_at(cam)
        eye = Eye(lens.scaled(METER / lens.width))
        return np.array([float(eye.radiance(self.world, at, float(s)).mean()) for s in seconds])

    def seeds(self, *key: int) -> np.random.SeedSequence:
        """Return the seeds of one random source; `key`: its `Stream` and, for example, the index of the camera."""
        return np.random.SeedSequence(self.seed, spawn_key=key)


def flight_notes(rig: Rig, world: World, imu: ImuErrors) -> dict[str, Any]:
    """Return facts about a simulated flight with a rig, a world and an IMU, as notes for the report."""
    lens = rig.cameras[0].camera
    return {
        "cameras": [c.name for c in rig.cameras],
        "image_size": [lens.width, lens.height],
        "focal_px": [lens.fu, lens.fv],
        "focal_from": "simulated",
        "nav": True,
        "imu": True,
        "scene": world.description,
        "imu_noise": imu.densities,
    }


def seen_box(flight: SimulatedFlight) -> Extent:
    """Return west, south, east, north (m) of the box in the world that contains the ground seen by the cameras."""
    world = flight.world
    west, south, east, north = world.extent
    low, s = world.low, flight.since(flight.frame_times)
    turns, places = flight.trajectory.rotations(s), flight.trajectory.place_world(s)
    hits = []
    for cam in flight.true_rig.cameras:
        lens = cam.camera
        u, v = np.linspace(-0.5, lens.width - 0.5, 17), np.linspace(-0.5, lens.height - 0.5, 13)
        sides = [np.stack(np.broadcast_arrays(u, k), -1) for k in v[[0, -1]]]
        sides += [np.stack(np.broadcast_arrays(k, v), -1) for k in u[[0, -1]]]
        rays = lens.rays(np.concatenate(sides)) @ (turns @ cam.body_from_cam.rotation).swapaxes(1, 2)
        centres = (places + turns @ cam.body_from_cam.translation)[:, None]
        down = np.maximum(-rays[..., 2:], 1e-6)  # a ray that points up ends far away
        hits.append((centres + rays * (centres[..., 2:] - low) / down)[..., :2].reshape(-1, 2))
    least, most = np.concatenate(hits).min(axis=0), np.concatenate(hits).max(axis=0)
    return (
        float(np.clip(least[0], west, east)), float(np.clip(least[1], south, north)),
        float(np.clip(most[0], west, east)), float(np.clip(most[1], south, north)),
    )  # fmt: skip


def fly(
    scene: str | Path | Scene | SceneWorld = "demo",
    seed: int = 0,
    duration: float | None = None,
    *,
    height: float | None = None,
    speed: float | None = None,
    rate_hz: float | None = None,
    waypoints: Sequence[Sequence[float]] | None = None,
    limits: Limits | None = None,
    plan: FlightPlan | None = None,
    rig: Rig | None = None,
    imaging: Imaging | None = None,
    nav: NavErrors | None = None,
    imu: ImuErrors | None = None,
    faults: Faults | None = None,
) -> SimulatedFlight:
    """Fly over a scene with its own settings and the given arguments; pictures are drawn when `events` is read.

    The same arguments give the same events, bit for bit.

    Args:
        waypoints: (east, north, height) in metres, with heights relative to the same zero as the plan's.

    Raises:
        InputError: the scene does not exist, or the flight cannot be flown: see `alight_sim.course.chart`.
    """
    world = scene if isinstance(scene, SceneWorld) else build(scene, seed)
    s = world.scene or Scene()
    wishes = {"duration": duration, "height": height, "speed": speed, "waypoints": waypoints, "limits": limits}
    used = s.model_copy(
        update={
            "flight": _with(plan or s.flight, wishes),
            "imaging": _with(imaging or s.imaging, {"rate_hz": rate_hz}),
            "sensors": _with(s.sensors, {"nav": nav, "imu": imu}),
            "faults": faults or s.faults,
            "rig": RigModel.of(rig) if rig else s.rig,
        }
    )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(Stream.WIND,)))
    again = world.scene is not None and world.seed == seed
    trajectory = chart(world, used.flight, rng)
    return SimulatedFlight(world, trajectory, seed, used.rig.rig, used, again, warnings=list(world.warnings))


def _with(section: S, wishes: dict[str, Any]) -> S:
    try:
        return type(section).model_validate(dict(section) | {k: v for k, v in wishes.items() if v is not None})
    except ValidationError as e:
        raise InputError(explain(e)) from e
