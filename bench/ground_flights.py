"""P(safe) on flights with truth: false claims, share of safe ground found, and reliability of P.

    python bench/ground_flights.py                       # test flights that nobody looked at before, batch
    python bench/ground_flights.py --set test            # those of the sessions before, and the sample
    python bench/ground_flights.py --how ring
    python bench/ground_flights.py --waterfall           # reasons why truly safe ground is not found
    python bench/ground_flights.py --figure docs/figures/reliability.svg

A touchdown counts as truly safe where the simulator's brute force finds it safe, or within 0.3 m of such a place: edges
are drawn no better than that. Found is the claimed share of the truly safe cells that the map saw.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from ground_maps import HOWS, Judgeable, judgeable
from heights_figures import Axis, chart
from numpy.typing import NDArray

from alight import hazards
from alight.landing import sites
from alight.pipeline.judging import land_cover
from alight.records import LANDABLE, ElevationMap, Flag, Hazard, HazardMap, Terrain, TerrainMap
from alight.settings import Settings
from alight.sources.appearance import read_model
from alight.terrain.classify import Tables

TUNING = (
    "canal/12m/tuning-35", "canal/20m/tuning-31", "canal/20m/tuning-55", "canal/40m/tuning-39",
    "car_park/12m/tuning-419", "car_park/20m/tuning-407", "car_park/30m/tuning-73", "concrete/12m/tuning-404",
    "concrete/20m/tuning-416", "concrete/30m/tuning-77", "depot/12m/tuning-34", "depot/12m/tuning-57",
    "depot/20m/tuning-37", "depot/30m/tuning-67", "desert/12m/tuning-415", "desert/20m/tuning-403",
    "desert/30m/tuning-70", "farmland/12m/tuning-405", "farmland/20m/tuning-417", "farmland/30m/tuning-79",
    "forest/12m/tuning-422", "forest/20m/tuning-410", "forest/30m/tuning-72", "furrows/12m/tuning-63",
    "furrows/20m/tuning-75", "furrows/30m/tuning-54", "gravel/10m/tuning-58", "gravel/12m/tuning-1",
    "gravel/12m/tuning-21", "gravel/20m/tuning-5", "gravel/20m/tuning-57", "gravel/30m/tuning-23",
    "gravel/40-8m/tuning-3", "gravel/40m/tuning-9", "gravel/40m/tuning-50", "lakes/12m/tuning-62",
    "lakes/20m/tuning-420", "lakes/30m/tuning-68", "marsh/12m/tuning-53", "marsh/20m/tuning-61",
    "marsh/30m/tuning-74", "meadow/12m/tuning-400", "meadow/20m/tuning-64", "meadow/30m/tuning-66",
    "meadow/40-8m/tuning-11", "pasture/12m/tuning-2", "pasture/12m/tuning-22", "pasture/20m/tuning-6",
    "pasture/30m/tuning-24", "pasture/40-8m/tuning-4", "quarry/12m/tuning-402", "quarry/20m/tuning-414",
    "quarry/30m/tuning-71", "snow/12m/tuning-411", "snow/20m/tuning-76", "tall_grass/12m/tuning-409",
    "tall_grass/20m/tuning-421", "tall_grass/30m/tuning-65", "village/12m/tuning-418", "village/20m/tuning-406",
    "village/30m/tuning-69", "yard/12m/tuning-401", "yard/20m/tuning-413", "yard/30m/tuning-78",
)  # fmt: skip
TEST = (
    "meadow/50m/test-1", "village/50m/test-1", "yard/20m/test-1", "desert/50m/test-1", "meadow/20m/test-2",
    "car_park/50m/test-1", "lakes/20m/test-1", "farmland/100m/test-1", "concrete/20m/test-1", "quarry/50m/test-1",
)  # fmt: skip
FRESH = (  # seeds that nobody looked at before the method was settled: for the figures of the docs, once
    "meadow/50m/test-201", "village/50m/test-201", "yard/20m/test-201", "desert/50m/test-201", "meadow/20m/test-202",
    "car_park/50m/test-201", "lakes/20m/test-201", "farmland/100m/test-201", "concrete/20m/test-201",
    "quarry/50m/test-201", "snow/20m/test-201", "forest/50m/test-201",
)  # fmt: skip
LEVELS = (0.9, 0.95, 0.99)
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0 + 1e-9)
ENOUGH = 500  # cells of a bin
NEVER = (Terrain.TALL_VEGETATION, Terrain.TREE, Terrain.WATER)
Bool = NDArray[np.bool_]
Taken = dict[Terrain, NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Judged:
    """The seen cells of one flight, flat."""

    name: str
    p: NDArray[np.float32]  # claimed; 0 where it cannot be judged
    safe: Bool
    near: Bool  # or within 0.3 m of it

    def line(self, least: float) -> str:
        """Line of text: cells claimed, falsely claimed and found."""
        sure = self.p >= least
        wrong, found = (sure & ~self.near).sum(), (sure & self.safe).sum()
        return (
            f"{self.name:36s} P >= {least:4.2f}: claimed {sure.sum():7d}, "
            f"false {100 * wrong / max(sure.sum(), 1):6.2f} %, found {100 * found / max(self.safe.sum(), 1):5.1f} %"
        )


def pooled(all_of: list[Judged], name: str = "all of them") -> Judged:
    """Join the cells of several flights."""
    parts = [np.concatenate([getattr(j, k) for j in all_of]) for k in ("p", "safe", "near")]
    return Judged(name, parts[0], parts[1], parts[2])


def cover_of(j: Judgeable, tables: Tables | None = None) -> TerrainMap:
    """Land cover by the tables of the package, or by other tables."""
    return land_cover(j.elevation, Settings().stages().terrain, read_model(), tables)


def verdict(j: Judgeable) -> HazardMap:
    """The hazard map with the default settings."""
    s = Settings().stages()
    return hazards.assess(j.elevation, cover_of(j), s.lander, s.hazards)


def judged(j: Judgeable, found: HazardMap) -> Judged:
    """The hazard map beside the truth."""
    safe, near = j.safe
    return Judged(j.name, np.nan_to_num(found.p_safe)[j.seen], safe[j.seen], near[j.seen])


def listed(j: Judgeable, found: HazardMap) -> tuple[int, int]:
    """Number of listed sites that are truly safe or within 0.3 m of a safe place, and number of all listed sites."""
    s, near, grid = Settings().stages(), j.safe[1], j.elevation.grid
    chosen = sites.choose_sites(found, None, j.elevation, s.sites, s.lander).sites
    at = [tuple(int(np.rint(i)) for i in grid.index(c.east, c.north)) for c in chosen]
    return sum(bool(near[k]) for k in at), len(at)


def taken(j: Judgeable, found: HazardMap) -> Taken:
    """Seen cells of each class that no lander may touch, and those of them where a touchdown is claimed safe."""
    sure = np.nan_to_num(found.p_safe) >= Settings().hazards.p_safe
    kinds = {k: j.seen & (j.label == k) for k in NEVER}
    return {k: np.array([here.sum(), (here & sure).sum()]) for k, here in kinds.items()}


def reliability(j: Judged) -> list[tuple[float, float, int]]:
    """Claimed and true frequency, and number of cells, of every bin with enough cells."""
    out = []
    for low, high in pairwise(BINS):
        here = (j.p >= low) & (j.p < high) & (j.p > 0)
        if here.sum() >= ENOUGH:
            out.append((float(j.p[here].mean()), float(j.near[here].mean()), int(here.sum())))
    return out


def _true_heights(j: Judgeable) -> ElevationMap:
    e = j.elevation
    unseen = (e.flags & np.uint16(Flag.UNSEEN)) | np.where(np.isfinite(j.height), 0, Flag.UNSEEN)
    sigma = np.full(e.grid.shape, 0.01, np.float32)
    return replace(e, height=j.height, sigma=sigma, flags=unseen.astype(np.uint16), gauge=None)


def _true_cover(j: Judgeable) -> TerrainMap:
    good = np.isin(j.label, [int(k) for k in LANDABLE]).astype(np.float32)
    return TerrainMap(j.elevation.grid, j.label, np.where(j.label == Terrain.UNKNOWN, np.float32(np.nan), good))


def waterfall(j: Judgeable) -> None:
    """Print the found and false cells with parts replaced by the truth, and the refusals of truly safe cells."""
    s, e, own, true = Settings().stages(), j.elevation, cover_of(j), _true_cover(j)
    level, plain = _true_heights(j), s.hazards.model_copy(update={"smoothed": False})
    for name, height, cover, settings in (
        ("as it is", e, own, s.hazards), ("cover left out", e, None, s.hazards),
        ("true cover, heights as they are", e, true, plain), ("true heights, cover as it is", level, own, plain),
        ("true heights, true cover", level, true, plain),
    ):  # fmt: skip
        print(
            f"   {name:34s}" + judged(j, hazards.assess(height, cover, s.lander, settings)).line(s.hazards.p_safe)[36:]
        )
    safe = j.safe[0] & ((e.flags & np.uint16(Flag.UNSEEN)) == 0)
    reasons = hazards.assess(e, own, s.lander, s.hazards).reasons[safe]
    shares = {bit: 100 * float(((reasons & bit) != 0).mean()) for bit in Hazard} if safe.any() else {}
    print("   truly safe and refused for: " + ", ".join(f"{b.name} {v:.0f} %" for b, v in shares.items() if v >= 1))


def flights(options: argparse.Namespace) -> Iterator[Judgeable]:
    """The flights that the options name."""
    names = options.flights or {"tuning": TUNING, "test": TEST, "fresh": FRESH}[options.set]
    if not options.flights and options.set == "test" and (options.data / "sample").is_dir():
        names = (*names, str(options.data / "sample"))
    for name in names:
        found = judgeable(name, options.how, options.scratch, tuple({*HOWS, options.how}))
        if found is not None:
            yield found


def figure(j: Judged) -> str:
    """Chart of claimed against true frequency."""
    ticks = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
    lines = {"P(safe)": [(a, b) for a, b, _ in reliability(j)], "what it should be": [(0.0, 0.0), (1.0, 1.0)]}
    title = "P(safe): claimed and true frequency, test flights"
    return chart(title, Axis("claimed", ticks, log=False), Axis("true", ticks, log=False), lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("flights", nargs="*", default=[], help="rungs of the ladder, or folders with truth")
    parser.add_argument("--set", choices=["tuning", "test", "fresh"], default="fresh")
    parser.add_argument("--how", choices=["batch", "ring", "batch-true", "ring-true"], default="batch")
    parser.add_argument("--waterfall", action="store_true")
    parser.add_argument("--figure", type=Path, default=None)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    done, barred, total = [], list[Taken](), np.zeros(2, np.int64)
    for j in flights(options):
        found = verdict(j)
        done.append(judged(j, found))
        barred.append(taken(j, found))
        right, count = listed(j, found)
        total += right, count
        print(
            f"{done[-1].name:36s} {100 * done[-1].safe.mean():5.1f} % truly safe; sites: {right} of {count}", flush=True
        )
        for level in LEVELS:
            print("   " + done[-1].line(level), flush=True)
        if options.waterfall:
            waterfall(j)
    every = pooled(done)
    print(f"sites truly safe, or within 0.3 m of it: {total[0]} of {total[1]}")
    for level in LEVELS:
        print(every.line(level))
    for kind in NEVER:
        cells, wrong = np.sum([t[kind] for t in barred], axis=0)
        print(f"{kind.name.lower()}: {cells} cells, no touchdown on {100 * (1 - wrong / max(cells, 1)):.3f} %")
    for claimed, true, cells in reliability(every):
        print(f"   claimed {claimed:.3f}  true {true:.3f}  {cells:8d} cells")
    if options.figure is not None:
        options.figure.write_text(figure(every), encoding="utf-8")


if __name__ == "__main__":
    main()
