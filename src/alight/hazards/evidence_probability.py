"""P(safe) of the evidence against a footprint, for heights from matched images (docs/method/hazards.md, G7b)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from alight.arrays import F32
from alight.learned import monotone_costs, read_net
from alight.learned.terms import HazardTerm


class PriorPenalty(NamedTuple):
    """Log odds that a term costs at least, linear between two of its values."""

    low: float
    high: float
    per_unit: float  # log odds a unit of the term


# Set by hand, because the training flights do not show it: no stone lies on their bare concrete, and no gap in their
# heights is half a footprint.
PRIOR_PENALTIES = {
    HazardTerm.UNKNOWN: PriorPenalty(0.05, 0.35, 8.0),
    HazardTerm.ROUGHNESS_SMOOTH: PriorPenalty(-0.7, 0.4, 2.0),
    HazardTerm.ROUGHNESS_TREND: PriorPenalty(-0.7, 0.0, 3.0),
    HazardTerm.EXCESS_SIGMAS: PriorPenalty(-1.5, 2.0, 0.7),
    HazardTerm.DEVIATION_SIGMAS: PriorPenalty(-2.0, 3.0, 0.5),
    HazardTerm.BLOB_DARK: PriorPenalty(0.25, 1.2, 5.0),
    HazardTerm.BLOB_BRIGHT: PriorPenalty(0.3, 1.2, 3.0),
}


def prior_penalties(terms: Mapping[str, F32]) -> F32:
    """Log odds that the evidence costs at least, of the shape of each term."""
    costs = [
        (terms[name].clip(p.low, p.high) - np.float32(p.low)) * np.float32(p.per_unit)
        for name, p in PRIOR_PENALTIES.items()
    ]
    return np.asarray(sum(costs), np.float32)


def evidence_probability(terms: Mapping[str, F32]) -> F32:
    """P(a touchdown keeps every limit) from the evidence, (R, C); NaN terms give NaN.

    No term makes it larger by growing. The log odds are replaced by those that held on flights left out of the fit;
    `learned/p_safe.md` says what that is worth and where it ends.

    Args:
        terms: (R, C) each, one for every `HazardTerm`.
    """
    net = read_net("p_safe")
    assert net.calibration is not None
    penalties = prior_penalties(terms)
    odds = -penalties.ravel() - monotone_costs(net, terms)
    return np.asarray(expit(np.interp(odds, *net.calibration)), np.float32).reshape(penalties.shape)
