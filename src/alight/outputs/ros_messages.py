"""Measurements and results as ROS 2 messages (CDR), with the definitions of their types.

Frames of tf: `map` is the world (east, north, up about the origin), `odom` the estimator's map frame, `base_link` the
body, `cam0`, `cam1` the optical frames of the cameras.
"""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain, zip_longest
from typing import Any, NamedTuple

import numpy as np

from alight.arrays import F32, F64, U8
from alight.geometry import Grid, LocalFrame, Pose
from alight.records import (
    ElevationMap,
    HazardMap,
    ImuSample,
    Motion,
    MotionState,
    NavSample,
    RigCamera,
    Route,
    Site,
    Sites,
    Terrain,
    TerrainMap,
    p_safe_text,
)
from alight.report.paint import rgb
from alight.sources.source import LARGEST

WORLD, ODOMETRY, BODY = "map", "odom", "base_link"
GRID_MAP = """std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
================================================================================
MSG: grid_map_msgs/GridMapInfo
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""
DISTORTION = {"none": "plumb_bob", "radial-tangential": "plumb_bob", "equidistant": "equidistant"}  # names of ROS
_STAMP, _NUMBER = b"a stamp!", b"a number"  # 8 bytes each: what a form has where it is filled
_OPEN_NS, _OPEN = int(np.dot(struct.unpack("<iI", _STAMP), (10**9, 1))), struct.unpack("<d", _NUMBER)[0]
COLOURS = {"site": "#1a9850", "candidate": "#f39c12"}


class RosMessage(NamedTuple):
    """One message of a topic, encoded."""

    topic: str
    type: str  # such as sensor_msgs/msg/Image
    t_ns: int  # stamp
    parts: Sequence[bytes | memoryview]  # bytes of the message, in parts

    @property
    def size(self) -> int:
        """Number of bytes."""
        return sum(map(len, self.parts))


@lru_cache(maxsize=1)
def _store() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(GRID_MAP, "grid_map_msgs/msg/GridMap"))
    return store


@lru_cache(maxsize=64)
def definition_of(kind: str) -> bytes:
    """Return the definition of a type of messages, and of the types in it, as text (ros2msg)."""
    return str(_store().generate_msgdef(kind, ros_version=2)[0]).encode()


def _new(kind: str, *values: Any) -> Any:
    """Return a message, or a part of one, from the values of its fields in order."""
    return _class_of(kind)(*values)


@lru_cache(maxsize=64)
def _class_of(kind: str) -> Any:
    return _store().types[kind.replace("/", "/msg/")]


def _encoded(topic: str, t_ns: int, message: Any) -> RosMessage:
    kind = message.__msgtype__
    return RosMessage(topic, kind, t_ns, [bytes(_store().serialize_cdr(message, kind))])


def _time(t_ns: int, kind: str = "Time") -> Any:
    return _new(f"builtin_interfaces/{kind}", *_stamp(t_ns))


def _stamp(t_ns: int) -> tuple[int, int]:
    return t_ns // 10**9, t_ns % 10**9


def _header(t_ns: int, frame: str) -> Any:
    return _new("std_msgs/Header", _time(t_ns), frame)


def _stamped(head: bytes, t_ns: int) -> bytes:
    """Replace the stamp in the beginning of an encoded message with a header, which is the same for many messages."""
    return head[:4] + struct.pack("<iI", t_ns // 10**9, t_ns % 10**9) + head[12:]


class _Form:
    """A message that is encoded once, and then filled with stamps and numbers: faster than a new one each time.

    Args:
        message: one with the time `_OPEN_NS` and the number `_OPEN` where it is filled.
    """

    def __init__(self, message: Any) -> None:
        self._type = message.__msgtype__
        encoded = bytes(_store().serialize_cdr(message, self._type))
        pieces = re.split(b"(%b|(?:%b)+)" % (_STAMP, _NUMBER), encoded)
        self._fixed = pieces[::2]
        runs = ["iI" if run == _STAMP else f"{len(run) // len(_NUMBER)}d" for run in pieces[1::2]]
        texts = [f"{len(piece)}s" for piece in self._fixed]
        self._struct = struct.Struct("<" + "".join(chain.from_iterable(zip_longest(texts, runs, fillvalue=""))))

    def filled(self, topic: str, t_ns: int, *runs: Iterable[float]) -> RosMessage:
        """Return the message with stamps and numbers in the order of its fields, each run of them by itself."""
        *fixed, end = self._fixed
        values = chain.from_iterable(chain((text,), run) for text, run in zip(fixed, runs, strict=True))
        return RosMessage(topic, self._type, t_ns, [self._struct.pack(*values, end)])


def _vector(v: Iterable[float], kind: str = "Vector3") -> Any:
    return _new(f"geometry_msgs/{kind}", *map(float, v))


def _pose(pose: Pose) -> Any:
    return _new("geometry_msgs/Pose", _vector(pose.translation, "Point"), _turn(pose))


def _turn(pose: Pose | None) -> Any:
    """Return an orientation; None: of a form, to be filled."""
    return _vector([_OPEN] * 4 if pose is None else _numbers(pose)[3:], "Quaternion")


def _numbers(pose: Pose) -> list[float]:
    """Return the numbers of a pose in the order of ROS: x, y, z, and the quaternion's x, y, z, w."""
    w, *xyz = pose.quaternion.tolist()
    return [*pose.translation.tolist(), *xyz, w]


def text(topic: str, t_ns: int, words: str) -> RosMessage:
    """Return a text, std_msgs/String."""
    return _encoded(topic, t_ns, _new("std_msgs/String", words))


def json_text(topic: str, t_ns: int, tree: Any) -> RosMessage:
    """Return a tree as JSON in a std_msgs/String; arrays become lists."""
    return text(topic, t_ns, json.dumps(tree, default=lambda array: array.tolist()))


def log_line(topic: str, t_ns: int, name: str, words: str) -> RosMessage:
    """Return a line of a log, rcl_interfaces/Log, of level INFO."""
    return _encoded(topic, t_ns, _new("rcl_interfaces/Log", _time(t_ns), 20, name, words, "", "", 0))


def diagnostics(topic: str, t_ns: int, name: str, level: int, words: str, values: Mapping[str, Any]) -> RosMessage:
    """Return the state of a part of the system; `level`: 0 good, 1 warning, 2 error."""
    pairs = [_new("diagnostic_msgs/KeyValue", k, str(v)) for k, v in values.items()]
    status = _new("diagnostic_msgs/DiagnosticStatus", level, name, words, "", pairs)
    return _encoded(topic, t_ns, _new("diagnostic_msgs/DiagnosticArray", _header(t_ns, ""), [status]))


@lru_cache(maxsize=8)
def _image_head(frame: str, shape: tuple[int, ...]) -> bytes:
    """Return the bytes of an image before its pixels, without its stamp."""
    encoding, depth = ("mono8", 1) if len(shape) == 2 else ("rgb8", shape[2])
    empty = np.empty(0, np.uint8)
    image = _new("sensor_msgs/Image", _header(0, frame), shape[0], shape[1], encoding, 0, shape[1] * depth, empty)
    count = struct.pack("<I", int(np.prod(shape)))
    return bytes(_store().serialize_cdr(image, image.__msgtype__))[: -len(count)] + count


def image(frame: str, t_ns: int, pixels: U8) -> RosMessage:
    """Return a picture of a camera, (H, W) grey or (H, W, 3) RGB; its pixels are not copied."""
    whole = np.ascontiguousarray(pixels)
    parts: list[Any] = [_stamped(_image_head(frame, whole.shape), t_ns), whole.data.cast("B")]
    return RosMessage(f"/{frame}/image_raw", "sensor_msgs/msg/Image", t_ns, parts)


def camera_info(frame: str, camera: RigCamera) -> RosMessage:
    """Return the calibration of a camera, with the stamp 0; see `at`."""
    lens = camera.camera
    D = np.array(lens.distortion) if lens.model == "equidistant" else lens.coefficients
    P = np.hstack([lens.K, np.zeros((3, 1))])
    region = _new("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
    info = _new(
        "sensor_msgs/CameraInfo", _header(0, frame), lens.height, lens.width, DISTORTION[lens.model], D,
        lens.K.ravel(), np.eye(3).ravel(), P.ravel(), 0, 0, region,
    )  # fmt: skip
    return _encoded(f"/{frame}/camera_info", 0, info)


def at(message: RosMessage, t_ns: int) -> RosMessage:
    """Return a message that begins with a header, with another stamp."""
    head, *rest = message.parts
    return message._replace(t_ns=t_ns, parts=[_stamped(bytes(head), t_ns), *rest])


@lru_cache(maxsize=1)
def _imu_form() -> _Form:
    none, unknown, open_vector = np.array([-1.0, *[0.0] * 8]), np.zeros(9), _vector([_OPEN] * 3)
    return _Form(
        _new(
            "sensor_msgs/Imu", _header(_OPEN_NS, BODY), _turn(Pose()), none, open_vector, unknown, open_vector, unknown
        )
    )


def imu(topic: str, sample: ImuSample) -> RosMessage:
    """Return an inertial measurement of unknown covariance (0), without an orientation (-1)."""
    runs = sample.angular_velocity_body.tolist(), sample.specific_force_body.tolist()
    return _imu_form().filled(topic, sample.t_ns, _stamp(sample.t_ns), *runs)


@lru_cache(maxsize=2)
def _fix_form(covariance_type: int) -> _Form:
    status = _new("sensor_msgs/NavSatStatus", 0, 1)  # a fix, of GPS
    header, numbers = _header(_OPEN_NS, BODY), (*[_OPEN] * 3, np.full(9, _OPEN))
    return _Form(_new("sensor_msgs/NavSatFix", header, status, *numbers, covariance_type))


def fix(topic: str, t_ns: int, position_world: F64, covariance: F64 | None, local: LocalFrame) -> RosMessage:
    """Return a position on Earth; `covariance`: (3, 3) m^2, east north up; None: unknown."""
    known, kind = (np.zeros(9), 0) if covariance is None else (covariance.ravel(), 3)
    return _fix_form(kind).filled(
        topic, t_ns, _stamp(t_ns), [*map(float, local.to_geodetic(position_world)), *known.tolist()]
    )


def gps_fix(topic: str, sample: NavSample, local: LocalFrame) -> Iterator[RosMessage]:
    """Yield the position of a row of GPS/INS on Earth, if it has a possible one."""
    place, sigma = sample.position_world, sample.sigma_position
    if place is not None and place.shape == (3,) and (np.abs(place) <= LARGEST["position_world"]).all():
        yield fix(topic, sample.t_ns, place, None if sigma is None else np.diag(sigma**2), local)


@lru_cache(maxsize=1)
def _odometry_form() -> _Form:
    open_vector, pose = _vector([_OPEN] * 3), _new("geometry_msgs/Pose", _vector([_OPEN] * 3, "Point"), _turn(None))
    pose = _new("geometry_msgs/PoseWithCovariance", pose, np.full(36, _OPEN))
    twist = _new(
        "geometry_msgs/TwistWithCovariance", _new("geometry_msgs/Twist", open_vector, open_vector), np.zeros(36)
    )
    return _Form(_new("nav_msgs/Odometry", _header(_OPEN_NS, ODOMETRY), BODY, pose, twist))


def _odometry(topic: str, motion: Motion, pose: list[float]) -> RosMessage:
    """Return a motion in the estimator's map frame, its `pose` as `_numbers`; NaN: velocity unknown."""
    unknown = [np.nan] * 3
    seen = motion.velocity_world
    velocity = unknown if seen is None else (motion.world_from_body.rotation.T @ seen).tolist()
    numbers = [*pose, *motion.covariance.ravel().tolist(), *velocity, *unknown]
    return _odometry_form().filled(topic, motion.t_ns, _stamp(motion.t_ns), numbers)


@lru_cache(maxsize=8)
def _transforms_form(frames: tuple[tuple[str, str], ...]) -> _Form:
    turn = _new("geometry_msgs/Transform", _vector([_OPEN] * 3), _turn(None))
    found = [_new("geometry_msgs/TransformStamped", _header(_OPEN_NS, a), b, turn) for a, b in frames]
    return _Form(_new("tf2_msgs/TFMessage", found))


def transforms(topic: str, t_ns: int, poses: Mapping[tuple[str, str], Pose]) -> RosMessage:
    """Return transforms of tf; the keys are (parent, child)."""
    return _transforms(topic, t_ns, {frames: _numbers(pose) for frames, pose in poses.items()})


def _transforms(topic: str, t_ns: int, poses: Mapping[tuple[str, str], list[float]]) -> RosMessage:
    runs = chain.from_iterable((_stamp(t_ns), pose) for pose in poses.values())
    return _transforms_form((*poses,)).filled(topic, t_ns, *runs)


def motion_messages(motion: Motion) -> Iterator[RosMessage]:
    """Yield a motion as odometry, its frames as tf, and its state as diagnostics."""
    t_ns, pose = motion.t_ns, _numbers(motion.world_from_body)
    yield _odometry("/motion", motion, pose)
    offset = [0.0] * 3 if motion.offset_world is None else motion.offset_world.tolist()
    yield _transforms("/tf", t_ns, {(WORLD, ODOMETRY): [*offset, 0.0, 0.0, 0.0, 1.0], (ODOMETRY, BODY): pose})
    level = {MotionState.GOOD: 0, MotionState.LOST: 2}.get(motion.state, 1)
    words = f"{motion.state.name.lower()}{f': {motion.why}' if motion.why else ''}"
    values = {"frame_id": motion.frame_id, "tracks": motion.tracks}
    yield diagnostics("/diagnostics", t_ns, "motion", level, words, values)


def map_layers(elevation: ElevationMap, land_cover: TerrainMap | None, hazards: HazardMap | None) -> dict[str, F32]:
    """Return the layers of a map by name, each (R, C) on the grid of the heights; NaN is unknown."""
    trusted, grid = elevation.trusted, elevation.grid
    layers = {"elevation": elevation.height, "sigma": elevation.relative_sigma}
    layers = {name: np.where(trusted, values, np.float32(np.nan)) for name, values in layers.items()}
    if hazards is not None:
        layers["p_safe"] = _on(grid, hazards.grid, hazards.p_safe)
    if land_cover is not None:
        label = land_cover.label
        cover = np.where(label == Terrain.UNKNOWN, np.float32(np.nan), label)
        layers["land_cover"] = _on(grid, land_cover.grid, cover)
    return {name: values.astype(np.float32, copy=False) for name, values in layers.items()}


def _on(grid: Grid, own: Grid, values: F32) -> F32:
    """Return values on the grid `own` on another, of the nearest cells; NaN: outside."""
    return values if own == grid else own.nearest_on(grid, values, np.nan)


def grid_map(topic: str, t_ns: int, grid: Grid, layers: Mapping[str, F32]) -> RosMessage:
    """Return a map as grid_map_msgs/GridMap. Its first index counts from east to west, its second from north to south.

    Args:
        layers: (R, C) by name, NaN = unknown; the first decides which cells are valid.
    """
    half = grid.cell / 2
    middle = np.array([grid.east + half * (grid.cols - 1), grid.north - half * (grid.rows - 1), 0.0])
    lengths = grid.cell * grid.cols, grid.cell * grid.rows
    info = _new("grid_map_msgs/GridMapInfo", grid.cell, *lengths, _pose(Pose(np.eye(3), middle)))
    dimensions = [
        _new("std_msgs/MultiArrayDimension", "column_index", grid.rows, grid.rows * grid.cols),
        _new("std_msgs/MultiArrayDimension", "row_index", grid.cols, grid.cols),
    ]
    layout = _new("std_msgs/MultiArrayLayout", dimensions, 0)
    data = [_new("std_msgs/Float32MultiArray", layout, v[:, ::-1].ravel()) for v in layers.values()]
    names = [*layers]
    return _encoded(
        topic, t_ns, _new("grid_map_msgs/GridMap", _header(t_ns, WORLD), info, names, names[:1], data, 0, 0)
    )  # fmt: skip


def _approach(position_world: F64, heading: float) -> Any:
    """Return the pose of a vehicle that looks into a heading, rad clockwise from north; NaN: east."""
    half = 0.0 if math.isnan(heading) else math.pi / 4 - heading / 2
    turn = _vector((0.0, 0.0, math.sin(half), math.cos(half)), "Quaternion")
    return _new("geometry_msgs/Pose", _vector(position_world.tolist(), "Point"), turn)


def _poses(topic: str, t_ns: int, poses: Sequence[Any]) -> RosMessage:
    return _encoded(topic, t_ns, _new("geometry_msgs/PoseArray", _header(t_ns, WORLD), poses))


def route_poses(topic: str, t_ns: int, route: Route) -> RosMessage:
    """Return the way-points of a route as poses, in order."""
    return _poses(topic, t_ns, [_approach(w.position_world, w.heading) for w in route.waypoints])


def sites_messages(topic: str, t_ns: int, sites: Sites) -> Iterator[RosMessage]:
    """Yield sites and candidates in order of rank: as markers with P(safe) in words, and as poses."""
    delete_all, cylinder, words = 3, 3, 9
    whole, white = _vector([1.0] * 3), _new("std_msgs/ColorRGBA", *[1.0] * 4)
    markers = [_marker(t_ns, (delete_all, 0, 0), _approach(np.zeros(3), math.nan), whole, white)]
    poses = [_approach(s.position_world, s.heading) for s in sites.listed]
    for site, pose in zip(sites.listed, poses, strict=True):
        colour = _new("std_msgs/ColorRGBA", *(v / 255 for v in rgb(COLOURS[site.kind])), 1.0)
        label = f"{site.kind} {site.rank}: P(safe) {p_safe_text(site.p_safe)}"
        markers.append(_marker(t_ns, (0, cylinder, site.rank), pose, _disc(site), colour))
        markers.append(_marker(t_ns, (0, words, site.rank), pose, whole, white, label))
    yield _encoded(topic, t_ns, _new("visualization_msgs/MarkerArray", markers))
    yield _poses(f"{topic}/poses", t_ns, poses)


def _disc(site: Site) -> Any:
    """Return the size of a site's marker: a flat disc of its free radius, metres."""
    width = 1.0 if math.isnan(site.radius) else 2 * float(site.radius)
    return _vector((width, width, width / 50))


@lru_cache(maxsize=1)
def _no_mesh() -> tuple[Any, Any, Any]:
    """Return the texture, mesh and lifetime of a marker that has none."""
    texture = _new("sensor_msgs/CompressedImage", _header(0, ""), "", np.empty(0, np.uint8))
    return texture, _new("visualization_msgs/MeshFile", "", np.empty(0, np.uint8)), _time(0, "Duration")


def _marker(t_ns: int, what: tuple[int, int, int], pose: Any, scale: Any, colour: Any, words: str = "") -> Any:
    """Return a marker; `what`: its action, its type, and its number."""
    action, kind, number = what
    texture, file, always = _no_mesh()
    return _new(
        "visualization_msgs/Marker", _header(t_ns, WORLD), "label" if words else "place", number, kind, action,
        pose, scale, colour, always, False, [], [], "", texture, [], words, "", file, False,
    )  # fmt: skip
