"""What lies about the map: footprints and overlap of the pictures, residuals of their GPS positions, and zones."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
import shapely

from alight.arrays import F64
from alight.geometry import Grid
from alight.geometry.zones import rectangle_of
from alight.records import RunResult
from alight.records.zones import USES, GroundZone
from alight.report import words


class Residual(NamedTuple):
    """GPS position of a photo minus its estimated position, metres."""

    name: str
    east: float
    north: float


class Residuals(NamedTuple):
    """A plot of GPS residuals; 1 is the edge of the plot."""

    photos: Sequence[Residual]
    edge: float  # metres
    rms: float  # metres, horizontal

    @property
    def alt(self) -> str:
        """The plot in words."""
        return f"GPS residuals of {words.counted(len(self.photos), 'photo')}, {words.metres(self.rms)} rms"


def footprints(result: RunResult) -> list[F64]:
    """Return the corners of each picture, (4, 2) metres east and north, on level ground of the map's median height.

    Pictures that show the sky, and photos of several cameras, have none.
    """
    e = result.elevation
    if e is None or not e.trusted.any() or not result.cameras:
        return []
    if len(result.cameras) > 1 and result.source_kind == "photos":
        return []
    camera, ground = result.cameras[0], float(np.median(e.height[e.trusted]))
    w, h = camera.width - 1, camera.height - 1
    rays = camera.rays(np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float64))
    out = []
    for motion in result.motions:
        pose = motion.world_from_cams[0]
        ways = rays @ pose.rotation.T
        if (ways[:, 2] < -0.1 * np.linalg.norm(ways, axis=1)).all():  # below the horizon
            out.append(pose.translation[:2] + ways[:, :2] * ((ground - pose.translation[2]) / ways[:, 2])[:, None])
    return out


def overlap(found: Sequence[F64]) -> float | None:
    """Return the median share of a picture that the next one shows as well; None: fewer than two pictures."""
    rings = [np.ascontiguousarray(ring, np.float32) for ring in found]
    shares = [cv2.intersectConvexConvex(a, b)[0] / max(cv2.contourArea(a), 1e-6) for a, b in pairwise(rings)]
    return float(np.median(shares)) if shares else None


def gps_residuals(result: RunResult) -> Residuals | None:
    """Return the GPS residuals of photos with a position; None: there are fewer than two."""
    poses = {m.t_ns: m.world_from_body.translation for m in result.motions}
    photos = []
    for row in result.photos:
        if row.facts.place is not None and row.facts.t_ns in poses and result.georeferenced:
            estimated = poses[row.facts.t_ns]
            tagged = result.local.to_enu(*row.facts.place, result.local.height + estimated[2])
            photos.append(Residual(row.facts.name, *(float(v) for v in (tagged - estimated)[:2])))
    if len(photos) < 2:
        return None
    away = np.hypot(*np.array([(p.east, p.north) for p in photos]).T)
    return Residuals(photos, float(away.max()), float(np.sqrt((away**2).mean())))


def rings_of(area: shapely.Geometry) -> list[list[shapely.Geometry]]:
    """Return the rings of each polygon of an area, the outer one first; lines and points are left out."""
    return [[p.exterior, *p.interiors] for p in shapely.get_parts(area) if p.area > 0.0]


def zone_areas(result: RunResult, grid: Grid) -> list[tuple[GroundZone, shapely.Geometry]]:
    """Return zones, roads, cars, people and buildings with their areas on a grid; those to keep out of come last."""
    window = rectangle_of(grid)
    zones = sorted([*result.zones.zones, *result.others], key=lambda z: USES[::-1].index(z.use))
    areas = ((z, z.shape.buffer(z.reach).intersection(window)) for z in zones)
    return [(z, area) for z, area in areas if not area.is_empty]
