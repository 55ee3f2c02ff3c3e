"""The fuzzer: a short run finds nothing, and a fault that is there is found, shrunk and kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="every trial is a fork")


def fuzz(keep: Path, *options: str, before: str = "") -> tuple[int, str]:
    """Exit code and output of a run of `bench/fuzz`; `before` is run in its process first."""
    folder = str(ROOT / "bench" / "fuzz")
    script = f"{before}\nimport runpy\nrunpy.run_path({folder!r}, run_name='__main__')"
    env = os.environ | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script, "--keep", str(keep), *options],
        env=env, capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("kinds", ["noise,photos", "dem,protocol"])
def test_a_short_run_finds_nothing(tmp_path: Path, kinds: str) -> None:
    code, said = fuzz(tmp_path / "kept", "--trials", "8", "--seed", "7", "--kinds", kinds)
    assert code == 0, said
    assert "0 kinds of failure" in said
    assert not (tmp_path / "kept").exists()


def test_a_fault_is_found_shrunk_and_kept(tmp_path: Path) -> None:
    """A notebook that raises at the first loss."""
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
