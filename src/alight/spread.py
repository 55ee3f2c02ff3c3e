"""The spread of a sample by its median absolute deviation, and whether an error contradicts its covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

SIGMA_OF_MAD = 1.4826  # sigma of a Gaussian over its median absolute deviation
UNLIKELY = 6.0  # squared error over its covariance, per degree of freedom, from which an update of poses is refused


def robust_sigma(deviations: ArrayLike) -> float:
    """Return the median absolute value of `deviations` as the sigma of a zero-mean Gaussian; NaN without deviations."""
    d = np.asarray(deviations, dtype=np.float64)
    return float(SIGMA_OF_MAD * np.median(np.abs(d))) if d.size else float("nan")


def nmad(values: ArrayLike) -> float:
    """Return the normalised median absolute deviation: `robust_sigma` about the median; NaN if `values` is empty."""
    v = np.asarray(values, dtype=np.float64)
    return robust_sigma(v - np.median(v)) if v.size else float("nan")


def contradicts(square: float, freedom: int) -> bool:
    """Whether a squared error over its covariance, of `freedom` degrees of freedom, is too large for chance, or NaN."""
    return not square <= UNLIKELY * freedom
