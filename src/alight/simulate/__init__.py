"""The simulator: ground, cameras, vehicle and sensors with exact truth. Shares no code with the stages it tests."""

from alight.simulate.cameras import Imaging, default_rig
from alight.simulate.flight import SimulatedFlight, fly
from alight.simulate.log import write
from alight.simulate.scenes import SCENES, build
from alight.simulate.sensors import ImuErrors, NavErrors
from alight.simulate.truth import Footprint, Truth
from alight.simulate.vehicle import Limits
from alight.simulate.world import Sun, World

__all__ = [
    "SCENES",
    "Footprint",
    "Imaging",
    "ImuErrors",
    "Limits",
    "NavErrors",
    "SimulatedFlight",
    "Sun",
    "Truth",
    "World",
    "build",
    "default_rig",
    "fly",
    "write",
]
