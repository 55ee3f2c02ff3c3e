"""Hazards, sites, candidates with the view that would settle their doubt, routes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import ClassVar, Literal

import numpy as np

from alight.arrays import F32, F64, U16, Mask
from alight.records.surface import OnGrid, Terrain
from alight.records.wires import Wire
from alight.records.zones import ZoneKind

Kind = Literal["site", "candidate"]
Doubt = Literal["relief", "obstacle", "ground", "wires", "zone"]  # the factors of P(safe); a zone to be avoided


class Hazard(IntFlag):
    """Reason to refuse a touchdown centred on a cell; a bit."""

    UNKNOWN = 1  # part of the footprint was not seen or not trusted
    SLOPE = 2
    ROUGHNESS = 4
    STEP = 8
    CLEARANCE = 16  # an obstacle would touch the rotor or the belly
    TERRAIN = 32  # water, plants, structure
    EDGE = 64  # the footprint leaves the map
    DOUBT = 128  # every limit is met, but P(safe) is below the limit
    TRAFFIC = 256  # a moving object crossed or passed the cell recently
    WIRE = 512  # a wire hangs over the footprint or beside it
    ZONE = 1024  # in a keep-out zone, or outside the landing or search zones
    AVOID = 2048  # in a zone to be avoided: a site only where there is no other site or candidate


def is_site(p_safe: F32, least: float) -> Mask:
    """Return the mask of cells, (R, C), whose P(safe) makes a touchdown a site instead of a candidate.

    No other function decides between the two. The result sets `Hazard.DOUBT`: a cell without any reason is a site, a
    cell with this reason only is a candidate. Listed sites and candidates also keep a margin (`keeps_margin`).

    Args:
        p_safe: (R, C), 0 where a limit refuses a touchdown, NaN where it cannot be judged.
        least: least P(safe) of a site.
    """
    return p_safe >= least


def keeps_margin(clearance: F32, margin: float) -> Mask:
    """Return the mask of cells, (R, C), with the clearance that a listed site or candidate needs.

    Args:
        clearance: (R, C) distance to the nearest refused touchdown, metres.
        margin: least clearance, metres (`sites.margin`).
    """
    return clearance >= margin


@dataclass(frozen=True, eq=False)
class HazardMap(OnGrid):
    """Hazards of a touchdown centred on each cell; NaN where it cannot be judged."""

    unknown: ClassVar[int] = Hazard.UNKNOWN

    slope: F32  # (R, C) rad, slope of the footprint's plane
    roughness: F32  # (R, C) metres, largest deviation from the footprint's plane
    step: F32  # (R, C) metres, largest rise between neighbouring cells in the footprint
    clearance: F32  # (R, C) metres to the nearest cell where a touchdown is refused
    p_safe: F32  # (R, C) probability of a touchdown within every limit: product of the known factors; 0 if refused
    p_relief: F32  # (R, C) probability that slope and relief keep their limits, by the heights
    p_obstacle: F32  # (R, C) probability of no obstacle that is too small for heights and pictures
    p_ground: F32  # (R, C) probability of firm, dry ground; NaN: not judged
    resolved: F32  # (R, C) metres, height of the smallest obstacle found with a probability of 95 %
    settles_at: F32  # (R, C) metres, ground width of a pixel that would settle the doubt; NaN: no width would
    quality: F32  # (R, C) Q of the paper, eq. 5: 0 is best, more negative is worse
    reasons: U16  # (R, C) bits of Hazard; 0 = safe
    p_wires: F32 | None = None  # (R, C) probability that no doubtful line is a wire over it; None: 1
    wires: tuple[Wire, ...] = ()  # wires over the ground, found and doubtful
    zone: U16 | None = None  # (R, C) position in `zone_labels`, from 1, where `reasons` has ZONE or AVOID
    zone_labels: tuple[str, ...] = ()
    preferred: Mask | None = None  # (R, C) in a zone whose sites rank higher; None: nowhere

    def zones_behind(self, bit: Hazard) -> Counter[str]:
        """Return the labels of the zones that set ZONE or AVOID anywhere, the largest first, with their cells."""
        cells = Counter[str]()
        if self.zone is not None and bit in (Hazard.ZONE, Hazard.AVOID):
            counts = np.bincount(self.zone[(self.reasons & bit) != 0], minlength=len(self.zone_labels) + 1)[1:]
            for k in np.argsort(-counts, kind="stable"):
                cells[self.zone_labels[k]] += int(counts[k])
        return +cells  # without zones that set it nowhere

    def words(self, words: Mapping[Hazard, str], row: int, col: int) -> str:
        """Return the reasons of a cell in words, with the zone's name; empty: there is none."""
        reasons = Hazard(int(self.reasons[row, col]))
        out = ", ".join(words[bit] for bit in reasons if bit in words)
        if reasons & (Hazard.ZONE | Hazard.AVOID) and self.zone is not None:
            out += f" ({self.zone_labels[self.zone[row, col] - 1]})"
        return out


@dataclass(frozen=True)
class NextView:
    """View proposed to the executive to settle the doubt about a candidate."""

    east: float  # metres, position of the cameras
    north: float
    up: float
    height: float  # metres above the ground at the candidate
    settles: bool  # whether its pixels settle the doubt; False: too coarse even at the least height

    @property
    def position_world(self) -> F64:
        """Position of the cameras, (3,) metres."""
        return np.array([self.east, self.north, self.up])


@dataclass(frozen=True, eq=False)
class Observer:
    """The vehicle with its cameras that look down."""

    position: F64  # (3,) metres, in the frame of the map
    height_above_ground: float  # metres
    focal: float  # focal length of the newest view that looks down, pixels
    stereo: bool  # whether two cameras look down at the same time


@dataclass(frozen=True)
class NearZone:
    """The zone, road, car, person or building nearest to a site."""

    kind: ZoneKind
    label: str  # of a zone: use, name and reason
    distance: float  # metres from the site to the zone's border; 0: the site lies in it
    bearing: float  # rad, clockwise from north, from the site; NaN: the site lies in it


@dataclass(frozen=True)
class Site:
    """A site, or a candidate that may become one; the properties are those of sites.geojson."""

    rank: int  # from 1, over the whole list: sites first, then candidates
    east: float
    north: float
    up: float
    p_safe: float  # the product of the known factors
    p_relief: float
    p_obstacle: float
    p_ground: float  # NaN: the kind of ground was not judged
    resolved: float  # metres, height of the smallest obstacle found here with a probability of 95 %
    quality: float
    slope: float  # rad
    roughness: float  # metres
    clearance: float  # metres, to the rim of the nearest refused cell
    radius: float  # metres, of the largest disc around it without a refused cell
    terrain: Terrain
    heading: float  # rad, clockwise from north, suggested for the touchdown
    height_sigma: float  # metres
    doubt: Doubt | None = None  # candidate: the smallest factor of P(safe); None: a site
    look: NextView | None = None  # candidate: the next view; None: no view would settle the doubt
    p_wires: float = 1.0
    zone: NearZone | None = None  # nearest zone; None: there are no zones
    near: tuple[NearZone, ...] = ()  # nearest road, car, person and building, as far as there are any
    avoid: str = ""  # zone to be avoided in which it lies; it is a site only where there is no other place
    preferred: bool = False  # whether it lies in a zone whose sites rank higher

    @classmethod
    def unjudged(cls, east: float, north: float, up: float) -> Site:
        """Return a location, in metres, of which nothing is known yet."""
        nan = float("nan")
        return cls(
            0, float(east), float(north), float(up), nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, Terrain.UNKNOWN,
            nan, nan,
        )  # fmt: skip

    @property
    def kind(self) -> Kind:
        """Whether the record is a site or a candidate; a candidate has a doubt."""
        return "site" if self.doubt is None else "candidate"

    @property
    def position_world(self) -> F64:
        """Position, (3,) metres."""
        return np.array([self.east, self.north, self.up])

    def moved(self, shift: F64) -> Site:
        """Return the site and its view moved by `shift`, (3,) metres."""
        east, north, up = (float(v) for v in shift)
        look = self.look
        if look is not None:
            look = replace(look, east=look.east + east, north=look.north + north, up=look.up + up)
        return replace(self, east=self.east + east, north=self.north + north, up=self.up + up, look=look)


@dataclass(frozen=True)
class Sites:
    """Result of the search: ranked sites, then ranked candidates; without a site, the reason."""

    sites: tuple[Site, ...]
    reason: str = ""  # the reason why `sites` is empty
    frame_id: int = 0  # map number of the map that was searched
    candidates: tuple[Site, ...] = ()  # refused by no limit, but P(safe) is too low
    ground_judged: bool = True  # False: P(safe) is that of the shape alone

    @property
    def listed(self) -> tuple[Site, ...]:
        """Sites and candidates in order of rank."""
        return self.sites + self.candidates

    def moved(self, shift: F64) -> Sites:
        """Return the sites and candidates moved by `shift`, (3,) metres."""
        sites, candidates = (tuple(s.moved(shift) for s in part) for part in (self.sites, self.candidates))
        return replace(self, sites=sites, candidates=candidates)


@dataclass(frozen=True, eq=False)
class Waypoint:
    """Point of a route."""

    name: str
    position_world: F64  # (3,) metres
    heading: float  # rad, clockwise from north
    speed: float  # m/s, on the leg that ends here
    t: float  # s from the start of the route
    look: bool = False  # whether the ground is judged again from here


@dataclass(frozen=True)
class Route:
    """Way-points to the best site."""

    waypoints: tuple[Waypoint, ...]
    warnings: tuple[str, ...] = field(default=())
    frame_id: int = 0  # map number of the map used for planning


def p_safe_text(p: float) -> str:
    """Format P(safe) with three decimals, 0.620 or 0.987; never round up to 1."""
    return "> 0.999" if p > 0.9995 else f"{p:.3f}"
