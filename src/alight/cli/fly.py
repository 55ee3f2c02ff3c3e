"""Command that flies a landing: fly."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group
from rich.live import Live as Display
from rich.table import Table
from rich.text import Text

from alight.cli.app import (
    ForceOption,
    GeoidOption,
    HomeOption,
    OutOption,
    RecordOption,
    RigOption,
    SeedOption,
    SeparationOption,
    SetOption,
    SettingsOption,
    VerboseOption,
    app,
    complain,
    read_settings,
    say,
    stderr,
)
from alight.cli.check import WRONG
from alight.cli.live import refuse_unused
from alight.cli.runs import leave_result
from alight.records import InputError, p_safe_text
from alight.records.executive import FlightState
from alight.records.telemetry import FirmwareName

if TYPE_CHECKING:
    from alight.checks import CheckResult
    from alight.flight.session import FlightOutcome, FlightStatus
    from alight_sim.oracle import Touchdown

PLACE = (-20.0, -12.0)  # m east and north in the scene, where a rehearsal begins
NOT_LANDED = 4  # exit code: a landing was begun, and the vehicle has not landed by it
NOT_DOWN = "it has not touched the ground"
PORT, HEIGHT = 14550, 30.0  # of a rehearsal; m above the ground
BEHIND = 1.0  # s, from which a rehearsal reports that the machine is too slow
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


@app.command()
def rehearse(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="A scene file (YAML), or the name of a built-in scene.")
    ],
    folder: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Filled with the pictures: the --camera of alight fly.")
    ],
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of this machine, where alight fly listens.")] = PORT,
    seed: SeedOption = 0,
    height: Annotated[
        float, typer.Option(min=0.0, max=500.0, help="Metres above the ground at the start; 0: it stands.")
    ] = HEIGHT,
    width: Annotated[int, typer.Option(min=80, max=4000, help="Of the pictures, pixels; the height follows.")] = 320,
    rate: Annotated[float, typer.Option(min=1.0, max=100.0, help="Exposures a second.")] = 5.0,
    wind: Annotated[float, typer.Option(min=0.0, max=50.0, help="From the west, m/s.")] = 0.0,
    autopilot: Annotated[FirmwareName, typer.Option(help="Whose dialect it speaks.")] = "ardupilot",
    follow: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Draw the pictures for another autopilot (a SITL) where it says that it is, on a link of its own: "
            "tcp:127.0.0.1:5762.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="Then it ends.")] = 900.0,
    verbose: VerboseOption = False,
) -> None:
    """Simulate an autopilot and its cameras in real time, to try alight fly; Ctrl-C ends it."""
    if follow is not None:
        others = autopilot != "ardupilot"
        given = {"--port": port != PORT, "--height": height != HEIGHT, "--wind": wind > 0.0, "--autopilot": others}
        if any(given.values()):
            which = " and ".join(name for name, is_given in given.items() if is_given)
            raise InputError(f"{which}: the autopilot that is followed decides that; leave it out, or --follow")
        _follow(follow, scene, seed, folder, width, rate, seconds)
        return
    from alight_sim.oracle import OracleLander
    from alight_sim.rehearsal import Rehearsal
    from alight_sim.steered import SteeredFlight
    from alight_sim.steered.touchdown import judge_flight

    lander = OracleLander()
    flight = SteeredFlight(
        scene, seed, size=_size(width), rate_hz=rate, start=(*PLACE, height), wind=(wind, 0.0, 0.0),
        radius=lander.reach,
    )  # fmt: skip
    with Rehearsal(flight, folder, port, autopilot == "px4") as rehearsal:
        say(f"ready: alight fly --link udp:127.0.0.1:{port} --camera {shlex.quote(str(folder))} --out OUT")
        try:
            rehearsal.wait(seconds, lambda: flight.contact is not None and not rehearsal.autopilot.logic.armed)
            rehearsal.wait(5.0)
        except KeyboardInterrupt:
            pass
    if rehearsal.server.behind > BEHIND:
        complain(
            f"warning: the simulation was up to {rehearsal.server.behind:.0f} s behind the clock: this machine is too "
            "slow for it; lower --rate or --width",
            "yellow",
        )
    found = judge_flight(flight, lander)
    say(NOT_DOWN if found is None else _touchdown_words(found))


def _size(width: int) -> tuple[int, int]:
    return width, width * 3 // 4


def _follow(link: str, scene: str, seed: int, folder: Path, width: int, rate: float, seconds: float) -> None:
    from alight.trials.rehearse import follow_vehicle
    from alight_sim.followed import FollowedCameras

    cameras, found = FollowedCameras(scene, seed, size=_size(width), rate_hz=rate, start=PLACE), None
    with suppress(KeyboardInterrupt):
        found = follow_vehicle(link, cameras, folder, seconds, say)
    if cameras.left_out:
        complain(f"warning: {cameras.left_out} exposures were left out: this machine is too slow for them", "yellow")
    say(NOT_DOWN if found is None else _touchdown_words(found))


def _touchdown_words(found: Touchdown) -> str:
    verdict = "safe" if found.safe else f"unsafe ({', '.join(found.reasons)})"
    return f"touchdown at east {found.east:.2f} m north {found.north:.2f} m: {verdict}"


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
        if view.place is not None:
            east, north, _ = view.place
            yield (
                "place",
                f"{view.kind} at east {east:.1f} m north {north:.1f} m, P(safe) {p_safe_text(view.p_safe or 0.0)}",
            )
        if view.height is not None:
            yield "height", f"{view.height:.1f} m above {'it' if view.place is not None else 'the ground'}"
        yield "motion", f"{view.situation.state.name.lower()}, newest picture {view.situation.picture_age:.1f} s old"
    if heard is not None:
        age = heard.ages.get("HEARTBEAT", math.nan)
        yield "link", f"{heard.firmware}, {heard.mode_name or 'no mode'}, heartbeat {age:.1f} s ago"
        yield "battery", "not reported" if math.isnan(heard.battery.share) else f"{100 * heard.battery.share:.0f} %"
    if status.health is not None:
        yield "lanes", status.health.line
