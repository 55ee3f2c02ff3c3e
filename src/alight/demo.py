"""The demo: a simulated flight written as a log, run like any other, compared with its truth. Also warms the kernels."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from alight import replay, simulate
from alight.evaluate import Evaluation, evaluate
from alight.outputs import prepare, write_run
from alight.records import RunResult
from alight.settings import Settings
from alight.sources import open_source

Tell = Callable[[str, float], None]


def run(out: Path, seed: int, settings: Settings, overwrite: bool, tell: Tell) -> tuple[RunResult, Evaluation]:
    """Fly over simulated ground, find a site, and compare with the truth.

    The flight stays beside the results in a folder of its own, `OUT-flight`, as a log that `alight run` takes.

    Raises:
        AlightError: a folder cannot be written.
    """
    prepare(out, overwrite)
    flight = out.with_name(out.name + "-flight")
    simulate.write(
        simulate.fly("demo", seed), flight, lambda done, total: tell("flying", done / total), overwrite=True
    )
    source = open_source(flight, settings)
    result = replay.replay(source, settings, None, tell)
    write_run(result, out, overwrite)
    return result, evaluate(out, flight)


def warmup(tell: Tell) -> None:
    """Compile and cache every kernel by running each stage over a flight of a second."""
    folder = Path(tempfile.mkdtemp(prefix="alight-warmup-"))
    try:
        simulate.write(simulate.fly("demo", 0, 1.0), folder / "flight", lambda done, total: tell("flying", done / total))
        for method in ("batch", "ring"):
            settings = Settings.model_validate({"parallax": {"method": method}})
            replay.replay(open_source(folder / "flight", settings), settings, None, tell)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
