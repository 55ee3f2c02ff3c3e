"""Fit `learned/p_safe.npz` on tuning flights, and print what it is worth on flights left out.

    PYTHONPATH=bench python training/p_safe.py

A small net whose weights are all at least 0, on top of penalties that are set by hand; every map weighs the same. The
land cover of each flight is judged by a net, and its odds are found by another, that have not seen the flight; what
such odds were worth is the calibration. Needs the extra `train` (scikit-learn).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np
from card import version, write_table
from draws import rounds_of
from ground_flights import TUNING, Judged, cover_of, pooled, reliability
from ground_maps import How, judgeable
from land_cover import fit_net, joined, rows_of
from scipy.special import expit, logit
from sklearn.isotonic import IsotonicRegression

from alight.arrays import F32, F64, Mask
from alight.hazards import assess
from alight.hazards.evidence_probability import prior_penalties
from alight.learned import CLIP, AffineLayer, Net, monotone_costs
from alight.settings import Settings

SOME = 5000  # cells of a map
HIDDEN = 16
PENALTY = 1e-3  # of squared weights
UNSAFE = np.float32(3)  # what a cell that is not safe weighs
ROUNDS, BATCH, RATE = 8, 2048, 4e-3  # draws of all cells, cells of a step, first step of Adam
FOLDS = 5  # of flights, each judged by what was fitted without it
STEPS = (0.0, 0.02, *np.linspace(0.05, 0.95, 19), 0.98, 1.0)  # of the cells, by their odds


@dataclass(frozen=True, eq=False)
class Sample:
    """Some cells of one map that no limit refuses."""

    name: str
    terms: dict[str, F32]
    safe: Mask
    near: Mask
    level: F32  # (N,) P that the tilt keeps its limit, by which the fitted belief is multiplied
    share: float  # of the truly safe cells that are among those it was drawn from
    weight: float  # cells of the map that each of the sample stands for


def sample(name: str, how: How, scratch: Path, cover_net: Net) -> Sample | None:
    """Draw cells of one map, and look up the truth."""
    j = judgeable(name, how, scratch)
    if j is None:
        return None
    kept: list[dict[str, F32]] = []

    def keep(terms: dict[str, F32]) -> F32:
        kept.append(terms)
        return np.ones_like(next(iter(terms.values())))  # P that is left is that of the tilt

    s = Settings().stages()
    with patch("alight.hazards.assessment.evidence_probability", keep):
        verdict = assess(j.elevation, cover_of(j, cover_net), s.lander, s.hazards)
    safe, near = j.safe
    left = np.flatnonzero((verdict.reasons == 0) & j.seen)  # the tilt leaves P >= 0.99
    total = max(int((safe & j.seen).sum()), 1)
    if len(left) < 50:
        return None
    share = float(safe.ravel()[left].sum() / total)
    some = np.random.default_rng(0).choice(left, min(SOME, len(left)), replace=False)
    terms = {k: v.ravel()[some] for k, v in kept[0].items()}
    level = verdict.p_safe.ravel()[some]
    return Sample(f"{name}, {how}", terms, safe.ravel()[some], near.ravel()[some], level, share, len(left) / len(some))


@dataclass(eq=False)
class Adam:
    """Adam (Kingma and Ba 2015), weights that fell below 0 put back to 0: scikit-learn has no net with such weights."""

    layers: list[F32]  # changed in place, the bias in the last row
    taken: int = 0
    mean: list[F32] = field(default_factory=list)
    power: list[F32] = field(default_factory=list)

    def step(self, slopes: list[F32], rate: float) -> None:
        """One step."""
        if not self.taken:
            self.mean, self.power = ([np.zeros_like(w) for w in self.layers] for _ in range(2))
        self.taken += 1
        for w, g, mean, power in zip(self.layers, slopes, self.mean, self.power, strict=True):
            mean += np.float32(0.1) * (g - mean)
            power += np.float32(0.001) * (g * g - power)
            size = np.sqrt(power / (1 - 0.999**self.taken)) + 1e-8
            w -= np.asarray(rate * mean / (1 - 0.9**self.taken) / size, np.float32)
            np.maximum(w[:-1], 0, out=w[:-1])


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
    """The net of some flights, its rate falling as a cosine."""
    rng, names = np.random.default_rng(0), tuple(samples[0].terms)
    values = [np.stack([s.terms[k] for k in names], axis=1) for s in samples]
    usual, spread = (np.mean([f(v, axis=0) for v in values], axis=0).astype(np.float32) for f in (np.mean, np.std))
    x = np.concatenate([(v - usual) / (spread + np.float32(1e-3)) for v in values])
    least = np.concatenate([prior_penalties(s.terms) for s in samples])
    unsafe = np.concatenate([~s.near for s in samples]).astype(np.float32)
    weight = np.concatenate([np.full(len(v), 1 / len(v) / len(samples)) for v in values])
    flight = np.repeat(np.arange(len(values)), [len(v) for v in values])
    inner = np.vstack([np.abs(rng.normal(0, len(names) ** -0.5, (len(names), HIDDEN))), rng.normal(0, 1, (1, HIDDEN))])
    outer = np.concatenate([np.abs(rng.normal(0, 1, HIDDEN)), np.full(len(names), 0.05), np.zeros(1)])[:, None]
    layers = [inner.astype(np.float32), outer.astype(np.float32)]
    adam, steps = Adam(layers), ROUNDS * (len(weight) // BATCH)
    for cells, shift in rounds_of(rng, weight, flight, len(names), ROUNDS, BATCH):
        for i in cells.reshape(-1, BATCH):
            rate = RATE * 0.5 * (1 + np.cos(np.pi * adam.taken / steps))
            adam.step(_slopes(layers, (x[i] + shift[flight[i]]).clip(-CLIP, CLIP), least[i], unsafe[i]), rate)
    found = [AffineLayer(w[:-1], w[-1]) for w in layers]
    return Net(names, usual, spread + np.float32(1e-3), found[0], found[1])


def odds(s: Sample, net: Net) -> F32:
    """Log odds of the sample, not calibrated."""
    return np.asarray(-prior_penalties(s.terms) - monotone_costs(net, s.terms), np.float32)


def left_out(samples: list[Sample], fold_of: dict[str, int]) -> list[F32]:
    """Log odds of each flight by what was fitted without it."""
    fitted = {fold: fit([s for s in samples if fold_of[s.name] != fold]) for fold in set(fold_of.values())}
    return [odds(s, fitted[fold_of[s.name]]) for s in samples]


def calibration(samples: list[Sample], found: list[F32]) -> F64:
    """(2, steps): log odds, and those that held on flights left out, never less where the odds are better."""
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
    rising = IsotonicRegression().fit_transform(np.arange(len(worth)), worth, sample_weight=cells)
    return np.round([at, logit(np.minimum(rising, 1 - 1e-3))], 2)


def claimed(samples: list[Sample], found: list[F32], fold_of: dict[str, int]) -> list[F32]:
    """P of each flight, its odds worth what they were worth on the other folds."""
    worth = {}
    for fold in set(fold_of.values()):
        others = [k for k, s in enumerate(samples) if fold_of[s.name] != fold]
        worth[fold] = calibration([samples[k] for k in others], [found[k] for k in others])
    p = [expit(np.interp(z, *worth[fold_of[s.name]])) for s, z in zip(samples, found, strict=True)]
    return [s.level * np.asarray(v, np.float32) for s, v in zip(samples, p, strict=True)]


def metrics(done: list[tuple[Judged, float, float]]) -> list[str]:
    """Lines on what is false and found at some levels, flights left out of all that judges them."""
    out = []
    total = sum(w * j.safe.sum() / max(share, 1e-9) for j, share, w in done)
    for j, share, _ in done:
        parts = []
        for least in (0.9, 0.95, 0.97, 0.99):
            sure = j.p >= least
            wrong, found = (sure & ~j.near).sum() / max(sure.sum(), 1), (sure & j.safe).sum() / max(j.safe.sum(), 1)
            parts.append(f"{least}: false {100 * wrong:5.2f} found {100 * share * found:5.1f}")
        out.append(f"{j.name:34s} left {100 * share:3.0f} %   " + "   ".join(parts))
    for least in (0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995):
        claimed = sum(w * (j.p >= least).sum() for j, _, w in done)
        wrong = sum(w * ((j.p >= least) & ~j.near).sum() for j, _, w in done)
        found = sum(w * ((j.p >= least) & j.safe).sum() for j, _, w in done)
        out.append(f"P >= {least}: false {100 * wrong / max(claimed, 1):.2f} %, found {100 * found / total:.1f} %")
    pairs = reliability(pooled([j for j, _, _ in done]))
    return [*out, "claimed and true frequency: " + "  ".join(f"{a:.3f}:{b:.3f}" for a, b, _ in pairs)]


def samples_of(names: tuple[str, ...], scratch: Path) -> tuple[list[Sample], dict[str, int]]:
    """Cells of every flight, their cover judged by a net that has not seen the flight; and its fold."""
    parts = {names[r.flight[0]]: r for r in rows_of(names, scratch)}
    fold = {name: i % FOLDS for i, name in enumerate(parts)}
    out: list[Sample] = []
    fold_of: dict[str, int] = {}
    for k in range(FOLDS):
        net = fit_net(joined([r for name, r in parts.items() if fold[name] != k]))
        found = [sample(name, "batch", scratch, net) for name in parts if fold[name] == k]
        out += [s for s in found if s is not None]
        fold_of |= {s.name: k for s in found if s is not None}
    return out, fold_of


def main() -> None:
    """Fit, and write the table and its card."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    samples, fold_of = samples_of(TUNING, parser.parse_args().scratch)
    found = left_out(samples, fold_of)
    p = claimed(samples, found, fold_of)
    lines = metrics([(Judged(s.name, v, s.safe, s.near), s.share, s.weight) for s, v in zip(samples, p, strict=True)])
    print("\n".join(lines))
    net = replace(fit(samples), calibration=calibration(samples, found))
    fitted = (
        f"Maps of {len(fold_of)} of {len(TUNING)} simulated tuning flights of our own simulator (`TUNING` in "
        "`bench/ground_flights.py`), those that have 50\ncells or more that no limit refuses; batch maps with "
        f"estimated poses, default lander, {SOME} cells at most of each. Each weighs the same. {version()}"
    )
    table = "Flights left out of nets, penalties and calibration:\n\n" + "\n".join(f"    {line}" for line in lines)
    made = "`PYTHONPATH=bench python training/p_safe.py`"
    write_table("p_safe", net, {"Fitted on": fitted, "Made by": made, "Metrics": table})


if __name__ == "__main__":
    main()
