"""P(safe) on domains that had no part in a fit: other renderers, and fresh flights of our own (docs/lab/p-safe.md).

    PYTHONPATH=bench python bench/ground_domains.py                     # ../shared/data, batch and recursive
    PYTHONPATH=bench python bench/ground_domains.py gravel/12m/test-1   # rungs of the ladder, or folders with truth

Each flight is judged by itself. A claim is false where no truly safe touchdown lies within 0.3 m.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from ground_flights import cover_of
from ground_maps import HOWS, Judgeable, judgeable
from ground_truth import Bool, GroundTruth

from alight import hazards
from alight.landing import sites
from alight.landing.next_view import Observer
from alight.raster import distance_to
from alight.records import Hazard, HazardMap, Site
from alight.settings import Settings

FOREIGN = ("sample", "rendered/gravelpit", "rendered/scree", "rendered/shore")
LEVELS = (0.95, 0.99)
BINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
ENOUGH = 1000  # cells of a bin
ROOM = 1.0  # metres of clearance beyond the footprint
FINE = 0.032  # metres: pixels that are fine enough for the limit


@dataclass(frozen=True, eq=False)
class Row:
    """Numbers of one flight."""

    name: str
    safe: float  # share of the seen cells
    false: tuple[float, ...]  # share of the cells claimed at each of `LEVELS`
    claimed: tuple[int, ...]  # cells
    found: float  # share of the truly safe cells, at 0.95
    found_fine: tuple[int, int]  # cells found at 0.95, and truly safe, where the pixel is fine enough
    false_coarse: float  # share of the cells claimed at 0.95 where the pixel is not fine enough
    listed: tuple[str, ...]  # each place by rank: S or C, lower case where it is not safe
    covered: float  # share of the truly safe cells with `ROOM`, not refused
    bins: tuple[tuple[float, float, int], ...]  # claimed and true frequency, cells


def judged(j: Judgeable) -> tuple[HazardMap, tuple[Site, ...]]:
    """The hazard map, and the listed places."""
    s, cover = Settings().stages(), cover_of(j)
    danger = hazards.assess(j.elevation, cover, s.lander, s.hazards)
    middle = j.elevation.grid
    above = Observer(
        np.array([middle.east, middle.north, float(np.nanmedian(j.elevation.height)) + 30.0]), 30.0, 480.0, True
    )
    chosen = sites.choose_sites(danger, cover, j.elevation, s.sites, s.lander, above)
    return danger, (*chosen.sites, *chosen.candidates)


def _share(some: Bool, of: Bool) -> float:
    return float((some & of).sum() / of.sum()) if of.any() else float("nan")


def row_of(j: Judgeable) -> Row:
    """Judge one flight, and compare it with the truth."""
    danger, listed = judged(j)
    grid, truth = danger.grid, GroundTruth(j.truth, Settings().lander)
    seen = j.seen
    safe = truth.on(grid, truth.safe) & seen
    near = truth.on(grid, truth.near(truth.safe))
    roomy = truth.on(grid, (distance_to(~truth.safe) * j.truth.grid.cell > ROOM)) & seen
    p = np.where(seen, np.nan_to_num(danger.p_safe), 0)
    fine = j.elevation.picture_sampling <= FINE
    sure = p >= LEVELS[0]
    refused = (danger.reasons & np.uint8(0xFF & ~int(Hazard.DOUBT))) != 0
    at = [tuple(int(np.rint(i)) for i in grid.index(c.east, c.north)) for c in listed]
    marks = tuple((c.kind[0].upper() if near[k] else c.kind[0].lower()) for c, k in zip(listed, at, strict=True))
    bins = []
    for low, high in pairwise(BINS):
        here = (p >= low) & (p < high)
        if here.sum() >= ENOUGH:
            bins.append((float(p[here].mean()), float(near[here].mean()), int(here.sum())))
    return Row(
        j.name, _share(safe, seen), tuple(1 - _share(near, p >= v) for v in LEVELS),
        tuple(int((p >= v).sum()) for v in LEVELS), _share(sure, safe),
        (int((sure & safe & fine).sum()), int((safe & fine).sum())), 1 - _share(near, sure & ~fine), marks,
        _share(~refused, roomy), tuple(bins),
    )  # fmt: skip


def lines(r: Row) -> list[str]:
    """The numbers of one flight as lines of text."""
    false = " / ".join("  none" if not c else f"{100 * f:6.2f}" for f, c in zip(r.false, r.claimed, strict=True))
    fine = f"{100 * r.found_fine[0] / max(r.found_fine[1], 1):5.1f} of {r.found_fine[1]}"
    out = [
        f"{r.name:44s} safe {100 * r.safe:5.1f} %  false at 0.95 / 0.99 {false} % of "
        f"{r.claimed[0]}/{r.claimed[1]} cells  found {100 * r.found:5.1f} %, fine pixels {fine}  "
        f"not refused {100 * r.covered:5.1f} %  listed {''.join(r.listed) or '-'}"
    ]
    worst = [f"{c:.2f}:{t:.2f}" for c, t, _ in r.bins]
    return [*out, "      claimed:true " + "  ".join(worst)] if worst else out


def rows(names: Sequence[str], data: Path, scratch: Path) -> list[Row]:
    """Rows of every flight, batch and recursive."""
    asked = list(names) or [str(data / f) for f in FOREIGN if (data / f).is_dir()]
    out = []
    for name in asked:
        for how in HOWS:
            j = judgeable(name, how, scratch)
            if j is not None:
                out.append(row_of(j))
                print("\n".join(lines(out[-1])), flush=True)
    return out


def summary(all_of: Sequence[Row]) -> list[str]:
    """Requirements over all flights, in words."""
    listed = [m for r in all_of for m in r.listed]
    fine = np.array([r.found_fine for r in all_of]).sum(axis=0)
    first = sum(bool(r.listed) and r.listed[0].isupper() for r in all_of)
    over = [c - t for r in all_of for c, t, _ in r.bins]
    return [
        f"sites truly safe: {listed.count('S')} of {sum(m in 'Ss' for m in listed)}",
        f"flights that list a true place first: {first} of {sum(r.safe > 0 for r in all_of)}",
        f"found at 0.95 where pixels are fine enough: {100 * fine[0] / max(fine[1], 1):.1f} % of {fine[1]} cells",
        f"largest overstatement of a bin: {100 * max(over, default=0):.1f} points",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("flights", nargs="*", default=[])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    print("\n".join(summary(rows(options.flights, options.data, options.scratch))))


if __name__ == "__main__":
    main()
