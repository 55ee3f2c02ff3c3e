"""The simulator: ground, cameras, vehicle and sensors with exact truth. Shares no code with the stages it tests."""

from alight.simulate.exposure import Imaging
from alight.simulate.faults import Faults
from alight.simulate.flight import SimulatedFlight, fly
from alight.simulate.light import Light, Sun
from alight.simulate.log import write
from alight.simulate.patterns import FlightPlan
from alight.simulate.rigs import RigModel, default_rig
from alight.simulate.scene import Scene, built_in, read_scene
from alight.simulate.sensors import ImuErrors, NavErrors, Sensors
from alight.simulate.truth import Footprint, Truth
from alight.simulate.vehicle import Air, Limits
from alight.simulate.world import World, build, world_of

__all__ = [
    "Air",
    "Faults",
    "FlightPlan",
    "Footprint",
    "Imaging",
    "ImuErrors",
    "Light",
    "Limits",
    "NavErrors",
    "RigModel",
    "Scene",
    "Sensors",
    "SimulatedFlight",
    "Sun",
    "Truth",
    "World",
    "build",
    "built_in",
    "default_rig",
    "fly",
    "read_scene",
    "world_of",
    "write",
]
