"""Output of rich on a terminal: the console on stderr, the progress bars, and the log above them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, Task, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from alight.cli.terminal import discard


class _Stderr(Console):
    """Console on stderr. If the pipe is closed or the disk is full, lines are lost, but the work continues."""

    def on_broken_pipe(self) -> None:
        """Continue without stderr, where rich would end the program."""
        discard(sys.stderr)

    def __exit__(self, exc_type: Any, exc_value: Any, traceback: Any) -> None:
        """Write pending lines at the end of an output of rich, and continue if stderr fails."""
        try:
            super().__exit__(exc_type, exc_value, traceback)
        except OSError:
            discard(sys.stderr)


class _TimeLeft(TimeRemainingColumn):
    """Time left of the whole, or of each stage if there is no progress of the whole."""

    def render(self, task: Task) -> Text:
        """Return the time left of a task; empty for a stage of a whole."""
        return super().render(task) if task.fields["left"] else Text()


stderr = _Stderr(stderr=True)
log_handler = RichHandler(console=stderr, show_path=False, show_time=False)


@contextmanager
def bars() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that updates the progress bar of a stage; the bars are removed at the end."""
    from alight.pipeline.timing import WHOLE

    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        _TimeLeft(),
    )
    # the time left is estimated from the last 300 s: a tile may take a minute
    with Progress(*columns, console=stderr, transient=True, speed_estimate_period=300.0) as bar:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, share: float) -> None:
            if stage not in tasks:
                left = "left" if stage == WHOLE or WHOLE not in tasks else ""
                tasks[stage] = bar.add_task(stage, total=1.0, left=left)
            bar.update(tasks[stage], completed=share)

        yield report


@contextmanager
def live_table() -> Iterator[Callable[[Iterable[tuple[str, str]], Iterable[str]], None]]:
    """Yield a function that shows a table of names and values with lines below it, and replaces the previous one."""
    with Live(console=stderr, transient=True, auto_refresh=False) as display:

        def show(rows: Iterable[tuple[str, str]], lines: Iterable[str]) -> None:
            table = Table.grid(padding=(0, 2))
            for name, value in rows:
                table.add_row(Text(name, style="bold"), value)
            display.update(Group(*([table] if table.row_count else []), *map(Text, lines)), refresh=True)

        yield show


def scene_card(name: str, description: str, picture: Path) -> Table:
    """Return a scene's picture in half blocks, beside its name and description."""
    table = Table.grid(padding=(0, 2))
    table.add_column(min_width=32, no_wrap=True)
    table.add_column()
    table.add_row(half_blocks(picture), Text.assemble((f"\n{name}\n\n", "bold"), description))
    return table


def half_blocks(picture: Path, cols: int = 32, rows: int = 12) -> Text:
    """Return a picture as coloured half-block characters, two pixels per character; empty if it cannot be read.

    `cols`, `rows`: largest size of the text, characters.
    """
    import cv2

    out, image = Text(no_wrap=True), cv2.imread(str(picture), cv2.IMREAD_COLOR_RGB)
    if image is None:
        return out
    small = cv2.resize(image, (cols, 2 * rows), interpolation=cv2.INTER_AREA).tolist()
    for upper, lower in zip(small[::2], small[1::2], strict=True):
        for a, b in zip(upper, lower, strict=True):
            out.append("▀", style=f"rgb({a[0]},{a[1]},{a[2]}) on rgb({b[0]},{b[1]},{b[2]})")
        out.append("\n")
    return out
