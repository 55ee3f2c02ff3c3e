"""End a run at random moments by SIGTERM and SIGKILL, start it again into the same folder, and check the files.

    python bench/ends.py [--times 20] [--seed 0]

Every second pair of moments lies between the first file of the results and the last one.

After SIGTERM: exit code 143 (or 0, when all was done; or the signal's own before Python has begun), every present file
is whole, no unfinished file is beside them, and the folder for temporary files is empty. After the second run: the
files of an undisturbed run, with the same bytes where they hold no times, and no others. Exit code 1 when one of these
does not hold.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import alight_sim

COMMAND = (sys.executable, "-c", "from alight.cli import main; main()")
TIMED = {"run.json", "report.html"}  # hold the seconds that the run took
LOCK = ".alight.lock"


def files(out: Path) -> dict[str, bytes]:
    """Every file under a folder."""
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file()}


def differing(found: dict[str, bytes], whole: dict[str, bytes]) -> list[str]:
    """Names of files that differ from those of an undisturbed run: others, empty, or with other bytes."""
    return sorted(k for k, v in found.items() if k not in whole or (k not in TIMED and v != whole[k]) or not v)


class Folders:
    """Folders of a run: its input, its results and its temporary files."""

    def __init__(self, root: Path, flight: Path) -> None:
        self.out, self._flight, self.spare = root / "out", flight, root / "tmp"
        self.spare.mkdir(parents=True)

    def start(self) -> subprocess.Popen[bytes]:
        """Start a run."""
        words = [*COMMAND, "run", str(self._flight), "--out", str(self.out)]
        env = os.environ | {"TMPDIR": str(self.spare)}
        return subprocess.Popen(words, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def has_begun_to_write(self, process: subprocess.Popen[bytes]) -> float:
        """Wait for the first file of the results, or for the end of the run; return that time."""
        while process.poll() is None and not any(p.name != LOCK for p in self.out.glob("*")):
            time.sleep(0.002)
        return time.monotonic()

    def ended(
        self, how: signal.Signals, moment: float, writing: bool, whole: dict[str, bytes]
    ) -> tuple[str, list[str]]:
        """End a run after `moment` seconds and run it again; return its progress, and the faults of its files.

        Args:
            writing: the seconds count from the first file of the results.
            whole: files of an undisturbed run.
        """
        process = self.start()
        if writing:
            self.has_begun_to_write(process)
        try:
            _, err = process.communicate(timeout=moment)
        except subprocess.TimeoutExpired:
            process.send_signal(how)
            _, err = process.communicate(timeout=600)
        found, wrong = files(self.out) if self.out.exists() else {}, []
        stage = f"{len(found.keys() & whole.keys())} of {len(whole)} files"
        if how is signal.SIGTERM:
            allowed = (143, 0) if found else (143, 0, -how)
            if process.returncode not in allowed or b"Traceback" in err:
                wrong.append(f"exit code {process.returncode}: {err[-300:].decode(errors='replace')}")
            wrong += [f"{name}: not whole" for name in differing(found, whole) if name != LOCK]
            wrong += [f"{name}: left in the folder for temporary files" for name in files(self.spare)]
        again = self.start()
        _, err = again.communicate(timeout=600)
        if again.returncode:
            wrong.append(f"the second run: exit code {again.returncode}: {err[-300:].decode(errors='replace')}")
        found = files(self.out)
        wrong += [f"{name}: not as without an end" for name in differing(found, whole)]
        wrong += [f"{name}: missing after the second run" for name in whole.keys() - found.keys()]
        return stage, wrong


def main() -> int:
    """End runs; return the exit code."""
    parser = argparse.ArgumentParser(description="End runs at random moments and start them again.")
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw, bad = random.Random(given.seed), 0
    with tempfile.TemporaryDirectory(prefix="alight-ends-") as folder:
        root = Path(folder)
        alight_sim.write(alight_sim.fly("demo", 0, 1.5), root / "flight", lambda done, total: None)
        for name in ("warm", "whole"):  # the first one may compile loops
            first, start = Folders(root / name, root / "flight"), time.monotonic()
            process = first.start()
            begun = first.has_begun_to_write(process)
            if process.wait():
                raise SystemExit("a run that nobody ends fails")
            end = time.monotonic()
        whole = files(first.out)
        for k in range(given.times):
            how, writing = (signal.SIGTERM, signal.SIGKILL)[k % 2], k % 4 > 1
            moment = draw.uniform(0.0, end - (begun if writing else start))
            stage, wrong = Folders(root / str(k), root / "flight").ended(how, moment, writing, whole)
            when = "of writing" if writing else f"of {end - start:.1f}"
            sys.stdout.write(f"{how.name} after {moment:5.2f} s {when} ({stage}): {'; '.join(wrong) or 'good'}\n")
            sys.stdout.flush()
            bad += bool(wrong)
    sys.stdout.write(f"{given.times} runs ended, {bad} left something wrong\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
