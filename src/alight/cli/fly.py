"""Command that flies a landing: fly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group
from rich.live import Live as Display
from rich.table import Table
from rich.text import Text

from alight.cli.answers import leave_result
from alight.cli.app import (
    WRONG,
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
    say,
    stderr,
)
from alight.records import p_safe_text
from alight.records.executive import FlightState

if TYPE_CHECKING:
    from alight.checks.result import CheckResult
    from alight.flight.session import FlightOutcome, FlightStatus

NOT_LANDED = 4  # exit code: a landing was begun, and the vehicle has not landed by it
ANSWERS = {FlightState.LANDED: "LANDED", FlightState.RETURN: "RETURNED", FlightState.HANDED_OVER: "HANDED OVER"}


@app.command()
def fly(
    link: Annotated[
        str, typer.Option(metavar="LINK", help="The autopilot: udp:127.0.0.1:14550, tcp:HOST:PORT, serial:DEVICE:BAUD.")
    ],
    camera: Annotated[
        str, typer.Option(metavar="SOURCE", help="Cameras (camera:0,camera:2) or a folder that is being filled.")
    ],
    out: OutOption,
    rig: RigOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show every order instead of sending it.")] = False,
    take_off: Annotated[
        float | None, typer.Option(min=2.0, max=120.0, metavar="M", help="Arm and climb so high above home first.")
    ] = None,
    home: HomeOption = None,
    geoid: GeoidOption = None,
    separation: SeparationOption = None,
    imu: Annotated[
        float, typer.Option(min=0.0, max=1000.0, metavar="HZ", help="Rate of IMU samples to ask for; 0: none.")
    ] = 100.0,
    record: RecordOption = True,
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Fly a landing: search, look, look again from lower down, land or give up. A pilot must be ready to take over."""
    chosen = read_settings(settings, assign)
    refuse_unused(camera, False, rig)
    from alight.flight.session import FlightRequest, fly_vehicle
    from alight.runs import wanted_home

    request = FlightRequest(
        link, camera, out, chosen, rig, dry_run, wanted_home(home, geoid), separation, take_off,
        imu, record, force,
    )  # fmt: skip
    if stderr.is_terminal:
        with Display(console=stderr, transient=True, auto_refresh=False) as display:
            outcome = fly_vehicle(
                request, lambda status: display.update(page(status), refresh=True),
                lambda line: complain(line, "none"),
            )  # fmt: skip
    else:
        plain = _PlainPage()
        outcome = fly_vehicle(request, plain.tell, plain.say)
    for check in outcome.checks:
        say(check.line)
    _answer(outcome, dry_run)
    if outcome.result is None:
        raise typer.Exit(WRONG)
    leave_result(outcome.result, out, force)
    if not dry_run and outcome.state is not FlightState.LANDED:
        raise typer.Exit(NOT_LANDED)


def _answer(outcome: FlightOutcome, dry_run: bool) -> None:
    if outcome.state is None:
        say(f"NOT FLOWN  {outcome.why}")
    elif dry_run:
        say(f"DRY RUN  nothing was flown; {outcome.why}".removesuffix("; "))
    else:
        say(f"{ANSWERS.get(outcome.state, 'ENDED')}  {outcome.why}")


class _PlainPage:
    """Lines for a log: messages, the phase, and the status every ten seconds."""

    def __init__(self) -> None:
        self._phase, self._at = "", -math.inf

    def tell(self, status: FlightStatus) -> None:
        """Print the status, every ten seconds, and a new phase."""
        if status.phase != self._phase:
            self._phase = status.phase
            self.say(status.phase)
        if status.view is not None and status.view.t - self._at >= 10.0:
            self._at = status.view.t
            self.say("; ".join(f"{name} {value}" for name, value in facts(status)))

    def say(self, line: str) -> None:
        """Print one line on stderr."""
        complain(line, "none")


def page(status: FlightStatus) -> Group:
    """The terminal's page."""
    table = Table.grid(padding=(0, 2))
    for name, value in facts(status):
        table.add_row(Text(name, style="bold"), value)
    return Group(table, *(Text(line) for line in _unwell(status.checks)))


def _unwell(checks: Sequence[CheckResult]) -> list[str]:
    return [c.line for c in checks if c.verdict != "good"]


def facts(status: FlightStatus) -> Iterator[tuple[str, str]]:
    """Name and value of each fact of the status for a person."""
    view, heard = status.view, status.telemetry
    yield "state", status.phase if view is None else view.state.value
    if view is not None:
        yield "time", f"{view.t:.0f} s"
        yield "order", view.order
        if (p := view.target) is not None:
            yield "place", f"{p.kind} at east {p.east:.1f} m north {p.north:.1f} m, P(safe) {p_safe_text(p.p_safe)}"
        if view.height is not None:
            yield "height", f"{view.height:.1f} m above {'it' if view.target is not None else 'the ground'}"
        yield "motion", f"{view.situation.state.name.lower()}, newest picture {view.situation.picture_age:.1f} s old"
    if heard is not None:
        age = heard.ages.get("HEARTBEAT", math.nan)
        yield "link", f"{heard.firmware}, {heard.mode_name or 'no mode'}, heartbeat {age:.1f} s ago"
        yield "battery", "not reported" if math.isnan(heard.battery.share) else f"{100 * heard.battery.share:.0f} %"
    if status.health is not None:
        yield "lanes", status.health.line
