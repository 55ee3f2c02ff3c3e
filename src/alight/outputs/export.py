"""A finished run in the formats of other tools: ROS 2, grid_map, KML, LAS, MAVLink missions, styles of QGIS."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat

from alight.arrays import F32, F64
from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_text, validated
from alight.geometry import Grid, LocalFrame, Pose, world_up
from alight.outputs import ros_messages as ros
from alight.outputs.plan import Command
from alight.outputs.reading import AGAIN, Run, read_run
from alight.outputs.ros_file import RosFile
from alight.outputs.vectors import lon_lat_height
from alight.records import (
    InputError,
    MissingExtraError,
    Motion,
    MotionState,
    Route,
    Site,
    Sites,
    Terrain,
    Waypoint,
    p_safe_text,
)
from alight.records.landing import Doubt
from alight.report.paint import HEIGHT_RAMP, SAFE_RAMP


class LasClass(IntEnum):
    """Classes of points, as ASPRS numbers them."""

    UNCLASSIFIED = 1
    GROUND = 2
    LOW_VEGETATION = 3
    HIGH_VEGETATION = 5
    BUILDING = 6
    WATER = 9
    ROAD = 11


LAS_CLASSES = {
    Terrain.BARE: LasClass.GROUND, Terrain.SHORT_GRASS: LasClass.GROUND, Terrain.ROCK: LasClass.GROUND,
    Terrain.TALL_VEGETATION: LasClass.LOW_VEGETATION, Terrain.TREE: LasClass.HIGH_VEGETATION,
    Terrain.WATER: LasClass.WATER, Terrain.PAVED: LasClass.ROAD, Terrain.STRUCTURE: LasClass.BUILDING,
}  # fmt: skip


class _SiteRow(BaseModel):
    rank: int
    doubt: Doubt | None = None
    east_m: FiniteFloat
    north_m: FiniteFloat
    up_m: FiniteFloat
    p_safe: float | None = None
    radius_m: float | None = None
    heading_deg: float | None = None

    def site(self) -> Site:
        """Return the record of the site; None in the file is NaN."""
        p, radius, heading = (math.nan if v is None else v for v in (self.p_safe, self.radius_m, self.heading_deg))
        site = Site.unjudged(self.east_m, self.north_m, self.up_m)
        return replace(
            site, rank=self.rank, p_safe=p, radius=radius, heading=math.radians(heading), doubt=self.doubt
        )  # fmt: skip


class _Answer(BaseModel):
    sites: list[_SiteRow]
    candidates: list[_SiteRow]


class _WayProperties(BaseModel):
    name: str = ""
    t_s: float | None = None
    speed_m_s: float | None = None
    heading_deg: float | None = None


class _Way(BaseModel):
    geometry: dict[str, Any]
    properties: _WayProperties


class _Ways(BaseModel):
    features: list[_Way]


class _Item(BaseModel):
    command: int
    frame: int
    params: list[float | None]


class _Mission(BaseModel):
    home: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(alias="plannedHomePosition")
    items: list[_Item]


class _Plan(BaseModel):
    mission: _Mission


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A finished run, read from its folder.

    Raises:
        InputError: the folder has no finished run, or a file of it cannot be used.
    """

    folder: Path

    @cached_property
    def run(self) -> Run:
        """Rasters and run.json."""
        return read_run(self.folder)

    @property
    def local(self) -> LocalFrame:
        """The world's origin."""
        if self.run.local is None:
            raise InputError(f"{self.folder}: the run has no place on Earth; export it with --ros2 or --gridmap")
        return self.run.local

    def document(self, name: str, kind: type[Any]) -> Any:
        """Return a JSON file of the folder as a model of the class `kind`."""
        path = self.folder / name
        if not path.is_file():
            raise InputError(f"{path}: missing: {self.run.info.get('not_written', {}).get(name, AGAIN)}")
        try:
            return validated(kind, parse_json(read_text(path, LARGEST_JSON)))
        except DocumentError as e:
            raise InputError(f"{path}: {e}; {AGAIN}") from e

    @cached_property
    def sites(self) -> Sites:
        """Sites and candidates; of their factors only P(safe) is known."""
        try:
            answer = validated(_Answer, self.run.info["answer"])
        except (DocumentError, KeyError) as e:
            raise InputError(f"{self.folder / 'run.json'}: {e}; {AGAIN}") from e
        sites, candidates = (tuple(row.site() for row in rows) for rows in (answer.sites, answer.candidates))
        return Sites(sites, candidates=candidates)

    @cached_property
    def route(self) -> Route | None:
        """The way-points to the best site; None: there is none."""
        if not (self.folder / "route.geojson").is_file():
            return None
        ways = []
        for feature in self.document("route.geojson", _Ways).features[1:]:  # the first is the line
            p, (longitude, latitude, height) = feature.properties, feature.geometry["coordinates"]
            place = self.local.to_enu(latitude, longitude, height)
            heading = math.radians(p.heading_deg or 0.0)
            ways.append(Waypoint(p.name, place, heading, p.speed_m_s or 0.0, p.t_s or 0.0))
        return Route(tuple(ways))

    @cached_property
    def motions(self) -> list[Motion]:
        """The estimated motions, with the variances of trajectory.csv."""
        path = self.folder / "trajectory.csv"
        if not path.is_file():
            return []
        try:
            rows = [line.split(",") for line in read_text(path, LARGEST_JSON).splitlines()[1:]]
            return [_motion(row) for row in rows]
        except (ValueError, IndexError, KeyError, DocumentError) as e:
            raise InputError(f"{path}: {e}; {AGAIN}") from e

    def heights(self) -> tuple[Grid, F32, Run]:
        """Return the grid, the heights above the world's origin, (R, C) metres, and the run; NaN is unknown."""
        run = self.run
        if run.grid is None or run.height is None:
            raise InputError(f"{self.folder}: the run has no map of heights (dem.tif)")
        return run.grid, run.height if run.local is None else world_up(run.height, run.grid, run.local), run


def _motion(row: Sequence[str]) -> Motion:
    values = np.array([float(v or "nan") for v in row[1:17]])
    pose = Pose.from_quaternion(values[3:7], values[:3])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag(values[10:13] ** 2)
    covariance[3:, 3:] = pose.rotation @ np.diag(values[13:16] ** 2) @ pose.rotation.T
    return Motion(int(row[0]), pose, (), covariance, values[7:10], MotionState[row[17].upper()], int(row[18]))


def _map(found: FinishedRun, t_ns: int) -> ros.RosMessage:
    grid, height, run = found.heights()
    cover = None if run.terrain is None else np.where(run.terrain == Terrain.UNKNOWN, np.nan, run.terrain)
    layers = {"elevation": height, "sigma": run.sigma, "p_safe": run.safe, "land_cover": cover}
    known = {name: v.astype(np.float32) for name, v in layers.items() if v is not None}
    return ros.grid_map("/map", t_ns, grid, known)


def _messages(found: FinishedRun) -> Iterator[ros.RosMessage]:
    motions = found.motions
    for m in motions:
        yield from ros.motion_messages(m)
        if found.run.local is not None:
            yield ros.fix("/fix", m.t_ns, m.world_from_body.translation, m.covariance[:3, :3], found.run.local)
    end = motions[-1].t_ns if motions else time.time_ns()
    if found.run.height is not None:
        yield _map(found, end)
    yield from ros.sites_messages("/sites", end, found.sites)
    if found.route is not None:
        yield ros.route_poses("/route", end, found.route)
    for warning in found.run.info.get("warnings", ()):
        yield ros.log_line("/notes", end, "alight", str(warning))


def _mcap(messages: Iterator[ros.RosMessage]) -> bytes:
    out = BytesIO()
    file = RosFile(out)
    for message in messages:
        file.write(message, message.t_ns)
    file.finish()
    return out.getvalue()


def ros2(found: FinishedRun) -> bytes:
    """Return motions, map, sites and route as messages of ROS 2 in an MCAP file; see docs/formats/recording.md."""
    return _mcap(_messages(found))


def gridmap(found: FinishedRun) -> bytes:
    """Return the map alone as a grid_map_msgs/GridMap in an MCAP file."""
    motions = found.motions
    return _mcap(iter([_map(found, motions[-1].t_ns if motions else time.time_ns())]))


def kml(found: FinishedRun) -> bytes:
    """Return sites, on the ground, and the route as KML; the route's heights count from the ground of the best site."""
    local, places = found.local, []
    for s in found.sites.listed:
        longitude, latitude, height = lon_lat_height(local, s.east, s.north, s.up)
        words = f"P(safe) {p_safe_text(s.p_safe)}; ground {height:.2f} m above the WGS84 ellipsoid"
        at = f"<Point><coordinates>{longitude},{latitude}</coordinates></Point>"
        places.append(
            f"<Placemark><name>{s.kind} {s.rank}</name><description>{escape(words)}</description>{at}</Placemark>"
        )
    if (route := found.route) is not None and route.waypoints:
        zero = lon_lat_height(local, *route.waypoints[-1].position_world)[2]
        ways = [lon_lat_height(local, *w.position_world) for w in route.waypoints]
        line = " ".join(f"{lon},{lat},{h - zero:.2f}" for lon, lat, h in ways)
        places.append(
            "<Placemark><name>route to site 1</name><LineString><altitudeMode>relativeToGround</altitudeMode>"
            f"<coordinates>{line}</coordinates></LineString></Placemark>"
        )
    name = escape(str(found.run.info.get("input", {}).get("name", found.folder.name)))
    body = "\n".join(places)
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
        f"<name>{name}</name>\n{body}\n</Document></kml>\n"
    ).encode()


def las(found: FinishedRun) -> bytes:
    """Return the cells with a height as LAS 1.4: colours, classes of ASPRS, sigma and P(safe) of each point.

    Raises:
        MissingExtraError: laspy is not installed.
    """
    try:
        import laspy
    except ImportError as e:
        raise MissingExtraError("laspy", "las") from e
    import pyproj

    local = found.local
    grid, _, run = found.heights()
    assert run.height is not None
    rows, cols = np.nonzero(np.isfinite(run.height))
    east, north = grid.xy()
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([0.0, 0.0, np.floor(local.height)])
    header.add_crs(pyproj.CRS.from_user_input(local.crs))
    out = laspy.LasData(header)
    out.x, out.y, out.z = east[cols], north[rows], run.height[rows, cols]
    if run.ortho is not None:
        out.red, out.green, out.blue = 257 * run.ortho[rows, cols].T.astype(np.uint16)
    if run.terrain is not None:
        classes = np.array([LAS_CLASSES.get(t, LasClass.UNCLASSIFIED) for t in Terrain], np.uint8)
        out.classification = classes[run.terrain[rows, cols]]
    for name, values in (("sigma", run.sigma), ("p_safe", run.safe)):
        if values is not None:
            out.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.float32))
            out[name] = values[rows, cols]
    file = BytesIO()
    out.write(file)
    return file.getvalue()


def waypoints(found: FinishedRun) -> bytes:
    """Return route.plan as a mission in MAVLink's text format (QGC WPL 110); its first line is the planned home."""
    mission = found.document("route.plan", _Plan).mission
    home = [0, 1, 0, Command.WAYPOINT, 0, 0, 0, 0, *mission.home, 1]
    lines = [home]
    for k, item in enumerate(mission.items, 1):
        lines.append([k, 0, item.frame, item.command, *(0.0 if p is None else p for p in item.params), 1])
    text = StringIO()
    text.write("QGC WPL 110\n")
    for line in lines:
        text.write("\t".join(f"{v:.8f}" if isinstance(v, float) else str(int(v)) for v in line) + "\n")
    return text.getvalue().encode()


def styles(found: FinishedRun) -> dict[str, bytes]:
    """Return styles of QGIS by file name, which stand beside dem.tif and safe.tif; terrain.tif has its own colours."""
    files = {}
    if (height := found.run.height) is not None and np.isfinite(height).any():
        low, high = np.nanpercentile(height, (2, 98)).tolist()
        files["dem.qml"] = _style(np.linspace(low, high, len(HEIGHT_RAMP)), HEIGHT_RAMP, " m")
    if found.run.safe is not None:
        files["safe.qml"] = _style(np.linspace(0.0, 1.0, len(SAFE_RAMP)), SAFE_RAMP, "")
    return files


def _style(values: F64, colours: Sequence[str], unit: str) -> bytes:
    """Return the style of a raster's first band: colours at some values, and between them."""
    items = "".join(
        f'<item value="{v:.6g}" color="{c}" alpha="255" label="{v:.4g}{unit}"/>'
        for v, c in zip(values.tolist(), colours, strict=True)
    )
    low, high = f"{values[0]:.6g}", f"{values[-1]:.6g}"
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        '<qgis version="3.0" styleCategories="Symbology"><pipe>'
        '<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" '
        f'classificationMin="{low}" classificationMax="{high}"><rasterTransparency/><rastershader>'
        '<colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" '
        f'minimumValue="{low}" maximumValue="{high}">{items}</colorrampshader>'
        "</rastershader></rasterrenderer></pipe></qgis>\n"
    ).encode()
