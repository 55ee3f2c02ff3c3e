"""The demo: a simulated flight written as a log and run like any other. Also warms the kernels."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import alight_sim as simulate
from alight import compiled
from alight.outputs import prepare_folder
from alight.records import RunResult
from alight.runner import replay
from alight.settings import Settings
from alight.sources import open_source

Tell = Callable[[str, float], None]


def fly_demo(out: Path, seed: int, settings: Settings, overwrite: bool, tell: Tell) -> tuple[Path, RunResult]:
    """Fly over simulated ground and find a site; return the folder of the flight, and what was found.

    The flight stays beside the results in a folder of its own, `OUT-flight`, as a log with its truth.

    Raises:
        AlightError: a folder cannot be written.
    """
    prepare_folder(out, overwrite)
    named = out if out.name not in ("", "..") else out.resolve()
    flight = named.with_name(f"{named.name}-flight")
    _simulate(flight, seed, None, tell)
    return flight, replay.replay(open_source(flight, settings), settings, None, tell)


def _simulate(folder: Path, seed: int, seconds: float | None, tell: Tell) -> None:
    flight = simulate.fly("demo", seed) if seconds is None else simulate.fly("demo", seed, seconds)
    simulate.write(flight, folder, lambda done, total: tell("flying", done / total), overwrite=True)


def compile_kernels(tell: Tell) -> None:
    """Compile and cache every kernel by running each stage over a flight of a second."""
    folder = Path(tempfile.mkdtemp(prefix="alight-warmup-"))
    try:
        _simulate(folder / "flight", 0, 1.0, tell)
        for method in ("batch", "ring"):
            settings = Settings.model_validate({"parallax": {"method": method}})
            replay.replay(open_source(folder / "flight", settings), settings, None, tell)
        compiled.mark_warm()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
