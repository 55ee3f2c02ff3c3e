"""The three lanes in processes of their own, and the objects by which the flight calls them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from alight import compiled, terrain
from alight.arrays import F64
from alight.flight.live.nursery import Nursery
from alight.flight.live.worker import LaneLost, Spec, Worker
from alight.outputs import FileStore
from alight.pipeline.judging import JudgingLane, JudgingMemory, Verdict
from alight.pipeline.mapping import FinishedMap, MapSnapshot, MapUpdate
from alight.pipeline.mapping.recursive_mapper import RecursiveMapper
from alight.pipeline.navigation import FilterLane, FrameBatch, Navigation, Trajectory
from alight.pipeline.timing import Timings
from alight.records import Frame, Rig
from alight.settings import StageSettings

# -- in the processes


class NavigationProcess(FilterLane):
    """The navigation lane in its process: tracker and filter, one batch after the other."""

    def __init__(self, rig: Rig, settings: StageSettings, frame_id: int) -> None:
        super().__init__(rig, settings, history=False, frame_id=frame_id)

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Take one exposure with the rows before it; the result is returned without the pictures."""
        found = super().take(batch)
        return None if found is None else replace(found, frame=Frame(found.frame.t_ns, ()))


class MappingProcess(RecursiveMapper):
    """The mapping lane in its process: the recursive map.

    Args:
        folder: of the store for tiles that the vehicle has left behind.
    """

    def __init__(self, rig: Rig, settings: StageSettings, folder: Path) -> None:
        compiled.load_cached(parallel=True)
        super().__init__(rig, settings, FileStore(folder), Timings(), history=False)


class JudgingProcess(JudgingLane):
    """The judging lane in its process: land cover, hazards, sites."""

    def __init__(self, settings: StageSettings, appearance: terrain.Model | None, memory: JudgingMemory) -> None:
        compiled.load_cached(parallel=True)
        super().__init__(settings, appearance, Timings(), memory)

    def judge_and_remember(self, seen: MapSnapshot) -> tuple[Verdict, JudgingMemory]:
        """Judge a map; return the verdict, and the lane's memory, for a new process if this one is lost."""
        return self.judge(seen), self.memory


# -- in the flight


def _no_progress(share: float) -> None:
    """Report nothing: a call-back of the flight cannot be called from another process."""


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

    def finish(self, progress: Callable[[float], None]) -> Trajectory:
        """Return the last motion, and warnings.

        Raises:
            LaneLost: the process is gone.
        """
        assert self.post is not None
        found: Trajectory = self.post.call("finish", _no_progress)
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
        found: FinishedMap = self.post.call("finish", trajectory, _no_progress)
        return found


class RemoteJudging:
    """Caller of the judging lane; its memory of earlier maps outlives its process."""

    def __init__(self) -> None:
        self.post: Post | None = None
        self.memory = JudgingMemory()

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Judge a map, and keep the lane's memory for a new process.

        Raises:
            LaneLost: this map is not judged.
        """
        assert self.post is not None
        found, self.memory = self.post.call("judge_and_remember", seen)
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
