"""What a flight knew at each of its motions, read from its recording, or from the folder of a run without one."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Metadata

from alight.arrays import F32, F64, U8
from alight.documents import parse_json
from alight.geometry import Grid, Pose
from alight.outputs.export import FinishedRun, ros2
from alight.outputs.ros_messages import COLOURS
from alight.records import InputError, Rig
from alight.records.codec import HEAD, LANDING, NOTES, ORDERS, FlightHead
from alight.report.paint import rgb
from alight.sources.bags.files import decode
from alight.sources.bags.mcap_file import RawMessage, read_mcap, up_to_damage
from alight.sources.bags.streams import stamp_of

log = logging.getLogger(__name__)


class ShownPlace(NamedTuple):
    """A site or candidate of the newest verdict."""

    label: str  # kind, rank and P(safe)
    position: F64  # (3,) metres, world
    radius: float  # metres that are free about it

    @property
    def colour(self) -> tuple[int, int, int]:
        """Red, green, blue of its kind, as in the recording."""
        return rgb(COLOURS[self.label.split()[0]])


class ShownMap(NamedTuple):
    """The newest map."""

    grid: Grid
    layers: dict[str, F32]  # (R, C) by name, NaN = unknown


@dataclass(frozen=True, eq=False)
class Moment:
    """What was known when a motion had been estimated; all in the world."""

    t_ns: int = 0
    pose: Pose = field(default_factory=Pose)  # world_from_body
    covariance: F64 = field(default_factory=lambda: np.full((6, 6), np.nan))  # of the motion: position, rotation
    picture: U8 | None = None  # (H, W) or (H, W, 3) of the first camera
    places: tuple[ShownPlace, ...] = ()
    map: ShownMap | None = None
    route: F64 = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3) metres
    lines: tuple[str, ...] = ()  # decisions and notes so far
    numbers: dict[str, float] = field(default_factory=dict)  # newest value of each time series


class ShownFlight:
    """A flight to look at.

    Args:
        out: folder of a finished run.
        recording: recording of the flight; None: `recording.mcap` of the folder, if it has one.

    Raises:
        InputError: the folder holds no finished run.
    """

    def __init__(self, out: Path, recording: Path | None = None) -> None:
        self.found = FinishedRun(out)
        self._recording = recording or out / "recording.mcap"
        self.name = str(self.found.run.info.get("input", {}).get("name", out.name))

    @cached_property
    def rig(self) -> Rig | None:
        """The cameras; None: there is no recording."""
        heads = (m for m in self._messages() if isinstance(m, Metadata))
        head = next(heads, None) if self._recording.is_file() else None
        return None if head is None else FlightHead.from_json(head.metadata["head"]).rig

    def moments(self) -> Iterator[Moment]:
        """Yield what was known, motion by motion.

        Raises:
            InputError: the run has neither a recording nor a trajectory.
        """
        now, pictures, empty = Moment(), dict[int, RawMessage](), True
        for m in self._messages():
            if not isinstance(m, RawMessage):
                continue
            if m.topic == "/cam0/image_raw":
                pictures = {**dict(list(pictures.items())[-20:]), stamp_of(decode(m)): m}
                continue
            try:
                now = _after(now, m)
            except (ValueError, KeyError, IndexError, TypeError, AttributeError) as e:
                log.warning("%s: a message is damaged (%s)", m.topic, e)
                continue
            if m.topic == "/tf":
                empty = False
                image = pictures.get(now.t_ns)
                yield now if image is None else replace(now, picture=_picture(decode(image)))
        if empty:
            raise InputError(f"{self.found.folder}: has neither a recording nor a trajectory; there is nothing to show")

    def _messages(self) -> Iterator[RawMessage | Metadata]:
        if not self._recording.is_file():
            yield from read_mcap(BytesIO(ros2(self.found)))
            return
        with self._recording.open("rb") as file:
            own = (m for m in read_mcap(file) if isinstance(m, RawMessage) or m.name == HEAD)
            yield from up_to_damage(own, self._recording, "no recording of Alight", lambda: None)


def _after(now: Moment, m: RawMessage) -> Moment:
    """Return what is known after a message."""
    if m.topic == "/motion":
        covariance = np.array(decode(m).pose.covariance).reshape(6, 6)
        sigma = float(np.sqrt(np.trace(covariance[:3, :3])))
        return replace(now, covariance=covariance, numbers=now.numbers | {"position_sigma": sigma})
    if m.topic == "/tf":
        offset, body = decode(m).transforms
        pose = _pose(offset.transform.translation, offset.transform.rotation) @ _pose(
            body.transform.translation, body.transform.rotation
        )
        return replace(now, t_ns=stamp_of(body), pose=pose, numbers=now.numbers | {"up": float(pose.translation[2])})
    if m.topic == "/sites":
        return _judged(now, decode(m).markers)
    if m.topic == "/map":
        return replace(now, map=_map(decode(m)))
    if m.topic == "/route":
        return replace(now, route=np.array([_vector(p.position) for p in decode(m).poses]).reshape(-1, 3))
    if m.topic == "/diagnostics":
        return replace(now, numbers=now.numbers | dict(_numbers(decode(m).status[0])))
    line = _line(m)
    return replace(now, lines=(*now.lines, line)) if line and line not in now.lines[-1:] else now


def _line(m: RawMessage) -> str:
    if m.topic == LANDING:
        return str(parse_json(decode(m).data)["line"])
    if m.topic in (NOTES, ORDERS):
        message = decode(m)
        return f"{message.name}: {message.msg}" if m.topic == NOTES else ""
    return ""


def _judged(now: Moment, markers: Any) -> Moment:
    discs = [m for m in markers if m.ns == "place" and m.action == 0]
    labels = [m for m in markers if m.ns == "label"]
    places = tuple(
        ShownPlace(label.text, _vector(disc.pose.position), disc.scale.x / 2)
        for disc, label in zip(discs, labels, strict=True)
    )
    best = float(places[0].label.split()[-1]) if places else math.nan
    return replace(now, places=places, numbers=now.numbers | {"p_safe": best})


def _numbers(status: Any) -> Iterator[tuple[str, float]]:
    values = {pair.key: pair.value for pair in status.values}
    if status.name == "motion":
        yield "tracks", float(values["tracks"])
    elif values.get("battery", "None") != "None":
        yield "battery", float(values["battery"])


def _map(message: Any) -> ShownMap:
    """Return a GridMap as Alight writes it: the reverse of `outputs.ros_messages.grid_map`."""
    info, (rows, cols) = message.info, (d.size for d in message.data[0].layout.dim)
    half, middle = info.resolution / 2, info.pose.position
    grid = Grid(middle.x - half * (cols - 1), middle.y + half * (rows - 1), info.resolution, rows, cols)
    layers = [np.asarray(d.data, np.float32).reshape(rows, cols)[:, ::-1] for d in message.data]
    return ShownMap(grid, dict(zip(message.layers, layers, strict=True)))


def _vector(v: Any) -> F64:
    return np.array([v.x, v.y, v.z])


def _pose(place: Any, turn: Any) -> Pose:
    return Pose.from_quaternion([turn.w, turn.x, turn.y, turn.z], _vector(place))


def _picture(message: Any) -> U8:
    colours = () if message.encoding == "mono8" else (3,)
    return np.asarray(message.data, np.uint8).reshape(message.height, message.width, *colours)
