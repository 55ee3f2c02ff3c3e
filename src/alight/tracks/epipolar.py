"""Two-view geometry of a feature: inverse depth and distance from the epipolar line (M2, M3)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, skew
from alight.tracks.transfer_kernels import line_distances, triangulate_matches


def inverse_depth(first: F64, other: F64, other_from_first: Pose) -> tuple[F64, F64]:
    """Triangulate normalised matches: inverse depth in the first camera (M2).

    Args:
        first, other: (N, 2) normalised coordinates.

    Returns:
        (N,) inverse depth [1/m], negative where the rays diverge; (N,) length of its derivative's inverse, so that
        the sigma of the inverse depth is the sigma of a normalised coordinate over it.
    """
    depth, arm = np.empty(len(first)), np.empty(len(first))
    triangulate_matches(first, other, other_from_first.rotation, other_from_first.translation, depth, arm)
    return depth, arm


def epipolar_distance(first: F64, other: F64, other_from_first: Pose) -> F64:
    """Return the (N,) distance of `other` from the epipolar line of `first`, both normalised (M3)."""
    out = np.empty(len(first))
    line_distances(first, other, skew(other_from_first.translation) @ other_from_first.rotation, out)
    return out
