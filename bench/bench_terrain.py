"""What covers the ground: weights of the evidence, and how well the classes do on flights.

    python bench/bench_terrain.py fit                # the table of alight/terrain/weights.py, from tuning flights
    python bench/bench_terrain.py measure FLIGHT ... # refused and kept by true class; rungs, or folders with truth
    python bench/bench_terrain.py library            # the library with each site left out, and other scenes

Maps are the product's own (bench/ground_maps.py) and kept under --scratch, because making them is most of the work.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from ground_flights import TEST, TUNING
from ground_maps import judgeable
from numpy.typing import NDArray

from alight import terrain
from alight.records import F32, LANDABLE, U8, ElevationMap, Terrain
from alight.settings import TerrainSettings
from alight.sources.library import is_labelled, read_labelled, read_library, read_model
from alight.terrain.appearance import appearance, seen
from alight.terrain.classify import wetness
from alight.terrain.confusion import lines_of
from alight.terrain.evidence import terms
from alight.terrain.relief import relief
from alight.terrain.train import elsewhere, fit_head, judge_pixels

NEVER = (Terrain.TALL_VEGETATION, Terrain.TREE, Terrain.WATER)
ALL = (*NEVER, Terrain.STRUCTURE, Terrain.ROCK, *LANDABLE)
EACH = 300  # cells a class and flight that the fit uses
PENALTY = 3e-3  # of squared weights: evidence that another scene does not share
COPIES = 4  # of every flight, each as another camera and another ground might shift its evidence:
OTHERS = {
    ("texture",): 0.7,
    ("residual", "residual 2 m"): 0.4,
    ("rough 0.3 m", "rough 1 m"): 0.4,
    ("sigma",): 0.4,
    ("octave 0", "octave 1", "octave 2", "light detail"): 0.4,
    ("red detail", "blue detail"): 0.3,
}  # 1-sigma of that shift, natural logarithms
LEAST = 200  # cells of a class in a flight that count


def maps(names: Sequence[str], scratch: Path) -> Iterator[tuple[str, ElevationMap, U8]]:
    """Name, map and true class of every flight."""
    for name in names:
        found = judgeable(name, "batch", scratch)
        if found is not None:
            yield name, found.elevation, found.label


def evidence_of(e: ElevationMap) -> dict[str, F32]:
    """The terms of one map."""
    settings, look = TerrainSettings(), appearance(e)
    return terms(e, look, relief(e, wetness(e, look), settings))


def _rows(flights: list[str], scratch: Path) -> tuple[list[str], F32, U8, NDArray[np.int64]]:
    rng, parts, kinds, which = np.random.default_rng(0), [], [], []
    names: list[str] = []
    for i, (_, e, label) in enumerate(maps(flights, scratch)):
        found, known = evidence_of(e), seen(e)
        names = list(found)
        for kind in ALL:
            cells = np.flatnonzero((known & (label == kind)).ravel())
            if len(cells) >= LEAST:
                cells = rng.choice(cells, min(EACH, len(cells)), replace=False)
                parts.append(np.stack([v.ravel()[cells] for v in found.values()], axis=1))
                kinds += [int(kind)] * len(cells)
                which += [i] * len(cells)
    return names, np.concatenate(parts).astype(np.float32), np.array(kinds, np.uint8), np.array(which, np.int64)


def shifted(names: list[str], values: F32, flight: NDArray[np.int64]) -> F32:
    """The rows as if each flight had been flown elsewhere, COPIES times."""
    rng, parts = np.random.default_rng(0), []
    for _ in range(COPIES):
        copy = values.copy()
        for number in np.unique(flight):
            for group, sigma in OTHERS.items():
                columns = [names.index(n) for n in group]
                copy[np.ix_(flight == number, columns)] += np.float32(rng.normal(0, sigma))
        parts.append(copy)
    return np.concatenate(parts)


def fit(scratch: Path) -> None:
    """Print the module of weights; classes weigh the same, and within a class its flights."""
    names, values, kinds, flight = _rows(list(TUNING), scratch)
    values = shifted(names, values, flight)
    kinds, flight = np.tile(kinds, COPIES), np.tile(flight, COPIES)
    codes, at_ = np.unique(kinds, return_inverse=True)
    _, pair, count = np.unique(flight * 10 + kinds, return_inverse=True, return_counts=True)
    weight = 1 / count[pair]
    weight /= np.sqrt(np.bincount(at_, weights=weight)[at_])
    head = fit_head(values, at_.astype(np.int64), weight / weight.mean(), len(codes), PENALTY)

    print(f'"""Weights of the evidence, from {len(TUNING)} simulated tuning flights: `bench_terrain.py fit`."""\n')
    print("# term: usual value, spread, weight for each class from BARE to STRUCTURE a spread above the usual value")
    print("WEIGHTS: dict[str, tuple[float, float, tuple[float, ...]]] = {")
    for i, name in enumerate(names):
        row = tuple(round(float(v), 2) for v in head.weights[:, i])
        print(f'    "{name}": ({head.mean[i]:.3f}, {head.spread[i]:.3f}, {row}),')
    print("}\nBIAS =", tuple(round(float(v), 2) for v in head.bias))


def measure(flights: list[str], scratch: Path, model: Path | None) -> None:
    """Share of each true class that the verdict refuses, by class alone and with the heights that nobody trusts."""
    known = None if str(model) == "none" else read_model(model)
    print(f"{'refused %, class / class or height':<36}" + "".join(f"{k.name.lower()[:11]:>13}" for k in ALL))
    rows: list[list[tuple[float, float] | None]] = []
    for name, e, label in maps(flights, scratch):
        cover = terrain.classify(e, TerrainSettings(), known)
        refused, doubtful, looked = ~(cover.landable >= 0.5), ~e.trusted, seen(e)
        row: list[tuple[float, float] | None] = []
        for kind in ALL:
            here = looked & (label == kind)
            enough = here.sum() >= LEAST
            row.append((100 * refused[here].mean(), 100 * (refused | doubtful)[here].mean()) if enough else None)
        rows.append(row)
        _tell(name[-36:], row)
    means = [
        np.mean([r[k] for r in rows if r[k]], axis=0) if any(r[k] for r in rows) else None for k in range(len(ALL))
    ]
    _tell("mean of the flights", [None if m is None else (float(m[0]), float(m[1])) for m in means])


def _tell(name: str, row: list[tuple[float, float] | None]) -> None:
    print(f"{name:<36}" + "".join(f"{'':>13}" if r is None else f"{r[0]:7.1f}/{r[1]:5.1f}" for r in row), flush=True)


def library(data: Path) -> None:
    """The library with each site left out; other scenes, never trained on, at two guesses of their pixel size."""
    for line in lines_of(elsewhere(read_library(data / "terrain-library"))):
        print(line)
    scenes = data / "drone-scenes"
    for sampling in (0.025, 0.05) if is_labelled(scenes) else ():
        print(f"\ndrone-scenes at {sampling} m a pixel, blocks")
        for line in lines_of(judge_pixels(read_model(), read_labelled(scenes), sampling)):
            print(line)


def main() -> None:
    """One part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="measure", choices=["fit", "measure", "library"])
    parser.add_argument("flights", nargs="*", default=[])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    parser.add_argument("--model", type=Path, default=None, help="another model; 'none': without")
    arguments = parser.parse_args()
    if arguments.part == "fit":
        fit(arguments.scratch)
    elif arguments.part == "library":
        library(arguments.data)
    else:
        sample = [str(arguments.data / "sample")] if (arguments.data / "sample").is_dir() else []
        measure(arguments.flights or [*TEST, *sample], arguments.scratch, arguments.model)


if __name__ == "__main__":
    main()
