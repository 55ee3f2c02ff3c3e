"""A ROS bag as a source: its streams become those of a flight log, and are judged in the same way."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F64, I64, U8
from alight.geometry import Camera, LocalFrame, Pose
from alight.records import Frame, InputError, Rig, RigCamera
from alight.settings import Settings
from alight.sources.bags.choice import choose_topics
from alight.sources.bags.files import messages_of
from alight.sources.bags.growth import Growth
from alight.sources.bags.images import is_rectified, lens_of, pixels_of, rectified_from_camera
from alight.sources.bags.streams import INFO, TopicStream, decoded, read_streams, stamp_of
from alight.sources.calibration import load_yaml, read_camchain
from alight.sources.flight_log import Exposure, FlightLog
from alight.sources.logged_stream import LoggedStream, attitude_at
from alight.sources.source import LARGEST
from alight.sources.streams import LATE_NS, StreamRow, Table, ordered_rows

KALIBR = "set sources.calibration to Kalibr's camchain.yaml"
Waiting = dict[tuple[int, str], tuple[int, Any]]  # by camera and name: time of arrival [ns] and message


class BagFlight(FlightLog):
    """One flight in a bag of ROS 1 or ROS 2.

    Args:
        path: name of the bag as the user gave it.
        files: its files in order.
        topics: topics by role, empty for none; those of other roles are chosen.

    Raises:
        InputError: the bag has no pictures or no calibration, or it is not clear which topics to use.
    """

    growth: Growth | None = None  # how its files grow; None: they are complete
    no_place = "the bag has no GPS (NavSatFix): heights and places are relative, and nothing can be put on a map"

    def __init__(self, path: Path, files: Sequence[Path], settings: Settings, topics: Mapping[str, str]) -> None:
        self._files, self._settings, self._given = files, settings, topics
        super().__init__(path, settings)
        self.notes["log"] = [f"topics: {self._topics}"]

    def _read_origin(self) -> LocalFrame | None:
        """Read the whole bag; return the origin that it states, else its first position; None: no place on Earth."""
        self._streams, self._tree = read_streams(self._files, self.findings, self.growth)
        try:
            self._topics = choose_topics(self._streams, self._tree, self._given, self._calibrated())
        except InputError as e:
            raise InputError(f"{self._root}: {e}") from e
        self._compare_clocks()
        if (position := self._topics.position) is None or not position.has("place"):
            return None
        stated = [s for s in self._streams.values() if "GeoPoint" in s.type and s.has("place")]
        places = np.concatenate([s.part("place") for s in stated] + [self._places(position)])
        places = places[(np.abs(places) < [90.0, 360.0, LARGEST["height"]]).all(axis=1)]
        return LocalFrame(*places[0].tolist()) if len(places) else None

    def _calibrated(self) -> list[str]:
        """Return the topics of the first two cameras in Kalibr's file; empty if there is no file."""
        if (given := self._settings.sources.calibration) is None:
            return []
        cameras = [c for _, c in sorted(load_yaml(Path(given).expanduser()).items()) if isinstance(c, dict)]
        return [str(c.get("rostopic", "")) for c in cameras][:2]

    def _compare_clocks(self) -> None:
        """Compare stamps with times of arrival; a stream on another clock than the pictures is moved to theirs."""
        t = self._topics
        used = list(dict.fromkeys(s for s in (*t.cameras, t.position, t.attitude, t.velocity, t.imu) if s))
        for stream in used:
            ages = stream.ages_ns
            if len(ages) > 1 and not np.diff(stream.t_ns).any():
                stream.stamped = False
                self.findings.warn(f"{stream.topic} has no stamps: its times of arrival are used")
            elif (jump := int(np.ptp(ages))) > LATE_NS:
                self.findings.contradict(
                    f"{stream.topic}: stamps and times of arrival drift apart by {1e-9 * jump:.1f} s, as after a jump "
                    "of a clock"
                )
        first, last = t.left.t_ns.min(), t.left.t_ns.max()
        for stream in used[1:]:
            apart = int(stream.ages_ns.min() - t.left.ages_ns.min())
            if not (stream.stamped and t.left.stamped) or abs(apart) <= LATE_NS:
                continue
            if stream.t_ns.max() < first or stream.t_ns.min() > last:
                stream.shift_ns = apart
            self.findings.contradict(
                f"{stream.topic} comes {1e-9 * apart:+.3f} s after {t.left.topic} of the same stamp, by another clock "
                f"or late: {'that is added to its stamps' if stream.shift_ns else 'its stamps are used as they are'}; "
                "alight check shows what remains"
            )

    def _read_imu_pose(self) -> Pose:
        imu, body = self._topics.imu, self._topics.body
        if imu is None or imu.frame == body or imu.type.startswith("px4"):
            return Pose()
        if not imu.frame:
            self.findings.warn(f"{imu.topic} names no frame: that of the body, {body}, is taken")
            return Pose()
        if (pose := self._tree.between(body, imu.frame)) is None:
            raise InputError(
                f"{self._root}: tf does not connect {imu.frame!r} of {imu.topic} with {body!r}; add that transform, or "
                "leave the IMU out: --topic imu="
            )
        return pose

    def _read_rig(self, settings: Settings) -> Rig:
        given = settings.sources.calibration
        path = Path(given or "CameraInfo").expanduser()
        self.notes["focal_from"] = f"Kalibr {path.name}" if given else path.name
        has_mounting = given is not None and "T_cam_imu" in dict(load_yaml(path).get("cam0") or {})
        cameras = [self._camera(f"cam{k}", s, given is None, has_mounting) for k, s in enumerate(self._topics.cameras)]
        rig = Rig(tuple(cameras))
        return read_camchain(path, rig, self._body_from_imu) if given else rig

    def _camera(self, name: str, stream: TopicStream, by_info: bool, has_mounting: bool) -> RigCamera:
        """Return a camera by tf and, if `by_info`, by CameraInfo, else with a stand-in for its lens.

        `has_mounting`: whether Kalibr's file gives the mounting, so that it may be missing in tf.
        """
        mounting = self._tree.between(self._topics.body, stream.frame)
        if mounting is None and not has_mounting:
            raise InputError(
                f"{self._root}: tf does not connect {stream.frame!r} of {stream.topic} with {self._topics.body!r}; "
                f"{KALIBR} with T_cam_imu"
            )
        mounting, (width, height) = mounting or Pose(), stream.size
        if not by_info:
            return RigCamera(name, Camera(width, height, width, width, width / 2, height / 2), mounting)
        info, rectified = self._info(stream), is_rectified(stream.topic)
        lens = lens_of(info.info, rectified, stream.size, f"{self._root}: {info.topic}: ", KALIBR)
        return RigCamera(name, lens, mounting @ rectified_from_camera(info.info).inverse if rectified else mounting)

    def _info(self, stream: TopicStream) -> TopicStream:
        """Return the stream of CameraInfo of the pictures: of their namespace, else the only one of their frame."""
        infos = [s for s in self._streams.values() if s.type == INFO and s.info is not None]
        spaces = [stream.topic.rsplit("/", depth)[0] for depth in (1, 2)]
        beside = [s for space in spaces for s in infos if s.topic == f"{space}/camera_info"]
        same = [s for s in infos if s.frame == stream.frame]
        if not beside and len(same) != 1:
            raise InputError(f"{self._root}: no CameraInfo with a calibration belongs to {stream.topic}; {KALIBR}")
        return (beside or same)[0]

    def _stream(self, cam: str) -> TopicStream:
        return self._topics.cameras[int(cam.removeprefix("cam"))]

    def _stamps(self, cam: str) -> F64:
        return self._stream(cam).t_ns.astype(np.float64)

    def _where(self, stream: str, file: str = "") -> str:
        return f"{self._root}: {self._stream(stream).topic if stream.startswith('cam') else stream}"

    def _ordered(self, stream: TopicStream, group: str) -> tuple[I64, I64]:
        """Return times in order, (N,) ns, and the indices of their messages; others are recorded as lost."""
        t_ns = stream.t_ns
        self.findings.expect(group, len(t_ns))
        rows = [StreamRow(k + 1, t, []) for k, t in enumerate(t_ns.tolist())]
        at = np.array([row.line - 1 for row in ordered_rows(rows, group, self.findings)], np.int64)
        return t_ns[at], at

    def _logged(self, stream: TopicStream | None, *parts: str) -> LoggedStream:
        """Return the parts of a stream side by side, in order; without the rows that lack the first part."""
        if stream is None:
            return LoggedStream(values=np.empty((0, 3 * len(parts) + ("attitude" in parts))))
        t_ns, at = self._ordered(stream, f"{stream.topic} messages")
        known = np.asarray(np.isfinite(stream.part(parts[0])[at]).all(axis=1))
        return LoggedStream("", t_ns, np.concatenate([stream.part(p)[at] for p in parts], axis=1)).where(known)

    def _table(self, stream: str) -> Table | None:
        if stream == "nav0":
            return self._nav_table()
        if (imu := self._topics.imu) is None:
            return None
        t_ns, at = self._ordered(imu, "imu0 rows")
        return Table(t_ns, np.concatenate([imu.part("rates"), imu.part("force")], axis=1)[at], (at + 1).tolist())

    def _nav_table(self) -> Table | None:
        """Return rows at the times of the positions; attitude and velocity are interpolated where others are near."""
        if (position := self._topics.position) is None:
            return None
        t_ns, at = self._ordered(position, "nav0 rows")
        attitude = self._logged(self._topics.attitude, "attitude", "sigma_attitude", "rates")
        velocity = self._logged(self._topics.velocity, "velocity", "sigma_velocity").at(t_ns)
        turned = attitude.at(t_ns)
        rates = turned[:, 7:]
        if not np.isfinite(rates).any():
            rates = self._logged(self._topics.imu, "rates").at(t_ns) @ self._body_from_imu.rotation.T
        values = np.concatenate([
            self._places(position)[at], attitude_at(LoggedStream("", attitude.t_ns, attitude.values[:, :4]), t_ns),
            velocity[:, :3], rates, position.part("sigma_place")[at], turned[:, 4:7], velocity[:, 3:],
        ], axis=1)  # fmt: skip
        return Table(t_ns, values, (at + 1).tolist())

    def _places(self, position: TopicStream) -> F64:
        """Return latitude, longitude [degrees] and height above the ellipsoid [m], (N, 3)."""
        if not position.has("place"):
            return np.stack(self.local.to_geodetic(position.part("local")), axis=-1)
        places, separation = position.part("place").copy(), self._settings.sources.separation
        if separation is not None and position.has("sea_level"):
            places[:, 2] = position.part("sea_level")[:, 0] + separation
        return places

    def _images(self, cam: str) -> list[tuple[int, str]]:
        """Return (ns, name) of the messages of a camera; the name is their time."""
        return [(t, str(t)) for t in self._ordered(self._stream(cam), f"{cam} images")[0].tolist()]

    def _size_of(self, cam: str, name: str) -> tuple[int, int]:
        return self._stream(cam).size

    def _frames(self) -> Iterator[Frame]:
        """Read the bag again and yield its exposures; an image waits for those that arrive up to `LATE_NS` later."""
        number = {s.topic: k for k, s in enumerate(self._topics.cameras)}
        due, waiting = deque(self._exposures), Waiting()
        wanted = {(k, name) for e in due for k, name in enumerate(e.names) if name}
        messages = messages_of(self._files, lambda topic, _: topic in number, self.findings)
        for raw, image in decoded(messages, self.findings):
            k = number[raw.topic]
            key = k, str(self._topics.cameras[k].time_of(stamp_of(image), raw.t_ns))
            if key in wanted:
                wanted.remove(key)
                waiting[key] = raw.t_ns, image
            while due and waiting and (
                all(n is None or (k, n) in waiting for k, n in enumerate(due[0].names))
                or raw.t_ns - min(t for t, _ in waiting.values()) > LATE_NS
            ):  # fmt: skip
                wanted.difference_update(enumerate(due[0].names))
                yield from self._exposed(due.popleft(), waiting)
        for exposure in due:
            yield from self._exposed(exposure, waiting)

    def _exposed(self, exposure: Exposure, waiting: Waiting) -> Iterator[Frame]:
        """Yield the frame of an exposure, if it has an image; its images no longer wait."""
        images: list[U8 | None] = []
        for k, (cam, name) in enumerate(zip(self.rig.cameras, exposure.names, strict=True)):
            images.append(None)
            try:
                if name and (k, name) not in waiting:
                    raise ValueError(f"it arrives more than {1e-9 * LATE_NS:g} s after others")
                if name:
                    images[-1] = pixels_of(waiting.pop((k, name))[1], (cam.camera.width, cam.camera.height))
            except ValueError as e:
                self.findings.lose(f"{cam.name} images", str(name), str(e))
        if any(image is not None for image in images):
            yield Frame(exposure.t_ns, tuple(images), next(n for n in exposure.names if n))
