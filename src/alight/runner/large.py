"""Judgement of a large height raster in windows: with bounded memory, on all cores, and the same as of the whole."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio

from alight.arrays import F32, Mask
from alight.geometry import Grid, LocalFrame
from alight.geometry.grid import Box
from alight.hazards import assess
from alight.jobs import InTurn, Jobs, Sent, Task
from alight.landing.sites import find_sites, why_no_site
from alight.landing.zones import MapZones
from alight.outputs.tiles import TiledFile
from alight.outputs.verdict import MEASURES, MadeRasters, judged_rasters, write_judgement, written_on
from alight.records import HazardMap, InputError, RunResult, Tally
from alight.result import Result
from alight.runner.judge import GROUND_UNSEEN, too_wide, zones_on
from alight.runner.judged_parts import JudgedParts, clearance_in, farthest_of
from alight.runner.windows import SIDE, Overview, Windows, every_of
from alight.settings import Settings, StageSettings
from alight.sources.raster import GroundParts, as_map, count_cells, ground_in_parts

Progress = Callable[[str, float], None]


def is_large(path: Path) -> bool:
    """Whether a height raster is too large to be judged as a whole.

    Raises:
        InputError: see `count_cells`.
    """
    return count_cells(path) > 4 * SIDE**2


def little_memory() -> rasterio.Env:
    """Return the environment in which GDAL keeps 64 MB of tiles, instead of 5 % of the memory."""
    return rasterio.Env(GDAL_CACHEMAX=64)


def read_large(path: Path, sigma: str | None, settings: Settings) -> GroundParts:
    """Check a large height raster; see `ground_in_parts` for errors."""
    with little_memory():
        return ground_in_parts(path, sigma, settings.hazards.usual_sigma, SIDE // 4, every_of(count_cells(path)))


class JudgedWindow(NamedTuple):
    """Judgement of the cells of a window."""

    hazards: HazardMap  # the clearance is that within the cells that were judged
    seen: Mask  # (R, C) cells with a height


def judge_window(
    grid: Grid, height: F32, sigma: F32, core: Box, stages: StageSettings, limits: MapZones
) -> JudgedWindow:
    """Judge heights with their sigma, (R, C) metres, and return the cells in `core`."""
    elevation = as_map(grid, height, sigma)
    found = limits.judged(assess(elevation, None, stages.lander, stages.hazards))
    return JudgedWindow(found.part(core), elevation.trusted[core])


class LargeJudgement:
    """Judgement of a large raster.

    Args:
        ground: heights and sigma.
        settings: see `judge.for_surveyed_heights`.
        folder: for the rasters of the judgement.
        zones: file of zones; None: there are none.
        side: of a window, cells; even.
    """

    def __init__(
        self, ground: GroundParts, settings: Settings, folder: Path, zones: Path | None = None, side: int = SIDE
    ) -> None:
        self._ground, self._settings, self._folder = ground, settings, folder
        self._limits = MapZones(zones_on(ground.plane, zones), settings.lander.reach)
        self._stages = settings.stages()
        self._windows = Windows.of(ground.grid, self._stages, side)
        self._overview = Overview(ground.grid, self._windows.every)
        self.tally = Tally()  # of all cells
        self._seen = Tally()  # of those with a height
        self._labels: dict[str, int] = {}  # zones, numbered from 1

    def judge(self, name: str, jobs: Jobs, progress: Progress) -> Result:
        """Judge the windows, then choose the sites; `name` is the name of the input, for the report."""
        clock = [time.perf_counter()]
        with little_memory():
            self._write_rasters(jobs, progress)
            clock.append(time.perf_counter())
            s, w = self._stages, self._windows
            judged = JudgedParts(self._ground, w, s, self._limits, self.tally.judged, self._folder)
            sites = find_sites(judged, s.sites, s.lander)
        cell = self._ground.grid.cell
        reason = "" if sites.sites else why_no_site(self._seen, cell, s.sites, s.lander)
        sites = replace(sites, reason=reason, ground_judged=False)
        clock.append(time.perf_counter())
        limits, shown = self._limits, self._overview
        record = RunResult(
            source_name=name,
            source_kind="heights",
            local=LocalFrame(0.0, 0.0, 0.0),
            georeferenced=False,  # the page shows the coordinates of the raster's plane
            settings=self._settings,
            sites=limits.named(sites),
            zones=limits.plane,
            elevation=as_map(shown.grid, shown.fields.pop("height"), shown.fields.pop("sigma")),
            hazards=HazardMap(shown.grid, zone_labels=tuple(self._labels), **shown.fields),
            notes=self._notes(),
            warnings=self._warnings(),
            timings=dict(zip(("hazards", "sites"), [[float(s)] for s in np.diff(clock)], strict=True)),
        )
        made = MadeRasters(self._folder, self.tally)
        plane, files = self._ground.plane, self._ground.files
        writer = partial(write_judgement, plane=plane, sharpened=False, inputs=files, made=made)
        return Result(record, writer)

    def _write_rasters(self, jobs: Jobs, progress: Progress) -> None:
        """Judge all windows into the rasters of the folder; then measure the clearance, which looks farther."""
        cores, reasons = self._windows.cores, self._folder / "reasons.tif"
        later = "hazards.tif", MEASURES.index("clearance") + 1  # file and band of the clearance
        with ExitStack() as stack:
            files: dict[str, TiledFile] = {}
            for number, (core, found) in enumerate(zip(cores, jobs.run(self._tasks(), at_once=True), strict=True)):
                self._count(core, found)
                for name, make in judged_rasters(found.hazards).items():
                    raster = make()
                    if name not in files:
                        whole = written_on(replace(raster, grid=self._ground.grid), self._ground.plane)
                        files[name] = stack.enter_context(TiledFile(self._folder / name, *whole))
                    bands = [n for n in range(1, len(raster.bands) + 1) if (name, n) != later]
                    files[name].write(core, raster.bands[[n - 1 for n in bands]], bands)
                progress("judging", (number + 1) / len(cores))
            if not self._seen.cells:
                raise InputError(f"{self._ground.path}: no height has a sigma above 0; give --sigma in metres")
            files["reasons.tif"].add_overviews()
            arguments = self._windows, self._ground.grid
            tasks = (Task(str(n), clearance_in, (reasons, core, *arguments)) for n, core in enumerate(cores))
            for core, clearance in zip(cores, InTurn().run(tasks, at_once=True), strict=True):
                self._overview.add(core, {"clearance": clearance})
                self.tally, self._seen = (t.with_room(float(clearance.max())) for t in (self.tally, self._seen))
                files[later[0]].write(core, clearance[None], [later[1]])
            for name in ("safe.tif", "hazards.tif"):
                files[name].add_overviews()

    def _tasks(self) -> Iterator[Task]:
        """Yield the judgement of each window, with its heights, which are read here."""
        for core in self._windows.cores:
            box, within = self._windows.wider(core, self._windows.around)
            part = self._ground.part(box)
            self._overview.add(core, {"height": part.height[within], "sigma": part.sigma[within]})
            shared = Sent("stages", self._stages), Sent("zones", self._limits)
            arguments = part.grid, part.height, part.sigma, within, *shared
            yield Task(f"window {core[0].start} {core[1].start}", judge_window, arguments)

    def _count(self, core: Box, window: JudgedWindow) -> None:
        """Count the cells of a window and show them in the overview."""
        found = replace(window.hazards, clearance=np.zeros_like(window.hazards.clearance))  # not yet known
        self.tally += Tally.of(found)
        self._seen += Tally.of(found, window.seen)
        zone = found.zone
        if zone is not None:
            numbers = [self._labels.setdefault(label, len(self._labels) + 1) for label in found.zone_labels]
            zone = np.array([0, *numbers], np.uint16)[zone]
        self._overview.add(core, {**vars(found), "zone": zone})

    def _notes(self) -> dict[str, object]:
        grid, farthest = self._ground.grid, farthest_of(self._windows, self._ground.grid)
        about = f"{grid.cols} x {grid.rows} cells, judged in windows; the clearance is measured up to {farthest:.3g} m"
        every = self._windows.every
        about += f"; this page shows one of {every} rows and columns" if every > 1 else ""
        notes: dict[str, object] = {"heights": self._ground.settled, "ground": GROUND_UNSEEN, "raster": about}
        plane = self._limits.plane
        return notes | {"zones": plane.note} if plane.zones else notes

    def _warnings(self) -> list[str]:
        known = self._ground.known
        share = 100.0 * (known - self._seen.cells) / known
        lacking = f"no sigma above 0 in {share:.3g} % of the heights, which are taken as not measured"
        return [
            *self._ground.warnings,
            *([lacking] if share else []),
            *too_wide(self._ground.grid.cell, self._stages),
            *self._limits.plane.warnings,
        ]
