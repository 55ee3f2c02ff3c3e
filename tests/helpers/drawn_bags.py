"""Small bags of ROS 1 and ROS 2, written by rosbags from messages that name only the fields that matter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from alight.records import Event, Frame, ImuSample, NavSample
from alight.runner.opening import open_source
from alight.sources.streams import read_table

GEO_POINT = """std_msgs/Header header
geographic_msgs/GeoPoint position
================================================================================
MSG: geographic_msgs/GeoPoint
float64 latitude
float64 longitude
float64 altitude
"""
PX4 = {
    "VehicleGlobalPosition": "uint64 timestamp\nfloat64 lat\nfloat64 lon\nfloat32 alt\nfloat32 alt_ellipsoid\n"
    "float32 eph\nfloat32 epv\n",
    "VehicleAttitude": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n",
    "VehicleLocalPosition": "uint64 timestamp\nfloat32 vx\nfloat32 vy\nfloat32 vz\nfloat32 evh\nfloat32 evv\n",
    "SensorCombined": "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n",
}
FORMATS = ("ros1", "sqlite3", "mcap")


class Drawn(NamedTuple):
    """One message to write."""

    topic: str
    type: str  # such as sensor_msgs/msg/Imu
    t_ns: int  # time of arrival
    fields: dict[str, Any]  # by name; nested in dictionaries; others are zero

    def with_fields(self, new: dict[str, Any]) -> Drawn:
        """This message with some fields changed."""
        return self._replace(fields=self.fields | new)


def header(t_ns: int, frame: str) -> dict[str, Any]:
    """A header's fields."""
    return {"stamp": {"sec": t_ns // 10**9, "nanosec": t_ns % 10**9}, "frame_id": frame}


def vector(v: Iterable[float], names: str = "xyz") -> dict[str, float]:
    """A vector's or a quaternion's fields."""
    return dict(zip(names, map(float, v), strict=True))


def _store(kind: Stores) -> Any:
    store = get_typestore(kind)
    store.register(get_types_from_msg(GEO_POINT, "geographic_msgs/msg/GeoPointStamped"))
    if "tf2_msgs/msg/TFMessage" not in store.fielddefs:
        transforms = "geometry_msgs/TransformStamped[] transforms\n"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    for name, text in PX4.items():
        store.register(get_types_from_msg(text, f"px4_msgs/msg/{name}"))
    return store


def _message(store: Any, name: str, fields: dict[str, Any]) -> Any:
    """A message of a type with the given fields, zeros elsewhere."""
    zero: dict[str, Any] = {"string": "", "bool": False}
    definition, values = store.fielddefs[name][1], dict[str, Any]()
    names = {n.lower(): n for n, _ in definition}
    given = {names.get(k.lower(), k): v for k, v in fields.items()}
    for field, (kind, of) in definition:
        value = given.pop(field, None)
        if kind == Nodetype.NAME:
            values[field] = _message(store, of, value or {})
        elif kind == Nodetype.BASE:
            values[field] = zero.get(of[0], 0) if value is None else value
        elif of[0][0] == Nodetype.NAME:
            values[field] = [_message(store, of[0][1], v) for v in value or ()]
        else:
            values[field] = np.array(np.zeros(of[1]) if value is None else value, of[0][1][0])
    assert not given, given
    return store.types[name](**values)


def write_bag(path: Path, form: str, messages: Iterable[Drawn]) -> Path:
    """Write a bag in one of `FORMATS`; return what `alight run` is given: a file of ROS 1, a folder of ROS 2."""
    is_ros1 = form == "ros1"
    path = path.with_suffix(".bag") if is_ros1 else path
    store = _store(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=plugin) as out:
        of_topic: dict[str, Any] = {}
        for m in messages:
            if m.topic not in of_topic:
                of_topic[m.topic] = out.add_connection(m.topic, m.type, typestore=store)
            message = _message(store, m.type, m.fields)
            data = (store.serialize_ros1 if is_ros1 else store.serialize_cdr)(message, m.type)
            out.write(of_topic[m.topic], m.t_ns, data)
    return path


def image(topic: str, t_ns: int, frame: str, pixels: Any, **fields: Any) -> Drawn:
    """An uncompressed picture, grey or RGB, unless `fields` have another encoding."""
    depth = 1 if pixels.ndim == 2 else pixels.shape[2]
    own = {"encoding": "mono8" if depth == 1 else "rgb8", "step": pixels.shape[1] * depth}
    size = {"height": pixels.shape[0], "width": pixels.shape[1], "data": pixels.ravel()}
    return Drawn(topic, "sensor_msgs/msg/Image", t_ns, {"header": header(t_ns, frame)} | size | own | fields)


def compressed(topic: str, t_ns: int, frame: str, pixels: Any) -> Drawn:
    """A picture as PNG, which loses nothing."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, "png")
    data = np.frombuffer(file.getvalue(), np.uint8)
    fields = {"header": header(t_ns, frame), "format": "png", "data": data}
    return Drawn(topic, "sensor_msgs/msg/CompressedImage", t_ns, fields)


def transform(t_ns: int, parent: str, child: str, quaternion_wxyz: Any, translation: Any, topic: str) -> Drawn:
    """A transform of /tf or /tf_static."""
    turn = {"rotation": vector(quaternion_wxyz, "wxyz"), "translation": vector(translation)}
    one = {"header": header(t_ns, parent), "child_frame_id": child, "transform": turn}
    return Drawn(topic, "tf2_msgs/msg/TFMessage", t_ns, {"transforms": [one]})


def covariance(sigma: Any, size: int = 3, first: int = 0) -> np.ndarray[Any, Any]:
    """A covariance with the squares of `sigma` on its diagonal from `first`; zeros if they are not known."""
    out = np.zeros((size, size))
    if sigma is not None:
        out[range(first, first + 3), range(first, first + 3)] = np.square(sigma)
    return out.ravel()


def messages_of_flight(flight: Path, picture: Callable[..., Drawn] = image, age_ns: int = 0) -> Iterator[Drawn]:
    """The events of a flight log as a robot would publish them, `age_ns` after their stamps.

    Position, attitude and velocity of GPS/INS have topics of their own; tf has the mountings.
    """
    source = open_source(flight)
    t0 = next(iter(source.events())).t_ns
    origin = {"position": vector((source.local.latitude, source.local.longitude, source.local.height),
                                 ("latitude", "longitude", "altitude"))}  # fmt: skip
    yield Drawn("/gp_origin", "geographic_msgs/msg/GeoPointStamped", t0, {"header": header(t0, "map")} | origin)
    for k, cam in enumerate(source.rig.cameras):
        pose, lens = cam.body_from_cam, cam.camera
        yield transform(t0, "base_link", f"cam{k}", pose.quaternion, pose.translation, "/tf_static")
        info = {"header": header(t0, f"cam{k}"), "width": lens.width, "height": lens.height, "K": lens.K.ravel(),
                "distortion_model": "plumb_bob", "D": lens.coefficients}  # fmt: skip
        yield Drawn(f"/cam{k}/camera_info", "sensor_msgs/msg/CameraInfo", t0, info)
    table = read_table(flight / "mav0", "nav0", source.findings)
    assert table is not None
    rows = dict(zip(table.t_ns.tolist(), table.values, strict=True))
    for event in source.events():
        for m in _of_event(event, rows, picture):
            yield m._replace(t_ns=m.t_ns + age_ns)


def _of_event(event: Event, rows: dict[int, Any], picture: Callable[..., Drawn]) -> Iterator[Drawn]:
    t, head = event.t_ns, header(event.t_ns, "base_link")
    if isinstance(event, Frame):
        for k, pixels in enumerate(event.images):
            if pixels is not None:
                yield picture(f"/cam{k}/image_raw", t, f"cam{k}", np.asarray(pixels))
    elif isinstance(event, ImuSample):
        fields = {"angular_velocity": vector(event.angular_velocity_body),
                  "linear_acceleration": vector(event.specific_force_body),
                  "orientation_covariance": [-1.0, *[0.0] * 8]}  # fmt: skip
        yield Drawn("/imu", "sensor_msgs/msg/Imu", t, {"header": head} | fields)
    elif isinstance(event, NavSample):
        v = rows[t]
        place = vector(v[:3], ("latitude", "longitude", "altitude"))
        known = {"position_covariance": covariance(v[13:16]), "position_covariance_type": 2}
        yield Drawn("/ins/fix", "sensor_msgs/msg/NavSatFix", t, {"header": head} | place | known)
        turn = {"orientation": vector(v[3:7], "wxyz"), "orientation_covariance": covariance(v[16:19]),
                "angular_velocity": vector(v[10:13]),
                "linear_acceleration_covariance": [-1.0, *[0.0] * 8]}  # fmt: skip
        yield Drawn("/ins/imu", "sensor_msgs/msg/Imu", t, {"header": head} | turn)
        twist = {"twist": {"linear": vector(v[7:10])}, "covariance": covariance(v[19:22], 6)}
        fields = {"header": header(t, "map"), "twist": twist}
        yield Drawn("/ins/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped", t, fields)
