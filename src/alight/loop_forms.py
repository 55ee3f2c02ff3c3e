"""Compilation of loops ahead of time, side by side: `loop_forms.json` lists the forms that each kind of run uses.

The lists are made by `bench/loop_forms.py`, the longest compilation first. A form that is not listed is compiled when
it is first called.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

from alight import compiled
from alight.documents import parse_json
from alight.jobs import InProcesses, InTurn, Jobs, Task

Use = Literal["flight", "hazards", "photos", "simulator"]  # kinds of runs
USES: tuple[Use, ...] = get_args(Use)


@cache
def loop_forms() -> dict[str, dict[str, list[str]]]:
    """Return by `Use` the loops with the types of their arguments, one text for each form."""
    forms: dict[str, dict[str, list[str]]] = parse_json(Path(__file__).with_suffix(".json").read_bytes())
    return forms


def compile_loop(name: str, forms: Sequence[str]) -> None:
    """Compile forms of a loop, named with its module, or load them from the cache."""
    module, _, function = name.rpartition(".")
    loop: Any = getattr(importlib.import_module(module), function)
    for form in forms:
        compiled.compile_form(loop, form)


def compile_loops(
    *uses: Use, progress: Callable[[str, float], None] = lambda stage, share: None, cores: int = 0
) -> None:
    """Compile the loops of these kinds of runs, unless that was done on this machine.

    Args:
        progress: called with the name of the stage and the share of it that is done.
        cores: number of processes that compile; 0: one on each core; 1: this process, as a script without
            `if __name__ == "__main__":` cannot start others.
    """
    cold = [use for use in uses if not compiled.is_warm(use)]
    if compiled.CACHE is None or not cold:
        return
    loops = {name: forms for use in cold for name, forms in loop_forms()[use].items()}
    tasks = [Task(name, compile_loop, (name, forms)) for name, forms in loops.items()]
    cores = cores or compiled.most_threads()
    jobs: Jobs = InProcesses(cores) if cores > 1 else InTurn()
    progress("compile", 0.0)
    for number, _ in enumerate(jobs.run(tasks, any_order=True), 1):
        progress("compile", number / len(tasks))
    for use in cold:
        compiled.mark_warm(use)
