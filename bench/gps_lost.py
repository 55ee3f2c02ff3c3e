"""Part of bench_motion.py: flights whose GPS is taken away, led away, or left alone."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from motion_flights import interpolated
from motion_scenarios import Sample, led_away, without_fix
from point_flight import RIG, PointFlight, run
from tables import DATA, Row, recording, show

from alight.arrays import F64
from alight.geometry import Pose
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.records import Frame, GpsState, Motion, Rig
from alight.settings import load_settings

SECOND = 1_000_000_000
ELLIPSE = -2.0 * np.log(0.05)  # squared distance of the 95 % ellipse
LIMITS = {"stereo": (1.5, 0.7), "one camera": (3.0, 1.5)}  # must and aim of the drift, % of the way
Fly = Callable[[Callable[[Sample], Sample]], list[Motion]]  # what becomes of each event -> motions


@dataclass
class Found:
    """Numbers of flights of one kind."""

    drift: list[float] = field(default_factory=list)  # share of the way
    covered: list[float] = field(default_factory=list)  # share of the exposures
    seconds: list[float] = field(default_factory=list)  # until the drift of GPS was named
    jump: float = 0.0  # m, largest step of the position against its velocity when GPS comes back
    alarms: int = 0  # exposures of good GPS at which it was not used

    def add(self, name: str, fly: Fly, truth: Callable[[int], Pose], begin_ns: int, end_ns: int) -> None:
        """Fly three times: GPS away between two times, led away from the first on, and good; print a line."""

        def off(m: Motion) -> F64:
            return np.asarray((m.world_from_body.translation - truth(m.t_ns).translation)[:2])

        away = [m for m in fly(lambda e: without_fix(e) if begin_ns <= e.t_ns < end_ns else e) if begin_ns <= m.t_ns]
        lost = [m for m in away if m.t_ns < end_ns and m.odometry and m.odometry.gps is GpsState.LOST]
        places = np.array([truth(m.t_ns).translation for m in away if m.t_ns < end_ns])
        way = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        self.drift.append(float(np.linalg.norm(off(lost[-1]) - off(away[0]))) / way)
        since = [(off(m) - off(lost[0]), m.odometry.covariance[:2, :2]) for m in lost[1:] if m.odometry]
        self.covered.append(float(np.mean([e @ np.linalg.solve(c, e) <= ELLIPSE for e, c in since])))
        back = [m for m in away if m.t_ns >= end_ns - SECOND]
        p, v = np.array([m.world_from_body.translation for m in back]), np.array([m.velocity_world for m in back])
        dt = np.diff([m.t_ns for m in back])[:, None] / SECOND
        self.jump = max(self.jump, *np.linalg.norm(np.diff(p, axis=0) - 0.5 * dt * (v[1:] + v[:-1]), axis=1))
        led = [m for m in fly(lambda e: led_away(e, (e.t_ns - begin_ns) * 1e-9)) if m.t_ns >= begin_ns]
        named = next((m for m in led if m.odometry and m.odometry.gps is GpsState.DRIFTS), None)
        self.seconds.append(np.inf if named is None else (named.t_ns - begin_ns) / SECOND)
        good = fly(lambda e: e)
        alarms = sum(m.odometry is not None and m.odometry.gps is not GpsState.USED for m in good)
        self.alarms += alarms
        print(
            f"  {name}: drift {100 * self.drift[-1]:.2f} % of {way:.0f} m, covered {100 * self.covered[-1]:.0f} %, "
            f"named after {self.seconds[-1]:.1f} s, doubted {alarms}",
            flush=True,
        )

    def show(self, name: str, must: float, aim: float) -> None:
        """Print the numbers of these flights."""
        rms = 100.0 * float(np.sqrt(np.mean(np.square(self.drift))))
        show(
            Row(f"{name}, {len(self.drift)} flights: drift without GPS, RMS, % of the way", rms, must, aim),
            Row("... largest", 100.0 * max(self.drift)),
            Row("... in the claimed 95 % ellipse, %", 100.0 * float(np.mean(self.covered)), (90.0, 99.0)),
            Row("... jump when GPS comes back, largest, m", self.jump, 0.5),
            Row("GPS led away at 1 m/s: named after, largest, s", max(self.seconds), 5.0, 2.0),
            Row("good GPS: exposures at which it was doubted", self.alarms, 0),
        )


def mono(rig: Rig) -> Rig:
    """The rig with its first camera alone."""
    return replace(rig, cameras=rig.cameras[:1])


def part_lost(args: argparse.Namespace) -> None:
    """Flights of points without GPS for 60 s."""
    for name, rig, (must, aim) in zip(LIMITS, (RIG, mono(RIG)), LIMITS.values(), strict=True):
        found = Found()
        for seed in range(args.seeds):
            f = PointFlight(seed=seed, seconds=70.0, rig=rig)
            start = f.events[0].t_ns - round(f.seconds_of(f.events[0]) * SECOND)

            def fly(how: Callable[[Sample], Sample], f: PointFlight = f) -> list[Motion]:
                return run([how(e) for e in f.events], rig=f.rig)[1]

            found.add(f"points {seed}", fly, f.truth, start + 8 * SECOND, start + 68 * SECOND)
        found.show(f"points, 60 s, {name}", must, aim)


def part_lost_pictures(args: argparse.Namespace) -> None:
    """Flights of pictures without GPS, as long as they last."""
    settings = load_settings("", ["tuning.filter.smooth=false"])
    for name, (must, aim) in LIMITS.items():
        found = Found()
        for folder in [DATA / "sample", *sorted((DATA / "rendered").glob("*")), *args.flights]:
            source = recording(folder, settings)
            if source is None:
                continue
            rig = source.rig if name == "stereo" else mono(source.rig)
            stages = settings.stages(source.imu_noise)

            def drawn(how: Callable[[Sample], Sample], source=source, rig=rig, stages=stages) -> list[Motion]:
                lane, out = FilterLane(rig, stages, history=False), list[Motion]()
                for e in source.events():
                    e = replace(e, images=e.images[: len(rig.cameras)]) if isinstance(e, Frame) else how(e)
                    navigation = lane.feed(e)
                    if navigation is not None and navigation.motion is not None:
                        out.append(navigation.motion)
                return out

            frames = [e.t_ns for e in source.events() if isinstance(e, Frame)]
            end = min(frames[-1], frames[0] + 64 * SECOND)
            found.add(folder.name, drawn, interpolated(source), frames[0] + 4 * SECOND, end)
        found.show(f"pictures, {name}", must, aim)
