"""The folder of `alight hazards`: the judgement of a height raster, on the raster's own grid and coordinates."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rasterio.crs import CRS
from rasterio.warp import transform

from alight import __version__
from alight.geometry import LOCAL_WKT
from alight.outputs import rasters, vectors
from alight.outputs.folder import NO_PLACE, Contents, report_file, write_folder
from alight.raster import unreadable
from alight.records import ElevationMap, Hazard, RunResult, Sites
from alight.sources.raster_plane import RasterPlane

log = logging.getLogger(__name__)


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


def _summary(result: RunResult, plane: RasterPlane | None, missing: Mapping[str, str]) -> dict[str, Any]:
    hazards = result.hazards_as_mapped
    assert hazards is not None
    judged = np.isfinite(hazards.p_safe)
    shares = {(r.name or "").lower(): round(float(((hazards.reasons & np.uint16(r)) != 0).mean()), 6) for r in Hazard}
    return {
        "alight": __version__,
        "input": {"name": result.source_name, "kind": result.source_kind},
        "crs": plane.reference.crs.to_string() if plane and plane.reference.crs else None,
        "plane": {"x": plane.x, "y": plane.y, "metres": plane.metres} if plane else None,
        "answer": vectors.answer_json(result.sites),
        "share_safe": round(float((hazards.reasons == 0).mean()), 6),
        "share_judged": round(float(judged.mean()), 6),
        "share_refused": shares,
        "notes": vectors.plain(result.notes),
        "warnings": list(result.warnings),
        "not_written": dict(missing),
        "settings": result.settings.model_dump(mode="json"),
    }


def _contents(result: RunResult, plane: RasterPlane | None, sharpened: bool) -> Contents:
    """Return every file but run.json, in the order of writing, or why it is not written; see `write_judgement`."""
    hazards, elevation = result.hazards_as_mapped, result.elevation
    assert hazards is not None
    assert elevation is not None
    sites = verdict_geojson(result.sites, plane)

    def tif(raster: rasters.RasterFile) -> Callable[[], bytes]:
        own = raster if plane is None else replace(raster, grid=plane.grid_in_crs(raster.grid))
        return lambda: rasters.encode(own, plane.crs if plane else CRS.from_wkt(LOCAL_WKT))

    names, units = ("slope", "roughness", "step", "clearance", "quality"), ("rad", "m", "m", "m", "")
    files: Contents = {
        "safe.tif": tif(rasters.safe_raster(hazards)),
        "reasons.tif": tif(rasters.reasons_raster(hazards)),
        "hazards.tif": tif(rasters.measures_raster(hazards, names, units)),
        "heights.tif": tif(_heights(elevation)) if sharpened else "no image made the heights finer",
        **({} if result.terrain is None else {"terrain.tif": tif(rasters.terrain_raster(result.terrain))}),
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
) -> list[Path]:
    """Write safe.tif, hazards.tif, reasons.tif, sites.geojson, report.html and run.json; return the paths written.

    `heights.tif` is added if an image made the heights finer (`sharpened`). `plane`: coordinates of the input raster;
    None: local ones. See `folder.write_folder` for errors.
    """
    contents = _contents(result, plane, sharpened)
    return write_folder(contents, lambda missing: _summary(result, plane, missing), out, overwrite, inputs)
