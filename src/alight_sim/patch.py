"""A rectangle of the world as arrays: heights for the rays, and layers for the shading."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Grid
from alight_sim.kernels.ground import EDGE, PLAIN, STEP, WIDE
from alight_sim.kernels.raycast import max_pyramid
from alight_sim.materials import tables


@dataclass(frozen=True, eq=False)
class GroundPatch:
    """A rectangle of the world as arrays; the drawn surface is bilinear between the cell centres."""

    grid: Grid
    height: F32  # (R, C) metres above the origin, topmost surface
    label: U8  # (R, C) Terrain codes; this and all layers below are reduced to blocks of 2^level x 2^level cells
    skin: F32  # (R, C, SKIN): `light`, then `tint` (1: no tint), side by side in memory
    look: U8 | None = None  # (R, C) codes of Look; None: all by class
    tinted: bool = False
    level: int = 0

    @property
    def light(self) -> F32:
        """(R, C, 5) slope east, slope north, shadow margin, share of open sky, water depth."""
        return self.skin[..., :5]

    @property
    def tint(self) -> F32 | None:
        """(R, C, 3) factor on the look's reflectance; None: 1."""
        return self.skin[..., 5:] if self.tinted else None

    @cached_property
    def pyramid(self) -> tuple[F32, NDArray[np.int64], NDArray[np.int64], F32]:
        """Pyramid of largest heights for fast ray casting, its level offsets and widths, and its dilated version."""
        pyramid = max_pyramid(self.height)
        return (*pyramid, _max_about(*pyramid))

    @cached_property
    def cells(self) -> U8:
        """(R, C, 2) look of each cell, and bits about its neighbours (`STEP`, `PLAIN`)."""
        of_class = tables()[1].astype(np.uint8)[self.label]
        looks = of_class if self.look is None else np.where(self.look == 0, of_class, self.look)
        about = np.uint8(PLAIN) * _is_plain(self.label.astype(np.uint16) + np.uint16(16) * looks)
        if self.level == 0:
            about |= np.uint8(STEP) * _is_step(self.height)
        return np.stack([looks, about], axis=-1)

    @cached_property
    def place(self) -> F64:
        """(3,) east and north of cell (0, 0), and size of a cell, metres: input of the kernels."""
        return np.array([self.grid.east, self.grid.north, self.grid.cell])

    @cached_property
    def skin_place(self) -> F64:
        """Placement of all layers except height: east and north of block (0, 0), and the block size; (3,) metres."""
        shift = 0.5 * ((1 << self.level) - 1) * self.grid.cell
        return np.asarray(self.place * (1, 1, 1 << self.level) + np.array([shift, -shift, 0.0]))

    @cached_property
    def low(self) -> float:
        """The lowest height, metres above the origin."""
        return float(self.height.min())

    @property
    def nbytes(self) -> int:
        """Memory in bytes, with the pyramids and `cells`."""
        parts = (self.height, self.label, self.skin, self.look)
        return sum(p.nbytes for p in parts if p is not None) + self.height.nbytes * 8 // 3 + 2 * self.label.size


def _is_plain(codes: NDArray[np.uint16]) -> Mask:
    """Return the mask of cells whose neighbours within `WIDE` cells have the same code; all (R, C)."""
    square = np.ones((2 * WIDE + 1, 2 * WIDE + 1), np.uint8)
    return np.asarray(cv2.erode(codes, square) == cv2.dilate(codes, square))


def _is_step(height: F32) -> Mask:
    """Return the mask of top left cells of 2 x 2 blocks whose heights differ by `EDGE` or more; all (R, C)."""
    out = np.zeros(height.shape, bool)
    square = np.ones((2, 2), np.uint8)
    top, low = (extreme(height, square, anchor=(0, 0)) for extreme in (cv2.dilate, cv2.erode))
    out[1:-2, 1:-2] = (top - low >= np.float32(EDGE))[1:-2, 1:-2]
    return out


def _max_about(pyramid: F32, offsets: NDArray[np.int64], widths: NDArray[np.int64]) -> F32:
    """Return a pyramid with each node replaced by the maximum over 3 x 3 nodes; `offsets`, `widths`: of its levels."""
    levels = (p.reshape(-1, w) for p, w in zip(np.split(pyramid, offsets[1:]), widths, strict=True))
    return np.concatenate([cv2.dilate(p, np.ones((3, 3), np.uint8)).ravel() for p in levels])
