"""Check of flight by sight: the way that the filter finds without GPS, against GPS."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from alight.checks.result import CheckResult, good, unknown, warning
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.records import Event, Frame, Motion, MotionState, NavSample, Rig
from alight.settings import StageSettings

NAME = "sight alone"


class SightCheck:
    """Flies the second half of a part without GPS positions and velocities.

    Args:
        start, seconds: begin and length of the part, s from the first exposure.
    """

    def __init__(self, rig: Rig, settings: StageSettings, seconds: float, start: float = 0.0) -> None:
        self._lane, self._noise = FilterLane(rig, settings, history=False), settings.motion.filter
        self._start_ns, self._half_ns = round(1e9 * start), round(0.5e9 * seconds)
        self._begin_ns: int | None = None  # time from which GPS is left out
        self._nav, self._motions = list[NavSample](), list[Motion]()

    def watch(self, events: Iterable[Event]) -> Iterator[Event]:
        """Yield the events, and fly by them."""
        for event in events:
            self.feed(event)
            yield event

    def feed(self, event: Event) -> None:
        """Process one event."""
        if isinstance(event, Frame) and self._begin_ns is None:
            self._begin_ns = event.t_ns + self._start_ns + self._half_ns
        if self._begin_ns is not None and event.t_ns < self._begin_ns - self._half_ns:
            return
        if isinstance(event, NavSample) and self._begin_ns is not None and event.t_ns >= self._begin_ns:
            self._nav += [event] if event.position_world is not None else []
            event = replace(event, position_world=None, velocity_world=None)
        navigation = self._lane.feed(event)
        if navigation is not None and navigation.motion is not None and event.t_ns >= (self._begin_ns or 0):
            self._motions.append(navigation.motion)

    @property
    def result(self) -> CheckResult:
        """The drift of the position, horizontally, as a share of the way."""
        motions = [m for m in self._motions if m.odometry is not None and m.state is not MotionState.LOST]
        times = np.array([m.t_ns for m in motions], dtype=np.float64)
        rows = [s for s in self._nav if len(times) and times[0] <= s.t_ns <= times[-1]]
        if len(rows) < 2 or len({m.frame_id for m in motions}) > 1:
            return unknown(NAME, "needs GPS, attitude and pictures that hold the motion")
        places = np.array([m.world_from_body.translation[:2] for m in motions])
        at = np.array([s.t_ns for s in rows], dtype=np.float64)
        estimated = np.column_stack([np.interp(at, times, axis) for axis in places.T])
        off = np.array([s.position_world[:2] for s in rows if s.position_world is not None]) - estimated
        way, seconds = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()), 1e-9 * (at[-1] - at[0])
        drift = float(np.linalg.norm(off[-1] - off[0]))
        sigma = rows[-1].sigma_position
        claimed = self._noise.position_sigma if sigma is None else float(np.linalg.norm(sigma[:2]))
        gps = claimed * np.sqrt(-2.0 * np.expm1(-seconds / self._noise.nav_position_tau))
        covariance = motions[-1].odometry.covariance if motions[-1].odometry is not None else np.zeros((9, 9))
        own = float(np.sqrt(np.trace(covariance[:2, :2])))
        if way < 3.0 * gps:
            return unknown(NAME, f"{way:.1f} m flown in {seconds:.0f} s, and GPS drifts by {gps:.1f} m in that time")
        evidence = (
            f"{seconds:.0f} s without GPS over {way:.0f} m: {drift:.2f} m or {100 * drift / way:.1f} % of the way off, "
            f"of which GPS itself may drift {gps:.2f} m (1-sigma)"
        )
        if drift > 3.0 * np.hypot(own, gps):
            return warning(
                NAME, f"{evidence}; claimed was {own:.2f} m", "check calibration and mounting before flying by sight"
            )
        return good(NAME, evidence)
