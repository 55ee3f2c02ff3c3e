"""The rasters of a run as cloud-optimised GeoTIFF: one grid, one CRS, named bands, and colours for classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.io import MemoryFile

from alight.arrays import F32
from alight.geometry import LOCAL_WKT, Grid, LocalFrame, ellipsoid_fall
from alight.records import REFUSED, Datum, ElevationMap, Flag, Hazard, HazardMap, Terrain, TerrainMap
from alight.report.paint import FLAGS, HAZARDS, TERRAIN_COLOURS, Reason, rgb

SAFE_BANDS = ("p_safe", "p_relief", "p_obstacle", "p_ground", "resolved")


@dataclass(frozen=True, eq=False)
class RasterFile:
    """Content of one GeoTIFF."""

    grid: Grid
    bands: NDArray[Any]  # (B, R, C)
    names: Sequence[str]  # one per band
    units: Sequence[str] = ()  # one per band; empty: no band has a unit
    nodata: float | None = None
    tags: Mapping[str, str] = field(default_factory=dict)  # of the first band
    file_tags: Mapping[str, str] = field(default_factory=dict)  # of the whole file
    colours: Mapping[int, tuple[int, int, int, int]] | None = None
    resampling: str = "AVERAGE"  # GDAL's method for the overviews
    mask: NDArray[np.bool_] | None = None  # (R, C): False = transparent


def raster_crs(local: LocalFrame, georeferenced: bool) -> CRS:
    """Return the CRS of the rasters: transverse Mercator about the origin, or a local one if not georeferenced."""
    return CRS.from_string(local.crs) if georeferenced else CRS.from_wkt(LOCAL_WKT)


def ellipsoidal_height(elevation: ElevationMap, local: LocalFrame) -> F32:
    """Return heights above the WGS84 ellipsoid, (R, C) metres, NaN where a flag refuses the height.

    World up is measured from the tangent plane, and the ellipsoid curves away below it. The inverse is `world_up`.
    """
    height = local.height + elevation.height + ellipsoid_fall(elevation.grid)
    return np.where(elevation.trusted, height, np.nan).astype(np.float32)


def dem_raster(elevation: ElevationMap, local: LocalFrame, georeferenced: bool) -> RasterFile:
    """Return the bands height and sigma of dem.tif, NaN where a flag refuses the height.

    Args:
        georeferenced: whether the world has a place on Earth; if not, heights are relative to its origin.
    """
    sigma = np.where(elevation.trusted, elevation.relative_sigma, np.nan).astype(np.float32)
    bands = np.stack([ellipsoidal_height(elevation, local), sigma])
    tags = {
        "height_reference": "WGS84 ellipsoid" if georeferenced else "the recording's origin",
        "refused_flags": ",".join(f.name.lower() for f in Flag if f in REFUSED and f.name),
    }
    common = common_tags(elevation.datum)
    if (covariance := elevation.place_covariance) is not None:
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        common["POSITION_SIGMA_M"] = ",".join(f"{v:.4f}" for v in sigmas)  # east, north, up
    return RasterFile(elevation.grid, bands, ("height", "sigma"), ("m", "m"), np.nan, tags, common)


def common_tags(datum: Datum | None) -> dict[str, str]:
    """Return tags for the common error of all cells: its centre, sigmas of offset and tilt there, and covariance.

    They are empty if the poses have no covariance.
    """
    if datum is None:
        return {}
    offset, east, north = np.sqrt(np.diag(datum.covariance))
    return {
        "COMMON_OFFSET_SIGMA_M": f"{offset:.4f}",
        "COMMON_TILT_SIGMA_RAD": f"{east:.6f},{north:.6f}",
        "COMMON_CENTRE_M": f"{datum.east:.3f},{datum.north:.3f}",
        "COMMON_COVARIANCE": ",".join(f"{v:.6g}" for v in datum.covariance.ravel()),
    }


def _bits(reasons: Mapping[Flag, Reason] | Mapping[Hazard, Reason]) -> dict[str, str]:
    return {f"bit_{f.value.bit_length() - 1}": f"{(f.name or '').lower()}: {why.text}" for f, why in reasons.items()}


def flags_raster(elevation: ElevationMap) -> RasterFile:
    """Return the flags of each height as bits: the reasons why it is missing or doubtful."""
    return RasterFile(elevation.grid, elevation.flags[None], ("flags",), tags=_bits(FLAGS), resampling="NEAREST")


def terrain_raster(terrain: TerrainMap) -> RasterFile:
    """Return the class codes as a raster with the names and colours of the classes."""
    tags = {f"class_{t.value}": t.name.lower() for t in Terrain}
    colours = {t.value: (*rgb(colour), 255) for t, colour in TERRAIN_COLOURS.items()} | {0: (0, 0, 0, 0)}
    bands, names = terrain.label[None], ("terrain class",)
    return RasterFile(terrain.grid, bands, names, nodata=0, tags=tags, colours=colours, resampling="MODE")


def measures_raster(hazards: HazardMap, names: Sequence[str], units: Sequence[str]) -> RasterFile:
    """Return hazard measures as bands: `names` are fields of the hazard map, and `units` their units."""
    bands = np.stack([getattr(hazards, name) for name in names]).astype(np.float32)
    return RasterFile(hazards.grid, bands, names, units, np.nan)


def safe_raster(hazards: HazardMap) -> RasterFile:
    """Return bands of P(safe) at the worst heading, its factors, and the smallest detectable obstacle's height."""
    return measures_raster(hazards, SAFE_BANDS, ("", "", "", "", "m"))


def reasons_raster(hazards: HazardMap) -> RasterFile:
    """Return the reasons why a touchdown is refused or doubtful, as bits."""
    return RasterFile(hazards.grid, hazards.reasons[None], ("reasons",), tags=_bits(HAZARDS), resampling="NEAREST")


def ortho_raster(elevation: ElevationMap) -> RasterFile:
    """Return the orthophoto, transparent where no view saw the ground."""
    bands = np.moveaxis(elevation.rgb, 2, 0)
    return RasterFile(elevation.grid, bands, ("red", "green", "blue"), mask=elevation.views > 0)


def profile_of(raster: RasterFile, crs: CRS) -> dict[str, Any]:
    """Return the options of rasterio for a deflated GeoTIFF, compressed on all cores."""
    count, rows, cols = raster.bands.shape
    return {
        "width": cols,
        "height": rows,
        "count": count,
        "dtype": raster.bands.dtype.name,
        "crs": crs,
        "transform": rasterio.Affine(*raster.grid.transform),
        "nodata": raster.nodata,
        "compress": "DEFLATE",
        "num_threads": "ALL_CPUS",
    }


def describe_bands(dataset: Any, raster: RasterFile) -> None:
    """Write names, units, tags and colours of the bands into an open file."""
    dataset.descriptions = tuple(raster.names)
    dataset.units = tuple(raster.units or [""] * len(raster.bands))
    dataset.update_tags(1, **raster.tags)
    dataset.update_tags(**raster.file_tags)
    if raster.colours is not None:
        dataset.write_colormap(1, raster.colours)


def encode(raster: RasterFile, crs: CRS) -> bytes:
    """Return the bytes of a cloud-optimised GeoTIFF: tiled, deflated, with overviews."""
    options = {"driver": "COG", "level": 1, "predictor": "YES", "blocksize": 256}
    with MemoryFile() as memory:
        with memory.open(**profile_of(raster, crs), **options, overview_resampling=raster.resampling) as dataset:
            dataset.write(raster.bands)
            describe_bands(dataset, raster)
            if raster.mask is not None:
                dataset.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
                dataset.write_mask(raster.mask)
        return bytes(memory.read())
