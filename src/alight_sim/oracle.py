"""Safety of touchdowns of the true lander on the true surface, by brute force. Shares no code with site selection.

The surface is bilinear between the world's cell centres, so above any plane it is highest at cell centres. It includes
moving objects at their positions at the given time. Metres, radians, headings clockwise from north.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, U8, Mask
from alight.geometry import Pose
from alight.records import Terrain
from alight_sim.movers import Moving
from alight_sim.resting import resting_on_feet, resting_on_skids
from alight_sim.spans import TrueSpans
from alight_sim.things.base import Box
from alight_sim.world import World

BEARS = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED, Terrain.ROCK)
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))  # rad: headings at this step cover any symmetry of the gear
ASIDE = ("headings", "support", "foot_contact")  # settings of a map alone: here all is tried on the highest ground
_RIM = 8  # points on the rim of a foot
_BATCH = 4_000_000  # heights evaluated at once


@dataclass(frozen=True)
class OracleLander:
    """The vehicle that touches down. Without feet and skids it stands on its whole footprint."""

    radius: float = 1.5  # of the footprint
    max_slope: float = math.radians(10.0)  # of the plane on which it stands
    max_roughness: float = 0.15  # largest deviation from the footprint's plane; unused if gear has a clearance
    belly_clearance: float | None = None  # from the plane of the feet to the belly
    feet: tuple[tuple[float, float], ...] | None = None  # forward, left of each
    foot_radius: float = 0.0
    skids: tuple[float, float] | None = None  # length, distance
    max_step: float | None = None  # between neighbouring cells of the footprint; None: limited by the roughness alone
    rotor_radius: float | None = None  # None: within the footprint
    rotor_rise: float = 0.3  # largest height of objects beside the footprint above the plane
    max_sink: float = 1.0  # m/s
    max_drift: float = 0.5  # m/s over the ground
    upon: tuple[Terrain, ...] = BEARS  # classes that bear the lander

    @classmethod
    def of(cls, numbers: Mapping[str, Any], **more: Any) -> OracleLander:
        """Build a lander from a mapping of its fields, such as dumped settings; `more`: further fields.

        Keys in `ASIDE` are ignored.
        """
        return cls(**{k: v for k, v in numbers.items() if k not in ASIDE}, **more)

    @property
    def reach(self) -> float:
        """Radius about the centre within which the ground is judged, metres."""
        feet = max((math.hypot(*f) for f in self.feet or ()), default=0.0) + self.foot_radius
        skids = 0.5 * math.hypot(*self.skids) if self.skids else 0.0
        return max(self.radius, self.rotor_radius or 0.0, feet, skids)


@dataclass(frozen=True, eq=False)
class TrueSurface:
    """A part of the world with all objects on it at one time."""

    east: float  # of the centre of cell (0, 0), south-west
    north: float
    cell: float
    height: F64  # (R, C) metres, rows to the north
    label: U8  # (R, C) Terrain codes
    spans: TrueSpans = field(default_factory=TrueSpans)  # over it

    @classmethod
    def of(cls, world: World, box: Box, seconds: float | None = None, bodies: Sequence[Moving] = ()) -> TrueSurface:
        """Return the surface of a box (west, south, east, north).

        `seconds`: time for the positions of moving objects; None: all are left out. `bodies`: moving objects besides
        those of the world.
        """
        truth = world.truth(box)
        height, label = truth.height[::-1].astype(np.float64), truth.label[::-1].copy()
        grid = truth.grid
        out = cls(grid.east, grid.north - (grid.rows - 1) * grid.cell, grid.cell, height, label, truth.spans)
        for mover in (*world.movers, *bodies) if seconds is not None else ():
            for body in mover.boxes_at(np.array([seconds]))[0]:
                out._stand(body)
        return out

    def _stand(self, body: F64) -> None:
        rows, cols = self.height.shape
        dx = self.east + self.cell * np.arange(cols)[None] - body[0]
        dy = self.north + self.cell * np.arange(rows)[:, None] - body[1]
        spare = 0.5 * self.cell  # at least the cells of which it covers half
        along, across = body[3] * dx + body[4] * dy, body[3] * dy - body[4] * dx
        under = (np.abs(along) <= body[5] + spare) & (np.abs(across) <= body[6] + spare) & (body[7] > 0)
        self.height[under] = np.maximum(self.height[under], body[2] + body[7])
        self.label[under] = Terrain.STRUCTURE

    def index(self, places: F64) -> tuple[F64, F64]:
        """Return the fractional row and column of positions (..., 2) east, north."""
        rows, cols = self.height.shape
        row, col = (places[..., 1] - self.north) / self.cell, (places[..., 0] - self.east) / self.cell
        return np.clip(row, 0.0, rows - 1.0), np.clip(col, 0.0, cols - 1.0)

    def heights(self, places: F64) -> F64:
        """Return the (...) bilinear heights at positions (..., 2), metres."""
        row, col = self.index(places)
        i = np.minimum(row.astype(np.int64), self.height.shape[0] - 2)
        j = np.minimum(col.astype(np.int64), self.height.shape[1] - 2)
        v, u, h = row - i, col - j, self.height
        low, high = (1 - u) * h[i, j] + u * h[i, j + 1], (1 - u) * h[i + 1, j] + u * h[i + 1, j + 1]
        return np.asarray((1 - v) * low + v * high)

    def labels(self, places: F64) -> U8:
        """Return the (...) class of the cell nearest to positions (..., 2)."""
        row, col = self.index(places)
        return np.asarray(self.label[np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)])


class Disc(NamedTuple):
    """The cell centres around each of N positions, padded to the same number M."""

    forward: F64  # (N, M) from the position, in body axes at the heading
    left: F64
    height: F64
    label: U8
    inside: Mask  # within the radius


@dataclass(frozen=True, eq=False)
class Touchdown:
    """Judgement of one touchdown."""

    safe: bool
    reasons: tuple[str, ...]  # broken limits: slope, roughness, step, belly, rotor, ground, wire, sink, drift
    tilt: float  # rad, of the plane on which it stands; the largest if it rocks
    belly_gap: float  # metres from the belly (without clearance: the plane of the feet) to the ground below
    roughness: float  # metres, largest deviation from the footprint's least-squares plane
    rotor_rise: float  # metres, largest height beside the footprint above the plane, within the rotor; or -inf
    sink: float  # m/s
    drift: float  # m/s
    east: float
    north: float


@dataclass(frozen=True, eq=False)
class SafePlaces:
    """Safety of touchdowns at centres on a grid, each at several headings."""

    east: F64  # (C,) metres
    north: F64  # (R,) metres
    headings: F64  # (H,) rad clockwise from north
    safe_at: NDArray[np.bool_]  # (R, C, H)

    @property
    def safe(self) -> Mask:
        """(R, C) True for centres that are safe at every heading."""
        return np.asarray(self.safe_at.all(axis=2))

    @property
    def possible(self) -> Mask:
        """(R, C) True for centres that are safe at one heading or more."""
        return np.asarray(self.safe_at.any(axis=2))

    def with_margin(self, margin: float) -> Mask:
        """Return the (R, C) mask of centres with no unsafe centre within `margin` metres; beyond the grid all are."""
        step = float(self.east[1] - self.east[0]) if len(self.east) > 1 else math.inf
        k = math.floor(margin / step + 1e-9)
        padded = np.pad(self.safe, k, constant_values=False)
        out = self.safe.copy()
        for a in range(-k, k + 1):
            for b in range(-k, k + 1):
                if math.hypot(a, b) * step <= margin + 1e-9:
                    out &= padded[k + a : k + a + out.shape[0], k + b : k + b + out.shape[1]]
        return out


def judge_touchdown(
    world: World,
    lander: OracleLander,
    pose: Pose,
    velocity_world: Sequence[float] | F64 = (0.0, 0.0, 0.0),
    seconds: float = 0.0,
    bodies: Sequence[Moving] = (),
) -> Touchdown:
    """Judge a touchdown: the lander at its point of contact, with its heading and velocity.

    Args:
        world: the ground and its moving objects.
        lander: gear and limits of the lander.
        pose: `world_from_body` at the contact; only its heading and horizontal position are used.
        velocity_world: (3,) m/s just before the contact.
        seconds: time of the flight, for the positions of moving objects.
        bodies: moving objects that appeared on command (`SteeredFlight.bodies`).
    """
    east, north = float(pose.translation[0]), float(pose.translation[1])
    heading = math.atan2(pose.rotation[0, 0], pose.rotation[1, 0])
    spare = lander.reach + 3.0 * world.cell
    surface = TrueSurface.of(world, (east - spare, north - spare, east + spare, north + spare), seconds, bodies)
    found = _judged(surface, lander, np.array([[east, north]]), heading)
    sink, drift = -float(velocity_world[2]), math.hypot(velocity_world[0], velocity_world[1])
    reasons = [name for name, wrong in found.wrong.items() if wrong[0]]
    reasons += ["sink"] if sink > lander.max_sink else []
    reasons += ["drift"] if drift > lander.max_drift else []
    return Touchdown(
        not reasons, tuple(reasons), float(found.tilt[0]), float(found.gap[0]), float(found.roughness[0]),
        float(found.rise[0]), sink, drift, east, north,
    )  # fmt: skip


def safe_places(
    world: World,
    area: Box,
    lander: OracleLander,
    *,
    step: float = 0.5,
    headings: int = 4,
    seconds: float | None = None,
) -> SafePlaces:
    """Judge touchdowns at centres `step` metres apart in an area (west, south, east, north); see `judge_touchdown`.

    Args:
        headings: number of headings, a golden angle apart; a lander without gear is judged at one heading only.
        seconds: time for the positions of the world's movers; None: they are left out.
    """
    west, south, right, top = area
    e, n = np.arange(west, right + 1e-9, step), np.arange(south, top + 1e-9, step)
    spare = lander.reach + 3.0 * world.cell
    surface = TrueSurface.of(world, (west - spare, south - spare, right + spare, top + spare), seconds)
    turns = np.mod(GOLDEN_ANGLE * np.arange(headings if lander.feet or lander.skids else 1), 2.0 * np.pi)
    centres = np.stack(np.meshgrid(e, n), -1).reshape(-1, 2)
    size = max(1, _BATCH // max(1, round((2.0 * lander.reach / world.cell + 2) ** 2)))
    safe = np.zeros((len(centres), len(turns)), bool)
    for first in range(0, len(centres), size):
        for k, turn in enumerate(turns):
            part = _judged(surface, lander, centres[first : first + size], float(turn))
            safe[first : first + size, k] = ~np.any(list(part.wrong.values()), axis=0)
    return SafePlaces(e, n, turns, safe.reshape(len(n), len(e), len(turns)))


class _Found(NamedTuple):
    tilt: F64  # (N,)
    gap: F64
    roughness: F64
    rise: F64
    wrong: dict[str, Mask]


def _judged(surface: TrueSurface, lander: OracleLander, centres: F64, heading: float) -> _Found:
    """Judge touchdowns at centres (N, 2) and one heading (rad) against all limits except sink and drift."""
    disc = _disc(surface, centres, lander.radius, heading)
    plane, roughness = _fitted(disc)
    planes, contact = plane[:, None], disc.label
    firm = np.isin(disc.label, lander.upon) | ~disc.inside
    if lander.feet is not None or lander.skids is not None:
        at, height, contact = _contacts(surface, lander, centres, heading)
        planes = resting_on_feet(at, height) if lander.feet is not None else resting_on_skids(at, height)
        firm = np.isin(contact, lander.upon)
    tilt = np.arctan(np.hypot(planes[..., 1], planes[..., 2])).max(axis=1)
    gap = (lander.belly_clearance or 0.0) - _highest_above(disc, planes)
    rise = np.full(len(centres), -math.inf)
    if lander.rotor_radius is not None and lander.rotor_radius > lander.radius:
        ring = _disc(surface, centres, lander.rotor_radius, heading)
        beyond = ring.inside & (ring.forward**2 + ring.left**2 > lander.radius**2)
        rise = _highest_above(ring._replace(inside=beyond), planes)
    step = np.zeros(len(centres)) if lander.max_step is None else _largest_step(surface, centres, lander.radius)
    clear = lander.belly_clearance
    has_gear = lander.feet is not None or lander.skids is not None
    wrong = {
        "slope": tilt > lander.max_slope,
        "roughness": roughness > lander.max_roughness if clear is None or not has_gear else np.zeros(len(tilt), bool),
        "step": step > (math.inf if lander.max_step is None else lander.max_step),
        "belly": gap < 0.0 if clear is not None else np.zeros(len(tilt), bool),
        "rotor": rise > lander.rotor_rise,
        "ground": ~firm.all(axis=1),
        "wire": surface.spans.near(centres, lander.reach),
    }
    return _Found(tilt, gap, roughness, rise, wrong)


def _cells(
    surface: TrueSurface, centres: F64, radius: float, beside: tuple[int, int] = (0, 0)
) -> tuple[F64, F64, F64, U8, Mask]:
    """Return the cells around centres (N, 2): east and north of the centre, height, class, and a mask, each (N, M).

    Args:
        radius: metres; the mask is true for cells whose centre is within it.
        beside: rows and columns by which all cells are shifted, to compare them with their neighbours.
    """
    k = math.ceil(radius / surface.cell) + 1
    row, col = surface.index(centres)
    steps = np.arange(-k, k + 1)
    a, b = (g.ravel() for g in np.meshgrid(steps, steps, indexing="ij"))
    near = np.hypot(a, b) * surface.cell <= radius + 1.5 * surface.cell
    i = np.rint(row).astype(np.int64)[:, None] + a[near] + beside[0]
    j = np.rint(col).astype(np.int64)[:, None] + b[near] + beside[1]
    rows, cols = surface.height.shape
    there = (i >= 0) & (i < rows) & (j >= 0) & (j < cols)
    i, j = np.clip(i, 0, rows - 1), np.clip(j, 0, cols - 1)
    east = surface.east + surface.cell * j - centres[:, :1]
    north = surface.north + surface.cell * i - centres[:, 1:]
    inside = there & (east**2 + north**2 <= radius**2 + 1e-9)
    return east, north, surface.height[i, j], surface.label[i, j], inside


def _disc(surface: TrueSurface, centres: F64, radius: float, heading: float) -> Disc:
    east, north, height, label, inside = _cells(surface, centres, radius)
    s, c = math.sin(heading), math.cos(heading)
    return Disc(s * east + c * north, s * north - c * east, height, label, inside)


def _largest_step(surface: TrueSurface, centres: F64, radius: float) -> F64:
    """Return the (N,) largest step between neighbouring cells of discs of `radius` (m) at centres (N, 2), metres."""
    _, _, here, _, inside = _cells(surface, centres, radius)
    worst = np.zeros(len(centres))
    for beside in ((1, 0), (0, 1)):
        _, _, there, _, within = _cells(surface, centres, radius, beside)
        worst = np.maximum(worst, np.where(inside & within, np.abs(there - here), 0.0).max(axis=1))
    return worst


def _fitted(disc: Disc) -> tuple[F64, F64]:
    """Return (N, 3) least-squares planes (height at the centre, slopes forward, left) and (N,) largest deviations."""
    w = disc.inside.astype(np.float64)
    base = np.average(disc.height, axis=1, weights=w)[:, None]
    terms = np.stack([np.ones_like(w), disc.forward, disc.left], -1)
    normal = np.einsum("nm,nmi,nmj->nij", w, terms, terms)
    right = np.einsum("nm,nmi,nm->ni", w, terms, disc.height - base)
    plane = np.linalg.solve(normal, right[..., None])[..., 0]
    off = np.abs(disc.height - base - np.einsum("nmi,ni->nm", terms, plane))
    plane[:, 0] += base[:, 0]
    return plane, np.where(disc.inside, off, 0.0).max(axis=1)


def _highest_above(disc: Disc, planes: F64) -> F64:
    """Return the (N,) largest height of a cell above any of P planes (N, P, 3), metres; -inf: no cell is inside."""
    worst = np.full(len(planes), -math.inf)
    for k in range(planes.shape[1]):
        p = planes[:, k, :, None]
        above = disc.height - p[:, 0] - p[:, 1] * disc.forward - p[:, 2] * disc.left
        worst = np.maximum(worst, np.where(disc.inside, above, -math.inf).max(axis=1))
    return worst


def _contacts(surface: TrueSurface, lander: OracleLander, centres: F64, heading: float) -> tuple[F64, F64, U8]:
    """Return (K, 2) contact points (forward, left), (N, K) highest ground under each, and (N, L) classes there."""
    s, c = math.sin(heading), math.cos(heading)
    if lander.feet is not None:
        at, spread = np.array(lander.feet, float), lander.foot_radius
    else:
        assert lander.skids is not None
        length, wide = lander.skids
        along = np.linspace(-0.5 * length, 0.5 * length, 2 * math.ceil(length / surface.cell) + 1)
        at, spread = (
            np.concatenate([np.column_stack([along, np.full(len(along), k * 0.5 * wide)]) for k in (1, -1)]),
            0.0,
        )
    places = centres[:, None] + np.column_stack([s * at[:, 0] - c * at[:, 1], c * at[:, 0] + s * at[:, 1]])
    height, label = surface.heights(places), surface.labels(places)
    if spread > 0:
        turns = 2.0 * math.pi * np.arange(_RIM) / _RIM
        rim = places[:, :, None] + spread * np.column_stack([np.cos(turns), np.sin(turns)])
        height = np.maximum(height, surface.heights(rim).max(axis=2))
        label = np.concatenate([label, surface.labels(rim).reshape(len(centres), -1)], axis=1)
        for k in range(len(at)):
            foot = _disc(surface, places[:, k], spread, 0.0)
            height[:, k] = np.maximum(height[:, k], np.where(foot.inside, foot.height, -math.inf).max(axis=1))
    return at, height, label
