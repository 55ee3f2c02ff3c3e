"""Encode the records of a recording as bytes, and decode them, bit for bit (docs/formats/recording.md).

Numbers are JSON decimals, which restore the same bits. Pictures are raw bytes after a JSON head.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from alight.arrays import U8
from alight.documents import parse_json
from alight.geometry import Camera, LocalFrame, Pose
from alight.records.errors import InputError
from alight.records.events import Event, Frame, ImuSample, NavSample, Rig, RigCamera
from alight.settings import ImuNoise, Settings, settings_of_run

CAMERAS, NAV, IMU = "/cameras", "/nav", "/imu"  # topics of the input
SCHEDULE, NOTES, MOTION, SITES = "/schedule", "/notes", "/motion", "/sites"  # topics of the run
TELEMETRY, ORDERS, LANDING = "/telemetry", "/orders", "/landing"  # topics of a landing in flight
_HEAD = struct.Struct("<I")
_DAMAGED = (ValueError, KeyError, TypeError, struct.error, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True, eq=False)
class FlightHead:
    """Head of a recording: facts about the flight, written before the first event."""

    name: str
    rig: Rig
    local: LocalFrame
    georeferenced: bool
    imu_noise: ImuNoise
    settings: Settings

    def to_json(self) -> str:
        """Encode the head as JSON."""
        cameras = [
            {
                "name": c.name,
                "lens": asdict(c.camera),
                "rotation": c.body_from_cam.rotation.tolist(),
                "translation": c.body_from_cam.translation.tolist(),
            }
            for c in self.rig.cameras
        ]
        return json.dumps(
            {
                "name": self.name, "cameras": cameras, "origin": asdict(self.local),
                "georeferenced": self.georeferenced, "imu_noise": asdict(self.imu_noise),
                "settings": self.settings.model_dump(mode="json"),
            }
        )  # fmt: skip

    @classmethod
    def from_json(cls, text: str) -> FlightHead:
        """Decode the head from JSON.

        Raises:
            InputError: the head is damaged, or of another version.
        """
        try:
            tree = parse_json(text)
            cameras = tuple(
                RigCamera(
                    str(c["name"]),
                    Camera(**{**c["lens"], "distortion": tuple(c["lens"]["distortion"])}),
                    Pose(np.array(c["rotation"], float), np.array(c["translation"], float)),
                )
                for c in tree["cameras"]
            )
            return cls(
                str(tree["name"]), Rig(cameras), LocalFrame(**tree["origin"]), bool(tree["georeferenced"]),
                ImuNoise(**tree["imu_noise"]), settings_of_run(tree["settings"]),
            )  # fmt: skip
        except _DAMAGED as e:
            raise InputError(f"the recording's head is damaged or of another version ({e}); record again") from e


def pack(event: Event) -> tuple[str, list[bytes | memoryview]]:
    """Return the topic of an event, and its bytes in parts."""
    if isinstance(event, Frame):
        arrays = [None if i is None else np.ascontiguousarray(i) for i in event.images]
        head = json.dumps(
            {"t_ns": event.t_ns, "name": event.name, "shapes": [None if a is None else a.shape for a in arrays]}
        ).encode()
        return CAMERAS, [_HEAD.pack(len(head)), head, *(a.data.cast("B") for a in arrays if a is not None)]
    topic = NAV if isinstance(event, NavSample) else IMU
    return topic, [json.dumps(vars(event), default=lambda array: array.tolist()).encode()]


def unpack(topic: str, data: bytes) -> Event:
    """Decode an event from its topic and its bytes.

    Raises:
        ValueError: the bytes are damaged.
    """
    try:
        if topic == CAMERAS:
            return _frame(data)
        tree = parse_json(data)
        values: dict[str, Any] = {
            k: None if v is None else np.array(v, np.float64) for k, v in tree.items() if k != "t_ns"
        }
        kind: type[NavSample | ImuSample] = NavSample if topic == NAV else ImuSample
        return kind(int(tree["t_ns"]), **values)
    except _DAMAGED as e:
        raise ValueError(f"damaged ({e})") from e


def _frame(data: bytes) -> Frame:
    (size,) = _HEAD.unpack_from(data)
    at = _HEAD.size + size
    head: Mapping[str, Any] = parse_json(data[_HEAD.size : at])
    images = list[U8 | None]()
    for shape in head["shapes"]:
        if shape is None:
            images.append(None)
            continue
        count = int(np.prod(shape))
        images.append(np.frombuffer(data, np.uint8, count, at).reshape(shape).copy())  # writable, like camera images
        at += count
    return Frame(int(head["t_ns"]), tuple(images), str(head["name"]))
