"""Figures of the report: their records, the ground from above, and close-ups of the first place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from alight.records import ElevationMap, Kind, RunResult
from alight.report import canvas, paint, survey, words
from alight.report.canvas import Canvas

BADGE = 21.0  # page units, radius of a number
ZONES = "Red: keep-out zones, cars, people, buildings; orange: roads, zones to be avoided; blue: other zones."
ASIDE = tuple(
    (round(math.sin(a), 4), round(-math.cos(a), 4)) for a in np.radians([0, 45, -45, 90, -90, 135, -135, 180])
)


@dataclass(frozen=True)
class Key:
    """One colour of a legend."""

    colour: str
    text: str
    share: str = ""


@dataclass(frozen=True)
class Mark:
    """One site or candidate on a picture, page units."""

    x: float
    y: float
    r: float  # radius of the footprint
    room: float  # radius of the largest safe disc
    rank: int
    place: str
    kind: Kind
    look: str = ""  # of the first candidate: height of the next view
    aside: tuple[float, float] = (0.0, -1.0)  # direction of the number from the disc


@dataclass(frozen=True)
class ZoneMark:
    """A zone on a picture: the SVG path of its border, its use, its label, and its name where there is room."""

    path: str
    use: str
    label: str
    name: str
    x: float  # of the name, page units
    y: float


@dataclass(frozen=True)
class Bar:
    """A scale bar."""

    length: float  # page units
    text: str


@dataclass(frozen=True)
class Figure:
    """One picture with its title, marks, legend and caption."""

    title: str
    alt: str
    uri: str
    height: float  # page units, for a width of 1000
    marks: Sequence[Mark] = ()
    bar: Bar | None = None
    caption: str = ""
    keys: Sequence[Key] = ()
    zones: Sequence[ZoneMark] = ()
    flown: str = ""  # SVG points of the flight path
    route: str = ""  # SVG points of the route
    classes: Sequence[str] = ()
    place: int = 0  # rank of the site or candidate that it shows


def scale_bar(c: Canvas, share: float = 0.22) -> Bar:
    """Return the longest scale bar of 1, 2 or 5 times a power of ten that is at most `share` of the width."""
    longest = share * canvas.WIDTH / c.per_metre
    power = 10.0 ** math.floor(math.log10(longest))
    length = power * max(m for m in (1, 2, 5) if m * power <= longest)
    return Bar(round(length * c.per_metre, 2), f"{length:g} m" if length >= 1 else f"{length * 100:g} cm")


def marks(result: RunResult, c: Canvas) -> list[Mark]:
    """Return the marks of sites and candidates on a picture; the best one is last, so that it is drawn on top."""
    radius = result.settings.lander.radius * c.per_metre
    out = []
    for s in result.sites.listed:
        x, y = c.xy(s.east, s.north)
        first = s.look is not None and s is result.sites.candidates[0]  # the table has the heights of the others
        look = f"look from {s.look.height:.0f} m" if s.look is not None and first else ""
        room = max(radius, s.radius * c.per_metre) if math.isfinite(s.radius) else radius
        out.append(Mark(x, y, round(radius, 2), round(room, 2), s.rank, words.place(result, s), s.kind, look))
    return _aside(out, c)[::-1]


def outlines(result: RunResult, c: Canvas) -> list[ZoneMark]:
    """Return the borders of the zones on a picture; keep-out zones come last, so that they are drawn on top."""
    out = []
    for z, area in survey.zone_areas(result, c.grid):
        area = area.simplify(1.0 / c.per_metre)
        rings = [ring for part in survey.rings_of(area) for ring in part]
        path = " ".join("M" + " L".join("{} {}".format(*c.xy(x, y)) for x, y in ring.coords) + "Z" for ring in rings)
        if path:
            x0, _, x1, _ = area.bounds
            has_room = (x1 - x0) * c.per_metre > 10.0 * len(z.name)
            x, y = c.xy(*shapely.get_coordinates(area.representative_point())[0])
            out.append(ZoneMark(path, z.use, z.label, z.name if has_room else "", x, y))
    return out


def _aside(found: list[Mark], c: Canvas) -> list[Mark]:
    """Place each number beside its disc where it overlaps other marks least; the best site chooses first."""
    taken: list[tuple[float, float, float]] = []
    out = []
    for m in found:
        others = [(o.x, o.y, o.r) for o in found if o is not m] + taken
        spots = [_covered(m, way) for way in ASIDE]
        best = min(range(len(spots)), key=[sum(_hidden(*at, others, c) for at in spot) for spot in spots].__getitem__)
        taken += spots[best]
        out.append(replace(m, aside=ASIDE[best]))
    return out


def _covered(m: Mark, way: tuple[float, float]) -> list[tuple[float, float, float]]:
    """Return the discs (x, y, radius) covered by a mark's number on its side `way` and by its text opposite to it."""
    beside, text = m.r + BADGE, -1 if way[1] > 0 else 1
    number = (m.x + way[0] * beside, m.y + way[1] * beside, BADGE)
    return [number, *((m.x + x, m.y + text * (m.r + 14), 14.0) for x in (-56.0, -28.0, 0.0, 28.0, 56.0) if m.look)]


def _hidden(x: float, y: float, r: float, others: list[tuple[float, float, float]], c: Canvas) -> float:
    """Return the cost of a disc of radius `r`: its overlap with other discs and beyond the picture's edge."""
    outside = sum(max(r - d, 0.0) for d in (x, y, canvas.WIDTH - x, c.height - y))
    return 4 * outside + sum(max(q + r - math.hypot(x - a, y - b), 0.0) for a, b, q in others)


def _points(c: Canvas, positions: Sequence[NDArray[np.float64]]) -> str:
    return " ".join("{},{}".format(*c.xy(float(p[0]), float(p[1]))) for p in positions)


def _explain(result: RunResult, zones: Sequence[ZoneMark]) -> list[str]:
    lines = []
    if result.sites.sites:
        lines.append("Solid circle: the lander's footprint at a site; dotted: the largest safe disc about it.")
    if result.sites.candidates:
        lines.append("Dashed circle with a square number: a candidate.")
    lines += ["White line: the flight."] if result.motions else []
    lines += [ZONES] * bool(zones)
    above = "above the home" if result.home else "relative to the site, not to the vehicle's home"
    zero = f" The heights of route.plan are {above}."
    return lines + (["Green dashes: the way to site 1." + zero] if result.route else [])


def overview(result: RunResult, elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the orthophoto with sites, candidates, flight path and route."""
    sites, candidates, zones = len(result.sites.sites), len(result.sites.candidates), outlines(result, c)
    shown = f"{words.counted(sites, 'numbered landing site')} and {words.counted(candidates, 'candidate')}"
    return Figure(
        title="The ground from above",
        alt=f"Orthophoto, north up, with {shown}",
        uri=photo(elevation, c, 2000),
        height=round(c.height, 1),
        marks=marks(result, c),
        bar=scale_bar(c),
        zones=zones,
        flown=_points(c, [m.world_from_body.translation for m in result.motions]),
        route=_points(c, [w.position_world for w in result.route.waypoints]) if result.route else "",
        caption=" ".join(_explain(result, zones)),
        classes=("big",),
    )


def photo(elevation: ElevationMap, c: Canvas, longest: int) -> str:
    """Return the finest orthophoto of a canvas as a data URI, with at most `longest` pixels along its longer side."""
    picture, n = elevation.picture(max(c.grid.shape) * c.grid.cell / longest)
    seen = c.cut(elevation.views > 0).repeat(n, axis=0).repeat(n, axis=1)
    rgba = paint.rgba(Canvas(c.grid.finer(n), n * c.row, n * c.col).cut(picture), seen)
    return canvas.embedded(canvas.webp(canvas.shrink(rgba, longest)))


def closeups(result: RunResult, elevation: ElevationMap) -> list[Figure]:
    """Return the photo of each site and candidate for a check by eye; of the first one also the relief."""
    out, radius = [], result.settings.lander.radius
    for place in result.sites.listed:
        c = canvas.about(elevation.grid, place.east, place.north, max(3.2 * radius, radius + 3.0))
        name = f"{place.kind.capitalize()} {place.rank}"
        common: dict[str, Any] = {
            "height": round(c.height, 1), "marks": marks(result, c), "bar": scale_bar(c), "classes": ("near",),
            "zones": outlines(result, c), "place": place.rank,
        }  # fmt: skip
        alt, uri = f"Orthophoto of {name.lower()}", photo(elevation, c, 480)
        first = place is result.sites.listed[0]
        out.append(Figure(f"{name}, the photo" if first else name, alt, uri, **common))
        if first:
            near = c.cut(np.where(elevation.trusted, elevation.height, np.nan).astype(np.float32))
            low, high = paint.span(near[near != 0], 1, 99)
            uri, alt = c.uri(paint.paint_heights(elevation, low, high)), f"Shaded heights of {name.lower()}"
            caption = f"colours span {words.metres(high - low)} of height"
            out.append(Figure(f"{name}, the relief", alt, uri, caption=caption, **common))
    return out
