"""Base class of all sources, and the record of data that a source could not read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, Literal, Protocol

from alight.arrays import I64
from alight.geometry import LocalFrame, Pose
from alight.records import NO_ZONES, Event, PhotoFacts, Rig, Schedule, ZonesOnPlane
from alight.settings import ImuNoise, Settings

LARGEST = {  # larger values mean other units, typing errors or damage
    "height": 100_000.0, "position_world": 200_000.0, "height_world": 200_000.0, "lever arm": 1_000.0,  # m
    "velocity_world": 3_000.0, "angular_velocity_body": 200.0, "specific_force_body": 5_000.0,  # m/s, rad/s, m/s^2
}  # fmt: skip
SIGMAS = (1e-6, 1e6)  # in any unit; a smaller sigma makes a matrix singular, a larger one carries no information
Trajectory = tuple[I64, list[Pose]]  # (N,) ns and N poses world_from_body


class Findings:
    """Record of what a source could not read; the losses of a group become one sentence."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.contradictions: set[str] = set()  # sentences on data that contradict each other
        self._sentences: dict[str, None] = {}
        self._totals: dict[str, int] = {}
        self._lost: dict[str, dict[str, str]] = {}

    def warn(self, sentence: str) -> None:
        """Record a warning, one whole sentence; a repeated sentence is recorded once."""
        self._sentences[sentence] = None

    def contradict(self, sentence: str) -> None:
        """Record a warning that data contradict each other."""
        self.warn(sentence)
        self.contradictions.add(sentence)

    def expect(self, group: str, total: int) -> None:
        """Record the number of items in a group ("cam0 images"), including lost items."""
        self._totals[group] = self.counts[group] = total

    def lose(self, group: str, item: str, why: str) -> None:
        """Record that a named item of a group could not be used; a repeated item is counted once."""
        self._lost.setdefault(group, {}).setdefault(item, why)
        self.counts[f"{group} left out"] = len(self._lost[group])

    def loss(self, group: str) -> str:
        """Return the number of unusable items in a group, and the first with its reason, in words; empty if none."""
        if not (lost := self._lost.get(group)):
            return ""
        first, why = next(iter(lost.items()))
        of = f" of {self._totals[group]}" if group in self._totals else ""
        return f"{group}: {len(lost)}{of} left out (first: {first}: {why})"

    @property
    def warnings(self) -> list[str]:
        """All sentences, with losses first."""
        return [*(self.loss(g) for g in self._lost), *self._sentences]


class Described(Protocol):
    """Properties of a source that a result needs; see `Source`."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> Literal["flight", "photos"]: ...
    @property
    def rig(self) -> Rig: ...
    @property
    def local(self) -> LocalFrame: ...
    @property
    def georeferenced(self) -> bool: ...
    @property
    def counts(self) -> dict[str, int]: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def notes(self) -> dict[str, Any]: ...


class Source(ABC):
    """One recording: its cameras, the origin of its world, and its events in order of time."""

    name: str  # readable name, usually the folder's
    kind: Literal["flight", "photos"] = "flight"  # a flight is continuous in time; photos are taken far apart
    local: LocalFrame  # the world's origin on Earth; meaningless unless `georeferenced`
    georeferenced: bool  # whether the recording has a position on Earth
    rig: Rig  # the cameras, in the order of `Frame.images`
    length: int = 0  # exposures that `events` will try to yield
    imu_noise: ImuNoise = ImuNoise()  # as given by the recording
    truth_trajectory: Trajectory | None = None  # true body poses in the world; None: unknown
    schedule: Schedule | None = None  # exposures that each lane used, if a live run was recorded
    flown_with: Settings | None = None  # settings, if a live run was recorded
    zones: ZonesOnPlane = NO_ZONES  # zones in the world, if a live run was recorded with any

    def __init__(self) -> None:
        self.findings = Findings()
        self.notes: dict[str, Any] = {}  # for the report: camera, focal length and its source, kind of GPS

    @abstractmethod
    def events(self) -> Iterator[Event]:
        """Yield frames, navigation and inertial samples in order of time; images are decoded one at a time.

        Every call starts from the beginning. A navigation sample comes before the frame of the same time.
        """

    @property
    def photos(self) -> Sequence[PhotoFacts]:
        """Facts about each photo of a set of photos; complete once `events` has been exhausted."""
        return ()

    def digest(self) -> str:
        """Return a digest of all input of a set of photos, used as the key of saved work; empty for flights."""
        return ""

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of read items, lost items and exposures; complete once `events` has been exhausted."""
        return {**self.findings.counts, "exposures": self.length}

    @property
    def warnings(self) -> list[str]:
        """What could not be read, with reasons, one sentence each; complete once `events` has been exhausted."""
        return self.findings.warnings
