"""Zones on the map: touchdowns that they refuse, and what lies nearest to each site."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from rasterio import Affine
from rasterio.features import rasterize

from alight.arrays import F64, U16
from alight.geometry import Grid
from alight.geometry.zones import rectangle_of
from alight.raster import clearance_of, placeless_rasters
from alight.records import Hazard, HazardMap, NearZone, Site, Sites
from alight.records.zones import FOUND, ONLY, GroundZone, Use, ZonesOnPlane, cut


class _Touchdowns(NamedTuple):
    """Touchdowns with a reason against them: their area, and the zone in words."""

    reason: Hazard
    area: shapely.Geometry
    label: str


class MapZones:
    """The zones of a run, for its maps. Maps may lie `offset`, (2,) metres, from the zones' plane.

    Args:
        zones: the zones.
        reach: radius of the vehicle's disc, metres.
        found: roads, cars, people and buildings that the map itself shows.
    """

    def __init__(self, zones: ZonesOnPlane, reach: float, found: tuple[GroundZone, ...] = ()) -> None:
        self.plane, self._reach = ZonesOnPlane((*zones.zones, *found), zones.note, zones.warnings), reach

    def judged(self, hazards: HazardMap, offset: F64 | tuple[float, float] = (0.0, 0.0)) -> HazardMap:
        """Return the hazards with the reasons of the zones; P(safe), the chance that the lander stands, stays."""
        if not self.plane.zones:
            return hazards
        grid = replace(hazards.grid, east=hazards.grid.east + offset[0], north=hazards.grid.north + offset[1])
        drawn = [t for t in self._against(rectangle_of(grid)) if not t.area.is_empty]
        zone = _drawn([t.area for t in drawn], grid)
        reasons = hazards.reasons | np.array([0, *(t.reason for t in drawn)], np.uint16)[zone]
        preferred = _drawn([z.shape for z in self.plane.of("prefer")], grid) > 0
        return replace(
            hazards, reasons=reasons, clearance=clearance_of(reasons == 0, grid.cell), zone=zone,
            zone_labels=tuple(t.label for t in drawn), preferred=preferred if preferred.any() else None,
        )  # fmt: skip

    def _against(self, frame: shapely.Geometry) -> Iterator[_Touchdowns]:
        """Yield the touchdowns of a map that zones are against; those with a stronger reason come later."""
        yield from self._in("avoid", Hazard.AVOID, frame)
        for use in ONLY:
            if zones := self.plane.of(use):
                areas = [z.shape.buffer(z.reach - z.margin - self._reach) for z in zones]
                label = f"outside {use} zone {' or '.join(z.name for z in zones)}"
                yield _Touchdowns(Hazard.ZONE, frame.difference(shapely.union_all(areas)), label)
        yield from self._in("keep-out", Hazard.ZONE, frame)

    def _in(self, use: Use, reason: Hazard, frame: shapely.Geometry) -> Iterator[_Touchdowns]:
        for z in self.plane.of(use):
            room = z.reach + z.margin + self._reach
            if shapely.distance(z.shape, frame) < room:
                yield _Touchdowns(reason, cut(z.shape, frame.buffer(2.0 * room)).buffer(room), z.label)

    def crossed(self, start: F64, to: F64) -> list[GroundZone]:
        """Return the zones with a floor that the vehicle's disc crosses from `start` to `to`, (2,) metres."""
        way, shut = shapely.LineString([start, to]), (z for z in self.plane.of("keep-out") if z.floor > 0.0)
        return [z for z in shut if shapely.distance(z.shape, way) < z.reach + z.margin + self._reach]

    def named(self, sites: Sites, offset: F64 | tuple[float, float] = (0.0, 0.0)) -> Sites:
        """Return the sites and candidates, each with the zone, road, car, person and building nearest to it."""
        given = [z for z in self.plane.zones if z.name and not z.shape.is_empty]
        strict = [z for z in given if z.use in ("keep-out", "avoid")]
        kinds = [[z for z in self.plane.zones if z.kind == kind and not z.shape.is_empty] for kind in FOUND]

        def named(site: Site) -> Site:
            near = tuple(_nearest(zones, site, offset) for zones in kinds if zones)
            return replace(site, zone=_nearest(strict or given, site, offset) if given else None, near=near)

        return replace(sites, sites=tuple(map(named, sites.sites)), candidates=tuple(map(named, sites.candidates)))


def _nearest(zones: list[GroundZone], site: Site, offset: F64 | tuple[float, float]) -> NearZone:
    """Return the nearest of `zones` to a site."""
    at = shapely.Point(site.east + offset[0], site.north + offset[1])
    away = shapely.distance([z.shape for z in zones], at) - [z.reach for z in zones]
    nearest = zones[int(away.argmin())]
    to = np.subtract(*shapely.get_coordinates(shapely.shortest_line(nearest.shape, at)))
    inside = away.min() <= 0.0
    bearing = math.nan if inside else math.atan2(to[0], to[1]) % (2.0 * math.pi)
    return NearZone(nearest.kind, nearest.label, 0.0 if inside else float(away.min()), bearing)


def _drawn(areas: list[shapely.Geometry], grid: Grid) -> U16:
    """Return for each cell, (R, C), the number of the last area that holds its centre, from 1; 0: none does."""
    out = np.zeros(grid.shape, np.uint16)
    if areas:
        numbered = ((area, number) for number, area in enumerate(areas, 1))
        with placeless_rasters():
            rasterize(numbered, out=out, transform=Affine(*grid.transform))
    return out
