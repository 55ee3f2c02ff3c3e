"""Kinds of ground in the training data, and the novelty of evidence against them (docs/method/land-cover.md, T6)."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache

import numpy as np

from alight.arrays import F32
from alight.learned.tables import arrays_of, table_path
from alight.learned.terms import LAND_COVER_TERMS

CLIP = np.float32(8.0)  # spreads
CELLS_AT_A_TIME = 8192  # each is compared with hundreds of kinds of ground


@dataclass(frozen=True, eq=False)
class KnownGround:
    """Means of the kinds of ground in the training data, and the spread about them, in standardised terms."""

    terms: tuple[str, ...]
    usual: F32  # (T,)
    spread: F32  # (T,)
    means: F32  # (K, T)
    whitening: F32  # (T, T): the length of a row vector times it is the distance of Mahalanobis
    limit: float  # squared distance within which 95 of 100 cells lie of families of scenes left out

    def novelty(self, values: F32) -> F32:
        """Squared distance to the nearest kind over the limit, (N,), of terms (N, T): above 1 no kind is similar."""
        centres, out = self.means @ self.whitening, np.empty(len(values), np.float32)
        for first in range(0, len(values), CELLS_AT_A_TIME):
            some = slice(first, first + CELLS_AT_A_TIME)
            z = ((values[some] - self.usual) / self.spread).clip(-CLIP, CLIP) @ self.whitening
            square = (z * z).sum(axis=1)[:, None] - 2 * z @ centres.T + (centres * centres).sum(axis=1)
            out[some] = np.maximum(square.min(axis=1), 0) / np.float32(self.limit)
        return out


@cache
def read_known() -> KnownGround:
    """Read the table of the package.

    Raises:
        ValueError: it was fitted on other terms than this version computes, or its shapes do not fit.
    """
    a = arrays_of(table_path("known_ground").read_bytes(), LAND_COVER_TERMS)
    count = len(LAND_COVER_TERMS)
    if a["means"].shape[1:] != (count,) or a["whitening"].shape != (count, count) or not (a["spread"] > 0).all():
        raise ValueError("the shapes of the table do not fit its terms")
    usual, spread, means, whitening = (a[k].astype(np.float32) for k in ("usual", "spread", "means", "whitening"))
    return KnownGround(LAND_COVER_TERMS, usual, spread, means, whitening, float(a["limit"]))


def known_bytes(k: KnownGround) -> bytes:
    """Content of the file (.npz) of a table."""
    out = io.BytesIO()
    np.savez_compressed(
        out, terms=np.array(k.terms), usual=k.usual, spread=k.spread, means=k.means.astype(np.float16),
        whitening=k.whitening.astype(np.float32), limit=np.float64(k.limit),
    )  # fmt: skip
    return out.getvalue()
