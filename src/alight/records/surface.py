"""Heights and land cover on a grid, with the reasons where one is missing or doubtful."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, U16
from alight.geometry import Box, Grid


@dataclass(frozen=True, eq=False)
class Datum:
    """Common error of all heights of a map, beside the sigma of each cell: covariance of offset and tilt."""

    east: float  # metres, of the centre about which it tilts
    north: float
    covariance: F64  # (3, 3): offset up [m], rise per metre towards east and towards north [rad]

    @property
    def offset_sigma(self) -> float:
        """1-sigma of the height of the centre, metres."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def tilt_sigma(self) -> float:
        """1-sigma of the tilt in the direction in which it is largest, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]))


class PlaceSigma(NamedTuple):
    """1-sigma of the place of a whole map on Earth, metres."""

    horizontal: float  # in the direction in which it is largest
    vertical: float

    @classmethod
    def of(cls, covariance: F64) -> PlaceSigma:
        """Sigmas from a covariance, (3, 3) m^2, east north up."""
        variance = np.linalg.eigvalsh(covariance[:2, :2])[-1], covariance[2, 2]
        horizontal, vertical = (float(np.sqrt(max(v, 0.0))) for v in variance)
        return cls(horizontal, vertical)


class Flag(IntFlag):
    """Reason why a height is missing or doubtful; bits of flags.tif."""

    UNSEEN = 1  # fewer than two views see the cell
    TEXTURE = 2  # too little texture to match
    AMBIGUOUS = 4  # a second height fits nearly as well
    SATURATED = 8  # the pixels are at an end of their range
    MOVING = 16  # the views disagree although the geometry fits: water, swaying plants, moving shadow
    STEP = 32  # within a window of a height step: the height may be that of the neighbour
    INCONSISTENT = 64  # fewer than two of the views that see the cell agree
    RANGE = 128  # the height is at an end of the searched range
    UNSURE = 256  # probably a wrong match, or sigma too large, or isolated
    FEW = 512  # seen by two views only: a note, not a reason
    WATER = 1024  # water: the match is the bed, below the surface


class MissingVeto(IntFlag):
    """Vetoes that could have refused ground and were missing, beside colour (`TerrainMap.coloured`)."""

    SECOND_CAMERA = 1  # no two views of one moment: moving things are not found (`Flag.MOVING`)
    ATTITUDE = 2  # no attitude was measured: the level of the map is not checked


NOTHING_MISSING = MissingVeto(0)
REFUSED = Flag(sum(Flag)) & ~(Flag.STEP | Flag.FEW)  # a height with one of these is not given out: NaN in dem.tif


def is_flagged(flags: U16, bits: Flag) -> NDArray[np.bool_]:
    """True where any of some bits is set."""
    return np.asarray((flags & np.uint16(bits)) != 0)


def is_measured(flags: U16) -> NDArray[np.bool_]:
    """True where there is a height, even a doubtful one."""
    return ~is_flagged(flags, Flag.UNSEEN | Flag.RANGE | Flag.SATURATED)


def is_trusted(flags: U16) -> NDArray[np.bool_]:
    """True where no flag refuses the height."""
    return ~is_flagged(flags, REFUSED)


class Terrain(IntEnum):
    """Class codes of terrain.tif and of a flight's truth."""

    UNKNOWN = 0
    BARE = 1
    SHORT_GRASS = 2
    TALL_VEGETATION = 3
    TREE = 4
    WATER = 5
    ROCK = 6
    PAVED = 7
    STRUCTURE = 8


LANDABLE = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)  # kinds of ground that may be landed on


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights of one parallax step on one grid."""

    grid: Grid
    height: F32  # (R, C) metres above the origin (world up); NaN = unseen
    sigma: F32  # (R, C) metres, 1-sigma relative to the map
    flags: U16  # (R, C) bits of Flag
    views: U8  # (R, C) views that saw the cell
    rgb: U8  # (R, C, 3) colours from the cameras
    residual: F32  # (R, C) normalised matching residual, 0 (perfect) to 1 (nothing in common)
    sampling: F32  # (R, C) metres of ground that one sample of the match covers: its cell or, if larger, its pixel
    datum: Datum | None = None  # None: not known, as for poses that came without covariance

    def part(self, where: Box) -> Self:
        """A rectangle of the cells, copied, without what describes the map as a whole."""
        rasters = ("height", "sigma", "flags", "views", "rgb", "residual", "sampling")
        fields: dict[str, Any] = {k: np.ascontiguousarray(getattr(self, k)[where]) for k in rasters}
        return type(self)(self.grid.part(where), **fields)


@dataclass(frozen=True, eq=False)
class ElevationMap(Heights):
    """One map of the ground, fused from many steps."""

    warp: F32 | None = None  # (R, C) metres, 1-sigma of a height from bend and turn by pose errors, beside the datum
    fine: U8 | None = None  # (f R, f C, 3) orthophoto on finer pixels, the mean of several views; None: not known
    fine_sampling: F32 | None = None  # (R, C) metres of ground that a pixel of these views covers; None: as the heights
    frame_id: int = 0  # of the poses that it was made with (`Motion.frame_id`)
    position_covariance: F64 | None = None  # (3, 3) m^2, of the whole map's place on Earth; None: not known

    @property
    def finest(self) -> tuple[U8, int]:
        """The finest picture of the ground, (f R, f C, 3), and its pixels a cell, f."""
        picture = self.rgb if self.fine is None else self.fine
        return picture, picture.shape[0] // self.grid.rows

    def pixels_a_cell(self, pixel: float) -> int:
        """Pixels a cell of `picture`, along each axis; `pixel` in metres."""
        n = self.finest[1]
        while n % 2 == 0 and self.grid.cell / n < 0.9 * pixel:  # nearly as wide as wanted
            n //= 2
        return n

    def picture(self, pixel: float) -> tuple[U8, int]:
        """The finest picture on pixels of `pixel` metres or wider, (n R, n C, 3), and its pixels a cell, n."""
        picture, n = self.finest[0], self.pixels_a_cell(pixel)
        size = (n * self.grid.cols, n * self.grid.rows)
        same = picture.shape[:2] == size[::-1]
        return picture if same else np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8), n

    @property
    def picture_sampling(self) -> F32:
        """(R, C) metres of ground that a pixel of the finest picture covers where it was taken."""
        return self.sampling if self.fine_sampling is None else self.fine_sampling

    @property
    def relative_sigma(self) -> F32:
        """(R, C) metres, 1-sigma of a height relative to the map's plane: that of the match and the warp."""
        return self.sigma if self.warp is None else np.hypot(self.sigma, self.warp)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(R, C): cells whose height may be given out."""
        return np.asarray(np.isfinite(self.height) & is_trusted(self.flags))

    def refused(self) -> ElevationMap:
        """The map without any height that may be given out, as where their scale is unknown."""
        return replace(self, flags=self.flags | np.uint16(Flag.UNSURE))


@dataclass(frozen=True, eq=False)
class OnGrid:
    """Arrays (R, C) on the cells of a grid."""

    unknown: ClassVar[int] = 0  # value of integers outside of it; floating-point numbers are NaN there

    grid: Grid

    def on(self, grid: Grid) -> Self:
        """The same on another grid, each cell with the value of the nearest one; unknown outside.

        A map may be judged on coarser cells than its heights have; files and pictures share the grid of the heights.
        """
        if grid == self.grid:
            return self

        def moved(values: NDArray[Any]) -> NDArray[Any]:
            return self.grid.nearest_on(grid, values, np.nan if values.dtype.kind == "f" else self.unknown)

        return replace(self, grid=grid, **{k: moved(v) for k, v in vars(self).items() if isinstance(v, np.ndarray)})


@dataclass(frozen=True, eq=False)
class TerrainMap(OnGrid):
    """Land cover of every cell."""

    label: U8  # (R, C) Terrain codes
    landable: F32  # (R, C) probability that this kind of ground may be landed on; NaN = no evidence
    water: F32  # (R, C) probability of water; NaN = nothing seen
    enclosed: F32  # (R, C) 0 to 1: degree to which it is part of a level surface below both its banks
    raised: F32  # (R, C) 0 to 1: degree to which it is part of a level surface above the ground about it
    novelty: F32  # (R, C) novelty (T6): above 1, the ground is unlike all known ground; NaN = unseen
    bears: F32  # (R, C) probability of ground that bears and is dry, rock counted as such; NaN = unseen
    coloured: bool = True  # False: the pictures were grey, so that no colour could refuse anything

    def with_roofs(self, raised: F32) -> TerrainMap:
        """Add structures, which are not landable, where `raised` (R, C), 0 to 1, is above a half."""
        roof = (raised > 0.5) & ~np.isnan(self.landable)
        label = np.where(roof, np.uint8(Terrain.STRUCTURE), self.label)
        return replace(self, label=label, landable=np.minimum(self.landable, 1 - raised), raised=raised)


@dataclass(frozen=True, eq=False)
class PriorHeights:
    """A DEM in the world. Its vertical datum need not be known: the pictures give its offset."""

    name: str  # of its file, with the unit and vertical datum of its heights
    grid: Grid
    height: F32  # (R, C) metres above the origin, as if counted from the ellipsoid; NaN = unknown

    def at(self, east: F64, north: F64) -> F64:
        """The height of the nearest cell to each place (metres), NaN where it is unknown."""
        return self.grid.nearest_at(self.height, east, north).astype(np.float64)

    def over(self, grid: Grid) -> F64:
        """Its heights on another grid, (R, C) metres."""
        return self.grid.nearest_on(grid, self.height).astype(np.float64)


@dataclass(frozen=True)
class PriorComparison:
    """A map against a DEM from elsewhere: map less DEM, over the heights that are given out."""

    name: str
    bias: float  # metres, median
    nmad: float  # metres
    area: float  # m^2 where both have heights

    @property
    def line(self) -> str:
        """The comparison in words."""
        return (
            f"{self.name}: the map lies {self.bias:+.2f} m above it (median), NMAD {self.nmad:.2f} m "
            f"over {self.area:,.0f} m²"
        )
