"""Interface of a world for trials: the pictures of its rig, the height and class of its ground, and moving objects.

The simulator's own implementation is `alight_sim.scene_world`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from alight.arrays import F32, F64
from alight.geometry import Camera, LocalFrame
from alight.records import Rig
from alight_sim.exposure import Imaging
from alight_sim.faults import Faults
from alight_sim.movers import Moving
from alight_sim.rigs import default_rig
from alight_sim.scene import Origin
from alight_sim.sensors import Sensors
from alight_sim.things.base import Box
from alight_sim.truth import SceneTruth

Poses = Callable[[F64], tuple[F64, F64]]  # seconds (N,) -> world_from_cam: rotations (N, 3, 3), positions (N, 3)
Start = tuple[float, float, float]  # east, north, metres above the ground there
START: Start = (-20.0, -12.0, 40.0)


@runtime_checkable
class World(Protocol):
    """A world to land in. A subclass needs `name`, `radiance` and `truth`; everything else has a default.

    Axes are east, north, up in metres from the origin; a camera is right, down, forward. Times are seconds of the
    flight. The same arguments give the same results, independent of earlier calls.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in reports."""

    @abstractmethod
    def radiance(self, camera: Camera, world_from_cam: Poses, seconds: float, bodies: Sequence[Moving]) -> F32:
        """Draw a picture: (H, W, 3) linear light, red, green and blue. `imaging` converts it to grey values.

        Args:
            camera: image size, intrinsics and distortion.
            world_from_cam: poses of the camera around the time of the exposure.
            seconds: middle of the exposure.
            bodies: cars and persons that appeared on command and must be drawn too (`alight_sim.movers.boxes_at`).
        """

    @abstractmethod
    def truth(self, bounds: Box) -> SceneTruth:
        """Return heights and classes of the ground at the centres of all cells of size `cell` within the bounds.

        The ground continues everywhere: all heights are finite. Moving objects are left out. `spans` of the result are
        the wires above the bounds.
        """

    def height_at(self, east: float, north: float) -> float:
        """Return the height of the ground at a position, metres, bilinear between cell centres."""
        reach = 2.0 * self.cell
        near = self.truth((east - reach, north - reach, east + reach, north + reach))
        row, col = (float(i) for i in near.grid.index(np.array(east), np.array(north)))
        i, j = int(row), int(col)
        v, u = row - i, col - j
        return float(np.array([1 - v, v]) @ near.height[i : i + 2, j : j + 2] @ np.array([1 - u, u]))

    @property
    def cell(self) -> float:
        """Metres between the cell centres of `truth`."""
        return 0.1

    @property
    def movers(self) -> Sequence[Moving]:
        """Moving objects of the world itself, as upright boxes."""
        return ()

    @property
    def start(self) -> Start:
        """Position where the landings of a campaign begin; the search is centred on it."""
        return START

    @property
    def rig(self) -> Rig:
        """The cameras; a trial scales them to the size of its pictures."""
        return default_rig()

    @property
    def imaging(self) -> Imaging:
        """Settings of lens and sensor, which convert light to grey values."""
        return Imaging(auto=True)

    @property
    def sensors(self) -> Sensors:
        """Errors of GPS/INS and IMU."""
        return Sensors()

    @property
    def faults(self) -> Faults:
        """Faults between the shutter and the log."""
        return Faults()

    @property
    def local(self) -> LocalFrame:
        """Local frame with the position of the origin on Earth."""
        return Origin().local

    @property
    def description(self) -> str:
        """One sentence that describes the world."""
        return ""

    @property
    def warnings(self) -> Sequence[str]:
        """Assumptions about the world, for the report."""
        return ()
