"""Hazards, sites, candidates with the view that would settle their doubt, and the route."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import ClassVar, Literal

import numpy as np

from alight.arrays import F32, F64, U16, Mask
from alight.records.surface import OnGrid, Terrain

Kind = Literal["site", "candidate"]
Doubt = Literal["relief", "obstacle", "ground"]  # the factors of P(safe)


class Hazard(IntFlag):
    """Reason to refuse a touchdown centred on a cell; a bit."""

    UNKNOWN = 1  # part of the footprint was not seen or not trusted
    SLOPE = 2
    ROUGHNESS = 4
    STEP = 8
    CLEARANCE = 16  # something stands in the rotor's or belly's way
    TERRAIN = 32  # water, plants, structure
    EDGE = 64  # the footprint leaves the map
    DOUBT = 128  # every limit is met, but not surely enough (p_safe below the least wanted)
    TRAFFIC = 256  # something moved across it or beside it a moment ago


def is_site(p_safe: F32, least: float) -> Mask:
    """Whether P(safe) makes a touchdown that no limit refuses a site; else it is a candidate, (R, C).

    This alone decides between the two. Its result is `Hazard.DOUBT`: a place without any reason is a site, one with
    this reason alone a candidate. A place that is listed also keeps a margin (`keeps_margin`).

    Args:
        p_safe: (R, C), 0 where a limit refuses a touchdown, NaN where it cannot be judged.
        least: P(safe) of a site, at least.
    """
    return p_safe >= least


def keeps_margin(clearance: F32, margin: float) -> Mask:
    """Whether a touchdown has the room that a listed place must have, (R, C).

    Args:
        clearance: (R, C) metres to the nearest touchdown that is refused.
        margin: metres, `sites.margin`.
    """
    return clearance >= margin


@dataclass(frozen=True, eq=False)
class HazardMap(OnGrid):
    """Hazards of a touchdown centred on each cell. NaN where it cannot be judged."""

    unknown: ClassVar[int] = Hazard.UNKNOWN

    slope: F32  # (R, C) rad, of the footprint's plane
    roughness: F32  # (R, C) metres, largest deviation from that plane
    step: F32  # (R, C) metres, largest rise between neighbouring cells in the footprint
    clearance: F32  # (R, C) metres to the nearest cell where a touchdown is refused
    p_safe: F32  # (R, C) probability of a touchdown within every limit: product of the three factors; 0 if refused
    p_relief: F32  # (R, C) probability that slope and relief keep their limits, by the heights
    p_obstacle: F32  # (R, C) probability that no obstacle stands there that heights and pictures are too coarse to show
    p_ground: F32  # (R, C) probability that the ground bears and is dry
    resolved: F32  # (R, C) metres, height of the smallest obstacle that would have been found with 95 %
    settles_at: F32  # (R, C) metres, pixel on the ground that would settle the doubt; NaN: never
    quality: F32  # (R, C) Q of the paper, eq. 5: 0 is best, more negative is worse
    reasons: U16  # (R, C) bits of Hazard; 0 = safe


@dataclass(frozen=True)
class NextView:
    """A view that would settle the doubt about a candidate: a proposal to the executive."""

    east: float  # of the cameras
    north: float
    up: float
    height: float  # metres above the ground of the place
    settles: bool  # its pixels are fine enough; False: too coarse even as near as is allowed

    @property
    def position_world(self) -> F64:
        """The place of the cameras, (3,) metres."""
        return np.array([self.east, self.north, self.up])


@dataclass(frozen=True)
class Site:
    """A place to land (`site`), or one that may become it (`candidate`); properties as in sites.geojson."""

    rank: int  # among all places of the list: sites first, then candidates
    east: float
    north: float
    up: float
    p_safe: float  # the product of the three factors
    p_relief: float
    p_obstacle: float
    p_ground: float
    resolved: float  # metres, height of the smallest obstacle that would have been found here with 95 %
    quality: float
    slope: float  # rad
    roughness: float  # metres
    clearance: float  # metres, to the rim of the nearest refused cell
    radius: float  # metres, of the largest disc about it in which no cell is refused
    terrain: Terrain
    heading: float  # rad, clockwise from north, of the suggested touchdown
    height_sigma: float  # metres
    doubt: Doubt | None = None  # of a candidate: the smallest factor of P(safe)
    look: NextView | None = None  # of a candidate; None: no nearer view would settle the doubt

    @property
    def kind(self) -> Kind:
        """A candidate is a place in doubt."""
        return "site" if self.doubt is None else "candidate"

    def moved(self, shift: F64) -> Site:
        """The site and its view, moved by `shift`, (3,) metres."""
        east, north, up = (float(v) for v in shift)
        look = self.look
        if look is not None:
            look = replace(look, east=look.east + east, north=look.north + north, up=look.up + up)
        return replace(self, east=self.east + east, north=self.north + north, up=self.up + up, look=look)


@dataclass(frozen=True)
class Sites:
    """The answer: ranked sites, then ranked candidates; without a site, the reason."""

    sites: tuple[Site, ...]
    reason: str = ""  # why `sites` is empty
    frame_id: int = 0  # of the map that they were found on
    candidates: tuple[Site, ...] = ()  # nothing refuses them, and their P(safe) is below the limit

    @property
    def listed(self) -> tuple[Site, ...]:
        """Sites and candidates in order of rank."""
        return self.sites + self.candidates

    def moved(self, shift: F64) -> Sites:
        """Sites and candidates moved by `shift`, (3,) metres."""
        sites, candidates = (tuple(s.moved(shift) for s in part) for part in (self.sites, self.candidates))
        return replace(self, sites=sites, candidates=candidates)


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


def p_safe_text(p: float) -> str:
    """P(safe) with three figures, 0.620, 0.987; never rounded up to 1."""
    return "> 0.999" if p > 0.9995 else f"{p:.3f}"
