"""Commands of a flight: live, fly."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alight.cli import options
from alight.cli.app import ExitCode, app
from alight.cli.terminal import is_terminal, live_table, print_line, print_stderr, progress_bar, save_result

if TYPE_CHECKING:
    from alight.flight.session.outcome import FlightOutcome
    from alight.flight.session.request import FlightRequest, FlightStatus


@dataclass(kw_only=True)
class FlightOptions(options.ShownOptions, options.RouteOptions):
    """Options of `alight live` and `alight fly`."""

    rig: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Calibration of cameras: cam0/sensor.yaml and so on.")
    ] = None
    separation: Annotated[
        float | None,
        typer.Option(
            min=-200.0, max=200.0, help="Ellipsoid minus sea level, m, where the receiver does not report it."
        ),
    ] = None
    signing_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Passphrase of MAVLink 2 signing; unsigned messages are dropped."),
    ] = None
    odometry: Annotated[
        bool,
        typer.Option("--odometry", help="Send the motion as ODOMETRY; where GPS fails, the autopilot flies by it."),
    ] = False
    zones: options.Zones = None
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Record everything that comes in, and what is done, as MCAP.")
    ] = True

    def refuse_unused(self, source: str, follow: bool = False, speed: float = 1.0) -> None:
        """Refuse options that have no effect with this source.

        Args:
            source: a recording, a folder, or cameras.
            follow, speed: options of `alight live`; see `LiveOptions`.

        Raises:
            InputError: an option has no effect; the message names it.
        """
        from alight.records import InputError
        from alight.sources.live import is_cameras

        cameras = is_cameras(source)
        if cameras and follow:
            raise InputError("--follow: is for a folder that is being filled, and cameras are none; leave it out")
        if speed != 1.0 and (cameras or follow):
            raise InputError("--speed: is of a flight log or a recording; cameras and folders that fill have their own")
        if self.rig is not None and not cameras:
            raise InputError(f"--rig: is for cameras; {source} brings its own calibration; leave it out")


@dataclass(kw_only=True)
class LiveOptions(FlightOptions):
    """Options of `alight live`."""

    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A flight log, a recording (.mcap), a folder being filled, or cameras: camera:0,camera:2",
        ),
    ]
    speed: Annotated[float, typer.Option(min=0.01, help="Replay speed of a recording: 2 is twice as fast.")] = 1.0
    follow: Annotated[
        bool,
        typer.Option(
            "--follow", help="The folder or bag is being written; the run ends after 10 s without anything new."
        ),
    ] = False
    topic: options.Topic = None
    topics: options.TopicFile = None
    telemetry: Annotated[
        str | None, typer.Option(metavar="LINK", help="Autopilot that provides GPS/INS: udp:0.0.0.0:14550.")
    ] = None


@app.command()
@options.command_of(LiveOptions)
def live(o: LiveOptions) -> None:
    """Find a landing site during a flight. Ctrl-C ends it; the map is then judged as it is."""
    o.refuse_unshown()
    chosen = o.read_settings()
    o.refuse_unused(o.source, o.follow, o.speed)
    from alight.flight.live.run import LiveRequest, fly_live
    from alight.records import InputError
    from alight.runner.opening import open_live
    from alight.runs import flown_home, wanted_home, with_home, zones_of

    wanted = wanted_home(o.home, o.geoid)
    if o.signing_key is not None and o.telemetry is None:
        raise InputError("--signing-key: signs the link of --telemetry; give both or leave it out")
    if o.odometry and o.telemetry is None:
        raise InputError("--odometry: is sent over the link of --telemetry; give both or leave it out")
    topics = options.named_topics(o.topic, o.topics)
    opened = open_live(o.source, chosen, o.speed, o.follow, o.rig, topics=topics)
    if o.telemetry is not None:
        from alight.flight.live.signing_key import read_signing_key
        from alight.flight.live.telemetry import with_telemetry

        key = None if o.signing_key is None else read_signing_key(o.signing_key)
        opened = with_telemetry(opened, o.telemetry, o.separation, key, o.odometry)
    zones = zones_of(opened.source, chosen, o.zones)
    compile_if_cold()  # a lane cannot answer while it compiles
    inputs = [path for path in (Path(o.source), o.zones) if path is not None and path.is_file()]
    request = LiveRequest(o.out, chosen, o.record, opened.real_time, o.force, inputs, zones)
    with live_table() as show:
        result = fly_live(opened.source, opened.events, request, lambda line: show((), [line]), opened.on_motion)
    save_result(with_home(result, flown_home(wanted, opened.telemetry(), o.separation)), o.out, o.force)
    o.show(o.out)


def compile_if_cold() -> None:
    """Compile all loops, once before a flight, if they are not in the cache."""
    from alight import compiled
    from alight.loop_forms import compile_loops

    if not compiled.is_warm():
        print_stderr("loops are compiled before the flight, once; 'alight warmup' does it ahead of time")
    with progress_bar() as report:
        compile_loops("flight", progress=report)


@dataclass(kw_only=True)
class FlyOptions(FlightOptions):
    """Options of `alight fly`."""

    link: Annotated[
        str, typer.Option(metavar="LINK", help="The autopilot: udp:127.0.0.1:14550, tcp:HOST:PORT, serial:DEVICE:BAUD.")
    ]
    camera: Annotated[
        str, typer.Option(metavar="SOURCE", help="Cameras (camera:0,camera:2) or a folder that is being filled.")
    ]
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show every order instead of sending it.")] = False
    take_off: Annotated[
        float | None,
        typer.Option(min=2.0, max=120.0, metavar="M", help="Arm and climb to this height above home first."),
    ] = None
    sites: Annotated[
        Path | None, typer.Option(metavar="OUT", help="Folder of an earlier run: look at its sites first, in order.")
    ] = None
    imu: Annotated[
        float, typer.Option(min=0.0, max=1000.0, metavar="HZ", help="Rate of IMU samples to request; 0: none.")
    ] = 100.0


@app.command()
@options.command_of(FlyOptions)
def fly(o: FlyOptions) -> None:
    """Fly a landing: search, look, look again from lower down, land or give up. A pilot must be ready to take over."""
    o.refuse_unshown()
    chosen = o.read_settings()
    o.refuse_unused(o.camera)
    from alight.flight.session.request import FlightRequest
    from alight.outputs.reading import read_sites
    from alight.records.executive import FlightState
    from alight.runs import wanted_home
    from alight.sources.zones import read_zones

    request = FlightRequest(
        o.link, o.camera, o.out, chosen, o.rig, o.dry_run, wanted_home(o.home, o.geoid), o.separation, o.take_off,
        o.imu, o.signing_key, o.record, o.force, () if o.sites is None else read_sites(o.sites),
        None if o.zones is None else read_zones(o.zones), o.odometry,
    )  # fmt: skip
    outcome = _flown(request)
    for check in outcome.checks:
        print_line(check.line)
    if outcome.state is None:
        print_line(f"NOT FLOWN  {outcome.why}")
    elif o.dry_run:
        print_line(f"DRY RUN  nothing was flown; {outcome.why}".removesuffix("; "))
    else:
        words = {FlightState.LANDED: "LANDED", FlightState.RETURN: "RETURNED", FlightState.HANDED_OVER: "HANDED OVER"}
        print_line(f"{words.get(outcome.state, 'ENDED')}  {outcome.why}")
    if outcome.result is None:
        raise typer.Exit(ExitCode.FAULT_FOUND)
    landed = outcome.state is FlightState.LANDED and not o.dry_run
    save_result(outcome.result, o.out, o.force, not landed)
    o.show(o.out)
    if not (landed or o.dry_run):
        raise typer.Exit(ExitCode.NOT_LANDED)


def _flown(request: FlightRequest) -> FlightOutcome:
    """Fly and show the status: a table on a terminal, otherwise a line at each new phase and every ten seconds."""
    from alight.flight.session.flight import fly_vehicle

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
    """Yield the name and value of each fact of the status, as text."""
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
        age, share = telemetry.ages.get("HEARTBEAT", math.nan), telemetry.battery.share
        yield "link", f"{telemetry.firmware}, {telemetry.mode_name or 'no mode'}, heartbeat {age:.1f} s ago"
        yield "battery", "not reported" if math.isnan(share) else f"{100 * share:.0f} %"
    if status.health is not None:
        yield "lanes", status.health
