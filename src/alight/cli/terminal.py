"""Lines on stdout and stderr, progress, and the answer of a run. Rich is imported only for a terminal."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import typer

if TYPE_CHECKING:
    from alight.records import RunResult, Site, Sites

stdout_errors: list[str] = []  # errors of writing to stdout, reported when the work is done


def discard(stream: TextIO) -> None:
    """Redirect an unwritable stream to the null device; otherwise the interpreter fails on it at exit."""
    with suppress(OSError):  # the stream has no file descriptor
        number = stream.fileno()
        os.dup2(os.open(os.devnull, os.O_WRONLY), number)


def is_terminal() -> bool:
    """Whether stderr is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


def print_stderr(line: str, style: str = "yellow") -> None:
    """Print one line on stderr, however long: a terminal wraps it by itself, and a log needs it whole.

    An error of writing is ignored.
    """
    from alight.documents import printable

    text = printable(" ".join(line.split()))
    if is_terminal():
        from alight.cli.display import stderr

        stderr.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
        return
    try:
        typer.echo(text, err=True)
    except OSError:
        discard(sys.stderr)


def print_line(line: str) -> None:
    """Print one line on stdout. A closed pipe (`| head`) is no error; other write errors are reported at the end."""
    from alight.documents import printable

    try:
        typer.echo(printable(line))
    except OSError as e:
        discard(sys.stdout)
        if not isinstance(e, BrokenPipeError):
            stdout_errors.append(f"standard output: cannot be written ({e.strerror}); mend that or leave it open")


def progress_bar() -> AbstractContextManager[Callable[[str, float], None]]:
    """Return a context manager for progress bars on stderr, one per stage; without a terminal, see `ProgressLines`."""
    if not is_terminal():
        return nullcontext(ProgressLines())
    from alight.cli.display import bars

    return bars()


class ProgressLines:
    """Progress as lines on stderr, for output that is redirected: work of less than `every` seconds prints nothing.

    After that a line is printed when a stage begins, and at least every so many seconds if progress is reported.
    """

    def __init__(self, every: float = 15.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._every, self._clock = every, clock
        self._began = self._printed = self._whole_began = clock()
        self._stage = ""
        self._whole: float | None = None

    def __call__(self, stage: str, share: float) -> None:
        """Print a line if it is due."""
        from alight.pipeline.timing import WHOLE

        now = self._clock()
        if stage == WHOLE:
            self._whole = share
            return
        if self._whole is None:  # loops are compiled first, which is no part of the whole
            self._whole_began = now
        begins, self._stage = stage != self._stage, stage
        if now - self._began < self._every or not (begins or now - self._printed >= self._every):
            return
        self._printed, elapsed = now, now - self._began
        left = ""
        if self._whole and self._whole > 0.05:  # before, the estimate is wild
            left = f"; about {(now - self._whole_began) * (1 - self._whole) / self._whole:.0f} s left"
        print_stderr(f"{stage}: {share:.0%} after {elapsed:.0f} s{left}")


def live_table() -> AbstractContextManager[Callable[[Iterable[tuple[str, str]], Iterable[str]], None]]:
    """Return a context manager for a table of (name, value) rows with lines below it; idle without a terminal."""
    if not is_terminal():
        return nullcontext(lambda rows, lines: None)
    from alight.cli import display

    return display.live_table()


def log_to_stderr() -> None:
    """Log warnings and errors above the progress bar on a terminal, otherwise as one plain line each."""
    handler: logging.Handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    if is_terminal():
        from alight.cli.display import log_handler as handler
    logging.getLogger("alight").setLevel(logging.NOTSET)  # until --verbose
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[handler], force=True)


def print_answer(sites: Sites, place: Callable[[Sequence[float]], str], more: str = "") -> None:
    """Print the answer on stdout: the best site, or the reason for its absence and the first candidate.

    Args:
        place: returns the text for a position, (3,) metres.
        more: text after the numbers of sites and candidates.
    """
    from alight.report import words

    kinds = {"site": sites.sites, "candidate": sites.candidates}
    found = ", ".join(f"{len(part)} {name}{'s' * (len(part) != 1)}" for name, part in kinds.items() if part) + more
    if sites.sites:
        print_line(f"SITE  {_numbers(sites.sites[0], place)}  ({found})")
        return
    print_line(f"NO SITE  {sites.reason}")
    if sites.candidates:
        s = sites.candidates[0]
        look = words.look_from(s) + ("" if s.look is None else f", at {place([s.look.east, s.look.north, s.look.up])}")
        print_line(f"LOOK CLOSER  {_numbers(s, place)}  doubt: {words.doubt(s)}  look from: {look}  ({found})")


def _numbers(site: Site, place: Callable[[Sequence[float]], str]) -> str:
    from alight.records import p_safe_text

    name, but = ("P(safe)", "") if math.isfinite(site.p_ground) else ("P(shape)", ", ground not judged")
    zone = f"  in {site.avoid}" if site.avoid else ""
    return (
        f"{place([site.east, site.north, site.up])}  slope {math.degrees(site.slope):.1f} deg  "
        f"rough {site.roughness:.2f} m  clear {site.clearance:.1f} m  {name} {p_safe_text(site.p_safe)}{but}{zone}"
    )


def print_result(result: RunResult, answer: bool = True) -> None:
    """Print the answer of a run on stdout (if `answer`) and its warnings on stderr."""
    from alight.report import warnings

    def place(position: Sequence[float]) -> str:
        if not result.georeferenced:
            return f"east {position[0]:.2f} m north {position[1]:.2f} m"
        latitude, longitude, _ = result.local.to_geodetic(position)
        return f"{float(latitude):.7f} {float(longitude):.7f}"

    for w in warnings(result):
        print_stderr(f"warning: {w}")
    if answer:
        print_answer(result.sites, place)
    if isinstance(found := result.notes.get("log"), list):
        for line in found:
            print_line(f"LOG  {line}")
    for name in ("prior_dem", "zones"):
        if name in result.notes:
            print_line(f"{name.replace('_', ' ').upper()}  {result.notes[name]}")


def save_result(result: RunResult, out: Path, force: bool, answer: bool = True, same_as: Path | None = None) -> None:
    """Print the answer of a run (if `answer`), write the folder `out`, and print the path of the report in it.

    The answer comes first, in case the folder cannot be written. `force`, `same_as`: see `write_run`.
    """
    from alight.outputs import write_run

    print_result(result, answer)
    write_run(result, out, force, same_as)
    if result.route is not None and result.home is None and (out / "route.plan").exists():
        print_stderr(
            "warning: route.plan counts its heights from the ground of site 1, its planned home (whose own height is "
            "above the ellipsoid); give --home LAT,LON,ALT_MSL of the place where the vehicle is armed"
        )
    print_line(f"report: {out / 'report.html'}")
