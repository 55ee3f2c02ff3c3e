"""Standing things of rounded shape: rocks, trees, shrubs, mounds, logs."""

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
from alight_sim.things.base import (
    UNTINTED,
    Between,
    CoverName,
    LookName,
    Scattered,
    Sheet,
    Tint,
    power_law,
    terrain_named,
)

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator
PLANTABLE: tuple[CoverName, ...] = ("bare", "short_grass", "tall_vegetation")


class Dome(Scattered):
    """Things of rounded shape."""

    look: LookName = Field(Look.BY_CLASS, description="look; without it that of the class")
    tint: Tint = Field(UNTINTED, description="factor on the look's reflectance: a number or [red, green, blue]")
    shades: float = Field(0.25, ge=0.0, le=1.0, description="how much one differs from the next in brightness")

    def paint(self, rng: Generator, things: F64) -> None:
        """Set the look, and draw a brightness for each thing."""
        shade = np.exp(0.5 * self.shades * rng.standard_normal(len(things)))
        things[:, Column.RED : Column.BLUE + 1] = np.array(self.tint) * shade[:, None]
        things[:, Column.LOOK] = self.look

    def domes(
        self, sheet: Sheet, lay: Lay, kind: int, look: tuple[float, float, float, float], shape: int, rooted: bool
    ) -> None:
        """Stamp all things that reach the sheet as domes; see `kernels.stamps.stamp_domes` (`look` is its `form`)."""
        things = lay.things(sheet.box)
        if len(things):
            stamps.stamp_domes(
                sheet.x[0], sheet.y[:, 0], sheet.cell, things, np.array(look), int(shape), int(kind), rooted, lay.seed,
                sheet.ground, sheet.height, sheet.label, sheet.depth, sheet.look, sheet.tint,
            )  # fmt: skip


def drawn_evenly(rng: Generator, between: Between, count: int) -> F64:
    """Draw (count,) uniform random numbers between two limits."""
    return np.asarray(rng.uniform(*between, count))


class Rocks(Dome):
    """Rocks and boulders, half buried: many small, few large."""

    thing: Literal["rocks"]
    radius: Between = Field((0.2, 0.9), description="metres, [smallest, largest]; stones below 2 cells are not heights")
    exponent: float = Field(
        2.0, ge=0.0, le=6.0, description="the number above a radius goes with it to the power -this"
    )
    flatness: Between = Field((0.5, 0.9), description="height above the ground over the radius")
    upon: tuple[CoverName, ...] = Field(PLANTABLE, description="classes of ground where random ones may lie")

    @property
    def largest(self) -> float:
        """Radius of the largest rock with its ragged rim, metres."""
        return 1.3 * self.radius[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius of each rock by the power law, its turn, width and height."""
        n = len(things)
        radius = power_law(rng, self.radius, self.exponent, n)
        things[:, Column.TURN] = rng.uniform(0.0, math.pi, n)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = radius, radius * rng.uniform(0.6, 1.0, n)
        things[:, Column.TOP] = radius * drawn_evenly(rng, self.flatness, n)
        things[:, Column.EXTRA] = 0.06 * radius
        things[:, Column.REACH] = 1.3 * radius
        self.paint(rng, things)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        self.domes(sheet, lay, Terrain.ROCK, (0.12, 1.0, 0.25, 0.06), stamps.DomeShape.ELLIPSOID, rooted=False)


class Trees(Dome):
    """Trees: crowns of clumps of leaves with holes between them; the ground below the crowns is not visible."""

    thing: Literal["trees"]
    radius: Between = Field((1.6, 3.2), description="metres, of the crown")
    height: Between | None = Field(None, description="metres; without it 1.7 to 2.6 times the radius")
    form: Literal["round", "conifer", "bare"] = Field("round", description="round | conifer (a cone) | bare (twigs)")
    upon: tuple[CoverName, ...] = Field(PLANTABLE, description="classes of ground where random ones may grow")
    apart: bool = Field(True, description="random ones keep clear of the things of earlier layers that are apart too")

    @property
    def largest(self) -> float:
        """Radius of the largest crown with its clumps and ragged rim, metres."""
        return 1.5 * self.radius[1]

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, (self.height[1] if self.height else 2.6 * self.radius[1]) + 1.5

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius and height of each tree."""
        n = len(things)
        radius, tall = drawn_evenly(rng, self.radius, n), rng.uniform(1.7, 2.6, n)
        if self.height is not None:
            tall = drawn_evenly(rng, self.height, n) / radius
        things[:, Column.HALF_U], things[:, Column.HALF_V] = radius, radius * rng.uniform(0.85, 1.0, n)
        things[:, Column.TURN], things[:, Column.TOP] = rng.uniform(0.0, math.pi, n), tall * radius
        things[:, Column.EXTRA], things[:, Column.REACH] = 0.1, 1.3 * radius
        self.paint(rng, things)

    def parts(self, rng: Generator, things: F64) -> F64:
        """Return the clumps of each crown: balls in the upper part of an ellipsoid; a conifer is one cone."""
        if self.form == "conifer" or not len(things):
            return things
        count = np.clip((4.0 + 3.0 * things[:, Column.HALF_U]).astype(np.int64), 6, 24) * (
            3 if self.form == "bare" else 1
        )
        out = np.repeat(things, count, axis=0)
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        n = len(out)
        turn, lift = rng.uniform(0.0, 2.0 * math.pi, n), rng.uniform(-0.25, 1.0, n)
        far = rng.uniform(0.45, 0.75, n)
        lift[first], far[first] = 1.0, 0.62  # one clump is the top
        aside = far * np.sqrt(1.0 - lift**2)
        ball = out[:, Column.HALF_U] * rng.uniform(0.28, 0.46, n) * (0.45 if self.form == "bare" else 1.0)
        half = 0.36 * out[:, Column.TOP]  # half the ellipsoid's height; its middle is this far below the top
        out[:, Column.EAST] += aside * out[:, Column.HALF_U] * np.cos(turn)
        out[:, Column.NORTH] += aside * out[:, Column.HALF_V] * np.sin(turn)
        upper = np.minimum(half, 1.2 * ball)  # a clump is not much higher than wide
        out[:, Column.LEVEL] += out[:, Column.TOP] - half + lift * (half - upper)
        out[:, Column.TOP], out[:, Column.HALF_U] = upper, ball
        out[:, Column.HALF_V] = ball * rng.uniform(0.75, 1.0, n)
        out[:, Column.REACH] = 1.5 * ball
        out[:, Column.RED : Column.BLUE + 1] *= np.exp(0.12 * rng.standard_normal(n))[:, None]
        return out

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        if self.form == "conifer":
            self.domes(sheet, lay, Terrain.TREE, (0.12, 3.0, 0.5, 0.14), stamps.DomeShape.CONE, rooted=True)
        else:
            self.domes(sheet, lay, Terrain.TREE, (0.0, 1.0, 0.45, 0.17), stamps.DomeShape.ELLIPSOID, rooted=True)


class Shrubs(Dome):
    """Bushes, brambles, hedge plants: tall vegetation, ragged."""

    thing: Literal["shrubs"]
    radius: Between = Field((0.3, 1.2), description="metres")
    exponent: float = Field(
        1.0, ge=0.0, le=6.0, description="the number above a radius goes with it to the power -this"
    )
    tall: Between = Field((0.7, 1.4), description="height over radius")
    upon: tuple[CoverName, ...] = Field(PLANTABLE, description="classes of ground where random ones may grow")

    @property
    def largest(self) -> float:
        """Radius of the largest shrub with its ragged rim, metres."""
        return 1.5 * self.radius[1]

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.5 * self.radius[1] * self.tall[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius of each shrub by the power law, and its height."""
        n = len(things)
        radius = power_law(rng, self.radius, self.exponent, n)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = radius, radius * rng.uniform(0.7, 1.0, n)
        things[:, Column.TURN] = rng.uniform(0.0, math.pi, n)
        things[:, Column.TOP] = radius * drawn_evenly(rng, self.tall, n)
        things[:, Column.EXTRA], things[:, Column.REACH] = 0.12 * radius, 1.5 * radius
        self.paint(rng, things)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        look = (0.2, 1.0, 0.35, 0.14)
        self.domes(sheet, lay, Terrain.TALL_VEGETATION, look, stamps.DomeShape.ELLIPSOID, rooted=False)


class Mounds(Dome):
    """Molehills, tussocks, heaps of gravel, bales: low domes of a named class or of the ground's class."""

    thing: Literal["mounds"]
    radius: Between = Field((0.2, 0.6), description="metres")
    height: Between = Field((0.08, 0.25), description="metres")
    kind: CoverName | None = Field(None, description="class; without it that of the ground")
    form: Literal["round", "cone", "drum"] = Field("round", description="round | cone | drum (a bale, a tank)")

    @property
    def largest(self) -> float:
        """Radius of the largest mound with its ragged rim, metres."""
        return 1.3 * self.radius[1]

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.3 * self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius and height of each mound."""
        n = len(things)
        radius = drawn_evenly(rng, self.radius, n)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = radius, radius
        things[:, Column.TOP], things[:, Column.REACH] = drawn_evenly(rng, self.height, n), 1.3 * radius
        things[:, Column.EXTRA] = np.minimum(0.1 * things[:, Column.TOP], 0.04)
        self.paint(rng, things)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        kind = -1 if self.kind is None else int(terrain_named(self.kind))
        shape = {"round": stamps.DomeShape.ELLIPSOID, "cone": stamps.DomeShape.CONE, "drum": stamps.DomeShape.DRUM}[
            self.form
        ]
        ragged = 0.0 if self.form == "drum" else 0.07
        self.domes(sheet, lay, kind, (0.1, 1.0 if ragged else 0.0, 0.2, ragged), shape, rooted=self.form == "drum")


class Logs(Dome):
    """Felled trunks and thick branches."""

    thing: Literal["logs"]
    length: Between = Field((2.0, 7.0), description="metres")
    thickness: Between = Field((0.2, 0.6), description="metres")
    look: LookName = Field(Look.SOIL, description="look of the bark")

    @property
    def largest(self) -> float:
        """Half the length of the longest log with a margin, metres."""
        return 0.6 * self.length[1]

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.1 * self.thickness[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the length, thickness and turn of each log."""
        n = len(things)
        thick = drawn_evenly(rng, self.thickness, n)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = 0.5 * drawn_evenly(rng, self.length, n), 0.5 * thick
        things[:, Column.TOP], things[:, Column.TURN] = thick, rng.uniform(0.0, math.pi, n)
        things[:, Column.REACH] = 1.2 * things[:, Column.HALF_U]
        self.paint(rng, things)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        self.domes(sheet, lay, Terrain.TREE, (0.5, 0.0, 0.3, 0.0), stamps.DomeShape.ELLIPSOID, rooted=False)
