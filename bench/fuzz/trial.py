"""One trial: run the command on a damaged input in a process of its own, and decide whether the answer is allowed."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

from cost import TOO_SLOW
from grammar import Damage

import alight.cli
import alight.runner.judge
import alight.runner.replay  # imported once: every trial is a fork of this process

STARVED = 30  # times the limit of processor time, as wall time: other processes use the processor, too
MEMORY = 6 * 2**30  # bytes of address space, the limit of a trial


@dataclass(frozen=True)
class Outcome:
    """Outcome of a trial."""

    fault: str | None  # None: allowed
    seconds: float  # of processor time
    megabytes: float  # peak
    said: str


@dataclass(frozen=True)
class Command:
    """Command of a trial: its words, with {} for the folder of the input, and the allowed answers."""

    words: tuple[str, ...]
    out: bool = True  # takes --out
    keys: str = "settings"  # kind of keys of `--set`; none: ""
    codes: tuple[int, ...] = (0,)  # allowed beside 2 with one line
    begins: tuple[str, ...] = ("SITE", "NO SITE")  # allowed starts of the answer on stdout
    only: str = ""  # folder of the input whose files are damaged; empty: all


COMMANDS = {
    "noise": Command(("run", "{}")),
    "flight": Command(("run", "{}")),
    "photos": Command(("run", "{}")),
    "recording": Command(("run", "{}/recording.mcap")),
    "ros1": Command(("run", "{}/bag.bag")),
    "sqlite3": Command(("run", "{}/bag/bag.db3")),
    "mcap": Command(("run", "{}/bag/bag.mcap")),
    "dem": Command(("hazards", "{}/dem.tif")),
    "evaluated": Command(("evaluate", "{}/run", "--truth", "{}/flight"), out=False, keys="", begins=("",)),
    "checked": Command(("check", "{}"), out=False, codes=(0, 3), begins=("",)),
    "scene": Command(("simulate", "{}/scene.yaml"), keys="scene", begins=("flight:",)),
    "model": Command(("terrain", "test", "--model", "{}/model.npz"), out=False, keys="", begins=("",)),
    "campaign": Command(
        ("campaign", "--out", "{}/one", "--compare", "{}/two"), out=False, keys="", begins=("",), only="two"
    ),  # a damaged "one" is repaired by flying: minutes
}


def command(kind: str, folder: Path, out: Path, damages: list[Damage]) -> list[str]:
    """Return the command for an input."""
    asked = COMMANDS[kind]
    sets = [part for d in damages if d.kind == "set" for part in ("--set", f"{d.file}={d.what}")]
    where = ["--out", str(out)] if asked.out else []
    return [*(w.replace("{}", str(folder)) for w in asked.words), *where, *sets]


def run(kind: str, arguments: list[str], limit: float) -> Outcome:
    """Run a command in a child with a limit of processor time in seconds."""
    with tempfile.TemporaryDirectory() as spare:
        streams = [Path(spare) / name for name in ("out", "err")]
        start = time.monotonic()
        child = os.fork()
        if child == 0:
            _child(arguments, streams, limit)
        status, used = _wait(child, start, STARVED * limit)
        out, err = (p.read_text(encoding="utf-8", errors="replace") if p.exists() else "" for p in streams)
    seconds, megabytes = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
    return Outcome(_fault(COMMANDS[kind], status, out, err), seconds, megabytes, (out + err)[-3000:])


def idle_megabytes() -> float:
    """Memory of this process, which is the memory of a trial at its start."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _child(arguments: list[str], streams: list[Path], limit: float) -> None:
    code = 1
    try:
        for number, path in enumerate(streams, 1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        sys.stdout, sys.stderr = (os.fdopen(n, "w", errors="backslashreplace") for n in (1, 2))
        code = alight.cli.call(arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _wait(child: int, start: float, limit: float) -> tuple[int, resource.struct_rusage]:
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            return status, used
        if time.monotonic() - start > limit:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.02)


def _fault(asked: Command, status: int, out: str, err: str) -> str | None:
    """Return the fault of an answer; None: it is an allowed one, or one line that says what to mend."""
    if os.WIFSIGNALED(status):
        ends = {signal.SIGXCPU: TOO_SLOW, signal.SIGKILL: "does not end, and does nothing"}
        return ends.get(signal.Signals(os.WTERMSIG(status)), f"ended by signal {os.WTERMSIG(status)}")
    code = os.WEXITSTATUS(status)
    if "Traceback" in err:
        last = [line for line in err.splitlines() if line and not line.startswith(" ")]
        return f"traceback: {last[-1][:200]}"
    if code in asked.codes:
        if not out.startswith(asked.begins):
            return "no answer"
        return f"could not be made: {err[-200:]}" if "could not be made" in err else None
    if code != 2:
        return f"exit code {code}"
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    return None if len(errors) == 1 and len(errors[0]) < 2000 else "no single line of an error"
