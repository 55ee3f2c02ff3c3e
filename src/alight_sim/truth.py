"""True safety of a lander's footprint, by brute force over the world's own layers. Shares no code with the stages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from alight.arrays import F32, U8, Mask
from alight.geometry import Grid
from alight.records import Terrain
from alight_sim.kernels.touchdown import running_sums, touchdown
from alight_sim.section import Section
from alight_sim.spans import TrueSpans

BAND = 512  # rows of a raster that are made at once, to save memory: a multiple of the tiles of its file


@dataclass(frozen=True)
class TrueFootprint:
    """Limits of a footprint: every cell centre within `radius` has an allowed class and lies near the disc's plane."""

    radius: float = 1.5  # metres
    max_slope: float = math.radians(10.0)  # rad
    max_roughness: float = 0.15  # metres, largest deviation from the least-squares plane
    classes: tuple[Terrain, ...] = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)


class TrueLander(Section):
    """The lander for which a scene's truth is judged."""

    radius: float = Field(1.5, gt=0.0, le=50.0, description="metres, of the disc that it needs")
    max_slope_deg: float = Field(10.0, gt=0.0, le=60.0, description="of the disc's plane")
    max_roughness: float = Field(0.15, gt=0.0, le=10.0, description="metres, largest deviation from that plane")
    upon: tuple[Literal["bare", "short_grass", "tall_vegetation", "rock", "paved", "structure"], ...] = Field(
        ("bare", "short_grass", "paved"), description="classes that it may stand on"
    )

    @property
    def footprint(self) -> TrueFootprint:
        """Limits of its footprint, in radians and codes of Terrain."""
        classes = tuple(Terrain[name.upper()] for name in self.upon)
        return TrueFootprint(self.radius, math.radians(self.max_slope_deg), self.max_roughness, classes)


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """True heights and classes of the ground, and the spans over it, which are no part of the heights."""

    grid: Grid
    height: F32  # (R, C) metres above the origin
    label: U8  # (R, C) Terrain codes
    spans: TrueSpans = field(default_factory=TrueSpans)
    _masks: dict[TrueFootprint, Mask] = field(default_factory=dict, repr=False)

    def safe(self, footprint: TrueFootprint | None = None) -> Mask:
        """Return the (R, C) mask of touchdowns that keep every limit (None: of a default footprint), under no span."""
        key = footprint or TrueFootprint()
        if key not in self._masks:
            safe = safe_mask(self.height, self.label, self.grid.cell, key)
            self._masks[key] = safe & ~self.spans.over(self.grid, key.radius)
        return self._masks[key]


def _half_widths(radius: float, cell: float) -> NDArray[np.int64]:
    """Return the half width of each row of a disc, in cells, for `radius` and `cell` in metres."""
    k = math.floor(radius / cell + 1e-9)
    rise = np.arange(-k, k + 1) * cell
    return np.asarray(np.floor(np.sqrt(np.maximum(radius**2 - rise**2, 0.0)) / cell + 1e-9).astype(np.int64))


def safe_mask(height: F32, label: U8, cell: float, footprint: TrueFootprint) -> Mask:
    """Return the (R, C) mask of cells whose disc keeps the limits of slope, largest deviation and classes.

    The plane is the least-squares plane of the disc. A disc with an unknown height, or beyond the array, is not safe.
    """
    half = _half_widths(footprint.radius, cell)
    k, rows = len(half) // 2, height.shape[0]
    steep = math.tan(footprint.max_slope) * cell
    safe = np.zeros(height.shape, bool)
    for start in range(0, rows, BAND):
        first, last = max(0, start - k), min(rows, start + BAND + k)
        out = _band(height[first:last], label[first:last], half, steep, footprint)
        safe[start : start + BAND] = out[start - first : start - first + BAND]
    return safe


def _band(height: F32, label: U8, half: NDArray[np.int64], steep: float, footprint: TrueFootprint) -> Mask:
    height = np.ascontiguousarray(height, np.float32)
    barred = ~(np.isin(label, footprint.classes) & np.isfinite(height))
    base = float(np.median(height[~barred])) if not barred.all() else 0.0
    rows, cols = height.shape
    sums, count = np.empty((rows, cols + 1, 2)), np.empty((rows, cols + 1), np.int64)
    running_sums(height, barred, base, sums, count)
    out = np.empty(height.shape, bool)
    touchdown(height, base, sums, count, half, steep, footprint.max_roughness, out)
    return out
