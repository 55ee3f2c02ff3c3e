"""P(safe) of heights from matched images: one last step, fitted to flights with truth (docs/method/hazards.md, G7b)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from alight.hazards.weights import CALIBRATION, LAYERS, TERMS
from alight.learned.layers import standard, unpack_layer
from alight.records import F32

AT_A_TIME = 1 << 16  # cells
# term: from where to where, and how much a unit of it costs at least in log odds, whatever flights say: on theirs no
# stone lies on bare concrete and no gap is half a footprint
LEAST = {
    "unknown": (0.05, 0.35, 8.0), "even": (-0.7, 0.4, 2.0), "broad": (-0.7, 0.0, 3.0), "over": (-1.5, 2.0, 0.7),
    "rise": (-2.0, 3.0, 0.5), "dark": (0.25, 1.2, 5.0), "bright": (0.3, 1.2, 3.0),
}  # fmt: skip


def least_costs(found: dict[str, F32]) -> F32:
    """Log odds that the evidence costs at least, of the shape of each term."""
    costs = [(found[k].clip(low, high) - np.float32(low)) * np.float32(cost) for k, (low, high, cost) in LEAST.items()]
    return np.asarray(sum(costs), np.float32)


def learned_costs(terms: F32, inner: tuple[F32, F32], outer: tuple[F32, F32]) -> F32:
    """Log odds (N,) that standardised terms (N, T) cost, by a net whose weights are all at least 0.

    Its last layer sees the hidden units and the terms themselves: no term ever costs less where it is larger.
    """
    hidden = np.tanh(terms @ inner[0] + inner[1])
    units = hidden.shape[1]
    out: F32 = hidden @ outer[0][:units] + terms @ outer[0][units:] + outer[1]
    return out[:, 0]


def safe_belief(found: dict[str, F32]) -> F32:
    """P(a touchdown meets every limit), (R, C); NaN terms give NaN.

    No term ever makes it larger where it is larger itself. What the log odds were worth on flights that had no part in
    the fit is what is claimed, and never more than was seen there.
    """
    inner, outer = (unpack_layer(layer) for layer in LAYERS)
    odds: NDArray[np.float32] = -least_costs(found).ravel()
    flat = {name: found[name].ravel() for name in TERMS}
    for first in range(0, odds.size, AT_A_TIME):
        some = slice(first, first + AT_A_TIME)
        terms = np.stack([standard(flat[name][some], *scale) for name, scale in TERMS.items()], axis=1)
        odds[some] -= learned_costs(terms, inner, outer)
    shape = next(iter(found.values())).shape
    return np.asarray(expit(np.interp(odds, *CALIBRATION)), np.float32).reshape(shape)
