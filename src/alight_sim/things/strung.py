"""Things with parts in the air: wires from post to post, masts with guys, trees with bare branches."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64
from alight.records import Terrain
from alight_sim.kernels import stamps
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.spans import TrueSpans
from alight_sim.things.base import Between, Box, Layer, LookName, Scattered, Sheet, Tint, blank_things
from alight_sim.things.built import stamp
from alight_sim.things.lines import Lined

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator
ARM = 0.4  # thickness of a cross-arm over that of its post
UP = np.array([0.0, 0.0, 1.0])
STRANDS = 24  # wires of a line, at most


def footed(places: F64, lay: Lay) -> F64:
    """Return positions (N, 2), moved to cell centres so that thin posts keep their height, with the ground: (N, 3)."""
    cell = lay.stack.cell
    middle = (np.floor(places / cell) + 0.5) * cell
    if not len(middle):
        return np.zeros((0, 3))
    return np.column_stack([middle, lay.stack.ground(middle[:, :1], middle[:, 1:]).ground])


def posts(feet: F64, height: F64 | float, thickness: float, look: Look, tint: Tint, cell: float) -> F64:
    """Return (N, COLUMNS) upright boxes at the feet (N, 3).

    `height`: metres, one or (N,). `thickness`: metres, at least one `cell` is used. `tint`: factor on the look.
    """
    things = blank_things(feet[:, :2])
    half = 0.5 * max(thickness, cell)
    things[:, Column.LEVEL], things[:, Column.TOP], things[:, Column.HALF_U], things[:, Column.HALF_V] = (
        feet[:, 2],
        height,
        half,
        half,
    )
    things[:, Column.REACH], things[:, Column.LOOK], things[:, Column.RED : Column.BLUE + 1] = (
        math.hypot(half, half),
        look,
        tint,
    )
    return things


class Strung(Layer):
    """Wires strung between the tops of posts."""

    wires: int = Field(3, ge=1, le=STRANDS, description="side by side or one below the other")
    spacing: float = Field(
        0.8, ge=0.0, le=10.0, description="metres sideways from wire to wire, on a cross-arm; 0: none"
    )
    drop: float = Field(0.0, ge=0.0, le=10.0, description="metres down from wire to wire: a fence")
    diameter: float = Field(0.02, ge=0.001, le=0.2, description="metres, of a wire")
    sag: float = Field(0.02, ge=0.0, le=0.2, description="of the length from post to post, at the middle")
    colour: Tint = Field((0.30, 0.30, 0.31), description="reflectance of the wires")
    post: float = Field(0.25, ge=0.0, le=3.0, description="metres, thickness of a post; 0: wires without posts")
    post_look: LookName = Field(Look.PAINT, description="look of the posts")
    post_tint: Tint = Field((0.30, 0.26, 0.21), description="factor on that look's reflectance")

    def string(self, tops: F64, aside: F64) -> TrueSpans:
        """Return the wires and cross-arms between pairs of post tops (N, 2, 3).

        `aside`: (N, 2, 2) horizontal unit vectors along the cross-arm at each top.
        """
        out, length = [], np.linalg.norm(tops[:, 1] - tops[:, 0], axis=1)
        for k in range(self.wires):
            ends = tops.copy()
            ends[..., :2] += (k - 0.5 * (self.wires - 1)) * self.spacing * aside
            ends[..., 2] -= k * self.drop
            wire = TrueSpans.of(
                ends[:, 0], ends[:, 1], sag=self.sag * length, diameter=self.diameter, colour=self.colour
            )
            out.append(wire)
        if self.wires > 1 and self.spacing > 0.0 and self.post > 0.0:
            arms = np.repeat(tops.reshape(-1, 1, 3), 2, axis=1)
            half = 0.5 * (self.wires - 1) * self.spacing * aside.reshape(-1, 2)
            arms[:, 0, :2] -= half
            arms[:, 1, :2] += half
            arms = np.unique(arms.reshape(-1, 6), axis=0)  # two pairs share a post
            out.append(TrueSpans.of(arms[:, :3], arms[:, 3:], sag=0.0, diameter=ARM * self.post, colour=self.post_tint))
        return TrueSpans.joined(out)

    def plant(self, sheet: Sheet, lay: Lay, feet: F64, height: F64 | float) -> None:
        """Stamp posts at the feet (N, 3); `height`: metres, one or (N,)."""
        if self.post > 0.0:
            stamp(
                sheet, posts(feet, height, self.post, self.post_look, self.post_tint, lay.stack.cell), stamps.Roof.FLAT
            )


class PowerLine(Lined, Strung):
    """Wires on posts along a path: a power line, a telephone wire, lamps, a fence."""

    thing: Literal["power_line"]
    posts: float = Field(40.0, ge=0.5, le=500.0, description="metres from post to post, about")
    post_height: float = Field(9.0, gt=0.0, le=80.0, description="metres")

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of the posts, metres."""
        return 0.0, self.post_height

    def feet(self, lay: Lay) -> F64:
        """Return the (N, 3) feet of the posts: at the corners of the path, and evenly between them."""
        corners = self.placed
        legs = [
            a + np.linspace(0.0, 1.0, max(1, round(math.dist(a, b) / self.posts)) + 1)[:-1, None] * (b - a)
            for a, b in pairwise(corners)
        ]
        places = np.concatenate([*legs, corners[-1:]])
        return lay.keep("feet", lambda: footed(places, lay))

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp the posts."""
        self.plant(sheet, lay, self.feet(lay), self.post_height)

    def hang(self, box: Box, lay: Lay) -> TrueSpans:
        """Return all wires of the line."""
        return TrueSpans(lay.keep("spans", lambda: self._all(lay).table))

    def _all(self, lay: Lay) -> TrueSpans:
        tops = self.feet(lay) + self.post_height * UP
        ahead = np.gradient(tops[:, :2], axis=0)
        aside = ahead[:, ::-1] * (1.0, -1.0) / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
        return self.string(np.stack([tops[:-1], tops[1:]], axis=1), np.stack([aside[:-1], aside[1:]], axis=1))


class WashingLine(Scattered, Strung):
    """Wires between two posts: a washing line; higher and longer, a telephone wire; without posts, between houses."""

    thing: Literal["washing_line"]
    length: Between = Field((4.0, 8.0), description="metres from post to post")
    height: Between = Field((1.8, 2.2), description="metres of the posts")
    turn_deg: float | None = Field(None, description="of the wires, counter-clockwise from east; none: at random")
    spacing: float = Field(0.35, ge=0.0, le=10.0, description="metres sideways from wire to wire, on a cross-arm")
    diameter: float = Field(0.005, ge=0.001, le=0.2, description="metres, of a wire")
    colour: Tint = Field((0.6, 0.6, 0.58), description="reflectance of the wires")
    post: float = Field(0.06, ge=0.0, le=3.0, description="metres, thickness of a post; 0: wires without posts")

    @property
    def largest(self) -> float:
        """Half the longest wire plus half a cross-arm, metres."""
        return 0.5 * self.length[1] + 0.5 * self.wires * self.spacing

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of the tallest post, metres."""
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the length, height and turn of each washing line."""
        n = len(things)
        things[:, Column.HALF_U], things[:, Column.TOP] = (
            0.5 * rng.uniform(*self.length, n),
            rng.uniform(*self.height, n),
        )
        turns = rng.uniform(0.0, math.pi, n)
        things[:, Column.TURN] = turns if self.turn_deg is None else math.radians(self.turn_deg)
        things[:, Column.REACH] = self.largest

    def _feet(self, things: F64, lay: Lay) -> F64:
        """Return the (N, 2, 3) feet of both posts of each washing line."""
        half = things[:, Column.HALF_U, None] * np.column_stack(
            [np.cos(things[:, Column.TURN]), np.sin(things[:, Column.TURN])]
        )
        middle = things[:, [Column.EAST, Column.NORTH]]
        return footed(np.stack([middle - half, middle + half], axis=1).reshape(-1, 2), lay).reshape(-1, 2, 3)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp the posts."""
        things = lay.things(sheet.box)
        self.plant(sheet, lay, self._feet(things, lay).reshape(-1, 3), np.repeat(things[:, Column.TOP], 2))

    def hang(self, box: Box, lay: Lay) -> TrueSpans:
        """Return the wires of the washing lines that reach into a box."""
        things = lay.things(box)
        tops = self._feet(things, lay)
        tops[..., 2] += things[:, Column.TOP, None]
        aside = np.column_stack([-np.sin(things[:, Column.TURN]), np.cos(things[:, Column.TURN])])
        return self.string(tops, np.repeat(aside[:, None], 2, axis=1))


class GuyedMast(Scattered):
    """A mast with guys from several heights down to the ground."""

    thing: Literal["guyed_mast"]
    height: Between = Field((10.0, 30.0), description="metres")
    thickness: float = Field(0.3, gt=0.0, le=3.0, description="metres")
    guys: int = Field(3, ge=2, le=8, description="directions in which it is guyed")
    levels: int = Field(2, ge=1, le=8, description="heights from which guys start, the top among them")
    spread: float = Field(0.6, ge=0.1, le=2.0, description="distance of the anchors from the mast, over its height")
    diameter: float = Field(0.012, ge=0.001, le=0.2, description="metres, of a guy")
    sag: float = Field(0.01, ge=0.0, le=0.2, description="of a guy's length, at its middle")
    colour: Tint = Field((0.35, 0.35, 0.36), description="reflectance of the guys")
    look: LookName = Field(Look.PAINT, description="look of the mast")
    tint: Tint = Field((0.5, 0.5, 0.5), description="factor on that look's reflectance")

    @property
    def largest(self) -> float:
        """Distance of the farthest anchors from their mast, metres."""
        return self.spread * self.height[1]

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of the tallest mast, metres."""
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the height and turn of each mast."""
        n = len(things)
        things[:, Column.TOP], things[:, Column.TURN] = rng.uniform(*self.height, n), rng.uniform(0.0, 2.0 * math.pi, n)
        things[:, Column.REACH] = self.spread * things[:, Column.TOP]

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp the masts."""
        things = lay.things(sheet.box)
        feet = footed(things[:, [Column.EAST, Column.NORTH]], lay)
        stamp(
            sheet,
            posts(feet, things[:, Column.TOP], self.thickness, self.look, self.tint, lay.stack.cell),
            stamps.Roof.FLAT,
        )

    def hang(self, box: Box, lay: Lay) -> TrueSpans:
        """Return the guys of the masts that reach into a box."""
        out = []
        for thing in lay.things(box):
            (foot,) = footed(thing[None, [Column.EAST, Column.NORTH]], lay)
            turns = thing[Column.TURN] + 2.0 * math.pi * np.arange(self.guys) / self.guys
            anchors = footed(foot[:2] + thing[Column.REACH] * np.column_stack([np.cos(turns), np.sin(turns)]), lay)
            for share in np.arange(1, self.levels + 1) / self.levels:
                top = np.tile(foot + share * thing[Column.TOP] * UP, (self.guys, 1))
                sag = self.sag * np.linalg.norm(top - anchors, axis=1)
                out.append(TrueSpans.of(top, anchors, sag=sag, diameter=self.diameter, colour=self.colour))
        return TrueSpans.joined(out)


class Branches(Scattered):
    """A tree without leaves: a trunk, and branches through which the ground is seen."""

    thing: Literal["branches"]
    height: Between = Field((4.0, 9.0), description="metres, of the trunk")
    reach: Between = Field((2.0, 4.0), description="metres that branches reach from the trunk")
    count: int = Field(9, ge=1, le=60, description="branches; each has three twigs")
    diameter: Between = Field((0.01, 0.05), description="metres, [of twigs, of branches at the trunk]")
    thickness: float = Field(0.25, gt=0.0, le=3.0, description="metres, of the trunk")
    colour: Tint = Field((0.16, 0.13, 0.10), description="reflectance of the branches")
    apart: bool = Field(True, description="random ones keep clear of the things of earlier layers that are apart too")

    @property
    def largest(self) -> float:
        """Reach of the longest branch with its twigs, metres."""
        return 1.3 * self.reach[1]

    @property
    def rise(self) -> tuple[float, float]:
        """No lowering, and the height of the tallest trunk, metres."""
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the height and reach of each tree, and the seed of its branches."""
        n = len(things)
        things[:, Column.TOP], things[:, Column.HALF_U] = rng.uniform(*self.height, n), rng.uniform(*self.reach, n)
        things[:, Column.EXTRA], things[:, Column.REACH] = rng.integers(2**31, size=n), 1.3 * things[:, Column.HALF_U]

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp the trunks."""
        things = lay.things(sheet.box)
        feet = footed(things[:, [Column.EAST, Column.NORTH]], lay)
        trunks = posts(feet, things[:, Column.TOP], self.thickness, Look.SOIL, (0.8, 0.8, 0.8), lay.stack.cell)
        stamp(sheet, trunks, stamps.Roof.FLAT, Terrain.TREE)

    def hang(self, box: Box, lay: Lay) -> TrueSpans:
        """Return the branches of the trees that reach into a box."""
        things = lay.things(box)
        feet = footed(things[:, [Column.EAST, Column.NORTH]], lay)
        return TrueSpans.joined(self._grow(thing, foot) for thing, foot in zip(things, feet, strict=True))

    def _grow(self, thing: F64, foot: F64) -> TrueSpans:
        """Return the branches of a tree at `foot` (3,): each has two spans, the outer one thinner, and three twigs."""
        rng, n, (thin, thick) = np.random.default_rng(int(thing[Column.EXTRA])), self.count, self.diameter
        turn = 2.4 * np.arange(n) + rng.normal(0.0, 0.3, n)  # about the golden angle, as branches stand
        start = foot + np.outer(rng.uniform(0.4, 1.0, n) * thing[Column.TOP], UP)
        length, climb = thing[Column.HALF_U] * rng.uniform(0.6, 1.0, n), rng.uniform(-0.15, 0.6, n)
        way = length[:, None] * np.column_stack([np.cos(turn), np.sin(turn), climb])
        middle, tip = start + 0.5 * way, start + way + np.outer(-0.1 * length, UP)
        ends = [(start, middle, thick), (middle, tip, 0.5 * (thin + thick))]
        for share in (0.35, 0.55, 0.75):
            bud = start + share * way
            aside = rng.choice((-0.7, 0.7), n) + rng.normal(0.0, 0.2, n)
            twig = np.column_stack([np.cos(turn + aside), np.sin(turn + aside), rng.uniform(-0.2, 0.5, n)])
            ends.append((bud, bud + (0.4 * length * rng.uniform(0.5, 1.0, n))[:, None] * twig, thin))
        return TrueSpans.joined(TrueSpans.of(a, b, sag=0.0, diameter=d, colour=self.colour) for a, b, d in ends)
