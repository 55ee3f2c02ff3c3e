"""Gaussian means, plain and of the known cells only (normalised convolution, Knutsson and Westin 1993)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32

LEAST_SHARE = np.float32(1e-3)  # of a Gaussian's weight on known cells: below, no mean is given
NARROWEST = 0.3  # cells, 1-sigma: a narrower Gaussian is the cell itself
DENSE_SIGMA = 6.0  # cells, 1-sigma up to which `gaussian_mean` works on every cell
MASKED_SIGMA = 4.0  # cells, 1-sigma to which `masked_gaussian` reduces a wide Gaussian
Size = tuple[int, int]  # columns, rows


class WeightedMean(NamedTuple):
    """A weighted mean about every cell, (R, C) each."""

    mean: F32  # not reliable where the share is below `LEAST_SHARE`
    share: F32  # of the Gaussian's weight that lies on cells with weight, 0 to 1


def _blurred_small(values: F32, size: Size, sigma: float) -> F32:
    """Area means on a coarser raster, smoothed there."""
    return np.asarray(cv2.GaussianBlur(cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), sigma))


def _enlarged(values: F32, shape: tuple[int, ...]) -> F32:
    return np.asarray(cv2.resize(values, shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def gaussian_mean(values: F32, sigma: float) -> F32:
    """Gaussian mean of all cells; a wide one is taken on a coarser raster and interpolated.

    Args:
        values: (R, C), no NaN.
        sigma: cells, 1-sigma.
    """
    if sigma <= DENSE_SIGMA:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), max(sigma, NARROWEST)), np.float32)
    n = int(2 * sigma / DENSE_SIGMA)
    size = (max(1, values.shape[1] // n), max(1, values.shape[0] // n))
    return _enlarged(_blurred_small(values, size, sigma / n), values.shape)


def difference_of_gaussians(values: F32, narrow: float, wide: float) -> F32:
    """Detail wider than one Gaussian and narrower than another, (R, C); `narrow`, `wide`: 1-sigma, cells."""
    out = gaussian_mean(values, narrow)
    out -= gaussian_mean(values, wide)
    return out


def weighted_gaussian(values: F32, weight: F32, sigma: float) -> WeightedMean:
    """Gaussian mean of the cells with weight, and the share of the Gaussian on them.

    Args:
        values: (R, C); values where the weight is 0, NaN included, do not count.
        weight: (R, C), at least 0.
        sigma: cells, 1-sigma.
    """
    total = cv2.GaussianBlur(_counted(values, weight), (0, 0), sigma)
    share = np.asarray(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32)
    return WeightedMean(np.asarray(total / np.maximum(share, LEAST_SHARE), np.float32), share)


def masked_gaussian(values: F32, weight: F32, sigma: float) -> F32:
    """Gaussian mean of the cells with weight, NaN where none is near; a wide one is taken on a coarser raster.

    Args:
        values: (R, C); values where the weight is 0, NaN included, do not count.
        weight: (R, C), at least 0.
        sigma: cells, 1-sigma.
    """
    if sigma <= 2 * MASKED_SIGMA:
        return _where_known(weighted_gaussian(values, weight, sigma))
    n = int(sigma / MASKED_SIGMA)
    size = (max(1, round(values.shape[1] / n)), max(1, round(values.shape[0] / n)))
    total, share = (_blurred_small(a, size, sigma / n) for a in (_counted(values, weight), weight))
    mean = np.asarray(total / np.maximum(share, LEAST_SHARE), np.float32)
    return _enlarged(_where_known(WeightedMean(mean, share)), values.shape)


def _counted(values: F32, weight: F32) -> F32:
    return np.asarray(np.where(weight > 0, values * weight, 0), np.float32)


def _where_known(found: WeightedMean) -> F32:
    return np.asarray(np.where(found.share > LEAST_SHARE, found.mean, np.float32(np.nan)), np.float32)
