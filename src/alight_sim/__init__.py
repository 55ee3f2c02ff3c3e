"""The simulator: ground, cameras, vehicle and sensors with exact truth. Shares no code with the stages it tests."""

from alight_sim.exposure import Imaging
from alight_sim.faults import Faults
from alight_sim.flight import SimulatedFlight, fly
from alight_sim.light import Light, Sun
from alight_sim.log import write
from alight_sim.patterns import FlightPlan
from alight_sim.rigs import RigModel, default_rig
from alight_sim.scene import Scene, built_in, read_scene
from alight_sim.scene_world import SceneWorld, build, world_of
from alight_sim.sensors import ImuErrors, NavErrors, Sensors
from alight_sim.truth import SceneTruth, TrueFootprint
from alight_sim.vehicle import Air, Limits
from alight_sim.world import World

__all__ = [
    "Air",
    "Faults",
    "FlightPlan",
    "Imaging",
    "ImuErrors",
    "Light",
    "Limits",
    "NavErrors",
    "RigModel",
    "Scene",
    "SceneTruth",
    "SceneWorld",
    "Sensors",
    "SimulatedFlight",
    "Sun",
    "TrueFootprint",
    "World",
    "build",
    "built_in",
    "default_rig",
    "fly",
    "read_scene",
    "world_of",
    "write",
]
