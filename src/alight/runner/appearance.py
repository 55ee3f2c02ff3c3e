"""Training of a model of appearance on a folder of pictures, and its test on labelled pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from alight.outputs.atomic_write import write_whole
from alight.records import InputError, OutputError
from alight.sources.appearance import model_bytes, read_model
from alight.sources.library import is_labelled, read_labelled, read_library
from alight.terrain import Model
from alight.training.confusion import Confusion
from alight.training.train import judge_patches, judge_pixels, train


class TrainedAppearance(NamedTuple):
    """A model of appearance, and its test on sites that it was not trained on."""

    model: Model
    left_out: Confusion | None  # each site is judged without training on it; None: all pictures are of one site


def train_to_file(
    folder: Path, out: Path, sampling: float, progress: Callable[[str, float], None]
) -> TrainedAppearance:
    """Train a model of appearance on pictures by class and write it to `out`; return the model and its test.

    Args:
        folder: pictures in one folder per class.
        out: file of the model; its path is checked before the training.
        sampling: metres per pixel of pictures for which no index.csv gives it.
        progress: called with the stage and the share of it that is done.

    Raises:
        InputError: the pictures cannot be used.
        OutputError: the file cannot be written.
    """
    if out.is_dir() or not out.parent.is_dir():
        raise OutputError(f"{out}: not a file in a folder that exists; name one such as model.npz")
    patches = read_library(folder, sampling)
    try:
        found = TrainedAppearance(*train(patches, lambda share: progress("training", share)))
    except ValueError as e:
        raise InputError(f"{folder}: {e}") from e
    write_whole(out, model_bytes(found.model))
    return found


def judge_appearance(
    folder: Path, model: Path | None, sampling: float, progress: Callable[[str, float], None]
) -> Confusion:
    """Return the confusion matrix of a model of appearance on labelled pictures.

    Args:
        folder: pictures in one folder per class, or `images/` with `labels/`.
        model: file of the model; None: the package's own model.
        sampling: metres per pixel of pictures for which no index.csv gives it.
        progress: called with the stage and the share of it that is done.

    Raises:
        InputError: the pictures or the model cannot be used.
    """
    known = read_model(model)
    if folder.is_dir() and is_labelled(folder):
        return judge_pixels(known, read_labelled(folder), sampling)
    return judge_patches(known, read_library(folder, sampling), lambda share: progress("testing", share))
