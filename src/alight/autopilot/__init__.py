"""The autopilot: MAVLink 2 as a protocol machine without I/O, and links. NED, FRD and sea level stay in here."""

from alight.autopilot.autopilot import Autopilot
from alight.autopilot.border import EstimateTie, metres_between
from alight.autopilot.links import Link, open_link
from alight.autopilot.mission_item import MissionItem, mission_of
from alight.autopilot.remote_vehicle import RemoteVehicle
from alight.autopilot.setpoints import Setpoint
from alight.autopilot.streams import StreamRate
from alight.autopilot.telemetry_events import TelemetryEvents

__all__ = [
    "Autopilot",
    "EstimateTie",
    "Link",
    "MissionItem",
    "RemoteVehicle",
    "Setpoint",
    "StreamRate",
    "TelemetryEvents",
    "metres_between",
    "mission_of",
    "open_link",
]
