"""Compare a run with the truth: a flight with `truth/`, or a structure-from-motion reference of photos."""

from __future__ import annotations

from pathlib import Path

from alight.evaluation.flight import against_flight
from alight.evaluation.photos import against_photos
from alight.evaluation.report import Evaluation
from alight.outputs.reading import read_run
from alight.records import InputError

__all__ = ["Evaluation", "evaluate"]


def evaluate(out: Path, truth: Path) -> Evaluation:
    """Compare the run in the folder `out` with `truth`: a flight with `truth/`, or a folder with `sfm_reference.npz`.

    Raises:
        InputError: `out` is not a run, or `truth` contains neither.
    """
    run = read_run(out)
    if (truth / "truth").is_dir():
        return against_flight(run, truth)
    if (truth / "sfm_reference.npz").is_file():
        return against_photos(run, truth)
    raise InputError(f"{truth}: no truth in it; give a flight with truth/ or a folder with sfm_reference.npz")
