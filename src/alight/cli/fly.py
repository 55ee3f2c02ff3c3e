"""Command that flies a landing: fly."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from alight.cli import options
from alight.cli.app import ExitCode, app
from alight.cli.terminal import is_terminal, live_table, print_line, print_stderr, save_result

if TYPE_CHECKING:
    from alight.flight.session import FlightOutcome, FlightRequest, FlightStatus


@app.command()
def fly(
    link: Annotated[
        str, typer.Option(metavar="LINK", help="The autopilot: udp:127.0.0.1:14550, tcp:HOST:PORT, serial:DEVICE:BAUD.")
    ],
    camera: Annotated[
        str, typer.Option(metavar="SOURCE", help="Cameras (camera:0,camera:2) or a folder that is being filled.")
    ],
    out: options.Out,
    rig: options.Rig = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show every order instead of sending it.")] = False,
    take_off: Annotated[
        float | None, typer.Option(min=2.0, max=120.0, metavar="M", help="Arm and climb so high above home first.")
    ] = None,
    home: options.ArmedAt = None,
    geoid: options.Geoid = None,
    separation: options.Separation = None,
    imu: Annotated[
        float, typer.Option(min=0.0, max=1000.0, metavar="HZ", help="Rate of IMU samples to ask for; 0: none.")
    ] = 100.0,
    record: options.Record = True,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Fly a landing: search, look, look again from lower down, land or give up. A pilot must be ready to take over."""
    chosen = options.read_settings(settings, assign)
    options.refuse_unused(camera, False, rig)
    from alight.flight.session import FlightRequest
    from alight.records.executive import FlightState
    from alight.runs import wanted_home

    request = FlightRequest(
        link, camera, out, chosen, rig, dry_run, wanted_home(home, geoid), separation, take_off,
        imu, record, force,
    )  # fmt: skip
    outcome = _flown(request)
    for check in outcome.checks:
        print_line(check.line)
    if outcome.state is None:
        print_line(f"NOT FLOWN  {outcome.why}")
    elif dry_run:
        print_line(f"DRY RUN  nothing was flown; {outcome.why}".removesuffix("; "))
    else:
        words = {FlightState.LANDED: "LANDED", FlightState.RETURN: "RETURNED", FlightState.HANDED_OVER: "HANDED OVER"}
        print_line(f"{words.get(outcome.state, 'ENDED')}  {outcome.why}")
    if outcome.result is None:
        raise typer.Exit(ExitCode.FAULT_FOUND)
    save_result(outcome.result, out, force)
    if not dry_run and outcome.state is not FlightState.LANDED:
        raise typer.Exit(ExitCode.NOT_LANDED)


def _flown(request: FlightRequest) -> FlightOutcome:
    """Fly; the status is a table on a terminal, else a line at a new phase and every ten seconds."""
    from alight.flight.session import fly_vehicle

    if is_terminal():
        with live_table() as show:
            return fly_vehicle(
                request,
                lambda status: show(facts(status), [c.line for c in status.checks if c.verdict != "good"]),
                lambda line: print_stderr(line, "none"),
            )
    phase, printed = "", -math.inf

    def report(status: FlightStatus) -> None:
        nonlocal phase, printed
        if status.phase != phase:
            phase = status.phase
            print_stderr(phase)
        if status.view is not None and status.view.t - printed >= 10.0:
            printed = status.view.t
            print_stderr("; ".join(f"{name} {value}" for name, value in facts(status)))

    return fly_vehicle(request, report, print_stderr)


def facts(status: FlightStatus) -> Iterator[tuple[str, str]]:
    """Name and value of each fact of the status for a person."""
    from alight.records import p_safe_text

    view, telemetry = status.view, status.telemetry
    yield "state", status.phase if view is None else view.state.value
    if view is not None:
        yield "time", f"{view.t:.0f} s"
        yield "order", view.order
        if (p := view.target) is not None:
            yield "place", f"{p.kind} at east {p.east:.1f} m north {p.north:.1f} m, P(safe) {p_safe_text(p.p_safe)}"
        if view.height is not None:
            yield "height", f"{view.height:.1f} m above {'it' if view.target is not None else 'the ground'}"
        yield "motion", f"{view.situation.state.name.lower()}, newest picture {view.situation.picture_age:.1f} s old"
    if telemetry is not None:
        age = telemetry.ages.get("HEARTBEAT", math.nan)
        yield "link", f"{telemetry.firmware}, {telemetry.mode_name or 'no mode'}, heartbeat {age:.1f} s ago"
        yield (
            "battery",
            "not reported" if math.isnan(telemetry.battery.share) else f"{100 * telemetry.battery.share:.0f} %",
        )
    if status.health is not None:
        yield "lanes", status.health.line
