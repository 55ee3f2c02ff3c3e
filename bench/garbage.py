"""Garbage in nine of ten images, rows or photos: a site may be listed only where the good tenth alone supports it.

    python bench/garbage.py [--scene demo] [--seconds 6] [--seed 0] [--kinds noise,other]
    python bench/garbage.py --kinds photos-noise,photos-other,photos-tags

Each kind of garbage is run beside the good tenth alone (the other rows or photos taken away). A site is supported where
P(safe) of the good tenth's own run reaches the limit within a cell. Exit code 1 when a site is listed that is not
supported.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import garbage_photos
import numpy as np
from PIL import Image

import alight_sim
from alight.outputs import write_run
from alight.outputs.reading import Run, read_run
from alight.runner.replay import Find, find
from alight.settings import Settings

KEPT, OF = 5, 10  # the rows and images with this number of every ten are good
METRE = 1 / 111_000  # degrees of latitude


def is_good(k: int) -> bool:
    """Return whether row `k` of a stream stays unchanged."""
    return k % OF == KEPT


def _pictures(root: Path, change: Callable[[np.ndarray, int, list[Path]], np.ndarray]) -> None:
    for cam in sorted(root.glob("mav0/cam*")):
        rows = (cam / "data.csv").read_text(encoding="utf-8").splitlines()[1:]
        paths = [cam / "data" / row.split(",")[1].strip() for row in rows]
        for k, path in enumerate(paths):
            if not is_good(k):
                Image.fromarray(change(np.asarray(Image.open(path)), k, paths)).save(path)


def noise(root: Path, rng: np.random.Generator) -> None:
    """Replace nine of ten images by noise."""
    _pictures(root, lambda image, k, paths: rng.integers(0, 256, image.shape, np.uint8))


def other(root: Path, rng: np.random.Generator) -> None:
    """Replace nine of ten images by shifted and mirrored copies of good ones: real ground of another place."""
    good: dict[Path, np.ndarray] = {}

    def change(image: np.ndarray, k: int, paths: list[Path]) -> np.ndarray:
        path = paths[int(rng.integers(len(paths) // OF)) * OF + KEPT]
        good.setdefault(path, np.asarray(Image.open(path)))
        return np.ascontiguousarray(np.roll(good[path][::-1], int(rng.integers(50, 300)), axis=1))

    _pictures(root, change)


def black(root: Path, rng: np.random.Generator) -> None:
    """Replace nine of ten images by black ones."""
    _pictures(root, lambda image, k, paths: np.zeros_like(image))


def _rows(path: Path, change: Callable[[list[float]], list[float]]) -> None:
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    for k, row in enumerate(rows):
        if not is_good(k):
            t, *fields = row.split(",")
            rows[k] = ",".join([t, *(repr(v) for v in change([float(f) for f in fields]))])
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def nav(root: Path, rng: np.random.Generator) -> None:
    """Disturb nine of ten GPS/INS rows by 30 m (1 sigma), with random attitude and velocity, but unchanged sigmas."""

    def change(v: list[float]) -> list[float]:
        quaternion = rng.normal(size=4)
        place = [v[0] + 30 * METRE * rng.normal(), v[1] + 30 * METRE * rng.normal(), v[2] + 30 * rng.normal()]
        return [*place, *(quaternion / np.linalg.norm(quaternion)), *rng.normal(0, 10, 3), *v[10:]]

    _rows(root / "mav0" / "nav0" / "data.csv", change)


def imu(root: Path, rng: np.random.Generator) -> None:
    """Replace nine of ten IMU rows by noise."""
    _rows(root / "mav0" / "imu0" / "data.csv", lambda v: [*rng.normal(0, 1, 3), *rng.normal(0, 20, 3)])


def only_good(stream: str, root: Path) -> None:
    """Remove the rows that a kind of garbage would spoil."""
    for table in root.glob(f"mav0/{stream}*/data.csv"):
        head, *rows = table.read_text(encoding="utf-8").splitlines()
        kept = [row for k, row in enumerate(rows) if is_good(k)]
        table.write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Kind:
    """A kind of garbage."""

    spoil: Callable[[Path, np.random.Generator], None]
    alone: Callable[[Path], None]  # leaves the good tenth
    source: str = "flight"


CAM, NAV, IMU = (partial(only_good, stream) for stream in ("cam", "nav", "imu"))
KINDS = {"noise": Kind(noise, CAM), "other": Kind(other, CAM), "black": Kind(black, CAM), "nav": Kind(nav, NAV),
         "imu": Kind(imu, IMU)}  # fmt: skip
KINDS |= {
    f"photos-{name}": Kind(spoil, garbage_photos.only_good, "photos") for name, spoil in garbage_photos.KINDS.items()
}


def run(flight: Path, out: Path) -> Run:
    """Run a flight, and read its folder of results."""
    write_run(find(flight, out, Find(Settings())), out)
    return read_run(out)


def unsupported(found: Run, good: Run) -> list[str]:
    """Sites of a run that the run of the good tenth does not support, in words."""
    listed = found.info["answer"].get("sites", [])
    wrong = []
    for s in listed:
        p = 0.0
        if good.safe is not None and good.grid is not None and good.local is not None and found.local is not None:
            place = found.local.to_geodetic(np.array([s["east_m"], s["north_m"], s["up_m"]]))
            east, north, _ = good.local.to_enu(*place)
            row, col = (round(float(i)) for i in good.grid.index(east, north))
            if 0 <= row < good.grid.rows and 0 <= col < good.grid.cols:
                near = good.safe[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
                p = float(np.nanmax(np.nan_to_num(near)))
        if p < good.settings.hazards.p_safe:
            wrong.append(f"east {s['east_m']:.1f} north {s['north_m']:.1f} m, P {s['p_safe']:.3f}; alone {p:.3f}")
    return wrong


def made(source: str, root: Path, scene: str, seconds: float, seed: int) -> Path:
    """Make an undamaged input, once: a simulated flight, or photos."""
    folder = root / source
    if folder.exists():
        return folder
    if source == "photos":
        garbage_photos.draw_card(scene, folder)
    else:
        alight_sim.write(alight_sim.fly(scene, seed, seconds), folder, lambda done, total: None)
    return folder


def report(name: str, found: Run, good: Run) -> int:
    """Print the result of a run with garbage; return the number of its sites that are not supported."""
    wrong = unsupported(found, good)
    count, own = (len(r.info["answer"].get("sites", [])) for r in (found, good))
    said = found.info["answer"].get("reason") or ""
    sys.stdout.write(f"{name}: {count} sites, the good tenth alone {own}; {len(wrong)} not supported  {said}\n")
    sys.stdout.write("".join(f"    {w}\n" for w in wrong))
    sys.stdout.flush()
    return len(wrong)


def main() -> int:
    """Run every kind; return the exit code."""
    parser = argparse.ArgumentParser(description="Garbage in nine of ten images, rows or photos.")
    parser.add_argument("--scene", default="demo")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    given, bad = parser.parse_args(), 0
    with tempfile.TemporaryDirectory(prefix="alight-garbage-") as folder:
        root = Path(folder)
        alone: dict[Callable[[Path], None], Run] = {}
        for name in given.kinds.split(","):
            kind = KINDS[name]
            healthy = made(kind.source, root, given.scene, given.seconds, given.seed)
            if kind.alone not in alone:
                good = shutil.copytree(healthy, root / f"{name}-good")
                kind.alone(good)
                alone[kind.alone] = run(good, root / f"{name}-good-run")
            spoiled = shutil.copytree(healthy, root / name)
            kind.spoil(spoiled, np.random.default_rng(given.seed))
            bad += report(name, run(spoiled, root / f"{name}-run"), alone[kind.alone])
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
