"""Read zones from GeoJSON (RFC 7946): the user's own, by the property `alight`, and features of OpenStreetMap."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyproj
import shapely

from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_text
from alight.records import GroundZone, InputError, Zones
from alight.records.zones import USES
from alight.sources.map_features import map_feature

MEND = "save it as GeoJSON in WGS84 (EPSG:4326)"
AREAS = ("Polygon", "MultiPolygon")


class _ZoneError(ValueError):
    """A file or a zone that cannot be used; the message gives the reason and the remedy."""


class _Read(NamedTuple):
    """A zone as it is read: its shape, in the file's coordinates, is not checked yet."""

    number: int  # of the feature, from 1
    name: str
    zone: GroundZone
    is_own: bool  # whether the user drew it as a zone, else it is of a map

    @property
    def label(self) -> str:
        """The polygon in words, for messages."""
        return _label(self.number, self.name)


def _label(number: int, name: str) -> str:
    return f"polygon {json.dumps(name[:60], ensure_ascii=False)} (feature {number})" if name else f"polygon {number}"


def read_zones(path: Path) -> Zones:
    """Read a file of zones.

    Raises:
        InputError: the file is no GeoJSON, or a zone in it cannot be used; the message names the zone.
    """
    try:
        tree = parse_json(read_text(path, LARGEST_JSON))
    except OSError as e:
        raise InputError(f"{path}: cannot be read ({e.strerror}); name a GeoJSON file of zones") from e
    except DocumentError as e:
        raise InputError(f"{path}: {e}; name a GeoJSON file of zones") from e
    try:
        features = _features(tree)
        with np.errstate(invalid="ignore"):  # NaN is found later
            read = [zone for number, f in enumerate(features, 1) if (zone := _zone(f, number)) is not None]
        if not read:
            raise _ZoneError(f"holds no zone; give each polygon the property alight: {', '.join(USES)}")
        zones = tuple(replace(r.zone, shape=s) for r, s in zip(read, _checked(read, _to_degrees(tree)), strict=True))
    except _ZoneError as e:
        raise InputError(f"{path}: {e}") from e
    others = len(features) - len(read)
    return Zones(path.name, zones, f"; {others} other features are left out" if others else "")


def _features(tree: Any) -> list[dict[str, Any]]:
    """Return the features of a FeatureCollection, or a single one."""
    kind = tree.get("type") if isinstance(tree, dict) else None
    found = [tree] if kind == "Feature" else tree.get("features") if kind == "FeatureCollection" else None
    if not isinstance(found, list):
        what = f"a {kind}" if isinstance(kind, str) else "no GeoJSON"
        raise _ZoneError(f"is {what}; it needs a FeatureCollection whose polygons have the property alight")
    for number, feature in enumerate(found, 1):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise _ZoneError(f"feature {number} is no Feature of GeoJSON; {MEND}")
    return found


def _to_degrees(tree: Any) -> pyproj.Transformer | None:
    """Return the way from the coordinate system of the member `crs` to WGS84; None: it is WGS84."""
    crs = tree.get("crs")
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if crs is None or "CRS84" in str(name):
        return None
    try:
        return pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(name), "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError as e:
        raise _ZoneError(f"its coordinate system {json.dumps(name or crs)[:60]} is not known; {MEND}") from e


def _zone(feature: Mapping[str, Any], number: int) -> _Read | None:
    """Return the zone of a feature; None: it is none.

    Raises:
        _ZoneError: the zone cannot be used; the message names it.
    """
    properties, geometry = feature.get("properties"), feature.get("geometry")
    own = {str(k).strip().lower(): v for k, v in (properties if isinstance(properties, dict) else {}).items()}
    names = (*(own.get(key) for key in ("name", "id", "@id", "osm_id")), feature.get("id"))
    name = next((str(n) for n in names if isinstance(n, str | int | float) and not isinstance(n, bool) and n != ""), "")
    use, mapped = own.get("alight") or None, None
    try:
        if use is not None:
            if use not in USES:
                raise _ZoneError(f"alight: {json.dumps(use, ensure_ascii=False)[:60]}: needs one of {', '.join(USES)}")
            margin, floor = (_metres(own, key) for key in ("margin_m", "floor_m"))
            if use != "keep-out" and floor:
                raise _ZoneError(f"floor_m is for keep-out, and it is {use}; leave it out")
            reason = "" if own.get("reason") is None else str(own["reason"])
            zone = GroundZone(name or str(number), use, _shape(geometry, AREAS), 0.0, margin, floor, reason)
            return _Read(number, name, zone, True)
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        mapped = None if kind in (None, "Point", "MultiPoint", "GeometryCollection") else map_feature(own)
        if mapped is None:
            return None
        shape = _shape(geometry, ("LineString", "MultiLineString", *AREAS), mapped.is_area)
        zone = GroundZone(mapped.name, mapped.use, shape, mapped.reach, 0.0, mapped.floor, kind=mapped.kind)
        return _Read(number, name, zone, False)
    except _ZoneError as e:
        raise _ZoneError(f"{_label(number, name)}: {e}") from e


def _metres(own: Mapping[str, Any], key: str) -> float:
    value = own.get(key) or 0.0
    try:
        metres = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        metres = math.nan
    if not 0.0 <= metres <= 10_000.0:
        raise _ZoneError(f"{key}: {json.dumps(value, ensure_ascii=False)[:60]}: needs metres from 0 to 10000")
    return metres


def _shape(geometry: Any, kinds: Sequence[str], is_area: bool = True) -> shapely.Geometry:
    """Return a geometry of one of `kinds`; a closed line is a polygon if `is_area`.

    Raises:
        _ZoneError: the geometry is of another type, empty or no geometry.
    """
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind not in kinds:
        raise _ZoneError(f"it has {'no geometry' if kind is None else f'the geometry {kind}'}; draw a Polygon")
    given = geometry.get("coordinates")
    try:
        if kind == "LineString":
            parts = [_part([given], is_area and given[0] == given[-1])]
        elif kind == "MultiLineString":
            parts = [_part([line], is_area and line[0] == line[-1]) for line in given]
        else:
            parts = [_part(rings, True) for rings in ([given] if kind == "Polygon" else given)]
        return parts[0] if len(parts) == 1 else shapely.GeometryCollection(parts) if parts else _part([], True)
    except (TypeError, ValueError, KeyError, IndexError, shapely.errors.GEOSException) as e:
        raise _ZoneError("it is empty, or its coordinates are not those of such a geometry; draw it again") from e


def _part(lines: Any, filled: bool) -> shapely.Geometry:
    return shapely.Polygon(lines[0], lines[1:]) if filled else shapely.LineString(lines[0])


# -- all shapes together, as there may be many


def _checked(read: Sequence[_Read], to_degrees: pyproj.Transformer | None) -> Sequence[shapely.Geometry]:
    """Return the shapes in degrees. Those of a map that cross themselves are mended; parts that touch are joined.

    Raises:
        _ZoneError: a zone lies nowhere on Earth, or crosses itself or has no area; the message names the first one.
    """
    parts, of = shapely.get_parts(shapely.force_2d([r.zone.shape for r in read]), return_index=True)
    if to_degrees is not None:
        parts = shapely.transform(parts, lambda points: np.stack(to_degrees.transform(*points.T), axis=1))
    points, part = shapely.get_coordinates(parts, return_index=True)
    off = ~(np.abs(points) <= (360.0, 90.0)).all(axis=1)
    if off.any():
        x, y = points[off][0]
        reverse = ", but the reverse" if abs(x) <= 90.0 and abs(y) <= 360.0 else ""
        label = read[of[part[off][0]]].label
        raise _ZoneError(f"{label}: {x:.10g} {y:.10g} is no longitude and latitude{reverse}; {MEND}")
    first = points[np.searchsorted(of[part], of[part]), 0]  # of the same zone
    points[:, 0] -= 360.0 * np.round((points[:, 0] - first) / 360.0)  # drawn across the date line
    parts = shapely.set_coordinates(parts, points)
    bad = ~shapely.is_valid(parts) | ((shapely.get_dimensions(parts) == 2) & ~(shapely.area(parts) > 0.0))
    for k in np.flatnonzero(bad):
        if read[of[k]].is_own:
            crosses = shapely.is_valid_reason(parts[k]).replace("[", " at ").rstrip("]")
            why = "it has no area" if shapely.is_valid(parts[k]) else crosses
            raise _ZoneError(f"{read[of[k]].label}: it is no polygon: {why}; draw it again")
    parts[bad] = shapely.make_valid(parts[bad])
    begins = [*np.searchsorted(of, np.arange(len(read))), len(of)]
    return [parts[a] if b == a + 1 else shapely.union_all(parts[a:b]) for a, b in pairwise(begins)]
