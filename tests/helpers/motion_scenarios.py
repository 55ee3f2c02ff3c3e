"""Flights with named damage, and the results of the filter on them, for the tests and for bench/bench_motion.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from point_flight import PointFlight, best, blind, error, run, seconds

from alight.arrays import F64
from alight.geometry import so3_exp
from alight.motion import MotionFilter
from alight.records import Event, Motion, MotionState, NavSample, Tracks

Sample = Event | Tracks
GOOD, DEGRADED, LOST = MotionState.GOOD, MotionState.DEGRADED, MotionState.LOST


@dataclass(frozen=True)
class Scenario:
    """One kind of damage, between two times."""

    name: str
    begin: float  # s
    end: float
    how: Callable[[Sample, float], Sample | None]  # the event and its seconds -> the event that is left of it
    flight: dict[str, float] = field(default_factory=dict)
    length: float = 14.0

    def fly(self, seed: int = 0) -> Outcome:
        """Run the filter on a damaged flight; the undamaged one is `Outcome.whole`."""
        f = PointFlight(seed=seed, seconds=self.length, **self.flight)  # type: ignore[arg-type]
        left = [e for e in (self.how(e, seconds(e)) for e in f.events) if e is not None]
        estimator, motions = run(left, rig=f.rig)
        return Outcome(self, f, motions, estimator)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Motions of the filter on a damaged flight, with the truth."""

    scenario: Scenario
    flight: PointFlight
    motions: list[Motion]
    estimator: MotionFilter

    @cached_property
    def whole(self) -> list[Motion]:
        """Motions of the filter on the same flight without damage."""
        return run(self.flight.events)[1]

    def states(self, start: float, end: float) -> set[MotionState]:
        """All states given out in a stretch of time."""
        return {m.state for m in self.motions if start <= seconds(m) < end}

    def share(self, state: MotionState, start: float, end: float) -> float:
        """Share of the exposures in a stretch of time that had a state."""
        return float(np.mean([m.state is state for m in self.motions if start <= seconds(m) < end]))

    def normalised(self, after: float) -> float:
        """Largest error after a time, in its own sigma, of position (offset added) and attitude."""
        found = [error(m, self.flight.truth(m.t_ns)) for m in self.motions if seconds(m) >= after]
        return float(max(np.abs(e / np.sqrt(np.diag(c))).max() for e, c in found))

    def against_whole(self, after: float) -> tuple[float, float]:
        """RMS after a time: position against the undamaged run [m], and attitude error [rad]."""
        a = {m.t_ns: m for m in self.whole}
        both = [(m, a[m.t_ns]) for m in self.motions if seconds(m) >= after and m.t_ns in a]
        place = [np.linalg.norm(best(m)[0] - best(n)[0]) for m, n in both]
        return float(np.sqrt(np.mean(np.square(place)))), self.turned(after)

    def turned(self, after: float) -> float:
        """RMS attitude error after a time, rad."""
        e = [error(m, self.flight.truth(m.t_ns))[0][3:] for m in self.motions if seconds(m) >= after]
        return float(np.sqrt((np.square(e)).sum(axis=1).mean()))

    def jumps(self) -> F64:
        """(N,) m by which the position departs from its own velocity between exposures of one map."""
        out = []
        for a, b in zip(self.motions, self.motions[1:], strict=False):
            if a.frame_id == b.frame_id and a.velocity_world is not None and b.velocity_world is not None:
                step = b.world_from_body.translation - a.world_from_body.translation
                way = 0.5 * (a.velocity_world + b.velocity_world) * (b.t_ns - a.t_ns) * 1e-9
                out.append(float(np.linalg.norm(step - way)))
        return np.array(out)

    def heading(self, t: float) -> float:
        """Error of the heading at a time, rad."""
        m = min(self.motions, key=lambda m: abs(seconds(m) - t))
        return float(error(m, self.flight.truth(m.t_ns))[0][5])

    def drift(self) -> float:
        """Position error gained during the damage over the way flown in it."""

        def off(t: float) -> F64:
            m = min(self.motions, key=lambda m: abs(seconds(m) - t))
            return np.asarray(m.world_from_body.translation - self.flight.truth(m.t_ns).translation)

        s = self.scenario
        return float(np.linalg.norm(off(s.end) - off(s.begin))) / (self.flight.speed * (s.end - s.begin))


def _jump(e: Sample, t: float) -> Sample | None:
    if isinstance(e, NavSample) and 6.0 <= t < 9.0 and e.position_world is not None:
        return replace(e, position_world=e.position_world + np.array([3.0, 4.0, 0.0]))
    return e


def _dropped(e: Sample, t: float) -> Sample | None:
    lost = isinstance(e, Tracks) and np.random.default_rng(e.t_ns % (1 << 32)).random() < 0.2
    return blind(e) if lost and isinstance(e, Tracks) else e


def _covered(e: Sample, t: float) -> Sample | None:
    """Cover the lens: no feature comes back, so that the tracker has new ones after."""
    if not isinstance(e, Tracks):
        return e
    if 6.0 <= t < 9.0:
        return blind(e)
    return e if t < 6.0 else replace(e, ids=e.ids + 1_000_000)


def _turned(e: Sample, t: float) -> Sample | None:
    if isinstance(e, NavSample) and e.world_from_body is not None:
        return replace(e, world_from_body=so3_exp([0.0, 0.0, np.radians(10.0)]) @ e.world_from_body)
    return e


def _silent(e: Sample, t: float) -> Sample | None:
    return None if isinstance(e, NavSample) and 8.0 <= t < 38.0 else e


def without_fix(e: Sample) -> Sample:
    """The event without position and velocity, as from an autopilot without GPS: attitude and barometer are left."""
    if not isinstance(e, NavSample) or e.position_world is None:
        return e
    height = float(e.position_world[2])
    return replace(e, position_world=None, velocity_world=None, sigma_position=None, height_world=height)


def led_away(e: Sample, t: float, speed: float = 1.0) -> Sample:
    """The event `t` s after GPS began to be led away: position and velocity drift east at `speed` m/s."""
    if not isinstance(e, NavSample) or e.position_world is None or t < 0.0:
        return e
    v, by = np.array([speed, 0.0, 0.0]), e.velocity_world
    return replace(e, position_world=e.position_world + t * v, velocity_world=None if by is None else by + v)


def _as_is(e: Sample, t: float) -> Sample | None:
    return e


JUMP = Scenario("GPS jumps by 5 m for 3 s", 6.0, 9.0, _jump)
DROPPED = Scenario("20 % of the frames dropped", 0.0, 14.0, _dropped)
COVERED = Scenario("lens covered for 3 s", 6.0, 9.0, _covered)
MOVING = Scenario("30 % of the features move", 0.0, 14.0, _as_is, {"moving": 0.3})
TURNED = Scenario("INS heading wrong by 10 degrees", 0.0, 5.0, _turned)
OUTAGE = Scenario("GPS/INS silent for 30 s", 8.0, 38.0, _silent, length=40.0)
ALL = (JUMP, DROPPED, COVERED, MOVING, TURNED, OUTAGE)
