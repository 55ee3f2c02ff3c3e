"""The standard ladder with pictures through tracker and filter, and vision alone beside it."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import ladder
import numpy as np
from motion_common import SECOND, Flown, Row, errors, fly, ring_px, say

from alight.motion import MotionFilter
from alight.records import ImuSample, MotionState, NavSample, Tracks
from alight.settings import FilterSettings, load_settings
from alight_sim.flight import SimulatedFlight


@dataclass(frozen=True)
class Climbed:
    """Numbers of one rung of the ladder."""

    height: int
    ring: float  # px, RMS
    seconds: float  # that a ring spans
    lost: int  # exposures
    nees: float
    alone: float  # % of the way, GPS/INS off after the first second
    cameras: float  # % of the way, and no IMU either

    @classmethod
    def of(cls, rung: ladder.Rung) -> Climbed:
        """Fly a rung and measure it."""
        flight = rung.fly()
        flown = fly(flight, load_settings("", ["tuning.filter.smooth=false"]))
        px, length = ring_px(flown, flight.pose, float(rung.height))
        lost = sum(m.state is MotionState.LOST for m in flown.online)
        mean = errors(flown.online, flight.pose)[2]
        return cls(rung.height, px, length, lost, mean, _alone(flown, flight, True), _alone(flown, flight, False))


def part_ladder(options: argparse.Namespace) -> None:
    """The standard ladder with pictures, flights without a part in tuning: ring, states, vision alone beside it."""
    scenes, heights = options.scenes.split(","), [int(h) for h in options.heights.split(",")]
    print(f"{'':34s}{'ring px':>9s}{'over s':>8s}{'lost':>6s}{'NEES':>7s}{'no GPS/INS %':>14s}{'nor IMU %':>11s}")
    found = []
    for r in ladder.ladder("test", scenes=scenes, heights=heights, seeds=options.seeds):
        c = Climbed.of(r)
        found.append(c)
        print(
            f"{r.name:34s}{c.ring:9.3f}{c.seconds:8.2f}{c.lost:6d}{c.nees:7.1f}{c.alone:14.2f}{c.cameras:11.2f}",
            flush=True,
        )
    for h in heights:
        some = [c for c in found if c.height == h]
        kept = 100 * float(np.mean([c.lost == 0 for c in some]))
        rings = np.array([c.ring for c in some])
        say(
            Row(f"ladder {h} m, {len(some)} flights: completed without `lost`", kept, 100, 100, "%", least=True),
            Row("... ring, RMS over the flights", float(np.sqrt(np.mean(rings**2))), 0.35, 0.15, "px"),
            Row("... ring, the worst flight", float(rings.max()), unit="px"),
            Row("... NEES, mean (6 expected)", float(np.mean([c.nees for c in some]))),
            Row(
                "... GPS/INS off after 1 s: drift of the way, median",
                float(np.median([c.alone for c in some])),
                unit="%",
            ),
            Row("... and no IMU: cameras alone, median", float(np.median([c.cameras for c in some])), unit="%"),
        )


def _alone(flown: Flown, flight: SimulatedFlight, imu: bool) -> float:
    """Percent of the way by which vision drifts when GPS/INS falls silent after the first second."""
    estimator, motions = MotionFilter(flown.rig, FilterSettings(smooth=False)), []
    begin = int(flight.frame_times[0]) + SECOND
    for e in flown.events:
        if isinstance(e, Tracks):
            motions += [m] if (m := estimator.feed_tracks(e)) else []
        elif isinstance(e, NavSample) and e.t_ns < begin:
            estimator.feed_nav(e)
        elif isinstance(e, ImuSample) and imu:
            estimator.feed_imu(e)
    first = next(m for m in motions if m.t_ns >= begin)
    off = [m.world_from_body.translation - flight.pose(m.t_ns).translation for m in (first, motions[-1])]
    way = flight.pose(motions[-1].t_ns).translation - flight.pose(first.t_ns).translation
    return 100 * float(np.linalg.norm(off[1] - off[0]) / np.linalg.norm(way))
