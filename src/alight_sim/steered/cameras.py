"""The cameras of a steered flight: exposures one after another, with faults on command."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from alight.arrays import F32, F64, U8
from alight.records import Frame, InputError, Rig
from alight_sim.exposure import ControlStep, Sensor, controlled, gains
from alight_sim.faults import Exposures, Faults, exposures
from alight_sim.flight import START_NS, Stream
from alight_sim.movers import Moving
from alight_sim.world import Poses, World

Seeds = Callable[..., np.random.SeedSequence]


@dataclass(frozen=True)
class CameraFault:
    """A commanded fault of the cameras, between two times of the flight (s)."""

    what: str  # freeze, lose, cover, late
    start: float
    end: float
    camera: int | None = None  # index of the camera; None: all cameras
    amount: float = 0.0  # share of the light kept out; seconds of delay

    def holds(self, seconds: float, camera: int | None = None) -> bool:
        """Whether the fault affects a camera at a time (s)."""
        return self.start <= seconds < self.end and (self.camera is None or camera == self.camera)


@dataclass
class SteeredCameras:
    """Cameras of a steered flight; they expose in order of time."""

    world: World
    true_rig: Rig
    faults: Faults
    rate_hz: float
    seeds: Seeds
    bodies: Sequence[Moving] = ()
    commanded: list[CameraFault] = field(default_factory=list)
    next: int = 0  # index of the next exposure

    def __post_init__(self) -> None:
        cams = self.true_rig.cameras
        self.imaging = self.world.imaging
        self._glass = [Sensor.of(c.camera, self.imaging, self.seeds(Stream.FLAWS, k)) for k, c in enumerate(cams)]
        self._last: list[U8 | None] = [None] * len(cams)
        self._controlled: list[tuple[ControlStep, float] | None] = [None] * len(cams)
        self._plan: Exposures | None = None
        self._gains: list[F64] = []

    def done_at(self) -> float:
        """Return the time of the flight (s) at which the last row of the next exposure has been read."""
        rows = max(c.camera.height for c in self.true_rig.cameras)
        return self._seconds(self.next) + 0.5 * (self.imaging.exposure_time + rows * self.imaging.line_time)

    def expose(self, body: Poses) -> tuple[int, Frame] | None:
        """Draw the next exposure; return its arrival (ns) and frame, or None if all its pictures are lost.

        `body`: returns the true poses `world_from_body` at times (s).
        """
        k, plan = self.next, self._planned(self.next)
        self.next += 1
        seconds = self._seconds(k)
        images = tuple(self._image(k, cam, seconds, body, bool(plan.seen[k, cam])) for cam in range(len(self._last)))
        late = max((f.amount for f in self.commanded if f.what == "late" and f.holds(seconds)), default=0.0)
        if all(image is None for image in images):
            return None
        frame = Frame(int(plan.stamp_ns[k]), images, str(plan.true_ns[k]))
        return int(plan.arrival_ns[k]) + round(late * 1e9), frame

    def _image(self, k: int, cam: int, seconds: float, body: Poses, seen: bool) -> U8 | None:
        now = [f for f in self.commanded if f.what != "late" and f.holds(seconds, cam)]
        if not seen or any(f.what == "lose" for f in now):
            return None
        if any(f.what == "freeze" for f in now) and self._last[cam] is not None:
            return self._last[cam]
        light = self._light(cam, seconds, body)
        kept_out = max([f.amount for f in now if f.what == "cover"], default=self.faults.cover(seconds, cam))
        key = int(self.seeds(Stream.IMAGE, k, cam).generate_state(1, np.uint64)[0])
        self._last[cam] = self._glass[cam].expose(light, self._gain(k, cam, seconds, light), key, kept_out)
        return self._last[cam]

    def _light(self, cam: int, seconds: float, body: Poses) -> F32:
        """Return the (H, W, 3) linear light of camera `cam` for an exposure at a time (s); `body`: see `expose`.

        Raises:
            InputError: the world returns an array of another shape.
        """
        lens, body_from_cam = self.true_rig.cameras[cam].camera, self.true_rig.cameras[cam].body_from_cam

        def poses(times: F64) -> tuple[F64, F64]:
            turns, places = body(times)
            return turns @ body_from_cam.rotation, places + turns @ body_from_cam.translation

        light = np.ascontiguousarray(self.world.radiance(lens, poses, seconds, self.bodies), np.float32)
        if light.shape != (lens.height, lens.width, 3):
            raise InputError(
                f"world {self.world.name}: radiance gives an array {light.shape}, not {(lens.height, lens.width, 3)}"
            )
        return light

    def _gain(self, k: int, cam: int, seconds: float, light: F32) -> F64:
        """Return the (3,) gains of exposure `k`, camera `cam`, and update its exposure control by `light` (H, W, 3)."""
        base: F64 = self._gains[cam][k]
        if not self.imaging.auto:
            return base
        before, then = self._controlled[cam] or (None, seconds)
        step = controlled(self.imaging, before, float(light.mean()), seconds - then)
        self._controlled[cam] = step, seconds
        return np.asarray(base * math.exp(step.log))

    def _seconds(self, k: int) -> float:
        return float(self._planned(k).true_ns[k] - START_NS) * 1e-9

    def _planned(self, k: int) -> Exposures:
        """Return the plan of all exposures; a plan without index `k` is made twice as long first."""
        if self._plan is None or k >= len(self._plan.true_ns):
            count = 256 if self._plan is None else 2 * len(self._plan.true_ns)
            beat_ns = START_NS + np.round(np.arange(count) * 1e9 / self.rate_hz).astype(np.int64)
            cams = range(len(self.true_rig.cameras))
            self._plan = exposures(self.faults, beat_ns, len(cams), self.seeds(Stream.FAULTS))
            seconds: F64 = 1e-9 * np.asarray(self._plan.true_ns - START_NS, np.float64)
            self._gains = [gains(self.imaging, seconds, self.seeds(Stream.GAIN, cam)) for cam in cams]
        return self._plan
