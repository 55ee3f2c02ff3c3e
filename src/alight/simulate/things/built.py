"""Things that people put there: houses, cars, crates and litter."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from alight.kernels import stamps
from alight.kernels.stamps import BLUE, EXTRA, HALF_U, HALF_V, LOOK, REACH, RED, TOP, TURN
from alight.records import F64, Terrain
from alight.simulate.looks import Look
from alight.simulate.things.base import Between, CoverName, LookName, Scattered, Sheet, Tint

if TYPE_CHECKING:
    from alight.simulate.tiles import Lay

Generator = np.random.Generator
PAINTS: tuple[Tint, ...] = (
    (0.9, 0.9, 0.87), (0.45, 0.46, 0.48), (0.13, 0.13, 0.14), (0.04, 0.04, 0.045), (0.5, 0.04, 0.03),
    (0.04, 0.09, 0.35), (0.16, 0.24, 0.16), (0.6, 0.5, 0.25),
)  # fmt: skip
ROOFS: tuple[Tint, ...] = ((1.0, 1.0, 1.0), (0.8, 0.75, 0.75), (1.15, 1.1, 1.0), (0.65, 0.7, 0.75))
LITTER: tuple[Tint, ...] = ((0.8, 0.6, 0.35), (1.0, 1.0, 1.0), (0.08, 0.2, 0.55), (0.4, 0.3, 0.15), (0.15, 0.15, 0.15))


class Boxes(Scattered):
    """What has vertical sides."""

    turn_deg: float | None = Field(None, description="of the long side, counter-clockwise from east; none: at random")
    tints: tuple[Tint, ...] = Field((), description="factors [[red, green, blue], ...] on the look, to draw from")
    apart: bool = Field(True, description="random ones keep clear of the things of earlier layers that are apart too")

    @property
    def founded(self) -> bool:
        """Stands on the highest ground under it."""
        return True

    def turns(self, rng: Generator, count: int) -> F64:
        """Random turns, or the one asked for; drawn in any case, so that the rest stays."""
        turns = rng.uniform(0.0, 2.0 * math.pi, count)
        return turns if self.turn_deg is None else np.full(count, math.radians(self.turn_deg))

    def paint(self, rng: Generator, things: F64, look: Look, otherwise: tuple[Tint, ...]) -> None:
        """Draw a tint for each."""
        palette = np.array(self.tints or otherwise)
        things[:, RED : BLUE + 1] = palette[rng.integers(len(palette), size=len(things))]
        things[:, LOOK] = look

    def boxes(self, sheet: Sheet, lay: Lay, kind: int) -> None:
        """Stamp all that reach the sheet."""
        things = lay.things(sheet.box)
        if len(things):
            stamps.stamp_boxes(
                sheet.x[0], sheet.y[:, 0], sheet.cell, things, kind, Terrain.STRUCTURE,
                sheet.height, sheet.label, sheet.depth, sheet.look, sheet.tint,
            )  # fmt: skip


class Houses(Boxes):
    """Houses with a gable, hip or flat roof and a chimney."""

    thing: Literal["houses"]
    length: Between = Field((8.0, 12.0), description="metres along the ridge")
    width: Between = Field((6.0, 8.0), description="metres across")
    walls: Between = Field((2.8, 5.5), description="metres to the eaves")
    roof: Literal["gable", "hip", "flat"] = Field("gable", description="gable | hip | flat (with a parapet)")
    look: LookName = Field(Look.ROOF_TILES, description="of a pitched roof: roof_tiles | roof_slate | roof_metal")
    pitch_deg: float = Field(40.0, gt=0.0, le=60.0, description="slope of the roof")

    @property
    def largest(self) -> float:
        """Half the diagonal."""
        return 0.5 * math.hypot(self.length[1], self.width[1])

    @property
    def rise(self) -> tuple[float, float]:
        """Walls, roof, chimney."""
        return 0.0, self.walls[1] + 0.5 * self.width[1] * math.tan(math.radians(self.pitch_deg)) + 0.5

    def draw(self, rng: Generator, things: F64) -> None:
        """A plan, the walls and a roof of one colour."""
        n = len(things)
        things[:, HALF_U], things[:, HALF_V] = 0.5 * rng.uniform(*self.length, n), 0.5 * rng.uniform(*self.width, n)
        things[:, TOP], things[:, TURN] = rng.uniform(*self.walls, n), self.turns(rng, n)
        things[:, EXTRA] = 0.4 if self.roof == "flat" else math.tan(math.radians(self.pitch_deg))
        things[:, REACH] = np.hypot(things[:, HALF_U], things[:, HALF_V])
        self.paint(rng, things, Look.FLAT_ROOF if self.roof == "flat" else self.look, ROOFS)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Walls and roofs."""
        self.boxes(sheet, lay, {"gable": stamps.GABLE, "hip": stamps.HIP, "flat": stamps.FLAT}[self.roof])


class Cars(Boxes):
    """Parked cars."""

    thing: Literal["cars"]
    length: Between = Field((3.7, 4.9), description="metres")
    width: Between = Field((1.65, 1.9), description="metres")
    height: Between = Field((1.4, 1.75), description="metres")
    on: tuple[CoverName, ...] = Field(("paved", "bare"), description="classes of ground where random ones may stand")

    @property
    def largest(self) -> float:
        """Half the diagonal."""
        return 0.5 * math.hypot(self.length[1], self.width[1])

    @property
    def rise(self) -> tuple[float, float]:
        """The tallest."""
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """A size and a paint."""
        n = len(things)
        things[:, HALF_U], things[:, HALF_V] = 0.5 * rng.uniform(*self.length, n), 0.5 * rng.uniform(*self.width, n)
        things[:, TOP], things[:, TURN] = rng.uniform(*self.height, n), self.turns(rng, n)
        things[:, REACH] = np.hypot(things[:, HALF_U], things[:, HALF_V])
        self.paint(rng, things, Look.PAINT, PAINTS)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Bodies and cabins."""
        self.boxes(sheet, lay, stamps.CAR)


class Crates(Boxes):
    """Crates, pallets, barrels' stand-ins, litter: small boxes in many colours."""

    thing: Literal["crates"]
    size: Between = Field((0.3, 1.2), description="metres, of a side")
    height: Between = Field((0.15, 1.0), description="metres")
    on: tuple[CoverName, ...] = Field(("bare", "short_grass", "paved"), description="classes of ground for random ones")

    @property
    def largest(self) -> float:
        """Half the diagonal."""
        return 0.71 * self.size[1]

    @property
    def rise(self) -> tuple[float, float]:
        """The tallest."""
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Two sides and a height."""
        n = len(things)
        things[:, HALF_U], things[:, HALF_V] = 0.5 * rng.uniform(*self.size, n), 0.5 * rng.uniform(*self.size, n)
        things[:, TOP], things[:, TURN] = rng.uniform(*self.height, n), self.turns(rng, n)
        things[:, REACH] = np.hypot(things[:, HALF_U], things[:, HALF_V])
        self.paint(rng, things, Look.PAINT, LITTER)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Flat tops."""
        self.boxes(sheet, lay, stamps.FLAT)
