"""Narrow or shallow water: canals, rivers and ditches, often covered with plants, and puddles."""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from alight.arrays import F64, Mask
from alight.records import Terrain
from alight_sim.looks import Look
from alight_sim.relief import noise
from alight_sim.things.base import UNTINTED, CoverName, LookName, Sheet, Tint, ramp, terrain_named
from alight_sim.things.cover import Outline
from alight_sim.things.lines import PIECE, Lined, pieces, winding

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

LOWEST, EVEN = 11, 31  # pieces: windows of the lowest ground along the water, and of the smoothing of its height
EDGE = 0.04  # metres of the bank's foot above the water
FREEBOARD = 0.8  # share of `below` to which low ground beside the water is raised


def above(field: F64, share: float) -> F64:
    """Return a normally distributed field of unit deviation minus the threshold that a `share` of it exceeds."""
    return np.asarray(field - NormalDist().inv_cdf(min(max(1.0 - share, 1e-6), 1.0 - 1e-6)))


class Canals(Lined):
    """A canal, a river or a ditch: water below its banks, open or under floating plants, all of class water."""

    thing: Literal["canal"]
    width: float = Field(5.0, gt=0.2, le=200.0, description="metres of water from bank to bank")
    below: float = Field(0.8, ge=0.05, le=10.0, description="metres of the water below the banks")
    depth: float = Field(1.2, gt=0.0, le=20.0, description="metres of water in the middle")
    bank: float = Field(1.2, ge=0.0, le=50.0, description="metres over which the bank rises; 0: a wall")
    wander: float = Field(0.0, ge=0.0, le=50.0, description="metres by which it winds about its path")
    look: LookName = Field(Look.BY_CLASS, description="of open water: clear_water | murky_water")
    covered: float = Field(0.0, ge=0.0, le=1.0, description="share of the water under floating plants")
    cover_look: LookName = Field(Look.DUCKWEED, description="of these plants: duckweed | algae | sludge")
    cover_size: float = Field(12.0, ge=0.3, le=500.0, description="metres, of the patches of plants")
    cover_tint: Tint = Field(UNTINTED, description="factor on the plants' reflectance: a number or [red, green, blue]")
    leaves: float = Field(0.0, ge=0.0, le=1.0, description="share of the open water under floating leaves, in groups")
    shore: CoverName | None = Field("bare", description="class of the bank; null: that of the ground")
    shore_look: LookName = Field(Look.LOAM, description="look of the bank: loam, mud, concrete ...")

    @property
    def rise(self) -> tuple[float, float]:
        return self.below + 2.0, 1.0

    def reach(self) -> float:
        """Return half the width with its winding edge, plus the banks, metres."""
        return 0.6 * self.width + 3.0 * self.bank + 0.5

    def line(self, lay: Lay) -> F64:
        """Return the (N, 4) vertices at the water's height: `below` the lowest ground near by, smoothed."""
        line = pieces(self.placed, PIECE)
        if self.wander > 0.0:
            line = winding(line, self.wander, lay.seed)
        ground = lay.before(line[:, :1], line[:, 1:2]).ground[:, 0]
        low = minimum_filter1d(ground, LOWEST, mode="nearest")
        line[:, 3] = uniform_filter1d(low, EVEN, mode="nearest") - self.below
        return line

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Dig the bed, raise low ground beside it, fill it with water, and lay plants on it."""
        ways = self.ways(sheet, lay)
        if ways is None:
            return
        aside, level = ways[..., 0], ways[..., 2]
        edge = 0.06 * self.width * noise(sheet.x, sheet.y, lay.seed + 1, 7.0, 0.5, 0.6) if self.bank > 0.0 else 0.0
        half = np.maximum(0.5 * self.width + np.clip(edge, -0.2 * self.width, 0.2 * self.width), 0.1)
        away = np.abs(aside) - half
        near = np.abs(aside) < self.reach()
        wet = (away < 0.0) & near
        banks = np.maximum(sheet.ground, level + FREEBOARD * self.below)
        far = ramp(self.bank, 3.0 * self.bank + 0.2, away)
        rising = level + EDGE + ramp(0.0, max(self.bank, 1e-6), away) * (banks - level - EDGE)
        dry = (1.0 - far) * rising + far * sheet.ground
        sheet.ground[:] = np.where(wet, level, np.where(near, dry, sheet.ground))
        r = np.minimum(np.abs(aside) / half, 1.0)
        sheet.depth[:] = np.where(wet, np.maximum(self.depth * (1.0 - r * r), 0.02), sheet.depth)
        bare = near & ~wet & (away < 0.8 * self.bank + 0.15)
        if self.shore is not None:
            sheet.paint(..., bare, terrain_named(self.shore), self.shore_look)
        sheet.paint(..., wet, Terrain.WATER, self.look)
        self._plants(sheet, lay, wet)

    def _plants(self, sheet: Sheet, lay: Lay, wet: Mask) -> None:
        if self.leaves > 0.0:
            groups = above(noise(sheet.x, sheet.y, lay.seed + 2, 5.0, 1.0), min(2.0 * self.leaves, 1.0))
            single = above(noise(sheet.x, sheet.y, lay.seed + 3, 0.5, 0.3), 0.5)
            sheet.paint(..., wet & (groups > 0.0) & (single > 0.0), Terrain.WATER, Look.DUCKWEED, (0.7, 0.75, 0.8))
        if self.covered > 0.0:
            field = noise(sheet.x, sheet.y, lay.seed + 4, self.cover_size, min(0.3, self.cover_size), 0.7)
            floating = wet & (above(field, self.covered) > 0.0)
            sheet.paint(..., floating, Terrain.WATER, self.cover_look, self.cover_tint)


class Puddles(Outline):
    """Standing water in hollows of a metre or more, with a margin of mud or of wet ground.

    Mud gives way under a lander, so it has the class water too. List puddles before layers that make the ground rough:
    they are as level as the ground below them.
    """

    thing: Literal["puddles"]
    size: float = Field(4.0, gt=0.1, le=1000.0, description="metres, the longest waves of the outline")
    deep: float = Field(0.08, gt=0.0, le=2.0, description="metres of water in the middle")
    sunk: float = Field(0.04, ge=0.0, le=1.0, description="metres of the water below the ground around")
    mud: float = Field(0.0, ge=0.0, le=1.0, description="width of the margin of mud, in deviations of the outline")
    mud_look: LookName = Field(Look.MUD, description="look of that mud")
    wet: float = Field(0.0, ge=0.0, le=1.0, description="width of the margin of ground that is only wet, likewise")
    upon: tuple[CoverName, ...] = Field(("short_grass", "bare", "paved"), description="classes of ground to lie on")

    @property
    def rise(self) -> tuple[float, float]:
        return self.sunk, 0.0

    def field(self, sheet: Sheet, lay: Lay) -> F64:
        """Return (R, C) smooth noise of unit deviation, whose level line is the outline."""
        return noise(sheet.x, sheet.y, lay.seed, self.size, 0.2 * self.size, 1.2)

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Sink the ground, fill it, and paint the margins."""
        excess = self.excess(sheet, lay)
        inside = excess > 0.0
        margin = above(self.field(sheet, lay), self.share)
        open_ground = np.isin(sheet.label, [terrain_named(k) for k in self.upon])
        sheet.ground -= np.where(open_ground, self.sunk * ramp(-0.5, 0.0, margin), 0.0)
        damp = open_ground & ~inside & (margin > -self.mud - self.wet)
        sheet.tint[damp] *= 0.6
        if self.mud > 0.0:
            sheet.paint(..., open_ground & ~inside & (margin > -self.mud), Terrain.WATER, self.mud_look, self.tint)
        sheet.depth[inside] = np.maximum(self.deep * ramp(0.0, 0.7, excess), 0.01)[inside]
        sheet.paint(..., inside, Terrain.WATER, self.look, self.tint)
