"""Damage inputs for a given time from a seed; keep and shrink the cases whose answer is not an allowed one.

    python bench/fuzz --minutes 10 --seed 3 [--keep FOLDER] [--kinds flight,dem]

A failure is kept as JSON: its kind, its damages and the output. `--again FILE` repeats it. Exit code 1 if a case
failed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import hostile
import protocol
import seeds
import trial
from cost import PATIENCE, Cost, pixels_left
from grammar import Damage, drawn

HEALTHY_SECONDS = 600.0  # limit of processor time of a healthy input
MACHINES = {"protocol": protocol.trial, "hostile": hostile.trial}  # trials of the protocol machine, by seed
TAGS = tuple(seeds.dji_tags())


class Fuzzer:
    """Healthy inputs, their cost, and the failures that were found."""

    def __init__(self, folder: Path, keep: Path, kinds: list[str]) -> None:
        self._folder, self._keep = folder, keep
        self.failures: dict[str, Path] = {}
        self._healthy: dict[str, Cost] = {}
        idle = trial.idle_megabytes()
        for kind in kinds:
            if kind in seeds.INPUTS:
                _made(kind, folder / kind)
                found, pixels = self._tried(kind, [], HEALTHY_SECONDS)
                if found.fault:
                    raise SystemExit(f"{kind}: the healthy input fails: {found.fault}: {found.said}")
                self._healthy[kind] = Cost(found.seconds, found.megabytes, pixels, idle)

    def _tried(self, kind: str, damages: list[Damage], limit: float) -> tuple[trial.Outcome, int]:
        """Damage a copy of a healthy input and run the command on it; return the outcome and the pixels written."""
        with tempfile.TemporaryDirectory(dir=self._folder) as spare:
            copy, out = Path(spare) / "input", Path(spare) / "left" / "out"
            out.parent.mkdir()
            if kind == "photos" and any(d.kind in ("tag", "place", "same") for d in damages):
                seeds.photos(copy, tuple(damages))
            else:
                shutil.copytree(self._folder / kind, copy)
            for d in damages:
                d.apply(copy)
            found = trial.run(kind, trial.command(kind, copy, out, damages), limit)
            return found, pixels_left(out.parent)

    def judged(self, kind: str, damages: list[Damage]) -> tuple[str | None, str]:
        """Return the fault of the answer to a damaged input (None: no fault), and the output."""
        healthy = self._healthy[kind]
        found, pixels = self._tried(kind, damages, PATIENCE * healthy.limit)
        return healthy.fault(found, pixels), found.said

    def shrunk(self, kind: str, damages: list[Damage], fault: str) -> list[Damage]:
        """Return a smallest part of the damages that still fails."""
        left = list(damages)
        for d in damages:
            fewer = [e for e in left if e is not d]
            if len(left) > 1 and self.judged(kind, fewer)[0] is not None:
                left = fewer
        return left

    def once(self, kind: str, seed: int) -> str | None:
        """Run one trial; return its fault."""
        if kind in MACHINES:
            fault = MACHINES[kind](seed)
            if fault is not None:
                self._note(kind, fault.strip().splitlines()[-1], {"kind": kind, "seed": seed, "said": fault})
            return fault
        draw = random.Random(seed)
        asked = trial.COMMANDS[kind]
        damages = drawn(draw, self._folder / kind, asked.keys, asked.only)
        if kind == "photos" and draw.random() < 0.5:
            damages = [Damage("tag", draw.choice(TAGS), draw.random(), draw.choice(seeds.TAG_VALUES)) for _ in range(3)]
            damages += [Damage("place", "", 0, draw.choice(("pole", "one", "high")))] * (draw.random() < 0.2)
            damages += [Damage("same", "", 0, "")] * (draw.random() < 0.1)
        fault, said = self.judged(kind, damages)
        if fault is not None and fault not in self.failures:
            few = self.shrunk(kind, damages, fault)
            self._note(kind, fault, {"kind": kind, "damages": [asdict(d) for d in few], "fault": fault, "said": said})
        return fault

    def _note(self, kind: str, fault: str, tree: dict[str, object]) -> None:
        if fault in self.failures:
            return
        self._keep.mkdir(parents=True, exist_ok=True)
        path = self._keep / f"{kind}-{len(self.failures)}.json"
        path.write_text(json.dumps(tree, indent=1), encoding="utf-8")
        self.failures[fault] = path
        sys.stdout.write(f"{path}: {fault}\n")
        sys.stdout.flush()


def _made(kind: str, folder: Path) -> None:
    """Make a healthy input in a child process: this process must not start threads before it forks."""
    child = os.fork()
    if child == 0:
        seeds.INPUTS[kind](folder)
        os._exit(0)
    os.waitpid(child, 0)


def main() -> int:
    """Run trials for a given time; return the exit code."""
    parser = argparse.ArgumentParser(description="Damage inputs and see that the answer is one of those promised.")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--trials", type=int, default=10**9, help="end after so many")
    parser.add_argument("--seed", type=int, default=None, help="default: another one each time")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--kinds", default=",".join([*seeds.INPUTS, *MACHINES]))
    parser.add_argument("--again", type=Path, default=None, help="a failure that was kept")
    given = parser.parse_args()
    kinds = given.kinds.split(",")
    seed = random.SystemRandom().randrange(10**6) if given.seed is None else given.seed
    tree = json.loads(given.again.read_text(encoding="utf-8")) if given.again else None
    with tempfile.TemporaryDirectory(prefix="alight-fuzz-") as folder:
        fuzzer = Fuzzer(Path(folder), given.keep, [tree["kind"]] if tree else kinds)
        if tree:
            fault = MACHINES[tree["kind"]](tree["seed"]) if "seed" in tree else None
            if "damages" in tree:
                fault = "\n".join(map(str, fuzzer.judged(tree["kind"], [Damage(**d) for d in tree["damages"]])))
            sys.stdout.write(f"{fault}\n")
            return int(fault is not None and not fault.startswith("None"))
        end, trials = time.monotonic() + 60 * given.minutes, 0
        while time.monotonic() < end and trials < given.trials:
            fuzzer.once(kinds[trials % len(kinds)], 1_000_000 * seed + trials)
            trials += 1
    sys.stdout.write(f"seed {seed}: {trials} trials, {len(fuzzer.failures)} kinds of failure\n")
    return int(bool(fuzzer.failures))


if __name__ == "__main__":
    sys.exit(main())
