"""Cover of the ground: patches of another class, tall grass, crops in rows."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtr, ndtri

from alight.arrays import F64, Mask
from alight.records import Terrain
from alight_sim.looks import Look
from alight_sim.materials import table
from alight_sim.relief import noise
from alight_sim.section import Side
from alight_sim.things.base import (
    UNTINTED,
    Box,
    CoverName,
    Layer,
    LookName,
    Sheet,
    Tint,
    along_and_across,
    ramp,
    terrain_named,
)

if TYPE_CHECKING:
    from alight_sim.tiles import Lay


class Outline(Layer):
    """Cover of a share of the ground, in patches outlined by noise."""

    share: float = Field(0.15, ge=0.0, le=1.0, description="of the ground that may be covered")
    size: float = Field(10.0, gt=0.1, le=1000.0, description="metres, the longest waves of the outline")
    look: LookName = Field(Look.BY_CLASS, description="look; without it that of the class")
    tint: Tint = Field(UNTINTED, description="factor on the look's reflectance: a number or [red, green, blue]")
    upon: tuple[CoverName, ...] = Field(("short_grass",), description="classes of ground that may be covered")
    within: Box | None = Field(None, description="[west, south, east, north]: only in this box")

    def field(self, sheet: Sheet, lay: Lay) -> F64:
        """Return the (R, C) noise of unit deviation whose level line is the outline."""
        return noise(sheet.x, sheet.y, lay.seed, self.size, min(0.2, self.size), 0.8)

    def excess(self, sheet: Sheet, lay: Lay) -> F64:
        """Return `field` minus the threshold that a `share` of it exceeds, (R, C); negative: not covered."""
        excess = self.field(sheet, lay) - NormalDist().inv_cdf(min(max(1.0 - self.share, 1e-6), 1.0 - 1e-6))
        open_ground = np.isin(sheet.label, [terrain_named(k) for k in self.upon])
        if self.within is not None:
            west, south, east, north = self.within
            open_ground &= (sheet.x >= west) & (sheet.x <= east) & (sheet.y >= south) & (sheet.y <= north)
        return np.where(open_ground, excess, -1.0)


class Patches(Outline):
    """Patches of another class, look or height: open earth, snow that is left, hummocks, bunkers, clefts."""

    thing: Literal["patches"]
    kind: CoverName | None = Field("bare", description="class; null: that of the ground, only the look changes")
    up: float = Field(0.0, ge=-10.0, le=10.0, description="metres above the ground around; negative: below it")
    flank: float = Field(0.3, gt=0.0, le=4.0, description="width of their slopes, in deviations of the outline")
    finest: float = Field(0.2, ge=0.05, le=100.0, description="metres, the shortest waves of the outline")
    veins: bool = Field(False, description="the seams between patches instead: clefts, cracks, ridges of ice")

    @property
    def rise(self) -> tuple[float, float]:
        """Depth and height of the patches; one of them is 0. Metres."""
        return max(-self.up, 0.0), max(self.up, 0.0)

    def field(self, sheet: Sheet, lay: Lay) -> F64:
        """Return (R, C) noise of unit deviation; for veins, it is largest where the noise for patches is near zero."""
        field = noise(sheet.x, sheet.y, lay.seed, self.size, min(self.finest, self.size), 0.8)
        return np.asarray(ndtri(2.0 * ndtr(-np.abs(field))) if self.veins else field)

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Change class, look and height in the patches."""
        excess = self.excess(sheet, lay)
        if self.up != 0.0:
            sheet.ground += self.up * ramp(0.0, self.flank, excess)
            sheet.depth[excess > 0.0] = 0.0
        kind = terrain_named(self.kind) if self.kind is not None else None
        sheet.paint(..., excess > 0.0, kind, self.look, self.tint)


class TallGrass(Outline):
    """Grass, reed or weeds in tufts, in patches or everywhere (share: 1)."""

    thing: Literal["tall_grass"]
    share: float = Field(0.28, ge=0.0, le=1.0, description="of the ground that may be covered")
    size: float = Field(14.0, gt=0.1, le=1000.0, description="metres, the longest waves of the outline")
    height: float = Field(0.55, gt=0.0, le=4.0, description="metres, tallest tufts")
    shallower: float = Field(0.3, ge=0.0, le=5.0, description="metres of water that it still grows in, where `upon` it")
    tuft: float = Field(0.3, gt=0.02, le=5.0, description="metres from tuft to tuft")
    tall_from: float = Field(
        0.12,
        ge=0.0,
        le=4.0,
        description="metres: lower blades are of the ground's class, though they look and stand so",
    )

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.4 * self.height

    def cover(self, sheet: Sheet, lay: Lay) -> None:
        """Raise tufts, which are lower at the rim of a patch."""
        excess = self.excess(sheet, lay)
        mask = (excess > 0.0) & (sheet.height <= sheet.ground) & (sheet.depth <= self.shallower)
        tufts = self._lie(sheet, lay)
        rim = ramp(0.0, 0.25, excess)
        blades = self.height * rim * np.clip(0.45 + 0.22 * tufts, 0.04, 1.0)
        sheet.height[mask], sheet.depth[mask] = (sheet.ground + blades)[mask], 0.0
        usual = Look.TALL_GRASS if self.look == Look.BY_CLASS and self.tall_from > 0.0 else self.look
        sheet.paint(..., mask, None, usual, self.tint)
        sheet.label[mask & (blades >= self.tall_from)] = Terrain.TALL_VEGETATION

    def _lie(self, sheet: Sheet, lay: Lay) -> F64:
        """Return (R, C) noise of unit deviation for the height of the grass: tufts, swathes and streaks."""
        bend = noise(sheet.x, sheet.y, lay.seed + 32, 30.0 * self.tuft, 10.0 * self.tuft)
        u, v = along_and_across(sheet.x, sheet.y, lay.seed % 628 * 0.01)
        swathe = noise(u, 2.0 * v + 3.0 * self.tuft * bend, lay.seed + 33, 12.0 * self.tuft, 4.0 * self.tuft, 0.5)
        streak = noise(0.6 * u, 2.0 * v + 3.0 * self.tuft * bend, lay.seed + 34, self.tuft, 0.3 * self.tuft, 0.2)
        tufts = noise(sheet.x, sheet.y, lay.seed + 31, 2.0 * self.tuft, 0.4 * self.tuft, 0.4)
        return 0.5 * swathe + 0.55 * streak + 0.67 * tufts


class Crop(Layer):
    """Crop of one parcel of the fields."""

    kind: CoverName = Field("tall_vegetation", description="class of the plants, or of the ground where height is 0")
    soil: CoverName = Field("bare", description="class between the rows")
    height: float = Field(0.0, ge=0.0, le=4.0, description="metres, of the plants")
    spacing: float = Field(0.75, gt=0.05, le=20.0, description="metres from row to row")
    width: float = Field(0.5, ge=0.0, le=1.0, description="share of the spacing that the plants cover")
    ridge: float = Field(0.0, ge=0.0, le=1.0, description="metres from furrow to ridge")
    look: LookName = Field(Look.BY_CLASS, description="of the plants; without it that of the class")
    soil_look: LookName = Field(Look.BY_CLASS, description="between the rows")
    tint: Tint = Field(UNTINTED, description="factor on the plants' reflectance: a number or [red, green, blue]")


CROPS = tuple(Crop(**crop) for crop in table("crops"))


class Fields(Layer):
    """A patchwork of parcels with crops in rows and strips of grass between them; or one field in a box."""

    thing: Literal["fields"]
    parcel: tuple[Side, Side] = Field((60.0, 35.0), description="metres [along, across]; the rows run along")
    turn_deg: float = Field(20.0, description="of the rows, counter-clockwise from east")
    border: float = Field(1.5, ge=0.0, le=50.0, description="metres of grass between two parcels")
    crops: tuple[Crop, ...] = Field(CROPS, min_length=1, description="what grows, drawn for each parcel")
    upon: tuple[CoverName, ...] = Field(("short_grass", "bare"), description="classes of ground that are farmed")
    within: Box | None = Field(None, description="[west, south, east, north]: only in this box")

    @property
    def rise(self) -> tuple[float, float]:
        return max(c.ridge for c in self.crops), max(c.ridge + 1.4 * c.height for c in self.crops)

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Raise the furrows' ridges, paint the soil, and paint the crops whose height is 0."""
        which, across = sheet.notes[lay.index] = self._parcels(sheet, lay)
        for k, crop in enumerate(self.crops):
            mask = which == k
            if not mask.any():
                continue
            phase = across / crop.spacing
            sheet.ground[mask] += (0.5 * crop.ridge * np.cos(2.0 * math.pi * phase))[mask]
            planted = mask & self._in_row(crop, phase)
            sheet.paint(..., mask, terrain_named(crop.soil), crop.soil_look)
            if crop.height == 0.0:
                sheet.paint(..., planted, terrain_named(crop.kind), crop.look, crop.tint)

    def cover(self, sheet: Sheet, lay: Lay) -> None:
        """Raise the plants of all crops whose height is above 0."""
        which, across = sheet.notes[lay.index]
        for k, crop in enumerate(self.crops):
            if crop.height == 0.0 or not (which == k).any():
                continue
            gap = noise(sheet.x, sheet.y, lay.seed + 7, 0.5, 0.15, 0.3)
            mask = (which == k) & self._in_row(crop, across / crop.spacing + 0.06 * gap) & (gap > -2.2)
            mask &= sheet.height <= sheet.ground
            mask &= noise(sheet.x, sheet.y, lay.seed + 8, 5.0, 0.4, 0.5) > -1.7  # bare spots without plants
            grown = 0.8 + 0.12 * gap + 0.08 * noise(sheet.x, sheet.y, lay.seed + 9, 15.0, 4.0)
            sheet.height[mask] = (sheet.ground + crop.height * np.clip(grown, 0.2, 1.3))[mask]
            sheet.paint(..., mask, terrain_named(crop.kind), crop.look, crop.tint)

    @staticmethod
    def _in_row(crop: Crop, phase: F64) -> Mask:
        return np.asarray(np.abs(phase - np.floor(phase + 0.5)) <= 0.5 * crop.width)

    def _parcels(self, sheet: Sheet, lay: Lay) -> tuple[NDArray[np.int64], F64]:
        """Return the (R, C) index of the crop at each position (-1: no crop), and the (R, C) metres across the rows."""
        u, v = along_and_across(sheet.x, sheet.y, math.radians(self.turn_deg))
        # rows are not quite straight
        v = v + 0.6 * noise(sheet.x, sheet.y, lay.seed + 3, 90.0, 40.0) + 0.05 * noise(u, v, lay.seed + 4, 9.0, 2.0)
        j = np.floor(v / self.parcel[1]).astype(np.int64)
        shifted = u / self.parcel[0] + 0.37 * j
        i = np.floor(shifted).astype(np.int64)
        edge_u = (0.5 - np.abs(shifted - i - 0.5)) * self.parcel[0]
        edge_v = (0.5 - np.abs(v / self.parcel[1] - j - 0.5)) * self.parcel[1]
        which = lay.choose(i, j, len(self.crops))
        farmed = (np.minimum(edge_u, edge_v) > 0.5 * self.border) & self._open(sheet)
        return np.where(farmed, which, -1), v

    def _open(self, sheet: Sheet) -> Mask:
        open_ground = np.isin(sheet.label, [terrain_named(k) for k in self.upon])
        if self.within is not None:
            west, south, east, north = self.within
            open_ground &= (sheet.x >= west) & (sheet.x <= east) & (sheet.y >= south) & (sheet.y <= north)
        return open_ground
