"""Command that looks for faults of a rig: check."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from alight.cli.app import (
    WRONG,
    SetOption,
    SettingsOption,
    VerboseOption,
    app,
    complain,
    progress_bar,
    read_settings,
    say,
)
from alight.records import PhotoRow


@app.command()
def check(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A flight log (mav0/), a recording (.mcap), or photos.")
    ],
    seconds: Annotated[float, typer.Option(min=1.0, help="How much of the recording is read.")] = 10.0,
    start: Annotated[float, typer.Option(min=0.0, help="Seconds from the first exposure at which to begin.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print records instead of lines.")] = False,
    settings: SettingsOption = None,
    assign: SetOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Find faults of a rig: cameras, mounting, clocks, units, lenses; the exit code is 3 if a check is bad.

    Of photos: the facts in their tags, one line a photo.
    """
    chosen = read_settings(settings, assign)
    from alight.checks.checking import check_source
    from alight.checks.result import Judged
    from alight.runner.opening import open_source

    recording = open_source(source, chosen)
    if recording.photos:
        _tell_photos([PhotoRow(p, None) for p in recording.photos], recording.warnings, as_json)
        return
    with progress_bar() as tell:
        found = check_source(recording, seconds, start, lambda share: tell("checking", share))
    if as_json:
        say(json.dumps([asdict(r) for r in found], indent=1))
    for result in () if as_json else found:
        say(result.line)
    if any(r.verdict is Judged.BAD for r in found):
        raise typer.Exit(WRONG)


def _tell_photos(rows: list[PhotoRow], warnings: list[str], as_json: bool) -> None:
    """Print the facts about each photo on stdout, the warnings on stderr."""
    for w in warnings:
        complain(f"warning: {w}", "yellow")
    if as_json:
        say(json.dumps([row.as_json() for row in rows], indent=1))
    for row in () if as_json else rows:
        say(row.line)
