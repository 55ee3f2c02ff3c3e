"""Heights with true poses against their requirements: one table, a row a quantity, with must and aim beside it.

    python bench/bench_heights.py                                        # all of it, about an hour of CPU
    python bench/bench_heights.py --rows accuracy,coverage --rungs meadow/40m/test-1
    python bench/bench_heights.py --rows unflagged --seeds 1001

`step`: CPU of a keyframe. `accuracy`, `coverage`: rungs of the ladder. `unflagged`: wrong heights
where none can be measured. Quantities that were measured with the same source before are not measured again
(out/bench-heights). Heights from estimated poses: bench_coverage.py; of photos: bench_photos.py.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import heights_unflagged as unflagged
import numpy as np
from bench_steps import keyframe_rows
from heights_points import METHODS, Shots, compare, mapped, on_map, points_of
from ladder import exposures, rung
from tables import Row, kept, show

from alight_sim import SimulatedFlight

COUNTS = (10, 20)  # exposures
MIDDLE = 40  # metres: height at which everything is measured
HEIGHTS = (20, 40, 60, 100, 150)
SCENES = ("meadow", "farmland", "village", "quarry", "forest", "lakes", "desert", "yard")
FEW = ("meadow", "farmland", "village", "quarry")  # at the other heights
MUST = {10: (0.15, 0.12), 20: (0.12, 0.08)}  # % of height: must and aim
Found = dict[str, dict[str, float]]  # a row of numbers a matcher


@lru_cache(1)
def _flown(name: str) -> tuple[SimulatedFlight, Shots]:
    flight = rung(name).fly()
    return flight, list(exposures(flight))


def measure(name: str, count: int) -> Found:
    """Measure every matcher on the `count` exposures about the middle of a rung."""

    def work() -> Found:
        flight, shots = _flown(name)
        start = (len(shots) - count) // 2
        some = shots[start : start + count]
        points, left = points_of(flight, some), [s[:1] for s in some]
        ours = {m: on_map(mapped(left, m, 8), points) for m in METHODS}
        return compare(ours, points)

    return kept(f"{name} N {count}", work)  # type: ignore[no-any-return]


@dataclass
class Ladder:
    """The rungs of a table; a rung is measured when a row first needs it, and its numbers are printed."""

    names: Sequence[str] = ()  # rungs asked for by name, instead of all
    _found: dict[tuple[str, int], Found] = field(default_factory=dict)

    @property
    def heights(self) -> list[int]:
        """Heights of the rungs."""
        return sorted({rung(n).height for n in self.names}) if self.names else list(HEIGHTS)

    def of(self, name: str, count: int) -> Found:
        """The numbers of one rung."""
        if (name, count) not in self._found:
            for n in COUNTS:  # together: a flight takes as long as its matching
                self._found[name, n] = measure(name, n)
                print("\n".join(shown(f"{name}, N = {n}", self._found[name, n])), flush=True)
        return self._found[name, count]

    def median(self, matcher: str, column: str, heights: Collection[int], count: int) -> float:
        """Median of one number over the rungs of some heights."""
        every = self.names or [f"{s}/{h}m/test-1" for h in heights for s in (SCENES if h == MIDDLE else FEW)]
        values = [self.of(n, count)[matcher].get(column, np.nan) for n in every if rung(n).height in heights]
        return float(np.nanmedian(values)) if values else math.nan


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
        for h in sorted(rungs.heights, key=lambda h: (h != MIDDLE, h)) for n in COUNTS for m in METHODS
    ]  # fmt: skip


COVERAGE = {
    "open 95 %": ((93.0, 99.0), (94.0, 97.0)), "edge 95 %": ((90.0, 100.0), (93.0, 97.0)),
    "open 68 %": ((60.0, 80.0), (65.0, 72.0)),
}  # fmt: skip


def coverage(rungs: Ladder) -> list[Row]:
    """Share of the heights given out within the claimed interval."""
    return [
        Row(f"{k.split()[0]}: within the {k.split(' ', 1)[1]} interval, {m}, N = {n}",
            rungs.median(m, k, rungs.heights, n), *limits)
        for k, limits in COVERAGE.items() for n in COUNTS for m in METHODS
    ]  # fmt: skip


GROUPS: dict[str, Callable[[argparse.Namespace, Ladder], list[Row]]] = {
    "step": lambda options, rungs: keyframe_rows(),
    "accuracy": lambda options, rungs: accuracy(rungs),
    "coverage": lambda options, rungs: coverage(rungs),
    "unflagged": lambda options, rungs: unflagged.rows(options.seeds),
}


def main() -> None:
    """Print the table, group by group."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(GROUPS), help=f"some of {', '.join(GROUPS)}")
    parser.add_argument("--rungs", default="", help="of the ladder, by name, with commas between")
    parser.add_argument("--seeds", default="1001", help="of the scenes of `unflagged`")
    options = parser.parse_args()
    warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
    rungs = Ladder([n for n in options.rungs.split(",") if n])
    for name in options.rows.split(","):
        show(*GROUPS[name](options, rungs), title=name)


if __name__ == "__main__":
    main()
