"""A card of photos of which nine in ten are garbage, for bench/garbage.py: nine good ones, and nine more for each."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import alight_sim
from alight_sim.flight import SimulatedFlight

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from damage import dji_tags, write_photo, xmp_packet

SIZE, FIELD = (960, 640), math.radians(73.7)
LINES, PER_LINE, UP = 3, 3, 15.0  # m above the ground
ALONG, ACROSS = 4.0, 7.0  # m between photos, and between lines
GARBAGE = 9  # photos beside each good one
NEAR, FAR = 3.0, 30.0  # m, standard deviation of their places about the good one's
METRE = 1 / 111_000  # degrees of latitude
SHOTS = "shots.json"  # name, place (latitude, longitude, height) and yaw of the good ones

Picture = Callable[[np.ndarray], np.ndarray]
Shot = dict[str, Any]


def _fly(scene: str) -> SimulatedFlight:
    known = alight_sim.read_scene(alight_sim.built_in()[scene])
    flight = known.flight.model_copy(
        update={"pattern": "lawn_mower", "waypoints": None, "lines": LINES, "length": (PER_LINE - 1) * ALONG,
                "spacing": ACROSS, "height": UP, "speed": 4.0}
    )  # fmt: skip
    rig = alight_sim.RigModel.model_validate({"cameras": [{"resolution": SIZE, "field_deg": math.degrees(FIELD)}]})
    return alight_sim.fly(known.model_copy(update={"flight": flight, "rig": rig}), 1)


def _write(path: Path, shot: Shot, minute: int, image: np.ndarray) -> None:
    """Write a photo with the tags of a drone with RTK and a gimbal."""
    latitude, longitude, height = shot["place"]
    focal = 0.5 * SIZE[0] / math.tan(0.5 * FIELD)
    tags = dji_tags(
        AbsoluteAltitude=f"{height:.4f}", RelativeAltitude=f"{UP}", GimbalYawDegree=f"{shot['yaw']:.2f}",
        CalibratedFocalLength=f"{focal}", CalibratedOpticalCenterX=f"{SIZE[0] / 2 - 0.5}",
        CalibratedOpticalCenterY=f"{SIZE[1] / 2 - 0.5}", DewarpData="",
    )  # fmt: skip
    taken = f"2026:01:26 13:{minute:02d}:{shot['second']:02d}"
    write_photo(
        path, place=(latitude, longitude, height), xmp=xmp_packet(tags), size=SIZE, image=Image.fromarray(image),
        photo={36867: taken, 37386: 8.0},
    )  # fmt: skip


def draw_card(scene: str, folder: Path) -> None:
    """Draw the good tenth: three lines of three photos."""
    flown, shots, last = _fly(scene), list[Shot](), None
    for k, t in enumerate(flown.frame_times):
        pose = flown.pose(int(t)) @ flown.rig.cameras[0].body_from_cam
        if last is not None and np.linalg.norm(pose.translation[:2] - last) < 0.99 * ALONG:
            continue
        last, top = pose.translation[:2], -pose.rotation[:, 1]
        place = [float(v) for v in flown.local.to_geodetic(pose.translation)]
        shot = {"name": f"photo_{k:04d}", "place": place, "yaw": math.degrees(math.atan2(top[0], top[1])),
                "second": len(shots)}  # fmt: skip
        _write(folder / f"{shot['name']}.jpg", shot, 0, flown.image(k, 0))
        shots.append(shot)
    (folder / SHOTS).write_text(json.dumps(shots), encoding="utf-8")


def only_good(folder: Path) -> None:
    """Do nothing: garbage is added beside the good photos."""


def _spoil(folder: Path, rng: np.random.Generator, picture: Picture, metres: float) -> None:
    """Put photos beside each good one: another picture, `metres` (1 sigma) away from it, some minutes later."""
    for shot in json.loads((folder / SHOTS).read_text(encoding="utf-8")):
        pixels = np.asarray(Image.open(folder / f"{shot['name']}.jpg"))
        latitude, longitude, height = shot["place"]
        for k in range(1, GARBAGE + 1):
            east, north, up = (float(v) for v in metres * rng.normal(size=3))
            place = [latitude + METRE * north, longitude + METRE * east, height + up]
            _write(folder / f"{shot['name']}_{k}.jpg", shot | {"place": place}, k, picture(pixels))


def noise(folder: Path, rng: np.random.Generator) -> None:
    """Add noise, tagged with places near by."""
    _spoil(folder, rng, lambda pixels: rng.integers(0, 256, pixels.shape, np.uint8), NEAR)


def other(folder: Path, rng: np.random.Generator) -> None:
    """Add mirrored and shifted copies, tagged with places near by: real ground of another place."""

    def picture(pixels: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.roll(pixels[::-1], int(rng.integers(50, 500)), axis=1))

    _spoil(folder, rng, picture, NEAR)


def tags(folder: Path, rng: np.random.Generator) -> None:
    """Add the same pictures, tagged with places that are wrong by 30 m, and with the sigmas of the good ones."""
    _spoil(folder, rng, lambda pixels: pixels, FAR)


KINDS = {"noise": noise, "other": other, "tags": tags}
