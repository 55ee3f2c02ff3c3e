"""A recording of a live run as a source: its events in order of arrival, and its schedule."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Metadata

from alight.arrays import F64, U8
from alight.documents import parse_json
from alight.records import Event, Frame, ImuSample, InputError, NavSample, Rig, Schedule
from alight.records.codec import CAMERAS, FORMAT, HEAD, IMU, NAV, NOTES, SCHEDULE, FlightHead
from alight.settings import Settings
from alight.sources.bags.files import decode
from alight.sources.bags.mcap_file import RawMessage, read_mcap, up_to_damage
from alight.sources.bags.streams import stamp_of
from alight.sources.calibrated_folder import IMU_NOISE
from alight.sources.calibration import why_no_lens
from alight.sources.source import LARGEST, SIGMAS, Source

IMAGE = "sensor_msgs/msg/Image"
DAMAGED = (ValueError, KeyError, TypeError, OverflowError, IndexError, AttributeError)


def _imu(message: Any) -> ImuSample:
    rates, force = message.angular_velocity, message.linear_acceleration
    return ImuSample(
        stamp_of(message), np.array([rates.x, rates.y, rates.z]), np.array([force.x, force.y, force.z])
    )  # fmt: skip


def _nav(tree: dict[str, Any]) -> NavSample:
    values: dict[str, Any] = {
        k: None if v is None else np.array(v, np.float64)[()] for k, v in tree.items() if k != "t_ns"
    }
    return NavSample(int(tree["t_ns"]), **values)


def _frame(tree: dict[str, Any], pictures: dict[str, RawMessage]) -> Frame:
    """Return an exposure from its entry in the list of exposures and the newest pictures by topic."""
    images = list[U8 | None]()
    for k, is_seen in enumerate(tree["images"]):
        message = decode(pictures[f"/cam{k}/image_raw"]) if is_seen else None
        if message is not None and stamp_of(message) != tree["t_ns"]:
            raise ValueError(f"its picture of cam{k} is missing")
        colours = () if message is None or message.encoding == "mono8" else (3,)
        images.append(None if message is None else message.data.reshape(message.height, message.width, *colours).copy())
    return Frame(int(tree["t_ns"]), tuple(images), str(tree["name"]))


def why_unusable(event: Event, rig: Rig) -> str:
    """Return why an event of a recording cannot be used; empty if it can."""
    if not 0 <= event.t_ns < 2**62:
        return "its time is out of range"
    if isinstance(event, Frame):
        sizes = [(c.camera.height, c.camera.width) for c in rig.cameras]
        shapes = [None if image is None else np.shape(np.asarray(image)) for image in event.images]
        fits = len(shapes) == len(sizes) and all(
            shape is None or (shape[:2] == size and shape[2:] in ((), (3,)))
            for shape, size in zip(shapes, sizes, strict=True)
        )
        return "" if fits else "its images are not those of the cameras"
    for f in fields(event):
        value = getattr(event, f.name)
        if f.name == "t_ns" or (value is None and isinstance(event, NavSample)):
            continue
        rotation, sigma = f.name == "world_from_body", f.name.startswith("sigma")
        shape = (3, 3) if rotation else () if f.name == "height_world" else (3,)
        most = SIGMAS[1] if sigma else 1.001 if rotation else LARGEST[f.name]
        if value is None or np.shape(value) != shape or not (np.abs(value) <= most).all():
            return f"{f.name} is out of range"
        if sigma and (value < SIGMAS[0]).any():
            return f"{f.name} is out of range"
    R = event.world_from_body if isinstance(event, NavSample) else None
    return "" if R is None or _is_rotation(R) else "world_from_body is no rotation"


def _is_rotation(R: F64) -> bool:
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 1e-3)


def _read_head(text: str, path: Path) -> FlightHead:
    """Decode the head of the file `path`; raise InputError if its cameras, origin or IMU noise are impossible."""
    try:
        head = FlightHead.from_json(text)
    except InputError as e:
        raise InputError(f"{path}: {e}") from e
    place, noise = head.local, head.imu_noise.stated().values()
    try:
        wrong = [why for c in head.rig.cameras if (why := why_no_lens(c.camera))]
        for camera, at in ((c, c.body_from_cam) for c in head.rig.cameras):
            if not ((np.abs(at.translation) <= LARGEST["lever arm"]).all() and _is_rotation(at.rotation)):
                wrong.append(f"{camera.name} is too far from the body")
        if not (abs(place.latitude) < 90 and abs(place.longitude) <= 360 and abs(place.height) <= LARGEST["height"]):
            wrong.append("its origin is no place on Earth")
        if not all(IMU_NOISE[0] <= v <= IMU_NOISE[1] for v in noise):
            wrong.append("the noise of the IMU is out of range")
    except TypeError as e:  # text in place of numbers
        wrong = [str(e)]
    if wrong or not head.rig.cameras:
        raise InputError(f"{path}: its head is damaged ({(wrong or ['no camera'])[0]}); record again")
    return head


def _schedule(entries: dict[str, list[Any]], kind: str, entry: Any) -> None:
    """Add an `entry` of the schedule (JSON) to the list `kind` in `entries`, and its details to their own lists.

    A damaged entry raises an error and changes no list.
    """
    t_ns, value, place = int(entry["t_ns"]), int(entry["value"]), entry["about"]
    about = None if place is None else (float(place[0]), float(place[1]))
    entries[kind].append(t_ns)
    entries["effort"] += [value] * (kind == "mapped")
    entries["about"] += [about] * (kind == "judged")


class Recording(Source):
    """One recorded flight.

    Raises:
        InputError: the file is not a recording of Alight, or no exposure is left.
    """

    def __init__(self, path: Path, settings: Settings) -> None:
        super().__init__()
        self._path, self._skip, self._every = path, settings.sources.skip, settings.sources.every
        self._found: Counter[str] = Counter()  # number of messages per topic
        head, entries, notes = self._scan()
        frames = self._found[CAMERAS]
        self.length = len(range(self._skip, frames, self._every))
        self.name, self.rig, self.local, self.georeferenced = head.name, head.rig, head.local, head.georeferenced
        self.imu_noise, self.flown_with, self.zones = head.imu_noise, head.settings, head.zones
        self.schedule = Schedule(**{k: tuple(v) for k, v in entries.items()})
        self.notes |= {"cameras": [c.name for c in self.rig.cameras], "focal_from": "the recording"}
        self.notes |= {"in flight": notes} if notes else {}
        if not frames:
            raise InputError(f"{path}: holds no exposure; there is nothing to replay")
        if not self.length:
            raise InputError(f"{path}: no exposure is left; lower sources.skip ({self._skip})")

    def events(self) -> Iterator[Event]:
        """Yield the events in order of arrival."""
        seen, chosen = Counter[str](), range(self._skip, self._found[CAMERAS], self._every)
        pictures = dict[str, RawMessage]()  # the newest by topic
        for m in self._messages():
            if isinstance(m, RawMessage) and m.type.name == IMAGE:
                pictures[m.topic] = m
            if not isinstance(m, RawMessage) or m.topic not in (CAMERAS, NAV, IMU):
                continue
            seen[m.topic] += 1
            if m.topic == CAMERAS and seen[m.topic] - 1 not in chosen:
                continue
            try:
                event = self._event(m, pictures)
                if why := why_unusable(event, self.rig):
                    raise ValueError(why)
            except ValueError as e:
                self._lose(m.topic, seen[m.topic], str(e))
                continue
            yield event

    def _event(self, message: RawMessage, pictures: dict[str, RawMessage]) -> Event:
        try:
            if message.topic == IMU:
                return _imu(decode(message))
            tree = parse_json(decode(message).data)
            return _nav(tree) if message.topic == NAV else _frame(tree, pictures)
        except DAMAGED as e:
            raise ValueError(f"damaged ({e})") from e

    def _lose(self, topic: str, number: int, why: str) -> None:
        self.findings.lose(f"{topic[1:]} messages", f"number {number} of {self._found[topic]}", why)

    def _scan(self) -> tuple[FlightHead, dict[str, list[Any]], list[str]]:
        """Return the head, the schedule's lists by field name, and the notes; count the messages by topic."""
        head, notes, damaged = None, list[str](), list[tuple[str, int, str]]()
        entries: dict[str, list[Any]] = {k: [] for k in Schedule.__dataclass_fields__}
        for m in self._messages():
            if not isinstance(m, RawMessage):
                if m.metadata.get("format") != FORMAT:
                    raise InputError(f"{self._path}: is a recording of another version of Alight; record again")
                head = _read_head(m.metadata["head"], self._path)
                continue
            self._found[m.topic] += 1
            try:
                if m.topic == NOTES:
                    line = decode(m)
                    notes.append(f"{line.name}: {line.msg}")
                elif m.topic == SCHEDULE and (kind := str((entry := parse_json(decode(m).data))["kind"])) in entries:
                    _schedule(entries, kind, entry)
            except DAMAGED as e:
                damaged.append((m.topic, self._found[m.topic], f"damaged ({e})"))
        for message in damaged:
            self._lose(*message)
        self.findings.counts |= {f"{t[1:]} messages": self._found[t] for t in (CAMERAS, NAV, IMU) if self._found[t]}
        if head is None:
            raise InputError(f"{self._path}: no recording of Alight; give one that 'alight live' made")
        return head, entries, notes

    def _messages(self) -> Iterator[RawMessage | Metadata]:
        """Yield the head and every message; if the file ends early, warn and stop."""
        early = "the recording ends early, as after a loss of power: what came before it is used"
        warn = partial(self.findings.warn, early)
        yield from up_to_damage(self._own(), self._path, "no recording of Alight and no ROS bag (MCAP)", warn)

    def _own(self) -> Iterator[RawMessage | Metadata]:
        with self._path.open("rb") as file:
            yield from (m for m in read_mcap(file) if isinstance(m, RawMessage) or m.name == HEAD)
