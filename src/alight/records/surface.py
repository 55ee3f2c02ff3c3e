"""Heights and land cover on a grid, with reasons for missing and doubtful heights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, U16, Mask
from alight.geometry import Box, Grid


@dataclass(frozen=True, eq=False)
class Datum:
    """Common error of all heights of a map, in addition to each cell's sigma: covariance of offset and tilt."""

    east: float  # metres, east and north of the centre of the tilt
    north: float
    covariance: F64  # (3, 3): offset up [m], slopes towards east and north [rad]

    @property
    def offset_sigma(self) -> float:
        """1-sigma of the height at the centre, metres."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def tilt_sigma(self) -> float:
        """1-sigma of the tilt in its most uncertain direction, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]))


class PlaceSigma(NamedTuple):
    """1-sigma of the absolute position of a whole map, metres."""

    horizontal: float  # in the most uncertain direction
    vertical: float

    @classmethod
    def of(cls, covariance: F64) -> PlaceSigma:
        """Compute the sigmas from a covariance, (3, 3) m^2, east north up."""
        variance = np.linalg.eigvalsh(covariance[:2, :2])[-1], covariance[2, 2]
        horizontal, vertical = (float(np.sqrt(max(v, 0.0))) for v in variance)
        return cls(horizontal, vertical)


class Flag(IntFlag):
    """Reason why a height is missing or doubtful; bits of flags.tif."""

    UNSEEN = 1  # fewer than two views see the cell
    TEXTURE = 2  # too little texture to match
    AMBIGUOUS = 4  # a second height fits nearly as well
    SATURATED = 8  # the pixels are saturated, black or white
    MOVING = 16  # the views disagree although the geometry fits: water, swaying plants, moving shadow
    STEP = 32  # within a window of a height step: may be the height of the other side
    INCONSISTENT = 64  # fewer than two of the views that see the cell agree
    RANGE = 128  # the height is at a limit of the search range
    UNSURE = 256  # probably a wrong match, or sigma too large, or isolated
    FEW = 512  # seen by two views only: information, not a reason to refuse
    WATER = 1024  # water: the match is the bed, below the surface


class MissingVeto(IntFlag):
    """Vetoes that could not be applied to the ground for want of data; see `TerrainMap.coloured` for colour."""

    SECOND_CAMERA = 1  # no simultaneous views: moving objects are not found (`Flag.MOVING`)
    ATTITUDE = 2  # no attitude was measured: the map's level is not checked


NOTHING_MISSING = MissingVeto(0)
REFUSED = Flag(sum(Flag)) & ~(Flag.STEP | Flag.FEW)  # any of these bits refuses a height: NaN in dem.tif


def is_flagged(flags: U16, bits: Flag) -> NDArray[np.bool_]:
    """Return the mask of cells where any of `bits` is set."""
    return np.asarray((flags & np.uint16(bits)) != 0)


def is_measured(flags: U16) -> NDArray[np.bool_]:
    """Return the mask of cells that have a height, even a doubtful one."""
    return ~is_flagged(flags, Flag.UNSEEN | Flag.RANGE | Flag.SATURATED)


def is_trusted(flags: U16) -> NDArray[np.bool_]:
    """Return the mask of cells whose height no flag refuses."""
    return ~is_flagged(flags, REFUSED)


class Terrain(IntEnum):
    """Land-cover classes: codes of terrain.tif and of a flight's ground truth."""

    UNKNOWN = 0
    BARE = 1
    SHORT_GRASS = 2
    TALL_VEGETATION = 3
    TREE = 4
    WATER = 5
    ROCK = 6
    PAVED = 7
    STRUCTURE = 8


LANDABLE = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)  # classes that a vehicle may land on


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights of one parallax step on one grid."""

    grid: Grid
    height: F32  # (R, C) metres above the origin (world up); NaN = unseen
    sigma: F32  # (R, C) metres, 1-sigma relative to the map
    flags: U16  # (R, C) bits of Flag
    views: U8  # (R, C) number of views that saw the cell
    rgb: U8  # (R, C, 3) colours from the cameras
    residual: F32  # (R, C) normalised matching residual, 0 (perfect) to 1 (nothing in common)
    sampling: F32  # (R, C) metres of ground that one sample of the match covers: its cell or, if larger, its pixel
    datum: Datum | None = None  # None: unknown, as for poses without covariance

    def part(self, where: Box) -> Self:
        """Return a copy of the cells in the box `where`, without the fields that describe the whole map."""
        rasters = ("height", "sigma", "flags", "views", "rgb", "residual", "sampling")
        fields: dict[str, Any] = {k: np.ascontiguousarray(getattr(self, k)[where]) for k in rasters}
        return type(self)(self.grid.part(where), **fields)


@dataclass(frozen=True, eq=False)
class ElevationMap(Heights):
    """Heights of the ground, fused from many parallax steps."""

    warp: F32 | None = None  # (R, C) metres, 1-sigma from bending by pose errors, in addition to the datum
    fine: U8 | None = None  # (f * R, f * C, 3) orthophoto, f x f pixels per cell, mean of several views; None: unknown
    fine_sampling: F32 | None = None  # (R, C) metres, ground width of a pixel in the views of `fine`; None: `sampling`
    frame_id: int = 0  # map number of the poses (`Motion.frame_id`)
    position_covariance: F64 | None = None  # (3, 3) m^2, of the whole map's absolute position; None: unknown

    @property
    def finest(self) -> tuple[U8, int]:
        """Finest picture of the ground, (f * R, f * C, 3), and f, its pixels per cell along each axis."""
        picture = self.rgb if self.fine is None else self.fine
        return picture, picture.shape[0] // self.grid.rows

    def pixels_a_cell(self, pixel: float) -> int:
        """Return the pixels per cell of `picture(pixel)` along each axis; `pixel`: least pixel size, metres."""
        n = self.finest[1]
        while n % 2 == 0 and self.grid.cell / n < 0.9 * pixel:  # 0.9: accept slightly smaller pixels
            n //= 2
        return n

    def picture(self, pixel: float) -> tuple[U8, int]:
        """Return the finest picture with pixels of `pixel` metres or more, (n * R, n * C, 3), and n pixels per cell."""
        picture, n = self.finest[0], self.pixels_a_cell(pixel)
        size = (n * self.grid.cols, n * self.grid.rows)
        same = picture.shape[:2] == size[::-1]
        return picture if same else np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8), n

    @property
    def picture_sampling(self) -> F32:
        """Width on the ground of a camera pixel in the views that the finest picture was made from, (R, C) metres."""
        return self.sampling if self.fine_sampling is None else self.fine_sampling

    @property
    def relative_sigma(self) -> F32:
        """1-sigma of each height relative to the map's plane, from matching and warp, (R, C) metres."""
        return self.sigma if self.warp is None else np.hypot(self.sigma, self.warp)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Mask of the cells whose height is finite and trusted, (R, C)."""
        return np.asarray(np.isfinite(self.height) & is_trusted(self.flags))

    @property
    def place_covariance(self) -> F64 | None:
        """Covariance of the ground's absolute position, (3, 3) m^2: of the poses, upwards of the heights if larger."""
        if self.position_covariance is None or self.datum is None:
            return self.position_covariance
        out = self.position_covariance.copy()
        out[2, 2] = max(out[2, 2], self.datum.covariance[0, 0])
        return out

    def refused(self) -> ElevationMap:
        """Return the map with all heights refused, as when their scale is unknown."""
        return replace(self, flags=self.flags | np.uint16(Flag.UNSURE))


@dataclass(frozen=True, eq=False)
class OnGrid:
    """Arrays (R, C) on the cells of a grid."""

    unknown: ClassVar[int] = 0  # value of integer arrays outside the grid; floating-point arrays are NaN there

    grid: Grid

    def on(self, grid: Grid) -> Self:
        """Resample to another grid: each cell gets the value of the nearest cell, or unknown outside this grid.

        A map may be judged on coarser cells than its heights have; files and pictures use the grid of the heights.
        """
        if grid == self.grid:
            return self

        def moved(values: NDArray[Any]) -> NDArray[Any]:
            return self.grid.nearest_on(grid, values, np.nan if values.dtype.kind == "f" else self.unknown)

        return replace(self, grid=grid, **{k: moved(v) for k, v in vars(self).items() if isinstance(v, np.ndarray)})

    def part(self, where: Box) -> Self:
        """Return a copy of the cells in the box `where`."""
        parts = {k: np.ascontiguousarray(v[where]) for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, grid=self.grid.part(where), **parts)


@dataclass(frozen=True, eq=False)
class TerrainMap(OnGrid):
    """Land cover of every cell."""

    label: U8  # (R, C) Terrain codes
    landable: F32  # (R, C) probability of a class that a vehicle may land on; NaN = no evidence
    water: F32  # (R, C) probability of water; NaN = unseen
    enclosed: F32  # (R, C) 0 to 1: membership of a level surface below both its banks
    raised: F32  # (R, C) 0 to 1: membership of a level surface above the surrounding ground
    novelty: F32  # (R, C) novelty (T6): above 1, unlike all ground of the training set; NaN = unseen
    bears: F32  # (R, C) probability of firm, dry ground, rock included; NaN = unseen
    road: Mask | None = None  # (R, C) on a road (G20); None: not judged
    car: Mask | None = None  # (R, C) on a standing car (G21); None: not judged
    coloured: bool = True  # False: the pictures were grey, so that no colour veto applied

    @property
    def confidence(self) -> F32:
        """Probability of water where the class is water, else of (un)landable ground as the class is, (R, C)."""
        landable = np.isin(self.label, LANDABLE)
        return np.where(self.label == Terrain.WATER, self.water, np.where(landable, self.landable, 1 - self.landable))

    def with_roofs(self, raised: F32) -> TerrainMap:
        """Mark cells as structures, which are not landable, where `raised` (R, C), 0 to 1, is above 0.5."""
        roof = (raised > 0.5) & ~np.isnan(self.landable)
        label = np.where(roof, np.uint8(Terrain.STRUCTURE), self.label)
        return replace(self, label=label, landable=np.minimum(self.landable, 1 - raised), raised=raised)


@dataclass(frozen=True, eq=False)
class PriorHeights:
    """External DEM in the world frame. Its vertical datum may be unknown: a map gives the offset of its heights."""

    name: str  # file name, with unit and vertical datum
    grid: Grid
    height: F32  # (R, C) metres above the origin, treated as ellipsoidal heights; NaN = unknown

    def at(self, east: F64, north: F64) -> F64:
        """Return the height (metres) of the cell nearest to each position (metres); NaN where it is unknown."""
        return self.grid.nearest_at(self.height, east, north).astype(np.float64)

    def over(self, grid: Grid) -> F64:
        """Return the heights at the cells of another grid, (R, C) metres; NaN = unknown."""
        return self.grid.nearest_on(grid, self.height).astype(np.float64)


@dataclass(frozen=True)
class PriorComparison:
    """Comparison of a map with an external DEM: map minus DEM, over the trusted heights."""

    name: str
    bias: float  # metres, median difference
    nmad: float  # metres, of the difference
    area: float  # m^2 where both the map and the DEM have heights

    @property
    def line(self) -> str:
        """The comparison in words."""
        return (
            f"{self.name}: the map lies {self.bias:+.2f} m above it (median), NMAD {self.nmad:.2f} m "
            f"over {self.area:,.0f} m²"
        )
