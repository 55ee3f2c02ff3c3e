"""The application, the options that commands share, and the conversion of an error into one line and an exit code."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from alight import __version__, memory
from alight.documents import DocumentError, read_text
from alight.records import AlightError, InputError, OutputError, SettingsError, Site, Sites, p_safe_text
from alight.settings import Settings, load_settings

SPEED_OVER = 300.0  # s of progress from which the time left is estimated: a tile may take a minute
MENDABLE, WRONG, INTERRUPTED, TERMINATED = 2, 3, 130, 143  # exit codes; 3: a check is bad, or landings failed
# typer's errors descend from its own copy of click or, in older versions, from click; this leaf class exists in both
UsageError: type[Exception] = typer.BadParameter.__mro__[1]

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, help="Find a safe place to land.")
FILES = {  # of each command, in the order of --help
    "campaign": "campaign", "check": "check", "run": "runs", "evaluate": "runs", "demo": "runs", "settings": "runs",
    "warmup": "runs", "live": "live", "fly": "fly", "rehearse": "rehearse", "hazards": "hazards",
    "simulate": "simulate", "terrain": "terrain",
}  # fmt: skip
_ENDINGS = (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))  # requests to end; Windows has no SIGHUP
_unsaid: list[str] = []  # reasons why stdout did not take the answer: reported when the work is done
_signals: list[int] = []  # received requests to end


def _discard(stream: TextIO) -> None:
    """Send to the null device what a stream cannot write, or the interpreter fails on it at its end."""
    with suppress(OSError):  # it has no number
        number = stream.fileno()
        os.dup2(os.open(os.devnull, os.O_WRONLY), number)


class _Stderr(Console):
    """Console on stderr. A closed pipe or a full disk ends no work: the lines are lost, the results are not."""

    def on_broken_pipe(self) -> None:
        """Go on without stderr: rich would end the program."""
        _discard(sys.stderr)

    def __exit__(self, exc_type: Any, exc_value: Any, traceback: Any) -> None:
        """Write the lines; each output of rich ends here."""
        try:
            super().__exit__(exc_type, exc_value, traceback)
        except OSError:
            _discard(sys.stderr)


stderr = _Stderr(stderr=True)


def _speak_up(verbose: bool) -> None:
    if verbose:
        logging.getLogger("alight").setLevel(logging.INFO)


SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as lander.radius=2.")
]
SettingsOption = Annotated[Path | None, typer.Option("--settings", metavar="FILE", help="Settings as YAML.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")]
OutOption = Annotated[Path, typer.Option("--out", metavar="OUT", help="Folder for the results.")]
RigOption = Annotated[
    Path | None, typer.Option("--rig", metavar="FOLDER", help="Calibration of cameras: cam0/sensor.yaml and so on.")
]
SeparationOption = Annotated[
    float | None,
    typer.Option(
        "--separation",
        min=-200.0,
        max=200.0,
        help="Ellipsoid minus sea level, m, where the receiver does not report it.",
    ),
]
HomeOption = Annotated[
    str | None,
    typer.Option(
        "--home", metavar="LAT,LON,ALT_MSL", help="Where the vehicle is armed: route.plan counts its heights from it."
    ),
]
GeoidOption = Annotated[
    Path | None, typer.Option("--geoid", metavar="GRID", help="Geoid heights (EGM2008, GeoTIFF) for --home.")
]
RecordOption = Annotated[
    bool, typer.Option("--record/--no-record", help="Record everything that comes in, and what is done, as MCAP.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Another seed, another place.")]
VerboseOption = Annotated[bool, typer.Option("--verbose", "-v", callback=_speak_up, help="Say more on stderr.")]


def read_settings(file: Path | None, assignments: list[str] | None) -> Settings:
    """Read settings from a file and `--set` options.

    Raises:
        SettingsError: the file cannot be read, a key is unknown, a value is out of range.
    """
    try:
        text = read_text(file) if file else ""
    except OSError as e:
        raise SettingsError(f"{file}: cannot be read ({e.strerror}); name a YAML file") from e
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e
    try:
        return load_settings(text, assignments or ())
    except ValueError as e:
        raise SettingsError(f"{file}: {e}" if _fails(text) else str(e)) from e


def _fails(text: str) -> bool:
    """True if the text of a file alone is invalid."""
    try:
        load_settings(text)
    except ValueError:
        return True
    return False


def refuse_unused(source: str, follow: bool, rig: Path | None, speed: float = 1.0) -> None:
    """Refuse options that have no effect on this source.

    Args:
        source: a recording, a folder, or cameras.
        follow: the folder is being filled.
        rig: folder with the calibration of cameras.
        speed: of a recording.

    Raises:
        InputError: the message names the option.
    """
    from alight.sources.live import is_cameras

    cameras = is_cameras(source)
    if cameras and follow:
        raise InputError("--follow: is for a folder that is being filled, and cameras are none; leave it out")
    if speed != 1.0 and (cameras or follow):
        raise InputError("--speed: is of a flight log or a recording; cameras and folders that fill have their own")
    if rig is not None and not cameras:
        raise InputError(f"--rig: is for cameras; {source} brings its own calibration; leave it out")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Show a bar a stage on stderr, removed at the end; none where stderr is no terminal."""
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=stderr, transient=True, disable=not stderr.is_terminal, speed_estimate_period=SPEED_OVER
    ) as bar:
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0)
            bar.update(tasks[stage], completed=share)

        yield tell


def complain(line: str, style: str) -> None:
    """Print one line on stderr, however long: a terminal wraps it by itself, and a log needs it whole.

    Nothing is raised where it cannot be written.
    """
    from alight.report.words import printable

    stderr.print(printable(" ".join(line.split())), style=style, markup=False, highlight=False, soft_wrap=True)


def say(line: str) -> None:
    """Print one line on stdout. A closed pipe (`| head`) is no error; another failure to write ends no work."""
    from alight.report.words import printable

    try:
        typer.echo(printable(line))
    except OSError as e:
        _discard(sys.stdout)
        if not isinstance(e, BrokenPipeError):
            _unsaid.append(f"standard output: cannot be written ({e.strerror}); mend that or leave it open")


def tell_answer(sites: Sites, place: Callable[[Sequence[float]], str], more: str = "") -> None:
    """Print the answer on stdout: the best site, or the reason for none and the first candidate; one line each.

    Args:
        place: returns words for a position, (3,) metres.
        more: text after the numbers of sites and candidates.
    """
    from alight.report import words

    if sites.sites:
        s = sites.sites[0]
        kinds = {"site": sites.sites, "candidate": sites.candidates}
        found = ", ".join(f"{len(part)} {name}{'s' * (len(part) != 1)}" for name, part in kinds.items() if part)
        say(f"SITE  {_numbers(s, place)}  ({found}{more})")
        return
    say(f"NO SITE  {sites.reason}")
    if sites.candidates:
        s, count = sites.candidates[0], len(sites.candidates)
        look = words.look_from(s) + ("" if s.look is None else f", at {place([s.look.east, s.look.north, s.look.up])}")
        say(
            f"LOOK CLOSER  {_numbers(s, place)}  doubt: {words.doubt(s)}  look from: {look}  "
            f"({count} candidate{'s' * (count != 1)}{more})"
        )


def _numbers(site: Site, place: Callable[[Sequence[float]], str]) -> str:
    return (
        f"{place([site.east, site.north, site.up])}  slope {site.slope * 57.29578:.1f} deg  "
        f"rough {site.roughness:.2f} m  clear {site.clearance:.1f} m  P(safe) {p_safe_text(site.p_safe)}"
    )


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: VerboseOption = False,
) -> None:
    if version:
        say(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        say(context.get_help())


def _log_to_stderr() -> None:
    """Log warnings and errors above the bar on a terminal, else as one plain line each."""
    plain = logging.StreamHandler()
    plain.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    rich = RichHandler(console=stderr, show_path=False, show_time=False)
    handler = rich if stderr.is_terminal else plain
    logging.getLogger("alight").setLevel(logging.NOTSET)  # until --verbose
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[handler], force=True)


def _usage(error: Any) -> str:
    """A mistake on the command line as one line."""
    where = getattr(getattr(error, "ctx", None), "command_path", "alight")
    return f"{error.format_message().rstrip('.')}; see '{where} --help'"


def load_commands(words: Sequence[str] = ()) -> None:
    """Import the file of the command that is named first; the files of all commands where none is."""
    named = next((w for w in words if not w.startswith("-")), "")
    for file in dict.fromkeys([FILES[named]] if named in FILES else FILES.values()):
        import_module(f"alight.cli.{file}")


def _exit_code(arguments: Sequence[str] | None) -> int:
    """Exit code of a command that ended without an error; typer turns Ctrl-C into a code of its own or into Abort."""
    try:
        load_commands(sys.argv[1:] if arguments is None else arguments)
        return int(app(arguments, prog_name="alight", standalone_mode=False) or 0)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED


def _smaller(arguments: Sequence[str] | None) -> str:
    """Advice for less memory: first about the user's own settings."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    given = [w for option, w in pairwise(words) if option == "--set"]
    given += [w.removeprefix("--set=") for w in words if w.startswith("--set=")]
    if given:
        return f"take back what makes it large among {', '.join(g[:60] for g in given)}, or {_usual(words)}"
    return _usual(words)


def _usual(words: Sequence[str]) -> str:
    """Advice for less memory, for a command without settings."""
    command = next((w for w in words if not w.startswith("-")), "")
    advice = {
        "hazards": "give a part of the raster (gdal_translate -srcwin) or coarser cells (gdalwarp -tr)",
        "simulate": "choose smaller images, a lower rate or a smaller ground in the scene",
        "rehearse": "choose smaller images with --width",
        "terrain": "give fewer or smaller pictures",
        "evaluate": "give a smaller run",
        "check": "read less with --seconds",
    }
    return advice.get(command, "choose a larger parallax.cell or a smaller parallax.store_mb")


def call(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 2 and a line on stderr for a user's mistake, 130 for Ctrl-C."""
    _log_to_stderr()
    try:
        code = _exit_code(arguments)
        if code == INTERRUPTED:
            complain("interrupted: files that were finished are whole, the rest was not written", "yellow")
            return TERMINATED if _signals else code
        if _unsaid:
            raise OutputError(_unsaid[0])
        return code
    except AlightError as e:
        complain(f"error: {e}", "bold red")
    except UsageError as e:
        complain(f"error: {_usage(e)}", "bold red")
    except MemoryError:
        complain(f"error: not enough memory; {_smaller(arguments)}", "bold red")
    finally:
        _unsaid.clear()
        if "alight.outputs.folder_lock" in sys.modules:
            sys.modules["alight.outputs.folder_lock"].release_all()
    return MENDABLE


def _end(number: int, frame: object) -> None:
    """Treat a signal to end like Ctrl-C; errors of objects that it leaves incomplete are silenced."""
    if number != signal.SIGINT:
        _signals.append(number)
    sys.unraisablehook = lambda _: None
    raise KeyboardInterrupt


def _mend_streams() -> None:
    """Open closed standard streams on the null device, or the next file would take their number; print any name.

    A terminal width of 0 columns is ignored.
    """
    if not os.environ.get("COLUMNS", "80").strip("0"):
        del os.environ["COLUMNS"]
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def main() -> None:
    """Run the command line of this process."""
    memory.keep_little()
    _mend_streams()
    for number in (signal.SIGINT, *_ENDINGS):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # a background job ignores some
            signal.signal(number, _end)
    code = call()
    try:
        if sys.stderr is not None:  # it was closed at the start
            sys.stderr.flush()
    except OSError:  # a line of the log is left
        _discard(sys.stderr)
    for number in (signal.SIGINT, *_ENDINGS):
        signal.signal(number, signal.SIG_IGN)  # all is written: no signal can spoil the exit code any more
    sys.exit(code)
