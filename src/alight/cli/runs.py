"""Commands of a recorded flight and of the program: run, evaluate, demo, settings, warmup."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line, print_result, progress_bar, save_result


@app.command()
def run(
    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A flight log (mav0/), photos, or a video with .srt.")
    ],
    out: options.Out,
    poses: Annotated[
        str | None, typer.Option(metavar="FILE|truth", help="Body poses (TUM, ENU) instead of the estimate.")
    ] = None,
    quality: Annotated[
        Literal["fast", "normal", "fine"] | None,
        typer.Option(help="Size of the cells: the same as --set parallax.quality=..."),
    ] = None,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    prior_dem: Annotated[
        Path | None, typer.Option(metavar="DEM", help="Heights from elsewhere: to begin with and to compare with.")
    ] = None,
    home: options.ArmedAt = None,
    geoid: options.Geoid = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted run of the same photos and settings in OUT.")
    ] = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask cluster for photos: tcp://host:8786.")
    ] = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Find a landing site in a recorded flight or a folder of photos."""
    wanted = [f"parallax.quality={quality}"] if quality else []
    chosen = options.read_settings(settings, [*(assign or ()), *wanted])
    from alight.runner import replay
    from alight.runs import known_home

    wishes = replay.Find(chosen, poses, force, resume, prior_dem, scheduler, known_home(home, geoid))
    with progress_bar() as report:
        result = replay.find(source, out, wishes, report)
    save_result(result, out, force)


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
    """Compare a run with the truth and print the numbers."""
    from alight.evaluation import evaluate as compare

    for line in compare(out, truth).lines():
        print_line(line)


@app.command()
def demo(
    out: options.Out = Path("out/demo"),
    seed: options.Seed = 1,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Land a simulated vehicle: search, look, look again from lower down, touch down."""
    chosen = options.read_settings(settings, assign)
    from alight.outputs import write_run
    from alight.trials import demo as show

    with progress_bar() as report:
        landing = show.fly_demo(out, seed, chosen, force, report)
    print_result(landing.result)
    write_run(landing.result, out, force)
    for line in landing.lines:
        print_line(line)
    print_line(f"report: {out / 'report.html'}")


@app.command("settings")
def show_settings(
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    everything: Annotated[bool, typer.Option("--all", help="With the tuned constants of every stage.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="The keys with their descriptions, as a page.")] = False,
) -> None:
    """Print every setting with its value, as YAML that --settings takes back."""
    chosen = options.read_settings(settings, assign)
    if markdown:
        from alight.settings.page import settings_page

        print_line(settings_page().rstrip("\n"))
    else:
        print_line(chosen.to_yaml(tuning=everything).rstrip("\n"))


@app.command()
def warmup(verbose: options.Verbose = False) -> None:
    """Compile all loops, so that the first run does not wait for it."""
    from alight.trials.warmup import compile_kernels

    with progress_bar() as report:
        compile_kernels(report)
    print_line("ready")
