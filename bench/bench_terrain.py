"""Accuracy of the land cover on flights and on the library.

    python bench/bench_terrain.py measure FLIGHT ... # refused and kept by true class; rungs, or folders with truth
    python bench/bench_terrain.py library            # the library with each site left out, and other scenes

Maps are the product's own (bench/ground_maps.py) and kept under --scratch, because making them is most of the work.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ground_maps import FRESH, judgeable

from alight.arrays import F64
from alight.pipeline.judging import find_land_cover
from alight.records import LANDABLE, Terrain
from alight.settings import TerrainSettings
from alight.sources.appearance import read_model
from alight.sources.library import is_labelled, read_labelled, read_library
from alight.terrain.appearance import seen
from alight.training.confusion import lines_of
from alight.training.train import elsewhere, judge_pixels

NEVER = (Terrain.TALL_VEGETATION, Terrain.TREE, Terrain.WATER)
ALL = (*NEVER, Terrain.STRUCTURE, Terrain.ROCK, *LANDABLE)
LEAST = 200  # cells of a class in a flight that count


def measure(flights: list[str], scratch: Path, model: Path | None) -> None:
    """Share of each true class that is refused, by class alone and together with heights that are not trusted."""
    known = None if str(model) == "none" else read_model(model)
    print(f"{'refused %, class / class or height':<36}" + "".join(f"{k.name.lower()[:11]:>13}" for k in ALL))
    rows = []
    for j in filter(None, (judgeable(name, "batch", scratch) for name in flights)):
        e = j.elevation
        refused, looked = ~(find_land_cover(e, TerrainSettings(), known).landable >= 0.5), seen(e)
        cells = [looked & (j.label == kind) for kind in ALL]
        by = (refused, refused | ~e.trusted)
        rows.append([[100 * b[c].mean() if c.sum() >= LEAST else np.nan for b in by] for c in cells])
        _show(j.name[-36:], np.array(rows[-1]))
    _show("mean of the flights", np.nanmean(rows, axis=0))


def _show(name: str, row: F64) -> None:
    print(f"{name:<36}" + "".join(f"{a:7.1f}/{b:5.1f}" for a, b in row), flush=True)


def library(data: Path) -> None:
    """Print the confusion on the library with each site left out, and on other scenes at two assumed pixel sizes."""
    for line in lines_of(elsewhere(read_library(data / "terrain-library"))):
        print(line)
    scenes = data / "drone-scenes"
    for sampling in (0.025, 0.05) if is_labelled(scenes) else ():
        print(f"\ndrone-scenes at {sampling} m a pixel, blocks")
        for line in lines_of(judge_pixels(read_model(), read_labelled(scenes), sampling)):
            print(line)


def main() -> None:
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="measure", choices=["measure", "library"])
    parser.add_argument("flights", nargs="*", default=[])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    parser.add_argument("--model", type=Path, default=None, help="another model; 'none': without")
    arguments = parser.parse_args()
    if arguments.part == "library":
        library(arguments.data)
    else:
        sample = [str(arguments.data / "sample")] if (arguments.data / "sample").is_dir() else []
        measure(arguments.flights or [*FRESH, *sample], arguments.scratch, arguments.model)


if __name__ == "__main__":
    main()
