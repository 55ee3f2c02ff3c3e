"""The simulator: ground, cameras, vehicle and sensors with exact truth. Shares no code with the stages it tests."""

from alight.simulate.cameras import default_rig
from alight.simulate.exposure import Imaging
from alight.simulate.faults import Faults
from alight.simulate.flight import SimulatedFlight, fly
from alight.simulate.log import write
from alight.simulate.patterns import FlightPlan
from alight.simulate.scenes import SCENES, build
from alight.simulate.sensors import ImuErrors, NavErrors, Sensors
from alight.simulate.truth import Footprint, Truth
from alight.simulate.vehicle import Air, Limits
from alight.simulate.world import Sun, World

__all__ = [
    "SCENES",
    "Air",
    "Faults",
    "FlightPlan",
    "Footprint",
    "Imaging",
    "ImuErrors",
    "Limits",
    "NavErrors",
    "Sensors",
    "SimulatedFlight",
    "Sun",
    "Truth",
    "World",
    "build",
    "default_rig",
    "fly",
    "write",
]
