"""Robust weights: the cost functions of all estimators, and the weights of features that constrain poses (M28)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64, Mask
from alight.motion.points import PoseConstraint

_KNEE = 3.0  # medians of the residual: the larger, the slower the weight of a feature falls beyond the median


def cauchy(square: F64, scale: float) -> tuple[F64, float]:
    """Return the Cauchy weights (N,) of squared residuals (N,), and the total cost; `scale`: residual of weight 1/2."""
    q = square / scale**2
    return 1.0 / (1.0 + q), float(scale**2 * np.log1p(q).sum())


def huber(square: F64, scale: float) -> tuple[F64, float]:
    """Return the Huber weights (N,) of squared residuals (N,), and the total cost; `scale`: largest of weight 1."""
    n = np.sqrt(square)
    cost = float(np.where(n <= scale, square, 2 * scale * n - scale**2).sum())
    return scale / np.maximum(n, scale), cost


def median_of(values: F64) -> float:
    """Return the (upper) median of (N,) values, N > 0."""
    middle = len(values) // 2  # np.median takes 80 microseconds for the same result
    return float(np.partition(values, middle)[middle])


def median_residual(misfit: F64) -> float:
    """Return the median of (N,) squared residuals per row or degree of freedom; at least 0.001, and 1 if N is 0."""
    return max(median_of(misfit), 1e-3) if len(misfit) else 1.0  # simulated features may have no residual at all


def robust_weights(misfit: F64, median: float) -> F64:
    """Return the Geman-McClure weights (1987) of squared residuals, (N,); 1 for residuals up to their `median`."""
    relative = misfit / median
    return np.asarray(np.minimum(1.0, ((1.0 + _KNEE) / (relative + _KNEE)) ** 2))


def robust_pose_weights(constraint: PoseConstraint, P: F64, used: Mask, error: F64) -> tuple[F64, float]:
    """Return the (N,) weights of features in one update of the poses, and their median residual.

    Args:
        P: (6K, 6K) covariance of the poses before the update.
        used: (N,) whether a feature takes part; the others get weight zero.
        error: (6K,) errors by which the poses have moved from the mean of the prior.
    """
    # iteratively reweighted least squares: each feature is weighted by its residual after the update
    weight, freedom, step, median = used.astype(float), np.maximum(constraint.freedom, 1), np.zeros(len(P)), 0.0
    for _ in range(3 if used.any() else 0):
        misfit = np.maximum(constraint.misfit_at(step), 0.0) / freedom
        median = median_residual(misfit[used])
        weight = used * robust_weights(misfit, median)
        A, b = constraint.information(weight)
        step = P @ np.linalg.solve(np.eye(len(P)) + A @ P, b + A @ error) - error
    return weight, median
