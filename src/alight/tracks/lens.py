"""Undistortion by a table: each frame needs hundreds of rays, several times."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera
from alight.tracks.corner_kernels import interpolate_rays


class Lens:
    """Normalised coordinates of pixels, interpolated between whole pixels (error 1e-8 for common lenses)."""

    def __init__(self, camera: Camera) -> None:
        # (H + 2, W + 2, 2) rays of the pixels and of a pixel around the image
        u, v = np.meshgrid(np.arange(-1.0, camera.width + 1.0), np.arange(-1.0, camera.height + 1.0))
        self.table = np.ascontiguousarray(camera.rays(np.stack([u, v], axis=-1))[..., :2])

        self.pinhole = np.array([camera.fu, camera.fv, camera.cu, camera.cv])  # px
        self.model, self.coefficients = camera.code, camera.coefficients

    def normalise(self, pixels: F64) -> F64:
        """Return the (N, 2) normalised coordinates x/z, y/z of pixels; NaN stays NaN, outside at the edge."""
        out = np.empty((len(pixels), 2))
        interpolate_rays(self.table, np.asarray(pixels, dtype=np.float64) + 1.0, out)
        return out
