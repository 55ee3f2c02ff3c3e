"""Command that looks for faults of a rig: check."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from alight.cli import options
from alight.cli.app import ExitCode, app
from alight.cli.terminal import print_line, print_stderr, progress_bar


@app.command()
def check(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A flight log (mav0/), a recording (.mcap), or photos.")
    ],
    seconds: Annotated[float, typer.Option(min=1.0, help="How much of the recording is read.")] = 10.0,
    start: Annotated[float, typer.Option(min=0.0, help="Seconds from the first exposure at which to begin.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print records instead of lines.")] = False,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    verbose: options.Verbose = False,
) -> None:
    """Find faults of a rig: cameras, mounting, clocks, units, lenses; the exit code is 3 if a check is bad.

    Of photos: the facts in their tags, one line a photo.
    """
    chosen = options.read_settings(settings, assign)
    from alight.checks.checking import check_source
    from alight.checks.result import Judged
    from alight.runner.opening import open_source

    recording = open_source(source, chosen)
    if recording.photos:
        from alight.records import PhotoRow

        for w in recording.warnings:
            print_stderr(f"warning: {w}")
        rows = [PhotoRow(p, None) for p in recording.photos]
        _print_rows([row.line for row in rows], [row.as_json() for row in rows], as_json)
        return
    with progress_bar() as report:
        found = check_source(recording, seconds, start, lambda share: report("checking", share))
    _print_rows([r.line for r in found], [asdict(r) for r in found], as_json)
    if any(r.verdict is Judged.BAD for r in found):
        raise typer.Exit(ExitCode.FAULT_FOUND)


def _print_rows(lines: list[str], records: list[dict[str, Any]], as_json: bool) -> None:
    for line in [json.dumps(records, indent=1)] if as_json else lines:
        print_line(line)
