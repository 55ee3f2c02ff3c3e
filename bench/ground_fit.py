"""Fit `alight/hazards/weights.py` on tuning flights, and say what it is worth on flights left out.

    python bench/ground_fit.py > src/alight/hazards/weights.py

Additive logistic regression on ramps, every cost at least 0, every map weighing the same. Each map is used COPIES
times, its evidence shifted as another camera or other ground might: nothing may hang on what one simulator draws. The
cover of each flight is judged by a net, and its odds are found by costs, that have not seen the flight; what such odds
were worth is the calibration.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
from cover_fit import instead, joined, rows, train
from ground_flights import TUNING, Judged, cover_of, pooled, reliability
from ground_maps import How, judgeable
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from alight.hazards.belief import ramps
from alight.records import F32, F64, Flag
from alight.settings import Settings

stage = import_module("alight.hazards.assess")  # the module: the package names its function so

SOME = 5000  # cells of a map
PENALTY = 3e-5  # of squared costs
QUANTILES = (0.02, 0.15, 0.35, 0.55, 0.75, 0.9, 0.98)
COPIES = 2
SHIFTS = {
    ("dark", "bright"): 0.15, ("tint",): 0.1, ("residual", "worst residual"): 0.1,
    ("cover", "cover around", "cover in the mean", "cover beyond", "cover far beyond"): 0.3,
}  # fmt: skip
SCALED = ("dark", "bright", "residual", "worst residual")  # these shifts are factors
# term: from where on, and how much at least, a unit of it costs, whatever flights say: on theirs no stone lies on bare
# concrete and no gap is half a footprint
LEAST = {
    "unknown": (0.05, 8.0), "even": (-0.7, 2.0), "broad": (-0.7, 3.0), "over": (-1.5, 0.7), "rise": (-2.0, 0.5),
    "dark": (0.25, 5.0), "bright": (0.3, 3.0),
}  # fmt: skip
BEYOND = {"unknown": 0.35, "even": 0.4, "broad": 0.0, "over": 2.0, "dark": 1.2, "bright": 1.2}  # the last knot
FOLDS = 5  # of flights, each judged by what was fitted without it
STEPS = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.8, 0.88, 0.93, 0.96, 0.98, 1.0)  # of the cells, by their odds
Bool = NDArray[np.bool_]
Table = dict[str, tuple[tuple[float, ...], tuple[float, ...]]]


@dataclass(frozen=True, eq=False)
class Sample:
    """Some cells of one map that no limit refuses."""

    name: str
    terms: dict[str, F32]
    safe: Bool
    near: Bool
    level: F32  # (N,) P that the tilt keeps its limit, by which the fitted belief is multiplied
    share: float  # of the truly safe cells that are among those it was drawn from
    weight: float  # cells of the map that each of the sample stands for


def sample(name: str, how: How, scratch: Path) -> Sample | None:
    """Draw cells of one map, and look up the truth."""
    j = judgeable(name, how, scratch)
    if j is None:
        return None
    heard: list[dict[str, F32]] = []
    plain = stage.safe_belief

    def listen(found: dict[str, F32]) -> F32:
        heard.append(found)
        return np.ones_like(next(iter(found.values())))  # what is left of P is that of the tilt

    s = Settings()
    stage.safe_belief = listen  # type: ignore[attr-defined]
    try:
        verdict = stage.assess(j.elevation, cover_of(j), s.lander, s.hazards)
    finally:
        stage.safe_belief = plain  # type: ignore[attr-defined]
    safe, near = j.safe(s.lander)
    seen = j.known & ((j.elevation.flags & np.uint16(Flag.UNSEEN)) == 0)
    left = np.flatnonzero((verdict.reasons == 0) & seen)  # the tilt leaves P >= 0.99
    total = max(int((safe & seen).sum()), 1)
    if len(left) < 50:
        return None
    share = float(safe.ravel()[left].sum() / total)
    some = np.random.default_rng(0).choice(left, min(SOME, len(left)), replace=False)
    terms = {k: v.ravel()[some] for k, v in heard[0].items()}
    level = verdict.p_safe.ravel()[some]
    return Sample(f"{name}, {how}", terms, safe.ravel()[some], near.ravel()[some], level, share, len(left) / len(some))


def knots_of(samples: list[Sample]) -> dict[str, tuple[float, ...]]:
    """Quantiles of every term, maps weighing the same."""
    out = {}
    for name in samples[0].terms:
        values = np.concatenate([np.resize(s.terms[name], SOME) for s in samples])
        found = np.unique(np.quantile(values, QUANTILES).round(3))
        found = np.unique([*found, max(BEYOND.get(name, found[0]), found[-1])])
        out[name] = tuple(float(v) for v in (found if len(found) > 1 else (found[0], found[0] + 1.0)))
    return out


def design(terms: dict[str, F32], knots: dict[str, tuple[float, ...]]) -> F64:
    """(N, ramps)."""
    return np.stack([r for k, kn in knots.items() for r in ramps(terms[k], kn)], axis=1).astype(np.float64)


def elsewhere(s: Sample, rng: np.random.Generator) -> Sample:
    """The same map with evidence as another camera and other ground might give it."""
    terms = dict(s.terms)
    for group, sigma in SHIFTS.items():
        by = np.float32(rng.normal(0, sigma))
        for k in group:
            terms[k] = terms[k] * np.exp(by) if k in SCALED else terms[k] + by
    return replace(s, terms=terms)


def least_costs(knots: dict[str, tuple[float, ...]]) -> list[float]:
    """Of every ramp."""
    none = (np.inf, 0.0)
    return [
        max(0.0, b - max(a, LEAST.get(k, none)[0])) * LEAST.get(k, none)[1] if b > LEAST.get(k, none)[0] else 0.0
        for k, kn in knots.items()
        for a, b in pairwise(kn)
    ]


def fit(samples: list[Sample], knots: dict[str, tuple[float, ...]]) -> tuple[Table, float]:
    """Costs of the ramps and the base."""
    rng = np.random.default_rng(0)
    copies = [*samples, *(elsewhere(s, rng) for s in samples for _ in range(COPIES - 1))]
    X = np.concatenate([design(s.terms, knots) for s in copies])
    sign = np.concatenate([np.where(s.near, 1.0, -1.0) for s in copies])
    weight = np.concatenate([np.full(len(s.near), 1 / len(s.near) / len(copies)) for s in copies])

    def loss(b: F64) -> tuple[float, F64]:
        z = sign * (b[0] - X @ b[1:])
        off = -weight * sign / (1 + np.exp(z))
        value = float((weight * np.logaddexp(0, -z)).sum() + 0.5 * PENALTY * (b[1:] ** 2).sum())
        return value, np.concatenate([[off.sum()], -(X.T @ off) + PENALTY * b[1:]])

    least = least_costs(knots)
    bounds = [(None, None)] + [(v, None) for v in least]
    start = np.array([0.0, *least])
    b = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 200}).x
    costs, at = {}, 1
    for k, kn in knots.items():
        n = len(kn) - 1
        costs[k] = (kn, tuple(round(float(v), 2) for v in b[at : at + n]))
        at += n
    return costs, float(b[0])


def odds(s: Sample, table: Table, base: float) -> F32:
    """Log odds of the sample, not calibrated."""
    out = np.full(len(s.near), base)
    for k, (kn, costs) in table.items():
        out -= sum(c * r for c, r in zip(costs, ramps(s.terms[k], kn), strict=True))
    return np.asarray(out, np.float32)


def left_out(samples: list[Sample], fold_of: dict[str, int]) -> list[F32]:
    """Log odds of each flight by what was fitted without it."""
    knots, fitted = knots_of(samples), {}
    for fold in set(fold_of.values()):
        fitted[fold] = fit([s for s in samples if fold_of[s.name] != fold], knots)
    return [odds(s, *fitted[fold_of[s.name]]) for s in samples]


def calibration(samples: list[Sample], found: list[F32]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Odds, and what they were worth on flights left out: the better half a step, never better than the step above."""
    z = np.concatenate(found)
    weight = np.concatenate([np.full(len(s.near), s.weight) for s in samples])
    order = np.argsort(z)
    z, weight = z[order], weight[order]
    near, level = (np.concatenate([getattr(s, k) for s in samples])[order] for k in ("near", "level"))
    rank = np.cumsum(weight) / weight.sum()
    at, worth = [], []
    for low, high in pairwise(STEPS):
        here = (rank > low) & (rank <= high)
        true = (weight * near)[here].sum() / (weight * level)[here].sum()
        at.append(float((weight * z)[here].sum() / weight[here].sum()))
        worth.append(float(logit(min(true, 1 - 1e-3))))
    rising = np.maximum.accumulate(worth)
    return tuple(round(v, 2) for v in at), tuple(round(float(v), 2) for v in rising)


def tell(done: list[tuple[Judged, float, float]]) -> None:
    """What is false and found at some levels, flights left out, as comment lines."""
    total = sum(w * j.safe.sum() / max(share, 1e-9) for j, share, w in done)
    for j, share, _ in done:
        parts = []
        for least in (0.9, 0.95, 0.97, 0.99):
            sure = j.p >= least
            wrong, found = (sure & ~j.near).sum() / max(sure.sum(), 1), (sure & j.safe).sum() / max(j.safe.sum(), 1)
            parts.append(f"{least}: false {100 * wrong:5.2f} found {100 * share * found:5.1f}")
        print(f"# {j.name:34s} left {100 * share:3.0f} %   " + "   ".join(parts))
    for least in (0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995):
        claimed = sum(w * (j.p >= least).sum() for j, _, w in done)
        wrong = sum(w * ((j.p >= least) & ~j.near).sum() for j, _, w in done)
        found = sum(w * ((j.p >= least) & j.safe).sum() for j, _, w in done)
        print(f"# P >= {least}: false {100 * wrong / max(claimed, 1):.2f} %, found {100 * found / total:.1f} %")
    print("#   " + "  ".join(f"{a:.3f}:{b:.3f}" for a, b, _ in reliability(pooled([j for j, _, _ in done]))))


def module(table: Table, base: float, worth: tuple[tuple[float, ...], tuple[float, ...]], count: int) -> str:
    """The text of `weights.py`."""
    out = [f'"""Costs of the evidence against a footprint, from {count} simulated maps: `bench/ground_fit.py`."""', ""]
    out += ["# term: knots, and the log odds that the way from each knot to the next costs"]
    out += ["RAMPS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {"]
    out += [f'    "{k}": (\n        {kn},\n        {costs},\n    ),' for k, (kn, costs) in table.items()]
    out += ["}", f"BASE = {base:.2f}", "# log odds, and what they were worth on flights left out"]
    return "\n".join([*out, f"CALIBRATION = ({worth[0]}, {worth[1]})"])


def samples_of(names: tuple[str, ...], scratch: Path) -> tuple[list[Sample], dict[str, int]]:
    """Cells of every flight, their cover judged by a net that has not seen the flight; and its fold."""
    parts = {names[r.flight[0]]: r for r in rows(names, scratch)}
    fold = {name: i % FOLDS for i, name in enumerate(parts)}
    out: list[Sample] = []
    fold_of: dict[str, int] = {}
    for k in range(FOLDS):
        net = train(joined([r for name, r in parts.items() if fold[name] != k]))
        with instead(net):
            found = [sample(name, "batch", scratch) for name in parts if fold[name] == k]
        out += [s for s in found if s is not None]
        fold_of |= {s.name: k for s in found if s is not None}
    return out, fold_of


def main() -> None:
    """Fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    samples, fold_of = samples_of(TUNING, options.scratch)
    found = left_out(samples, fold_of)
    worth = calibration(samples, found)
    p = [s.level * np.asarray(expit(np.interp(z, *worth)), np.float32) for s, z in zip(samples, found, strict=True)]
    tell([(Judged(s.name, v, s.safe, s.near), s.share, s.weight) for s, v in zip(samples, p, strict=True)])
    table, base = fit(samples, knots_of(samples))
    print(module(table, base, worth, len(samples)))


if __name__ == "__main__":
    main()
