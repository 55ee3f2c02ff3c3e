"""The autopilot's fence as a region of the ground plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import shapely

from alight.arrays import F64
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.onboard import StoredItem
from alight.geometry import LocalFrame
from alight.geometry.zones import Region, Zone, united
from alight.records import InputError

_DEGREE = 1e-3  # step, degrees, over which the metres of a degree are measured


class OnEarth(Protocol):
    """Anything with a position on Earth, degrees."""

    @property
    def latitude(self) -> float: ...
    @property
    def longitude(self) -> float: ...


class _Kind(NamedTuple):
    name: str
    is_circle: bool
    keeps_in: bool


_KINDS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: _Kind("inclusion polygon", False, True),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: _Kind("exclusion polygon", False, False),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: _Kind("inclusion circle", True, True),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: _Kind("exclusion circle", True, False),
}


def on_plane(local: LocalFrame, at: OnEarth) -> F64:
    """Return a position in the plane of the fence, (2,) metres east and north of the origin of `local`.

    The plane is degrees times the length of a degree at the origin: an edge that is straight for the autopilot, in
    degrees, is straight here, and distances are exact near the origin.
    """
    north = local.to_enu(local.latitude + _DEGREE, local.longitude, local.height)[1]
    east = local.to_enu(local.latitude, local.longitude + _DEGREE, local.height)[0]
    turned = math.remainder(at.longitude - local.longitude, 360.0)  # across the date line
    return np.array([turned * east, (at.latitude - local.latitude) * north]) / _DEGREE


def fence_region(items: Sequence[StoredItem], local: LocalFrame, any_of: bool) -> Region:
    """Return the region that a fence allows, in the plane of `on_plane`.

    Args:
        any_of: whether the vehicle must stay in any, instead of in each, of the zones that keep it in.

    Raises:
        InputError: an item is of an unknown kind, or a polygon or a circle is incomplete; the message names it.
    """
    zones, rest = list[Zone](), [i for i in items if i.command != mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT]
    while rest:
        kind = _KINDS.get(rest[0].command)
        if kind is None:
            raise InputError(f"fence: command {rest[0].command} is no part of a fence that is known")
        name = f"{kind.name} {1 + sum(z.name.startswith(kind.name) for z in zones)}"
        count = 1 if kind.is_circle else round(rest[0].parameter) if math.isfinite(rest[0].parameter) else 0
        corners, rest = rest[:count], rest[max(count, 1) :]
        at = np.array([on_plane(local, i) for i in corners])
        same = {i.command for i in corners} == {i.command for i in corners[:1]}
        if not kind.is_circle and not (count >= 3 and len(corners) == count and same):
            raise InputError(f"fence: {name} has {len(corners)} corners of one kind and {count} are announced")
        if kind.is_circle and not corners[0].parameter > 0.0:
            raise InputError(f"fence: {name} has a radius of {corners[0].parameter:g} m")
        if kind.is_circle:
            zones.append(Zone(name, shapely.Point(at[0]), kind.keeps_in, corners[0].parameter))
        else:
            zones.append(Zone(name, shapely.make_valid(shapely.Polygon(at)), kind.keeps_in))
    inner = [z for z in zones if z.keeps_in]
    if any_of and len(inner) > 1:
        joined = united(" or ".join(z.name for z in inner), inner)
        zones = [joined, *(z for z in zones if not z.keeps_in)]
    return Region(tuple(zones))
