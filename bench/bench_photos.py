"""A card of photos: CPU a megapixel, memory, clock, and how much of the ground is covered how exactly.

    python bench/bench_photos.py                            # `make bench-photos`: reduced simulated sets, 15 minutes
    python bench/bench_photos.py --full                     # 18 x 9, 100 x 12 and 300 x 2 megapixels: hours
    python bench/bench_photos.py --only mirafiori --profile # where the CPU goes
    python bench/bench_photos.py --only garfield --set parallax.cell=0.2

Each set is one run in a process of its own, on one thread a core. Kernels are compiled before. Photos are drawn by the
simulator, with GPS tags of 2 m (1 sigma, drifting) and no other tags than a phone's.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import math
import os
import pstats
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from heights_table import Row, head
from PIL import Image

import alight_sim as simulate
from alight.arrays import F64
from alight.cli import main as alight
from alight.evaluation.photos import against_photos, plane_of
from alight.geometry import Grid, LocalFrame
from alight.outputs import Run, read_run, world_up
from alight.records import Flag
from alight.sources import read_tum
from alight.spread import nmad
from alight_sim.flight import START_NS

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("ALIGHT_DATA", ROOT.parent / "shared" / "data"))
OUT = ROOT / "out" / "bench-photos"
REAL = ("mirafiori", "garfield", "caliterra")
BOUNDS = {"mirafiori": (90.0, 2500.0), "garfield": (180.0, 2000.0), "caliterra": (300.0, 2000.0)}  # s, MB
CPU = 2.0, 1.0  # s a megapixel: must and aim
BAD = 0.01  # of the height
SENSOR = 13.2e-3, 8.8e-3  # metres, of a one-inch sensor
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

    @property
    def count(self) -> int:
        """Photos."""
        return self.lines * self.per_line


DRAWN = {
    "forest": Drawn("forest", (1836, 1224), 3, 6, 37.0, 0.62, 0.62),
    "village": Drawn("village", (1160, 774), 4, 8, 50.0, 0.75, 0.65),
    "long": Drawn("meadow", (1160, 774), 6, 16, 40.0, 0.75, 0.65),
}
FULL = {
    "forest": Drawn("forest", (3672, 2448), 3, 6, 37.0, 0.62, 0.62),
    "village": Drawn("village", (4240, 2832), 10, 10, 60.0, 0.8, 0.7),
    "long": Drawn("meadow", (1732, 1155), 12, 25, 40.0, 0.75, 0.65),
}


# -- photos


def folder_of(name: str, drawn: dict[str, Drawn]) -> Path:
    """The folder of a set's photos; drawn ones are kept from run to run."""
    if name in REAL:
        return DATA / name / "images"
    folder = OUT / f"{name}-{drawn[name].size[0]}x{drawn[name].size[1]}"
    if not (folder / "flown.npz").exists():
        shutil.rmtree(folder, ignore_errors=True)
        draw(drawn[name], folder)
    return folder / "images"


def draw(what: Drawn, folder: Path) -> None:
    """Fly the lines, write a JPEG with its tags at each place, and the truth beside them."""
    scene = simulate.read_scene(simulate.built_in()[what.scene], 1)
    width, height = what.size
    wide = 2 * what.height * math.tan(0.5 * FIELD)
    step, apart = (1 - what.along) * wide * height / width, (1 - what.across) * wide
    speed = 4.0
    camera = {"resolution": what.size, "field_deg": math.degrees(FIELD)}
    flight = scene.flight.model_copy(
        update={
            "pattern": "lawn_mower", "waypoints": None, "lines": what.lines, "length": (what.per_line - 1) * step,
            "spacing": apart, "height": what.height, "speed": speed,
        }
    )  # fmt: skip
    scene = scene.model_copy(
        update={
            "flight": flight,
            "rig": simulate.RigModel.model_validate({"cameras": [camera]}),
            "imaging": scene.imaging.model_copy(update={"rate_hz": 10.0}),
        }
    )
    flown = simulate.fly(scene, 1)
    (folder / "images").mkdir(parents=True)
    times = flown.frame_times
    places = np.array([flown.pose(int(t)).translation for t in times])
    rng, drift, last = np.random.default_rng(3), np.zeros(3), None
    seconds, centres = list[int](), list[F64]()
    for k, (t, place) in enumerate(zip(times, places, strict=True)):
        if last is not None and np.linalg.norm(place[:2] - last[:2]) < step:
            continue
        last = place
        seconds.append(second_of(int(t)))
        centres.append(place)
        drift = 0.9 * drift + rng.normal(0, (0.9, 0.9, 1.3))
        image = Image.fromarray(flown.image(k, 0))
        path = folder / "images" / f"photo_{len(seconds):04d}.jpg"
        image.save(path, quality=95, exif=tags(flown.local, place + drift, int(t), what.size))
    truth = flown.truth
    np.savez(
        folder / "flown.npz",
        height=truth.height, grid=[truth.grid.east, truth.grid.north, truth.grid.cell], above=what.height,
        origin=[flown.local.latitude, flown.local.longitude, flown.local.height],
        seconds=seconds, centres=centres,
    )  # fmt: skip


def second_of(t_ns: int) -> int:
    """The whole second of an exposure since 1970, as its tags give it."""
    return (t_ns - START_NS) // 10**9 + 1_700_000_000


def tags(local: LocalFrame, place: F64, t_ns: int, size: tuple[int, int]) -> bytes:
    """EXIF as a phone writes it: camera, focal length, time and GPS."""
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


# -- a run


def run_one(photos: Path, out: Path, options: list[str], profile: bool) -> None:
    """In a process of its own: the run, and what it cost beside it."""
    sys.argv = ["alight", "run", str(photos), "--out", str(out), "--force", *options]
    watch, start = cProfile.Profile(), time.perf_counter()
    if profile:
        watch.enable()
    code: object = 0
    try:
        alight()
    except SystemExit as e:
        code = e.code
    watch.disable()
    if code:
        sys.exit(1)
    if profile:
        pstats.Stats(watch).sort_stats("tottime").print_stats(25)
    used = resource.getrusage(resource.RUSAGE_SELF)
    cost = {
        "cpu": used.ru_utime + used.ru_stime, "mb": used.ru_maxrss / 1024, "clock": time.perf_counter() - start
    }  # fmt: skip
    out.with_suffix(".cost.json").write_text(json.dumps(cost))


def measured(name: str, photos: Path, options: list[str], profile: bool) -> list[Row]:
    """The rows of one set."""
    out = OUT / f"{name}-run"
    argv = [sys.executable, __file__, "--child", str(photos), str(out), *(["--profile"] if profile else [])]
    done = subprocess.run([*argv, "--", *options], check=False)
    if done.returncode:
        return [Row(f"{name}: the run failed", math.nan, 0.0)]
    cost = json.loads(out.with_suffix(".cost.json").read_text())
    files = sorted(photos.glob("*.[jJ][pP]*[gG]"))
    with Image.open(files[0]) as first:
        megapixels = len(files) * first.width * first.height / 1e6
    seconds, megabytes = BOUNDS.get(name, (math.inf, 2500.0))
    stages = json.loads((out / "run.json").read_text())["time"]
    print(f"{name}: {len(files)} photos, {megapixels:.0f} megapixels; seconds by stage: {json.dumps(stages)}")
    rows = [
        Row(f"{name}: CPU, s a megapixel", cost["cpu"] / megapixels, *CPU),
        Row(f"{name}: CPU, s a photo", cost["cpu"] / len(files)),
        Row(f"{name}: peak memory, MB", cost["mb"], megabytes, megabytes / 2),
        Row(f"{name}: clock, s", cost["clock"], seconds, seconds / 2),
    ]
    run = read_run(out)
    if name == "mirafiori":
        return rows + reference_rows(run)
    return rows if name in REAL else rows + truth_rows(name, run, photos.parent / "flown.npz")


def reference_rows(run: Run) -> list[Row]:
    """Accuracy of the real photos that have a reference."""
    found = {k: v for k, v in against_photos(run, DATA / "mirafiori").values.items() if isinstance(v, float)}
    limits: dict[str, Any] = {
        "NMAD less a plane, m": (0.036, 0.033),
        "off by more than 1 % of height and given out, % of all points": (0.65, 0.3),
        "accepted of cells seen by three photos or more, %": ((57.0, math.inf), (70.0, math.inf)),
    }
    return [Row(f"mirafiori: {k}", v, *limits.get(k, (None, None))) for k, v in found.items()]


def truth_rows(name: str, run: Run, path: Path) -> list[Row]:
    """Heights against the simulator's ground, the whole map moved, turned and scaled so that the cameras meet theirs.

    How far it had to be turned and scaled is what GPS leaves open. What remains is less a plane, and bows.
    """
    assert run.local is not None
    assert run.height is not None
    assert run.grid is not None
    assert run.flags is not None
    z = np.load(path)
    stamps, poses = read_tum(run.folder / "trajectory.tum", run.local)
    own = {int(t) // 10**9: p.translation for t, p in zip(stamps, poses, strict=True)}
    place = dict(zip(z["seconds"].tolist(), z["centres"], strict=True))
    both = sorted(own.keys() & place.keys())
    scale, turn, shift = similarity(np.array([own[k] for k in both]), np.array([place[k] for k in both]))
    seen = (run.flags & np.uint16(Flag.UNSEEN | Flag.FEW)) == 0
    cells = np.flatnonzero(seen.ravel())[::7]
    e, n = (v.ravel()[cells] for v in np.meshgrid(*run.grid.xy()))
    up = world_up(run.height, run.grid, run.local).ravel()[cells]
    moved = scale * np.c_[e, n, up] @ turn.T + shift
    ground, grid = z["height"], Grid(*z["grid"].tolist(), *z["height"].shape)
    true = grid.nearest_at(ground, moved[:, 0], moved[:, 1])
    given = np.isfinite(up) & np.isfinite(true)
    points = np.c_[moved[given, :2], true[given]]
    left = plane_of(points, moved[given, 2] - points[:, 2])[1]
    above = float(z["above"])
    return [
        Row(
            f"{name}: given out of the cells seen by three photos, %",
            100 * float(np.isfinite(up).mean()),
            (90.0, math.inf),
            (97.0, math.inf),
        ),
        Row(f"{name}: NMAD less a plane, % of height", 100 * nmad(left) / above),
        Row(f"{name}: bowing, % of height", 100 * bowing(points, left) / above),
        Row(
            f"{name}: off by more than 1 % of height, % of those given out",
            100 * float((np.abs(left) > BAD * above).mean()),
            0.5,
        ),
        Row(f"{name}: tilt that GPS left, mrad", 1000 * math.acos(min(float(turn[2, 2]), 1.0))),
        Row(f"{name}: scale that GPS left, %", 100 * abs(scale - 1)),
    ]


def similarity(own: F64, true: F64) -> tuple[float, F64, F64]:
    """Scale, rotation (3, 3) and shift (3,) that bring points (N, 3) nearest to others (Umeyama 1991)."""
    a, b = own - own.mean(axis=0), true - true.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.linalg.det(u @ vt)])
    turn, scale = (u * sign) @ vt, float((s * sign).sum() / (a**2).sum())
    return scale, turn, true.mean(axis=0) - scale * turn @ own.mean(axis=0)


def bowing(points: F64, left: F64) -> float:
    """Half the range over the map of the paraboloid that fits the errors best, outliers left out."""
    x = points[:, :2] - points[:, :2].mean(axis=0)
    terms = np.c_[x**2, x[:, :1] * x[:, 1:], x, np.ones(len(x))]
    use = np.abs(left) < max(5 * nmad(left), 1e-3)
    fitted = terms @ np.linalg.lstsq(terms[use], left[use], rcond=None)[0]
    return float(np.ptp(np.percentile(fitted, [2, 98]))) / 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", help="these sets")
    parser.add_argument("--full", action="store_true", help="the simulated sets at full size")
    parser.add_argument("--profile", action="store_true", help="print where the CPU went")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as `alight run` takes it")
    parser.add_argument("--quality", help="as `alight run` takes it")
    parser.add_argument("--child", nargs=2, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("options", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        run_one(*given.child, given.options, given.profile)
        return
    OUT.mkdir(parents=True, exist_ok=True)
    drawn = FULL if given.full else DRAWN
    options = [v for a in given.set for v in ("--set", a)]
    options += ["--quality", given.quality] if given.quality else []
    for name in given.only or (*REAL, *drawn):
        if name in REAL and not (DATA / name).is_dir():
            print(f"{name}: no {DATA / name}")
            continue
        rows = measured(name, folder_of(name, drawn), options, given.profile)
        print(head(name), *(r.line() for r in rows), sep="\n", flush=True)


if __name__ == "__main__":
    main()
