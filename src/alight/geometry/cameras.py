"""Camera models: pinhole with no, radial-tangential or equidistant distortion.

Optical frame: x right, y down, z forward. Pixels: the centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from alight.arrays import F64

_MODELS = ("none", "radial-tangential", "equidistant")  # the position is the model's code in the kernels


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera, after Brown-Conrady (radial-tangential) or Kannala-Brandt (equidistant).

    Raises:
        ValueError: a focal length or size is not positive, the model is unknown, or its number of coefficients is
            wrong.
    """

    width: int  # pixels
    height: int  # pixels
    fu: float  # pixels, focal length along a row
    fv: float  # pixels, focal length along a column
    cu: float  # pixels, column of the principal point; (0, 0) is the centre of the first pixel
    cv: float  # pixels, row of the principal point
    model: str = "none"  # none, radial-tangential or equidistant
    distortion: tuple[float, ...] = ()  # k1 k2 p1 p2 [k3] (radial-tangential) or k1 k2 k3 k4 (equidistant)

    def __post_init__(self) -> None:
        allowed = dict(zip(_MODELS, ((0,), (4, 5), (4,)), strict=True))
        if self.model not in allowed:
            raise ValueError(f"unknown distortion model {self.model!r}: use one of {', '.join(allowed)}")
        if len(self.distortion) not in allowed[self.model]:
            raise ValueError(f"{self.model} distortion takes {allowed[self.model]} numbers, got {len(self.distortion)}")
        numbers = (self.fu, self.fv, self.cu, self.cv, *self.distortion)
        if not np.isfinite(numbers).all() or min(self.fu, self.fv) <= 0 or min(self.width, self.height) <= 0:
            raise ValueError("no camera: focal lengths and image size must be positive, all numbers finite")

    @property
    def K(self) -> F64:
        """Calibration matrix, (3, 3), pixels."""
        return np.array([[self.fu, 0.0, self.cu], [0.0, self.fv, self.cv], [0.0, 0.0, 1.0]])

    @property
    def code(self) -> int:
        """Number of the distortion model in the compiled loops: 0 none, 1 radial-tangential, 2 equidistant."""
        return _MODELS.index(self.model)

    @property
    def coefficients(self) -> F64:
        """Distortion coefficients for the compiled loops, (5,), padded with zeros."""
        return np.array([*self.distortion, *([0.0] * (5 - len(self.distortion)))])

    def scaled(self, factor: float) -> Camera:
        """Return the camera of an image resized by `factor`; integer coordinates are pixel centres in both images."""
        return replace(
            self,
            width=round(self.width * factor),
            height=round(self.height * factor),
            fu=self.fu * factor,
            fv=self.fv * factor,
            cu=(self.cu + 0.5) * factor - 0.5,
            cv=(self.cv + 0.5) * factor - 0.5,
        )

    def distort(self, normalised: ArrayLike) -> F64:
        """Convert (..., 2) ideal normalised coordinates x/z, y/z to distorted normalised coordinates."""
        xy = np.asarray(normalised, dtype=np.float64)
        if self.model == "none":
            return xy
        x, y = xy[..., 0], xy[..., 1]
        if self.model == "equidistant":
            r = np.hypot(x, y)
            theta = np.arctan(r)
            t2 = theta * theta
            k1, k2, k3, k4 = self.distortion
            d = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            s = np.where(r > 1e-9, d / np.maximum(r, 1e-9), 1.0)
            return np.stack([x * s, y * s], axis=-1)
        k1, k2, p1, p2, k3 = self.coefficients
        r2 = x * x + y * y
        s = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [x * s + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * s + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=-1
        )

    def undistort(self, distorted: ArrayLike, iterations: int = 20) -> F64:
        """Convert (..., 2) distorted normalised coordinates to ideal ones, by at most `iterations` Newton steps."""
        target = np.asarray(distorted, dtype=np.float64)
        if self.model == "none":
            return target
        xy, eps = target.copy(), 1e-6
        east, south = np.array([eps, 0.0]), np.array([0.0, eps])
        for _ in range(iterations):
            f = self.distort(xy) - target
            jx = (self.distort(xy + east) - self.distort(xy - east)) / (2 * eps)
            jy = (self.distort(xy + south) - self.distort(xy - south)) / (2 * eps)
            det = jx[..., 0] * jy[..., 1] - jx[..., 1] * jy[..., 0]
            det = np.where(np.abs(det) < 1e-9, 1e-9, det)
            step_x = f[..., 0] * jy[..., 1] - f[..., 1] * jy[..., 0]
            step_y = jx[..., 0] * f[..., 1] - jx[..., 1] * f[..., 0]
            step = np.stack([step_x, step_y], -1) / det[..., None]
            xy = xy - np.clip(step, -0.5, 0.5)
            if np.abs(step).max(initial=0.0) < 1e-12:
                break
        return xy

    def project(self, points_cam: ArrayLike) -> F64:
        """Project (..., 3) points in the optical frame to (..., 2) pixels; NaN where z <= 0."""
        p = np.asarray(points_cam, dtype=np.float64)
        z = p[..., 2:3]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = self.distort(np.where(z > 0, p[..., :2] / z, np.nan))
        return xy * [self.fu, self.fv] + [self.cu, self.cv]

    def rays(self, pixels: ArrayLike) -> F64:
        """Convert (..., 2) pixels to (..., 3) ray directions in the optical frame, scaled to z = 1."""
        xy = self.undistort((np.asarray(pixels, dtype=np.float64) - [self.cu, self.cv]) / [self.fu, self.fv])
        return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
