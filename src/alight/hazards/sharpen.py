"""Refine heights to an image's finer pixels, so that they agree with the coarse heights and with the shading.

Rocks smaller than a cell are visible by their lit and shadowed sides (docs/method/hazards.md).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg

from alight.arrays import F32, F64, U8, Mask
from alight.hazards.footprint_kernels import cast_shadows
from alight.raster import grey_levels, rgb_levels, upsample
from alight.records import ElevationMap
from alight.settings.tuning.hazards import SharpenTuning
from alight.spread import SIGMA_OF_MAD

log = logging.getLogger(__name__)

HEIGHT_FLOOR = 0.001  # metres, least sigma of a cell
ROUNDS = ((1, 15), (1, 15), (3, 30))  # Gauss-Newton and conjugate-gradient steps; the first two only find the light
UNALTERNATED = np.array([-1, 4, 10, 4, -1], np.float32) / 16  # preserves cubics, removes alternation of pixels

Operator = Callable[[F32], F32]


@cache
def coarsening(cells: int, factor: int) -> csr_array:
    """Return the weights (cells, cells * factor) of the pixels along an axis in each cell (S2).

    Cells are made by linear resampling: the weights are a tent two cells wide, which starts `factor` / 2 pixels before
    the cell's own pixels, so it is centred only for even factors. Beyond the border, the last pixel is repeated.
    """
    tent = 1 - np.abs((np.arange(2 * factor) + 0.5) / factor - 1.0)
    at = np.arange(cells)[:, None] * factor + np.arange(2 * factor) - factor // 2
    weights = np.tile(tent / tent.sum(), cells).astype(np.float32)
    places = np.repeat(np.arange(cells), 2 * factor), at.clip(0, cells * factor - 1).ravel()
    return csr_array((weights, places), shape=(cells, cells * factor))


def coarsen(fine: F32, factor: int) -> F32:
    """Compute the heights of the cells from the heights of the pixels (S2)."""
    down, along = (coarsening(n // factor, factor) for n in fine.shape)
    return np.ascontiguousarray(down @ fine @ along.T)


def _laplacian(z: F32) -> F32:
    out = np.asarray(cv2.Laplacian(z, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_CONSTANT))
    out[0] = out[-1] = out[:, 0] = out[:, -1] = 0
    return out


def _gradient(height: F32, pixel: float, axis: int, border: int = cv2.BORDER_DEFAULT) -> F32:
    out = cv2.Sobel(height, cv2.CV_32F, 1 - axis, axis, scale=1 / (8 * pixel), borderType=border)
    return np.asarray(out, np.float32)


def gradients(height: F32, pixel: float) -> tuple[F32, F32]:
    """Compute Sobel gradients per column and per row, (R, C) metres per metre; `pixel`: width of a pixel, metres."""
    return _gradient(height, pixel, 0), _gradient(height, pixel, 1)


def _up(along: F32, across: F32) -> F32:
    return np.asarray(1 / np.sqrt(1 + along * along + across * across), np.float32)


@dataclass(frozen=True, eq=False)
class Sunlight:
    """Brightness = sun . normal + ambient, for Lambertian ground of one class seen from above (S1)."""

    sun: F64  # (3,) grey levels along columns, rows and up
    ambient: float  # grey levels
    spread: float  # grey levels, 1-sigma of the residual
    explained: float  # share of the image's variance that the model explains

    def brightness(self, along: F32, across: F32) -> tuple[F32, F32, F32]:
        """Compute the brightness (R, C) at gradients per column and row, and its derivatives with respect to them."""
        ax, ay, az = (np.float32(v) for v in self.sun)
        n = _up(along, across)
        facing = (az - ax * along - ay * across) * n
        d_along = -ax * n - facing * along * n * n
        d_across = -ay * n - facing * across * n * n
        out: tuple[F32, F32, F32] = (facing + np.float32(self.ambient), d_along, d_across)
        return out


def _fitted(terms: F32, image: F32) -> F64:
    a, b = terms.astype(np.float64), image.astype(np.float64)
    return np.asarray(np.linalg.lstsq(a.T @ a, a.T @ b, rcond=1e-9)[0])


def find_light(height: F32, image: F32, lit: Mask, pixel: float) -> Sunlight:
    """Fit the light robustly to the `lit` pixels of an image of ground with known heights (S1)."""
    along, across = gradients(height, pixel)
    n = _up(along, across)
    inner = (slice(2, -2, 2), slice(2, -2, 2))  # every second row and column
    use, along, across, n = lit[inner], along[inner], across[inner], n[inner]
    terms, seen = np.stack([-along * n, -across * n, n, np.ones_like(n)], axis=-1)[use], image[inner][use]
    if seen.size < 100:
        return Sunlight(np.zeros(3), 0.0, math.inf, 0.0)
    x, typical = _fitted(terms, seen), math.inf
    for _ in range(8):
        off = np.abs(seen - terms @ x.astype(np.float32))
        typical = float(np.median(off))
        kept = off < max(4 * typical, 2.0)
        x = _fitted(terms[kept], seen[kept])
    left = np.clip(seen - terms @ x.astype(np.float32), -4 * seen.std(), 4 * seen.std())
    explained = 1 - float((left**2).mean()) / max(float(seen.var()), 1e-9)
    return Sunlight(x[:3], float(x[3]), SIGMA_OF_MAD * typical, explained)


def in_shadow(height: F32, light: Sunlight, pixel: float, longest: int = 400) -> Mask:
    """Return the mask of pixels in shadow: turned away from the sun, or behind an object within `longest` pixels."""
    level, out = math.hypot(light.sun[0], light.sun[1]), np.zeros(height.shape, dtype=np.bool_)
    if level < 1e-6:
        return out
    towards = light.sun[:2] / level
    cast_shadows(height, float(towards[1]), float(towards[0]), light.sun[2] / level * pixel, longest, out)
    along, across = gradients(height, pixel)
    return out | (light.brightness(along, across)[0] < light.ambient)


def shadow_level(image: F32, shadow: Mask) -> float:
    """Return the grey level up to which a pixel may lie in shadow; -inf if fewer than 50 pixels should be in shadow."""
    core = cv2.erode(shadow.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if core.sum() < 50:
        return -math.inf
    return float(np.quantile(image[core], 0.95)) + 2.0


@dataclass(frozen=True, eq=False)
class _Scene:
    cells: F32  # (R, C) metres, no NaN
    cell_weight: F32  # (R, C) 1 / sigma^2; 0 where unknown
    image: F32  # (f * R, f * C) grey levels
    factor: int
    pixel: float  # metres
    tuning: SharpenTuning


def _step(scene: _Scene, z: F32, light: Sunlight, lit: Mask, iterations: int) -> F32:
    """Return a Gauss-Newton correction of heights `z` from cells, shading of `lit` pixels and curvature (S3)."""
    p, q = gradients(z, scene.pixel)
    shade, dp, dq = light.brightness(p, q)
    noise = np.float32(max(light.spread, scene.tuning.shade_floor * float(np.linalg.norm(light.sun))))
    off = scene.image - shade
    weight = lit / noise**2 / (1 + (off / (3 * noise)) ** 2)
    bend = _laplacian(z)
    usual = scene.tuning.bend
    stiff = 1 / np.float32(usual**2) / (1 + (bend / np.float32(3 * usual)) ** 2)
    scale = np.float32(1 / (8 * scene.pixel))

    def transposed(u: F32, v: F32) -> F32:
        along, across = (_gradient(a, scene.pixel, k, cv2.BORDER_CONSTANT) for k, a in enumerate((u, v)))
        return -along - across

    down, wide = (coarsening(n, scene.factor) for n in scene.cells.shape)

    def spread(cells: F32) -> F32:
        return np.ascontiguousarray(down.T @ (scene.cell_weight * cells) @ wide)

    def normal(x: F32) -> F32:
        gx, gy = gradients(x, scene.pixel)
        seen = weight * (dp * gx + dq * gy)
        return np.asarray(
            spread(coarsen(x, scene.factor)) + transposed(dp * seen, dq * seen) + _laplacian(stiff * _laplacian(x))
        )

    right = spread(scene.cells - coarsen(z, scene.factor))
    right += transposed(weight * dp * off, weight * dq * off) - _laplacian(stiff * bend)
    diagonal = down.power(2).T @ scene.cell_weight @ wide.power(2) + weight * (dp**2 + dq**2) * 12 * scale**2
    diagonal += 20 * stiff
    matrix = LinearOperator((z.size, z.size), lambda x: normal(x.reshape(z.shape)).ravel(), dtype=np.float32)
    jacobi = LinearOperator((z.size, z.size), lambda x: x.ravel() / diagonal.ravel(), dtype=np.float32)
    return np.asarray(cg(matrix, right.ravel(), rtol=1e-6, maxiter=iterations, M=jacobi)[0].reshape(z.shape))


def _solve(scene: _Scene) -> tuple[F32, Mask] | None:
    """Return fine heights and the mask of lit pixels; None if shading does not explain the image."""
    z = np.asarray(cv2.resize(scene.cells, scene.image.shape[::-1], interpolation=cv2.INTER_CUBIC))
    small = np.asarray(cv2.resize(scene.image, scene.cells.shape[::-1], interpolation=cv2.INTER_AREA))
    known = scene.cell_weight > 0
    coarse = find_light(scene.cells, small, known & (small > np.quantile(small, 0.05)), scene.pixel * scene.factor)
    log.info("shading explains %.0f %% of the image at the size of the cells", 100 * coarse.explained)
    if coarse.explained < scene.tuning.least_explained or coarse.sun[2] <= 0:
        return None
    light, lit, dark = coarse, np.ones(z.shape, dtype=np.bool_), -math.inf
    for steps, iterations in ROUNDS:
        dark = max(dark, shadow_level(scene.image, in_shadow(z, light, scene.pixel)))
        lit = scene.image > dark
        light = find_light(z, scene.image, lit, scene.pixel)
        use = lit.copy()
        use[:2] = use[-2:] = use[:, :2] = use[:, -2:] = False
        for _ in range(steps):
            z = z + _step(scene, z, light, use, iterations)
        at = light.sun.round(1), light.ambient, light.spread, dark
        log.info("light %s, ambient %.1f, left %.2f, shadow below %.0f", *at)
    return np.asarray(cv2.sepFilter2D(z, cv2.CV_32F, UNALTERNATED, UNALTERNATED)), lit


def _sigma(z: F32, lit: Mask, elevation: ElevationMap, factor: int) -> F32:
    """Return the 1-sigma of the fine heights (S4), from the cells' sigma and, mainly in shadow, local detail."""
    detail = z - cv2.GaussianBlur(z, (0, 0), 0.5 * factor)
    near = np.sqrt(cv2.blur(detail**2, (2 * factor + 1, 2 * factor + 1)))
    unseen = np.where(lit, np.float32(0.07), np.float32(0.5)) * near
    own = np.maximum(upsample(elevation.sigma, factor), np.float32(HEIGHT_FLOOR))
    return np.asarray(np.hypot(own, unseen), np.float32)


def sharpen(elevation: ElevationMap, image: U8, tuning: SharpenTuning) -> ElevationMap | None:
    """Refine heights to the pixels of an image of the same ground, lit by the sun and seen from above.

    Args:
        elevation: heights and sigma of the cells; cells that are not trusted stay unknown.
        image: (f * R, f * C) or (f * R, f * C, 3), f = 2, 4, ... pixels per cell, with the same north and extent.
        tuning: constants of the refinement.

    Returns:
        The map on the image's pixels; None if shading explains too little of the image, as on painted ground.

    Raises:
        ValueError: f is not an even whole number.
    """
    factor = image.shape[0] // elevation.grid.rows
    if factor < 2 or factor % 2 or image.shape[:2] != (factor * elevation.grid.rows, factor * elevation.grid.cols):
        raise ValueError("the image must be 2, 4, ... times finer than the heights, and of the same extent")
    known = elevation.trusted
    if known.mean() < 0.1:
        return None
    level = float(np.median(elevation.height[known]))
    cells = np.where(known, elevation.height - np.float32(level), np.float32(0))
    weight = np.where(known, 1 / np.maximum(elevation.sigma, np.float32(HEIGHT_FLOOR)) ** 2, np.float32(0))
    pixel = elevation.grid.cell / factor
    fine = grey_levels(image).astype(np.float32) + np.float32(0.5)
    found = _solve(_Scene(cells, weight, fine, factor, pixel, tuning))
    if found is None:
        return None
    z, lit = found[0] + np.float32(level), found[1]
    return replace(
        elevation,
        grid=elevation.grid.finer(factor),
        height=np.where(upsample(np.isfinite(elevation.height), factor), z, np.float32(np.nan)),
        sigma=_sigma(z, lit, elevation, factor),
        flags=upsample(elevation.flags, factor),
        views=upsample(elevation.views, factor),
        rgb=rgb_levels(image),
        residual=upsample(elevation.residual, factor),
        sampling=upsample(elevation.sampling, factor),
        fine=None,
        fine_sampling=np.full(z.shape, pixel, np.float32),
    )
