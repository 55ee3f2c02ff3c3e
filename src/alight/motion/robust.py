"""Which features to believe: most of the ground stands still, and the rest is held to what most of it says (M28)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alight.motion.ekf.observations import PoseConstraint
from alight.records import F64

Mask = NDArray[np.bool_]

_KNEE = 3.0  # times the usual misfit from which on a feature counts for little
_LEAST = 1e-3  # of the usual misfit, in squared sigmas: simulated features may have none
_ROUNDS = 3


def median_residual(misfit: F64) -> float:
    """What features miss by: the (upper) median of their squared misfits a row."""
    middle = len(misfit) // 2  # np.median takes 80 microseconds for the same
    return max(float(np.partition(misfit, middle)[middle]), _LEAST) if len(misfit) else 1.0


def robust_weights(misfit: F64, usual_misfit: float) -> F64:
    """Weights (Geman and McClure) of features by their squared misfit a row; one where it is no more than usual."""
    relative = misfit / usual_misfit
    return np.asarray(np.minimum(1.0, ((1.0 + _KNEE) / (relative + _KNEE)) ** 2))


def agree_on_poses(found: PoseConstraint, P: F64, which: Mask, error: F64) -> tuple[F64, float]:
    """Weights of N features that measure poses together, by what each misses when all have had their say; the usual.

    Args:
        P: (6K, 6K) covariance of the poses before.
        which: (N,) those that take part; the others get none.
        error: (6K,) by which the poses have been moved from where `P` is about.
    """
    weight, freedom, step, typical = which.astype(float), np.maximum(found.freedom, 1), np.zeros(len(P)), 0.0
    for _ in range(_ROUNDS if which.any() else 0):
        misfit = np.maximum(found.misfits(step), 0.0) / freedom
        typical = median_residual(misfit[which])
        weight = which * robust_weights(misfit, typical)
        A, b = found.information(weight)
        step = P @ np.linalg.solve(np.eye(len(P)) + A @ P, b + A @ error) - error
    return weight, typical
