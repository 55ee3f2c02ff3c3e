"""Rates of hazards: log of the expected number of hazards as a sum of rising piecewise linear curves, one a term."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from alight.arrays import F32, F64
from alight.learned.tables import arrays_of, table_path
from alight.learned.terms import DENSITY_TERMS, GROUND_TERMS, NEAR_TERMS, RELIEF_TERMS

TERMS_OF = {
    "relief_rate": RELIEF_TERMS, "density_rate": DENSITY_TERMS, "ground_rate": GROUND_TERMS,
    "near_obstacle_rate": NEAR_TERMS, "near_ground_rate": NEAR_TERMS,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rate:
    """A fitted rate, which never falls as a term grows."""

    terms: tuple[str, ...]  # identifiers (`terms`)
    knots: F64  # (T, K) values of each term, ascending; beyond the first and the last the line is level
    heights: F64  # (T, K) of the line at the knots, rising from 0
    bias: float  # log of the rate where every line is 0

    def log_rate(self, found: Mapping[str, F32]) -> F32:
        """Natural logarithm of the expected number of hazards, of the shape of the terms.

        Raises:
            KeyError: a term of the rate is missing.
        """
        total: F64 | float = self.bias
        for name, at, height in zip(self.terms, self.knots, self.heights, strict=True):
            total = total + np.interp(found[name], at, height)
        return np.asarray(total, np.float32)


@cache
def read_rate(name: str) -> Rate:
    """Read and check a rate of the package (one of `TERMS_OF`), once.

    Raises:
        ValueError: the file does not fit this version: other terms, shapes that do not fit, a line that falls.
    """
    return rate_of(table_path(name).read_bytes(), TERMS_OF[name])


def rate_of(content: bytes, terms: tuple[str, ...]) -> Rate:
    """Read a rate from the bytes of its file; check it against the terms that this version computes.

    Raises:
        ValueError: as `read_rate`.
    """
    arrays = arrays_of(content, terms)
    knots, heights = (arrays[k].astype(np.float64) for k in ("knots", "heights"))
    if knots.shape != heights.shape or knots.shape[0] != len(terms):
        raise ValueError("the shapes of the table's lines do not fit its terms")
    if not all(np.isfinite(a).all() for a in (knots, heights, arrays["bias"])):
        raise ValueError("the table holds numbers that are not finite")
    if (np.diff(knots, axis=1) <= 0).any() or (np.diff(heights, axis=1) < 0).any():
        raise ValueError("the table holds a line that falls, or knots that do not ascend")
    return Rate(terms, knots, heights, float(arrays["bias"]))


def rate_bytes(rate: Rate) -> bytes:
    """Content of the file (.npz) of a rate."""
    out = io.BytesIO()
    np.savez_compressed(
        out, terms=np.array(rate.terms), knots=rate.knots.astype(np.float32),
        heights=rate.heights.astype(np.float32), bias=np.float64(rate.bias),
    )  # fmt: skip
    return out.getvalue()
