"""The three lanes of a run, and lanes that a replay makes anew where one was lost in flight."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal, Protocol

from alight import terrain
from alight.arrays import F64
from alight.elevation import TileStore
from alight.jobs import InTurn, Jobs
from alight.pipeline.judging import JudgingLane, JudgingMemory, Verdict
from alight.pipeline.mapping import FinishedMap, MappingLane, MapSnapshot, MapUpdate, mapping_lane
from alight.pipeline.navigation import FilterLane, Navigation, NavigationLane, TimedPoses, Trajectory, navigation_lane
from alight.pipeline.policy import LanePolicy
from alight.pipeline.timing import Timings
from alight.records import Event, Frame, PriorHeights, Rig
from alight.settings import StageSettings

Progress = Callable[[float], None]


class Judge(Protocol):
    """One way to judge a map: in this process, or in another one."""

    @property
    def memory(self) -> JudgingMemory:
        """The sites of all maps judged so far, and warnings on them."""

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Judge a map."""

    def notes(self, found: Verdict) -> dict[str, object]:
        """Notes of a run on a verdict."""


@dataclass(frozen=True)
class Lanes:
    """Navigation, mapping and judging; they exchange records only."""

    navigation: NavigationLane
    mapping: MappingLane
    judging: Judge

    @classmethod
    def of(
        cls,
        rig: Rig,
        kind: Literal["flight", "photos"],
        stages: StageSettings,
        timings: Timings,
        poses: TimedPoses | None = None,
        far: TileStore | None = None,
        history: bool = True,
        appearance: terrain.Model | None = None,
        policy: LanePolicy | None = None,
        jobs: Jobs | None = None,
        prior: PriorHeights | None = None,
        navigation: NavigationLane | None = None,
    ) -> Lanes:
        """The lanes that a kind of recording and the settings call for; see `Pipeline` for the arguments."""
        jobs = jobs or InTurn()
        judging = JudgingLane(stages, appearance, timings)
        if policy is not None and (policy.navigation_anew or policy.mapping_anew):
            from alight.pipeline.mapping.recursive_mapper import RecursiveMapper

            again = FilterAgain(
                lambda number: FilterLane(rig, stages, history, frame_id=number), policy.navigation_anew
            )
            mapping = MappingAgain(lambda: RecursiveMapper(rig, stages, far, timings, history), policy.mapping_anew)
            return cls(again, mapping, judging)
        return cls(
            navigation or navigation_lane(rig, kind, stages, poses, history),
            mapping_lane(rig, stages, navigation is not None, far, timings, history, jobs, prior),
            judging,
        )


class FilterAgain:
    """The filter's lane, made anew before the exposures of these stamps; frame numbers go on."""

    def __init__(self, make: Callable[[int], FilterLane], before: Collection[int]) -> None:
        self._make, self._before, self._lane = make, frozenset(before), make(0)

    def feed(self, event: Event) -> Navigation | None:
        """As the lane; a new lane first takes the rows since the last exposure of the one before."""
        if isinstance(event, Frame) and event.t_ns in self._before:
            rows = self._lane.batcher.rest().rows
            self._lane = self._make(self._lane.next_frame)
            for row in rows:
                self._lane.feed(row)
        return self._lane.feed(event)

    def finish(self, progress: Progress) -> Trajectory:
        """Finish the present lane."""
        return self._lane.finish(progress)


class MappingAgain:
    """The recursive mapper, made anew before the exposures of these stamps."""

    def __init__(self, make: Callable[[], MappingLane], before: Collection[int]) -> None:
        self._make, self._before = make, frozenset(before)
        self._lane = make()

    def feed(self, navigation: Navigation, effort: int = 0) -> MapUpdate | None:
        """Feed the present mapper, or a new one from its first exposure on."""
        if navigation.frame.t_ns in self._before:
            self._lane = self._make()
        return self._lane.feed(navigation, effort)

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """Snapshot of the present mapper."""
        return self._lane.snapshot(about)

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """Finish the present mapper."""
        return self._lane.finish(trajectory, progress)
