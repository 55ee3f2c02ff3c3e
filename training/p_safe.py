"""Fit `learned/obstacle_rate.npz` and `learned/ground_rate.npz`, and print what they are worth on scenes left out.

    PYTHONPATH=bench python training/p_safe.py

Each rate is a sum of rising broken lines, fitted by maximum likelihood to whether a touchdown truly meets no obstacle,
or truly lies on ground that bears and is dry. What is claimed is what held on the worst family of scenes left out, not
on the average. Nothing but simulated flights is fitted to; other renderers and real places only judge.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from card import version, write_table
from ground_flights import TUNING, cover_of
from ground_maps import HOWS, How, judgeable
from ground_truth import GroundTruth
from land_cover import family_of, fit_net, joined, rows_of
from scipy.optimize import minimize
from sklearn.isotonic import IsotonicRegression

from alight.arrays import F32, F64, I64, Mask
from alight.hazards.assessment import evidence
from alight.learned import Net, Rate, rate_bytes
from alight.learned.terms import GROUND_TERMS, OBSTACLE_TERMS
from alight.records import Hazard
from alight.settings import Settings

SOME = 1500  # cells of a map
KNOTS = (0.02, 0.2, 0.4, 0.6, 0.8, 0.92, 0.98)  # quantiles of a term, families alike, at which its line bends
PENALTY = 1e-4  # of squared rises of the lines
ROUNDS, EAGER = 3, 1.0  # rounds in which a family weighs more by what was lost on it, and how much more
FOLDS = 5  # of families, each judged by what was fitted without it
STEPS = np.concatenate([np.linspace(0, 0.6, 13), np.linspace(0.6, 1.0, 9)[1:]])  # shares of the cells, best first
LEAST = 150  # cells of a family in a step that count
LEVELS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
MOST, FEWEST = 4.0, 1e-4  # hazards a footprint that are claimed at most and at least


@dataclass(frozen=True, eq=False)
class Sample:
    """Some cells of one map, flat."""

    name: str
    family: str
    obstacle: dict[str, F32]
    ground: dict[str, F32]
    tilt: F32  # P that the tilt keeps its limit
    even: Mask  # no limit of the ground's shape is broken by what the map shows
    kept: Mask  # no limit at all
    truly_even: Mask  # or within 0.3 m of it
    truly_bears: Mask
    truly_safe: Mask
    truly_near: Mask
    share: float  # of the cells that were seen


@dataclass(frozen=True, eq=False)
class Rows:
    """Cells of one rate: terms, whether a hazard is there, the family, and what each weighs."""

    terms: tuple[str, ...]
    values: F64  # (N, T)
    hazard: Mask
    family: I64
    weight: F64  # families alike, maps of a family alike


def sample(name: str, how: How, scratch: Path, net: Net) -> Sample | None:
    """Draw cells of one map, and look up the truth."""
    j = judgeable(name, how, scratch)
    if j is None:
        return None
    s = Settings().stages()
    found, reasons = evidence(j.elevation, cover_of(j, net), s.lander, s.hazards)
    discs, truth = found.discs, GroundTruth(j.truth, s.lander)
    seen = np.flatnonzero(discs.largest(j.seen.astype(np.float32)) > 0)
    some = np.random.default_rng(0).choice(seen, min(SOME, len(seen)), replace=False)

    def free(but: Hazard) -> Mask:
        return np.asarray(
            discs.largest((reasons & np.uint8(0xFF & ~int(but)) != 0).astype(np.float32)).ravel()[some] == 0
        )

    def truly(mask: Mask) -> Mask:
        return truth.on(discs.grid, mask).ravel()[some]

    return Sample(
        f"{name}, {how}", family_of(name),
        {k: v.ravel()[some] for k, v in found.obstacle.items()}, {k: v.ravel()[some] for k, v in found.ground.items()},
        discs.coarse(np.nan_to_num(found.tilt)).ravel()[some], free(Hazard.TERRAIN), free(Hazard(0)),
        truly(truth.near(truth.even)), truly(truth.near(truth.bears)), truly(truth.safe), truly(truth.near(truth.safe)),
        len(some) / max(len(seen), 1),
    )  # fmt: skip


def rows(samples: Sequence[Sample], what: str, families: list[str]) -> Rows:
    """The cells of one rate: those that nothing refuses for another reason."""
    parts = []
    for s in samples:
        use = s.even if what == "obstacle" else s.kept
        safe = s.truly_even if what == "obstacle" else s.truly_bears
        if use.sum() >= LEAST:
            values = np.stack([v[use] for v in getattr(s, what).values()], axis=1).astype(np.float64)
            parts.append((s.family, values, ~safe[use]))
    count = {f: sum(p[0] == f for p in parts) for f in families}
    weight = [np.full(len(v), 1 / len(v) / count[f]) for f, v, _ in parts]
    terms = OBSTACLE_TERMS if what == "obstacle" else GROUND_TERMS
    family = np.concatenate([np.full(len(v), families.index(f)) for f, v, _ in parts])
    total = np.concatenate(weight)
    return Rows(
        terms,
        np.nan_to_num(np.concatenate([p[1] for p in parts])),
        np.concatenate([p[2] for p in parts]),
        family,
        total / total.sum(),
    )


def _knots(r: Rows) -> F64:
    out = []
    order = np.argsort(r.values, axis=0)
    for t in range(r.values.shape[1]):
        share = np.cumsum(r.weight[order[:, t]])
        at = r.values[order[np.searchsorted(share, np.array(KNOTS) * share[-1]).clip(0, len(share) - 1), t], t]
        width = max(at[-1] - at[0], 1e-3)
        out.append(np.maximum.accumulate(at + 1e-3 * width * np.arange(len(at))))
    return np.array(out)


def _ramps(values: F64, knots: F64) -> F64:
    """(N, T (K - 1)): how far each value has come between two knots, 0 to 1."""
    parts = [((values[:, t, None] - k[:-1]) / np.diff(k)).clip(0, 1) for t, k in enumerate(knots)]
    return np.concatenate(parts, axis=1)


def _loss(x: F64, ramps: F64, hazard: Mask, weight: F64) -> tuple[float, F64]:
    log_rate = (ramps @ x[:-1] + x[-1]).clip(-12, 3)
    rate = np.exp(log_rate)
    some = -np.expm1(-rate)
    lost = np.where(hazard, -np.log(np.maximum(some, 1e-12)), rate)
    slope = weight * np.where(hazard, -rate * np.exp(-rate) / np.maximum(some, 1e-12), rate)
    value = float(weight @ lost) + PENALTY * float(x[:-1] @ x[:-1])
    return value, np.concatenate([ramps.T @ slope + 2 * PENALTY * x[:-1], [slope.sum()]])


def fit(r: Rows) -> Rate:
    """Maximum likelihood, no line falling; families on which more is lost weigh more (Sagawa et al. 2020)."""
    knots = _knots(r)
    ramps = _ramps(r.values, knots)
    x = np.concatenate([np.full(ramps.shape[1], 0.05), [-3.0]])
    bounds = [(0.0, None)] * ramps.shape[1] + [(-12.0, 3.0)]
    favour = np.ones(r.family.max() + 1)
    for _ in range(ROUNDS):
        weight = r.weight * favour[r.family]
        weight /= weight.sum()
        x = minimize(
            _loss, x, (ramps, r.hazard, weight), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 150}
        ).x
        log_rate = (ramps @ x[:-1] + x[-1]).clip(-12, 3)
        lost = np.where(r.hazard, -np.log(np.maximum(-np.expm1(-np.exp(log_rate)), 1e-12)), np.exp(log_rate))
        each = np.array(
            [
                np.average(lost[r.family == f], weights=r.weight[r.family == f]) if (r.family == f).any() else 0.0
                for f in range(len(favour))
            ]
        )
        favour *= np.exp(EAGER * (each - each.mean()) / max(each.std(), 1e-9) / ROUNDS)
    rises = x[:-1].reshape(len(knots), -1)
    heights = np.concatenate([np.zeros((len(knots), 1)), np.cumsum(rises, axis=1)], axis=1)
    same = np.array([[-20.0, 5.0], [-20.0, 5.0]])
    return Rate(r.terms, knots, heights, float(x[-1]), same)


def log_rates(rate: Rate, r: Rows) -> F64:
    """Of every cell, as fitted."""
    return (
        replace(rate, claim=np.array([[-30.0, 10.0], [-30.0, 10.0]]))
        .log_rate(dict(zip(r.terms, r.values.T, strict=True)))
        .astype(np.float64)
    )


def claim(z: F64, r: Rows) -> F64:
    """(2, steps): log rates, and those that held on the worst family left out, never less where the rate is higher."""
    order = np.argsort(z)
    z, hazard, family, weight = z[order], r.hazard[order], r.family[order], r.weight[order]
    rank = np.cumsum(weight) / weight.sum()
    at, worst = [], []
    for low, high in pairwise(STEPS):
        here = (rank > low) & (rank <= high)
        shares = [
            hazard[here & (family == f)].mean()
            for f in range(family.max() + 1)
            if (here & (family == f)).sum() >= LEAST
        ]
        if shares:
            at.append(float(np.average(z[here], weights=weight[here])))
            worst.append(float(max(shares)))
    rising = IsotonicRegression(increasing=True).fit_transform(np.arange(len(worst)), worst)
    rate = -np.log1p(-rising.clip(FEWEST, 1 - np.exp(-MOST)))
    at_ = np.maximum.accumulate(np.array(at) + 1e-6 * np.arange(len(at)))
    return np.array([at_, np.log(rate)])


def folds_of(families: Sequence[str]) -> dict[str, int]:
    """The fold of every family."""
    return {f: i % FOLDS for i, f in enumerate(sorted(set(families)))}


def left_out(samples: list[Sample], what: str) -> tuple[Rows, F64]:
    """Cells, and their log rates by what was fitted without their family."""
    families = sorted({s.family for s in samples})
    r = rows(samples, what, families)
    z = np.empty(len(r.hazard))
    for k in range(len(families)):
        out = r.family == k
        if out.any():
            kept = Rows(r.terms, r.values[~out], r.hazard[~out], r.family[~out], r.weight[~out] / r.weight[~out].sum())
            z[out] = log_rates(fit(kept), Rows(r.terms, r.values[out], r.hazard[out], r.family[out], r.weight[out]))
    return r, z


def claimed(s: Sample, obstacle: Rate, ground: Rate) -> F32:
    """P(safe) of the cells of one map."""
    p = s.tilt * np.exp(-np.exp(obstacle.log_rate(s.obstacle))) * np.exp(-np.exp(ground.log_rate(s.ground)))
    return np.where(s.kept, p, np.float32(0)).astype(np.float32)


def table(samples: list[Sample], p_of: Callable[[Sample], F32]) -> list[str]:
    """What is false and found at some levels, by family."""
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
                f"{level}: false {100 * (sure & ~near).sum() / max(sure.sum(), 1):5.2f} found {100 * (sure & safe).sum() / max(safe.sum(), 1):5.1f}"
            )
        out.append(f"{f:12s} safe {100 * safe.mean():5.1f}   " + "   ".join(parts))
    return out


def samples_of(names: Sequence[str], scratch: Path, hows: Sequence[How] = HOWS) -> list[Sample]:
    """Cells of every flight, their cover judged by a net that has not seen the flight's family."""
    parts = {names[r.flight[0]]: r for r in rows_of(names, scratch)}
    fold = folds_of([family_of(n) for n in parts])
    out = []
    for k in sorted(set(fold.values())):
        others = [r for n, r in parts.items() if fold[family_of(n)] != k]
        if not others:
            continue
        net = fit_net(joined(others))
        found = [sample(n, how, scratch, net) for n in parts if fold[family_of(n)] == k for how in hows]
        out += [s for s in found if s is not None]
    return out


def main() -> None:
    """Fit, and write the tables and their cards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    samples = samples_of(TUNING, parser.parse_args().scratch)
    found = {what: left_out(samples, what) for what in ("obstacle", "ground")}
    families = sorted({s.family for s in samples})
    rates = {}
    for what, (r, z) in found.items():
        rate = replace(fit(rows(samples, what, families)), claim=claim(z, r))
        rates[what] = rate
        fitted = f"Maps of {len(samples)} simulated tuning flights of {len(families)} families of scenes. {version()}"
        write_table(f"{what}_rate", rate_bytes(rate), {"Fitted on": fitted})
    print("\n".join(table(samples, lambda s: claimed(s, rates["obstacle"], rates["ground"]))))


if __name__ == "__main__":
    main()
