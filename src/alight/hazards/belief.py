"""P(safe) of heights from matched images: one last step, fitted to flights with truth (docs/method-hazards.md, G7b)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from alight.hazards.weights import BASE, CALIBRATION, RAMPS
from alight.records import F32


def ramps(values: F32, knots: tuple[float, ...]) -> list[F32]:
    """How far a term has come from each knot to the next, 0 to 1."""
    return [
        np.asarray(((values - np.float32(a)) / np.float32(b - a)).clip(0, 1), np.float32) for a, b in pairwise(knots)
    ]


def safe_belief(found: dict[str, F32]) -> F32:
    """P(a touchdown meets every limit), (R, C); NaN terms give NaN.

    Log odds = BASE - the sum of what each term costs; no term ever costs less where it is larger. What such odds were
    worth on flights that had no part in the fit is what is claimed, and never more than was seen there.
    """
    shape = next(iter(found.values())).shape
    odds: NDArray[np.float32] = np.full(shape, np.float32(BASE), np.float32)
    for name, (knots, costs) in RAMPS.items():
        for ramp, cost in zip(ramps(found[name], knots), costs, strict=True):
            if cost > 0:
                odds -= np.float32(cost) * ramp
    return np.asarray(expit(np.interp(odds, *CALIBRATION)), np.float32)
