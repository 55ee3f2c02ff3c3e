"""Sunlight on the ground: direction, brightness and shadows, estimated from heights and one image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, Mask
from alight.hazards.footprint_kernels import cast_shadows
from alight.spread import SIGMA_OF_MAD

DIFFERENCE, SMOOTHING = np.array([-1, 0, 1], np.float32), np.array([1, 2, 1], np.float32)


def gradients(height: F32, pixel: float) -> tuple[F32, F32]:
    """Sobel gradients along columns and rows, metres a metre: similar to those of a renderer and of a camera's blur."""
    scale = np.float32(1 / (8 * pixel))
    along = cv2.sepFilter2D(height, cv2.CV_32F, DIFFERENCE * scale, SMOOTHING)
    across = cv2.sepFilter2D(height, cv2.CV_32F, SMOOTHING, DIFFERENCE * scale)
    return np.asarray(along), np.asarray(across)


def _up(along: F32, across: F32) -> F32:
    """Upward part of the unit normal."""
    out: F32 = (1 / np.sqrt(1 + along * along + across * across)).astype(np.float32)
    return out


@dataclass(frozen=True, eq=False)
class Sunlight:
    """Brightness = sun . normal + ambient, of one kind of ground (Lambert) seen from above (S1)."""

    sun: F64  # (3,) grey levels along columns, rows and up
    ambient: float  # grey levels
    spread: float  # grey levels, 1-sigma of the residual
    explained: float  # share of the image's variance that it explains

    @property
    def elevation(self) -> float:
        """Height of the sun above the horizon, rad."""
        return math.atan2(self.sun[2], math.hypot(self.sun[0], self.sun[1]))

    def brightness(self, along: F32, across: F32) -> tuple[F32, F32, F32]:
        """Brightness (R, C) at these gradients, and its derivatives along columns and rows."""
        ax, ay, az = (np.float32(v) for v in self.sun)
        n = _up(along, across)
        facing = (az - ax * along - ay * across) * n
        d_along = -ax * n - facing * along * n * n
        d_across = -ay * n - facing * across * n * n
        out: tuple[F32, F32, F32] = (facing + np.float32(self.ambient), d_along, d_across)
        return out


def _solve(terms: F32, image: F32) -> F64:
    a, b = terms.astype(np.float64), image.astype(np.float64)
    return np.asarray(np.linalg.lstsq(a.T @ a, a.T @ b, rcond=1e-9)[0])


def find_light(height: F32, image: F32, lit: Mask, pixel: float) -> Sunlight:
    """Fit the light to an image of ground with known heights, by least squares without outliers (S1).

    Args:
        height: (R, C) metres.
        image: (R, C) grey levels on the same grid.
        lit: pixels that may count.
        pixel: metres.
    """
    along, across = gradients(height, pixel)
    n = _up(along, across)
    use = lit.copy()
    use[:2] = use[-2:] = use[:, :2] = use[:, -2:] = False
    terms, seen = np.stack([-along * n, -across * n, n, np.ones_like(n)], axis=-1)[use], image[use]
    if seen.size < 100:
        return Sunlight(np.zeros(3), 0.0, math.inf, 0.0)
    x, typical = _solve(terms, seen), math.inf
    for _ in range(8):
        off = np.abs(seen - terms @ x.astype(np.float32))
        typical = float(np.median(off))
        kept = off < max(4 * typical, 2.0)
        x = _solve(terms[kept], seen[kept])
    left = np.clip(seen - terms @ x.astype(np.float32), -4 * seen.std(), 4 * seen.std())
    explained = 1 - float((left**2).mean()) / max(float(seen.var()), 1e-9)
    return Sunlight(x[:3], float(x[3]), SIGMA_OF_MAD * typical, explained)


def in_shadow(height: F32, light: Sunlight, pixel: float, longest: int = 400) -> Mask:
    """Pixels that the sun does not reach: turned away from it, or behind an object up to `longest` cells away."""
    level = math.hypot(light.sun[0], light.sun[1])
    if level < 1e-6:
        return np.zeros(height.shape, dtype=np.bool_)
    towards = light.sun[:2] / level
    out = np.zeros(height.shape, dtype=np.bool_)
    cast_shadows(height, float(towards[1]), float(towards[0]), math.tan(light.elevation) * pixel, longest, out)
    along, across = gradients(height, pixel)
    return out | (light.brightness(along, across)[0] < light.ambient)


def shadow_level(image: F32, shadow: Mask) -> float:
    """Grey level up to which a pixel may lie in shadow; -inf where fewer than 50 pixels should lie in one."""
    core = cv2.erode(shadow.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if core.sum() < 50:
        return -math.inf
    return float(np.quantile(image[core], 0.95)) + 2.0
