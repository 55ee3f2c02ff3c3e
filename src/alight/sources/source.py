"""Interface of every source, and its record of data that could not be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from alight.geometry import LocalFrame, Pose
from alight.records import Event, PhotoFacts, Rig, Schedule
from alight.settings import ImuNoise, Settings

FAR = 200_000.0  # m; an aircraft's local frame ends long before: beyond it the numbers are of another system
Trajectory = tuple[NDArray[np.int64], list[Pose]]  # (N,) ns and as many world_from_body


class Described(Protocol):
    """Description of a source in results: its name, its place on Earth, the counts of read and lost items."""

    @property
    def name(self) -> str:
        """Name for a reader: the folder's name."""

    @property
    def kind(self) -> Literal["flight", "photos"]:
        """Kind: a flight is continuous in time, photos are single exposures far apart."""

    @property
    def local(self) -> LocalFrame:
        """The world's origin on Earth; meaningless unless `georeferenced`."""

    @property
    def georeferenced(self) -> bool:
        """False where the recording has no place on Earth."""

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of read and lost items; complete once `events` has been exhausted."""

    @property
    def warnings(self) -> list[str]:
        """Items that could not be read, with reasons, one sentence each; complete once `events` has been exhausted."""

    @property
    def notes(self) -> dict[str, Any]:
        """Facts for the report: camera, focal length and its source, kind of GPS."""


class Source(Described, Protocol):
    """One recording: its cameras, the origin of its world, and its events in order of time."""

    @property
    def rig(self) -> Rig:
        """The cameras, in the order of `Frame.images`."""

    @property
    def photos(self) -> Sequence[PhotoFacts]:
        """Facts about each photo of a set of photos; complete once `events` has been exhausted."""

    @property
    def truth_trajectory(self) -> Trajectory | None:
        """True body poses in the world; None: the recording has none."""

    @property
    def imu_noise(self) -> ImuNoise:
        """Noise that the recording states for its IMU."""

    @property
    def schedule(self) -> Schedule | None:
        """Exposures that each lane used, of a live run that was recorded; None: it is no such recording."""

    @property
    def flown_with(self) -> Settings | None:
        """Settings of a live run that was recorded; None: it is no such recording."""

    @property
    def length(self) -> int:
        """Exposures that `events` will try to yield."""

    def digest(self) -> str:
        """Digest of all input, as the key of saved work (photos); else empty."""

    def events(self) -> Iterator[Event]:
        """Yield frames, navigation and inertial samples in order of time, images decoded one at a time.

        Every call starts from the beginning. A navigation sample comes before the frame of the same time.
        """


class Findings:
    """Record of items that a source could not read: losses are gathered into one sentence a group."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._sentences: dict[str, None] = {}
        self._totals: dict[str, int] = {}
        self._lost: dict[str, dict[str, str]] = {}

    def say(self, sentence: str) -> None:
        """Note one whole sentence, once."""
        self._sentences[sentence] = None

    def expect(self, group: str, total: int) -> None:
        """Note the number of items of a group ("cam0 images"), lost ones included."""
        self._totals[group] = self.counts[group] = total

    def lose(self, group: str, item: str, why: str) -> None:
        """Note that one named item of a group could not be used; the same item twice counts once."""
        self._lost.setdefault(group, {}).setdefault(item, why)
        self.counts[f"{group} left out"] = len(self._lost[group])

    def loss(self, group: str) -> str:
        """Number of items of a group that could not be used, and the first with its reason; empty: none."""
        lost, total = self._lost.get(group, {}), self._totals.get(group)
        if not lost:
            return ""
        first, why = next(iter(lost.items()))
        of = f" of {total}" if total is not None else ""
        return f"{group}: {len(lost)}{of} left out (first: {first}: {why})"

    @property
    def warnings(self) -> list[str]:
        """All sentences, losses first."""
        return [*(self.loss(g) for g in self._lost), *self._sentences]


class RecordedSource:
    """Common part of all sources: counts and warnings from `_findings`, and defaults."""

    _findings: Findings
    length: int
    schedule: Schedule | None = None
    flown_with: Settings | None = None

    @property
    def photos(self) -> Sequence[PhotoFacts]:
        """Empty: the source is no set of photos."""
        return ()

    def digest(self) -> str:
        """Empty: no work is saved."""
        return ""

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of read and lost items, and of exposures."""
        return {**self._findings.counts, "exposures": self.length}

    @property
    def warnings(self) -> list[str]:
        """Items that could not be read, with reasons, one sentence each."""
        return self._findings.warnings
