"""A simulated autopilot (Copter, PX4) over MAVLink, with a vehicle of its own; no code of `alight.flight.autopilot`."""

from alight_sim.autopilot.channel import LossyChannel
from alight_sim.autopilot.dialects import DIALECTS, PX4_CONTROLLER
from alight_sim.autopilot.estimate import EstimateError
from alight_sim.autopilot.server import UdpServer
from alight_sim.autopilot.simulated import SimulatedAutopilot, SimulatedHome
from alight_sim.point_mass import FlightLimits, PointMass, Wanted

__all__ = [
    "DIALECTS",
    "PX4_CONTROLLER",
    "EstimateError",
    "FlightLimits",
    "LossyChannel",
    "PointMass",
    "SimulatedAutopilot",
    "SimulatedHome",
    "UdpServer",
    "Wanted",
]
