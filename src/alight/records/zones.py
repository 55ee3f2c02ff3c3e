"""Zones that a user gives: where not to land, where only, where preferably, and where to look."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
import shapely

from alight.arrays import F64
from alight.geometry import LocalFrame
from alight.geometry.zones import Zone, united
from alight.records.errors import InputError

Use = Literal["keep-out", "avoid", "landing", "search", "prefer"]
ZoneKind = Literal["zone", "road", "car", "person", "building"]
USES: tuple[Use, ...] = get_args(Use)
FOUND: tuple[ZoneKind, ...] = get_args(ZoneKind)[1:]  # what a map shows, too; each has a place of its own in the answer
ONLY: tuple[Use, ...] = ("landing", "search")  # they refuse what lies outside them, so that even a far one counts


@dataclass(frozen=True, eq=False)
class GroundZone:
    """A part of the ground with its use: all points at most `reach` metres from a shape."""

    name: str  # empty: it was found on the map
    use: Use
    shape: shapely.Geometry  # valid; longitude and latitude in degrees, in `ZonesOnPlane` east and north in metres
    reach: float = 0.0  # metres, half the width of a road
    margin: float = 0.0  # metres that the vehicle's disc keeps from the zone's border
    floor: float = 0.0  # metres above the ground, below which a keep-out zone is not crossed
    reason: str = ""
    kind: ZoneKind = "zone"

    @property
    def label(self) -> str:
        """Use, name and reason in words, or the kind of what was found on the map."""
        return f"{self.use} zone {self.name}{f' ({self.reason})' if self.reason else ''}" if self.name else self.kind


@dataclass(frozen=True, eq=False)
class ZonesOnPlane:
    """Zones in a plane, metres east and north; those far from it are left out."""

    zones: tuple[GroundZone, ...]
    note: str = ""  # the file and its zones, in words
    warnings: tuple[str, ...] = ()

    def of(self, *uses: Use) -> list[GroundZone]:
        """Return the zones of the given uses."""
        return [z for z in self.zones if z.use in uses]

    def limits(self, above: float, start: F64) -> list[Zone]:
        """Return the zones that limit a flight `above` metres above the ground that began at `start`, (2,) metres.

        A flight that begins in a search zone stays in the search zones. Minus infinity is a touchdown: it is outside
        every keep-out zone, and inside a search zone if there is any.
        """
        lands = math.isinf(above)
        shut = [z for z in self.of("keep-out") if lands or z.floor > above]
        out = [Zone(z.label, z.shape, False, z.reach + z.margin) for z in shut]
        within = [Zone(z.label, z.shape.buffer(-z.margin), True, z.reach) for z in self.of("search")]
        if within and (lands or any(z.depth(start[None])[0] > 0.0 for z in within)):
            out.append(united(" or ".join(z.name for z in within), within))
        return out

    def around(self, at: F64, metres: float) -> ZonesOnPlane:
        """Return the zones within a square of `metres` to each side of `at`, (2,) metres, cut at twice the distance."""
        square, wide = (shapely.box(*(at - d), *(at + d)) for d in (metres, 2.0 * metres))
        near = [z for z in self.zones if z.use in ONLY or shapely.distance(z.shape, square) <= z.reach + z.margin]
        return ZonesOnPlane(tuple(replace(z, shape=cut(z.shape, wide)) for z in near))


NO_ZONES = ZonesOnPlane(())


def cut(shape: Any, frame: shapely.Geometry) -> Any:
    """Return the parts of a shape, or of an array of shapes, within a frame; polygons stay polygons."""
    parts = shapely.intersection(shape, frame)
    return np.where(shapely.get_dimensions(shape) == 2, shapely.buffer(parts, 0.0), parts)[()]


@dataclass(frozen=True, eq=False)
class Zones:
    """The zones of a file, in degrees."""

    file: str
    zones: tuple[GroundZone, ...]
    left_out: str = ""  # what the file has besides zones, in words

    @property
    def note(self) -> str:
        """The file and the number of its zones, in words."""
        counts = Counter(z.use for z in self.zones)
        return f"{self.file}: {', '.join(f'{counts[use]} {use}' for use in USES if counts[use])}{self.left_out}"

    def in_world(self, local: LocalFrame) -> ZonesOnPlane:
        """Return the zones in the world of `local`; see `on_plane`."""

        def plane(lon_lat: F64) -> F64:
            return local.to_enu(lon_lat[:, 1], lon_lat[:, 0], local.height)[:, :2]

        return self.on_plane(plane, local.longitude, local.latitude)

    def on_plane(self, plane: Callable[[F64], F64], longitude: float, latitude: float) -> ZonesOnPlane:
        """Return the zones within half a degree of a position, in metres.

        An edge is straight in degrees, as RFC 7946 has it.

        Args:
            plane: converts longitude and latitude, (N, 2) degrees, to east and north, (N, 2) metres.

        Raises:
            InputError: no zone lies there, but one would with latitude and longitude exchanged.
        """
        here = np.array([longitude, latitude])
        half = np.array([0.5 / max(math.cos(math.radians(latitude)), 0.01), 0.5])
        frame = shapely.box(*-half, *half)

        def about_here(shapes: Any) -> Any:
            """Return the parts of shapes in the frame, in degrees from here; the date line is no border."""
            points, counts = shapely.get_coordinates(shapes) - here, shapely.get_num_coordinates(shapes)
            west, _, east, _ = shapely.bounds(shapes).T
            points[:, 0] -= np.repeat(np.round((west + east - 2.0 * longitude) / 720.0) * 360.0, counts)
            shapes = shapely.set_coordinates(shapes.copy(), points)
            partly = ~shapely.contains_properly(frame, shapes)
            shapes[partly] = cut(shapes[partly], frame)
            return shapes

        given = np.array([z.shape for z in self.zones], dtype=object)
        shapes = about_here(given)
        if shapely.is_empty(shapes).all():
            exchanged = about_here(shapely.transform(given, lambda lon_lat: lon_lat[:, ::-1]))
            if not shapely.is_empty(exchanged).all():
                name = self.zones[int(np.argmin(shapely.is_empty(exchanged)))].label
                raise InputError(f"{self.file}: {name}: latitude stands before longitude; GeoJSON has longitude first")
        fine = shapely.segmentize(shapes, 0.005)  # an edge of 500 m lies within 5 mm of the straight one
        moved = shapely.transform(fine, lambda lon_lat: plane(lon_lat + here))
        kept = tuple(
            replace(z, shape=s) for z, s in zip(self.zones, moved, strict=True) if z.use in ONLY or not s.is_empty
        )
        far = (f"zones: {self.file}: no zone lies within 50 km of here",) if shapely.is_empty(moved).all() else ()
        return ZonesOnPlane(kept, self.note, far)
