"""The streams of a bag: stamps, times of arrival and measurements of each topic that Alight understands."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Pose, matrix_from_quaternion, quaternion_from_matrix
from alight.geometry.rotations import ENU_FROM_NED, FRD_FROM_FLU
from alight.sources.bags.files import decode, messages_of
from alight.sources.bags.frame_tree import FrameTree
from alight.sources.bags.growth import Growth
from alight.sources.bags.images import IMAGES, header_of_picture, is_calibrated
from alight.sources.bags.mcap_file import RawMessage
from alight.sources.source import Findings

Parts = dict[str, Sequence[float]]  # measurements of one message, by name
NOT_MEASURED = (np.nan,) * 3


def _vector(v: Any) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def _sigmas(covariance: Any, first: int = 0) -> Sequence[float]:
    """Return 1-sigma of three neighbours, from `first`, of a covariance (9,) or (36,)."""
    values = np.diag(np.reshape(covariance, (3, 3) if len(covariance) == 9 else (6, 6)))[first : first + 3]
    return np.sqrt(values).tolist() if (values >= 0).all() else NOT_MEASURED


def _attitude(q: Any) -> Sequence[float]:
    return (q.w, q.x, q.y, q.z) if abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1.0) < 0.1 else (np.nan,) * 4


def _fix(m: Any) -> Parts:
    sigma = _sigmas(m.position_covariance) if m.position_covariance_type else NOT_MEASURED
    place = (m.latitude, m.longitude, m.altitude) if m.status.status >= 0 else NOT_MEASURED
    return {"place": place, "sigma_place": sigma}


def _imu(m: Any) -> Parts:
    return {  # a covariance that begins with -1: not measured
        "attitude": _attitude(m.orientation) if m.orientation_covariance[0] != -1 else (np.nan,) * 4,
        "sigma_attitude": _sigmas(m.orientation_covariance),
        "rates": _vector(m.angular_velocity) if m.angular_velocity_covariance[0] != -1 else NOT_MEASURED,
        "force": _vector(m.linear_acceleration) if m.linear_acceleration_covariance[0] != -1 else NOT_MEASURED,
    }


def _pose(m: Any) -> Parts:
    return {"local": _vector(m.pose.position), "attitude": _attitude(m.pose.orientation)}


def _pose_with_covariance(m: Any) -> Parts:
    c = m.pose.covariance
    return _pose(m.pose) | {"sigma_place": _sigmas(c), "sigma_attitude": _sigmas(c, 3)}


def _twist(m: Any) -> Parts:
    return {"velocity": _vector(m.twist.linear)}


def _twist_with_covariance(m: Any) -> Parts:
    return _twist(m.twist) | {"sigma_velocity": _sigmas(m.twist.covariance)}


def _odometry(m: Any) -> Parts:
    """Return the parts of an odometry, whose twist is in the axes of the body."""
    parts, turn = _pose_with_covariance(m), np.full((3, 3), np.nan)
    if np.isfinite(parts["attitude"]).all():
        turn = matrix_from_quaternion(parts["attitude"])
    variances = np.reshape(m.twist.covariance, (6, 6))[:3, :3]
    return parts | {
        "velocity": (turn @ _vector(m.twist.twist.linear)).tolist(),
        "sigma_velocity": _sigmas((turn @ variances @ turn.T).ravel()),
        "rates": _vector(m.twist.twist.angular),
    }


def _px4_place(m: Any) -> Parts:
    above = m.alt_ellipsoid if m.alt_ellipsoid not in (0.0, m.alt) else np.nan  # equal: only one is measured
    return {"place": (m.lat, m.lon, above), "sea_level": (m.alt,), "sigma_place": (m.eph, m.eph, m.epv)}


def _px4_attitude(m: Any) -> Parts:
    if abs(np.linalg.norm(m.q) - 1.0) > 0.05:
        return {"attitude": (np.nan,) * 4}
    return {"attitude": quaternion_from_matrix(ENU_FROM_NED @ matrix_from_quaternion(m.q) @ FRD_FROM_FLU).tolist()}


def _px4_velocity(m: Any) -> Parts:
    return {"velocity": (m.vy, m.vx, -m.vz), "sigma_velocity": (m.evh, m.evh, m.evv)}


def _px4_imu(m: Any) -> Parts:
    return {k: (v[0], -v[1], -v[2]) for k, v in (("rates", m.gyro_rad), ("force", m.accelerometer_m_s2))}


def _origin(m: Any) -> Parts:
    return {"place": (m.position.latitude, m.position.longitude, m.position.altitude)}


PARTS: dict[str, Callable[[Any], Parts]] = {  # by type
    "sensor_msgs/msg/NavSatFix": _fix, "sensor_msgs/msg/Imu": _imu, "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose, "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "geometry_msgs/msg/TwistStamped": _twist, "geometry_msgs/msg/TwistWithCovarianceStamped": _twist_with_covariance,
    "geographic_msgs/msg/GeoPointStamped": _origin, "px4_msgs/msg/VehicleGlobalPosition": _px4_place,
    "px4_msgs/msg/VehicleAttitude": _px4_attitude, "px4_msgs/msg/VehicleLocalPosition": _px4_velocity,
    "px4_msgs/msg/SensorCombined": _px4_imu,
}  # fmt: skip
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


def stamp_of(message: Any) -> int:
    """Return the stamp of a message, ns; 0 if it has none."""
    if (header := getattr(message, "header", None)) is not None:
        return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
    return 1000 * int(getattr(message, "timestamp_sample", 0) or getattr(message, "timestamp", 0))  # PX4's


class TopicStream:
    """Stamps and measurements of one topic."""

    def __init__(self, raw: RawMessage, message: Any) -> None:
        self.topic, self.type = raw.topic, raw.type.name
        self.frame = str(getattr(getattr(message, "header", None), "frame_id", "")).lstrip("/")
        self.child = str(getattr(message, "child_frame_id", "")).lstrip("/")
        self.size, self.refused = (0, 0), ""  # of images: width and height; why they cannot be used
        self.info: Any = None  # the first calibration with a focal length, of CameraInfo
        self.shift_ns = 0  # ns, added to the stamps
        self.stamped = True  # whether stamps are used, not times of arrival
        self._stamps, self._arrivals, self._values = array("q"), array("q"), array("d")
        self._columns: dict[str, slice] = {}

    def add(self, raw: RawMessage, message: Any) -> None:
        """Add a message; of an image, only its stamp is kept."""
        stamp = stamp_of(message)
        if not (0 <= raw.t_ns < 2**62 and 0 <= stamp < 2**62):
            raise ValueError("its time is out of range")
        parts = PARTS[self.type](message) if self.type in PARTS else {}
        if self.type == INFO and self.info is None and is_calibrated(message):
            self.info = message
        if self.type in IMAGES and self.size == (0, 0):
            self.size, self.refused = header_of_picture(message)
        if not self._columns:
            at = np.cumsum([0, *map(len, parts.values())]).tolist()
            self._columns = {name: slice(a, b) for name, a, b in zip(parts, at, at[1:], strict=False)}
        self._stamps.append(stamp)
        self._arrivals.append(raw.t_ns)
        for values in parts.values():
            self._values.extend(values)

    def keep_after(self, t_ns: float) -> None:
        """Drop the messages up to a time on the clock of the bag, ns; all must have come in order of time."""
        count = int(np.searchsorted(self.t_ns, t_ns, side="right"))
        del self._values[: count * (len(self._values) // max(len(self._stamps), 1))]
        del self._stamps[:count], self._arrivals[:count]

    def time_of(self, stamp: int, arrival: int) -> int:
        """Return the time of a message on the clock of the bag, ns, from its stamp and its time of arrival, ns."""
        return (stamp if self.stamped else arrival) + self.shift_ns

    @property
    def t_ns(self) -> I64:
        """Times of the messages on the clock of the bag, (N,)."""
        return np.array(self._stamps if self.stamped else self._arrivals, np.int64) + self.shift_ns

    @property
    def ages_ns(self) -> I64:
        """Times of arrival minus stamps, (N,)."""
        return np.array(self._arrivals, np.int64) - np.array(self._stamps, np.int64)

    @property
    def age(self) -> float:
        """Median time from stamp to arrival on the clock of the bag, s."""
        return 1e-9 * (float(np.median(self.ages_ns)) - self.shift_ns)

    @property
    def rate(self) -> float:
        """Messages a second, from the median interval of arrival; 0 of a single message."""
        steps = np.diff(np.array(self._arrivals, np.int64))
        return 1e9 / max(float(np.median(steps)), 1.0) if len(steps) else 0.0

    def part(self, name: str) -> F64:
        """Return measurements by name, (N, D); NaN: not measured. A name that the type lacks gives (N, 3) NaN."""
        at = self._columns.get(name, slice(0, 3))
        if name not in self._columns or not self._stamps:
            return np.full((len(self._stamps), at.stop - at.start), np.nan)
        return np.frombuffer(self._values).reshape(len(self._stamps), -1)[:, at]

    def has(self, name: str) -> bool:
        """Whether a measurement was made at least once."""
        return bool(np.isfinite(self.part(name)).all(axis=1).any())

    @property
    def has_attitude(self) -> bool:
        """Whether an attitude is measured; of an IMU, one that is constant and without sigma is a stand-in."""
        values = self.part("attitude")
        known = values[np.isfinite(values).all(axis=1)]
        is_real = not self.has("force") or (known != known[:1]).any() or (self.part("sigma_attitude") > 0).any()
        return len(known) > 0 and bool(is_real)

    def __str__(self) -> str:
        return f"{self.topic} ({self.rate:.3g} Hz{f', frame {self.frame}' if self.frame else ''})"


def read_streams(
    files: Sequence[Path], findings: Findings, growth: Growth | None = None
) -> tuple[dict[str, TopicStream], FrameTree]:
    """Read a whole bag once; return its streams by topic, and its tree of frames. Damaged messages are lost.

    `growth`: as for `messages_of`.
    """
    streams, frames = dict[str, TopicStream](), FrameTree()
    used = {*PARTS, *IMAGES, *TRANSFORMS, INFO}
    for raw, message in decoded(messages_of(files, lambda topic, name: name in used, findings, growth), findings):
        try:
            if raw.type.name in TRANSFORMS:
                for t in message.transforms:
                    pose = Pose.from_quaternion(_attitude(t.transform.rotation), _vector(t.transform.translation))
                    frames.add(t.header.frame_id, t.child_frame_id, pose)
                continue
            if raw.topic not in streams:
                streams[raw.topic] = TopicStream(raw, message)
            streams[raw.topic].add(raw, message)
        except (ValueError, TypeError, AttributeError, OverflowError) as e:
            findings.lose(f"{raw.topic} messages", f"of {raw.t_ns} ns", str(e))
    return {topic: s for topic, s in streams.items() if len(s.t_ns)}, frames


def decoded(messages: Iterator[RawMessage], findings: Findings) -> Iterator[tuple[RawMessage, Any]]:
    """Yield messages with their decoded forms; damaged ones are recorded as lost."""
    for raw in messages:
        try:
            yield raw, decode(raw)
        except ValueError as e:
            findings.lose(f"{raw.topic} messages", f"of {raw.t_ns} ns", str(e))
