"""A mission: items as an autopilot takes them, made from a route."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import Any

from alight.flight.autopilot.border import EstimateTie, scaled_degrees
from alight.flight.autopilot.pymavlink_dialect import message
from alight.records import Place, Route, Waypoint

NAV_WAYPOINT, NAV_LAND = 16, 21  # MAV_CMD
CONDITION_YAW, DO_CHANGE_SPEED = 115, 178
GLOBAL, MISSION, ABOVE_HOME = 0, 2, 3  # MAV_FRAME
_AS_IT_IS = -1.0  # a throttle that stays
_STEEP = 0.5  # m sideways, below which a leg goes straight down
LOOK_TIME = 3.0  # s, of a hold where the ground is looked at


class SpeedKind(Enum):
    """SPEED_TYPE."""

    GROUND = 1.0
    DESCENT = 3.0


@dataclass(frozen=True)
class MissionItem:
    """One item. Those without a place (speed, heading) have frame MISSION."""

    command: int
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    place: Place | None = None
    frame: int = MISSION

    def message(self, sequence: int, system: int, component: int) -> Any:
        """The item as MISSION_ITEM_INT: altitudes above home, or above sea level for the home itself."""
        p, at = self.parameters, self.place
        altitude = 0.0 if at is None else at.altitude_msl if self.frame == GLOBAL else at.above_home
        return message(
            "MISSION_ITEM_INT", target_system=system, target_component=component, seq=sequence, frame=self.frame,
            command=self.command, current=int(sequence == 0), autocontinue=1, param1=p[0], param2=p[1], param3=p[2],
            param4=p[3], x=0 if at is None else scaled_degrees(at.latitude),
            y=0 if at is None else scaled_degrees(at.longitude), z=altitude, mission_type=0,
        )  # fmt: skip


def waypoint(place: Place, heading: float = math.nan, hold: float = 0.0) -> MissionItem:
    """Fly to a place and stay for `hold` seconds; heading in rad clockwise from north, NaN: the autopilot chooses."""
    return MissionItem(NAV_WAYPOINT, (hold, 0.0, 0.0, math.degrees(heading) % 360.0), place, ABOVE_HOME)


def land(place: Place, heading: float = math.nan) -> MissionItem:
    """Land at a place.

    Args:
        place: on the ground.
        heading: rad clockwise from north; NaN: the autopilot chooses.
    """
    return MissionItem(NAV_LAND, (0.0, 0.0, 0.0, math.degrees(heading) % 360.0), place, ABOVE_HOME)


def change_speed(speed: float, downwards: bool = False) -> MissionItem:
    """Change the speed from this item on.

    Args:
        speed: m/s.
        downwards: of the descent; else over the ground.
    """
    kind = SpeedKind.DESCENT if downwards else SpeedKind.GROUND
    return MissionItem(DO_CHANGE_SPEED, (kind.value, speed, _AS_IT_IS, 0.0))


def face(heading: float) -> MissionItem:
    """Turn to a heading, rad clockwise from north."""
    return MissionItem(CONDITION_YAW, (math.degrees(heading) % 360.0, 0.0, 0.0, 0.0))


def mission_of(
    route: Route, tie: EstimateTie, look_time: float = LOOK_TIME, with_start: bool = False
) -> tuple[MissionItem, ...]:
    """Make the mission of a route: speed, heading and place of each way-point; holds where the ground is looked at.

    Args:
        route: way-points from the vehicle to the touchdown, in our world.
        tie: our position and the autopilot's of one instant; its place must have a height above home.
        look_time: s, of a hold.
        with_start: fly to the start of the route first; a vehicle that is there need not.

    Raises:
        ValueError: the autopilot's height above its home is not known.
    """
    if not math.isfinite(tie.place.above_home):
        raise ValueError("the autopilot's height above its home is not known")
    *way, touchdown = route.waypoints
    items = [_stop(way[0], tie, look_time)] if with_start else []
    for here, there in pairwise(way):
        items += [*_leg(here, there), _stop(there, tie, look_time)]
    end = land(tie.place_of(touchdown.position_world), touchdown.heading)
    return (*items, *_leg(way[-1], touchdown), end)


def _leg(here: Waypoint, there: Waypoint) -> tuple[MissionItem, MissionItem]:
    """Speed and heading of a leg, in this order and both every time.

    Items before a way-point are executed on the way to it. But ArduPilot executes the first one before it starts the
    leg, and that start resets the heading: the heading must be the second.
    """
    return _speed(here, there), face(there.heading)


def _stop(w: Waypoint, tie: EstimateTie, look_time: float) -> MissionItem:
    return waypoint(tie.place_of(w.position_world), w.heading, look_time if w.look else 0.0)


def _speed(here: Waypoint, there: Waypoint) -> MissionItem:
    east, north, up = there.position_world - here.position_world
    return change_speed(there.speed, downwards=up < 0 and math.hypot(east, north) < _STEEP)


def home_item(home: Place) -> MissionItem:
    """The home as an item, which ArduPilot wants as the first one."""
    return MissionItem(NAV_WAYPOINT, place=home, frame=GLOBAL)
