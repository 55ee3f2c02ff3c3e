"""Route: way-points from the vehicle to a point above the site, clear of all mapped obstacles, then straight down."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F64, Mask
from alight.geometry import Grid
from alight.landing.wind import ground_speed, is_from_behind
from alight.landing.zones import MapZones
from alight.raster import block_quantile, upsample
from alight.records import ElevationMap, Route, Site, Waypoint, Wire, is_measured, nearest_wire
from alight.records.wires import BEYOND
from alight.settings import RouteSettings
from alight.settings.tuning.executive import ExecutiveTuning

WIRE_ABOUT = 1.0  # metres: how far a wire may be from where it was found
UNMAPPED = ExecutiveTuning().unmapped  # largest unmapped share of the ground beside the path


@dataclass(frozen=True, eq=False)
class _Corridor:
    """Obstacles along the path: the mapped cells within `clearance` of the ground track."""

    share: F64  # (n,) position of each cell along the path, 0 (start) to 1 (site)
    top: F64  # (n,) metres, height of each cell plus two sigma
    unknown: bool  # whether part of the path, or of the ground beside it, is not mapped
    beside: float  # metres, highest top within `clearance` of the site
    ceiling: float  # metres, highest top on the whole map: unmapped ground may be as high


def along_way(start: F64, to: F64, grid: Grid, width: float) -> tuple[F64, Mask]:
    """Compute where cells lie along the straight track from `start` to `to`, east and north, and which are near.

    Returns:
        Position along the track, (R, C), 0 at `start` to 1 at `to`; mask of the cells within `width` metres.
    """
    east, north = grid.xy()
    x, y = east - start[0], (north - start[1])[:, None]
    ex, ey = float(to[0] - start[0]), float(to[1] - start[1])
    share = np.clip((x * ex + y * ey) / max(ex * ex + ey * ey, 1e-12), 0.0, 1.0)
    x, y = x - share * ex, y - share * ey
    return share, x * x + y * y <= (width + grid.cell / 2) ** 2


def _corridor(start: F64, site: Site, elevation: ElevationMap, width: float, wires: Sequence[Wire]) -> _Corridor:
    at = np.array([site.east, site.north])
    share, near = along_way(start, at, elevation.grid, width)
    top = Obstructions.of(elevation, wires).top
    here, known = near & np.isfinite(top), np.isfinite(top)
    unknown = _track_unknown(start, site, elevation, elevation.trusted)
    if not unknown:  # both ends lie on the map
        unknown = _beside_unmapped(start, at, elevation.grid, known, width)
    _, about = along_way(at, at, elevation.grid, width)
    beside = float(top[about & known].max(initial=site.up))
    return _Corridor(share[here], top[here], unknown, beside, float(top[known].max(initial=site.up)))


@dataclass(frozen=True, eq=False)
class Obstructions:
    """Heights of possible obstacles."""

    top: F64  # (R, C) metres, world up, height to clear; NaN where no height was measured
    rise: F64  # (R, C) metres, of doubtful heights above the ground around them; NaN elsewhere

    @classmethod
    def of(cls, elevation: ElevationMap, wires: Sequence[Wire] = ()) -> Obstructions:
        """Derive obstacle heights from a map: trusted heights plus two sigma, block medians of doubtful heights.

        Ground under a wire, found or doubtful, is as high as the wire.

        In a tree's crown most heights are doubtful, by several metres. Single heights may be wrong, so each doubtful
        cell gets the median of its block of 0.5 m. `rise` is this median above the lowest heights of its own block of 2
        m and of the neighbouring blocks.
        """
        height = np.where(is_measured(elevation.flags), elevation.height, np.float32(np.nan))
        size, shape = max(1, round(0.5 / elevation.grid.cell)), height.shape
        about = upsample(block_quantile(height, size, 0.5), size, shape).astype(np.float64)
        wide = max(1, round(2.0 / elevation.grid.cell))
        low = block_quantile(height, wide, 0.1)
        low = cv2.erode(np.where(np.isfinite(low), low, np.float32(np.inf)), np.ones((3, 3), np.uint8))
        rise = np.where(elevation.trusted, np.nan, about - upsample(low, wide, shape))
        surely = elevation.height.astype(np.float64) + 2 * elevation.sigma.astype(np.float64)
        top = np.where(elevation.trusted, surely, np.where(np.isfinite(height), about, np.nan))
        if wires:
            distance, up = nearest_wire([w.longer(BEYOND) for w in wires], elevation.grid)
            top = np.where(distance <= WIRE_ABOUT, np.fmax(top, up + WIRE_ABOUT), top)
        return cls(top, rise)


def _track_unknown(start: F64, site: Site, elevation: ElevationMap, known: Mask) -> bool:
    """Whether any cell of the track from `start` to the site lies off the map or outside the mask `known` (R, C)."""
    grid = elevation.grid
    steps = 2 + int(math.hypot(site.east - start[0], site.north - start[1]) / grid.cell)
    east, north = np.linspace(start[0], site.east, steps), np.linspace(start[1], site.north, steps)
    return not bool(grid.nearest_at(known, east, north).all())


def _beside_unmapped(start: F64, to: F64, grid: Grid, mapped: Mask, width: float) -> bool:
    """Whether more than `UNMAPPED` of any stretch of the corridor along the path is unmapped.

    The corridor reaches `width` metres to either side; a stretch is `2 * width` long. Ground beyond both ends is
    ignored. `mapped` (R, C) is True for cells of the grid with a height, even a doubtful one; off the map no cell is
    mapped.
    """
    rows, cols = grid.index(*np.array([start[:2], to[:2]]).T)
    reach, corner = math.ceil(width / grid.cell) + 1, (math.floor(rows.min()), math.floor(cols.min()))
    shape = (math.ceil(v.max()) - low + 2 * reach for v, low in zip((rows, cols), corner, strict=True))
    about = grid.window(corner[0] - reach, corner[1] - reach, *(n + 1 for n in shape))
    share, near = along_way(start, to, about, width)
    near &= (share > 0) & (share < 1)
    if not near.any():
        return False
    steps = (share[near] * math.hypot(to[0] - start[0], to[1] - start[1]) / grid.cell).astype(np.int64)
    stretch = np.ones(min(max(round(2 * width / grid.cell), 1), int(steps.max()) + 1))
    unknown = ~grid.nearest_on(about, mapped)[near]
    lost, cells = (np.convolve(np.bincount(steps, w), stretch, "valid") for w in (unknown, None))
    return bool((lost > UNMAPPED * cells).any())


def _heights(start: F64, site: Site, way: _Corridor, settings: RouteSettings, wind: F64 | None) -> tuple[float, float]:
    """Return the heights (metres, world up) at which the transit begins and ends (G17).

    The transit is a straight line down to the approach point if that line is clear, else level flight above all
    obstacles. It is level in a tail wind too: a rotor that sinks along with the air meets its own wash.
    """
    end = site.up + settings.approach_height
    begin = max(float(start[2]), end)
    if way.unknown:  # unmapped ground may be as high as the highest top
        level = max(way.ceiling + settings.clearance, begin)
        return level, level
    line = begin + way.share * (end - begin)
    if begin > end and is_from_behind(np.array([site.east, site.north]) - start[:2], wind, settings.calm):
        line = np.full_like(line, begin)
        end = begin
    if (line - way.top >= settings.clearance).all():
        return begin, end
    level = max(float(way.top.max()) + settings.clearance, begin)
    return level, level


class WayBelow(NamedTuple):
    """Ground below a level path."""

    clear: float  # metres up, least height clear of all mapped obstacles; minus infinity if nothing is mapped
    unmapped: float  # unmapped share of the ground below the path
    doubtful: float  # m^2 of that ground with obstacles of doubtful height


def way_below(
    start: F64, to: F64, grid: Grid, obstructions: Obstructions, clearance: float, beside: float, rise: float
) -> WayBelow:  # fmt: skip
    """Compute the least height of a level path, and the unmapped and the doubtful parts of the ground below it.

    Args:
        start, to: (3,) metres, ends of the path, which may leave the map.
        grid: grid of the map.
        obstructions: obstacles on the map.
        clearance: vertical clearance above the obstacles, metres.
        beside: distance in metres to either side that is treated as below the path.
        rise: height above the surrounding ground, metres; a doubtful height above it is an obstacle of unknown height.
    """
    _, near = along_way(start, to, grid, beside)
    here, cell = obstructions.top[near], grid.cell * grid.cell
    known, wide = np.isfinite(here), beside + grid.cell / 2
    area = max(2 * wide * math.hypot(to[0] - start[0], to[1] - start[1]) + math.pi * wide * wide, here.size * cell)
    unmapped, doubtful = 1.0 - float(known.sum()) * cell / area, float((obstructions.rise[near] > rise).sum()) * cell
    return WayBelow(float(here[known].max(initial=-np.inf)) + clearance, unmapped, doubtful)


def _bearing(a: F64, b: F64, otherwise: float) -> float:
    d = b - a
    return otherwise if math.hypot(d[0], d[1]) < 0.5 else math.atan2(d[0], d[1]) % (2 * math.pi)


def _stops(
    start: F64, site: Site, heights: tuple[float, float], settings: RouteSettings
) -> list[tuple[str, F64, bool]]:
    """Return name, position and look (True: judge the ground from here) of every way-point after the start.

    `heights`: metres, at which the transit begins and ends.
    """
    begin, end = heights
    over = [site.east, site.north]
    approach = site.up + settings.approach_height
    stops = [
        ("climb", np.array([start[0], start[1], begin]), False),
        ("transit", np.array([*over, end]), True),
        ("approach", np.array([*over, approach]), True),
        ("inspect", np.array([*over, site.up + settings.look_share * settings.approach_height]), True),
        ("touchdown", np.array([*over, site.up]), False),
    ]
    out: list[tuple[str, F64, bool]] = []
    for stop, following in zip(stops, [*stops[1:], None], strict=True):
        merged = following is not None and np.linalg.norm(following[1] - stop[1]) < 0.05  # the later name is kept
        if not merged and np.linalg.norm(stop[1] - (out[-1][1] if out else start)) > 0.05:
            out.append(stop)
    return out


def _timed(
    start: F64, site: Site, stops: list[tuple[str, F64, bool]], settings: RouteSettings, wind: F64 | None
) -> tuple[Waypoint, ...]:
    t, at, heading = 0.0, start, site.heading
    out = [Waypoint("start", start, _bearing(start, stops[0][1], heading) if stops else heading, 0.0, 0.0)]
    for name, position, look in stops:
        d = position - at
        vertical = math.hypot(d[0], d[1]) < 0.5
        over_ground = ground_speed(d, wind, settings.cruise_speed, settings.air_speed)
        speed = settings.descent_speed if vertical and d[2] < 0 else over_ground
        t += float(np.linalg.norm(d)) / speed
        heading = _bearing(at, position, site.heading)
        out.append(Waypoint(name, position, heading, speed, t, look))
        at = position
    return tuple(out)


def plan_route(
    site: Site, elevation: ElevationMap, vehicle_position: F64, settings: RouteSettings, wires: Sequence[Wire] = (),
    zones: MapZones | None = None,
) -> Route:  # fmt: skip
    """Plan the route to a point above the site and straight down, clear of all mapped obstacles up to that point.

    Args:
        site: landing site.
        elevation: map of heights; two sigma are added to each trusted height.
        vehicle_position: (3,) metres, world.
        settings: heights, speeds, clearance above and beside the path, and the wind if it is known. The air speed stays
            within `air_speed`, and no transit descends in a tail wind.
        wires: wires over the ground.
        zones: zones; none is crossed lower than its floor above the highest thing on the way, on the map or beyond it.

    Returns:
        The way-points from the vehicle's position to the touchdown, with speed towards each and time at it. Warnings
        report a climb, unmapped ground below, tall obstacles within `clearance` of the descent, and slow flight into
        wind.
    """
    start = np.asarray(vehicle_position, dtype=np.float64)
    way = _corridor(start, site, elevation, settings.clearance, wires)
    wind = None if settings.wind is None else np.array(settings.wind, np.float64)
    heights = _heights(start, site, way, settings, wind)
    warnings = []
    if zones is not None and (crossed := zones.crossed(start[:2], np.array([site.east, site.north]))):
        floor = max(z.floor for z in crossed)
        level = floor + (way.ceiling if way.unknown else float(way.top.max()))
        if min(heights) < level:
            heights = max(heights[0], level), max(heights[0], level)
        warnings.append(f"the way to the site crosses {', '.join(z.label for z in crossed)} from {floor:g} m up")
    if way.unknown:
        warnings.append("the way to the site crosses ground that is not mapped: flown above the highest thing known")
    if heights[0] > start[2] + 0.05:
        warnings.append(f"the vehicle climbs {heights[0] - start[2]:.1f} m before it leaves")
    if way.beside - site.up > settings.clearance:
        warnings.append(
            f"{way.beside - site.up:.1f} m high is what stands within {settings.clearance:g} m of the way down"
        )
    points = _timed(start, site, _stops(start, site, heights, settings), settings, wind)
    over = [b.speed for a, b in pairwise(points) if math.hypot(*(b.position_world - a.position_world)[:2]) >= 0.5]
    if (slowest := min(over, default=math.inf)) < settings.cruise_speed - 0.05:
        warnings.append(f"against the wind it makes {slowest:.1f} m/s over the ground")
    return Route(points, tuple(warnings))
