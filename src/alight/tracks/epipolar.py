"""Two-view geometry of a feature: inverse depth and distance from the epipolar line (M2, M3)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, skew


def inverse_depth(first: F64, other: F64, other_from_first: Pose) -> tuple[F64, F64]:
    """Triangulate normalised matches: inverse depth in the first camera (M2).

    Args:
        first, other: (N, 2) normalised coordinates.

    Returns:
        (N,) inverse depth [1/m], negative where the rays diverge; (N,) length of its derivative's inverse, so that
        the sigma of the inverse depth is the sigma of a normalised coordinate over it.
    """
    R, t = other_from_first.rotation, other_from_first.translation
    a = first @ R[:, :2].T + R[:, 2]
    u, v = other[:, 0], other[:, 1]
    arm = np.stack([t[1] - t[2] * v, t[2] * u - t[0], t[0] * v - t[1] * u])  # t x (u, v, 1)
    off = np.stack([a[:, 1] - a[:, 2] * v, a[:, 2] * u - a[:, 0], a[:, 0] * v - a[:, 1] * u])
    square = np.maximum((arm * arm).sum(axis=0), 1e-18)
    return -(off * arm).sum(axis=0) / square, np.sqrt(square)


def epipolar_distance(first: F64, other: F64, other_from_first: Pose) -> F64:
    """Return the (N,) distance of `other` from the epipolar line of `first`, both normalised (M3)."""
    E = skew(other_from_first.translation) @ other_from_first.rotation
    lines = np.hstack([first, np.ones((len(first), 1))]) @ E.T
    norm = np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)
    return np.asarray(np.abs((lines[:, :2] * other).sum(axis=1) + lines[:, 2]) / norm)
