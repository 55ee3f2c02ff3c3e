"""Sets of photos for the photo bench: real ones, and lines that the simulator flies and draws, with their truth.

Photos are drawn with GPS tags of 2 m (1 sigma, drifting) and no other tags than a phone's.
"""

from __future__ import annotations

import math
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import numpy as np
from damage import write_photo
from PIL import Image
from tables import DATA, ROOT

import alight_sim as simulate
from alight.arrays import F64
from alight_sim.flight import START_NS

OUT = ROOT / "out" / "bench-photos"
REAL = ("mirafiori", "garfield", "caliterra")
SENSOR = 13.2e-3  # metres, width of a one-inch sensor
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


def folder_of(name: str) -> Path:
    """The folder of a set's photos; drawn ones are kept from run to run."""
    if name in REAL:
        return DATA / name / "images"
    d = DRAWN[name]
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
    times = flown.frame_times
    places = np.array([flown.pose(int(t)).translation for t in times])
    rng, drift, last = np.random.default_rng(3), np.zeros(3), None
    seconds, centres = list[int](), list[F64]()
    looks = flown.rig.cameras[0].body_from_cam
    for k, (t, place) in enumerate(zip(times, places, strict=True)):
        if last is not None and np.linalg.norm(place[:2] - last[:2]) < step:
            continue
        last = place
        seconds.append((int(t) - START_NS) // 10**9 + 1_700_000_000)  # since 1970
        centres.append((flown.pose(int(t)) @ looks).translation)
        drift = 0.9 * drift + rng.normal(0, (0.9, 0.9, 1.3))
        write_photo(
            folder / "images" / f"photo_{len(seconds):04d}.jpg", second=None, xmp=b"", size=what.size,
            place=tuple(float(v) for v in flown.local.to_geodetic(place + drift)), model="Simulator",
            main={0x010F: "Alight"}, photo=phone_tags(seconds[-1], width), image=Image.fromarray(flown.image(k, 0)),
        )  # fmt: skip
    truth = flown.truth
    np.savez(
        folder / "flown.npz",
        height=truth.height, grid=[truth.grid.east, truth.grid.north, truth.grid.cell], above=what.height,
        seconds=seconds, centres=centres,
    )  # fmt: skip


def phone_tags(second: int, width: int) -> dict[int, object]:
    """EXIF tags of a phone: the time in seconds since 1970, and the focal length of pictures so many pixels wide."""
    focal = 0.5 * SENSOR / math.tan(0.5 * FIELD)
    taken = time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(second))
    lens = {0x920A: focal * 1000, 0xA405: round(36 * focal / SENSOR)}
    return {0x9003: taken, 0xA20E: width / SENSOR / 100, 0xA20F: width / SENSOR / 100, 0xA210: 3, **lens}
