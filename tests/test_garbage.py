"""Garbage in nine of ten images: a site is listed only where the good tenth supports it (bench/garbage.py)."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import garbage
import numpy as np
from some_run import some_run

from alight.outputs import write_run
from alight.outputs.reading import read_run

ROOT = Path(__file__).parents[1]
BENCH = ROOT / "bench" / "garbage.py"


def test_a_site_is_supported_where_the_other_run_is_sure(tmp_path: Path) -> None:
    write_run(some_run(), tmp_path / "run")
    found = read_run(tmp_path / "run")
    assert found.info["answer"]["sites"]
    assert found.safe is not None
    sure, unsure = (replace(found, safe=np.full_like(found.safe, p)) for p in (1.0, 0.5))
    assert garbage.unsupported(found, sure) == []
    assert len(garbage.unsupported(found, unsure)) == len(found.info["answer"]["sites"])
    assert len(garbage.unsupported(found, replace(found, safe=None))) == len(found.info["answer"]["sites"])


def test_noise_in_nine_of_ten_images_makes_no_site(tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT / "src"), "TMPDIR": str(tmp_path)}
    command = [sys.executable, str(BENCH), "--seconds", "1.5", "--kinds", "noise"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "noise: " in done.stdout
    assert "0 not supported" in done.stdout
