"""How far from its guess a feature may be found: what the motion and its depth leave open of its place (M1f)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alight.records import F32, F64

Mask = NDArray[np.bool_]
# (3, 3, 3): points @ [i] is the i-th coordinate of what turns about each axis move them by
_TURNS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], float
)


def scatter(points: F64, by_depth: F64, focal: float, change: F64 | None) -> F64:
    """Return the (N, 2, 2) covariance of pixels that were carried into a view, px^2.

    Args:
        points: (N, 3) m in the camera of that view, as expected.
        by_depth: (N, 3) m by which one sigma of its depth moves each point.
        focal: px.
        change: (6, 6) covariance by which all points are turned and moved together in that camera; None: by nothing.
    """
    along = _seen(points, by_depth[:, :, None], focal)[..., 0]
    out = along[:, :, None] * along[:, None, :]
    if change is None:
        return np.asarray(out)
    value, vector = np.linalg.eigh(change)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    moves = points @ _TURNS @ root[:3] + root[3:, None]  # (3, N, 6) of the points, in the camera
    by_change = _seen(points, moves.transpose(1, 0, 2), focal)
    return np.asarray(out + by_change @ by_change.transpose(0, 2, 1))


def _seen(points: F64, moves: F64, focal: float) -> F64:
    """(N, 2, M) px by which (N, 3, M) moves of (N, 3) points show."""
    z = np.maximum(points[:, 2, None], 1e-9)
    return np.asarray(focal / z[..., None] * (moves[:, :2] - (points[:, :2] / z)[..., None] * moves[:, 2:]))


def within(off: F32, covariance: F64, sigmas: float, least: float) -> Mask:
    """Return which of (N, 2) distances from a guess lie within some sigmas of it.

    Args:
        covariance: (N, 2, 2) of the guess, px^2.
        least: px, sigma added to it in every direction: of the match, and of what no covariance knows.
    """
    a, b, c = covariance[:, 0, 0] + least**2, covariance[:, 0, 1], covariance[:, 1, 1] + least**2
    x, y = off[:, 0].astype(np.float64), off[:, 1].astype(np.float64)
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= sigmas**2 * (a * c - b * b))
