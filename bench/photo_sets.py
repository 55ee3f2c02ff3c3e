"""Sets of photos for the photo bench: real ones, and lines that the simulator flies and draws, with their truth.

Photos are drawn with GPS tags of 2 m (1 sigma, drifting) and no other tags than a phone's.
"""

from __future__ import annotations

import math
import os
import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mirafiori_reference import moved, tum_line
from PIL import Image

import alight_sim as simulate
from alight.arrays import F64
from alight.geometry import LocalFrame, Pose
from alight.records import Frame
from alight.runner.opening import open_source
from alight.settings import Settings
from alight_sim.flight import START_NS

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("ALIGHT_DATA", ROOT.parent / "shared" / "data"))
OUT = ROOT / "out" / "bench-photos"
REAL = ("mirafiori", "garfield", "caliterra")
SENSOR = 13.2e-3, 8.8e-3  # metres, of a one-inch sensor
AROUND = 25.0  # m of ground about the lines
FIELD = math.radians(73.7)  # across the picture


@dataclass(frozen=True)
class Drawn:
    """A set of photos drawn by the simulator: lines over a scene."""

    scene: str
    size: tuple[int, int]  # pixels
    lines: int
    per_line: int
    height: float  # metres
    along: float  # overlap
    across: float
    tilt_deg: float = 90.0  # below the horizon

    @property
    def count(self) -> int:
        """Number of photos."""
        return self.lines * self.per_line


DRAWN = {
    "forest": Drawn("forest", (1836, 1224), 3, 6, 37.0, 0.62, 0.62),
    "village": Drawn("village", (1160, 774), 4, 8, 50.0, 0.75, 0.65),
    "long": Drawn("meadow", (1160, 774), 6, 16, 40.0, 0.75, 0.65),
    "apart": Drawn("village", (1160, 774), 4, 6, 50.0, 0.60, 0.60),
    "oblique": Drawn("village", (866, 577), 4, 10, 60.0, 0.75, 0.65, 55.0),
}
FULL = DRAWN | {
    "forest": replace(DRAWN["forest"], size=(3672, 2448)),
    "village": Drawn("village", (4240, 2832), 10, 10, 60.0, 0.8, 0.7),
    "long": replace(DRAWN["long"], size=(1732, 1155), lines=12, per_line=25),
    "apart": replace(DRAWN["apart"], size=(1732, 1155)),
}


def folder_of(name: str, drawn: dict[str, Drawn]) -> Path:
    """The folder of a set's photos; drawn ones are kept from run to run."""
    if name in REAL:
        return DATA / name / "images"
    d = drawn[name]
    folder = OUT / f"{name}-{d.count}x{d.size[0]}x{d.size[1]}"
    if not (folder / "flown.npz").exists():
        shutil.rmtree(folder, ignore_errors=True)
        draw(d, folder)
    return folder / "images"


def draw(what: Drawn, folder: Path) -> None:
    """Fly the lines, write a JPEG with its tags at each place, and the truth beside them."""
    scene = simulate.read_scene(simulate.built_in()[what.scene], 1)
    width, height = what.size
    wide = 2 * what.height * math.tan(0.5 * FIELD)
    step, apart = (1 - what.along) * wide * height / width, (1 - what.across) * wide
    speed, length = 4.0, (what.per_line - 1) * step
    needed = max(length, (what.lines - 1) * apart) + 2 * AROUND
    camera = {"resolution": what.size, "field_deg": math.degrees(FIELD), "tilt_deg": what.tilt_deg}
    flight = scene.flight.model_copy(
        update={
            "pattern": "lawn_mower", "waypoints": None, "lines": what.lines, "length": length,
            "spacing": apart, "height": what.height, "speed": speed,
        }
    )  # fmt: skip
    scene = scene.model_copy(
        update={
            "flight": flight,
            "rig": simulate.RigModel.model_validate({"cameras": [camera]}),
            "ground": scene.ground.model_copy(update={"size": tuple(max(s, needed) for s in scene.ground.size)}),
            "imaging": scene.imaging.model_copy(update={"rate_hz": 10.0}),
        }
    )
    flown = simulate.fly(scene, 1)
    (folder / "images").mkdir(parents=True)
    times = flown.frame_times
    places = np.array([flown.pose(int(t)).translation for t in times])
    rng, drift, last = np.random.default_rng(3), np.zeros(3), None
    seconds, poses = list[int](), list[Pose]()
    looks = flown.rig.cameras[0].body_from_cam
    for k, (t, place) in enumerate(zip(times, places, strict=True)):
        if last is not None and np.linalg.norm(place[:2] - last[:2]) < step:
            continue
        last = place
        seconds.append(second_of(int(t)))
        poses.append(flown.pose(int(t)) @ looks)
        drift = 0.9 * drift + rng.normal(0, (0.9, 0.9, 1.3))
        image = Image.fromarray(flown.image(k, 0))
        path = folder / "images" / f"photo_{len(seconds):04d}.jpg"
        image.save(path, quality=95, exif=tags(flown.local, place + drift, int(t), what.size))
    truth = flown.truth
    np.savez(
        folder / "flown.npz",
        height=truth.height, grid=[truth.grid.east, truth.grid.north, truth.grid.cell], above=what.height,
        origin=[flown.local.latitude, flown.local.longitude, flown.local.height],
        seconds=seconds, centres=[p.translation for p in poses], turns=[p.rotation for p in poses],
    )  # fmt: skip


def second_of(t_ns: int) -> int:
    """The whole second of an exposure since 1970, as its tags give it."""
    return (t_ns - START_NS) // 10**9 + 1_700_000_000


def tags(local: LocalFrame, place: F64, t_ns: int, size: tuple[int, int]) -> bytes:
    """EXIF like that of a phone: camera, focal length, time and GPS."""
    latitude, longitude, height = (float(v) for v in local.to_geodetic(place))
    exif = Image.Exif()
    focal = 0.5 * SENSOR[0] / math.tan(0.5 * FIELD)
    exif[0x010F], exif[0x0110] = "Alight", "Simulator"
    details = exif.get_ifd(0x8769)
    details[0x9003] = time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(second_of(t_ns)))
    details[0x920A], details[0xA405] = focal * 1000, round(36e-3 * focal / SENSOR[0] * 1000)
    details[0xA20E], details[0xA20F], details[0xA210] = size[0] / SENSOR[0] / 100, size[0] / SENSOR[0] / 100, 3
    gps = exif.get_ifd(0x8825)
    gps[1], gps[2] = "N" if latitude >= 0 else "S", sexagesimal(abs(latitude))
    gps[3], gps[4] = "E" if longitude >= 0 else "W", sexagesimal(abs(longitude))
    gps[5], gps[6] = b"\x00", height
    return bytes(exif.tobytes())


def sexagesimal(degrees: float) -> tuple[float, float, float]:
    """Degrees, minutes, seconds."""
    minutes = (degrees - int(degrees)) * 60
    return float(int(degrees)), float(int(minutes)), (minutes - int(minutes)) * 60


def true_poses(photos: Path) -> Path:
    """Write the true poses of drawn photos as TUM, in the frame of a run over them."""
    z = np.load(photos.parent / "flown.npz")
    at = {int(s): Pose(r, c) for s, r, c in zip(z["seconds"], z["turns"], z["centres"], strict=True)}
    source = open_source(photos, Settings())
    looks, local = source.rig.cameras[0].body_from_cam.inverse, LocalFrame(*z["origin"])
    lines = [
        tum_line(e.t_ns, moved(source.local, local, at[e.t_ns // 10**9]) @ looks)
        for e in source.events() if isinstance(e, Frame) and e.t_ns // 10**9 in at
    ]  # fmt: skip
    path = photos.parent / "true.tum"
    path.write_text("\n".join(lines) + "\n")
    return path


def first(drawn: Drawn, lines: int) -> Drawn:
    """Return a set with its first lines alone."""
    return replace(drawn, lines=lines)
