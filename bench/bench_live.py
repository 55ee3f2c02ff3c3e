"""A live run against its requirements: a simulated flight at its own speed, in real time.

    python bench/bench_live.py                          all of it; a quarter of an hour
    python bench/bench_live.py rate start               some parts: rate memory start sample
    python bench/bench_live.py memory --minutes 30

The simulated flight, 640 x 480 stereo at 30 exposures a second, is made once and kept in out/bench-live. At its end the
ground below repeats, and the motion goes on.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from tables import DATA, Row, at_least, show

import alight
import alight_sim
from alight.arrays import F64
from alight.flight.live.live import Listener, Live, LiveOptions
from alight.flight.live.run import for_flight
from alight.outputs.recorder import Recorder
from alight.pipeline import FlightPolicy
from alight.records import Event, Frame, NavSample
from alight.records.codec import FlightHead
from alight.runner.opening import open_source
from alight.runs import appearance_of
from alight.settings import Settings, load_settings
from alight.sources import Source
from alight.sources.live import paced

KEPT = Path(__file__).parents[1] / "out" / "bench-live"
RATE, SECONDS = 30.0, 10.0
SETTINGS = ("tuning.tracks.count=200", "parallax.cell=0.09")  # 40 m up: 590 x 450 cells below


def recording() -> Path:
    """The simulated flight as a recording; pictures are read from it without decoding."""
    path = KEPT / f"meadow-{RATE:.0f}-{SECONDS:.0f}-ros2.mcap"
    if not path.exists():
        print("making the flight ...", flush=True)
        KEPT.mkdir(parents=True, exist_ok=True)
        flight = alight_sim.fly("meadow", 3, duration=SECONDS, height=40.0, rate_hz=RATE)
        head = FlightHead(flight.name, flight.rig, flight.local, True, flight.imu_noise, Settings())
        recorder = Recorder(path.with_suffix(".tmp"), head)
        for event in flight.events():
            recorder.event(event)
            while recorder.behind > 100:  # MB
                time.sleep(0.01)
        recorder.close()
        assert not recorder.lost
        path.with_suffix(".tmp").rename(path)
    return path


def around(source: Source, seconds: float) -> Iterator[Event]:
    """Repeat the flight for some seconds: it continues at its end, at the same speed, over the same ground."""
    known = [e for e in source.events() if isinstance(e, NavSample) and e.position_world is not None]
    frames = [e.t_ns for e in source.events() if isinstance(e, Frame)]
    period = frames[-1] - frames[0] + round((frames[-1] - frames[0]) / (len(frames) - 1))
    stamps, places = np.array([e.t_ns for e in known]), np.array([e.position_world for e in known])
    begin, end = (np.array([np.interp(t, stamps, axis) for axis in places.T]) for t in (frames[0], frames[0] + period))
    for k in range(int(seconds * 1e9 / period) + 1):
        for e in source.events():
            if not frames[0] <= e.t_ns < frames[0] + period:
                continue
            if e.t_ns - frames[0] + k * period > seconds * 1e9:
                return
            yield moved(e, k * period, k * (end - begin))


def moved(event: Event, later: int, by: F64) -> Event:
    """An event `later` ns later, its position moved by `by` (3,) metres."""
    if isinstance(event, NavSample) and event.position_world is not None:
        return replace(event, t_ns=event.t_ns + later, position_world=event.position_world + by)
    return replace(event, t_ns=event.t_ns + later)


class Flown:
    """One live flight and its measured numbers.

    Args:
        seconds: of flight.
        memory: seconds between two measurements of it; 0: none, and a recording is written instead.
    """

    def __init__(self, seconds: float, memory: float = 0.0) -> None:
        source, settings = open_source(recording()), for_flight(load_settings("", [*SETTINGS]))
        self.memory = list[float]()
        with tempfile.TemporaryDirectory() as folder:
            head = FlightHead(source.name, source.rig, source.local, True, source.imu_noise, settings)
            recorder = Recorder(Path(folder) / "recording.mcap", head) if not memory else None
            options = LiveOptions(
                recorder=recorder, folder=Path(folder), appearance=appearance_of(settings), imu=source.imu_noise
            )
            live = Live(source.rig, settings, options)
            for lane in live.lanes.values():
                lane.wait_until_ready()
            begin = measured = time.perf_counter()
            first, counts = None, dict[str, int]()
            for event in paced(around(source, seconds), 1.0):
                live.feed(event)
                now = time.perf_counter()
                if first is None and now - begin > 3.0:  # s; before, the ground is still searched
                    first = now
                    for times in live.watch.timings.stages.values():
                        times.clear()
                    counts = dict(live.watch.counts)
                if memory and now - measured > memory:
                    measured = now
                    self.memory.append(resident(os.getpid()))
                    print(f"  {now - begin:6.0f} s  {self.memory[-1]:7.1f} MB  {live.health}", flush=True)
            assert first is not None
            self.lasted = time.perf_counter() - first
            self.times = {k: np.array(v) for k, v in live.watch.timings.stages.items()}
            self.used = live.watch.counts["frames used"] - counts.get("frames used", 0)
            self.left_out = sum(
                n - counts.get(k, 0) for k, n in live.watch.counts.items() if k.startswith("navigation: exposures left")
            )
            self.restarts = sum(live.watch.restarts.values())
            live.finish()
            self.compiled = live.counts["loops compiled in flight"]
            if recorder is not None:
                recorder.close()


def q95(times: dict[str, F64], name: str) -> float:
    """95th percentile of the times of a name; NaN without one."""
    return float(np.percentile(times[name], 95)) if len(times.get(name, ())) else float("nan")


def resident(pid: int) -> float:
    """MB of memory that a process and its children hold, shared memory counted once."""
    total = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
        if parent == pid:
            total += resident(int(entry.parent.name))
    try:
        pss = next(x for x in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines() if x.startswith("Pss:"))
    except (OSError, StopIteration):
        return total
    return total + int(pss.split()[1]) / 1000


def part_rate(_: argparse.Namespace) -> None:
    """30 exposures a second."""
    f = Flown(40.0)
    t = f.times
    show(
        Row("exposures a second that navigation used", f.used / f.lasted, at_least(29.0), at_least(50.0)),
        Row("... left out", f.left_out, 0),
        Row("frame to pose, p95, ms", 1e3 * q95(t, "frame to pose"), 50),
        Row("map steps a second", len(t.get("map step", ())) / f.lasted, at_least(5), at_least(15)),
        Row("map step, p95, s", q95(t, "map step"), 0.25),
        Row("keyframe to verdict, p95, s", q95(t, "frame to verdict"), 1.0, 0.4),
        Row("lanes lost", f.restarts, 0),
        Row("loops compiled in flight", f.compiled, 0),
    )


def part_memory(args: argparse.Namespace) -> None:
    """Resident memory, flat after the first tenth."""
    m = Flown(60.0 * args.minutes, memory=10.0).memory
    early, late = statistics.median(m[len(m) // 10 : len(m) // 5 + 1]), statistics.median(m[-max(len(m) // 10, 1) :])
    show(Row(f"memory at the end of {args.minutes:g} minutes, MB", late, 1500, 800),
        Row("... over that at the start", late / early, 1.05))  # fmt: skip


def part_start(_: argparse.Namespace) -> None:
    """From the command to the first pose, everything compiled, by the clock of the recording."""
    alight.warmup()
    with tempfile.TemporaryDirectory() as folder:
        begin, out = time.time_ns(), Path(folder) / "out"
        subprocess.run(command("live", recording(), "--out", out), check=True, stdout=subprocess.DEVNULL)
        with (out / "recording.mcap").open("rb") as file:
            _, _, motion = next(iter(make_reader(file).iter_messages(topics=["/motion"])))
    show(Row("start to first pose, s", 1e-9 * (motion.log_time - begin), 5, 3))


def part_sample(_: argparse.Namespace) -> None:
    """The sample flight of 12 s, with verdicts as often as the computer can."""
    source, settings, verdicts, begin = open_source(DATA / "sample"), load_settings(), list[float](), 0.0
    options = LiveOptions(
        Listener(verdict=lambda verdict, t_ns: verdicts.append(time.perf_counter())), policy=FlightPolicy(every=1),
        appearance=appearance_of(settings), imu=source.imu_noise,
    )  # fmt: skip
    live = Live(source.rig, for_flight(settings), options)
    for lane in live.lanes.values():
        lane.wait_until_ready()
    for event in paced(source.events(), 1.0):
        begin = begin or time.perf_counter() * isinstance(event, Frame)
        live.feed(event)
    show(
        Row("first verdict after the first exposure, s", verdicts[0] - begin, 4.0, 2.0),
        Row("longest time from one verdict to the next, s", max(np.diff(verdicts)), 2.0, 1.0),
        Row("exposures left out of the map, of 120", live.watch.counts["mapping: exposures left out, busy"], 10, 0),
        Row("keyframe to verdict, median, s", statistics.median(live.watch.timings.stages["frame to verdict"])),
    )
    live.close()


def command(*words: object) -> list[str]:
    """The command line in a process of its own."""
    code = "import sys; from alight.cli import main; sys.argv[0] = 'alight'; main()"
    return [sys.executable, "-c", code, *(str(w) for w in words)]


PARTS = {"rate": part_rate, "memory": part_memory, "start": part_start, "sample": part_sample}


def main() -> None:
    """Run the parts that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], default=list(PARTS))
    parser.add_argument("--minutes", type=float, default=30.0, help="of the part `memory`")
    args = parser.parse_args()
    for name in args.parts or PARTS:
        print(f"-- {name}: {PARTS[name].__doc__}", flush=True)
        PARTS[name](args)


if __name__ == "__main__":
    main()
