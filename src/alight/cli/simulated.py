"""Commands of the simulator: demo, simulate, rehearse, campaign."""

from __future__ import annotations

import shlex
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from alight.cli import options
from alight.cli.app import ExitCode, app
from alight.cli.terminal import print_line, print_result, print_stderr, progress_bar

if TYPE_CHECKING:  # the simulator is slow to import, and most commands do not need it
    from alight.trials.campaign.run import Campaign, Ended
    from alight_sim.oracle import Touchdown
    from alight_sim.scene import Scene

PORT, HEIGHT = 14550, 30.0  # of a rehearsal; m above the ground


@dataclass(kw_only=True)
class DemoOptions(options.ShownOptions, options.ResultOptions):
    """Options of `alight demo`."""

    out: options.Out = Path("out/demo")
    seed: options.Seed = 1


@app.command()
@options.command_of(DemoOptions)
def demo(o: DemoOptions) -> None:
    """Land a simulated vehicle: search, look, look again from lower down, touch down."""
    o.refuse_unshown()
    chosen = o.read_settings()
    from alight.loop_forms import compile_loops
    from alight.outputs import write_run
    from alight.trials.demo import fly_demo

    with TemporaryDirectory() as folder:
        recording = Path(folder) / "demo.mcap" if o.film or o.view else None
        with progress_bar() as report:
            compile_loops("simulator", "flight", progress=report)
            landing = fly_demo(o.out, o.seed, chosen, o.force, report, recording)
        print_result(landing.result)
        write_run(landing.result, o.out, o.force)
        for line in landing.lines:
            print_line(line)
        print_line(f"report: {o.out / 'report.html'}")
        o.show(o.out, recording)


@dataclass(kw_only=True)
class SimulateOptions:
    """Options of `alight simulate`."""

    scene: Annotated[
        str | None, typer.Argument(metavar="SCENE", help="A scene file (YAML), or the name of a built-in scene.")
    ] = None
    out: Annotated[Path | None, typer.Option(metavar="FLIGHT", help="Folder for the flight log.")] = None
    seed: options.Seed = 0
    show: Annotated[bool, typer.Option("--list", help="Show the built-in scenes.")] = False
    keys: Annotated[bool, typer.Option("--keys", help="Print every key of a scene file, as Markdown.")] = False
    height: Annotated[float | None, typer.Option(help="Metres above the ground, instead of the scene's.")] = None
    duration: Annotated[float | None, typer.Option(help="Seconds of a transect or a hover.")] = None
    speed: Annotated[float | None, typer.Option(help="Metres a second.")] = None
    assign: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One key of the scene: light.clouds.share=0.4."),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Replace a simulated flight of that name.")] = False
    verbose: options.Verbose = False


@app.command()
@options.command_of(SimulateOptions)
def simulate(o: SimulateOptions) -> None:
    """Simulate a flight over generated ground, with exact truth."""
    if o.show:
        _print_scenes()
        return
    if o.keys:
        from alight_sim.keys import reference

        print_line(reference().rstrip("\n"))
        return
    if o.scene is None or o.out is None:
        raise typer.BadParameter("needs SCENE and --out FLIGHT; --list shows the built-in scenes")
    given = {"height": o.height, "duration": o.duration, "speed": o.speed}
    wishes = [f"flight.{key}={value}" for key, value in given.items() if value is not None]
    scene, out = read_scene_with(o.scene, [*wishes, *(o.assign or ())], o.seed), o.out
    import alight_sim as simulator
    from alight.loop_forms import compile_loops

    with progress_bar() as report:
        compile_loops("simulator", progress=report)
        report("world", 0.0)
        flight = simulator.fly(scene, o.seed)
        report("world", 1.0)
        simulator.write(flight, out, lambda done, total: report("flying", done / total), overwrite=o.force)
    cameras = len(flight.rig.cameras)
    print_line(
        f"flight: {out}  ({scene.name}, seed {o.seed}: {flight.seconds:.1f} s, {flight.length} exposures of "
        f"{cameras} camera{'s' if cameras > 1 else ''}, truth beside them)"
    )
    results = out.with_name(f"{out.name}-run") if out.name not in ("", "..") else Path("run")
    made, found = shlex.quote(str(out)), shlex.quote(str(results))
    print_line(f"go on:  alight run {made} --out {found} && alight evaluate {found} --truth {made}")


def read_scene_with(scene: str, assignments: list[str], seed: int = 0) -> Scene:
    """Read a built-in scene by its name, or a scene file, with `key=value` assignments that override it.

    Args:
        seed: seed of the values that the scene file leaves to chance.

    Raises:
        InputError: the scene does not exist, or cannot be read.
        SettingsError: an assignment names no key, or its value is out of range.
    """
    from alight.documents import parse_yaml, read_text
    from alight.records import InputError, SettingsError
    from alight_sim.scene import built_in, parse_scene, read_scene

    path = built_in().get(scene, Path(scene))
    if not path.exists():
        raise InputError(f"{scene}: no such file and no built-in scene; 'alight simulate --list' shows those")
    found = read_scene(path, seed)
    if not assignments:
        return found
    tree = {"name": path.stem} | (parse_yaml(read_text(path)) or {})
    for a in assignments:
        _assign(tree, a)
    try:
        return parse_scene(tree, f"{scene} with {' '.join(assignments)}", path.parent, seed)
    except InputError as e:
        raise SettingsError(str(e)) from e


def _item(part: str) -> int:
    number = int(part)
    if number < 1:
        raise IndexError(part)
    return number - 1


def _assign(tree: dict[str, Any], assignment: str) -> None:
    """Put the value of a `key=value` assignment into the tree of a scene; list items are numbered from 1."""
    from alight.documents import DocumentError, parse_yaml
    from alight.records import SettingsError

    key, sep, value = assignment.partition("=")
    if not sep or not all(part.strip() for part in key.split(".")):
        raise SettingsError(f"--set takes key=value, got {assignment!r}")
    try:
        wanted = parse_yaml(value)
    except DocumentError as e:
        raise SettingsError(f"--set {assignment}: {e}") from e
    *path, last = key.strip().split(".")
    at: Any = tree
    try:
        for part in path:
            at = at[_item(part)] if isinstance(at, list) else at.setdefault(part, {})
        at[_item(last) if isinstance(at, list) else last] = wanted
    except (ValueError, IndexError, TypeError, AttributeError) as e:
        raise SettingsError(f"--set {assignment}: does not fit the scene; its keys stand in the scene's file") from e


def _print_scenes() -> None:
    from rich.console import Console

    from alight.cli.display import scene_card
    from alight_sim.scene import FOLDER, built_in, read_scene

    console = Console()
    colour = console.is_terminal and console.color_system is not None
    for name, path in built_in().items():
        scene, picture = read_scene(path), FOLDER / "pictures" / f"{name}.jpg"
        if colour and picture.exists():
            console.print(scene_card(name, scene.description, picture))
        else:
            print_line(f"{name:<14} {scene.description}")
            print_line(f"{'':<14} {picture if picture.exists() else path}")


@dataclass(kw_only=True)
class RehearseOptions:
    """Options of `alight rehearse`."""

    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A scene file (YAML), or the name of a built-in scene.")]
    folder: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the pictures: the --camera of alight fly.")]
    port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of this machine where alight fly listens.")] = (
        PORT
    )
    seed: options.Seed = 0
    height: Annotated[
        float, typer.Option(min=0.0, max=500.0, help="Metres above the ground at the start; 0: it stands.")
    ] = HEIGHT
    width: Annotated[int, typer.Option(min=80, max=4000, help="Width of the pictures, pixels; the height follows.")] = (
        320
    )
    rate: Annotated[float, typer.Option(min=1.0, max=100.0, help="Exposures a second.")] = 5.0
    wind: Annotated[float, typer.Option(min=0.0, max=50.0, help="Wind from the west, m/s.")] = 0.0
    autopilot: options.Firmware = "ardupilot"
    follow: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Draw the pictures for another autopilot (a SITL) where it reports itself, on a link of its own: "
            "tcp:127.0.0.1:5762.",
        ),
    ] = None
    seconds: Annotated[float, typer.Option(min=1.0, help="Length of the rehearsal, s.")] = 900.0
    verbose: options.Verbose = False

    @property
    def pictures(self) -> dict[str, Any]:
        """Size (width, height) and rate of the pictures."""
        return {"size": (self.width, self.width * 3 // 4), "rate_hz": self.rate}


@app.command()
@options.command_of(RehearseOptions)
def rehearse(o: RehearseOptions) -> None:
    """Simulate an autopilot and its cameras in real time, to try alight fly; Ctrl-C ends it."""
    found = _rehearsed(o) if o.follow is None else _followed(o, o.follow)
    if found is None:
        print_line("it has not touched the ground")
        return
    verdict = "safe" if found.safe else f"unsafe ({', '.join(found.reasons)})"
    print_line(f"touchdown at east {found.east:.2f} m north {found.north:.2f} m: {verdict}")


def _rehearsed(o: RehearseOptions) -> Touchdown | None:
    """Fly the simulated autopilot; return the oracle's verdict on its touchdown, None without a touchdown."""
    from alight_sim.autopilot import PX4_CONTROLLER
    from alight_sim.oracle import OracleLander
    from alight_sim.rehearsal import Rehearsal
    from alight_sim.steered import SteeredFlight
    from alight_sim.steered.touchdown import judge_flight
    from alight_sim.world import START

    lander, (east, north, _), px4 = OracleLander(), START, o.autopilot == "px4"
    flight = SteeredFlight(
        o.scene, o.seed, start=(east, north, o.height), wind=(o.wind, 0.0, 0.0), radius=lander.reach,
        limits=PX4_CONTROLLER if px4 else None, **o.pictures,
    )  # fmt: skip
    with Rehearsal(flight, o.folder, o.port, px4) as rehearsal:
        print_line(f"ready: alight fly --link udp:127.0.0.1:{o.port} --camera {shlex.quote(str(o.folder))} --out OUT")
        with suppress(KeyboardInterrupt):
            rehearsal.wait(o.seconds, lambda: flight.contact is not None and not rehearsal.autopilot.logic.armed)
            rehearsal.wait(5.0)
    if rehearsal.server.behind > 1.0:  # s
        print_stderr(
            f"warning: the simulation was up to {rehearsal.server.behind:.0f} s behind the clock: this machine is too "
            "slow for it; lower --rate or --width"
        )
    return judge_flight(flight, lander)


def _followed(o: RehearseOptions, link: str) -> Touchdown | None:
    from alight.records import InputError
    from alight.trials.rehearse import follow_vehicle
    from alight_sim.followed import FollowedCameras
    from alight_sim.world import START

    others, (east, north, _) = o.autopilot != "ardupilot", START
    given = {"--port": o.port != PORT, "--height": o.height != HEIGHT, "--wind": o.wind > 0.0, "--autopilot": others}
    if any(given.values()):
        which = " and ".join(name for name, is_given in given.items() if is_given)
        raise InputError(f"{which}: the autopilot that is followed decides that; leave it out, or --follow")
    cameras, found = FollowedCameras(o.scene, o.seed, start=(east, north), **o.pictures), None
    with suppress(KeyboardInterrupt):
        found = follow_vehicle(link, cameras, o.folder, o.seconds, print_line)
    if cameras.left_out:
        print_stderr(f"warning: {cameras.left_out} exposures were left out: this machine is too slow for them")
    return found


@dataclass(kw_only=True)
class CampaignOptions(options.SettingsOptions):
    """Options of `alight campaign`."""

    out: options.Out
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="SCENES", help="Names, scene files, or 'all'; none: go on with OUT.")
    ] = None
    worlds: Annotated[
        list[str] | None,
        typer.Option("--world", metavar="PACKAGE.MODULE:FACTORY", help="A world of another package; may be repeated."),
    ] = None
    landings: Annotated[int | None, typer.Option(min=1, max=100_000, help="Number of landings; 20 unless given.")] = (
        None
    )
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all random choices; 0.")] = None
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes that fly landings on this machine.")] = 1
    scheduler: options.Scheduler = None
    only: Annotated[int | None, typer.Option(metavar="K", min=0, help="Fly landing K again and write nothing.")] = None
    look_again: Annotated[
        bool | None, typer.Option("--look-again/--no-look-again", help="Look again from lower heights before landing.")
    ] = None
    link_faults: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the landings with a takeover, a lost link, refused modes.")
    ] = 0.0
    people: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the landings in which a person or car comes to the site.")
    ] = 0.0
    autopilot: options.Firmware = "ardupilot"
    odometry: Annotated[
        bool,
        typer.Option("--odometry", help="Send odometry, and let GPS fail in every landing instead of other parts."),
    ] = False
    compare: Annotated[Path | None, typer.Option(metavar="OTHER", help="Another campaign, for a table of both.")] = None


@app.command()
@options.command_of(CampaignOptions)
def campaign(o: CampaignOptions) -> None:
    """Fly many simulated landings in closed loop and report their outcomes; an interrupted campaign is continued."""
    looks = [] if o.look_again is None else [f"executive.look_again={str(o.look_again).lower()}"]
    chosen = o.read_settings(after=looks)
    from alight.records import InputError
    from alight.trials.campaign import run as runner
    from alight.trials.campaign.page import comparison
    from alight.trials.campaign.worlds import FORM, is_factory

    if wrong := [w for w in o.worlds or [] if not is_factory(w)]:
        raise InputError(f"--world {wrong[0]}: {FORM}")
    if named := [*(o.scenes or []), *(o.worlds or [])]:
        wanted = runner.wanted_landings(o.out, o.landings)
        planned = runner.Campaign(named, wanted, o.seed or 0, chosen, o.link_faults, o.autopilot, o.odometry, o.people)
    elif (
        o.settings
        or o.assign
        or looks
        or o.seed is not None
        or o.link_faults
        or o.people
        or o.odometry
        or o.autopilot != "ardupilot"
    ):
        raise InputError("name SCENES or --world beside the options of a new campaign; without, OUT's own are used")
    else:
        planned = runner.continued(o.out, o.landings)
    if o.only is not None:
        _again(planned, o.out, o.only)
        return
    numbers = runner.fly_campaign(planned, o.out, o.jobs, o.scheduler, o.compare, print_landing)
    for line in runner.outcome_lines(numbers):
        print_line(line)
    if o.compare is not None:
        for name, one, two in comparison(numbers, runner.numbers_in(o.compare)):
            print_line(f"{name:<34} {one:>10} {two:>10}")
    print_line(f"report: {o.out / 'campaign.html'}")
    if failed := numbers.outcomes["failed"]:
        print_stderr(f"{failed} landings failed: the report says why, and counts nothing of them as safe", "bold red")
        raise typer.Exit(ExitCode.FAULT_FOUND)


def _again(planned: Campaign, out: Path, only: int) -> None:
    from alight.trials.campaign.run import again

    found = again(planned, out, only)
    print_line(found.record.model_dump_json())
    fault = f"was not compared: {found.not_compared}" if found.not_compared is not None else ""
    if found.differing:
        fault = f"is not as in {out}: {', '.join(found.differing)}"
    if fault:
        print_stderr(f"landing {only} {fault}", "bold red")
        raise typer.Exit(ExitCode.FAULT_FOUND)


def print_landing(ended: Ended) -> None:
    """Print one line on stderr about a landing that has ended."""
    from alight.records import p_safe_text

    r = ended.record
    parts = [
        f"#{r.number} {r.conditions.scene}: {r.outcome}",
        r.error or r.why if r.outcome != "landed safely" else "",
        "" if r.p_at_commit is None else f"P(safe) {p_safe_text(r.p_at_commit)}",
        *(f"with {f.what}" for f in r.conditions.faults if f.happened is not None),
        f"{r.seconds:.0f} s",
        f"{r.cpu_s:.0f} s of CPU",
        f"{_clock(ended.left_s)} left" if ended.done < ended.of else "",
    ]
    style = "none" if r.is_right else "yellow"
    print_stderr(", ".join([f"{ended.done}/{ended.of}", *filter(None, parts)]), style)


def _clock(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
