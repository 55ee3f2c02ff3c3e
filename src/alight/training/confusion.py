"""Confusion of true and predicted classes by site, and its consequences for landing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, U8
from alight.records import LANDABLE, Terrain


@dataclass(frozen=True, eq=False)
class Confusion:
    """True and predicted classes of N patches or blocks, by a model with K classes."""

    kinds: U8  # (N,) true Terrain codes
    sites: NDArray[np.str_]  # (N,) site of each patch or block
    classes: U8  # (K,) Terrain codes of the model
    log_p: F64  # (N, K) log probabilities

    def where(self, rows: NDArray[np.bool_]) -> Confusion:
        """Return the confusion of the rows that a mask (N,) selects."""
        return Confusion(self.kinds[rows], self.sites[rows], self.classes, self.log_p[rows])

    @property
    def predicted(self) -> U8:
        """Most probable class of each row, (N,)."""
        return np.asarray(self.classes[self.log_p.argmax(axis=1)])

    @property
    def landable(self) -> F64:
        """P(landable) of each row, (N,): the sum over the landable classes."""
        return np.asarray(np.exp(self.log_p)[:, np.isin(self.classes, LANDABLE)].sum(axis=1))

    @property
    def safe(self) -> NDArray[np.bool_]:
        """Mask of the rows whose true class is landable, (N,)."""
        return np.isin(self.kinds, LANDABLE)

    def accuracy(self) -> float:
        """Return the share of correct predictions."""
        return float((self.predicted == self.kinds).mean())

    def macro_recall(self) -> float:
        """Return the recall (share of correct predictions), averaged over the true classes."""
        return float(np.mean([(self.predicted == k)[self.kinds == k].mean() for k in np.unique(self.kinds)]))

    def hazards_called_safe(self, least: float) -> float:
        """Return the share of hazards with a P(landable) of at least `least`."""
        return _share(self.landable >= least, ~self.safe)

    def safe_refused(self, least: float) -> float:
        """Return the share of landable rows with a P(landable) below `least`."""
        return _share(self.landable < least, self.safe)

    def least_for(self, share: float) -> float:
        """Return the smallest limit of P(landable) at which at most `share` of the hazards pass as safe."""
        hazards = self.landable[~self.safe]
        return float(np.nextafter(np.quantile(hazards, 1 - share, method="higher"), 2.0)) if len(hazards) else 0.5


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float((part & whole).sum() / whole.sum()) if whole.any() else float("nan")


def _table(c: Confusion) -> Iterator[str]:
    columns = [Terrain(k).name.lower() for k in c.classes]
    yield f"{'true, patches':<24}" + "".join(f"{n[:9]:>10}" for n in columns)
    for k in np.unique(c.kinds):
        predicted = c.predicted[c.kinds == k]
        yield f"{f'{Terrain(k).name.lower()}, {len(predicted)}':<24}" + "".join(
            f"{(predicted == n).sum():10d}" for n in c.classes
        )


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.0f} %"


def lines_of(c: Confusion) -> Iterator[str]:
    """Yield the lines of the report: the table of each site, then the table of all sites."""
    for site in np.unique(c.sites):
        here = c.where(c.sites == site)
        yield f"site {site}"
        yield from _table(here)
        yield from _summary(here, 0.5)
        yield ""
    yield "all sites"
    yield from _table(c)
    yield f"accuracy {c.accuracy():.2f}, mean recall of the classes {c.macro_recall():.2f}"
    yield from _summary(c, 0.5)
    if not c.safe.all():
        yield from _summary(c, c.least_for(0.05))


def _summary(c: Confusion, least: float) -> Iterator[str]:
    yield (
        f"asking P(landable) >= {least:.2f}: hazards called safe {_percent(c.hazards_called_safe(least))}, "
        f"safe ground refused {_percent(c.safe_refused(least))}"
    )
