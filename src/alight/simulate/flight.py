"""A simulated flight: a source of events like any other, plus the truth."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from alight.geometry import LocalFrame, Pose
from alight.records import F64, U8, Event, Frame, InputError, Rig
from alight.simulate.cameras import Eye, Imaging, default_rig
from alight.simulate.scenes import build
from alight.simulate.sensors import ImuErrors, NavErrors, imu_biases, imu_samples, nav_samples
from alight.simulate.truth import Truth
from alight.simulate.vehicle import Limits, Trajectory, fly_through
from alight.simulate.world import World

START_NS = 1_700_000_000_000_000_000
LEAD = 0.5  # s that the inertial sensors run before the first frame and after the last
NAV_OFFSET_NS = 13_000_000  # the navigation solution keeps its own time
CLEAR = 2.0  # metres that the cameras must have above the ground
# one random stream for each source of randomness; a new one goes at the end
WIND, NAV, IMU_BIAS, IMU_NOISE, IMAGE = range(5)

Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SimulatedFlight:
    """A flight over a world. Use it where a recording goes; every call of `events` gives the same events."""

    world: World
    trajectory: Trajectory
    seed: int
    rig: Rig
    rate_hz: float
    seconds: float  # from the first frame to the last
    imaging: Imaging
    nav: NavErrors
    imu: ImuErrors
    georeferenced: bool = True
    warnings: list[str] = field(default_factory=list)
    kind: Literal["flight"] = "flight"

    @property
    def name(self) -> str:
        """The scene and the seed."""
        return f"{self.world.name}-{self.seed}"

    @property
    def local(self) -> LocalFrame:
        """Where the world lies."""
        return self.world.local

    @property
    def length(self) -> int:
        """Exposures."""
        return len(self.frame_times)

    @property
    def counts(self) -> dict[str, int]:
        """Nothing is lost."""
        return {"exposures": self.length}

    @property
    def notes(self) -> dict[str, Any]:
        """Facts for the report."""
        lens = self.rig.cameras[0].camera
        return {
            "cameras": [c.name for c in self.rig.cameras],
            "image_size": [lens.width, lens.height],
            "focal_px": [lens.fu, lens.fv],
            "focal_from": "simulated",
            "nav": True,
            "imu": True,
            "scene": self.world.description,
        }

    @cached_property
    def truth(self) -> Truth:
        """The ground as it is."""
        return Truth(self.world.grid, self.world.height, self.world.label)

    @cached_property
    def frame_times(self) -> Times:
        """(N,) ns of the exposures."""
        return START_NS + np.round(np.arange(int(self.seconds * self.rate_hz + 1e-9) + 1) * 1e9 / self.rate_hz).astype(
            np.int64
        )

    @cached_property
    def imu_times(self) -> Times:
        """(N,) ns."""
        return self._clock(self.imu.rate_hz, 0)

    @cached_property
    def nav_times(self) -> Times:
        """(N,) ns."""
        return self._clock(self.nav.rate_hz, NAV_OFFSET_NS)

    @cached_property
    def truth_trajectory(self) -> tuple[Times, list[Pose]]:
        """True body poses at the times of all inertial samples and exposures."""
        t = np.union1d(self.imu_times, self.frame_times)
        return t, [self.pose(int(k)) for k in t]

    def pose(self, t_ns: int) -> Pose:
        """True `world_from_body`."""
        return self.trajectory.pose((t_ns - START_NS) * 1e-9)

    @cached_property
    def biases(self) -> tuple[F64, F64]:
        """True (N, 3) gyroscope and accelerometer biases at `imu_times`."""
        return imu_biases(len(self.imu_times), self.imu, self.seeds(IMU_BIAS))

    def events(self) -> Iterator[Event]:
        """Yield frames, navigation and inertial samples in order of time; pictures are drawn as they are asked for."""
        nav = nav_samples(self.trajectory, self.nav_times, self._since(self.nav_times), self.nav, self.seeds(NAV))
        seconds = self._since(self.imu_times)
        imu = imu_samples(self.trajectory, self.imu_times, seconds, self.biases, self.imu, self.seeds(IMU_NOISE))
        streams: list[Iterator[Event]] = [nav, imu, self._frames()]
        return heapq.merge(*streams, key=lambda event: event.t_ns)

    def image(self, index: int, cam: int) -> U8:
        """Draw one picture, (H, W, 3) RGB; any order gives the same."""
        t_ns = int(self.frame_times[index])
        world_from_cam = self.pose(t_ns) @ self.rig.cameras[cam].body_from_cam
        eye = self.eyes[cam]
        light = eye.radiance(self.world, world_from_cam, (t_ns - START_NS) * 1e-9)
        return eye.expose(light, np.random.default_rng(self.seeds(IMAGE, index, cam)))

    @cached_property
    def eyes(self) -> tuple[Eye, ...]:
        """The cameras, their rays undistorted."""
        return tuple(Eye(c.camera, self.imaging) for c in self.rig.cameras)

    def seeds(self, *key: int) -> np.random.SeedSequence:
        """The random stream of one source of randomness."""
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def _frames(self) -> Iterator[Event]:
        for k, t in enumerate(self.frame_times):
            yield Frame(int(t), tuple(self.image(k, cam) for cam in range(len(self.rig.cameras))), str(t))

    def _clock(self, rate_hz: float, offset_ns: int) -> Times:
        n = math.floor((self.seconds + 2 * LEAD) * rate_hz) + 1
        return START_NS - int(LEAD * 1e9) + offset_ns + np.round(np.arange(n) * 1e9 / rate_hz).astype(np.int64)

    @staticmethod
    def _since(t_ns: Times) -> F64:
        return (t_ns - START_NS).astype(np.float64) * 1e-9


def fly(
    scene: str | World = "demo",
    seed: int = 0,
    duration: float = 6.0,
    *,
    height: float = 27.0,
    speed: float = 5.0,
    rate_hz: float = 8.0,
    waypoints: Sequence[Sequence[float]] | None = None,
    rig: Rig | None = None,
    imaging: Imaging | None = None,
    nav: NavErrors | None = None,
    imu: ImuErrors | None = None,
    limits: Limits | None = None,
) -> SimulatedFlight:
    """Fly over a scene; nothing is drawn before `events` is read.

    Without `waypoints` (east, north, up above the world's origin, metres): a straight transect of `duration` seconds
    at `speed` through the middle, `height` metres above the mean ground. With them, start and end are at rest and the
    flight lasts as long as it takes. The same arguments give the same events, bit for bit.

    Raises:
        InputError: no such scene, or the flight leaves the world or comes within 2 m of its ground.
    """
    world = build(scene, seed) if isinstance(scene, str) else scene
    bounds = limits or Limits(speed=speed)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(WIND,)))
    transect = waypoints is None
    points = _transect(world, duration * speed, height) if waypoints is None else waypoints
    try:
        trajectory = fly_through(points, bounds, rng, rolling=transect)
    except ValueError as e:
        raise InputError(str(e)) from e
    seconds = duration if transect else trajectory.duration
    _check(world, trajectory, seconds)
    return SimulatedFlight(
        world, trajectory, seed, rig or default_rig(), rate_hz, seconds,
        imaging or Imaging(), nav or NavErrors(), imu or ImuErrors(),
    )  # fmt: skip


def _transect(world: World, length: float, height: float) -> list[list[float]]:
    """West to east through the middle, a little askew, so that nothing lines up with the cells."""
    up = float(world.height.mean()) + height
    half = 0.5 * length
    return [[-half, -0.1 * half, up], [half, 0.1 * half, up]]


def _check(world: World, trajectory: Trajectory, seconds: float) -> None:
    for t in np.arange(-LEAD, seconds + LEAD, 0.1):
        east, north, up = (float(v) for v in trajectory.position(t))
        ground = world.height_at(east, north)
        if math.isnan(ground):
            raise InputError(f"the flight leaves the world at east {east:.0f} m, north {north:.0f} m; make it shorter")
        if up < ground + CLEAR:
            raise InputError(
                f"the flight comes within {CLEAR:g} m of the ground at east {east:.0f}, north {north:.0f}; fly higher"
            )
