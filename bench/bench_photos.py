"""A card of photos: CPU a megapixel, memory, time, coverage of the ground and accuracy of the heights.

    python bench/bench_photos.py                            # `make bench-photos`: real and simulated sets, 15 minutes
    python bench/bench_photos.py --only garfield --set parallax.cell=0.2

Each set is one run in a process of its own, on one thread a core. Kernels are compiled before. Photos are drawn by the
simulator, with GPS tags of 2 m (1 sigma, drifting) and no other tags than a phone's.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from photo_sets import DRAWN, OUT, REAL, folder_of
from PIL import Image
from tables import DATA, Row, show

from alight.arrays import F64
from alight.evaluation.photos import against_photos, plane_of
from alight.geometry import Grid, world_up
from alight.outputs.reading import Run, read_run
from alight.records import Flag
from alight.sources.tum import read_tum
from alight.spread import nmad

BOUNDS = {"mirafiori": (90.0, 2500.0), "garfield": (180.0, 2000.0), "caliterra": (300.0, 2000.0)}  # s, MB
CPU = 2.0, 1.0  # s a megapixel: must and aim
NMAD = {"oblique": (0.18, 0.12)}  # % of the height: must and aim
OFF = {"oblique": (2.0, 0.5)}  # % of the heights given out that are off by more than 1 % of the height


def measured(name: str, photos: Path, options: list[str]) -> list[Row]:
    """The rows of one set."""
    out, start = OUT / f"{name}-run", time.perf_counter()
    run_command = [Path(sys.executable).with_name("alight"), "run", photos, "--out", out, "--force", *options]
    _, status, used = os.wait4(subprocess.Popen(run_command).pid, 0)
    if status:
        return [Row(f"{name}: the run failed", math.nan, 0.0)]
    cpu, clock = used.ru_utime + used.ru_stime, time.perf_counter() - start
    files = sorted(photos.glob("*.[jJ][pP]*[gG]"))
    with Image.open(files[0]) as first:
        megapixels = len(files) * first.width * first.height / 1e6
    seconds, megabytes = BOUNDS.get(name, (math.inf, 2500.0))
    run = read_run(out)
    print(f"{name}: {len(files)} photos, {megapixels:.0f} megapixels; seconds by stage: {json.dumps(run.info['time'])}")
    rows = [
        Row(f"{name}: CPU, s a megapixel", cpu / megapixels, *CPU),
        Row(f"{name}: peak memory, MB", used.ru_maxrss / 1024, megabytes, megabytes / 2),
        Row(f"{name}: clock, s", clock, seconds, seconds / 2),
    ]
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
    tilt = float(np.linalg.norm(turn[2, :2] / run.info["common_error"]["tilt_sigma_rad"]))
    return [
        Row(f"{name}: tilt of the whole survey, in its claimed sigmas", tilt, 3.0, 2.0),
        Row(f"{name}: given out of the cells seen by three photos, %", 100 * float(np.isfinite(up).mean())),
        Row(f"{name}: NMAD less a plane, % of height", 100 * nmad(left) / above, *NMAD.get(name, (None, None))),
        Row(
            f"{name}: off by more than 1 % of height, % of those given out",
            100 * float((np.abs(left) > 0.01 * above).mean()),
            *OFF.get(name, (0.5, None)),
        ),
    ]


def to_truth(run: Run, z: Any) -> tuple[float, F64, F64]:
    """Scale, rotation and shift from a run's frame to the simulator's world, by their cameras."""
    assert run.local is not None
    stamps, poses = read_tum(run.folder / "trajectory.tum", run.local)
    own = {int(t) // 10**9: p.translation for t, p in zip(stamps, poses, strict=True)}
    place = dict(zip(z["seconds"].tolist(), z["centres"], strict=True))
    both = sorted(own.keys() & place.keys())
    return similarity(np.array([own[k] for k in both]), np.array([place[k] for k in both]))


def similarity(own: F64, true: F64) -> tuple[float, F64, F64]:
    """Scale, rotation (3, 3) and shift (3,) that bring points (N, 3) nearest to others (Umeyama 1991)."""
    a, b = own - own.mean(axis=0), true - true.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.linalg.det(u @ vt)])
    turn, scale = (u * sign) @ vt, float((s * sign).sum() / (a**2).sum())
    return scale, turn, true.mean(axis=0) - scale * turn @ own.mean(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", help="these sets")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as `alight run` takes it")
    given = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    options = [v for a in given.set for v in ("--set", a)]
    for name in given.only or (*REAL, *DRAWN):
        if name in REAL and not (DATA / name).is_dir():
            print(f"{name}: no {DATA / name}")
            continue
        show(*measured(name, folder_of(name), options), title=name)


if __name__ == "__main__":
    main()
