"""Command of a live run: live."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import live_table, print_stderr, save_result


@app.command()
def live(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A flight log, a recording (.mcap), a folder being filled, or cameras: camera:0,camera:2",
        ),
    ],
    out: options.Out,
    speed: Annotated[float, typer.Option(min=0.01, help="Of a recording: 2 is twice as fast as it was.")] = 1.0,
    follow: Annotated[
        bool, typer.Option("--follow", help="The folder is being filled; 10 s without anything new end it.")
    ] = False,
    rig: options.Rig = None,
    telemetry: Annotated[
        str | None, typer.Option(metavar="LINK", help="Autopilot that gives GPS/INS: udp:0.0.0.0:14550.")
    ] = None,
    separation: options.Separation = None,
    home: options.ArmedAt = None,
    geoid: options.Geoid = None,
    record: options.Record = True,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Find a landing site during a flight; Ctrl-C ends it, and the map so far is judged."""
    chosen = options.read_settings(settings, assign)
    options.refuse_unused(source, follow, rig, speed)
    from alight.flight.live.run import LiveRequest, fly_live
    from alight.runner.opening import open_live
    from alight.runs import flown_home, wanted_home, with_home

    wanted = wanted_home(home, geoid)
    opened = open_live(source, chosen, speed, follow, rig)
    if telemetry is not None:
        from alight.flight.live.telemetry import with_telemetry

        opened = with_telemetry(opened, telemetry, separation)
    compile_if_cold()  # a lane that compiles does not answer
    inputs = [path] if (path := Path(source)).is_file() else []
    request = LiveRequest(out, chosen, record, opened.real_time, force, inputs)
    with live_table() as show:
        result = fly_live(opened.source, opened.events, request, lambda health: show((), [health.line]))
    save_result(with_home(result, flown_home(wanted, opened.telemetry(), separation)), out, force)


def compile_if_cold() -> None:
    """Compile all loops if they are not in the cache: once, before a flight."""
    from alight import compiled

    if not compiled.is_warm():
        from alight.trials.warmup import compile_kernels

        print_stderr("loops are compiled before the flight, once; 'alight warmup' does it ahead of time")
        compile_kernels(lambda stage, share: None)
