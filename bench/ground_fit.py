"""Fit `alight/hazards/weights.py` on tuning flights, and say what it is worth on flights left out.

    python bench/ground_fit.py > src/alight/hazards/weights.py

A small net whose weights are all at least 0, on top of costs that no flight may undercut, every map weighing the same.
Each time round the evidence of every map is shifted, as another camera or other ground might shift it: nothing may hang
on what one simulator draws. The cover of each flight is judged by a net, and its odds are found by another, that have
not seen the flight; what such odds were worth is the calibration.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np
from cover_fit import Adam, Net, Schedule, instead, joined, rows, text_of, train
from ground_flights import TUNING, Judged, cover_of, pooled, reliability
from ground_maps import How, judgeable
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.special import expit, logit

from alight.hazards.monotone_net import learned_costs, least_costs
from alight.learned.layers import CLIP
from alight.records import F32
from alight.settings import Settings

stage = import_module("alight.hazards.assessment")  # the module: the package names its function so

SOME = 5000  # cells of a map
HIDDEN = 16
PENALTY = 1e-3  # of squared weights
UNSAFE = np.float32(3)  # what a cell that is not safe weighs
SCHEDULE = Schedule(rounds=8, batch=2048, rate=4e-3)
FOLDS = 5  # of flights, each judged by what was fitted without it
STEPS = (0.0, 0.02, *np.linspace(0.05, 0.95, 19), 0.98, 1.0)  # of the cells, by their odds
Bool = NDArray[np.bool_]


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

    s = Settings().stages()
    stage.safe_belief = listen  # type: ignore[attr-defined]
    try:
        verdict = stage.assess(j.elevation, cover_of(j), s.lander, s.hazards)
    finally:
        stage.safe_belief = plain  # type: ignore[attr-defined]
    safe, near = j.safe
    left = np.flatnonzero((verdict.reasons == 0) & j.seen)  # the tilt leaves P >= 0.99
    total = max(int((safe & j.seen).sum()), 1)
    if len(left) < 50:
        return None
    share = float(safe.ravel()[left].sum() / total)
    some = np.random.default_rng(0).choice(left, min(SOME, len(left)), replace=False)
    terms = {k: v.ravel()[some] for k, v in heard[0].items()}
    level = verdict.p_safe.ravel()[some]
    return Sample(f"{name}, {how}", terms, safe.ravel()[some], near.ravel()[some], level, share, len(left) / len(some))


def _slopes(layers: list[F32], x: F32, least: F32, unsafe: F32) -> list[F32]:
    """Of the mean log loss, the costs being those of the net and the least ones together; wrong safe ones cost more."""
    inner, outer = layers
    hidden = np.tanh(x @ inner[:-1] + inner[-1])
    units = hidden.shape[1]
    seen = np.hstack([hidden, x])
    cost = (seen @ outer[:-1] + outer[-1])[:, 0] + least
    weight = 1 + (UNSAFE - 1) * unsafe
    off = np.asarray(((expit(cost) - unsafe) * weight / weight.sum())[:, None], np.float32)
    back = (off @ outer[:units].T) * (1 - hidden**2)
    pairs = ((x, back, inner), (seen, off, outer))
    return [np.vstack([a.T @ b + np.float32(PENALTY) * w[:-1], b.sum(axis=0)[None]]) for a, b, w in pairs]


def fit(samples: list[Sample]) -> Net:
    """The net of some flights: Adam, weights that became less than 0 put back to 0 after each step."""
    rng, names = np.random.default_rng(0), tuple(samples[0].terms)
    values = [np.stack([s.terms[k] for k in names], axis=1) for s in samples]
    usual, spread = (np.mean([f(v, axis=0) for v in values], axis=0).astype(np.float32) for f in (np.mean, np.std))
    x = np.concatenate([(v - usual) / (spread + np.float32(1e-3)) for v in values])
    least = np.concatenate([least_costs(s.terms) for s in samples])
    unsafe = np.concatenate([~s.near for s in samples]).astype(np.float32)
    weight = np.concatenate([np.full(len(v), 1 / len(v) / len(samples)) for v in values])
    flight = np.repeat(np.arange(len(values)), [len(v) for v in values])
    inner = np.vstack([np.abs(rng.normal(0, len(names) ** -0.5, (len(names), HIDDEN))), rng.normal(0, 1, (1, HIDDEN))])
    outer = np.concatenate([np.abs(rng.normal(0, 1, HIDDEN)), np.full(len(names), 0.05), np.zeros(1)])[:, None]
    layers = [inner.astype(np.float32), outer.astype(np.float32)]
    adam = Adam(layers)
    for i, shift, rate in SCHEDULE.batches(rng, weight, flight, len(names)):
        adam.step(_slopes(layers, (x[i] + shift).clip(-CLIP, CLIP), least[i], unsafe[i]), rate)
        for w in layers:
            np.maximum(w[:-1], 0, out=w[:-1])
    return Net(names, usual, spread + np.float32(1e-3), tuple(layers))


def odds(s: Sample, net: Net) -> F32:
    """Log odds of the sample, not calibrated."""
    values = np.stack([s.terms[k] for k in net.names], axis=1)
    terms = ((values - net.usual) / net.spread).clip(-CLIP, CLIP)
    inner, outer = ((w[:-1], w[-1]) for w in net.layers)
    return np.asarray(-least_costs(s.terms) - learned_costs(terms, inner, outer), np.float32)


def left_out(samples: list[Sample], fold_of: dict[str, int]) -> list[F32]:
    """Log odds of each flight by what was fitted without it."""
    fitted = {fold: fit([s for s in samples if fold_of[s.name] != fold]) for fold in set(fold_of.values())}
    return [odds(s, fitted[fold_of[s.name]]) for s in samples]


def calibration(samples: list[Sample], found: list[F32]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Odds, and what they were worth on flights left out, step by step, never less where the odds are better."""
    z = np.concatenate(found)
    weight = np.concatenate([np.full(len(s.near), s.weight) for s in samples])
    order = np.argsort(z)
    z, weight = z[order], weight[order]
    near, level = (np.concatenate([getattr(s, k) for s in samples])[order] for k in ("near", "level"))
    rank = np.cumsum(weight) / weight.sum()
    at, worth, cells = [], [], []
    for low, high in pairwise(STEPS):
        here = (rank > low) & (rank <= high)
        at.append(float((weight * z)[here].sum() / weight[here].sum()))
        cells.append(float((weight * level)[here].sum()))
        worth.append(float((weight * near)[here].sum()) / cells[-1])
    rising = logit(np.minimum(isotonic_regression(worth, weights=cells).x, 1 - 1e-3))
    return tuple(round(v, 2) for v in at), tuple(round(float(v), 2) for v in rising)


def claimed(samples: list[Sample], found: list[F32], fold_of: dict[str, int]) -> list[F32]:
    """P of each flight, its odds worth what they were worth on the other folds."""
    worth = {}
    for fold in set(fold_of.values()):
        others = [k for k, s in enumerate(samples) if fold_of[s.name] != fold]
        worth[fold] = calibration([samples[k] for k in others], [found[k] for k in others])
    p = [expit(np.interp(z, *worth[fold_of[s.name]])) for s, z in zip(samples, found, strict=True)]
    return [s.level * np.asarray(v, np.float32) for s, v in zip(samples, p, strict=True)]


def tell(done: list[tuple[Judged, float, float]]) -> None:
    """What is false and found at some levels, flights left out of all that judges them, as comment lines."""
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


def module(net: Net, worth: tuple[tuple[float, ...], tuple[float, ...]], count: int) -> str:
    """The text of `weights.py`."""
    said = f"Costs of the evidence against a footprint, from {count} simulated maps: `bench/ground_fit.py`."
    out = [f'"""{said}"""', "", *text_of(net), "# log odds, and what they were worth on flights left out"]
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
    p = claimed(samples, found, fold_of)
    tell([(Judged(s.name, v, s.safe, s.near), s.share, s.weight) for s, v in zip(samples, p, strict=True)])
    print(module(fit(samples), calibration(samples, found), len(samples)))


if __name__ == "__main__":
    main()
