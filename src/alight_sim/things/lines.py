"""Things along lines: roads, tracks and ruts, walls, hedges."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from alight.arrays import F64, Mask
from alight.records import Terrain
from alight_sim.kernels.layers import along_line
from alight_sim.looks import Look
from alight_sim.materials import tables
from alight_sim.relief import noise
from alight_sim.section import Coordinate
from alight_sim.things.base import (
    UNTINTED,
    CoverName,
    Layer,
    LookName,
    Places,
    Sheet,
    Tint,
    along_and_across,
    covered,
    ramp,
    terrain_named,
)

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

LONGEST = 200_000.0  # metres of a path
PIECE = 2.0  # metres between the points at which a road or a canal follows the ground's height
SMOOTH = 5  # pieces on either side over which a road smooths the ground
WHITE = 3.2  # brightness of paint over asphalt
LANE = 1.22  # metres, width of a runner's lane
WIRE = 0.9  # reflectance of ground under a wire, over the ground beside it


def _line(value: Places) -> Places:
    if len(value) < 2 or min(np.hypot(*np.diff(np.array(value), axis=0).T)) <= 0.0:
        raise ValueError("needs two places or more, each apart from the one before")
    if np.hypot(*np.diff(np.array(value), axis=0).T).sum() > LONGEST:
        raise ValueError(f"is longer than {LONGEST / 1e3:.0f} km")
    return value


Line = Annotated[Places, AfterValidator(_line)]


def pieces(corners: F64, length: float) -> F64:
    """Cut a path of corners (N, 2) into pieces of about `length` metres.

    Returns:
        Vertices, (M, 4) metres: east, north, distance along the path, height 0.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    cuts = np.linspace(0.0, along[-1], max(2, round(along[-1] / length) + 1))
    s = np.union1d(along, cuts)
    return np.column_stack(
        [np.interp(s, along, corners[:, 0]), np.interp(s, along, corners[:, 1]), s, np.zeros(len(s))]
    )


def winding(line: F64, wander: float, seed: int) -> F64:
    """Return the vertices (N, 4) of `pieces`, smoothly shifted aside by `wander` m (standard deviation)."""
    along = line[:, 2:3]
    aside = wander * noise(along, np.zeros_like(along), seed, 12.0 * wander, 4.0 * wander)
    ahead = np.gradient(line[:, :2], line[:, 2], axis=0)
    ahead /= np.hypot(*ahead.T)[:, None]
    out = line.copy()
    out[:, :2] += aside * ahead[:, ::-1] * (1.0, -1.0)
    return out


class Lined(Layer):
    """Things that follow a path."""

    path: Line = Field(description="[[east, north], ...] metres from the origin, or from `at`")
    at: tuple[Coordinate, Coordinate] = Field(
        (0.0, 0.0), description="[east, north] metres: the path counts from there"
    )
    turn_deg: float = Field(0.0, description="of the path about `at`, counter-clockwise")

    @property
    def placed(self) -> F64:
        """(N, 2) east and north of the path's corners, metres from the origin."""
        u, v = np.array(self.path).T
        return np.column_stack(along_and_across(u, v, -math.radians(self.turn_deg))) + self.at

    def reach(self) -> float:
        """Return the distance from the path within which the ground changes, metres."""
        raise NotImplementedError

    def line(self, lay: Lay) -> F64:
        """Return the vertices of the path, (N, 4) metres: east, north, distance along, height."""
        return pieces(self.placed, 1e9)

    def ways(self, sheet: Sheet, lay: Lay) -> F64 | None:
        """Return distance from the line, distance along it, and its height there at the sheet's positions, (R, C, 3).

        None: the sheet is out of reach.
        """
        west, south, east, north = sheet.box
        line, reach = lay.keep("line", lambda: self.line(lay)), self.reach()
        low, high = np.minimum(line[:-1], line[1:]), np.maximum(line[:-1], line[1:])
        near = (high[:, 0] > west - reach) & (low[:, 0] < east + reach)
        near &= (high[:, 1] > south - reach) & (low[:, 1] < north + reach)
        if not near.any():
            return None
        found = np.flatnonzero(near)
        out = np.empty((*sheet.x.shape, 3))
        # a run without holes: a piece between two near ones does no harm
        along_line(*map(np.ascontiguousarray, (sheet.x, sheet.y)), line[found[0] : found[-1] + 2], reach, out)
        return out


class Roads(Lined):
    """A road, a track or a foot-path: levelled across, smooth along, with marks or ruts."""

    thing: Literal["road"]
    width: float = Field(5.0, gt=0.0, le=60.0, description="metres")
    kind: CoverName = Field("paved", description="class")
    look: LookName = Field(Look.BY_CLASS, description="look; without it that of the class")
    tint: Tint = Field(UNTINTED, description="factor on the look's reflectance: a number or [red, green, blue]")
    level: bool = Field(True, description="level the ground across and even it out along; false: only colour it")
    bank: float = Field(2.0, ge=0.0, le=30.0, description="metres over which it blends into the ground")
    kerb: float = Field(0.0, ge=-0.5, le=1.0, description="metres that the surface is above the ground beside it")
    ragged: float = Field(0.02, ge=0.0, le=0.5, description="wandering of its edges over the width")
    marks: Literal["none", "dashed", "edges", "lanes"] = Field(
        "none", description="none | dashed | edges (with a dashed line) | lanes (of runners)"
    )
    ruts: float = Field(0.0, ge=0.0, le=0.5, description="metres, depth of two wheel tracks")
    flooded: float = Field(0.0, ge=0.0, le=1.0, description="share of the wheel tracks that stands under water")
    grass_between: bool = Field(False, description="grass between the wheel tracks")

    @property
    def rise(self) -> tuple[float, float]:
        return self.ruts + max(-self.kerb, 0.0) + 0.5, max(self.kerb, 0.0) + 0.5

    def reach(self) -> float:
        """Return half the width with ragged edges, plus the bank, metres."""
        return 0.5 * self.width * (1.0 + 4.0 * self.ragged) + self.bank + 0.1

    def line(self, lay: Lay) -> F64:
        """Return the (N, 4) vertices with the ground's heights, smoothed along the path."""
        line = pieces(self.placed, PIECE)
        heights = lay.before(line[:, :1], line[:, 1:2]).ground[:, 0]
        padded = np.pad(heights, SMOOTH, mode="edge")
        line[:, 3] = np.convolve(padded, np.full(2 * SMOOTH + 1, 1.0 / (2 * SMOOTH + 1)), "valid")
        return line

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Level the ground, colour it, and add marks and ruts."""
        ways = self.ways(sheet, lay)
        if ways is None:
            return
        aside, along, height = ways[..., 0], ways[..., 1], ways[..., 2]
        away, half = np.abs(aside), np.full(aside.shape, 0.5 * self.width)
        if self.ragged > 0.0:
            half *= 1.0 + self.ragged * noise(sheet.x, sheet.y, lay.seed, 4.0, 0.25, 0.5)
        dry = sheet.label != Terrain.WATER
        inside = (away < half) & dry
        if self.level:
            blend = ramp(0.0, max(self.bank, 1e-9), away - half)
            sheet.ground[:] = np.where(
                dry & (away < self.reach()), height + blend * (sheet.ground - height), sheet.ground
            )
        sheet.ground += np.where(dry, self.kerb * covered(half - away, sheet.cell), 0.0)
        sheet.paint(..., inside, terrain_named(self.kind), self.look, self.tint)
        self._marks(sheet, inside, aside, along)
        if self.ruts > 0.0:
            self._ruts(sheet, lay, inside, away)

    def _marks(self, sheet: Sheet, inside: Mask, aside: F64, along: F64) -> None:
        if self.marks == "none":
            return
        if self.marks == "lanes":
            sheet.tint[inside & (np.abs(aside / LANE - np.round(aside / LANE)) * LANE < 0.03)] *= WHITE
            return
        white = (np.abs(aside) < 0.07) & (along % 9.0 < 3.0)
        if self.marks == "edges":
            white |= np.abs(np.abs(aside) - 0.5 * self.width + 0.25) < 0.07
        sheet.tint[white & inside] *= WHITE

    def _ruts(self, sheet: Sheet, lay: Lay, inside: Mask, away: F64) -> None:
        gauge = min(0.78, 0.3 * self.width) + 0.08 * noise(sheet.x, sheet.y, lay.seed + 5, 8.0, 2.0)
        groove = np.maximum(1.0 - ((away - gauge) / 0.28) ** 2, 0.0)
        depth = self.ruts * (0.8 + 0.3 * noise(sheet.x, sheet.y, lay.seed + 6, 4.0, 0.5))
        sheet.ground -= np.where(inside, depth * groove, 0.0)
        if self.flooded > 0.0:
            low = NormalDist().inv_cdf(min(max(self.flooded, 1e-6), 1.0 - 1e-6))
            wet = inside & (groove > 0.35) & (noise(sheet.x, sheet.y, lay.seed + 7, 9.0, 1.5) < low)
            sheet.ground += np.where(wet, depth * (groove - 0.35), 0.0)
            sheet.depth[wet] = np.maximum(depth * (groove - 0.35), 0.01)[wet]
            sheet.paint(..., wet, Terrain.WATER, Look.STILL_WATER)
        if self.grass_between:
            green = inside & (away < gauge - 0.25)
            sheet.paint(..., green, Terrain.SHORT_GRASS)


class Walls(Lined):
    """A wall or a fence with vertical sides, at least one cell thick."""

    thing: Literal["wall"]
    height: float = Field(1.8, gt=0.0, le=50.0, description="metres above the ground")
    thickness: float = Field(0.3, gt=0.0, le=20.0, description="metres")
    posts: float = Field(0.0, ge=0.0, le=50.0, description="metres from post to post: only they stand; 0: all of it")
    wire: bool = Field(False, description="wire from post to post: of class structure, though it is hardly to be seen")
    wander: float = Field(0.0, ge=0.0, le=20.0, description="metres by which it winds about its path: a hose, a cable")
    kind: CoverName = Field("structure", description="class")
    gap: tuple[float, float] | None = Field(None, description="[from, to] metres along it that stay open: a gate")
    look: LookName = Field(Look.WALL, description="look")
    tint: Tint = Field(UNTINTED, description="factor on the look's reflectance: a number or [red, green, blue]")

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, self.height

    def reach(self) -> float:
        """Return half the thickness with a margin, metres."""
        return max(0.5 * self.thickness, 0.2) + 0.1

    def line(self, lay: Lay) -> F64:
        """Return the (N, 4) vertices of the path, or of the line that winds about it."""
        if self.wander == 0.0:
            return super().line(lay)
        return winding(pieces(self.placed, self.wander), self.wander, lay.seed)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        ways = self.ways(sheet, lay)
        if ways is None:
            return
        # a thin wall keeps its height instead of a straight edge; half a cell either side lets no ray through
        within = max(0.5 * self.thickness, 0.5001 * sheet.cell) - np.abs(ways[..., 0])
        thin = self.thickness < 3.0 * sheet.cell
        share = (within >= 0.0).astype(np.float64) if thin else covered(within, sheet.cell)
        inside = share > 0.0
        if self.gap is not None:
            inside &= (ways[..., 1] < self.gap[0]) | (ways[..., 1] > self.gap[1])
        line = inside & (share >= 0.5)
        if self.posts > 0.0:
            inside &= np.abs(ways[..., 1] % self.posts - 0.5 * self.posts) <= max(
                0.5 * self.thickness, 0.6 * sheet.cell
            )
        if self.wire:
            self._string(sheet, line & ~inside)
        rise = share * (sheet.ground + self.height - sheet.height)
        inside &= rise > 0.0
        sheet.height[inside] += rise[inside]
        inside &= share >= 0.5
        sheet.depth[inside] = 0.0
        sheet.paint(..., inside, terrain_named(self.kind), self.look, self.tint)

    @staticmethod
    def _string(sheet: Sheet, line: Mask) -> None:
        usual = tables()[1][sheet.label].astype(np.uint8)
        sheet.look[line] = np.where(sheet.look == Look.BY_CLASS, usual, sheet.look)[line]
        sheet.label[line] = Terrain.STRUCTURE
        sheet.tint[line] *= WIRE


class Hedges(Lined):
    """A hedge: tall vegetation with a ragged outline and top."""

    thing: Literal["hedge"]
    height: float = Field(1.8, gt=0.0, le=10.0, description="metres")
    width: float = Field(1.5, gt=0.0, le=20.0, description="metres")
    gap: tuple[float, float] | None = Field(None, description="[from, to] metres along it that stay open: a gate")

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.5 * self.height

    def reach(self) -> float:
        """Return half the width with its raggedness, metres."""
        return 0.9 * self.width + 0.1

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        ways = self.ways(sheet, lay)
        if ways is None:
            return
        clumps = noise(sheet.x, sheet.y, lay.seed, 0.9, 0.15, 0.4)
        r = 2.0 * np.abs(ways[..., 0]) / self.width * (1.0 + 0.13 * clumps)
        top = sheet.ground + self.height * (0.45 + 0.55 * np.sqrt(np.maximum(1.0 - r * r, 0.0)) + 0.07 * clumps)
        inside = (r < 1.0) & (top > sheet.height)
        if self.gap is not None:
            inside &= (ways[..., 1] < self.gap[0]) | (ways[..., 1] > self.gap[1])
        sheet.height[inside] = top[inside]
        sheet.depth[inside] = 0.0
        sheet.paint(..., inside, Terrain.TALL_VEGETATION, Look.BUSH)
