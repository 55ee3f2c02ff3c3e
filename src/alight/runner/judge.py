"""Judgement of heights from another source: sharpen them with an image, assess hazards, choose sites."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

import numpy as np

from alight.elevation import on_cells_up_to
from alight.geometry import LocalFrame
from alight.hazards import assess
from alight.hazards.sharpen import sharpen
from alight.landing.sites import choose_sites
from alight.landing.third_party import third_parties
from alight.landing.zones import MapZones
from alight.outputs.verdict import write_judgement
from alight.pipeline.judging import find_land_cover
from alight.records import NO_ZONES, ElevationMap, GroundZone, InputError, RunResult, TerrainMap, ZonesOnPlane
from alight.result import Result
from alight.runs import appearance_of
from alight.settings import Settings, StageSettings, load_settings
from alight.sources.raster import GroundRaster
from alight.sources.raster_plane import RasterPlane
from alight.sources.zones import read_zones
from alight.terrain.appearance import appearance

# surveyed heights show every obstacle and lie level, unless the user's settings differ
SURVEYED = ("tuning.hazards.smoothed=false", "tuning.hazards.tilt_sigma=0.003", "tuning.hazards.noise_length=0.4")
GROUND_UNSEEN = "not judged: no picture in colour (--image) shows water or plants, and P is that of the shape"
IMAGE_UNUSED = "the image is not used: light and shade do not explain it (paint, plants, another time of day)"


def for_surveyed_heights(settings: Settings) -> Settings:
    """Return the settings with constants that suit surveyed heights, where the user has not set them."""
    surveyed = load_settings("", SURVEYED).tuning.hazards
    own = settings.tuning.hazards
    suited = {k: getattr(surveyed, k) for k in surveyed.model_fields_set - own.model_fields_set}
    tuning = settings.tuning.model_copy(update={"hazards": own.model_copy(update=suited)})
    return settings.model_copy(update={"tuning": tuning})


def too_wide(cell: float, stages: StageSettings) -> list[str]:
    """Return a warning if cells of `cell` metres are too wide to show obstacles that the lander must avoid."""
    if cell <= stages.lander.judging_cell or stages.hazards.smoothed:
        return []
    return [
        f"cells of {cell:g} m do not show every obstacle of {stages.lander.tallest_obstacle:g} m: P(safe) is lowered "
        "by those that are usual on unknown ground (tuning.hazards.unseen_unknown); give cells of "
        f"{stages.lander.judging_cell:.3g} m or less"
    ]


def _land_cover(elevation: ElevationMap, settings: Settings) -> TerrainMap | None:
    """Estimate the land cover from heights and picture; None if the picture is grey or the settings disable it."""
    keys = settings.stages().terrain
    if not (keys.enabled and appearance(on_cells_up_to(elevation, keys.cell)).coloured):
        return None
    return find_land_cover(elevation, keys, appearance_of(settings))


def zones_on(plane: RasterPlane | None, file: Path | None) -> ZonesOnPlane:
    """Read the zones of a file for the plane of a raster; without a file there are none.

    Raises:
        InputError: the file cannot be used, or the raster has no place on Earth.
    """
    if file is None:
        return NO_ZONES
    zones = read_zones(file)
    if plane is None or not plane.reference.on_earth:
        raise InputError(f"--zones {file}: is for heights with a place on Earth; run it without")
    return zones.on_plane(plane.from_degrees, *plane.middle)


def judge_ground(ground: GroundRaster, settings: Settings, name: str, zones: Path | None = None) -> Result:
    """Return P(safe) and reasons of each cell of a height raster, and the landing sites of the lander.

    `name` is the name of the input, for the report; `zones` a file of zones. See `for_surveyed_heights` for suitable
    settings.
    """
    given = zones_on(ground.plane, zones)
    warnings, elevation, clock = list(ground.warnings), ground.elevation, [time.perf_counter()]
    if ground.image is not None and ground.image.shape[0] > elevation.grid.rows:
        finer = sharpen(elevation, ground.image, settings.tuning.hazards.sharpen)
        warnings += [IMAGE_UNUSED] if finer is None else []
        elevation = finer or elevation
    clock.append(time.perf_counter())
    stages = settings.stages()
    warnings += too_wide(elevation.grid.cell, stages)
    land_cover = _land_cover(elevation, settings) if ground.image is not None else None
    notes = {"heights": ground.settled} if ground.settled else {}
    notes |= {"ground": GROUND_UNSEEN} if land_cover is None else {}
    clock.append(time.perf_counter())
    others = tuple[GroundZone, ...]()
    if stages.sites.third_party:
        nobody = np.zeros(elevation.grid.shape, np.bool_)
        others = third_parties(land_cover, elevation.grid, nobody, stages.hazards.traffic_margin)
    limits = MapZones(given, stages.lander.reach, others)
    hazards = limits.judged(assess(elevation, land_cover, stages.lander, stages.hazards))
    notes |= {"zones": given.note} if given.zones else {}
    warnings += given.warnings
    clock.append(time.perf_counter())
    sites = choose_sites(hazards, land_cover, elevation, stages.sites, stages.lander)
    result = RunResult(
        source_name=name,
        source_kind="heights",
        local=LocalFrame(0.0, 0.0, 0.0),
        georeferenced=False,  # the page shows the coordinates of the raster's plane
        settings=settings,
        sites=limits.named(sites),
        zones=given,
        others=others,
        terrain=land_cover,
        elevation=elevation,
        hazards=hazards,
        notes=notes,
        warnings=warnings,
        timings=dict(zip(("sharpen", "terrain", "hazards"), [[float(s)] for s in np.diff(clock)], strict=True)),
    )
    sharpened = elevation is not ground.elevation
    return Result(result, partial(write_judgement, plane=ground.plane, sharpened=sharpened, inputs=ground.files))
