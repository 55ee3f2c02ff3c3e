"""Commands that show a flight: `film` and `view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line

Finished = Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")]
RECORDING = typer.Option(metavar="F.mcap", help="Recording of the flight, instead of recording.mcap of OUT.")


@app.command()
def film(
    out: Finished,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The film: .mp4, .webp or .gif.")],
    recording: Annotated[Path | None, RECORDING] = None,
    rate: Annotated[float | None, typer.Option(min=1.0, max=30.0, help="Frames a second.")] = None,
    speed: Annotated[float | None, typer.Option(min=0.1, max=100.0, help="2 is twice as fast as it was.")] = None,
    verbose: options.Verbose = False,
) -> None:
    """Draw the flight of a finished run: the ground from above, the camera, and the decisions."""
    from alight.viewing.film import write_film
    from alight.viewing.flight import ShownFlight

    frames = write_film(ShownFlight(out, recording), file, rate, speed)
    print_line(f"film: {file}  ({frames} frames)")


@app.command()
def view(
    out: Finished,
    recording: Annotated[Path | None, RECORDING] = None,
    save: Annotated[
        Path | None, typer.Option(metavar="F.rrd", help="Write a file that Rerun opens, instead of showing it.")
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Show the flight of a finished run in three dimensions, with Rerun."""
    from alight.viewing.flight import ShownFlight
    from alight.viewing.spatial import show

    show(ShownFlight(out, recording), save)
    if save is not None:
        print_line(f"view: {save}  (open it with: rerun {save})")
