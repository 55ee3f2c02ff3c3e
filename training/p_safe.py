"""Fit the tables of rates in `learned/`, and print their accuracy on families of scenes left out.

    PYTHONPATH=bench python training/p_safe.py

Each rate is a sum of rising piecewise linear curves, fitted by maximum likelihood to whether a touchdown truly has no
obstacle, or truly lies on ground that bears and is dry. The factor for the worst family of scenes left out is printed,
but not applied: docs/lab/p-safe.md. Only simulated flights are fitted to; other renderers and real places only test.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from card import version, write_table
from ground_maps import HOWS, TUNING, How, Judgeable, cover_of, judgeable
from ground_truth import GroundTruth
from land_cover import family_of, fit_net, joined, rows_of, with_limit
from looks import TUNING as LOOKS
from looks import Look, kept_looks
from scipy.optimize import minimize
from scipy.special import ndtr

from alight.arrays import F32, F64, I64, Mask
from alight.hazards.assessment import limits_broken
from alight.hazards.evidence import evidence_of
from alight.hazards.factors import margins_over_sigma
from alight.hazards.touchdown import Inputs, measure
from alight.learned import Rate
from alight.learned.terms import DENSITY_TERMS, GROUND_TERMS, RELIEF_TERMS
from alight.settings import Settings
from alight.terrain.classify import Tables

SOME = 1500  # cells of a map
KNOTS = (0.02, 0.2, 0.4, 0.6, 0.8, 0.92, 0.98)  # quantiles of a term, families alike, at which its line bends
PENALTY = 1e-5  # of squared rises of the lines
ROUNDS = 3  # after each of which the families with more loss get more weight
EAGER = {"obstacle": 1.0, "ground": 0.5}  # exponent of that weight: dense stones; ground that looks safe but is not
NAMES = {"obstacle": ("relief_rate", "density_rate"), "ground": ("ground_rate",)}
FOLDS = 5  # of flights, or of families, each judged by a net that was fitted without it
LEAST_STEP = 0.02  # of the range of a term: knots lie no nearer
MOST = 3.0  # log of the largest rate of a part
LEAST = 100  # cells of a family that count
KEPT = ((0.95, 1.0), (0.99, 1.5))  # levels of P, and the limit of the share of hazards over 1 - P


@dataclass(frozen=True, eq=False)
class Sample:
    """Flat arrays of some cells of one map."""

    name: str
    family: str
    terms: dict[str, F32]
    hidden: F32  # share of the obstacles above the limit that the heights would not show
    tilt: F32  # P that the tilt keeps its limit
    kept: Mask  # the map shows no limit that is broken
    truly_even: Mask  # or within 0.3 m of it
    truly_bears: Mask
    truly_safe: Mask
    truly_near: Mask


@dataclass(frozen=True, eq=False)
class Part:
    """One rate of a sum: its terms, and its factor (`share`)."""

    terms: tuple[str, ...]
    values: F64  # (N, T)
    share: F64  # (N,)


@dataclass(frozen=True, eq=False)
class Rows:
    """Cells of one factor: inputs of the rates that are summed, truth of a hazard, family, weight."""

    parts: tuple[Part, ...]
    hazard: Mask
    family: I64
    weight: F64  # families alike, maps of a family alike

    def some(self, which: Mask) -> Rows:
        """Return the cells that `which` (N,) marks."""
        parts = tuple(Part(p.terms, p.values[which], p.share[which]) for p in self.parts)
        return Rows(parts, self.hazard[which], self.family[which], self.weight[which] / self.weight[which].sum())


def sample(j: Judgeable, tables: Tables, about: Look | None = None, most: int = SOME) -> Sample:
    """Draw cells of one map, or those about the place of a look, and look up the truth."""
    s = Settings().stages()
    on = Inputs(j.elevation, cover_of(j, tables), s.lander, s.hazards)
    touchdowns = measure(on)
    found, reasons = evidence_of(touchdowns, on), limits_broken(touchdowns, on)
    p_tilt = np.nan_to_num(ndtr(margins_over_sigma(touchdowns, on)[0]))
    discs, truth = found.discs, GroundTruth(j.truth, s.lander)
    seen = discs.largest(j.seen.astype(np.float32)) > 0
    cells = np.flatnonzero(seen if about is None else seen & about.about(discs.grid))
    some = np.random.default_rng(0).choice(cells, min(most, len(cells)), replace=False)

    def truly(mask: Mask) -> Mask:
        return truth.on(discs.grid, mask).ravel()[some]

    return Sample(
        j.name, family_of(j.name), {k: v.ravel()[some] for k, v in found.terms.items()}, found.hidden.ravel()[some],
        discs.coarse(p_tilt).ravel()[some],
        discs.largest((reasons != 0).astype(np.float32)).ravel()[some] == 0,
        truly(truth.near(truth.even)), truly(truth.near(truth.bears)), truly(truth.safe), truly(truth.near(truth.safe)),
    )  # fmt: skip


def together(parts: Sequence[Sample], name: str) -> Sample:
    """Join the cells of several maps."""

    def joined_of(field: str) -> Any:
        values = [getattr(p, field) for p in parts]
        if isinstance(values[0], dict):
            return {k: np.concatenate([v[k] for v in values]) for k in values[0]}
        return np.concatenate(values)

    rest = {f.name: joined_of(f.name) for f in fields(Sample) if f.name not in ("name", "family")}
    return Sample(name, parts[0].family, **rest)


def samples_of_flight(name: str, scratch: Path, tables: Tables, hows: Sequence[How]) -> list[Sample]:
    """One sample of every way of mapping, or one of all looks of a world."""
    if "/looks/" in name:
        looks = kept_looks(name, scratch)
        parts = [sample(look.judgeable, tables, look, SOME // len(looks)) for look in looks]
        return [together(parts, name)] if parts else []
    maps = [judgeable(name, how, scratch) for how in hows]
    return [sample(j, tables) for j in maps if j is not None]


def rows(samples: Sequence[Sample], what: str, families: list[str]) -> Rows:
    """The cells of one factor: those that nothing refuses, without those that are a hazard of the other factor alone.

    A tuft that is uneven and does not bear is a hazard of the ground.
    """
    kept = [(s, s.kept & (s.truly_bears if what == "obstacle" else s.truly_even | ~s.truly_bears)) for s in samples]
    kept = [(s, use) for s, use in kept if use.sum() >= LEAST]
    count = {f: sum(s.family == f for s, _ in kept) for f in families}
    weight = np.concatenate([np.full(use.sum(), 1 / use.sum() / count[s.family]) for s, use in kept])

    def part(terms: tuple[str, ...], hidden: bool) -> Part:
        values = [np.stack([s.terms[t][use] for t in terms], axis=1) for s, use in kept]
        share = [s.hidden[use] if hidden else np.ones(use.sum()) for s, use in kept]
        return Part(
            terms, np.nan_to_num(np.concatenate(values)).astype(np.float64), np.concatenate(share).astype(np.float64)
        )

    parts = (
        (part(RELIEF_TERMS, False), part(DENSITY_TERMS, True)) if what == "obstacle" else (part(GROUND_TERMS, False),)
    )
    hazard = np.concatenate([~(s.truly_even if what == "obstacle" else s.truly_bears)[use] for s, use in kept])
    family = np.concatenate([np.full(use.sum(), families.index(s.family)) for s, use in kept])
    return Rows(parts, hazard, family, weight / weight.sum())


def _knots(values: F64, weight: F64) -> F64:
    out = []
    order = np.argsort(values, axis=0)
    for t in range(values.shape[1]):
        share = np.cumsum(weight[order[:, t]])
        at = values[order[np.searchsorted(share, np.array(KNOTS) * share[-1]).clip(0, len(share) - 1), t], t]
        least = max(at[-1] - at[0], 1e-3) * LEAST_STEP
        for k in range(1, len(at)):
            at[k] = max(at[k], at[k - 1] + least)
        out.append(at)
    return np.array(out)


def _ramps(values: F64, knots: F64) -> F64:
    """(N, T (K - 1) + 1): position of each value between two knots, clipped to 0 to 1, and 1 for the bias."""
    parts = [((values[:, t, None] - k[:-1]) / np.diff(k)).clip(0, 1) for t, k in enumerate(knots)]
    return np.concatenate([*parts, np.ones((len(values), 1))], axis=1)


@dataclass(eq=False)
class _Likelihood:
    """Likelihood of Poisson numbers of hazards; one weight a ramp, the rates of the parts one after the other."""

    ramps: list[F64]
    share: list[F64]
    hazard: Mask
    weight: F64

    def _logs(self, x: F64) -> list[F64]:
        ends = np.cumsum([r.shape[1] for r in self.ramps])
        return [r @ w for r, w in zip(self.ramps, np.split(x, ends[:-1]), strict=True)]

    def _rates(self, logs: list[F64]) -> list[F64]:
        return [s * np.exp(np.minimum(z, MOST)) for z, s in zip(logs, self.share, strict=True)]

    def rate(self, x: F64) -> F64:
        """Rate (N,) of all parts together, shares included."""
        return np.asarray(np.sum(self._rates(self._logs(x)), axis=0))

    def lost(self, rate: F64) -> F64:
        """Loss (N,) of every cell: the negative log likelihood."""
        return np.where(self.hazard, -np.log(np.maximum(-np.expm1(-rate), 1e-12)), rate)

    def __call__(self, x: F64) -> tuple[float, F64]:
        """The mean loss with its penalty, and its gradient."""
        logs = self._logs(x)
        rates = self._rates(logs)
        rate = np.sum(rates, axis=0)
        slope = self.weight * np.where(self.hazard, -np.exp(-rate) / np.maximum(-np.expm1(-rate), 1e-12), 1.0)
        free = [slope * own * (z < MOST) for z, own in zip(logs, rates, strict=True)]
        back = np.concatenate([r.T @ v for r, v in zip(self.ramps, free, strict=True)])
        penalised = x * np.concatenate([np.r_[np.ones(r.shape[1] - 1), 0] for r in self.ramps])
        return float(self.weight @ self.lost(rate)) + PENALTY * float(penalised @ x), back + 2 * PENALTY * penalised


def fit(r: Rows, eager: float) -> tuple[Rate, ...]:
    """Fit by maximum likelihood, no curve falling; families with more loss have more weight (Sagawa et al. 2020)."""
    knots = [_knots(p.values, r.weight) for p in r.parts]
    ramps = [_ramps(p.values, k) for p, k in zip(r.parts, knots, strict=True)]
    x = np.concatenate([np.r_[np.full(a.shape[1] - 1, 0.1), -5.0] for a in ramps])
    bounds = [b for a in ramps for b in [*[(0.0, None)] * (a.shape[1] - 1), (-14.0, 3.0)]]
    favour = np.ones(r.family.max() + 1)
    for _ in range(ROUNDS):
        weight = r.weight * favour[r.family]
        likelihood = _Likelihood(ramps, [p.share for p in r.parts], r.hazard, weight / weight.sum())
        x = minimize(
            likelihood, x, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 400, "ftol": 1e-8}
        ).x
        lost = likelihood.lost(likelihood.rate(x))
        total = np.bincount(r.family, r.weight, len(favour))
        each = np.bincount(r.family, r.weight * lost, len(favour)) / np.maximum(total, 1e-12)
        favour = favour * np.exp(eager * (each - each.mean()) / max(each.std(), 1e-9) / ROUNDS)
    out, ends = [], np.cumsum([a.shape[1] for a in ramps])
    for p, k, w in zip(r.parts, knots, np.split(x, ends[:-1]), strict=True):
        rises = w[:-1].reshape(len(k), -1)
        heights = np.concatenate([np.zeros((len(k), 1)), np.cumsum(rises, axis=1)], axis=1)
        out.append(Rate(p.terms, k, heights, float(w[-1])))
    return tuple(out)


def expected(rates: Sequence[Rate], r: Rows) -> F64:
    """Expected number of hazards (N,) of every cell."""
    each = [
        p.share * np.exp(rate.log_rate(dict(zip(p.terms, p.values.T, strict=True))))
        for rate, p in zip(rates, r.parts, strict=True)
    ]
    return np.sum(each, axis=0)


def caution(rate: F64, r: Rows) -> float:
    """The factor on all rates with which the claims at `KEPT` hold on the worst family left out."""
    for factor in np.geomspace(0.25, 32, 85):
        p = np.exp(-factor * rate)
        false = [
            r.hazard[sure].mean() - slack * (1 - level)
            for level, slack in KEPT
            for f in range(r.family.max() + 1)
            if (sure := (r.family == f) & (p >= level)).sum() >= LEAST
        ]
        if max(false, default=0.0) <= 0:
            return float(factor)
    return 32.0


def folds_of(names: Sequence[str], whole_families: bool) -> dict[str, int]:
    """The fold of every flight: each family's flights spread over all folds, or each family in one."""
    families = sorted({family_of(n) for n in names})
    if whole_families:
        return {n: families.index(family_of(n)) % FOLDS for n in names}
    own = {f: [n for n in names if family_of(n) == f] for f in families}
    return {n: own[family_of(n)].index(n) % FOLDS for n in names}


def left_out(samples: list[Sample], strange: list[Sample], what: str) -> tuple[Rows, F64]:
    """The `strange` cells, and their rates by a fit to the samples of all other families."""
    families = sorted({s.family for s in samples})
    known, r = rows(samples, what, families), rows(strange, what, families)
    out = np.empty(len(r.hazard))
    for k in range(len(families)):
        own = r.family == k
        if own.any():
            out[own] = expected(fit(known.some(known.family != k), EAGER[what]), r.some(own))
    return r, out


def claimed(s: Sample, obstacle: Sequence[Rate], ground: Sequence[Rate]) -> F32:
    """P(safe) of the cells of one map."""
    relief, density = (np.exp(rate.log_rate(s.terms)) for rate in obstacle)
    bad = relief + s.hidden * density + np.exp(ground[0].log_rate(s.terms))
    return np.where(s.kept, s.tilt * np.exp(-bad), np.float32(0)).astype(np.float32)


def table(samples: list[Sample], p_of: Callable[[Sample], F32]) -> list[str]:
    """Lines of text: false claims and safe cells found at some levels, by family."""
    out = []
    for f in sorted({s.family for s in samples}):
        own = [s for s in samples if s.family == f]
        p, safe, near = (
            np.concatenate(v)
            for v in ([p_of(s) for s in own], [s.truly_safe for s in own], [s.truly_near for s in own])
        )
        parts = []
        for level in (0.9, 0.95, 0.99):
            sure = p >= level
            parts.append(
                f"{level}: false {100 * (sure & ~near).sum() / max(sure.sum(), 1):5.2f} "
                f"found {100 * (sure & safe).sum() / max(safe.sum(), 1):5.1f}"
            )
        out.append(f"{f:12s} safe {100 * safe.mean():5.1f}   " + "   ".join(parts))
    return out


def samples_of(names: Sequence[str], scratch: Path, whole_families: bool, hows: Sequence[How] = HOWS) -> list[Sample]:
    """Cells of every flight, their land cover by a net that was fitted without the flight, or without its family."""
    parts = {names[r.flight[0]]: r for r in rows_of(names, scratch)}
    fold = folds_of(list(parts), whole_families)
    out = []
    for k in sorted(set(fold.values())):
        others = {n: r for n, r in parts.items() if fold[n] != k}
        tables = Tables(fit_net(joined(list(others.values()))), with_limit(list(others.values()), list(others)))
        out += [s for n in parts if fold[n] == k for s in samples_of_flight(n, scratch, tables, hows)]
    return out


def main() -> None:
    """Fit, and write the tables and their cards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    scratch = parser.parse_args().scratch
    names = (*TUNING, *LOOKS)
    samples, strange = (samples_of(names, scratch, whole_families) for whole_families in (False, True))
    families = sorted({s.family for s in samples})
    near = sum("/looks/" in s.name for s in samples)
    maps = (
        f"{len(samples) - near} maps of {len(TUNING)} simulated tuning flights, looks from 4 to 10 m in {near} worlds"
    )
    fitted = f"{maps}; {len(families)} families of scenes. {version()}"
    rates: dict[str, tuple[Rate, ...]] = {}
    for what, names in NAMES.items():
        r, rate = left_out(samples, strange, what)
        print(f"{what}: the worst family left out asks for {caution(rate, r):.1f} times these rates")
        rates[what] = fit(rows(samples, what, families), EAGER[what])
        for name, k in zip(names, rates[what], strict=True):
            write_table(name, k.to_bytes(), {"Fitted on": fitted})
    print("\n".join(table(samples, lambda s: claimed(s, rates["obstacle"], rates["ground"]))))


if __name__ == "__main__":
    main()
