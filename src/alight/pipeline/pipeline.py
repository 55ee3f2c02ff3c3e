"""The method: events in, a landing decision out. No file, clock or thread: replay and flight run the same code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from alight import terrain
from alight.elevation import TileStore
from alight.jobs import Jobs
from alight.landing.reserve import Reserve
from alight.pipeline.decision import Decision, conclude
from alight.pipeline.judging import Verdict
from alight.pipeline.lanes import Lanes
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation, NavigationLane, TimedPoses
from alight.pipeline.policy import FlightPolicy, LanePolicy
from alight.pipeline.timing import Clock, Tell, Timings
from alight.records import Event, Motion, PriorHeights, Rig
from alight.settings import ImuNoise, Settings


class Pipeline:
    """Three lanes in turn: navigation, mapping, judging. Feed it events in the order of arrival, then `finish`.

    Args:
        rig, kind: the cameras; `flight` (continuous) or `photos` (far apart).
        poses: body poses that replace the estimated ones, for evaluation.
        clock: seconds, for the time of the stages; the core has none of its own.
        far: store of the tiles that the vehicle has left behind: a file's mapping, `NullStore`, or by default memory.
        history: keep the data for `finish`; without it a flight may last for ever.
        appearance: model of appearance; None: land cover from the map's own evidence alone.
        policy: chooses exposures, effort and the maps that are judged; None: a `FlightPolicy` by `sites.every`.
        on_verdict: called with the verdict on a map that was judged in flight, and the stamp of its newest exposure.
        lanes, navigation: used instead of the usual ones; one whose motions all come at the end (bundle adjustment).
        imu, jobs, prior: noise of the recording's IMU; workers for photos; heights known from elsewhere.
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
        policy: LanePolicy | None = None,
        on_verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None,
        lanes: Lanes | None = None,
        navigation: NavigationLane | None = None,
        imu: ImuNoise | None = None,
        jobs: Jobs | None = None,
        prior: PriorHeights | None = None,
    ) -> None:
        self._settings = stages = (settings or Settings()).stages(imu)
        self._timings, self._on_verdict = Timings(clock, history), on_verdict
        self._policy = policy or FlightPolicy(stages.sites.every)
        lanes = lanes or Lanes.of(
            rig, kind, stages, self._timings, poses, far, history, appearance, self._policy, jobs, prior, navigation
        )
        self._navigation, self._mapping, self._judging = lanes.navigation, lanes.mapping, lanes.judging

    def feed(self, event: Event) -> Motion | None:
        """Take one event; an exposure gives its motion when that is known at once."""
        if not self._policy.tracks(event):
            return None
        with self._timings.of("motion"):
            navigation = self._navigation.feed(event)  # features, motion: docs/method/motion.md
        if navigation is not None and (seen := self.map(navigation)) is not None:
            self._on_verdict(self.judge(seen), navigation.frame.t_ns)
        return None if navigation is None else navigation.motion

    def map(self, navigation: Navigation) -> MapSnapshot | None:
        """Improve the map with an exposure; return the map if it is to be judged, else None."""
        policy = self._policy
        if not policy.maps(navigation):
            return None
        update = self._mapping.feed(navigation, policy.effort(navigation))  # docs/method/parallax.md
        due = policy.due_verdict(navigation, update)
        return None if due is None else self._mapping.snapshot(due.about)

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Judge a map: land cover, hazards, sites, and the next view where there is no site."""
        return self._judging.judge(seen)  # docs/method/land-cover.md, docs/method/hazards.md

    @property
    def reserve(self) -> Reserve:
        """The sites of all maps judged so far, and those that the newest one gave up, with the reason; in the world."""
        return self._judging.memory.reserve

    @property
    def timings(self) -> Mapping[str, Sequence[float]]:
        """Seconds of every step, by stage; in flight the last ones."""
        return self._timings.stages

    def finish(self, tell: Tell = lambda stage, share: None) -> Decision:
        """Refine the motion, build the map, judge it and choose."""
        return conclude(self._navigation, self._mapping, self._judging, self._settings, self._timings, tell)
