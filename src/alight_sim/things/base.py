"""Base of all things of a scene: the sheet on which they are drawn, and their scattering over a world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer

from alight.arrays import F32, F64, U8, Mask
from alight.records import Terrain
from alight_sim.kernels.stamps import COLUMNS, Column
from alight_sim.looks import Look
from alight_sim.section import Coordinate, Section
from alight_sim.spans import TrueSpans

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Box = tuple[float, float, float, float]  # west, south, east, north, metres
CoverName = Literal["bare", "short_grass", "tall_vegetation", "tree", "water", "rock", "paved", "structure"]
Places = tuple[tuple[Coordinate, Coordinate], ...]
Factor = Annotated[float, Field(ge=0.0, le=20.0)]
UNTINTED = (1.0, 1.0, 1.0)
LARGEST = 200.0  # metres, largest size of one thing


def _look(value: Any) -> Any:
    if isinstance(value, str) and value.upper() in Look.__members__:
        return Look[value.upper()]
    if isinstance(value, Look):
        return value
    raise ValueError(f"must be one of: {', '.join(k.lower() for k in Look.__members__)}")


def _triple(value: Any) -> Any:
    return (value, value, value) if isinstance(value, int | float) else value


LookName = Annotated[Look, BeforeValidator(_look), PlainSerializer(lambda look: look.name.lower(), when_used="json")]
Tint = Annotated[tuple[Factor, Factor, Factor], BeforeValidator(_triple)]


def _pair(value: Any) -> Any:
    return (value, value) if isinstance(value, int | float) else value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 < value[0] <= value[1]:
        raise ValueError("must be one number or [smallest, largest], above 0")
    if value[1] > LARGEST:
        raise ValueError(f"must be at most {LARGEST:g}")
    return value


Between = Annotated[tuple[float, float], BeforeValidator(_pair), AfterValidator(_ordered)]


def terrain_named(name: str) -> Terrain:
    return Terrain[name.upper()]


@dataclass(eq=False)
class Sheet:
    """Positions (R, C) with the layers under construction, which things change in place.

    `ground` is the solid ground, `height` the topmost surface: cover and standing things raise only `height`.
    """

    x: F64
    y: F64
    ground: F64
    height: F64
    label: U8
    depth: F64  # metres of water
    look: U8  # codes of Look
    tint: F32  # (R, C, 3) factor on the look's reflectance
    cell: float  # metres between the positions of a tile; 0: single positions
    notes: dict[int, Any] = field(default_factory=dict)  # by layer: data of its `shape` for its `cover`

    @classmethod
    def blank(cls, x: F64, y: F64, label: Terrain, cell: float = 0.0) -> Sheet:
        """Return flat ground of class `label` at height 0, at positions `x`, `y` (R, C); `cell`: see the field."""
        zero = np.zeros(x.shape)
        labels = np.full(x.shape, label, np.uint8)
        looks, tint = np.zeros(x.shape, np.uint8), np.ones((*x.shape, 3), np.float32)
        return cls(x, y, zero, zero, labels, zero.copy(), looks, tint, cell)

    @property
    def box(self) -> Box:
        """Box of the positions, enlarged by a cell on every side, because things cover cells beyond their outline."""
        near = self.cell
        return (
            float(self.x.min()) - near, float(self.y.min()) - near,
            float(self.x.max()) + near, float(self.y.max()) + near,
        )  # fmt: skip

    def near(self, east: float, north: float, reach: float) -> tuple[Any, F64, F64]:
        """Return the positions within +- `reach` of a position: their index, and offsets east and north (m)."""
        if self.cell > 0.0:
            cols = np.nonzero(np.abs(self.x[0] - east) < reach)[0]
            rows = np.nonzero(np.abs(self.y[:, 0] - north) < reach)[0]
            index: Any = (_run(rows), _run(cols))
        else:
            index = np.nonzero((np.abs(self.x - east) < reach) & (np.abs(self.y - north) < reach))
        return index, self.x[index] - east, self.y[index] - north

    def paint(
        self, index: Any, mask: Mask, kind: Terrain | None, look: Look = Look.BY_CLASS, tint: Sequence[float] = UNTINTED
    ) -> None:
        """Set class `kind` (None: kept), look and tint at the positions of an index of `near` where `mask` is true."""
        for layer, value in ((self.label, kind), (self.look, look), (self.tint, tint)):
            if value is None:
                continue
            part = layer[index]
            part[mask] = value
            if part.base is None:  # fancy indexing made a copy
                layer[index] = part


def _run(found: NDArray[np.intp]) -> slice:
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, 0)


def ramp(low: float, high: float, x: F64) -> F64:
    """Return a smooth step of `x`: 0 up to `low`, 1 from `high` on."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


class Layer(Section):
    """One kind of thing. All layers first shape the solid ground, then add cover, standing and hanging things."""

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Change the solid ground of a sheet in place."""

    def cover(self, sheet: Sheet, lay: Lay) -> None:
        """Raise the surface of a sheet above the solid ground, in place."""

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        """Stamp standing things on a sheet in place."""

    def hang(self, box: Box, lay: Lay) -> TrueSpans:
        """Return the layer's spans in the air: at least all spans that come into a box."""
        return TrueSpans()

    @property
    def rise(self) -> tuple[float, float]:
        """Largest lowering and largest raising of the ground by the layer, metres."""
        return 0.0, 0.0


class Scattered(Layer):
    """Things at given positions, or scattered at random with a number per hectare."""

    at: Places = Field((), description="[[east, north], ...] metres from the origin")
    per_hectare: float = Field(0.0, ge=0.0, le=20000.0, description="how many a hectare, at random places")
    upon: tuple[CoverName, ...] = Field(
        ("bare", "short_grass"), description="classes of ground where random ones may stand; those of `at` always do"
    )
    not_on: tuple[LookName, ...] = Field((), description="looks of ground that random ones keep off: a cleared track")
    within: Box | None = Field(None, description="[west, south, east, north]: random ones stand only in this box")
    apart: bool = Field(False, description="random ones keep clear of the things of earlier layers that are apart too")
    clump: float = Field(1.0, gt=0.0, le=1.0, description="share of the ground, in patches, that random ones keep to")
    clump_size: float = Field(15.0, gt=0.5, le=1000.0, description="metres, of those patches")

    @property
    def largest(self) -> float:
        """Largest distance from a thing's centre to its farthest part, metres."""
        raise NotImplementedError

    @property
    def founded(self) -> bool:
        """Whether the base of a thing is the highest ground under it, instead of the mean."""
        return False

    @property
    def density(self) -> float:
        """Number of random things drawn per hectare; some of them may find no site."""
        return self.per_hectare

    def draw(self, rng: np.random.Generator, things: F64) -> None:
        """Draw all columns of things (N, COLUMNS) except their positions, in place."""
        raise NotImplementedError

    def kept(self, things: F64, seed: int) -> Mask:
        """Return the (N,) mask of drawn random things (N, COLUMNS) to keep, by which a layer varies their density."""
        return np.ones(len(things), bool)

    def parts(self, rng: np.random.Generator, things: F64) -> F64:
        """Return the parts (M, COLUMNS) to stamp for the things; by default the things themselves."""
        return things


def blank_things(places: F64) -> F64:
    """Return (N, COLUMNS) things at positions (N, 2), with all other columns 0."""
    things = np.zeros((len(places), COLUMNS))
    things[:, [Column.EAST, Column.NORTH]] = places
    return things


def overlapping(things: F64, box: Box) -> F64:
    """Return the things (N, COLUMNS) that reach into a box."""
    west, south, east, north = box
    e, n, reach = things[:, Column.EAST], things[:, Column.NORTH], things[:, Column.REACH]
    near = (e + reach >= west) & (e - reach <= east) & (n + reach >= south) & (n - reach <= north)
    return np.asarray(things[near])


def power_law(rng: np.random.Generator, between: Between, exponent: float, count: int) -> F64:
    """Draw (count,) sizes within limits by a power law: the number above a size is proportional to size**-exponent."""
    low, high = between
    u = rng.random(count)
    if low == high:
        return np.full(count, low)
    if exponent < 1e-9:
        return np.asarray(low * (high / low) ** u)
    a, b = low**-exponent, high**-exponent
    return np.asarray((a - u * (a - b)) ** (-1.0 / exponent))


def covered(inside: F64, cell: float) -> F64:
    """Return the share of a cell inside an edge; `inside`: metres of its centre from the edge, negative outside."""
    return np.clip(inside / max(cell, 1e-6) + 0.5, 0.0, 1.0)


def along_and_across(dx: F64, dy: F64, turn: float) -> tuple[F64, F64]:
    """Return coordinates of (dx, dy) along and across a direction `turn`, rad counter-clockwise from east."""
    c, s = math.cos(turn), math.sin(turn)
    return np.asarray(c * dx + s * dy), np.asarray(c * dy - s * dx)
