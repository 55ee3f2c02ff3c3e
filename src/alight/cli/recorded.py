"""Commands without a flight: run, judge, check, evaluate, hazards, terrain, settings, warmup, doctor."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from alight.cli import options
from alight.cli.app import ExitCode, app
from alight.cli.terminal import print_answer, print_line, print_stderr, progress_bar, save_result

if TYPE_CHECKING:
    from alight.records import Tally
    from alight.result import Result
    from alight.settings import Settings
    from alight.sources.raster_plane import RasterPlane
    from alight.training.confusion import Confusion

log = logging.getLogger(__name__)
terrain = typer.Typer(help="Train and test the model of what ground looks like.")
app.add_typer(terrain, name="terrain")
SamplingOption = Annotated[
    float, typer.Option("--gsd", min=0.001, max=1.0, help="Metres a pixel, where no index.csv gives it.")
]


@dataclass(kw_only=True)
class RunOptions(options.ShownOptions, options.RouteOptions):
    """Options of `alight run`."""

    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A flight log, a ROS bag, photos, frames with a log, or a video.")
    ]
    poses: Annotated[
        str | None, typer.Option(metavar="FILE|truth", help="Body poses (TUM, ENU) instead of the estimate.")
    ] = None
    quality: Annotated[
        Literal["fast", "normal", "fine"] | None,
        typer.Option(help="Size of the cells: the same as --set parallax.quality=..."),
    ] = None
    prior_dem: Annotated[
        Path | None, typer.Option(metavar="DEM", help="Heights from elsewhere: to begin with and to compare with.")
    ] = None
    places: options.Places = None
    zones: options.Zones = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted run of the same photos and settings in OUT.")
    ] = False
    scheduler: options.Scheduler = None
    topic: options.Topic = None
    topics: options.TopicFile = None


@app.command()
@options.command_of(RunOptions)
def run(o: RunOptions) -> None:
    """Find a landing site in a recorded flight or a folder of photos."""
    o.refuse_unshown()
    chosen = o.read_settings(after=[f"parallax.quality={o.quality}"] if o.quality else ())
    from alight.runner import replay
    from alight.runs import known_home

    armed_at = known_home(o.home, o.geoid if o.home else None)
    topics = options.named_topics(o.topic, o.topics)
    wishes = replay.Find(
        chosen, o.poses, o.force, o.resume, o.prior_dem, o.scheduler, armed_at, o.places, o.geoid, topics,
        o.zones,
    )  # fmt: skip
    with progress_bar() as report:
        result = replay.find(o.source, o.out, wishes, report)
    save_result(result, o.out, o.force)
    o.show(o.out)


@dataclass(kw_only=True)
class CheckOptions(options.SettingsOptions):
    """Options of `alight check`."""

    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A flight log (mav0/), a recording (.mcap), a ROS bag, or photos.")
    ]
    places: options.Places = None
    topic: options.Topic = None
    topics: options.TopicFile = None
    seconds: Annotated[float, typer.Option(min=1.0, help="How much of the recording is read.")] = 10.0
    start: Annotated[float, typer.Option(min=0.0, help="Seconds from the first exposure at which to begin.")] = 0.0
    as_json: Annotated[bool, typer.Option("--json", help="Print records instead of lines.")] = False


@app.command()
@options.command_of(CheckOptions)
def check(o: CheckOptions) -> None:
    """Find faults of a rig, or check whether photos can be used; the exit code is 3 if a check is bad.

    With --verbose, the facts in the tags of each photo are logged.
    """
    chosen = o.read_settings()
    from alight.checks.result import Judged
    from alight.records import PhotoRow
    from alight.runner.checking import check_opened
    from alight.runner.opening import open_source

    recording = open_source(o.source, chosen, places=o.places, topics=options.named_topics(o.topic, o.topics))
    for line in () if o.as_json else recording.notes.get("log", ()):
        print_line(f"LOG  {line}")
    with progress_bar() as report:
        found = check_opened(recording, chosen, o.seconds, o.start, lambda share: report("checking", share))
    records: list[dict[str, Any]] = [{k: v for k, v in asdict(r).items() if k != "lasts"} for r in found]
    if photos := [PhotoRow(p, None) for p in recording.photos]:
        records[-1]["photos"] = [row.as_json() for row in photos]
    for row in photos:
        log.info("%s", row.line)
    _print_rows([r.line for r in found], records, o.as_json)
    if any(r.verdict is Judged.BAD for r in found):
        raise typer.Exit(ExitCode.FAULT_FOUND)


def _print_rows(lines: list[str], records: list[dict[str, Any]], as_json: bool) -> None:
    for line in [json.dumps(records, indent=1)] if as_json else lines:
        print_line(line)


@app.command()
def evaluate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that a run left.")],
    truth: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER", help="A flight with truth/, or a folder with a structure-from-motion reference."
        ),
    ],
    verbose: options.Verbose = False,
) -> None:
    """Compare a run with the truth and print the errors."""
    from alight.evaluation import evaluate as compare

    for line in compare(out, truth).lines():
        print_line(line)


@dataclass(kw_only=True)
class JudgeOptions(options.SettingsOptions):
    """Options of `alight judge`."""

    run: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that a run left.")]
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help="Folder for the results; default: OUT-judged.")
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False


@app.command()
@options.command_of(JudgeOptions)
def judge(o: JudgeOptions) -> None:
    """Judge the ground of a run for another lander or other limits, without motion and mapping."""
    from alight.settings import Settings
    from alight.settings.units import with_degrees

    chosen = with_degrees(o.read_settings().model_dump(mode="json", exclude_unset=True), Settings)
    from alight.outputs.evidence import EVIDENCE
    from alight.outputs.folder import prepare_folder
    from alight.outputs.reading import read_evidence
    from alight.result import Result

    out = o.out or o.run.resolve().with_name(f"{o.run.resolve().name}-judged")
    kept = Result(read_evidence(o.run))
    prepare_folder(out, o.force, [o.run / EVIDENCE])
    with progress_bar() as report:
        report("judging", 0.0)
        judged = kept.judge(settings=chosen)
        report("judging", 1.0)
    save_result(judged.record, out, o.force, same_as=o.run)


@dataclass(kw_only=True)
class HazardsOptions(options.ResultOptions):
    """Options of `alight hazards`."""

    dem: Annotated[Path, typer.Argument(metavar="DEM.tif", help="Heights on square cells, in metres or feet.")]
    sigma: Annotated[
        str | None, typer.Option(metavar="S.tif|METRES", help="1-sigma of the heights; default: their second band.")
    ] = None
    image: Annotated[
        Path | None,
        typer.Option(
            metavar="I.tif", help="The same ground seen from above; two or more pixels a cell make the heights finer."
        ),
    ] = None
    zones: options.Zones = None
    lander: Annotated[
        Path | None, typer.Option(metavar="lander.yaml", help="Keys of the lander, as under 'lander' in the settings.")
    ] = None
    scheduler: options.Scheduler = None


class _JudgedRaster(NamedTuple):
    """A judgement, the plane of its raster, and counts of all cells."""

    result: Result
    plane: RasterPlane | None
    tally: Tally | None = None  # None: the result has all cells, and they are counted in it


@app.command("hazards")
@options.command_of(HazardsOptions)
def judge_raster(o: HazardsOptions) -> None:
    """Judge any height raster: P(safe) and reasons of each cell, and the landing sites for the lander."""
    from alight import records
    from alight.runner import judge, large

    chosen = judge.for_surveyed_heights(o.read_settings(before=_lander(o.lander) if o.lander else ()))
    judged, plane, tally = (_in_windows if o.image is None and large.is_large(o.dem) else _as_whole)(o, chosen)
    result = judged.record
    assert result.hazards is not None
    assert plane is not None

    def place(position: Sequence[float]) -> str:
        x, y = plane.in_crs(position[0], position[1])
        return f"east {x:.2f} north {y:.2f}"

    tally = tally or records.Tally.of(result.hazards)
    share = 100 * tally.safe / tally.cells
    for w in result.warnings:
        print_stderr(f"warning: {w}")
    print_answer(result.sites, place, f", {share:.1f} % is safe")
    for name in ("heights", "raster", "ground", "zones"):
        if name in result.notes:
            print_line(f"{name.upper()}  {result.notes[name]}")
    judged.save(o.out, o.force)
    print_line(f"report: {o.out / 'report.html'}")


def _as_whole(o: HazardsOptions, chosen: Settings) -> _JudgedRaster:
    """Judge a raster that is held in memory."""
    from alight.loop_forms import compile_loops
    from alight.outputs.folder import prepare_folder
    from alight.runner.judge import judge_ground
    from alight.sources.raster import read_ground

    ground = read_ground(o.dem, o.sigma, o.image, chosen.hazards.usual_sigma)
    prepare_folder(o.out, o.force, [*ground.files, *([o.zones] if o.zones else [])])
    with progress_bar() as report:
        compile_loops("hazards", progress=report)
        report("judging", 0.0)
        judged = judge_ground(ground, chosen, o.dem.name, o.zones)
        report("judging", 1.0)
    return _JudgedRaster(judged, ground.plane)


def _in_windows(o: HazardsOptions, chosen: Settings) -> _JudgedRaster:
    """Judge a large raster in windows."""
    from alight.cluster import open_jobs
    from alight.loop_forms import compile_loops
    from alight.outputs.folder import new_work, prepare_folder, remove_work
    from alight.runner.large import LargeJudgement, read_large

    ground = read_large(o.dem, o.sigma, chosen)
    prepare_folder(o.out, o.force, [*ground.files, *([o.zones] if o.zones else [])])
    judgement = LargeJudgement(ground, chosen, new_work(o.out), o.zones)
    try:
        with open_jobs(o.scheduler) as jobs, progress_bar() as report:
            compile_loops("hazards", progress=report)
            judged = judgement.judge(o.dem.name, jobs, report)
    except BaseException:
        remove_work(o.out)
        raise
    return _JudgedRaster(judged, ground.plane, judgement.tally)


def _lander(file: Path) -> list[str]:
    """Return the keys of a lander's file as assignments; the file may have them under `lander:` or without it.

    Raises:
        SettingsError: the file cannot be read or holds no keys.
    """
    from alight.documents import DocumentError, parse_yaml
    from alight.records import SettingsError

    try:
        tree: Any = parse_yaml(options.yaml_text(file))
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e
    tree = tree.get("lander", tree) if isinstance(tree, dict) else tree
    if not isinstance(tree, dict) or not tree:
        raise SettingsError(f"{file}: needs keys of the lander such as 'radius: 1.5'; 'alight settings' lists them")
    return [f"lander.{key}={json.dumps(value, default=str)}" for key, value in tree.items()]


@terrain.command("train")
def train_model(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder with a folder of pictures for each class: bare, water, ...")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="MODEL", help="File for the model (.npz).")],
    sampling: SamplingOption = 0.05,
    verbose: options.Verbose = False,
) -> None:
    """Train a model on your own pictures, and test the method by leaving out one site after another.

    Each site is judged by a model trained on the other sites. The site of a picture is given by index.csv, else by a
    folder within the folder of the class.
    """
    from alight.runner.appearance import train_to_file

    with progress_bar() as report:
        found = train_to_file(folder, out, sampling, report)
    print_line(found.model.provenance)
    if found.left_out is None:
        print_line(
            "tested on nothing: all pictures are of one site; put those of another place into a folder of their own"
        )
    print_line(f"model: {out}")


@terrain.command("test")
def evaluate_model(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="One folder a class, or images/ with labels/.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL", help="A trained model; default: the package's own.")
    ] = None,
    leave_out: Annotated[
        bool, typer.Option("--leave-out", help="Test each site with a model trained on the others.")
    ] = False,
    sampling: SamplingOption = 0.05,
    verbose: options.Verbose = False,
) -> None:
    """Test a model on pictures, and print its confusion of classes by site. Without FOLDER: print its provenance."""
    from alight.runner.appearance import judge_appearance
    from alight.sources.appearance import read_model
    from alight.training.confusion import lines_of

    if leave_out and (folder is None or model is not None):
        wrong = "needs FOLDER" if folder is None else "trains models of its own: leave out --model"
        raise typer.BadParameter(f"--leave-out {wrong}")
    if folder is None:
        print_line(read_model(model).provenance)
        return
    with progress_bar() as report:
        found = _left_out(folder, sampling, report) if leave_out else judge_appearance(folder, model, sampling, report)
    for line in lines_of(found):
        print_line(line)


def _left_out(folder: Path, sampling: float, report: Callable[[str, float], None]) -> Confusion:
    from alight.records import InputError
    from alight.sources.library import read_library
    from alight.training.train import elsewhere

    patches = read_library(folder, sampling)
    try:
        return elsewhere(patches, lambda share: report("testing", share))
    except ValueError as e:
        raise InputError(f"{folder}: {e}; put the pictures of each site into a folder of its own") from e


@dataclass(kw_only=True)
class ShowOptions(options.SettingsOptions):
    """Options of `alight settings`."""

    everything: Annotated[bool, typer.Option("--all", help="Print the tuned constants of every stage as well.")] = False
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a page of all keys with their descriptions.")] = (
        False
    )


@app.command("settings")
@options.command_of(ShowOptions)
def show_settings(o: ShowOptions) -> None:
    """Print all settings with their values, as YAML for --settings."""
    chosen = o.read_settings()
    if o.markdown:
        from alight.settings.page import settings_page

        print_line(settings_page().rstrip("\n"))
    else:
        print_line(chosen.to_yaml(tuning=o.everything).rstrip("\n"))


@app.command()
def warmup(verbose: options.Verbose = False) -> None:
    """Compile all loops on all cores, so that the first run does not wait for the compiler."""
    from alight.loop_forms import USES, compile_loops

    with progress_bar() as report:
        compile_loops(*USES, progress=report)
    print_line("ready")


@app.command()
def doctor(verbose: options.Verbose = False) -> None:
    """Print versions, processors, memory, caches, cameras, serial links and missing extras, for a bug report."""
    from alight.runner.doctor import facts

    found = list(facts())
    width = max(len(name) for name, _ in found)
    for name, value in found:
        print_line(f"{name:<{width}}  {value}")
