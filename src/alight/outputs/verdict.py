"""The folder of `alight hazards`: the judgement of a height raster, on the raster's own grid and coordinates."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rasterio.crs import CRS
from rasterio.warp import transform

from alight import __version__
from alight.geometry import LOCAL_WKT
from alight.outputs import rasters, vectors
from alight.outputs.folder import NO_PLACE, Contents, report_file, write_folder
from alight.raster import unreadable
from alight.records import ElevationMap, Hazard, HazardMap, RunResult, Sites, Tally
from alight.sources.raster_plane import RasterPlane

log = logging.getLogger(__name__)

MEASURES = ("slope", "roughness", "step", "clearance", "quality")  # bands of hazards.tif


def _heights(e: ElevationMap) -> rasters.RasterFile:
    known = e.trusted
    bands = np.stack([np.where(known, a, np.float32(np.nan)) for a in (e.height, e.sigma)])
    return rasters.RasterFile(e.grid, bands, ("height", "sigma"), ("m", "m"), np.nan)


def _places(sites: Sites, plane: RasterPlane | None) -> list[list[float]] | None:
    """Return longitude, latitude (degrees) and height (m) of each listed place; None if they are unknown."""
    if plane is None or not plane.reference.on_earth:
        return None
    x, y = [[plane.in_crs(s.east, s.north)[axis] for s in sites.listed] for axis in (0, 1)]
    try:
        lon, lat = transform(plane.crs, "EPSG:4326", x, y)
    except unreadable() as e:
        log.info("no place on Earth: %s", e)
        return None
    return [[round(x, 9), round(y, 9), round(s.up, 3)] for x, y, s in zip(lon, lat, sites.listed, strict=True)]


def verdict_geojson(sites: Sites, plane: RasterPlane | None) -> dict[str, Any] | None:
    """Return sites and candidates in order of rank, as GeoJSON; None if their positions on Earth are unknown."""
    places = _places(sites, plane)
    if places is None and sites.listed:
        return None
    at = zip(places or [], sites.listed, strict=True)
    return vectors.collection([vectors.feature("Point", xyz, vectors.site_properties(s)) for xyz, s in at], sites)


def _summary(result: RunResult, plane: RasterPlane | None, tally: Tally, missing: Mapping[str, str]) -> dict[str, Any]:
    shares = {(bit.name or "").lower(): round(tally.share(bit), 6) for bit in Hazard}
    return {
        "alight": __version__,
        "input": {"name": result.source_name, "kind": result.source_kind},
        "crs": plane.reference.crs.to_string() if plane and plane.reference.crs else None,
        "plane": {"x": plane.x, "y": plane.y, "metres": plane.metres} if plane else None,
        "answer": vectors.answer_json(result.sites),
        "share_safe": round(tally.safe / tally.cells, 6),
        "share_judged": round(tally.judged / tally.cells, 6),
        "share_refused": shares,
        "notes": vectors.plain(result.notes),
        "warnings": list(result.warnings),
        "not_written": dict(missing),
        "settings": result.settings.model_dump(mode="json"),
    }


def written_on(raster: rasters.RasterFile, plane: RasterPlane | None) -> tuple[rasters.RasterFile, CRS]:
    """Return a raster in the coordinates of the plane of an input, and its coordinate system."""
    if plane is None:
        return raster, CRS.from_wkt(LOCAL_WKT)
    return replace(raster, grid=plane.grid_in_crs(raster.grid)), plane.crs


def judged_rasters(hazards: HazardMap) -> dict[str, Callable[[], rasters.RasterFile]]:
    """Return by file name the functions that make the rasters of a judgement."""
    return {
        "safe.tif": partial(rasters.safe_raster, hazards),
        "reasons.tif": partial(rasters.reasons_raster, hazards),
        "hazards.tif": partial(rasters.measures_raster, hazards, MEASURES, ("rad", "m", "m", "m", "")),
    }


class MadeRasters(NamedTuple):
    """Rasters of a judgement that were written while a large raster was judged, and counts of its cells."""

    folder: Path  # of the files, which are moved
    tally: Tally


def _contents(result: RunResult, plane: RasterPlane | None, sharpened: bool, made: MadeRasters | None) -> Contents:
    """Return every file but run.json, in the order of writing, or why it is not written; see `write_judgement`."""
    hazards, elevation = result.hazards_as_mapped, result.elevation
    assert hazards is not None
    assert elevation is not None
    sites = verdict_geojson(result.sites, plane)

    def tif(make: Callable[[], rasters.RasterFile]) -> Callable[[], bytes]:
        return lambda: rasters.encode(*written_on(make(), plane))

    files: Contents = {
        n: tif(make) if made is None else partial(made.folder.joinpath, n)
        for n, make in judged_rasters(hazards).items()
    }
    files |= {
        "heights.tif": tif(partial(_heights, elevation)) if sharpened else "no image made the heights finer",
        **({} if result.terrain is None else {"terrain.tif": tif(partial(rasters.terrain_raster, result.terrain))}),
        "sites.geojson": NO_PLACE if sites is None else lambda: vectors.json_bytes(sites),
    }
    return files | report_file(result, files)


def write_judgement(
    result: RunResult,
    out: Path,
    overwrite: bool,
    plane: RasterPlane | None,
    sharpened: bool,
    inputs: Sequence[Path] = (),
    made: MadeRasters | None = None,
) -> list[Path]:
    """Write safe.tif, hazards.tif, reasons.tif, sites.geojson, report.html and run.json; return the paths written.

    Args:
        result: the judgement.
        out, overwrite, inputs: see `folder.write_folder`, also for errors.
        plane: coordinates of the input raster; None: local ones.
        sharpened: whether an image made the heights finer, so that `heights.tif` is added.
        made: rasters of all cells, if the result has only some of them; None: they are made from the result.
    """
    contents = _contents(result, plane, sharpened, made)
    hazards = result.hazards_as_mapped
    assert hazards is not None
    tally = Tally.of(hazards) if made is None else made.tally
    return write_folder(contents, lambda missing: _summary(result, plane, tally, missing), out, overwrite, inputs)
