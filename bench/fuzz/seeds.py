"""Healthy inputs to be damaged: small, so that a trial takes seconds, and real enough to reach every stage."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import rasterio

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))

from damage import dji_tags, write_campaign, write_flight, write_photo, xmp_packet
from drawn_bags import messages_of_flight, write_bag
from grammar import NUMBERS, Damage

import alight_sim
from alight.cli import call
from alight.learned import table_path


def noise(folder: Path) -> None:
    """Make a flight log over noise: it reaches every reader and makes no map."""
    write_flight(folder, 8)


def flight(folder: Path) -> None:
    """Make a flight log of a second of simulated flight: it reaches every stage."""
    alight_sim.write(alight_sim.fly("demo", 0, 1.5), folder, lambda done, total: None, overwrite=True)


def dem(folder: Path) -> None:
    """Make a raster of heights."""
    folder.mkdir(parents=True)
    z = np.random.default_rng(0).normal(100.0, 0.005, (60, 60)).astype(np.float32)
    place = rasterio.Affine(0.1, 0, 550000, 0, -0.1, 4180000)
    profile = {"driver": "GTiff", "width": 60, "height": 60, "count": 1, "dtype": "float32"}
    with rasterio.open(folder / "dem.tif", "w", crs="EPSG:32610", transform=place, **profile) as d:
        d.write(z, 1)


def photos(folder: Path, damages: tuple[Damage, ...] = ()) -> None:
    """Make photos of noise with tags, some of them damaged: `what` of a damage replaces the tag named by its `file`."""
    for k in range(4):
        tags = {d.file: d.what for d in damages if d.kind == "tag" and int(4 * d.where) in (k, 3)}
        known = {name: value for name, value in tags.items() if name in dji_tags()}
        place: list[float] = [45.0 + 3e-5 * k, 7.6, 350.0]
        for d in damages:
            if d.kind == "place":
                place = {"pole": [90.0, 0.0, 350.0], "one": [45.0, 7.6, 350.0], "high": [45.0, 7.6, 1e6]}[d.what]
        write_photo(
            folder / f"DJI_{k:04d}.JPG", 0 if any(d.kind == "same" for d in damages) else k, second=f"{10 + 3 * k}",
            place=(place[0], place[1], place[2]), xmp=xmp_packet(dji_tags(**known)),
        )  # fmt: skip


def recording(folder: Path) -> None:
    """Make the recording of a live run over a second of simulated flight."""
    with tempfile.TemporaryDirectory() as spare:
        log, out = Path(spare) / "log", Path(spare) / "out"
        flight(log)
        _done(["live", str(log), "--speed", "0.5", "--out", str(out)])
        folder.mkdir(parents=True)
        shutil.copy(out / "recording.mcap", folder)


def bag(form: str, folder: Path) -> None:
    """Make a ROS bag over noise: of ROS 1, or a database or an MCAP file of ROS 2."""
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as spare:
        write_bag(folder / "bag", form, messages_of_flight(write_flight(Path(spare) / "log", 8)))
    for metadata in folder.glob("bag/metadata.yaml"):  # it is not read
        metadata.unlink()


def evaluated(folder: Path) -> None:
    """Make a run and the truth of its flight, without the pictures of both."""
    flight(folder / "flight")
    _done(["run", str(folder / "flight"), "--out", str(folder / "run")])


def scene(folder: Path) -> None:
    """Make a scene file of a short flight."""
    folder.mkdir(parents=True)
    text = (Path(alight_sim.__file__).parent / "scenes" / "demo.yaml").read_text(encoding="utf-8")
    more = "rig: {cameras: [{resolution: [160, 120]}]}\nimaging: {rate_hz: 10}\n"
    (folder / "scene.yaml").write_text(text.replace("duration: 6", "duration: 0.3") + more, encoding="utf-8")


def model(folder: Path) -> None:
    """Copy the package's own model of appearance."""
    folder.mkdir(parents=True)
    shutil.copy(table_path("appearance"), folder / "model.npz")


def campaign(folder: Path) -> None:
    """Make two campaigns of three landings that were given up, so that no landing has to be flown."""
    for name in ("one", "two"):
        write_campaign(folder / name)


def _done(words: list[str]) -> None:
    if call(words):
        raise SystemExit(f"alight {' '.join(words)} failed")


TAG_VALUES = (*(n for n in NUMBERS if "\u00e9" not in n), "50;1,2,3", "+91.00", "1/0", "-9999999")
INPUTS: dict[str, Callable[[Path], None]] = {
    "noise": noise, "flight": flight, "dem": dem, "photos": photos, "recording": recording, "evaluated": evaluated,
    "checked": flight, "scene": scene, "model": model, "campaign": campaign,
    "ros1": partial(bag, "ros1"), "sqlite3": partial(bag, "sqlite3"), "mcap": partial(bag, "mcap"),
}  # fmt: skip
