"""The method: events in, a landing decision out. No file, clock or thread: replay and flight run the same code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

from alight import terrain
from alight.arrays import F64
from alight.elevation import TileStore
from alight.landing import route
from alight.landing.reserve import Reserve
from alight.pipeline.decision import Decision
from alight.pipeline.judging import Verdict
from alight.pipeline.lanes import Lanes
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation, TimedPoses
from alight.pipeline.timing import Clock, Timings
from alight.pipeline.turns import turns
from alight.records import Event, Motion, Rig, Route, Schedule
from alight.settings import ImuNoise, Settings

Tell = Callable[[str, float], None]  # stage, share done


class Pipeline:
    """Three lanes in turn: navigation, mapping, judging. Feed it events in the order of arrival, then `finish`.

    Args:
        rig: the cameras.
        kind: `flight` (continuous, filter) or `photos` (far apart, bundle adjustment); the settings may say otherwise.
        poses: body poses that replace the estimated ones, for evaluation.
        clock: seconds, for the time of the stages; the core has none of its own.
        far: where the map puts what the vehicle has left behind: a file's mapping, `NullStore`, or by default memory.
        history: keep what `finish` needs of a recording; without it a flight may last for ever.
        appearance: what ground looks like; None: the map's own evidence alone says what covers it.
        schedule: of a live run, to do again what it did and when; None: every exposure in its turn.
        lanes: to use instead of those that `kind` and the settings call for, such as processes of their own.
        imu: noise that the recording states for its IMU.
    """

    def __init__(
        self,
        rig: Rig,
        kind: Literal["flight", "photos"] = "flight",
        settings: Settings | None = None,
        poses: TimedPoses | None = None,
        clock: Clock = lambda: 0.0,
        far: TileStore | None = None,
        history: bool = True,
        appearance: terrain.Model | None = None,
        schedule: Schedule | None = None,
        lanes: Lanes | None = None,
        imu: ImuNoise | None = None,
    ) -> None:
        self._settings = stages = (settings or Settings()).stages(imu)
        self._timings = Timings(clock, history)
        lanes = lanes or Lanes.of(rig, kind, stages, self._timings, poses, far, history, appearance, schedule)
        self._navigation, self._mapping, self._judging = lanes.navigation, lanes.mapping, lanes.judging
        self._turns = turns(schedule, stages.sites.every)

    def feed(self, event: Event) -> Motion | None:
        """Take one event; an exposure gives its motion when that is known at once."""
        if not self._turns.takes(event):
            return None
        with self._timings.of("motion"):
            navigation = self._navigation.feed(event)  # features, motion: docs/method/motion.md
        if navigation is not None and (seen := self.map(navigation)) is not None:
            self.judge(seen)
        return None if navigation is None else navigation.motion

    def map(self, navigation: Navigation) -> MapSnapshot | None:
        """Improve the map with an exposure; the map as it is then, where it is to be judged."""
        if not (turn := self._turns).maps(navigation):
            return None
        update = self._mapping.feed(navigation, turn.effort(navigation))  # docs/method/parallax.md
        return self._mapping.snapshot(turn.about(navigation)) if turn.judges(navigation, update) else None

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Judge a map: land cover, hazards, sites, and the next view where there is no site."""
        return self._judging.judge(seen)  # docs/method/land-cover.md, docs/method/hazards.md

    def judge_now(self, about: F64 | None = None) -> Verdict | None:
        """Judge the ground under the newest keyframe, and about a place of the map, (2,) metres; None without a map."""
        seen = self._mapping.snapshot(about)
        return None if seen is None else self.judge(seen)

    @property
    def reserve(self) -> Reserve:
        """The sites of all maps judged so far, and those that the newest one gave up, with the reason."""
        return self._judging.reserve

    @property
    def timings(self) -> Mapping[str, Sequence[float]]:
        """Seconds of every step, by stage; in flight the last ones."""
        return self._timings.stages

    def finish(self, tell: Tell = lambda stage, share: None) -> Decision:
        """Refine the motion, build the map, judge it and choose."""
        with self._timings.of("motion, all frames together"):
            trajectory = self._navigation.finish(lambda f: tell("motion", f))
        if not trajectory.usable:
            return Decision.none(trajectory, trajectory.reason)
        found = self._mapping.finish(trajectory, lambda f: tell("heights", f))
        if found.snapshot is None:
            return Decision.none(trajectory, found.reason, *found.warnings)
        tell("judging", 0.2)
        way = self._route(verdict := self.judge(found.snapshot), found.snapshot)
        tell("judging", 1.0)
        warnings, notes = (*found.warnings, *self._judging.warnings), self._judging.notes(verdict)
        return Decision.of(trajectory, found.snapshot, verdict, way, warnings, notes)

    def _route(self, verdict: Verdict, seen: MapSnapshot) -> Route | None:
        """The way to the best site, planned in the world."""
        if not verdict.sites.sites:
            return None
        vehicle, site = seen.frame.point(seen.vehicle.position), verdict.sites.sites[0]
        way = route.plan_route(site, seen.frame.elevation(seen.elevation), vehicle, self._settings.route)
        return replace(way, frame_id=seen.frame.frame_id)
