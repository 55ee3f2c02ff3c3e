"""Search region of a feature: the covariance of its predicted pixel, from motion and depth (M1f)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F32, F64, Mask

# (3, 3, 3): points @ [i] is the i-th coordinate of the motion of points by rotations about each axis
_GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], float
)


def pixel_covariance(points: F64, by_depth: F64, focal: float, relative_covariance: F64 | None) -> F64:
    """Return the (N, 2, 2) covariance in px^2 of pixels predicted in a view.

    Args:
        points: (N, 3) m in the camera of that view, as predicted.
        by_depth: (N, 3) m, motion of each point by one sigma of its depth.
        focal: px.
        relative_covariance: (6, 6) of the rotation and shift of all points in that camera; None: exact.
    """
    along = _pixel_motion(points, by_depth[:, :, None], focal)[..., 0]
    out = along[:, :, None] * along[:, None, :]
    if relative_covariance is None:
        return np.asarray(out)
    value, vector = np.linalg.eigh(relative_covariance)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    moves = points @ _GENERATORS @ root[:3] + root[3:, None]  # (3, N, 6) of the points, in the camera
    by_change = _pixel_motion(points, moves.transpose(1, 0, 2), focal)
    return np.asarray(out + by_change @ by_change.transpose(0, 2, 1))


def _pixel_motion(points: F64, moves: F64, focal: float) -> F64:
    """(N, 2, M) px of (N, 3, M) motions of (N, 3) points."""
    z = np.maximum(points[:, 2, None], 1e-9)
    return np.asarray(focal / z[..., None] * (moves[:, :2] - (points[:, :2] / z)[..., None] * moves[:, 2:]))


def inside_search_region(offset: F32 | F64, covariance: F64, sigmas: float, least: float) -> Mask:
    """Return which of (N, 2) offsets from a predicted pixel lie inside some sigmas of it.

    Args:
        covariance: (N, 2, 2) of the prediction, px^2.
        least: px, sigma added in every direction: of the match, and of errors that the covariance leaves out.
    """
    a, b, c = covariance[:, 0, 0] + least**2, covariance[:, 0, 1], covariance[:, 1, 1] + least**2
    x, y = offset[:, 0].astype(np.float64), offset[:, 1].astype(np.float64)
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= sigmas**2 * (a * c - b * b))
