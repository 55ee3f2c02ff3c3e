"""Flights with truth, and their maps, made by the default pipeline and kept for all that judge them or fit to them.

Flying and matching are most of the work, and neither depends on the judgement: a map is made once and judged often.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from ladder import rung
from numpy.typing import NDArray

import alight
import alight_sim
from alight.arrays import F64, U8
from alight.documents import parse_yaml, read_text
from alight.elevation import FIELDS
from alight.evaluation.flight import FlightTruth, read_flight_truth
from alight.geometry import Grid
from alight.parallax.wires.find import find_wires
from alight.pipeline import Pipeline, PipelineOptions
from alight.pipeline.judging import as_judged, find_land_cover
from alight.records import Datum, ElevationMap, Flag, Motion, TerrainMap, Wire
from alight.runner.opening import open_source
from alight.settings import Settings, load_settings
from alight.sources import Source
from alight.sources.appearance import read_model
from alight.terrain.classify import Tables
from alight_sim import SimulatedFlight

Bool = NDArray[np.bool_]
How = Literal["batch", "recursive", "batch-true", "recursive-true"]
HOWS: tuple[How, ...] = ("batch", "recursive")
FLIGHT_SETS = parse_yaml(read_text(Path(__file__).with_name("flight_sets.yaml")))
TUNING, FRESH = tuple(FLIGHT_SETS["tuning"]), tuple(FLIGHT_SETS["fresh"])
MAKERS = ("elevation", "geometry", "motion", "parallax", "pipeline", "raster", "settings", "sources", "tracks")


@dataclass(frozen=True, eq=False)
class Judgeable:
    """One map, and the true ground, moved by the map's position error."""

    name: str
    elevation: ElevationMap
    truth: FlightTruth  # on its own grid, less the path's mean error
    wires: tuple[Wire, ...] = ()  # as the judging lane finds them

    @cached_property
    def label(self) -> U8:
        """(R, C) true class of every cell of the map."""
        return self.of(self.truth.label)

    def of(self, label: U8) -> U8:
        """(R, C): codes on the truth's grid at every cell of the map."""
        return np.asarray(self._at(label), np.uint8)

    @cached_property
    def known(self) -> Bool:
        """(R, C): the true height is known."""
        return np.isfinite(self._at(self.truth.dem))

    @cached_property
    def seen(self) -> Bool:
        """(R, C): a camera saw the ground, and its true height is known."""
        return self.known & ((self.elevation.flags & np.uint16(Flag.UNSEEN)) == 0)

    def _at(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        return self.truth.grid.nearest_on(self.elevation.grid, values)


def write_map(path: Path, e: ElevationMap, truth: FlightTruth, wires: Sequence[Wire] = (), **more: object) -> None:
    """Keep a map beside its truth, and `more` arrays or numbers with it."""
    datum = e.datum or Datum(0.0, 0.0, np.zeros((3, 3)))
    np.savez_compressed(
        path,
        grid=_numbers(e.grid), datum=np.concatenate([[datum.east, datum.north], datum.covariance.ravel()]),
        fine=e.fine, fine_sampling=e.fine_sampling, truth_grid=_numbers(truth.grid),
        dem=truth.dem, label=truth.label, wires=np.array([[*w.start, *w.end, w.chance] for w in wires]).reshape(-1, 7),
        **{k: getattr(e, k) for k in FIELDS}, **more,
    )  # fmt: skip


def _numbers(grid: Grid) -> F64:
    return np.array([grid.east, grid.north, grid.cell, *grid.shape])


def _grid(g: F64) -> Grid:
    return Grid(float(g[0]), float(g[1]), float(g[2]), int(g[3]), int(g[4]))


def read_map(path: Path, name: str) -> Judgeable:
    """Read a map that `write_map` kept."""
    with np.load(path) as z:
        g = z["datum"]
        datum = Datum(float(g[0]), float(g[1]), g[2:].reshape(3, 3)) if g.any() else None
        fields = {k: z[k] for k in (*FIELDS, "fine", "fine_sampling")}
        e = ElevationMap(_grid(z["grid"]), **fields, datum=datum)
        wires = tuple(Wire(w[:3], w[3:6], float(w[6])) for w in z["wires"])
        return Judgeable(name, e, FlightTruth(z["dem"], z["label"], _grid(z["truth_grid"])), wires)


def _lane(source: Source | SimulatedFlight, how: How) -> Pipeline:
    settings = load_settings("", [f"parallax.method={how.split('-')[0]}"])
    poses = source.truth_trajectory if how.endswith("true") else None
    return Pipeline(source.rig, source.kind, settings, PipelineOptions(poses, imu=source.imu_noise))


def _drift(motions: list[Motion], source: Source | SimulatedFlight) -> F64:
    """Mean of the path's error, (3,) metres."""
    assert source.truth_trajectory is not None
    true = {int(t): p.translation for t, p in zip(*source.truth_trajectory, strict=True)}
    off = [m.world_from_body.translation - true[m.t_ns] for m in motions if m.t_ns in true]
    return np.mean(off, axis=0) if off else np.zeros(3)


@dataclass(frozen=True, eq=False)
class Finished:
    """The refined motions of a flight that has ended, and in the world its map and wires as they are judged."""

    motions: tuple[Motion, ...]
    elevation: ElevationMap | None  # None: there is no map
    wires: tuple[Wire, ...] = ()


def finished(lane: Pipeline, settings: Settings) -> Finished:
    """End a flight, and map it."""
    trajectory = lane._navigation.finish(lambda _: None)
    seen = lane._mapping.finish(trajectory, lambda _: None).snapshot if trajectory.usable else None
    if seen is None:
        return Finished(trajectory.motions, None)
    elevation = as_judged(seen, settings.lander)
    wires = tuple(w.moved(seen.frame.offset_world) for w in find_wires(seen.views, elevation))
    return Finished(trajectory.motions, seen.frame.elevation(elevation), wires)


def shifted(truth: FlightTruth, off: F64) -> FlightTruth:
    """The true ground moved by (3,) metres, the mean error of a path."""
    grid = replace(truth.grid, east=truth.grid.east + off[0], north=truth.grid.north + off[1])
    return FlightTruth((truth.dem + off[2]).astype(np.float32), truth.label, grid)


def _make(name: str, hows: tuple[How, ...], paths: dict[How, Path]) -> None:
    """Draw a flight once and feed it to every way of mapping."""
    source = open_source(Path(name), load_settings("")) if Path(name).is_dir() else rung(name).fly()
    lanes = {how: _lane(source, how) for how in hows}
    for event in source.events():
        for lane in lanes.values():
            lane.feed(event)
    true = read_flight_truth(Path(name)) if Path(name).is_dir() else None
    if true is None:
        assert isinstance(source, SimulatedFlight)
        true = FlightTruth(source.truth.height, source.truth.label, source.truth.grid)
    for how, lane in lanes.items():
        found = finished(lane, Settings())
        if found.elevation is None:
            print(f"{name}, {how}: no map", flush=True)
            continue
        write_map(paths[how], found.elevation, shifted(true, _drift(list(found.motions), source)), found.wires)


@cache
def _made_by() -> str:
    """Digest of the code that makes a map, the simulator included."""
    product = Path(alight.__file__).parent
    files = [f for f in sorted(product.rglob("*.py")) if f.relative_to(product).parts[0].partition(".")[0] in MAKERS]
    files += sorted(Path(alight_sim.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:12]


def judgeable(name: str, how: How, scratch: Path, hows: tuple[How, ...] = HOWS) -> Judgeable | None:
    """The map of a rung of the ladder or of a folder with truth; None where no height could be measured.

    Maps of other code are not used: each state of the code that makes them has a folder of its own in `scratch`.
    """
    scratch = scratch / _made_by()
    scratch.mkdir(parents=True, exist_ok=True)
    stem = name.strip("/").replace("/", "_").replace("..", "")
    paths = {h: scratch / f"{stem}-{h}.npz" for h in {*hows, how}}
    if not paths[how].exists():
        wanted = tuple(h for h, p in paths.items() if not p.exists())
        _make(name, wanted, paths)
    return read_map(paths[how], f"{name}, {how}") if paths[how].exists() else None


def cover_of(j: Judgeable, tables: Tables | None = None) -> TerrainMap:
    """Land cover by the tables of the package, or by other tables."""
    return find_land_cover(j.elevation, Settings().stages().terrain, read_model(), tables)
