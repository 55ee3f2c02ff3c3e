"""How far a height can be trusted: sigma, and the flags that override it (docs/method.md, section 4).

Sigma says how well a surface fits; whether it is the right surface needs its own evidence: texture, the second-best
cost, what the views do not share, neighbours, steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.kernels import trust as kernels
from alight.parallax.refine import Fit, middle
from alight.parallax.views import NORM_FLOOR, Prepared, maps, sample
from alight.records import F32, U16, Flag

MIN_CONTRAST = 0.7  # grey levels that the views have in common and in noise: less carries no height
MAX_RESIDUAL = 0.5  # share of the samples' variance nearby that the views do not have in common
MAX_COST_RATIO = 1.04  # best over second-best cost, mean nearby: above 1 the smoothing overruled what the cells saw
FLOOR_PX = 0.1  # parallax pixels: what does not average away with the number of views
FLOOR_CELL = 0.3  # cells: a window is no point
STEP_PX = 4.0  # parallax pixels
STEP_CELLS = 2  # reach of the window over a step, cells of half resolution
MAX_DOUBT = 0.25  # probability of a wrong match that is still given out

# Odds of being off by more than a hundredth of the height (eq. 15): log-linear in evidence without unit, so that it
# means the same for any camera and height. Between what bench/doubt.py fits on simulated flights, where the second-best
# cost says nothing that the others do not, and what real photos need, where it does.
DOUBT = {"ambiguity": 1.2, "residual": 1.2, "sigma": 0.3, "drop": 0.8, "rise": 0.8, "slide": -2.2, "one": -1.26}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of each cell beside the fit; all (R, C)."""

    cost_ratio: F32  # best over second-best sweep cost
    texture: F32  # variance of the template nearby
    residual: F32  # share of the variance that the views do not have in common
    grey: F32  # (R / 2, C / 2) mean grey level of the views
    slide: F32  # baseline of the views that see a cell over their height above it
    low: float  # metres, lowest searched height
    high: float


def variance_of(mean: F32) -> F32:
    """Variance of the template over 5x5 cells: the texture that all views share."""
    filled = np.where(np.isfinite(mean), mean, np.float32(0))
    local = cv2.blur(filled, (5, 5))
    np.multiply(local, local, out=local)
    np.subtract(cv2.sqrBoxFilter(filled, cv2.CV_32F, (5, 5)), local, out=local)
    return np.asarray(np.maximum(local, 0, out=local), dtype=np.float32)


def residual_share(fit: Fit, texture: F32) -> F32:
    """The share of the samples' variance that the views do not have in common: 0 perfect, 1 nothing."""
    return np.asarray(fit.noise / np.maximum(texture + fit.noise, 1e-6), dtype=np.float32)


def relief2(height: F32) -> F32:
    """Variance of the heights about the smoothed ones over 5x5 cells, metres^2."""
    filled = _filled(height)
    off = np.subtract(filled, cv2.GaussianBlur(filled, (0, 0), 1.5), out=filled)
    return np.asarray(cv2.blur(np.multiply(off, off, out=off), (5, 5)), dtype=np.float32)


def sigma(fit: Fit, cell: float) -> F32:
    """1-sigma of each height relative to the map (eq. 14): fit, a floor in pixels and cells, local relief."""
    out = np.empty_like(fit.height)
    rough2 = relief2(fit.height)
    kernels.sigma(fit.height, fit.noise, fit.precision, fit.metres_per_px, rough2, FLOOR_PX, FLOOR_CELL * cell, out)
    return out


def _filled(height: F32) -> F32:
    return np.where(np.isfinite(height), height, np.float32(middle(height)))


def _halved(values: F32) -> F32:
    """Means of 2 x 2 cells."""
    size = (-(-values.shape[1] // 2), -(-values.shape[0] // 2))
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _pooled(values: F32, choose: np.ufunc) -> F32:
    """Least or greatest of 2 x 2 cells."""
    even = np.pad(values, [(0, n % 2) for n in values.shape], mode="edge")
    rows = choose(even[::2], even[1::2])
    return np.ascontiguousarray(choose(rows[:, ::2], rows[:, 1::2]))


def _near(values: F32) -> F32:
    """Mean over 10 x 10 cells at half resolution: what is near needs no more."""
    return np.asarray(cv2.blur(_halved(values), (5, 5)), dtype=np.float32)


def evidence(fit: Fit, seen: Evidence, sigma_: F32, ambiguity: F32) -> dict[str, F32]:
    """What speaks for a wrong match, without unit, at half resolution: the terms of eq. 15 before the logarithm.

    ambiguity: best over second-best cost nearby; residual: share of the variance that the views do not share, nearby;
    sigma: claimed sigma nearby, parallax pixels; drop and rise: to the lowest and highest neighbour, parallax pixels
    (the high side of a step is where windows smear); slide: baseline over height.
    """
    per_px = _halved(fit.metres_per_px)
    sigma_px = np.fmin(sigma_ / fit.metres_per_px, np.float32(5.0))  # 5 where there is none
    filled = _filled(fit.height)
    low, high = _pooled(filled, np.minimum), _pooled(filled, np.maximum)
    near = np.ones((2 * STEP_CELLS + 1,) * 2, np.uint8)
    return {
        "ambiguity": np.clip(ambiguity, 1e-2, 1.0),
        "sigma": np.clip(np.sqrt(_near(sigma_px**2)), 5e-2, 50.0),
        "residual": np.clip(_near(seen.residual), 1e-2, 1.0),
        "drop": np.clip((high - cv2.erode(low, near)) / per_px, 5e-2, 50.0),
        "rise": np.clip((cv2.dilate(high, near) - low) / per_px, 5e-2, 50.0),
        "slide": np.clip(_halved(seen.slide), 1e-2, 2.0),
    }


def doubt(terms: dict[str, F32]) -> F32:
    """Probability that a height is off by more than a hundredth of the height above it (eq. 15)."""
    score = sum((np.float32(DOUBT[k]) * np.log(v) for k, v in terms.items()), start=np.float32(DOUBT["one"]))
    return np.asarray(1.0 / (1.0 + np.exp(-score)), dtype=np.float32)


def brightness(prepared: list[Prepared], grid: Grid, height: F32) -> F32:
    """Mean grey level of the views at half resolution, NaN where none sees."""
    wide = grid.coarser(2)
    level = _halved(_filled(height))
    total, count = np.zeros(wide.shape, np.float32), np.zeros(wide.shape, np.float32)
    for p in prepared:
        grey = sample(p.grey, *maps(p, wide, level))
        seen = np.isfinite(grey)
        total += np.where(seen, grey, 0)
        count += seen
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, dtype=np.float32)


def flags(fit: Fit, seen: Evidence, sigma_: F32) -> U16:
    """The reasons, as bits of `Flag`, why each height is missing or doubtful."""
    ambiguity = _near(np.where(np.isfinite(seen.cost_ratio), seen.cost_ratio, np.float32(1)))
    terms = evidence(fit, seen, sigma_, ambiguity)
    near = _bit(terms["residual"] > MAX_RESIDUAL, Flag.MOVING)
    near |= _bit(ambiguity > MAX_COST_RATIO, Flag.AMBIGUOUS)
    near |= _bit((seen.grey < 3) | (seen.grey > 252), Flag.SATURATED)
    near |= _bit(np.maximum(terms["drop"], terms["rise"]) > STEP_PX, Flag.STEP)
    near |= _bit(doubt(terms) > MAX_DOUBT, Flag.UNSURE)
    edge = 0.01 * (seen.high - seen.low)
    limits = (seen.low + edge, seen.high - edge, (MIN_CONTRAST / NORM_FLOOR) ** 2)
    bits = (Flag.UNSEEN, Flag.INCONSISTENT, Flag.FEW, Flag.TEXTURE, Flag.RANGE)
    out = np.empty(fit.height.shape, np.uint16)
    kernels.flag(
        near, fit.height, fit.seen, fit.used, fit.precision, seen.texture, fit.noise, limits, tuple(map(int, bits)), out
    )
    return out


def _bit(where: NDArray[np.bool_], flag: Flag) -> U16:
    return np.where(where, np.uint16(flag), np.uint16(0))
