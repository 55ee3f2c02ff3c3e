"""The fuzzer: a short run finds no fault, and an existing fault is found, shrunk and kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import rasterio
from length import first, long
from PIL import Image

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="every trial is a fork")


def fuzz(keep: Path, *options: str, before: str = "") -> tuple[int, str]:
    """Run `bench/fuzz` after `before` in one process; return exit code and output."""
    folder = str(ROOT / "bench" / "fuzz")
    script = f"{before}\nimport runpy\nrunpy.run_path({folder!r}, run_name='__main__')"
    env = os.environ | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script, "--keep", str(keep), *options],
        env=env, capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("kinds", first(1, ["dem,protocol", "noise,photos"]))
def test_a_short_run_finds_nothing(tmp_path: Path, kinds: str) -> None:
    code, said = fuzz(tmp_path / "kept", "--trials", "4", "--seed", "7", "--kinds", kinds)
    assert code == 0, said
    assert "0 kinds of failure" in said
    assert not (tmp_path / "kept").exists()


@long
def test_a_fault_is_found_shrunk_and_kept(tmp_path: Path) -> None:
    """A source raises an error at its first loss."""
    fault = """
import alight.sources.source as source
def faulty(self, group, item, why):
    raise OverflowError("a fault put in")
source.Findings.lose = faulty
"""
    keep = tmp_path / "kept"
    code, said = fuzz(keep, "--trials", "12", "--seed", "7", "--kinds", "noise", before=fault)
    assert code == 1, said
    kept = [json.loads(p.read_text(encoding="utf-8")) for p in keep.glob("*.json")]
    assert any("a fault put in" in k["fault"] and len(k["damages"]) == 1 for k in kept)


@pytest.fixture(scope="module")
def cost() -> ModuleType:
    """Import bench/fuzz/cost.py as a module."""
    spec = spec_from_file_location("cost", ROOT / "bench" / "fuzz" / "cost.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["cost"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("seconds", "megabytes", "pixels", "fault"),
    [
        (19.0, 300.0, 0, None), (31.0, 300.0, 0, "too slow"), (31.0, 300.0, 400_000, None),
        (119.0, 300.0, 800_000, None), (121.0, 300.0, 800_000, "too slow"), (1.0, 790.0, 0, None),
        (1.0, 810.0, 0, "too large: 810 MB"), (1.0, 1390.0, 800_000, None),
        (1.0, 1410.0, 800_000, "too large: 1410 MB"),
    ],
)  # fmt: skip
def test_time_and_memory_are_held_against_what_was_left(
    cost: ModuleType, seconds: float, megabytes: float, pixels: int, fault: str | None
) -> None:
    """The healthy input takes 3 s and 100 MB more than an idle process, and leaves 200,000 pixels."""
    healthy = cost.Cost(3.0, 400.0, 200_000, 300.0)
    assert healthy.fault(SimpleNamespace(fault=None, seconds=seconds, megabytes=megabytes), pixels) == fault


def test_a_wrong_answer_stays_wrong_whatever_was_left(cost: ModuleType) -> None:
    found = SimpleNamespace(fault="no answer", seconds=1.0, megabytes=1.0)
    assert cost.Cost(3.0, 400.0, 0, 300.0).fault(found, 10**9) == "no answer"


def test_pixels_of_whole_pictures_and_rasters_count(cost: ModuleType, tmp_path: Path) -> None:
    for name in ("a.png", "b.jpg"):
        Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(tmp_path / name)
    (tmp_path / "c.png").write_bytes(b"")
    (tmp_path / "d.txt").write_text("text")
    with rasterio.open(tmp_path / "e.tif", "w", driver="GTiff", width=7, height=9, count=1, dtype="uint8",
                       transform=rasterio.Affine(2, 0, 0, 0, -2, 0)) as raster:  # fmt: skip
        raster.write(np.zeros((9, 7), np.uint8), 1)
    assert cost.pixels_left(tmp_path) == 2 * 600 + 63
