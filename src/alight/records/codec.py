"""The head of a recording as JSON, bit for bit, and the names of its topics (docs/formats/recording.md)."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import shapely

from alight.documents import parse_json
from alight.geometry import Camera, LocalFrame, Pose
from alight.records.errors import InputError
from alight.records.events import Rig, RigCamera
from alight.records.zones import NO_ZONES, GroundZone, ZonesOnPlane
from alight.settings import ImuNoise, Settings, settings_of_run

HEAD, FORMAT = "alight", "ros2"  # name of the metadata of a recording, and what its messages are
CAMERAS, NAV, IMU = "/cameras", "/nav", "/imu"  # topics of the input; the pictures have topics of their own
SCHEDULE, NOTES = "/schedule", "/notes"  # topics of the run that are read back
ORDERS, LANDING = "/orders", "/landing"  # topics of a landing in flight
_DAMAGED = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, shapely.GEOSException)


@dataclass(frozen=True, eq=False)
class FlightHead:
    """Head of a recording: facts about the flight, written before the first event."""

    name: str
    rig: Rig
    local: LocalFrame
    georeferenced: bool
    imu_noise: ImuNoise
    settings: Settings
    zones: ZonesOnPlane = NO_ZONES  # zones of the user, in the world

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
                "zones": [{**vars(z), "shape": shapely.to_wkb(z.shape, hex=True)} for z in self.zones.zones],
                "zones_note": self.zones.note,
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
                ImuNoise(**tree["imu_noise"]), settings_of_run(tree["settings"]), _zones(tree),
            )  # fmt: skip
        except _DAMAGED as e:
            raise InputError(f"the recording's head is damaged or of another version ({e}); record again") from e


def _zones(tree: dict[str, Any]) -> ZonesOnPlane:
    """Return the zones of a head; a recording of an earlier version has none."""
    zones = (GroundZone(**{**z, "shape": shapely.from_wkb(z["shape"])}) for z in tree.get("zones", ()))
    return ZonesOnPlane(tuple(zones), str(tree.get("zones_note", "")))
