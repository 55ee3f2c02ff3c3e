"""The lens taken out, by a table: each frame asks for hundreds of rays, several times."""

from __future__ import annotations

import numpy as np

from alight.geometry import Camera
from alight.records import F64
from alight.tracks.corner_kernels import look_up_rays


class Lens:
    """Ideal coordinates of pixels, bilinear between those of whole pixels (exact to 1e-8 for lenses of this world)."""

    def __init__(self, camera: Camera) -> None:
        u, v = np.meshgrid(np.arange(-1.0, camera.width + 1.0), np.arange(-1.0, camera.height + 1.0))
        self._table = np.ascontiguousarray(camera.rays(np.stack([u, v], axis=-1))[..., :2])

    def normalise(self, pixels: F64) -> F64:
        """Take (N, 2) pixels to x/z, y/z with the lens taken out; NaN stays NaN, outside is taken at the edge."""
        out = np.empty((len(pixels), 2))
        look_up_rays(self._table, np.asarray(pixels, dtype=np.float64) + 1.0, out)
        return out
