"""Fit the outlier probability of `alight.parallax.uncertainty` (eq. 15) on tuning flights of the ladder, true poses.

    PYTHONPATH=bench python training/outlier_probability.py   # prints coefficients, and their accuracy a flight

A cell is wrong when its error exceeds a hundredth of the height above it. The logarithms of the evidence are the terms
of a logistic regression; each flight has the same weight, and so have its batch and its ring. Real photos and the
sample flight are not used: they test the result.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from ladder import exposures, rung
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

import alight_sim as simulate
from alight.arrays import F32, F64
from alight.learned import read_wrong_match
from alight.parallax import uncertainty as trust
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.raster import upsample
from alight.records import Flag, Heights, Terrain
from alight.settings import Settings
from alight.settings.tuning.parallax import UncertaintyTuning

FLIGHTS = (
    "meadow/20m/tuning-1", "yard/20m/tuning-1", "village/50m/tuning-1", "quarry/50m/tuning-1", "forest/50m/tuning-1",
    "lakes/50m/tuning-1", "farmland/100m/tuning-1", "meadow/100m/tuning-2", "village/150m/tuning-2",
)  # fmt: skip
WRONG = 0.01  # of the height above the cell
EVERY = 5  # cells: errors of neighbours are correlated


@contextmanager
def overheard() -> Iterator[list[tuple[dict[str, F32], Heights]]]:
    """Record the evidence and the heights of every grid that the trust stage judges in this context."""
    kept: list[tuple[dict[str, F32], Heights]] = []
    evidence, judged = trust.match_evidence, trust.judged
    last: list[dict[str, F32]] = []

    def spy(*args: object) -> dict[str, F32]:
        last.append(evidence(*args))  # type: ignore[arg-type]
        return last[-1]

    def listen(*args: object) -> Heights:
        out = judged(*args)  # type: ignore[arg-type]
        kept.append((last[-1], replace(out, height=out.height.copy())))  # a ring's is overwritten by its next step
        return out

    trust.match_evidence, trust.judged = spy, listen  # type: ignore[assignment]
    yield kept
    trust.match_evidence, trust.judged = evidence, judged


def rows_of(
    terms: dict[str, F32], found: Heights, truth: simulate.SceneTruth, camera: float
) -> tuple[F64, NDArray[np.bool_]]:
    """Logarithms of the evidence (N, terms) and whether each cell is wrong (N,), without water and unseen cells."""
    e, n = np.meshgrid(*found.grid.xy())
    r, c = (np.rint(i).astype(int) for i in truth.grid.index(e, n))
    inside = (r >= 0) & (r < truth.grid.rows) & (c >= 0) & (c < truth.grid.cols)
    r, c = r.clip(0, truth.grid.rows - 1), c.clip(0, truth.grid.cols - 1)
    use = inside & np.isfinite(found.height) & ((found.flags & np.uint16(Flag.UNSEEN)) == 0)
    use &= truth.label[r, c] != Terrain.WATER
    grid = np.zeros_like(use)
    grid[24:-24:EVERY, 24:-24:EVERY] = True
    use &= grid
    at = [np.log(upsample(terms[k], 2, e.shape)[use]) for k in names()]
    wrong = np.abs(found.height - truth.height[r, c]) > WRONG * (camera - truth.height[r, c])
    return np.stack(at, axis=-1).astype(np.float64), wrong[use]


def names() -> list[str]:
    """The terms that have a coefficient."""
    return [k for k in read_wrong_match() if k != "constant"]


def collect(name: str) -> Iterator[tuple[F64, NDArray[np.bool_]]]:
    """Yield the rows of the batch, then of the ring."""
    flight = rung(name).fly()
    shots = list(exposures(flight))
    views = [v for shot in shots for v in shot]
    camera = float(np.median([v.centre[2] for v in views]))
    for method in ("batch", "recursive"):
        batch, recursive = BatchMap(Settings().stages()), RecursiveMap(Settings().stages())
        lane = batch if method == "batch" else recursive
        if not lane.find_ground(views[:: max(1, len(views) // 24)]):
            print(f"{name}: {lane.reason}")
            return
        with overheard() as kept:
            if method == "batch":
                batch.match_tiles(views, lambda share: None)
            else:
                for shot in shots:
                    recursive.step(shot[:1])
                kept = kept[4::4]
        parts = [rows_of(terms, found, flight.truth, camera) for terms, found in kept]
        yield np.concatenate([x for x, _ in parts]), np.concatenate([y for _, y in parts])


def logistic(X: F64, y: NDArray[np.bool_], weight: F64) -> F64:
    """Coefficients of a logistic regression, the constant last, with hardly any penalty."""
    found = LogisticRegression(C=1e6, max_iter=1000, tol=1e-8).fit(X, y, sample_weight=weight)
    return np.r_[found.coef_[0], found.intercept_]


def main() -> None:
    """Fit and print."""
    labels, parts = [], []
    for name in sys.argv[1:] or FLIGHTS:
        for method, part in zip(("batch", "recursive"), collect(name), strict=False):
            labels.append(f"{name} {method}")
            parts.append(part)
            print(f"{labels[-1]}: {len(part[1])} cells, {100 * part[1].mean():.2f} % wrong", flush=True)
    weight = np.concatenate([np.full(len(y), 1 / len(y)) for _, y in parts])
    b = logistic(np.concatenate([x for x, _ in parts]), np.concatenate([y for _, y in parts]), weight)
    fitted = zip([*names(), "constant"], b, strict=True)
    print("wrong_match of learned/heights.yaml:", {k: round(float(v), 2) for k, v in fitted})
    for label, (X, y) in zip(labels, parts, strict=True):
        p = 1 / (1 + np.exp(-(np.c_[X, np.ones(len(X))] @ b)))
        kept = p < UncertaintyTuning().max_outlier
        print(
            f"{label}: given out {100 * kept.mean():.1f} %, of these wrong {100 * (y & kept).sum() / kept.sum():.2f} %"
        )


if __name__ == "__main__":
    main()
