"""Uncertainty of heights: sigma, and the flags that override it (docs/method/uncertainty.md).

Sigma measures how well a surface fits. Other evidence shows whether it is the right surface: texture, the second-best
cost, the residual, neighbours, steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8, U16
from alight.geometry import Grid
from alight.learned import SigmaCoefficients, read_sigma, read_wrong_match
from alight.parallax import uncertainty_kernels as kernels
from alight.parallax.gauss_newton import Fit
from alight.parallax.views import NORM_FLOOR, Prepared, maps, sample
from alight.raster import nearest_known, upsample, whole_blocks
from alight.records import Flag, Heights
from alight.settings.tuning.parallax import UncertaintyTuning


@dataclass(frozen=True, eq=False)
class Pooled:
    """Statistics of a fit at half resolution; all arrays are (R / 2, C / 2)."""

    low: F32  # metres, lowest of 2 x 2 cells; the nearest known height where unknown
    high: F32  # metres, highest of 2 x 2 cells
    lowest: F32  # metres, lowest of the cells nearby
    highest: F32  # metres, highest of these cells
    texture: F32  # variance of the template nearby: texture common to all views
    residual: F32  # share of the samples' variance that the views do not have in common, 0 to 1
    noise: F32  # mean residual variance
    hidden2: F32  # metres^2, variance of the relief that the windows smooth away
    sigma2_px: F32  # variance of the heights, parallax pixels^2 (eq. 14)
    metres_per_px: F32


def pooled(fit: Fit, tuning: UncertaintyTuning) -> Pooled:
    """Return the statistics of a fit at half resolution, which suffices for means over neighbours."""
    height, mean, noise, precision, per_px = (
        whole_blocks(a, 2) for a in (fit.height, fit.mean, fit.noise, fit.precision, fit.metres_per_px)
    )
    out = np.empty((8, height.shape[0] // 2, height.shape[1] // 2), np.float32)
    kernels.pool(_filled(height), mean, noise, precision, per_px, 0.0, out)
    low, high, mid, uneven, mean, square, s2, fitted = out
    texture = np.maximum(_box(square, 3) - _box(mean, 3) ** 2, 0)
    per_px = np.ascontiguousarray(per_px[::2, ::2])
    sigma = read_sigma()
    hidden2 = _hidden(mid, uneven, s2, per_px, sigma) + np.float32((sigma.floor_cells * fit.grid.cell) ** 2)
    # eq. 14 for 2 x 2 cells, for the evidence only; `kernels.height_sigma` has it for each height
    sigma2 = np.float32(sigma.fit) * fitted + hidden2 / (per_px * per_px)
    near = np.ones((tuning.near, tuning.near), np.uint8)
    lowest, highest = cv2.erode(low, near), cv2.dilate(high, near)
    share = s2 / np.maximum(texture + s2, 1e-6)
    return Pooled(low, high, lowest, highest, texture, share, s2, hidden2, sigma2, per_px)


def _filled(height: F32) -> F32:
    """Return heights (R, C) with unknown ones replaced by the nearest known ones; R and C must be even."""
    # any other value, such as the mean height of the map, would stand out as a step where the ground slopes
    known = np.isfinite(height)
    if known.all():
        return height
    share = half_resolution(known.astype(np.float32))
    level = half_resolution(np.where(known, height, np.float32(0))) / np.maximum(share, np.float32(0.25))
    return np.where(known, height, upsample(nearest_known(level, share > 0), 2))


def _hidden(mid: F32, uneven: F32, noise: F32, per_px: F32, by: SigmaCoefficients) -> F32:
    """Return the variance of the relief that windows smooth away, metres^2, by a model with the coefficients `by`.

    `mid`: mean height of 2 x 2 cells, metres. `uneven`: variance within them, metres^2. `noise`: residual variance.
    `per_px`: parallax pixel, metres.
    """
    fine, trend = (mid - cv2.GaussianBlur(mid, (0, 0), s) for s in (0.75, 1.5))
    rough, wide = uneven + _box(fine * fine, 3), cv2.GaussianBlur(trend * trend, (0, 0), 1.5)
    square = per_px * per_px
    out = square * np.float32(by.hidden_px**2)
    for variance, power in ((rough, by.fine_power), (wide, by.broad_power)):
        out *= cv2.pow(np.maximum(variance / square, np.float32(1e-4)), 2 * power)
    out *= cv2.pow(np.maximum(noise, np.float32(1e-5)), 2 * by.noise_power)
    return np.asarray(out + np.float32(by.relief) * rough, dtype=np.float32)


def _box(values: F32, cells: int) -> F32:
    return np.asarray(cv2.blur(values, (cells, cells)), dtype=np.float32)


def half_resolution(values: F32) -> F32:
    """Return the means of 2 x 2 cells, (R / 2, C / 2) rounded up."""
    size = (-(-values.shape[1] // 2), -(-values.shape[0] // 2))
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def match_evidence(seen: Pooled, ratio: F32, slide: F32, near: int) -> dict[str, F32]:
    """Return the evidence for a wrong match at half resolution: the dimensionless inputs of eq. 15, by name.

    Over `near` x `near` cells: `ambiguity` is the mean cost `ratio`, `residual` the mean share of the variance that the
    views do not have in common, `sigma` the rms 1-sigma in parallax pixels. `drop` and `rise` are the height
    differences to the lowest and highest neighbour, in parallax pixels. `slide` is the baseline over the height above
    ground.
    """
    return {
        "ambiguity": np.clip(_box(np.where(np.isfinite(ratio), ratio, np.float32(1)), near), 1e-2, 1e3),
        "sigma": np.sqrt(np.clip(_box(np.minimum(seen.sigma2_px, np.float32(25.0)), near), 2.5e-3, 25.0)),
        "residual": np.clip(_box(seen.residual, near), 1e-2, 1.0),
        "drop": np.clip((seen.high - seen.lowest) / seen.metres_per_px, 5e-2, 50.0),
        "rise": np.clip((seen.highest - seen.low) / seen.metres_per_px, 5e-2, 50.0),
        "slide": np.clip(slide, 1e-2, 2.0),
    }


def outlier_probability(terms: dict[str, F32]) -> F32:
    """Return the probability that a height is wrong by more than a hundredth of the height above ground (eq. 15).

    The log odds are linear in the logarithms of the `terms` from `match_evidence`.
    """
    odds = {k: np.float32(v) for k, v in read_wrong_match().items()}
    score = sum((odds[k] * np.log(terms[k]) for k in terms), start=odds["constant"])
    return np.asarray(1.0 / (1.0 + np.exp(-score)), dtype=np.float32)


def brightness(prepared: list[Prepared], grid: Grid, height: F32) -> F32:
    """Return the mean grey level of the views, (R / 2, C / 2), at heights of that shape, metres; NaN: not seen.

    `grid`: the grid at full resolution.
    """
    total, count = np.zeros(height.shape, np.float32), np.zeros(height.shape, np.float32)
    for p in prepared:
        grey = sample(p.grey, *maps(p, *grid.coarser(2).xy(), height))
        seen = np.isfinite(grey)
        total += np.where(seen, grey, 0)
        count += seen
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, dtype=np.float32)


def judged(
    fit: Fit, ratio: F32, lit: list[Prepared], searched: tuple[float, float], sampling: F32, rgb: U8,
    tuning: UncertaintyTuning,
) -> Heights:  # fmt: skip
    """Return the heights of a fit with sigma and flags.

    Args:
        ratio: (R / 2, C / 2) best over second-best cost of the sweep.
        lit: prepared views whose grey levels are tested for saturation.
        searched: lowest and highest height of the search, metres.
        sampling, rgb: (R, C) metres of ground per sample, and (R, C, 3) colours, returned with the heights.
    """
    grid = fit.grid
    seen = pooled(fit, tuning)
    terms = match_evidence(seen, ratio, np.float32(grid.cell) / seen.metres_per_px, tuning.near)
    grey = brightness(lit, grid, np.float32(0.5) * (seen.low + seen.high))
    near = _bit(terms["residual"] > tuning.max_residual, Flag.MOVING)
    near |= _bit(terms["ambiguity"] > tuning.max_cost_ratio, Flag.AMBIGUOUS)
    near |= _bit((grey < 3) | (grey > 252), Flag.SATURATED)
    near |= _bit(np.maximum(terms["drop"], terms["rise"]) > tuning.step_px, Flag.STEP)
    near |= _bit(seen.texture + seen.noise < (tuning.min_contrast / NORM_FLOOR) ** 2, Flag.TEXTURE)
    near |= _bit(outlier_probability(terms) > tuning.max_outlier, Flag.UNSURE)
    edge = 0.01 * (searched[1] - searched[0])
    sigma, residual, flags = (np.empty(grid.shape, t) for t in (np.float32, np.float32, np.uint16))
    # eq. 14 for each cell; `pooled` has it for 2 x 2 cells
    kernels.height_sigma(fit.height, fit.noise, fit.precision, seen.hidden2, read_sigma().fit, sigma)
    kernels.flag(
        near, seen.residual, fit.height, fit.seen, fit.used, sigma, searched[0] + edge, searched[1] - edge,
        (int(Flag.UNSEEN), int(Flag.INCONSISTENT), int(Flag.FEW), int(Flag.RANGE)), residual, flags,
    )  # fmt: skip
    return Heights(grid, fit.height, sigma, flags, fit.seen, rgb, residual, sampling)


def _bit(where: NDArray[np.bool_], flag: Flag) -> U16:
    return where.astype(np.uint16) * np.uint16(flag)
