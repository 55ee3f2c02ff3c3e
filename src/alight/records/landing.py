"""Hazards, sites, the next view and the route."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64
from alight.geometry import Grid
from alight.records.surface import Terrain


class Hazard(IntFlag):
    """Why a touchdown centred on a cell is refused."""

    UNKNOWN = 1  # part of the footprint was not seen or not trusted
    SLOPE = 2
    ROUGHNESS = 4
    STEP = 8
    CLEARANCE = 16  # something stands in the rotor's or belly's way
    TERRAIN = 32  # water, plants, structure
    EDGE = 64  # the footprint leaves the map
    DOUBT = 128  # every limit is met, but not surely enough (p_safe below the least wanted)


@dataclass(frozen=True, eq=False)
class HazardMap:
    """What a touchdown centred on each cell would meet. NaN where it cannot be judged."""

    grid: Grid
    slope: F32  # (R, C) rad, of the footprint's plane
    roughness: F32  # (R, C) metres, largest deviation from that plane
    step: F32  # (R, C) metres, largest rise between neighbouring cells in the footprint
    clearance: F32  # (R, C) metres to the nearest cell where a touchdown is refused
    p_safe: F32  # (R, C) probability that a touchdown here meets every limit: the product of the three factors
    p_relief: F32  # (R, C) probability that slope and relief keep their limits, by the heights
    p_obstacle: F32  # (R, C) probability that nothing stands there that heights and pictures are too coarse to show
    p_ground: F32  # (R, C) probability that the ground bears and is dry
    resolved: F32  # (R, C) metres, height of the smallest obstacle that would have been found with 95 %
    settles_at: F32  # (R, C) metres, size of the pixel on the ground by which the doubt would be settled; NaN: never
    quality: F32  # (R, C) Q of the paper, eq. 5: 0 is best, more negative is worse
    reasons: NDArray[np.uint8]  # (R, C) bits of Hazard; 0 = safe


@dataclass(frozen=True)
class Site:
    """One candidate landing site, properties as in sites.geojson."""

    rank: int
    east: float
    north: float
    up: float
    p_safe: float
    quality: float
    slope: float  # rad
    roughness: float  # metres
    clearance: float  # metres
    radius: float  # metres, of the largest safe disc about it
    terrain: Terrain
    heading: float  # rad, clockwise from north, of the suggested touchdown
    height_sigma: float  # metres


@dataclass(frozen=True)
class Sites:
    """The answer: ranked sites, or the reason why there is none."""

    sites: tuple[Site, ...]
    reason: str = ""  # why `sites` is empty
    frame_id: int = 0  # of the map that they were found on


@dataclass(frozen=True, eq=False)
class NextView:
    """A view that would reduce the doubt about the most promising place: a proposal to the executive."""

    position_world: F64  # (3,) metres, of the cameras
    place_world: F64  # (3,) metres, what to look at
    p_safe: float  # of that place by now
    height: float  # metres above it


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A point of the route."""

    name: str
    position_world: F64  # (3,) metres
    heading: float  # rad, clockwise from north
    speed: float  # m/s towards it
    t: float  # s from the start of the route
    look: bool = False  # judge the ground again from here


@dataclass(frozen=True)
class Route:
    """The way-points to the best site."""

    waypoints: tuple[Waypoint, ...]
    warnings: tuple[str, ...] = field(default=())
    frame_id: int = 0  # of the map that it was planned on
