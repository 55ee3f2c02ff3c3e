"""Search region of a feature: the covariance of its predicted pixel, from motion and depth (M1f)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F32, F64, Mask
from alight.tracks.transfer_kernels import pixel_covariances


def pixel_covariance(points: F64, by_depth: F64, focal: float, relative_covariance: F64 | None) -> F64:
    """Return the (N, 2, 2) covariance in px^2 of pixels predicted in a view.

    Args:
        points: (N, 3) m in the camera of that view, as predicted.
        by_depth: (N, 3) m, motion of each point by one sigma of its depth.
        focal: px.
        relative_covariance: (6, 6) of the rotation and shift of all points in that camera; None: exact.
    """
    root = np.zeros((6, 0))
    if relative_covariance is not None:
        value, vector = np.linalg.eigh(relative_covariance)
        root = vector * np.sqrt(np.maximum(value, 0.0))
    out = np.empty((len(points), 2, 2))
    pixel_covariances(points, by_depth, focal, root, out)
    return out


def inside_search_region(offset: F32 | F64, covariance: F64, sigmas: float, least: float) -> Mask:
    """Return which of (N, 2) offsets from a predicted pixel lie inside some sigmas of it.

    Args:
        covariance: (N, 2, 2) of the prediction, px^2.
        least: px, sigma added in every direction: of the match, and of errors that the covariance leaves out.
    """
    a, b, c = covariance[:, 0, 0] + least**2, covariance[:, 0, 1], covariance[:, 1, 1] + least**2
    x, y = offset[:, 0].astype(np.float64), offset[:, 1].astype(np.float64)
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= sigmas**2 * (a * c - b * b))
