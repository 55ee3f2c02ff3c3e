"""Garbage in nine of ten images: a site is listed only where the good tenth supports it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from some_run import some_run
from stereo_flight import STEREO

import alight_sim
from alight.outputs import write_run
from alight.outputs.reading import Run, read_run
from alight.runner.replay import Find, find
from alight.settings import Settings

KEPT, OF = 5, 10  # the images with this number of every ten are good


def run(flight: Path, out: Path) -> Run:
    """Run a flight, and read its folder of results."""
    write_run(find(flight, out, Find(Settings())), out)
    return read_run(out)


def with_noise(flight: Path) -> None:
    """Replace nine of ten images by noise."""
    rng = np.random.default_rng(0)
    for table in sorted(flight.glob("mav0/cam*/data.csv")):
        for k, row in enumerate(table.read_text(encoding="utf-8").splitlines()[1:]):
            path = table.parent / "data" / row.split(",")[1].strip()
            if k % OF != KEPT:
                Image.fromarray(rng.integers(0, 256, np.asarray(Image.open(path)).shape, np.uint8)).save(path)


def only_good(flight: Path) -> None:
    """Remove the rows of nine of ten images."""
    for table in flight.glob("mav0/cam*/data.csv"):
        head, *rows = table.read_text(encoding="utf-8").splitlines()
        table.write_text("\n".join([head, *rows[KEPT::OF]]) + "\n", encoding="utf-8")


def unsupported(found: Run, good: Run) -> list[str]:
    """Sites of a run where P(safe) of the good tenth's own run stays below the limit within a cell, in words."""
    wrong = []
    for s in found.info["answer"].get("sites", []):
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


def test_a_site_is_supported_where_the_other_run_is_sure(tmp_path: Path) -> None:
    write_run(some_run(), tmp_path / "run")
    found = read_run(tmp_path / "run")
    assert found.info["answer"]["sites"]
    assert found.safe is not None
    sure, unsure = (replace(found, safe=np.full_like(found.safe, p)) for p in (1.0, 0.5))
    assert unsupported(found, sure) == []
    assert len(unsupported(found, unsure)) == len(found.info["answer"]["sites"])
    assert len(unsupported(found, replace(found, safe=None))) == len(found.info["answer"]["sites"])


def test_noise_in_nine_of_ten_images_makes_no_site(tmp_path: Path) -> None:
    flight = tmp_path / "flight"
    flown = alight_sim.fly("demo", 0, 1.5, rig=STEREO, height=15.0)
    alight_sim.write(flown, flight, lambda done, total: None)
    good = shutil.copytree(flight, tmp_path / "good")
    only_good(good)
    with_noise(flight)
    assert unsupported(run(flight, tmp_path / "run"), run(good, tmp_path / "good-run")) == []
