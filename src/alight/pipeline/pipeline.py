"""The method: events in, a landing decision out. Without file, clock or thread, it is the same in replay and flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from alight.landing.reserve import Reserve
from alight.pipeline.judging import JudgingLane, Verdict
from alight.pipeline.lanes import PipelineOptions, conclude, mapping_lane, navigation_lane
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation
from alight.pipeline.policy import FlightPolicy
from alight.pipeline.timing import StageProgress, Timings, unreported
from alight.records import Decision, Event, Motion, Rig
from alight.settings import Settings


class Pipeline:
    """Three lanes in turn: navigation, mapping, judging. Feed it events in the order of arrival, then call `finish`.

    Args:
        rig: the cameras.
        kind: `flight` (continuous exposures) or `photos` (exposures far apart).
        settings: all settings; None: the defaults.
        options: appearance model, workers, policy and more; None: the defaults of `PipelineOptions`.
    """

    def __init__(
        self,
        rig: Rig,
        kind: Literal["flight", "photos"] = "flight",
        settings: Settings | None = None,
        options: PipelineOptions | None = None,
    ) -> None:
        options = options or PipelineOptions()
        self._settings = stages = (settings or Settings()).stages(options.imu)
        self._zones = options.zones
        self._timings, self._on_verdict = Timings(options.clock, options.history), options.on_verdict
        self._policy = options.policy or FlightPolicy(stages.sites.every)
        self._navigation = navigation_lane(rig, kind, stages, options)
        at_end = options.poses is None and stages.motion.bundles(kind)
        self._mapping = mapping_lane(rig, stages, options, self._timings, at_end)
        self._judging = JudgingLane(stages, options.appearance, self._timings, zones=options.zones)

    def feed(self, event: Event) -> Motion | None:
        """Process one event; return the motion of an exposure if it is known at once, else None."""
        if not self._policy.tracks(event):
            return None
        with self._timings.of("motion"):
            navigation = self._navigation.feed(event)  # features, motion: docs/method/motion.md
        if navigation is not None and (seen := self.map(navigation)) is not None:
            self._on_verdict(self.judge(seen), navigation.frame.t_ns)
        return None if navigation is None else navigation.motion

    def map(self, navigation: Navigation) -> MapSnapshot | None:
        """Improve the map with an exposure; return the map if it is due to be judged, else None."""
        policy = self._policy
        if not policy.maps(navigation):
            return None
        keyframes = self._mapping.feed(navigation, policy.effort(navigation))  # docs/method/parallax.md
        due = policy.due_verdict(navigation, keyframes)
        return None if due is None else self._mapping.snapshot(due.about)

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Return the verdict on a map: land cover, hazards, sites, and candidates with next views."""
        return self._judging.judge(seen)  # docs/method/land-cover.md, docs/method/hazards.md

    @property
    def reserve(self) -> Reserve:
        """Sites, in the world, of all maps judged so far that no newer map refuses.

        `lost` are the sites that the newest map refused, with the reasons.
        """
        return self._judging.memory.reserve

    @property
    def timings(self) -> Mapping[str, Sequence[float]]:
        """Durations of all steps in seconds, by stage; without history only the last steps."""
        return self._timings.stages

    def finish(self, progress: StageProgress = unreported) -> Decision:
        """Refine the motion, build and judge the map, and return the decision, with all results in the world."""
        return conclude(
            self._navigation, self._mapping, self._judging, self._settings, self._timings, progress, self._zones
        )
