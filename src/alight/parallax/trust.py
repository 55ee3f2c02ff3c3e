"""How far a height can be trusted: sigma, and the flags that override it (docs/method.md, section 4).

Sigma says how well a surface fits; whether it is the right surface needs its own evidence: texture, the second-best
cost, what the views do not share, neighbours, steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.parallax.refine import Fit
from alight.parallax.views import Prepared, sample
from alight.records import F32, U16, Flag

MIN_CONTRAST = 1.2  # grey levels: less is noise
MAX_RESIDUAL = 0.5  # share of the samples' variance nearby that the views do not have in common
MAX_COST_RATIO = 1.04  # best over second-best cost, mean nearby: above 1 the smoothing overruled what the cells saw
FLOOR_PX = 0.1  # parallax pixels: what does not average away with the number of views
FLOOR_CELL = 0.3  # cells: a window is no point
ROUGH_SHARE = 1.0  # of the local roughness counts as error: windows flatten it
STEP_PX = 4.0  # parallax pixels
STEP_CELLS = 5  # reach of the window over a step
MAX_DOUBT = 0.25  # probability of a wrong match that is still given out

# Odds of being off by more than four parallax pixels (eq. 15): log-linear in evidence without unit, so that it means
# the same for any camera and height. Fitted by bench/doubt.py on simulated flights; it holds on real photos unchanged.
DOUBT = {"ambiguity": 1.2, "residual": 1.12, "sigma": 1.26, "drop": 0.07, "rise": 0.34, "one": 0.14}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of each cell beside the fit; all (R, C)."""

    cost_ratio: F32  # best over second-best sweep cost
    contrast: F32  # grey levels, largest local sd that a view saw
    grey: F32  # mean grey level of the views
    low: float  # metres, lowest searched height
    high: float


def variance_of(mean: F32) -> F32:
    """Variance of the template over 5x5 cells: the texture that all views share."""
    filled = np.nan_to_num(mean)
    box = (5, 5)
    return np.asarray(np.maximum(cv2.blur(filled * filled, box) - cv2.blur(filled, box) ** 2, 0), dtype=np.float32)


def residual_share(fit: Fit) -> F32:
    """The share of the samples' variance that the views do not have in common: 0 perfect, 1 nothing."""
    texture = variance_of(fit.mean)
    return np.asarray(fit.noise / np.maximum(texture + fit.noise, 1e-6), dtype=np.float32)


def roughness(height: F32) -> F32:
    """Rms deviation from the smoothed heights over 5x5 cells, metres."""
    filled = _filled(height)
    return np.asarray(
        np.sqrt(np.maximum(cv2.blur((filled - cv2.GaussianBlur(filled, (0, 0), 1.5)) ** 2, (5, 5)), 0)),
        dtype=np.float32,
    )


def sigma(fit: Fit, metres_per_px: F32, cell: float) -> F32:
    """1-sigma of each height relative to the map (eq. 14): fit, a floor in pixels and cells, local roughness."""
    with np.errstate(divide="ignore", invalid="ignore"):
        fitted = 2.0 * fit.noise / fit.precision
    floor = (FLOOR_PX * metres_per_px) ** 2 + (FLOOR_CELL * cell) ** 2
    total = fitted + floor + (ROUGH_SHARE * roughness(fit.height)) ** 2
    return np.asarray(np.where(np.isfinite(total), np.sqrt(total), np.nan), dtype=np.float32)


def _filled(height: F32) -> F32:
    middle = float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0
    return np.nan_to_num(height, nan=middle).astype(np.float32)


def _near(values: F32) -> F32:
    return np.asarray(cv2.blur(np.nan_to_num(values, nan=1.0).astype(np.float32), (9, 9)), dtype=np.float32)


def evidence(fit: Fit, seen: Evidence, sigma_: F32, metres_per_px: F32) -> dict[str, F32]:
    """What speaks for a wrong match, each (R, C) and without unit: the terms of eq. 15 before the logarithm.

    ambiguity: best over second-best cost nearby; residual: share of the variance that the views do not share, nearby;
    sigma: claimed sigma nearby, parallax pixels; drop and rise: to the lowest and highest neighbour, parallax pixels
    (the high side of a step is where windows smear).
    """
    height = _filled(fit.height)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * STEP_CELLS + 1, 2 * STEP_CELLS + 1))
    sigma_px = np.minimum(np.nan_to_num(sigma_ / metres_per_px, nan=5.0), 5.0)
    return {
        "ambiguity": np.clip(_near(seen.cost_ratio), 1e-2, 1.0),
        "residual": np.clip(_near(residual_share(fit)), 1e-2, 1.0),
        "sigma": np.clip(np.sqrt(_near(sigma_px**2)), 5e-2, 50.0),
        "drop": np.clip((height - cv2.erode(height, disc)) / metres_per_px, 5e-2, 50.0),
        "rise": np.clip((cv2.dilate(height, disc) - height) / metres_per_px, 5e-2, 50.0),
    }


def doubt(terms: dict[str, F32]) -> F32:
    """Probability that a height is off by more than four parallax pixels, whatever its sigma says (eq. 15)."""
    score = sum((DOUBT[k] * np.log(v) for k, v in terms.items()), start=np.float32(DOUBT["one"]))
    return np.asarray(1.0 / (1.0 + np.exp(-score)), dtype=np.float32)


def photometry(prepared: list[Prepared], placed: list[tuple[F32, F32]]) -> tuple[F32, F32]:
    """Largest local contrast and mean grey level of the views, sampled at their maps `placed`, grey levels."""
    contrast, total, count = (np.zeros(placed[0][0].shape, np.float32) for _ in range(3))
    for p, (mx, my) in zip(prepared, placed, strict=True):
        seen = mx >= 0
        contrast = np.fmax(contrast, sample(p.contrast, mx, my))
        total += np.where(seen, np.nan_to_num(sample(p.grey, mx, my)), 0)
        count += seen
    return contrast, np.asarray(total / np.maximum(count, 1), dtype=np.float32)


def flags(fit: Fit, seen: Evidence, sigma_: F32, metres_per_px: F32) -> U16:
    """The reasons, as bits of `Flag`, why each height is missing or doubtful."""
    out = np.zeros(fit.height.shape, np.uint16)

    def mark(where: NDArray[np.bool_], flag: Flag) -> None:
        out[where] |= np.uint16(flag)

    terms = evidence(fit, seen, sigma_, metres_per_px)
    edge = 0.01 * (seen.high - seen.low)
    mark(~np.isfinite(fit.height) | (fit.seen < 2), Flag.UNSEEN)
    mark((fit.used < 2) | (fit.precision <= 0), Flag.INCONSISTENT)
    mark(fit.seen < 3, Flag.FEW)
    mark(seen.contrast < MIN_CONTRAST, Flag.TEXTURE)
    mark(terms["residual"] > MAX_RESIDUAL, Flag.MOVING)
    mark(_near(seen.cost_ratio) > MAX_COST_RATIO, Flag.AMBIGUOUS)
    mark((seen.grey < 3) | (seen.grey > 252), Flag.SATURATED)
    mark((fit.height < seen.low + edge) | (fit.height > seen.high - edge), Flag.RANGE)
    mark(np.maximum(terms["drop"], terms["rise"]) > STEP_PX, Flag.STEP)
    mark(doubt(terms) > MAX_DOUBT, Flag.UNSURE)
    return out
