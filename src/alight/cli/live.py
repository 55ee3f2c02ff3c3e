"""Command of a live run: live."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.live import Live as Display
from rich.text import Text

from alight.cli.answers import leave_result
from alight.cli.app import (
    ForceOption,
    GeoidOption,
    HomeOption,
    OutOption,
    RecordOption,
    RigOption,
    SeparationOption,
    SetOption,
    SettingsOption,
    VerboseOption,
    app,
    complain,
    read_settings,
    refuse_unused,
    stderr,
)


@app.command()
def live(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A flight log, a recording (.mcap), a folder being filled, or cameras: camera:0,camera:2",
        ),
    ],
    out: OutOption,
    speed: Annotated[float, typer.Option(min=0.01, help="Of a recording: 2 is twice as fast as it was.")] = 1.0,
    follow: Annotated[
        bool, typer.Option("--follow", help="The folder is being filled; 10 s without anything new end it.")
    ] = False,
    rig: RigOption = None,
    telemetry: Annotated[
        str | None, typer.Option(metavar="LINK", help="Autopilot that gives GPS/INS: udp:0.0.0.0:14550.")
    ] = None,
    separation: SeparationOption = None,
    home: HomeOption = None,
    geoid: GeoidOption = None,
    record: RecordOption = True,
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Find a landing site during a flight; Ctrl-C ends it, and the map so far is judged."""
    chosen = read_settings(settings, assign)
    refuse_unused(source, follow, rig, speed)
    from alight.flight.live.health import FlightHealth
    from alight.flight.live.run import fly_live
    from alight.runner.live import open_live
    from alight.runs import flown_home, wanted_home, with_home

    wanted = wanted_home(home, geoid)
    opened = open_live(source, chosen, speed, follow, rig)
    if telemetry is not None:
        from alight.flight.live.telemetry import with_telemetry

        opened = with_telemetry(opened, telemetry, separation)
    compile_if_cold()  # a lane that compiles does not answer
    with Display(console=stderr, transient=True, auto_refresh=False) as display:

        def tell(health: FlightHealth) -> None:
            if stderr.is_terminal:
                display.update(Text(health.line), refresh=True)

        inputs = [path] if (path := Path(source)).is_file() else []
        result = fly_live(
            opened.source, opened.events, out, chosen, record, opened.real_time, force, tell, inputs=inputs
        )
    leave_result(with_home(result, flown_home(wanted, opened.telemetry(), separation)), out, force)


def compile_if_cold() -> None:
    """Compile all loops if they are not in the cache: once, before a flight."""
    from alight import compiled

    if not compiled.is_warm():
        from alight.trials.warmup import compile_kernels

        complain("loops are compiled before the flight, once; 'alight warmup' does it ahead of time", "yellow")
        compile_kernels(lambda stage, share: None)
