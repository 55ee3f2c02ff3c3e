"""The application, and the conversion of an error into one line and an exit code."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Sequence
from enum import IntEnum
from itertools import pairwise
from typing import Annotated

import typer

from alight import __version__, memory
from alight.cli import options
from alight.cli.terminal import discard, log_to_stderr, print_line, print_stderr, stdout_errors


class ExitCode(IntEnum):
    """Exit codes besides 0."""

    USER_ERROR = 2  # the line on stderr names the remedy
    FAULT_FOUND = 3  # a check is bad, or landings failed
    NOT_LANDED = 4  # a landing was begun, but did not end with a touchdown
    INTERRUPTED = 128 + signal.SIGINT
    TERMINATED = 128 + signal.SIGTERM


# typer's errors inherit from its own copy of click or, in older versions, from click; this class exists in both
UsageError: type[Exception] = typer.BadParameter.__mro__[1]

app = typer.Typer(pretty_exceptions_enable=False, help="Find a safe place to land.")
SMALLER = {  # advice when memory is exhausted, by command
    "hazards": "give a part of the raster (gdal_translate -srcwin) or coarser cells (gdalwarp -tr)",
    "simulate": "choose smaller images, a lower rate or a smaller ground in the scene",
    "rehearse": "choose smaller images with --width",
    "terrain": "give fewer or smaller pictures",
    "evaluate": "give a smaller run",
    "check": "read less with --seconds",
}
_ENDINGS = (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))  # requests to end; Windows has no SIGHUP
_signals: list[int] = []  # received signals


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: options.Verbose = False,
) -> None:
    if version:
        print_line(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        print_line(context.get_help())


def _smaller(words: Sequence[str]) -> str:
    """Return advice on how to use less memory; settings assigned in `words`, the command line, are named first."""
    command = next((w for w in words if not w.startswith("-")), "")
    usual = SMALLER.get(command, "choose a larger parallax.cell or a smaller parallax.store_mb")
    given = [w for option, w in pairwise(words) if option == "--set"]
    given += [w.removeprefix("--set=") for w in words if w.startswith("--set=")]
    if not given:
        return usual
    return f"take back what makes it large among {', '.join(g[:60] for g in given)}, or {usual}"


def _mistake(error: Exception, words: Sequence[str]) -> str:
    """Return one line about an error that a user can mend; empty: a defect of Alight. `words`: command line."""
    if isinstance(error, MemoryError):
        return f"not enough memory; {_smaller(words)}"
    if isinstance(error, UsageError):
        from alight.documents import plain_words

        where = getattr(getattr(error, "ctx", None), "command_path", "alight")
        line = plain_words(error.format_message().rstrip(".").removeprefix("Invalid value: "))  # type: ignore[attr-defined]
        return f"{line}; see '{where} --help'"
    from alight.records import AlightError

    return str(error) if isinstance(error, AlightError) else ""


def call(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 2 and a line on stderr for a user's mistake, 130 for Ctrl-C."""
    log_to_stderr()
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = int(app(words, prog_name="alight", standalone_mode=False) or 0)
    except (KeyboardInterrupt, typer.Abort):
        code = ExitCode.INTERRUPTED
    except Exception as e:
        if not (line := _mistake(e, words)):
            raise
        print_stderr(f"error: {line}", "bold red")
        return ExitCode.USER_ERROR
    finally:
        errors = [*stdout_errors]
        stdout_errors.clear()
        if "alight.outputs.folder_lock" in sys.modules:
            sys.modules["alight.outputs.folder_lock"].release_all()
    if code == ExitCode.INTERRUPTED:  # typer too raises this code for Ctrl-C
        print_stderr("interrupted: files that were finished are whole, the rest was not written")
        return ExitCode.TERMINATED if _signals else code
    if errors:
        print_stderr(f"error: {errors[0]}", "bold red")
        return ExitCode.USER_ERROR
    return code


def _end(number: int, frame: object) -> None:
    """Handle a terminating signal like Ctrl-C; errors of objects left incomplete are not printed."""
    if number != signal.SIGINT:
        _signals.append(number)
    sys.unraisablehook = lambda _: None
    raise KeyboardInterrupt


def _mend_streams() -> None:
    """Open closed standard streams on the null device and let them print any character.

    Otherwise the next opened file would take the number of a closed stream. A terminal width of 0 columns is ignored.
    """
    if not os.environ.get("COLUMNS", "80").strip("0"):
        del os.environ["COLUMNS"]
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # uses the lowest free number: this one
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def main() -> None:
    """Run the command line of this process and exit."""
    memory.keep_little()
    _mend_streams()
    for number in (signal.SIGINT, *_ENDINGS):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # a background job ignores some
            signal.signal(number, _end)
    code = call()
    try:
        if sys.stderr is not None:  # it was closed at the start
            sys.stderr.flush()
    except OSError:  # a line of the log is not written
        discard(sys.stderr)
    for number in (signal.SIGINT, *_ENDINGS):
        signal.signal(number, signal.SIG_IGN)  # all is written: from here no signal may change the exit code
    sys.exit(int(code))
