"""The three lanes in processes of their own, and the objects by which the flight calls them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from alight import compiled, terrain
from alight.arrays import F64
from alight.flight.live.nursery import Nursery
from alight.flight.live.worker import LaneLost, Spec, Worker
from alight.landing.reserve import Reserve
from alight.outputs import FileStore
from alight.pipeline.judging import JudgingLane, JudgingMemory, Verdict
from alight.pipeline.mapping import FinishedMap, MapSnapshot, MapUpdate
from alight.pipeline.mapping.recursive import RecursiveMapper
from alight.pipeline.navigation import FilterLane, FrameBatch, Navigation, Trajectory
from alight.pipeline.timing import Clock, Timings
from alight.records import Event, Frame, Rig
from alight.settings import StageSettings

Stages = Mapping[str, Sequence[float]]  # seconds of every step, by stage


# -- in the processes


class NavigationProcess:
    """The navigation lane in its process: tracker and filter, one batch after the other."""

    def __init__(self, rig: Rig, settings: StageSettings, frame_id: int) -> None:
        self._lane = FilterLane(rig, settings, history=False, frame_id=frame_id)

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Take one exposure with the rows before it; the result is returned without the pictures."""
        self._lane.hear(batch)
        tracked = self._lane.track(batch)
        found = None if tracked is None else self._lane.update(tracked)
        return None if found is None else replace(found, frame=Frame(found.frame.t_ns, ()))

    def finish(self) -> Trajectory:
        """Return the last motion, and warnings."""
        return self._lane.finish(lambda share: None)


class MappingProcess:
    """The mapping lane in its process: the recursive map.

    Args:
        clock: seconds.
        folder: of the store for tiles that the vehicle has left behind.
    """

    def __init__(self, rig: Rig, settings: StageSettings, clock: Clock, folder: Path) -> None:
        compiled.load_cached(parallel=True)
        self._timings = Timings(clock, history=False)
        self._lane = RecursiveMapper(rig, settings, FileStore(folder), self._timings, history=False)

    def feed(self, navigation: Navigation, effort: int) -> MapUpdate | None:
        """Take an exposure with its motion into the map, with an effort: 0 all of it, higher numbers less."""
        return self._lane.feed(navigation, effort)

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """The map under the newest keyframe, and about a place, (2,) metres in the map's frame."""
        return self._lane.snapshot(about)

    def finish(self, trajectory: Trajectory) -> FinishedMap:
        """The map of the whole flight."""
        return self._lane.finish(trajectory, lambda share: None)

    def timings(self) -> Stages:
        """Seconds of the last steps, by stage."""
        return self._timings.stages


class JudgingProcess:
    """The judging lane in its process: land cover, hazards, sites."""

    def __init__(
        self, settings: StageSettings, clock: Clock, appearance: terrain.Model | None, memory: JudgingMemory
    ) -> None:
        compiled.load_cached(parallel=True)
        self._timings = Timings(clock, history=False)
        self._lane = JudgingLane(settings, appearance, self._timings, memory)

    def judge(self, seen: MapSnapshot) -> tuple[Verdict, JudgingMemory]:
        """Judge a map; return the verdict, and the lane's memory, for a new process if this one is lost."""
        return self._lane.judge(seen), self._lane.memory

    def notes(self, found: Verdict) -> dict[str, object]:
        """As `JudgingLane.notes`."""
        return self._lane.notes(found)

    def timings(self) -> Stages:
        """Seconds of the last steps, by stage."""
        return self._timings.stages


# -- in the flight


@dataclass
class Post:
    """A lane's place: when its process is lost, another one takes it.

    Args:
        patience: s without an answer after which the process is lost.
        lost: called with the lane and the reason each time.
    """

    nursery: Nursery
    make: Callable[[], Spec]
    patience: float
    lost: Callable[[str, str], None]

    def __post_init__(self) -> None:
        self.worker = Worker(self.nursery, self.make())
        self.compiled: set[str] = set()
        self.given_up = ""  # the reason why there will be no other process

    def call(self, method: str, *given: Any) -> Any:
        """Call the lane.

        Raises:
            LaneLost: it raised, died or did not answer; the next call goes to a new process.
        """
        if self.given_up:
            raise LaneLost(self.given_up)
        made = False
        try:
            self.worker.wait_until_ready()
            made = True
            return self.worker.call(method, *given, timeout=self.patience)
        except LaneLost as e:
            if not self.given_up:
                self.given_up = "" if made else f"it cannot be started: {e}"
                self.lost(self.worker.name, str(e))
            if not self.given_up:
                self.worker = Worker(self.nursery, self.make())
            raise
        finally:
            self.compiled |= set(self.worker.compiled)

    def close(self) -> None:
        """End the process; a thread that waits for it gets `LaneLost`."""
        self.given_up = self.given_up or "the flight is over"
        with suppress(OSError):
            self.worker.close()


class RemoteNavigation:
    """Caller of the navigation lane; frame numbers continue when its process is replaced."""

    def __init__(self) -> None:
        self.post: Post | None = None
        self.next_frame = 0

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Take one exposure with the rows before it.

        Raises:
            LaneLost: the exposure is lost, and the motion begins anew with the next one.
        """
        assert self.post is not None
        found: Navigation | None = self.post.call("take", batch)
        if found is None:
            return None
        assert batch.frame is not None
        if found.motion is not None:
            self.next_frame = max(self.next_frame, found.motion.frame_id + 1)
        return replace(found, frame=batch.frame)

    def feed(self, event: Event) -> Navigation | None:
        """Not used in flight, where exposures come in batches."""
        raise NotImplementedError("a flight feeds batches")

    def finish(self, progress: Callable[[float], None]) -> Trajectory:
        """Return the last motion, and warnings.

        Raises:
            LaneLost: the process is gone.
        """
        assert self.post is not None
        found: Trajectory = self.post.call("finish")
        return found


class RemoteMapping:
    """Caller of the mapping lane: each call goes to its process."""

    def __init__(self, post: Post) -> None:
        self.post = post

    def feed(self, navigation: Navigation, effort: int = 0) -> MapUpdate | None:
        """Take an exposure with its motion into the map, with an effort: 0 all of it, higher numbers less.

        Raises:
            LaneLost: the map is gone; the next exposure begins another one.
        """
        found: MapUpdate | None = self.post.call("feed", navigation, effort)
        return found

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """Return the map under the newest keyframe.

        Args:
            about: (2,) metres in the map's frame, a place that it must show as well.

        Raises:
            LaneLost: the map is gone.
        """
        found: MapSnapshot | None = self.post.call("snapshot", about)
        return found

    def finish(self, trajectory: Trajectory, progress: Callable[[float], None]) -> FinishedMap:
        """Return the map of the whole flight.

        Raises:
            LaneLost: the map is gone.
        """
        found: FinishedMap = self.post.call("finish", trajectory)
        return found


class RemoteJudging:
    """Caller of the judging lane; its memory of earlier maps outlives its process."""

    def __init__(self) -> None:
        self.post: Post | None = None
        self.memory = JudgingMemory()

    @property
    def reserve(self) -> Reserve:
        """The sites of all maps judged so far, and those that the newest one gave up, with the reason."""
        return self.memory.reserve

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sites that were kept or lost where the motion began anew, in words."""
        return self.memory.warnings

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Judge a map, and keep the lane's memory for a new process.

        Raises:
            LaneLost: this map is not judged.
        """
        assert self.post is not None
        found, self.memory = self.post.call("judge", seen)
        verdict: Verdict = found
        return verdict

    def notes(self, found: Verdict) -> dict[str, object]:
        """As `JudgingLane.notes`.

        Raises:
            LaneLost: the process is gone.
        """
        assert self.post is not None
        notes: dict[str, object] = self.post.call("notes", found)
        return notes
