"""Lines, areas and places over the page's map: sites, flight, footprints of the pictures, route, wires."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from alight.geometry import Grid
from alight.records import RunResult
from alight.report import survey, words


class Shape(NamedTuple):
    """A shape as in GeoJSON, but with coordinates in metres east, north and up."""

    layer: str  # title of its layer, which can be switched
    style: str  # class in style.css
    type: str  # LineString, Polygon or Point
    coordinates: Sequence[Any]  # of a Polygon: its rings, the outer one first
    text: str = ""
    radius: float = 0.0  # metres, of the circle about a Point
    room: float = 0.0  # metres, of a second, dotted circle about it
    rank: int = 0  # of a site or candidate
    hidden: bool = False  # whether its layer is hidden at first


def _line(points: Iterable[Iterable[float]]) -> list[list[float]]:
    return [[round(float(v), 2) for v in p] for p in points]


def shapes_of(result: RunResult) -> Iterator[Shape]:
    """Yield the shapes of a run; later ones are drawn over earlier ones."""
    prints = survey.footprints(result)
    for ring in prints[:: math.ceil(len(prints) / 60) or 1]:
        yield Shape("Footprints of the pictures", "footprint", "Polygon", [_line(ring)], hidden=True)
    areas = [] if result.elevation is None else survey.zone_areas(result, result.elevation.grid)
    for zone, area in areas:
        for rings in survey.rings_of(area):
            yield Shape("Zones", f"zone {zone.use}", "Polygon", [_line(r.coords) for r in rings], zone.label)
    for wire in result.hazards.wires if result.hazards is not None else ():
        text = f"wire, {words.percent(wire.chance)} sure"
        yield Shape("Wires", "wire", "LineString", _line([wire.start, wire.end]), text)
    if len(result.motions) > 1:
        flown = [m.world_from_body.translation for m in result.motions]
        yield Shape("Flight", "flown", "LineString", _line(flown[:: math.ceil(len(flown) / 2000)]), "flight path")
    if result.route is not None and result.route.waypoints:
        way = _line([w.position_world for w in result.route.waypoints])
        yield Shape("Route", "route", "LineString", way, "way to site 1")
        for w, at in zip(result.route.waypoints, way, strict=True):
            yield Shape("Route", "waypoint", "Point", at, f"{w.name}, {w.t:.0f} s")
    for s in result.sites.listed[::-1]:
        look = "" if s.look is None else f"look from {s.look.height:.0f} m"
        yield Shape(
            "Sites and candidates", s.kind, "Point", _line([s.position_world])[0],
            f"{s.kind.capitalize()} {s.rank}, P(safe) {words.chance(s.p_safe)}" + f", {look}" * bool(look),
            result.settings.lander.radius, s.radius if math.isfinite(s.radius) else 0.0, s.rank,
        )  # fmt: skip


def geodetic(result: RunResult, grid: Grid) -> dict[str, list[float]] | None:
    """Return latitude and longitude, degrees, as quadratic forms of east and north; None: no place on Earth.

    The terms are 1, e, n, e^2, e n, n^2, with east and north in km; over 2 km they are exact to a millimetre or so.
    """
    if not result.georeferenced:
        return None
    e, n = (v.ravel() for v in np.meshgrid(*(np.linspace(v[0], v[-1], 5) for v in grid.xy())))
    terms = np.stack([np.ones_like(e), e, n, e * e, e * n, n * n], axis=1) / 1000.0 ** np.array([0, 1, 1, 2, 2, 2])
    places = result.local.to_geodetic(np.stack([e, n, np.zeros_like(e)], axis=1))[:2]
    forms = [np.linalg.lstsq(terms, place, rcond=None)[0].tolist() for place in places]
    return dict(zip(("latitude", "longitude"), forms, strict=True))
