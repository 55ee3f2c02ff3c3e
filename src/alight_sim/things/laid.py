"""Things that people lay down or leave: bars and pipes in bundles or standing from a slab, plastic sheets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64
from alight.records import Terrain
from alight_sim.kernels import stamps
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.relief import noise
from alight_sim.things.base import Between, CoverName, Sheet, along_and_across
from alight_sim.things.built import Boxes, stamp

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator
OPEN: tuple[CoverName, ...] = ("bare", "short_grass", "paved")
THINNEST = 0.71  # cells, half the thickness of a bar: thinner ones would fall between the cells
DRAPED = 0.8  # metres above the ground up to which a sheet lies over things


class Bars(Boxes):
    """Bundles and stacks of bars, pipes, poles or planks; or rows of bars on end, as rebar stands from a slab."""

    thing: Literal["bars"]
    length: Between = Field((3.0, 6.0), description="metres")
    thickness: Between = Field((0.012, 0.03), description="metres; drawn no thinner than a cell")
    count: Between = Field((5.0, 20.0), description="how many side by side")
    rows: int = Field(1, ge=1, le=10, description="layers on top of each other, each with one less than that below")
    gap: float | None = Field(None, gt=0.0, le=10.0, description="metres from middle to middle; none: they touch")
    upright: bool = Field(False, description="on end")
    upon: tuple[CoverName, ...] = Field(OPEN, description="classes of ground for random ones")

    @property
    def largest(self) -> float:
        """Half the diagonal of the largest bundle with a margin, metres."""
        long = 0.0 if self.upright else self.length[1]
        return 0.6 * math.hypot(long, math.ceil(self.count[1]) * (self.gap or self.thickness[1]))

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of the tallest stack or of bars on end, metres."""
        return 0.0, self.length[1] if self.upright else self.rows * self.thickness[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the length, thickness and number of bars, the turn and the tint of each bundle."""
        n = len(things)
        length, thick = rng.uniform(*self.length, n), rng.uniform(*self.thickness, n)
        things[:, Column.HALF_U] = 0.5 * (thick if self.upright else length)
        things[:, Column.HALF_V], things[:, Column.TOP] = 0.5 * thick, length if self.upright else thick
        things[:, Column.EXTRA], things[:, Column.TURN] = np.rint(rng.uniform(*self.count, n)), self.turns(rng, n)
        things[:, Column.REACH] = np.hypot(
            things[:, Column.HALF_U], 0.5 * things[:, Column.EXTRA] * (self.gap or thick)
        )
        self.paint(rng, things, Look.PAINT, "steel")

    def parts(self, rng: Generator, things: F64) -> F64:
        """Return the bars (M, COLUMNS) of all bundles."""
        found = [np.empty((0, things.shape[1]))]
        for row in range(self.rows):
            count = np.maximum(things[:, Column.EXTRA] - row, 0.0).astype(np.int64)
            out = np.repeat(things, count, axis=0)
            number = np.arange(len(out)) - np.repeat(np.cumsum(count) - count, count)
            thick, n = 2.0 * out[:, Column.HALF_V], len(out)
            aside = (number - 0.5 * np.repeat(count - 1, count)) * (self.gap or thick)
            aside += 0.1 * thick * rng.normal(size=n)
            along = 0.04 * out[:, Column.HALF_U] * rng.normal(size=n)
            dx, dy = np.cos(out[:, Column.TURN]), np.sin(out[:, Column.TURN])
            out[:, Column.EAST] += along * dx - aside * dy
            out[:, Column.NORTH] += along * dy + aside * dx
            out[:, Column.LEVEL] += 0.87 * row * thick
            out[:, Column.TURN] += 0.3 * thick / np.maximum(out[:, Column.HALF_U], 0.5) * rng.normal(size=n)
            out[:, Column.EXTRA], out[:, Column.REACH] = 0.0, np.hypot(out[:, Column.HALF_U], out[:, Column.HALF_V])
            out[:, Column.RED : Column.BLUE + 1] *= np.exp(0.15 * rng.normal(size=n))[:, None]
            found.append(out)
        return np.concatenate(found)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp the bars, at least as thick as a cell."""
        things = lay.things(sheet.box)
        things[:, [Column.HALF_U, Column.HALF_V]] = np.maximum(
            things[:, [Column.HALF_U, Column.HALF_V]], THINNEST * sheet.cell
        )
        stamp(sheet, things, stamps.Roof.FLAT)


class Tarpaulins(Boxes):
    """Plastic sheets and tarpaulins, flat or with folds, over the ground and what lies on it."""

    thing: Literal["tarpaulins"]
    size: Between = Field((1.5, 5.0), description="metres, of the long side")
    width: Between | None = Field(None, description="metres, of the short side; without it as `size`")
    folds: float = Field(0.03, ge=0.0, le=0.5, description="metres, height of the folds")
    upon: tuple[CoverName, ...] = Field(OPEN, description="classes of ground for random ones")
    apart: bool = Field(False, description="random ones keep clear of the things of earlier layers that are apart too")

    @property
    def largest(self) -> float:
        """Half the diagonal of the largest tarpaulin with a margin, metres."""
        return 0.75 * max(self.size[1], self.width[1] if self.width else 0.0)

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of things under a tarpaulin plus that of its folds, metres."""
        return 0.0, DRAPED + 3.0 * self.folds

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw both sides, the turn and the tint of each tarpaulin."""
        n = len(things)
        things[:, Column.HALF_U] = 0.5 * rng.uniform(*self.size, n)
        things[:, Column.HALF_V] = 0.5 * rng.uniform(*(self.width or self.size), n)
        things[:, Column.TURN] = self.turns(rng, n)
        things[:, Column.REACH] = 1.05 * np.hypot(things[:, Column.HALF_U], things[:, Column.HALF_V])
        self.paint(rng, things, Look.PAINT, "plastic")

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Lay the tarpaulins over the ground and low things, with random creases and wandering edges."""
        for thing in lay.things(sheet.box):
            index, dx, dy = sheet.near(thing[Column.EAST], thing[Column.NORTH], thing[Column.REACH])
            if not dx.size:
                continue
            u, v = along_and_across(dx, dy, thing[Column.TURN])
            edge = (
                0.04
                * min(thing[Column.HALF_U], thing[Column.HALF_V])
                * noise(sheet.x[index], sheet.y[index], lay.seed, 2.0, 1.0)
            )
            crease = noise(u + 7.0 * thing[Column.EAST], v + 7.0 * thing[Column.NORTH], lay.seed + 1, 1.2, 0.25, 0.8)
            crease = np.maximum(1.0 - np.abs(crease), 0.0)
            inside = np.maximum(np.abs(u) - thing[Column.HALF_U], np.abs(v) - thing[Column.HALF_V]) < edge
            inside &= (sheet.height[index] < sheet.ground[index] + DRAPED) & (sheet.label[index] != Terrain.TREE)
            sheet.height[index] += np.where(inside, 0.01 + self.folds * crease**2, 0.0)
            sheet.depth[index] = np.where(inside, 0.0, sheet.depth[index])
            sheet.paint(index, inside, Terrain.STRUCTURE, Look.PAINT, thing[Column.RED : Column.BLUE + 1])
