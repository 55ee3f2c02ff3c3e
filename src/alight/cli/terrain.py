"""Commands for models of the appearance of ground: terrain train, terrain test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line, progress_bar

if TYPE_CHECKING:
    from alight.training.confusion import Confusion

terrain = typer.Typer(help="Train and test the model of what ground looks like.")
app.add_typer(terrain, name="terrain")

SamplingOption = Annotated[
    float, typer.Option("--gsd", min=0.001, max=1.0, help="Metres a pixel, where no index.csv gives it.")
]


@terrain.command("train")
def train_model(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="One folder of pictures a class: bare, water, ...")],
    out: Annotated[Path, typer.Option("--out", metavar="MODEL", help="File for the model (.npz).")],
    sampling: SamplingOption = 0.05,
    verbose: options.Verbose = False,
) -> None:
    """Train a model on your own pictures, and test it on each site with that site left out."""
    from alight.runner.appearance import train_to_file

    with progress_bar() as report:
        found = train_to_file(folder, out, sampling, report)
    print_line(found.model.provenance)
    if found.left_out is None:
        print_line(
            "tested on nothing: all pictures are of one site; put those of another place into a folder of their own"
        )
    print_line(f"model: {out}")


@terrain.command("test")
def evaluate_model(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="One folder a class, or images/ with labels/.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL", help="A trained model; default: the package's own.")
    ] = None,
    leave_out: Annotated[
        bool, typer.Option("--leave-out", help="Test each site with a model trained on the others.")
    ] = False,
    sampling: SamplingOption = 0.05,
    verbose: options.Verbose = False,
) -> None:
    """Print the confusion matrix of a model, by site. Without FOLDER: the provenance of the model."""
    from alight.runner.appearance import judge_appearance
    from alight.sources.appearance import read_model
    from alight.training.confusion import lines_of

    if leave_out and (folder is None or model is not None):
        wrong = "needs FOLDER" if folder is None else "trains models of its own: leave out --model"
        raise typer.BadParameter(f"--leave-out {wrong}")
    if folder is None:
        print_line(read_model(model).provenance)
        return
    with progress_bar() as report:
        found = _left_out(folder, sampling, report) if leave_out else judge_appearance(folder, model, sampling, report)
    for line in lines_of(found):
        print_line(line)


def _left_out(folder: Path, sampling: float, report: Callable[[str, float], None]) -> Confusion:
    from alight.records import InputError
    from alight.sources.library import read_library
    from alight.training.train import elsewhere

    patches = read_library(folder, sampling)
    try:
        return elsewhere(patches, lambda share: report("testing", share))
    except ValueError as e:
        raise InputError(f"{folder}: {e}; put the pictures of each site into a folder of its own") from e
