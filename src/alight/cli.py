"""The command line: the one place that catches, prints and exits."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from alight import __version__
from alight.records import AlightError, RunResult, SettingsError
from alight.settings import Settings, load

app = typer.Typer(
    no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help="Find a safe place to land."
)
_stderr = Console(stderr=True)

SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as lander.radius=2.")
]
SettingsOption = Annotated[Path | None, typer.Option("--settings", metavar="FILE", help="Settings as YAML.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")]
OutOption = Annotated[Path, typer.Option("--out", help="Folder for the results.")]


def read_settings(file: Path | None, assignments: list[str] | None) -> Settings:
    """Settings of a file and `--set` options.

    Raises:
        SettingsError: the file cannot be read, a key is unknown, a value is out of range.
    """
    try:
        text = file.read_text(encoding="utf-8") if file else ""
    except (OSError, UnicodeDecodeError) as e:
        raise SettingsError(
            f"{file}: cannot be read ({getattr(e, 'strerror', None) or 'not text'}); name a YAML file"
        ) from e
    try:
        return load(text, assignments or ())
    except ValueError as e:
        raise SettingsError(str(e)) from e


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar a stage on stderr; gone when done."""
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=_stderr, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0)
            bar.update(tasks[stage], completed=share)

        yield tell


def _say(result: RunResult, out: Path) -> None:
    """The answer in a few lines on stdout."""
    for w in result.warnings:
        _stderr.print(f"warning: {w}", style="yellow", markup=False, highlight=False)
    if not result.sites.sites:
        typer.echo(f"NO SITE  {result.sites.reason}")
    for s in result.sites.sites[:1]:
        lat, lon, _ = result.local.to_geodetic([s.east, s.north, s.up])
        place = (
            f"{float(lat):.7f} {float(lon):.7f}"
            if result.georeferenced
            else f"east {s.east:.2f} m north {s.north:.2f} m"
        )
        typer.echo(
            f"SITE  {place}  slope {s.slope * 57.29578:.1f} deg  rough {s.roughness:.2f} m  "
            f"clear {s.clearance:.1f} m  P(safe) {s.p_safe:.3f}  ({len(result.sites.sites)} found)"
        )
    typer.echo(f"report: {out / 'report.html'}")


@app.command()
def run(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="A flight log (mav0/) or a folder of photos.")],
    out: OutOption,
    poses: Annotated[
        str | None, typer.Option(metavar="FILE|truth", help="Body poses (TUM, ENU) instead of the estimate.")
    ] = None,
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Find a landing site in a recorded flight or a folder of photos."""
    from alight import replay

    chosen = read_settings(settings, assign)
    with progress_bar() as tell:
        result = replay.run(source, out, chosen, poses, force, tell)
    _say(result, out)


@app.command()
def evaluate(
    out: Annotated[Path, typer.Argument(help="Folder that a run left.")],
    truth: Annotated[
        Path, typer.Option(help="A flight with truth/, or a folder with a structure-from-motion reference.")
    ],
) -> None:
    """Compare a run with the truth and print the numbers."""
    from alight.evaluate import evaluate as compare

    for line in compare(out, truth).lines():
        typer.echo(line)


@app.command()
def demo(
    out: OutOption = Path("out/demo"),
    seed: Annotated[int, typer.Option(help="Another seed, another place.")] = 1,
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Simulate a small flight, find a landing site in it and compare with the truth."""
    from alight import demo as show

    chosen = read_settings(settings, assign)
    with progress_bar() as tell:
        result, report = show.run(out, seed, chosen, force, tell)
    _say(result, out)
    for line in report.lines():
        typer.echo(line)


@app.command("settings")
def show_settings(settings: SettingsOption = None, assign: SetOption = None) -> None:
    """Print every setting with its value, as YAML that --settings takes back."""
    typer.echo(read_settings(settings, assign).to_yaml(), nl=False)


@app.command()
def warmup() -> None:
    """Compile every kernel, so that the first run does not wait for it."""
    from alight import demo as show

    with progress_bar() as tell:
        show.warmup(tell)
    typer.echo("ready")


@app.callback(invoke_without_command=True)
def _top(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say more on stderr.")] = False,
) -> None:
    level = logging.INFO if verbose else logging.WARNING
    handler = RichHandler(console=_stderr, show_path=False, show_time=False)
    logging.basicConfig(level=level, format="%(message)s", handlers=[handler], force=True)
    if version:
        typer.echo(__version__)
        raise typer.Exit


def main() -> Any:
    """Run the command line: exit code 2 and one line on stderr for whatever a user can mend, 130 for Ctrl-C."""
    try:
        return app(standalone_mode=True)
    except AlightError as e:
        _stderr.print(f"error: {e}", style="bold red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        _stderr.print("interrupted: files that were finished are whole, the rest was not written")
        sys.exit(130)
