"""Functions of single values, for features."""

from __future__ import annotations

import numpy as np

from alight.arrays import F32


def linear_ramp(values: F32, low: float, high: float) -> F32:
    """0 below `low`, 1 above `high`, linear between; NaN gives 0."""
    scaled = np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(np.nan_to_num(scaled), np.float32)


def log_at_least(values: F32, floor: float) -> F32:
    """Natural logarithm of max(values, floor); NaN gives log(1) = 0."""
    return np.asarray(np.log(np.maximum(np.nan_to_num(values, nan=1.0), np.float32(floor))), np.float32)


def log_offset(values: F32, offset: float) -> F32:
    """Natural logarithm of values + offset; NaN counts as 0."""
    return np.asarray(np.log(np.nan_to_num(values) + np.float32(offset)), np.float32)
