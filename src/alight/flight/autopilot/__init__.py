"""The autopilot: MAVLink 2 as a protocol machine without I/O, and links. NED, FRD and sea level stay in here."""

from alight.flight.autopilot.autopilot import Autopilot
from alight.flight.autopilot.border import EstimateTie, metres_between
from alight.flight.autopilot.fence import on_plane
from alight.flight.autopilot.links import Link, open_link
from alight.flight.autopilot.odometry import ExternalPose
from alight.flight.autopilot.parameters import judged_parameters
from alight.flight.autopilot.remote_vehicle import RemoteVehicle
from alight.flight.autopilot.setpoints import Setpoint
from alight.flight.autopilot.streams import StreamRate
from alight.flight.autopilot.telemetry_events import TelemetryEvents

__all__ = [
    "Autopilot",
    "EstimateTie",
    "ExternalPose",
    "Link",
    "RemoteVehicle",
    "Setpoint",
    "StreamRate",
    "TelemetryEvents",
    "judged_parameters",
    "metres_between",
    "on_plane",
    "open_link",
]
