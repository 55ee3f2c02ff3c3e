"""P(safe) on domains that had no part in a fit: other renderers, and flights of our own (docs/lab/p-safe.md).

    PYTHONPATH=bench python bench/ground_domains.py                     # ../shared/data, batch and recursive
    PYTHONPATH=bench python bench/ground_domains.py gravel/12m/test-1   # rungs of the ladder, or folders with truth
    PYTHONPATH=bench python bench/ground_domains.py --set fresh         # flights of our own

Each flight is judged by itself. A claim is false where no truly safe touchdown lies within 0.3 m; found is the claimed
share of the truly safe cells that the map saw.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
from ground_maps import FRESH, HOWS, TUNING, How, Judgeable, judgeable
from ground_truth import Bool, GroundTruth
from tables import DATA

from alight import hazards
from alight.arrays import F32
from alight.landing import sites
from alight.landing.sites import Observer
from alight.pipeline.judging import find_land_cover
from alight.raster import distance_to
from alight.records import Hazard, HazardMap, Site
from alight.settings import Settings
from alight.sources.appearance import read_model

FOREIGN = ("sample", *(f"rendered/{name}" for name in ("gravelpit", "scree", "shore", "marsh", "car_park")))
SETS = {"foreign": FOREIGN, "fresh": FRESH, "tuning": TUNING}
LEVELS = (0.95, 0.99)
BINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
ENOUGH = 1000  # cells of a bin
ROOM = 1.0  # metres of clearance beyond the footprint
FINE = 0.032  # metres: pixels that are fine enough for the limit


@dataclass(frozen=True, eq=False)
class Claims:
    """P(safe) of the seen cells of a flight beside the truth, flat."""

    name: str
    p: F32  # claimed; 0 where it cannot be judged
    safe: Bool
    near: Bool  # or within 0.3 m of it

    @classmethod
    def of(cls, name: str, danger: HazardMap, truth: GroundTruth, here: Bool) -> Claims:
        """The claims of a map on some of its cells."""
        safe, near = (truth.on(danger.grid, m)[here] for m in (truth.safe, truth.near(truth.safe)))
        return cls(name, np.nan_to_num(danger.p_safe)[here], safe, near)

    @property
    def bins(self) -> list[tuple[float, float, int]]:
        """Claimed and true frequency, and number of cells, of every bin with enough cells."""
        inside = [(self.p >= low) & (self.p < high) for low, high in pairwise(BINS)]
        return [
            (float(self.p[b].mean()), float(self.near[b].mean()), int(b.sum())) for b in inside if b.sum() >= ENOUGH
        ]

    def lines(self) -> list[str]:
        """Cells falsely claimed and found, and the reliability, as lines of text."""
        sure = [self.p >= level for level in LEVELS]
        false = " / ".join(f"{100 * (s & ~self.near).sum() / s.sum():6.2f}" if s.any() else "  none" for s in sure)
        found = 100 * float((sure[0] & self.safe).sum() / max(self.safe.sum(), 1))
        out = [
            f"{self.name:44s} safe {100 * self.safe.mean():5.1f} %  false at 0.95 / 0.99 {false} % of "
            f"{sure[0].sum()}/{sure[1].sum()} cells  found {found:5.1f} %"
        ]
        return [*out, "      claimed:true " + "  ".join(f"{c:.2f}:{t:.2f}" for c, t, _ in self.bins)]


def pooled(flights: Sequence[Claims], name: str = "all of them") -> Claims:
    """Join the cells of several flights."""
    return Claims(name, *(np.concatenate([getattr(f, k) for f in flights]) for k in ("p", "safe", "near")))


@dataclass(frozen=True, eq=False)
class Row:
    """Numbers of one flight."""

    claims: Claims
    found_fine: tuple[int, int]  # cells found at 0.95, and truly safe, where the pixel is fine enough
    listed: tuple[str, ...]  # each place by rank: S or C, lower case where it is not safe
    covered: float  # share of the truly safe cells with `ROOM`, not refused

    def lines(self) -> list[str]:
        """The numbers as lines of text."""
        first, *rest = self.claims.lines()
        fine = f"{100 * self.found_fine[0] / max(self.found_fine[1], 1):5.1f} of {self.found_fine[1]}"
        places = "".join(self.listed) or "-"
        return [f"{first}, fine pixels {fine}  not refused {100 * self.covered:5.1f} %  listed {places}", *rest]


def judged(j: Judgeable, settings: Settings) -> tuple[HazardMap, tuple[Site, ...]]:
    """The hazard map, and the listed places."""
    s, cover = settings.stages(), find_land_cover(j.elevation, settings.stages().terrain, read_model())
    danger = hazards.assess(j.elevation, cover, s.lander, s.hazards, wires=j.wires)
    middle = j.elevation.grid
    above = Observer(
        np.array([middle.east, middle.north, float(np.nanmedian(j.elevation.height)) + 30.0]), 30.0, 480.0, True
    )
    chosen = sites.choose_sites(danger, cover, j.elevation, s.sites, s.lander, above)
    return danger, (*chosen.sites, *chosen.candidates)


def row_of(j: Judgeable, settings: Settings | None = None) -> Row:
    """Judge one flight, and compare it with the truth."""
    settings = settings or Settings()
    danger, listed = judged(j, settings)
    grid, truth = danger.grid, GroundTruth(j.truth, settings.lander)
    safe, near = truth.on(grid, truth.safe) & j.seen, truth.on(grid, truth.near(truth.safe))
    roomy = truth.on(grid, (distance_to(~truth.safe) * j.truth.grid.cell > ROOM)) & j.seen
    fine = safe & (j.elevation.picture_sampling <= FINE)
    sure = np.where(j.seen, np.nan_to_num(danger.p_safe), 0) >= LEVELS[0]
    refused = (danger.reasons & np.uint8(0xFF & ~int(Hazard.DOUBT))) != 0
    at = [tuple(int(np.rint(i)) for i in grid.index(c.east, c.north)) for c in listed]
    marks = tuple((c.kind[0].upper() if near[k] else c.kind[0].lower()) for c, k in zip(listed, at, strict=True))
    covered = float((~refused & roomy).sum() / roomy.sum()) if roomy.any() else float("nan")
    claims = Claims.of(j.name, danger, truth, j.seen)
    return Row(claims, (int((sure & fine).sum()), int(fine.sum())), marks, covered)


def rows(names: Sequence[str], hows: Sequence[How], scratch: Path) -> list[Row]:
    """Rows of every flight, each way of mapping by itself."""
    out = []
    for name in names:
        for how in hows:
            j = judgeable(name, how, scratch, tuple(hows))
            if j is not None:
                out.append(row_of(j))
                print("\n".join(out[-1].lines()), flush=True)
    return out


def summary(flights: Sequence[Row]) -> list[str]:
    """Requirements over all flights, in words."""
    listed = [m for r in flights for m in r.listed]
    fine = np.array([r.found_fine for r in flights]).sum(axis=0)
    first = sum(bool(r.listed) and r.listed[0].isupper() for r in flights)
    over = [c - t for r in flights for c, t, _ in r.claims.bins]
    return [
        *pooled([r.claims for r in flights]).lines(),
        f"sites truly safe: {listed.count('S')} of {sum(m in 'Ss' for m in listed)}",
        f"flights that list a true place first: {first} of {sum(r.claims.safe.any() for r in flights)}",
        f"found at 0.95 where pixels are fine enough: {100 * fine[0] / max(fine[1], 1):.1f} % of {fine[1]} cells",
        f"largest overstatement of a bin: {100 * max(over, default=0):.1f} points",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("flights", nargs="*", default=[])
    parser.add_argument("--set", choices=SETS, default="foreign")
    parser.add_argument("--how", nargs="*", choices=get_args(How), default=HOWS)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    names = options.flights or SETS[options.set]
    if not options.flights and options.set == "foreign":
        names = [str(DATA / f) for f in FOREIGN if (DATA / f).is_dir()]
    if found := rows(names, options.how, options.scratch):
        print("\n".join(summary(found)))


if __name__ == "__main__":
    main()
