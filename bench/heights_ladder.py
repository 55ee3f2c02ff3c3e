"""Rows of the ladder: error against height and frames, StereoSGBM on the same frames, edges, coverage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from heights_matchers import MATCHERS
from heights_points import compare, points_of
from heights_table import Row, kept
from ladder import rung
from true_views import exposures

COUNTS = (10, 20)  # exposures
MIDDLE = 40  # metres: height at which everything is measured
HEIGHTS = (20, 40, 60, 100, 150)
SCENES = ("meadow", "farmland", "village", "quarry", "forest", "lakes", "desert", "yard")
FEW = ("meadow", "farmland", "village", "quarry")  # at the other heights
MUST = {10: (0.15, 0.12), 20: (0.12, 0.08)}  # % of height: must and aim
OURS = ("batch", "ring")
MOTION = ("SGBM motion, median", "SGBM motion, widest")
Found = dict[str, dict[str, float]]  # a row of numbers a matcher


@lru_cache(1)
def _flown(name: str) -> tuple[object, list[list[object]]]:
    flight = rung(name).fly()
    return flight, list(exposures(flight))


def measure(name: str, count: int) -> Found:
    """Measure every matcher on the `count` exposures about the middle of a rung."""

    def work() -> Found:
        flight, shots = _flown(name)
        start = (len(shots) - count) // 2
        some = shots[start : start + count]
        points = points_of(flight, some)
        return compare({k: match(some, points) for k, match in MATCHERS.items()}, points)

    return kept(f"{name} N {count}", work)


@dataclass
class Ladder:
    """The rungs of a table; a rung is measured when a row first needs it."""

    names: Sequence[str] = ()  # rungs asked for by name, instead of all
    _found: dict[tuple[str, int], Found] = field(default_factory=dict)

    def rungs(self, height: int) -> list[str]:
        """Names of the rungs at one height."""
        if self.names:
            return [n for n in self.names if rung(n).height == height]
        return [f"{s}/{height}m/test-1" for s in (SCENES if height == MIDDLE else FEW)]

    @property
    def heights(self) -> list[int]:
        """Heights of the rungs."""
        return sorted({rung(n).height for n in self.names}) if self.names else list(HEIGHTS)

    def of(self, name: str, count: int) -> Found:
        """The numbers of one rung, printed when they are new."""
        if (name, count) not in self._found:
            for n in COUNTS:  # together: a flight takes as long as its matching
                self._found[name, n] = measure(name, n)
                print("\n".join(shown(f"{name}, N = {n}", self._found[name, n])), flush=True)
        return self._found[name, count]

    def median(
        self, matcher: str, column: str, heights: Iterable[int], count: int, scenes: Sequence[str] = SCENES
    ) -> float:
        """Median of one number over the rungs of some heights and scenes."""
        names = [n for h in heights for n in self.rungs(h) if rung(n).scene in scenes]
        values = [self.of(n, count)[matcher].get(column, math.nan) for n in names]
        known = [v for v in values if not math.isnan(v)]
        return float(np.median(known)) if known else math.nan


def shown(title: str, found: Found) -> list[str]:
    """The numbers of a rung as lines of text."""
    columns = list(found["batch"])
    out = [f"{title:28s}" + "".join(f"{c:>13s}" for c in columns)]
    for name, values in found.items():
        out.append(f"  {name:26s}" + "".join(f"{values.get(c, math.nan):13.3f}" for c in columns))
    return out


def accuracy(rungs: Ladder) -> list[Row]:
    """Rows of the error on open ground, % of height."""
    return [
        Row(f"open-ground NMAD, % of height: {h} m, N = {n}, {m}", rungs.median(m, "open NMAD %", [h], n), *MUST[n])
        for h in sorted(rungs.heights, key=lambda h: (h != MIDDLE, h)) for n in COUNTS for m in OURS
    ]  # fmt: skip


def exponent(rungs: Ladder) -> list[Row]:
    """Slope of log error in metres over log height; about 2 for the rig, whose baseline does not grow.

    Only scenes that are flown at every height count: others, at one height, would bias the slope.
    """
    heights = rungs.heights
    out = []
    for matcher in (*OURS, "SGBM rig", "SGBM rig x4"):
        for n in COUNTS if matcher in OURS else COUNTS[:1]:
            errors = [0.01 * h * rungs.median(matcher, "open NMAD %", [h], n, FEW) for h in heights]
            slope = float(np.polyfit(np.log(heights), np.log(errors), 1)[0]) if len(heights) > 1 else math.nan
            limits = (1.1, 1.0) if matcher in OURS else ()
            out.append(Row(f"exponent of the error over range, {matcher}, N = {n}", slope, *limits))
    return out


def sgbm(rungs: Ladder) -> list[Row]:
    """Ratio of StereoSGBM's error to ours on the same motion baseline; the better of its two ways counts."""
    out = []
    for n in COUNTS:
        theirs = {m: rungs.median(m, "open NMAD %", [MIDDLE], n) for m in MOTION}
        best = min(theirs, key=lambda m: theirs[m])
        for m in OURS:
            ratio = theirs[best] / rungs.median(m, "open NMAD %", [MIDDLE], n)
            name = f"times better than {best}, open ground, {MIDDLE} m, N = {n}, {m}"
            out.append(Row(name, ratio, (2.0, math.inf), (3.0, math.inf)))
    return out


def edges(rungs: Ladder) -> list[Row]:
    """Bad cells beside steps, over those of StereoSGBM, as a map of the same cells and along the rays to the points."""
    out = []
    for n in COUNTS:
        cells = rungs.median("SGBM motion, map", "edge bad %", [MIDDLE], n)
        rays = min(rungs.median(m, "edge bad %", [MIDDLE], n) for m in MOTION)
        for m in OURS:
            bad = rungs.median(m, "edge bad %", [MIDDLE], n)
            name = f"bad within 0.5 m of a step over SGBM's map ({bad:.1f} / {cells:.1f} %), {MIDDLE} m, N = {n}, {m}"
            out.append(Row(name, bad / cells, 1.0, 0.5))
            out.append(Row(f"... over SGBM looked up along the rays ({rays:.1f} %)", bad / rays, 1.0, 0.5))
            given = (rungs.median(k, "edge bad given %", [MIDDLE], n) for k in (m, "SGBM motion, map"))
            out.append(Row("... of those given out, over those that SGBM's map gives out", divided(*given), 1.0, 0.5))
    return out


def divided(ours: float, theirs: float) -> float:
    """Ratio of two numbers; NaN if the second is 0."""
    return ours / theirs if theirs else math.nan


COVERAGE = {
    "open 95 %": ((93.0, 99.0), (94.0, 97.0)), "edge 95 %": ((90.0, 100.0), (93.0, 97.0)),
    "open 68 %": ((60.0, 80.0), (65.0, 72.0)),
}  # fmt: skip


def coverage(rungs: Ladder) -> list[Row]:
    """Share of the heights given out within the claimed interval."""
    return [
        Row(f"{k.split()[0]}: within the {k.split(' ', 1)[1]} interval, {m}, N = {n}",
            rungs.median(m, k, rungs.heights, n), *limits)
        for k, limits in COVERAGE.items() for n in COUNTS for m in OURS
    ]  # fmt: skip
