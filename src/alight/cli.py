"""The command line: the one place that catches, prints and exits."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from alight import __version__
from alight.records import AlightError, OutputError, RunResult, SettingsError
from alight.settings import Settings, load

MENDABLE, INTERRUPTED = 2, 130  # exit codes
# typer's errors descend from the click it brings along or, older, from click itself; it shows this one leaf of both
UsageError: type[Exception] = typer.BadParameter.__mro__[1]

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help="Find a safe place to land.")
_stderr = Console(stderr=True)


def _speak_up(verbose: bool) -> None:
    if verbose:
        logging.getLogger("alight").setLevel(logging.INFO)


SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as lander.radius=2.")
]
SettingsOption = Annotated[Path | None, typer.Option("--settings", metavar="FILE", help="Settings as YAML.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")]
OutOption = Annotated[Path, typer.Option("--out", metavar="OUT", help="Folder for the results.")]
VerboseOption = Annotated[bool, typer.Option("--verbose", "-v", callback=_speak_up, help="Say more on stderr.")]


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
        raise SettingsError(f"{file}: {e}" if file and not assignments else str(e)) from e


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar a stage on stderr, gone when done; nothing where stderr is no terminal."""
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=_stderr, transient=True, disable=not _stderr.is_terminal) as bar:
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0)
            bar.update(tasks[stage], completed=share)

        yield tell


def _complain(line: str, style: str) -> None:
    """One line on stderr, however long: a terminal wraps it by itself, and a log wants it whole."""
    _stderr.print(" ".join(line.split()), style=style, markup=False, highlight=False, soft_wrap=True)


def _say(line: str) -> None:
    """One line on stdout. That nobody reads it (`| head`) is no error.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        typer.echo(line)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter trips over it at its end
    except OSError as e:
        raise OutputError(f"standard output: cannot be written ({e.strerror}); mend that or leave it open") from e


def _place(result: RunResult) -> str:
    """Where the best site is: degrees, or metres from the origin where the place on Earth is unknown."""
    s = result.sites.sites[0]
    if not result.georeferenced:
        return f"east {s.east:.2f} m north {s.north:.2f} m"
    latitude, longitude, _ = result.local.to_geodetic([s.east, s.north, s.up])
    return f"{float(latitude):.7f} {float(longitude):.7f}"


def _answer(result: RunResult) -> None:
    """The answer in one line on stdout, the warnings on stderr."""
    from alight.report import warnings

    for w in warnings(result):
        _complain(f"warning: {w}", "yellow")
    if not result.sites.sites:
        _say(f"NO SITE  {result.sites.reason}")
        return
    s = result.sites.sites[0]
    _say(
        f"SITE  {_place(result)}  slope {s.slope * 57.29578:.1f} deg  rough {s.roughness:.2f} m  "
        f"clear {s.clearance:.1f} m  P(safe) {s.p_safe:.3f}  ({len(result.sites.sites)} found)"
    )


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
    verbose: VerboseOption = False,
) -> None:
    """Find a landing site in a recorded flight or a folder of photos."""
    chosen = read_settings(settings, assign)
    from alight import replay

    with progress_bar() as tell:
        result = replay.find(source, out, chosen, poses, force, tell)
    _answer(result)  # first: it is not lost when it cannot be written
    replay.write_run(result, out, force)
    _say(f"report: {out / 'report.html'}")


@app.command()
def evaluate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that a run left.")],
    truth: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER", help="A flight with truth/, or a folder with a structure-from-motion reference."
        ),
    ],
    verbose: VerboseOption = False,
) -> None:
    """Compare a run with the truth and print the numbers."""
    from alight.evaluate import evaluate as compare

    for line in compare(out, truth).lines():
        _say(line)


@app.command()
def demo(
    out: OutOption = Path("out/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another place.")] = 1,
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Simulate a small flight, find a landing site in it and compare with the truth."""
    chosen = read_settings(settings, assign)
    from alight import demo as show
    from alight import replay
    from alight.evaluate import evaluate as compare

    with progress_bar() as tell:
        flight, result = show.fly(out, seed, chosen, force, tell)
    _answer(result)
    replay.write_run(result, out, force)
    for line in compare(out, flight).lines():
        _say(line)
    _say(f"report: {out / 'report.html'}")
    _say(f"flight: {flight}  (alight run takes it, alight evaluate compares with it)")


@app.command("settings")
def show_settings(settings: SettingsOption = None, assign: SetOption = None) -> None:
    """Print every setting with its value, as YAML that --settings takes back."""
    _say(read_settings(settings, assign).to_yaml().rstrip("\n"))


@app.command()
def warmup(verbose: VerboseOption = False) -> None:
    """Compile every kernel, so that the first run does not wait for it."""
    from alight import demo as show

    with progress_bar() as tell:
        show.warmup(tell)
    _say("ready")


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: VerboseOption = False,
) -> None:
    if version:
        _say(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        _say(context.get_help())


def _log_to_stderr() -> None:
    """Warnings and worse, above the bar on a terminal, else one plain line each."""
    plain = logging.StreamHandler()
    plain.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    rich = RichHandler(console=_stderr, show_path=False, show_time=False)
    handler = rich if _stderr.is_terminal else plain
    logging.getLogger("alight").setLevel(logging.NOTSET)  # until --verbose
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[handler], force=True)


def _usage(error: Any) -> str:
    """A mistake on the command line as one line."""
    where = getattr(getattr(error, "ctx", None), "command_path", "alight")
    return f"{error.format_message().rstrip('.')}; see '{where} --help'"


def _exit_code(arguments: Sequence[str] | None) -> int:
    """Of a command that ended without an error; typer turns Ctrl-C into a code of its own or into Abort."""
    try:
        return int(app(arguments, prog_name="alight", standalone_mode=False) or 0)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED


def call(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 2 and one line on stderr for what a user can mend, 130 for Ctrl-C."""
    _log_to_stderr()
    try:
        code = _exit_code(arguments)
        if code == INTERRUPTED:
            _complain("interrupted: files that were finished are whole, the rest was not written", "yellow")
        return code
    except AlightError as e:
        _complain(f"error: {e}", "bold red")
    except UsageError as e:
        _complain(f"error: {_usage(e)}", "bold red")
    except MemoryError:
        _complain("error: not enough memory; choose a larger parallax.cell or a smaller parallax.store_mb", "bold red")
    return MENDABLE


def main() -> None:
    """Run the command line of this process."""
    sys.exit(call())
