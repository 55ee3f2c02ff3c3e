"""Fit the rates of looks from near by in `learned/`, and print their accuracy on families of scenes left out.

    PYTHONPATH=bench python training/near.py

The rates are sums of rising piecewise linear curves as in `p_safe.py`, over all terms together, fitted to looks from 4
to 10 m alone, under any light. A hazard exceeds the lander's own limits: from near by the height of a stone is
measured, and a lower stone is no hazard. Only simulated flights are fitted to; other renderers and real places only
test.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from card import version, write_table
from ground_maps import cover_of
from ground_truth import GroundTruth
from land_cover import family_of
from looks import FAMILIES, TEST, Look, kept_looks
from p_safe import Part, Rows, fit, folds_of
from scipy.special import ndtr

from alight.arrays import F64, Mask
from alight.hazards.assessment import limits_broken
from alight.hazards.evidence import evidence_of, unlike_ground
from alight.hazards.factors import margins_over_sigma, with_floors
from alight.hazards.touchdown import Inputs, measure
from alight.learned import Rate
from alight.learned.terms import NEAR_TERMS, FloorTerm
from alight.settings import Settings

LEFT_OUT = ("marsh", "rubble")  # puddles like lawn make every lawn doubtful; no term separates them: docs/lab/p-safe.md
SHALLOW = ("depot", "furrows")  # water of 3 cm on even ground: it lowers P everywhere, and is detected no better
WORLDS = tuple(f"{family}/looks/tuning-{k}" for k in range(1, 5) for family in FAMILIES if family not in LEFT_OUT)
SOME = 250  # cells of a look
LEAST_NEARNESS = 0.5
WHAT = ("obstacle", "ground")
LEVELS = (0.8, 0.9, 0.95, 0.97, 0.99)


@dataclass(frozen=True, eq=False)
class NearSample:
    """Flat arrays of some cells of one world's looks that no limit refuses."""

    family: str
    terms: F64  # (N, T)
    tilt: F64  # (N,) P that the tilt keeps its limit
    level: Mask  # (N,) a touchdown keeps the limits of slope and roughness, or does within 0.3 m
    bears: Mask  # (N,) the same of ground that bears and is dry
    safe: Mask  # (N,) the same of both together


def _cells(look: Look, rng: np.random.Generator) -> NearSample | None:
    s, j = Settings().stages(), look.judgeable
    on = Inputs(j.elevation, cover_of(j), s.lander, s.hazards)
    touchdowns = measure(on)
    found, reasons = evidence_of(touchdowns, on), limits_broken(touchdowns, on)
    p_tilt = np.nan_to_num(ndtr(margins_over_sigma(touchdowns, on)[0]))
    discs, truth = found.discs, GroundTruth(j.truth, s.lander)
    kept = (discs.largest(j.seen.astype(np.float32)) > 0) & look.about(discs.grid)
    kept &= (discs.largest((reasons != 0).astype(np.float32)) == 0) & (found.near >= LEAST_NEARNESS)
    cells = np.flatnonzero(kept)
    if not cells.size:
        return None
    some = rng.choice(cells, min(SOME, cells.size), replace=False)

    def truly(mask: Mask) -> Mask:
        return truth.on(discs.grid, truth.near(mask)).ravel()[some]

    terms = np.stack([np.nan_to_num(found.terms[t].ravel()[some]) for t in NEAR_TERMS], axis=1)
    tilt = discs.coarse(p_tilt.astype(np.float32)).ravel()[some]
    return NearSample(
        family_of(j.name), terms.astype(np.float64), tilt.astype(np.float64),
        truly(truth.level), truly(truth.bears), truly(truth.level & truth.bears),
    )  # fmt: skip


def sample_of(name: str, scratch: Path) -> NearSample | None:
    """Draw cells of every look of a world; None: it has none."""
    rng = np.random.default_rng(0)
    parts = [p for look in kept_looks(name, scratch) if (p := _cells(look, rng)) is not None]
    if not parts:
        return None
    joined = (np.concatenate([getattr(p, k) for p in parts]) for k in ("terms", "tilt", "level", "bears", "safe"))
    return NearSample(parts[0].family, *joined)


def rows_of(samples: Sequence[NearSample], what: str) -> Rows:
    """The cells of one factor: a place that is uneven and does not bear is a hazard of the ground."""
    samples = [s for s in samples if what == "obstacle" or s.family not in SHALLOW]
    families = sorted({s.family for s in samples})
    use = [s.bears if what == "obstacle" else s.level | ~s.bears for s in samples]
    count = {f: sum(s.family == f for s in samples) for f in families}
    pairs = list(zip(samples, use, strict=True))
    weight = np.concatenate([np.full(u.sum(), 1 / max(u.sum(), 1) / count[s.family]) for s, u in pairs])
    values = np.concatenate([s.terms[u] for s, u in pairs])
    hazard = np.concatenate([~(s.level if what == "obstacle" else s.bears)[u] for s, u in pairs])
    family = np.concatenate([np.full(u.sum(), families.index(s.family)) for s, u in pairs])
    return Rows((Part(NEAR_TERMS, values, np.ones(len(hazard))),), hazard, family, weight / weight.sum())


def fitted(samples: Sequence[NearSample]) -> dict[str, Rate]:
    """The rates of both factors."""
    return {what: fit(rows_of(samples, what), eager=0.0)[0] for what in WHAT}  # families weigh alike


def claimed(rates: dict[str, Rate], s: NearSample) -> F64:
    """P(safe) of the cells of a sample, without straight ridges (G7i), which no term holds."""
    values = {t: s.terms[:, k].astype(np.float32) for k, t in enumerate(NEAR_TERMS)}
    values |= {FloorTerm.UNLIKE: unlike_ground(values), FloorTerm.RIDGE: np.zeros(len(s.terms), np.float32)}
    hazards = {what: np.exp(rates[what].log_rate(values)) for what in WHAT}
    hazards = with_floors(hazards, values, {"all": 1.0, "heights": 1.0})
    return np.asarray(s.tilt * np.exp(-hazards["obstacle"] - hazards["ground"]), np.float64)


def line(name: str, p: F64, safe: Mask) -> str:
    """Line of text: false claims and safe cells found at some levels."""
    parts = [
        f"{k}: false {100 * (~safe[p >= k]).mean() if (p >= k).any() else 0:5.2f} found "
        f"{100 * (p[safe] >= k).mean() if safe.any() else 0:5.1f}"
        for k in LEVELS
    ]
    return f"{name:12s} safe {100 * safe.mean():5.1f}   " + "   ".join(parts)


def report(samples: Sequence[NearSample], p: Sequence[F64]) -> list[str]:
    """A line of text a family, and one of all."""
    pairs = list(zip(samples, p, strict=True))
    out = []
    for f in sorted({s.family for s in samples}):
        own = [(s, q) for s, q in pairs if s.family == f]
        out.append(line(f, np.concatenate([q for _, q in own]), np.concatenate([s.safe for s, _ in own])))
    return [*out, line("all", np.concatenate(list(p)), np.concatenate([s.safe for s in samples]))]


def main() -> None:
    """Fit, print the accuracy, and write the tables with their cards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    parser.add_argument("--worlds", nargs="*", default=WORLDS)
    parser.add_argument("--test", nargs="*", default=TEST)
    options = parser.parse_args()
    samples = [s for n in options.worlds if (s := sample_of(n, options.scratch)) is not None]
    families = sorted({s.family for s in samples})
    fold = folds_of(families, whole_families=True)
    without = {k: fitted([s for s in samples if fold[s.family] != k]) for k in set(fold.values())}
    print("families left out", *report(samples, [claimed(without[fold[s.family]], s) for s in samples]), sep="\n")
    rates = fitted(samples)
    fresh = [s for n in options.test if (s := sample_of(n, options.scratch)) is not None]
    if fresh:
        print("seeds that nothing is fitted to", *report(fresh, [claimed(rates, s) for s in fresh]), sep="\n")
    worlds = f"looks from 4 to 10 m in {len(samples)} simulated worlds; {len(families)} families of scenes. {version()}"
    for what, rate in rates.items():
        write_table(f"near_{what}_rate", rate.to_bytes(), {"Fitted on": worlds})


if __name__ == "__main__":
    main()
