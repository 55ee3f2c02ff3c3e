"""Roads found on real photos against roads that were labelled by hand (`bench/roads/*.geojson`).

    python bench/bench_roads.py RUN...      # folders of finished runs, named mirafiori, garfield, ...

The length of the labelled roads that is found, the share of other ground that is called road, and the rank of the first
site that lies on one. Lines named `maybe` (car parks, verges) count neither way.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import shapely
from tables import Row, show

from alight.outputs.reading import read_evidence, read_run
from alight.pipeline.again import judge_again
from alight.pipeline.judging import find_land_cover, on_judging_cells
from alight.runs import appearance_of
from alight.settings import Settings
from alight.sources.zones import read_zones

LABELS = Path(__file__).parent / "roads"
EDGE = 1.0  # metres beside a labelled road that count neither way


def measured(folder: Path) -> list[Row]:
    """The rows of one run."""
    result, name = read_evidence(folder), folder.name
    evidence, stages = result.evidence, result.settings.stages()
    assert evidence is not None
    elevation = on_judging_cells(evidence, stages.lander)
    cover = find_land_cover(elevation, Settings().stages().terrain, appearance_of(result.settings))
    assert cover.road is not None
    lines = read_zones(LABELS / f"{name}.geojson").in_world(result.local).zones
    roads, doubtful = ([z for z in lines if z.name.endswith("maybe") is maybe] for maybe in (False, True))
    east, north = np.meshgrid(*evidence.frame.grid(cover.grid).xy())
    seen = np.isfinite(cover.landable)

    def within(zones: list[object], more: float) -> np.ndarray:
        area = shapely.union_all([z.shape.buffer(z.reach + more) for z in zones])  # type: ignore[attr-defined]
        return np.asarray(shapely.contains_xy(area, east, north))

    found = known = 0
    for z in roads:
        points = shapely.get_coordinates(z.shape.segmentize(0.5))
        row, col = (np.rint(v).astype(int) for v in evidence.frame.grid(cover.grid).index(*points.T))
        inside = (row >= 0) & (row < seen.shape[0]) & (col >= 0) & (col < seen.shape[1])
        row, col = row[inside], col[inside]
        known, found = known + int(seen[row, col].sum()), found + int((seen & cover.road)[row, col].sum())
    other = seen & ~within(roads, EDGE) & ~within(doubtful, EDGE)
    again = judge_again(_with_cover(result, cover), result.settings)
    on_road = within(roads, 0.0)
    ranks = []
    for s in again.sites.listed:
        row, col = (round(float(v)) for v in evidence.frame.grid(cover.grid).index(np.array(s.east), np.array(s.north)))
        ranks += [s.rank] if on_road[row, col] else []
    before = len(read_run(folder, ()).info["answer"]["sites"])
    print(f"{name}: {before} sites before, {len(again.sites.sites)} now, {len(again.sites.candidates)} candidates")
    for s in again.sites.listed:
        print(f"  {s.kind} {s.rank}: {s.p_safe:.3f} {s.avoid} {[(n.label, round(n.distance, 1)) for n in s.near]}")
    return [
        Row(f"{name}: length of the roads that is found, %", 100 * found / max(known, 1), ((80.0, np.inf), None)[0]),
        Row(f"{name}: other ground called road, %", 100 * float(cover.road[other].mean()), 2.0),
        Row(f"{name}: sites and candidates on a road", len(ranks)),
        Row(f"{name}: rank of the first on a road", float(min(ranks, default=99)), (2.0, np.inf)),
    ]


def _with_cover(result, cover):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    return replace(result, evidence=replace(result.evidence, land_cover=cover.on(result.evidence.grid)))


def main() -> None:
    for folder in map(Path, sys.argv[1:]):
        show(*measured(folder), title=folder.name)


if __name__ == "__main__":
    main()
