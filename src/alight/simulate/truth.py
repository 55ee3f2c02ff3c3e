"""Truth: where a lander is truly safe, by brute force over the world's own layers. Shares no code with the stages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import binary_erosion
from scipy.signal import fftconvolve

from alight.geometry import Grid
from alight.records import F32, F64, U8, Terrain
from alight.simulate.section import Section

Mask = NDArray[np.bool_]
CHUNK = 500  # discs judged at a time: their cells stay in the processor's cache


@dataclass(frozen=True)
class Footprint:
    """What a lander stands: every cell centre within `radius` of an allowed class and near the disc's plane."""

    radius: float = 1.5  # metres
    max_slope: float = math.radians(10.0)  # rad
    max_roughness: float = 0.15  # metres, largest deviation from the least-squares plane
    classes: tuple[Terrain, ...] = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)


class Lander(Section):
    """The lander that a scene's truth is kept for."""

    radius: float = Field(1.5, gt=0.0, le=50.0, description="metres, of the disc that it needs")
    max_slope_deg: float = Field(10.0, gt=0.0, le=60.0, description="of the disc's plane")
    max_roughness: float = Field(0.15, gt=0.0, le=10.0, description="metres, largest deviation from that plane")
    upon: tuple[Literal["bare", "short_grass", "tall_vegetation", "rock", "paved", "structure"], ...] = Field(
        ("bare", "short_grass", "paved"), description="classes that it may stand on"
    )

    @property
    def footprint(self) -> Footprint:
        """The same in radians and codes."""
        classes = tuple(Terrain[name.upper()] for name in self.upon)
        return Footprint(self.radius, math.radians(self.max_slope_deg), self.max_roughness, classes)


@dataclass(frozen=True, eq=False)
class Truth:
    """The ground as it is."""

    grid: Grid
    height: F32  # (R, C) metres above the origin
    label: U8  # (R, C) Terrain codes
    _masks: dict[Footprint, Mask] = field(default_factory=dict, repr=False)

    def safe(self, footprint: Footprint | None = None) -> Mask:
        """(R, C): a touchdown centred here keeps every limit. A disc that leaves the world does not."""
        key = footprint or Footprint()
        if key not in self._masks:
            self._masks[key] = safe_mask(self.height, self.label, self.grid.cell, key)
        return self._masks[key]


def _disc(radius: float, cell: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    k = math.ceil(radius / cell)
    r, c = np.mgrid[-k : k + 1, -k : k + 1]
    inside = np.hypot(r, c) * cell <= radius + 1e-9
    return r[inside], c[inside]


def _kernel(r: NDArray[np.int64], c: NDArray[np.int64], values: F64) -> F64:
    k = int(np.abs(r).max())
    out = np.zeros((2 * k + 1, 2 * k + 1))
    out[r + k, c + k] = values
    return out


def safe_mask(height: F32, label: U8, cell: float, footprint: Footprint) -> Mask:
    """(R, C): least-squares plane of the disc about each cell; slope, largest deviation and classes within limits.

    On a full disc the normal equations are diagonal: the plane's slopes are first moments over second moments.
    """
    r, c = _disc(footprint.radius, cell)
    k = int(np.abs(r).max(initial=0))
    disc = _kernel(r, c, np.ones(len(r))) > 0
    safe = binary_erosion(np.isin(label, footprint.classes), structure=disc, border_value=0)
    safe[:k], safe[-k:], safe[:, :k], safe[:, -k:] = False, False, False, False
    if not safe.any():
        return np.asarray(safe)
    h = np.where(np.isfinite(height), height, 1e6).astype(np.float64)
    h -= np.median(h)
    x, y = c * cell, -r * cell
    # fftconvolve flips its kernel: mirrored offsets make it a correlation
    mean = fftconvolve(h, _kernel(-r, -c, np.full(len(r), 1.0 / len(r))), "same")
    slope_e = fftconvolve(h, _kernel(-r, -c, x / (x * x).sum()), "same")
    slope_n = fftconvolve(h, _kernel(-r, -c, y / (y * y).sum()), "same")
    safe &= np.hypot(slope_e, slope_n) <= math.tan(footprint.max_slope)
    rows, cols = np.nonzero(safe)
    arms, flat, offsets = np.stack([x, y]), h.ravel(), r * h.shape[1] + c
    for start in range(0, len(rows), CHUNK):
        i, j = rows[start : start + CHUNK], cols[start : start + CHUNK]
        plane = mean[i, j, None] + np.column_stack([slope_e[i, j], slope_n[i, j]]) @ arms
        deviation = np.abs(flat.take((i * h.shape[1] + j)[:, None] + offsets) - plane).max(axis=1)
        safe[i, j] = deviation <= footprint.max_roughness
    return np.asarray(safe)
