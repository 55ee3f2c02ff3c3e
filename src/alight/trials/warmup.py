"""Compilation of all loops ahead of time, by a run over a short simulated flight."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import alight_sim as simulate
from alight import compiled
from alight.pipeline.timing import StageProgress
from alight.runner import replay
from alight.runner.opening import open_source
from alight.settings import Settings


def compile_kernels(progress: StageProgress) -> None:
    """Compile all loops and cache them, by running each stage over a simulated flight of one second."""
    folder = Path(tempfile.mkdtemp(prefix="alight-warmup-"))
    try:
        flight = simulate.fly("demo", 0, 1.0)
        simulate.write(flight, folder / "flight", lambda done, total: progress("flying", done / total))
        for method in ("batch", "recursive"):
            settings = Settings.model_validate({"parallax": {"method": method}})
            replay.replay(open_source(folder / "flight", settings), settings, None, progress)
        compiled.mark_warm()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
