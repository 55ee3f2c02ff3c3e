"""Thousands of stones that follow a size-frequency law, of the ground's own material or of another."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtr

from alight.arrays import F64, Mask
from alight_sim.kernels import stones as kernel
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.materials import tables
from alight_sim.relief import noise
from alight_sim.things.base import UNTINTED, Between, CoverName, LookName, Scattered, Sheet, Tint

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator
STRETCH = 1.25  # longest axis over the diameter of the disc of equal area
RIM = 1.3  # farthest part over half the longest axis
USUAL = 0.05  # share of the ground that sets the sizes of named stones if none is given


def decay(share: float) -> float:
    """Return q(k), 1/m: decay with diameter of the share of ground under stones (Golombek and Rapp 1997).

    `share`: k, share of the ground under stones of all sizes.
    """
    return 1.79 + 0.152 / share


def share_above(diameter: float, share: float) -> float:
    """Return the share of ground under stones of `diameter` (m) or more, k exp(-q(k) D); `share`: k, see `decay`."""
    return share * math.exp(-decay(share) * diameter)


@lru_cache(64)
def _counts(share: float, size: Between) -> tuple[F64, F64]:
    """Return diameters (m) within `size`, and for each the number of larger stones per square metre; `share`: k."""
    diameter = np.geomspace(*size, 400) if size[0] < size[1] else np.array(size)
    q = decay(share)
    density = share * q * np.exp(-q * diameter) / (0.25 * math.pi * diameter**2)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(diameter)
    return diameter, np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])


class Stones(Scattered):
    """Stones whose sizes follow the law of rock fields (Golombek and Rapp 1997), partly buried.

    The share of the ground under stones of diameter D and more is k exp(-(1.79 + 0.152 / k) D). The share under stones
    of all sizes, k, varies over the ground. Without a look of their own, stones look like the ground below them: only
    shape, light and shade show them.
    """

    thing: Literal["stones"]
    share: Between | None = Field(
        None, description="k, share of the ground under stones, [fewest, most]; none: only those of `at`"
    )
    patch: float = Field(25.0, ge=0.5, le=1000.0, description="metres, of the patches of many and of few stones")
    size: Between = Field((0.1, 2.0), description="metres, diameter [smallest, largest]")
    height: Between = Field((0.4, 0.6), description="height above the ground over the diameter")
    form: Literal["round", "angular"] = Field("angular", description="round (pebbles, boulders) | angular (rubble)")
    rock_from: float = Field(
        0.3, ge=0.0, description="metres: larger ones are of class rock, smaller ones of the ground's class"
    )
    hidden: float = Field(0.0, ge=0.0, le=0.95, description="share of a stone that grass or moss hides, rim first")
    look: LookName = Field(Look.BY_CLASS, description="look; without it that of the ground")
    tint: Tint = Field(UNTINTED, description="factor on the reflectance of that look: a number or [red, green, blue]")
    shades: float = Field(0.15, ge=0.0, le=1.0, description="how much one differs from the next in brightness")
    upon: tuple[CoverName, ...] = Field(
        ("bare", "short_grass", "paved", "rock"), description="classes of ground where random ones may lie"
    )
    apart: bool = Field(True, description="random ones keep clear of the things of earlier layers that are apart too")

    @model_validator(mode="after")
    def _by_cover(self) -> Stones:
        if self.per_hectare:
            raise ValueError("the number of stones follows from share: [fewest, most]; leave per_hectare out")
        if self.share is not None and self.share[1] > 0.6:
            raise ValueError(f"no more than 0.6 of the ground may be under stones, got {self.share[1]:g}")
        return self

    @property
    def largest(self) -> float:
        """Radius of the largest stone with its ragged rim, metres."""
        return 0.5 * RIM * STRETCH * self.size[1]

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, 1.2 * self.size[1] * self.height[1]

    @property
    def _most(self) -> float:
        return self.share[1] if self.share else USUAL

    @property
    def density(self) -> float:
        """Number of random stones drawn per hectare, enough for the densest areas."""
        if self.share is None:
            return 0.0
        if self.size[0] == self.size[1]:  # of one size: the law's share, all in that size
            return 1e4 * share_above(self.size[0], self._most) / (0.25 * math.pi * self.size[0] ** 2)
        return 1e4 * float(_counts(self._most, self.size)[1][0])

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the diameter of each stone by the law for the densest areas, two axes, a height and a shade."""
        n = len(things)
        sizes, counts = _counts(self._most, self.size)
        diameter = np.interp(-rng.random(n) * counts[0], -counts, sizes)
        stretch = rng.uniform(1.0, STRETCH, n)
        things[:, Column.TURN] = rng.uniform(0.0, 2.0 * math.pi, n)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = 0.5 * diameter * stretch, 0.5 * diameter / stretch
        things[:, Column.TOP] = diameter * rng.uniform(*self.height, n)
        things[:, Column.EXTRA], things[:, Column.REACH] = diameter, RIM * things[:, Column.HALF_U]
        things[:, Column.RED] = np.exp(self.shades * rng.standard_normal(n))
        things[:, Column.GREEN], things[:, Column.BLUE] = (
            rng.random(n),
            rng.random(n),
        )  # random numbers for existence and outline

    def share_at(self, east: F64, north: F64, seed: int) -> F64:
        """Return the share of ground under stones, k, at positions (N,), m; it varies within the limits of `share`."""
        few, most = self.share or (USUAL, USUAL)
        field = noise(east, north, seed + 5, self.patch, 0.2 * self.patch)
        return np.asarray(few * (most / few) ** ndtr(field))

    def kept(self, things: F64, seed: int) -> Mask:
        """Return the (N,) mask of the drawn stones to keep, which thins them from the densest law to the local one."""
        if self.share is None or not len(things):
            return np.ones(len(things), bool)
        k, most = self.share_at(things[:, Column.EAST], things[:, Column.NORTH], seed), self._most
        q = 1.79 + 0.152 / k
        chance = k * q / (most * decay(most)) * np.exp(-(q - decay(most)) * things[:, Column.EXTRA])
        return np.asarray(things[:, Column.GREEN] < chance)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        things = lay.things(sheet.box)
        if len(things):
            form = np.array([float(self.form == "angular"), self.rock_from, self.hidden, float(self.look), *self.tint])
            kernel.stamp_stones(
                sheet.x[0], sheet.y[:, 0], sheet.cell, things, form, lay.seed, sheet.ground, tables()[1],
                sheet.height, sheet.label, sheet.depth, sheet.look, sheet.tint, sheet.tint.copy(),
            )  # fmt: skip
