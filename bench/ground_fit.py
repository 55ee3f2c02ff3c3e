"""Fit the costs of `alight/hazards/weights.py` on tuning flights, and say what they are worth on scenes left out.

    python bench/ground_fit.py                  # leave each group of scenes out, then print the module of all
    python bench/ground_fit.py --only           # print the module alone

Additive logistic regression on ramps, every cost at least 0, every map weighing the same. Each map is used COPIES
times, its evidence shifted as another camera or other ground might: nothing may hang on what one simulator draws.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
from ground_flights import TUNING, Judged, cover_of, pooled, reliability
from ground_maps import How, judgeable
from numpy.typing import NDArray
from scipy.optimize import minimize

from alight.hazards.belief import ramps
from alight.records import F32, F64, Flag
from alight.settings import Settings

stage = import_module("alight.hazards.assess")  # the module: the package names its function so

SOME = 4000  # cells of a map
STRICT = False
PENALTY = 3e-5  # of squared costs
QUANTILES = (0.02, 0.15, 0.35, 0.55, 0.75, 0.9, 0.98)
COPIES = 3
SHIFTS = {
    ("dark", "bright"): 0.15, ("tint",): 0.1, ("residual", "worst residual"): 0.1, ("sigma",): 0.1,
    ("cover", "cover around", "cover in the mean"): 0.3,
}  # fmt: skip
SCALED = ("dark", "bright", "residual", "worst residual")  # these shifts are factors
# term: from where on, and how much at least, a unit of it costs, whatever flights say: on theirs no stone lies on bare
# concrete and no gap is half a footprint
LEAST = {
    "unknown": (0.05, 8.0), "even": (-0.7, 2.0), "rise": (-2.0, 0.5),
    "dark": (0.25, 5.0), "bright": (0.3, 3.0),
}  # fmt: skip
BEYOND = {"unknown": 0.35, "even": 0.0, "dark": 1.2, "bright": 1.2}  # the last knot
FOLDS = (
    {"meadow"}, {"village", "yard"}, {"desert", "snow"}, {"lakes", "tall_grass"}, {"farmland", "forest"},
    {"car_park", "concrete", "quarry"},
)  # fmt: skip
Bool = NDArray[np.bool_]
Table = dict[str, tuple[tuple[float, ...], tuple[float, ...]]]


@dataclass(frozen=True, eq=False)
class Sample:
    """Some cells of one map that no limit refuses."""

    name: str
    terms: dict[str, F32]
    safe: Bool
    near: Bool
    share: float  # of the truly safe cells that are among those it was drawn from


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
    safe, near = j.safe(s.lander, STRICT)
    seen = j.known & ((j.elevation.flags & np.uint16(Flag.UNSEEN)) == 0)
    left = np.flatnonzero((verdict.reasons == 0) & seen)  # the tilt leaves P >= 0.99
    total = max(int((safe & seen).sum()), 1)
    if len(left) < 50:
        return None
    share = float(safe.ravel()[left].sum() / total)
    some = np.random.default_rng(0).choice(left, min(SOME, len(left)), replace=False)
    terms = {k: v.ravel()[some] for k, v in heard[0].items()}
    return Sample(f"{name}, {how}", terms, safe.ravel()[some], near.ravel()[some], share)


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


def belief(s: Sample, table: Table, base: float) -> F32:
    """P(safe) of the sample."""
    odds = np.full(len(s.near), base)
    for k, (kn, costs) in table.items():
        odds -= sum(c * r for c, r in zip(costs, ramps(s.terms[k], kn), strict=True))
    return np.asarray(1 / (1 + np.exp(-odds)), np.float32)


def left_out(samples: list[Sample]) -> None:
    """Each group of scenes judged by what was fitted without it."""
    done = []
    for fold in FOLDS:
        mine = [s for s in samples if s.name.split("/")[0] in fold]
        table, base = fit([s for s in samples if s not in mine], knots_of(samples)) if mine else ({}, 0.0)
        for s in mine:
            done.append((Judged(s.name, belief(s, table, base), s.safe, s.near), s.share))
    tell(done)


def tell(done: list[tuple[Judged, float]]) -> None:
    """What is false and found at some levels."""
    for j, share in done:
        parts = []
        for least in (0.9, 0.95, 0.99):
            sure = j.p >= least
            wrong, found = (sure & ~j.near).sum() / max(sure.sum(), 1), (sure & j.safe).sum() / max(j.safe.sum(), 1)
            parts.append(f"{least}: false {100 * wrong:5.2f} found {100 * share * found:5.1f}")
        print(f"  {j.name:34s} left {100 * share:3.0f} %   " + "   ".join(parts))
    every = pooled([j for j, _ in done])
    for least in (0.8, 0.9, 0.95, 0.98, 0.99, 0.995):
        sure = every.p >= least
        wrong = (sure & ~every.near).sum() / max(sure.sum(), 1)
        found = np.mean([sh * (j.safe & (j.p >= least)).sum() / max(j.safe.sum(), 1) for j, sh in done])
        print(f"  P >= {least}: false {100 * wrong:.2f} %, found, mean of the maps {100 * found:.1f} %")
    print("  " + "  ".join(f"{a:.3f}:{b:.3f}" for a, b, _ in reliability(every)))


def module(table: Table, base: float, count: int) -> str:
    """The text of `weights.py`."""
    out = [f'"""Costs of the evidence against a footprint, from {count} simulated maps: `bench/ground_fit.py`."""', ""]
    out += ["# term: knots, and the log odds that the way from each knot to the next costs"]
    out += ["RAMPS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {"]
    out += [f'    "{k}": (\n        {kn},\n        {costs},\n    ),' for k, (kn, costs) in table.items()]
    return "\n".join([*out, "}", f"BASE = {base:.2f}"])


def main() -> None:
    """Fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="store_true", help="leave nothing out")
    parser.add_argument("--how", nargs="*", default=["batch"])
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    found = [sample(n, how, options.scratch) for how in options.how for n in TUNING]
    samples = [s for s in found if s is not None]
    if not options.only:
        left_out(samples)
    table, base = fit(samples, knots_of(samples))
    print(module(table, base, len(samples)))


if __name__ == "__main__":
    main()
