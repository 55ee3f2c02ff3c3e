"""The planes on which a lander rests: on its feet, or on its two skids."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from alight.arrays import F64

_TIE = 1e-6  # metres: all resting poses whose heights differ by less are possible


def resting_on_feet(at: F64, height: F64) -> F64:
    """Return (N, P, 3) planes on which a lander with feet `at` (K, 2) rests on ground `height` (N, K).

    At rest the centre is as low as possible without a foot below the ground: a plane through three feet. Several planes
    for one centre mean that the lander may rock between them; if fewer than P, they are repeated.
    """
    found = []
    for three in combinations(range(len(at)), 3):
        A = np.column_stack([np.ones(3), at[list(three)]])
        if abs(np.linalg.det(A)) < 1e-9:
            continue
        plane = height[:, list(three)] @ np.linalg.inv(A).T
        under = height - plane @ np.column_stack([np.ones(len(at)), at]).T
        lowest = np.where((under <= _TIE).all(axis=1), plane[:, 0], math.inf)
        found.append(np.column_stack([plane, lowest]))
    planes = np.stack(found, axis=1)
    best = planes[:, :, 3].min(axis=1, keepdims=True)
    rests = planes[:, :, 3] <= best + _TIE
    first = np.take_along_axis(planes, np.argmin(planes[:, :, 3], axis=1)[:, None, None], axis=1)
    return np.asarray(np.where(rests[..., None], planes, first)[..., :3])


def resting_on_skids(at: F64, height: F64) -> F64:
    """Return the (N, 2, 3) planes on which two skids rest: at the lowest and at the highest pitch that is stable.

    Args:
        at: (K, 2) metres forward and left of points on the skids, the left skid first.
        height: (N, K) metres, ground below these points.
    """
    half = len(at) // 2
    s, wide = at[:half, 0], float(at[0, 1] - at[half, 1])
    left, right = height[:, :half], height[:, half:]

    def middles(pitch: F64) -> tuple[F64, F64]:
        return (left - pitch[:, None] * s).max(axis=1), (right - pitch[:, None] * s).max(axis=1)

    def total(pitch: F64) -> F64:
        a, b = middles(pitch)
        return a + b

    low, high = np.full(len(height), -4.0), np.full(len(height), 4.0)
    for _ in range(60):
        a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
        left_lower = total(a) <= total(b)
        low, high = np.where(left_lower, low, a), np.where(left_lower, b, high)
    best = 0.5 * (low + high)
    least, ends = total(best), []
    for end in (-4.0, 4.0):
        inside, outside = best.copy(), np.full(len(best), end)
        for _ in range(50):
            middle = 0.5 * (inside + outside)
            rests = total(middle) <= least + _TIE
            inside, outside = np.where(rests, middle, inside), np.where(rests, outside, middle)
        a, b = middles(inside)
        ends.append(np.stack([0.5 * (a + b), inside, (a - b) / wide], -1))
    return np.stack(ends, axis=1)
