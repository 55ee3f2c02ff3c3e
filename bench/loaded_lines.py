"""Count the lines of ours that `alight run FLIGHT` and `alight fly` load, child processes included.

python bench/loaded_lines.py                 # a simulated flight of two seconds, and a minute of alight fly
python bench/loaded_lines.py run FLIGHT      # alight run over this flight alone
python bench/loaded_lines.py fly [RATE]      # alight fly alone, with alight rehearse as its vehicle: three minutes;
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

MOST = {"run": 26_000, "fly": 34_000}  # lines
WATCH = """
import os, sys
class _Watch:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("alight", "alight_sim"):
            with open(os.environ["LOADED_LINES"], "a") as file:
                file.write(name + "\\n")
sys.meta_path.insert(0, _Watch())
"""  # as sitecustomize.py: children inherit it, and forks that are killed have written by then


def watched(folder: Path) -> dict[str, str]:
    """Environment of a command whose imports, and those of its children, are written to `folder / "loaded"`."""
    (folder / "sitecustomize.py").write_text(WATCH)
    return {**os.environ, "PYTHONPATH": str(folder), "LOADED_LINES": str(folder / "loaded")}


def alight(*arguments: object, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
    """Start a command of Alight."""
    command = [str(Path(sys.executable).with_name("alight")), *map(str, arguments)]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def run(folder: Path, flight: str = "") -> None:
    """Run a flight log; without one, a simulated flight of two seconds."""
    if not flight:
        flight = str(folder / "flight")
        alight("simulate", "demo", "--out", flight, "--duration", 2).communicate()
    answer, _ = alight("run", flight, "--out", folder / "out", env=watched(folder)).communicate()
    print(answer.splitlines()[0])


def fly(folder: Path, rate: str = "5") -> None:
    """Fly over simulated ground for a while, with so many exposures a second; the vehicle is a process of its own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    pictures = ("--folder", folder / "pictures", "--width", 80, "--rate", rate)
    vehicle = alight("rehearse", "concrete", "--port", port, *pictures)
    assert vehicle.stdout is not None
    print(vehicle.stdout.readline().strip())
    flight = alight(
        "fly", "--link", f"udp:127.0.0.1:{port}", "--camera", folder / "pictures", "--out", folder / "out",
        env=watched(folder),
    )  # fmt: skip
    assert flight.stdout is not None
    for line in flight.stdout:
        print(line, end="")
        if line.startswith("state"):
            break
    time.sleep(60.0)
    flight.send_signal(signal.SIGINT)
    print(flight.communicate()[0])
    vehicle.send_signal(signal.SIGINT)
    vehicle.communicate()


def report(command: str, folder: Path) -> bool:
    """Print what a command has loaded, by room; return whether it is little enough."""
    lines = {}
    for name in set((folder / "loaded").read_text().split()):
        spec = find_spec(name)
        if spec is not None and spec.origin is not None:
            lines[name] = Path(spec.origin).read_text(encoding="utf-8").count("\n")
    rooms = Counter[str]()
    for name, count in lines.items():
        rooms[".".join(name.split(".")[:2])] += count
    if command == "fly" and "alight.flight.live.preload" not in lines:
        sys.exit("the flight was not begun: this machine was too busy for the simulation; measure again")
    simulator = sorted(name for name in lines if name.startswith("alight_sim"))
    print(f"alight {command}: {len(lines)} modules, {rooms.total()} lines (at most {MOST[command]})")
    for room, count in rooms.most_common():
        print(f"  {room:24s}{count:6d}")
    print("  modules of the simulator:", ", ".join(simulator) or "none")
    return rooms.total() <= MOST[command] and not simulator


def main() -> int:
    """Measure; the exit code is 1 where a command loads too much."""
    commands, good = sys.argv[1:2] or ["run", "fly"], True
    for command in commands:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (run if command == "run" else fly)(folder, *sys.argv[2:])
            good &= report(command, folder)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
