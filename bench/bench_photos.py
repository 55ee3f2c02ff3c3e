"""A card of photos: CPU a megapixel, memory, time, coverage of the ground and accuracy of the heights.

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
import pstats
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from heights_table import Row, head
from photo_points import shared_points
from photo_sets import DATA, DRAWN, FULL, OUT, REAL, Drawn, first, folder_of, true_poses
from PIL import Image

from alight.arrays import F64
from alight.cli import main as alight
from alight.evaluation.photos import against_photos, plane_of
from alight.geometry import Grid, world_up
from alight.outputs.reading import Run, read_run
from alight.records import Flag
from alight.sources.tum import read_tum
from alight.spread import nmad

BOUNDS = {"mirafiori": (90.0, 2500.0), "garfield": (180.0, 2000.0), "caliterra": (300.0, 2000.0)}  # s, MB
CPU = 2.0, 1.0  # s a megapixel: must and aim
BAD = 0.01  # of the height
APART = "forest", "apart"  # sets of about 60 % overlap, that are mapped with the true poses as well
NMAD = {"oblique": (0.18, 0.12)}  # % of the height: must and aim
OFF = {"oblique": (2.0, 0.5)}  # % of the heights given out that are off by more than BAD


# -- a run


def run_one(photos: Path, out: Path, options: list[str], profile: bool) -> None:
    """Run in a process of its own, and write its cost beside it."""
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


def beside(name: str, drawn: Drawn, rows: list[Row], photos: Path, options: list[str]) -> list[Row]:
    """Rows that compare a drawn set with a second run: with true poses, or over a third of the photos."""

    def of(some: list[Row], what: str) -> float:
        return next(r.value for r in some if r.name.endswith(f": {what}"))

    if name in APART:
        again = measured(f"{name}-true", photos, ["--poses", str(true_poses(photos)), *options], False)
        what = "NMAD less a plane, % of height"
        if len(again) == 1:
            return again
        return [
            Row(f"{name}: {what}, true poses", of(again, what)),
            Row(f"{name}: NMAD, own poses over true ones", of(rows, what) / of(again, what), 1.5, 1.15),
        ]
    if name == "long":
        fewer = first(drawn, drawn.lines // 3)
        again = measured("third", folder_of("third", {"third": fewer}), options, False)
        what = "CPU, s a photo"
        if len(again) == 1:
            return again
        return [
            Row(f"{name}: CPU a photo over that of {fewer.count} photos", of(rows, what) / of(again, what), 1.1, 1.0),
            Row(f"{name}: peak memory of {fewer.count} photos, MB", of(again, "peak memory, MB")),
        ]
    return []


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
    """Heights against the simulator's ground, after the similarity that fits the map's cameras to the true ones.

    Its rotation and scale are the error of GPS. Of the other errors, a plane is subtracted, and bowing is measured.
    """
    assert run.local is not None
    assert run.height is not None
    assert run.grid is not None
    assert run.flags is not None
    z = np.load(path)
    scale, turn, shift = to_truth(run, z)
    seen = (run.flags & np.uint16(Flag.UNSEEN | Flag.FEW)) == 0
    cells = np.flatnonzero(seen.ravel())[::7]
    e, n = (v.ravel()[cells] for v in np.meshgrid(*run.grid.xy()))
    up = world_up(run.height, run.grid, run.local).ravel()[cells]
    moved = scale * np.c_[e, n, np.nan_to_num(up)] @ turn.T + shift
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
        ),
        *point_rows(name, run, (scale, turn, shift), shared_points(path.parent / "images"), above),
        Row(f"{name}: NMAD less a plane, % of height", 100 * nmad(left) / above, *NMAD.get(name, (None, None))),
        Row(f"{name}: bowing, % of height", 100 * bowing(points, left) / above),
        Row(
            f"{name}: off by more than 1 % of height, % of those given out",
            100 * float((np.abs(left) > BAD * above).mean()),
            *OFF.get(name, (0.5, None)),
        ),
        Row(f"{name}: tilt that GPS left, mrad", 1000 * math.acos(min(float(turn[2, 2]), 1.0))),
        Row(f"{name}: scale that GPS left, %", 100 * abs(scale - 1)),
    ]


def to_truth(run: Run, z: Any) -> tuple[float, F64, F64]:
    """Scale, rotation and shift from a run's frame to the simulator's world, by their cameras."""
    assert run.local is not None
    stamps, poses = read_tum(run.folder / "trajectory.tum", run.local)
    own = {int(t) // 10**9: p.translation for t, p in zip(stamps, poses, strict=True)}
    place = dict(zip(z["seconds"].tolist(), z["centres"], strict=True))
    both = sorted(own.keys() & place.keys())
    return similarity(np.array([own[k] for k in both]), np.array([place[k] for k in both]))


def point_rows(name: str, run: Run, truth_from_run: tuple[float, F64, F64], points: F64, above: float) -> list[Row]:
    """Heights at points (N, 3) that three photos share: share given out, and share of all with a large error."""
    assert run.local is not None
    assert run.height is not None
    assert run.grid is not None
    scale, turn, shift = truth_from_run
    own = (points - shift) @ turn / scale
    up = run.grid.nearest_at(world_up(run.height, run.grid, run.local), own[:, 0], own[:, 1])
    given = np.isfinite(up)
    found = scale * np.c_[own[:, :2], np.nan_to_num(up)] @ turn.T + shift
    left = plane_of(points[given], (found - points)[given, 2])[1]
    return [
        Row(
            f"{name}: given out at {len(points)} points of three photos, %",
            100 * float(given.mean()), (90.0, math.inf), (97.0, math.inf),
        ),
        Row(
            f"{name}: the same, off by more than 1 % of height, % of all points",
            100 * float((np.abs(left) > BAD * above).sum() / len(points)), *OFF.get(name, (0.5, None)),
        ),
    ]  # fmt: skip


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
        photos = folder_of(name, drawn)
        rows = measured(name, photos, options, given.profile)
        if name in drawn and len(rows) > 1:
            rows += beside(name, drawn[name], rows, photos, options)
        print(head(name), *(r.line() for r in rows), sep="\n", flush=True)


if __name__ == "__main__":
    main()
