"""Roads found on real photos against roads that were labelled by hand (`bench/roads/*.json`).

    python bench/bench_roads.py RUN...      # folders of finished runs, named mirafiori, garfield, caliterra

The land cover is found anew from the evidence of each run. Measured are the length of the labelled roads that is found,
the share of other ground that is called road, and the sites on roads. Lines named `maybe` (a car park, verges, paths of
which it is hard to say) count neither way.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from tables import Row, at_least, show

from alight.arrays import Mask
from alight.outputs.reading import read_evidence
from alight.pipeline.again import judge_again
from alight.pipeline.judging import find_land_cover, on_judging_cells
from alight.records import GroundZone
from alight.runs import appearance_of
from alight.settings import Settings
from alight.sources.zones import read_zones

LABELS = Path(__file__).parent / "roads"
EDGE = 1.0  # metres beside a labelled road that count neither way


def measured(folder: Path) -> list[Row]:
    """The rows of one run."""
    result, name = read_evidence(folder), folder.name
    evidence = result.evidence
    assert evidence is not None
    elevation = on_judging_cells(evidence, result.settings.lander)
    cover = find_land_cover(elevation, Settings().stages().terrain, appearance_of(result.settings))
    assert cover.road is not None
    grid, seen = evidence.frame.grid(cover.grid), np.isfinite(cover.landable)
    lines = read_zones(LABELS / f"{name}.json").in_world(result.local).zones
    roads, doubtful = ([z for z in lines if z.name.endswith("maybe") is maybe] for maybe in (False, True))

    def within(zones: Sequence[GroundZone], more: float) -> Mask:
        area = shapely.union_all([z.shape.buffer(z.reach + more) for z in zones])
        return np.asarray(shapely.contains_xy(area, *np.meshgrid(*grid.xy())))

    points = np.concatenate([shapely.get_coordinates(z.shape.segmentize(0.5)) for z in roads])
    on_seen = grid.nearest_at(seen.astype(np.float32), *points.T) == 1
    on_found = grid.nearest_at((seen & cover.road).astype(np.float32), *points.T) == 1
    other = seen & ~within([*roads, *doubtful], EDGE)
    with_roads = replace(result, evidence=replace(evidence, land_cover=cover.on(evidence.grid)))
    sites = judge_again(with_roads, result.settings).sites
    places = shapely.points([(s.east, s.north) for s in sites.listed]).reshape(-1)
    on_road = shapely.distance(shapely.union_all([z.shape.buffer(z.reach) for z in roads]), places) == 0.0
    print(f"{name}: {len(sites.sites)} sites, {len(sites.candidates)} candidates, {on_road.sum()} of them on a road")
    return [
        Row(f"{name}: length of the roads that is found, %", 100 * float(on_found[on_seen].mean()), at_least(80.0)),
        Row(f"{name}: other ground called road, %", 100 * float(cover.road[other].mean()), 2.0),
        Row(f"{name}: whether the first place is on a road", float(on_road[:1].any()), 0.0),
    ]


def main() -> None:
    for folder in map(Path, sys.argv[1:]):
        show(*measured(folder), title=folder.name)


if __name__ == "__main__":
    main()
