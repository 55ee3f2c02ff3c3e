"""The route as a QGroundControl plan."""

from __future__ import annotations

import math
from enum import IntEnum
from itertools import pairwise
from typing import Any, NamedTuple

from alight.arrays import F64
from alight.geometry import LocalFrame
from alight.outputs.vectors import lon_lat_height, number
from alight.records import Home, Route, Waypoint
from alight.settings import Settings

ABOVE_SITE = (
    "altitudes are metres above the ground of the landing site, which is the planned home; "
    "where the vehicle's home is another place, add the site's height minus that home's height to every way-point"
)


class Command(IntEnum):
    """MAVLink commands (MAV_CMD)."""

    WAYPOINT = 16
    LAND = 21
    YAW = 115
    SPEED = 178


class PlanItem(NamedTuple):
    """One mission item of a plan: a command, its parameters, and its position."""

    command: Command
    parameters: tuple[float, float, float, float]
    position_world: F64 | None = None  # (3,) metres; None: speed and heading have no position


def plan_items(route: Route) -> list[PlanItem]:
    """Return the mission items of a route: a way-point, speed and heading for each leg, and a hold at each look."""
    *way, touchdown = route.waypoints
    items = [_stop(way[0])]
    for here, there in pairwise(way):
        items += [*_leg(here, there), _stop(there)]
    end = PlanItem(Command.LAND, (0.0, 0.0, 0.0, _degrees(touchdown.heading)), touchdown.position_world)
    return [*items, *_leg(way[-1], touchdown), end]


def _leg(here: Waypoint, there: Waypoint) -> tuple[PlanItem, PlanItem]:
    """Return the speed and heading items of a leg; every leg has both, in this order.

    ArduPilot executes the first of these items before the leg starts, and the start of a leg resets the heading. So the
    heading must be the second item.
    """
    east, north, up = there.position_world - here.position_world
    straight_down = up < 0 and math.hypot(east, north) < 0.5  # m
    kind, same_throttle = 3.0 if straight_down else 1.0, -1.0  # SPEED_TYPE_DESCENT_SPEED, SPEED_TYPE_GROUNDSPEED
    speed = PlanItem(Command.SPEED, (kind, there.speed, same_throttle, 0.0))
    return speed, PlanItem(Command.YAW, (_degrees(there.heading), 0.0, 0.0, 0.0))


def _stop(w: Waypoint) -> PlanItem:
    hold = 3.0 if w.look else 0.0  # s
    return PlanItem(Command.WAYPOINT, (hold, 0.0, 0.0, _degrees(w.heading)), w.position_world)


def _degrees(heading: float) -> float:
    return math.degrees(heading) % 360.0


def _item(jump_id: int, item: PlanItem, local: LocalFrame, zero: float) -> dict[str, Any]:
    """Return one item as QGroundControl's JSON; NaN becomes null.

    `jump_id`: its number in the plan, from 1. `zero`: height above the ellipsoid (m) to which altitudes are relative.
    """
    frame = 2 if item.position_world is None else 3  # MAV_FRAME_MISSION, MAV_FRAME_GLOBAL_RELATIVE_ALT
    simple = {"type": "SimpleItem", "command": item.command, "frame": frame, "doJumpId": jump_id, "autoContinue": True}
    parameters = [number(p, 4) for p in item.parameters]
    if item.position_world is None:
        return {**simple, "params": [*parameters, 0, 0, 0]}
    longitude, latitude, height = lon_lat_height(local, *item.position_world)
    altitude = round(height - zero, 3) + 0.0
    return {
        **simple,
        "AMSLAltAboveTerrain": None,
        "Altitude": altitude,
        "AltitudeMode": 1,  # relative to home
        "params": [*parameters, latitude, longitude, altitude],
    }


def route_plan(route: Route, local: LocalFrame, settings: Settings, home: Home | None = None) -> dict[str, Any]:
    """Return the route as a QGroundControl plan: speeds, headings, holds at looks; the last way-point becomes LAND.

    Altitudes are relative to the vehicle's home. Without a home they are relative to the ground of the landing site.
    The site is then the planned home (with its altitude above the ellipsoid), and the plan's name states this.
    """
    longitude, latitude, zero = lon_lat_height(local, *route.waypoints[-1].position_world)
    planned, name = [latitude, longitude, zero], "to site 1, HEIGHTS RELATIVE TO THE SITE, NOT TO HOME"
    reference = ABOVE_SITE
    if home is not None:
        planned, name, zero = [home.latitude, home.longitude, home.altitude_msl], "to site 1", home.height
        reference = "altitudes are metres above the home that was given, which is the planned home"
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "name": name,
        "heightReference": reference,
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": 3,  # MAV_AUTOPILOT_ARDUPILOTMEGA
            "vehicleType": 2,  # MAV_TYPE_QUADROTOR
            "globalPlanAltitudeMode": 1,
            "cruiseSpeed": settings.route.cruise_speed,
            "hoverSpeed": settings.route.cruise_speed,
            "plannedHomePosition": planned,
            "items": [_item(i, item, local, zero) for i, item in enumerate(plan_items(route), 1)],
        },
    }
