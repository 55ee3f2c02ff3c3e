"""What every source offers, and the notebook in which it writes down what it could not read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from alight.geometry import LocalFrame, Pose
from alight.records import Event, PhotoFacts, Rig, Schedule
from alight.settings import ImuNoise, Settings

Trajectory = tuple[NDArray[np.int64], list[Pose]]  # (N,) ns and as many world_from_body


class Described(Protocol):
    """What results say of what they came from: its name, its place on Earth, what was read and lost."""

    @property
    def name(self) -> str:
        """What a person calls it: the folder's name."""

    @property
    def kind(self) -> Literal["flight", "photos"]:
        """A flight is continuous in time; photos are single exposures far apart."""

    @property
    def local(self) -> LocalFrame:
        """Where the world's origin lies; meaningless unless `georeferenced`."""

    @property
    def georeferenced(self) -> bool:
        """False where the log says nothing about its place on Earth."""

    @property
    def counts(self) -> dict[str, int]:
        """How much was read and lost; complete once `events` has been exhausted."""

    @property
    def warnings(self) -> list[str]:
        """What could not be read and why, one sentence each; complete once `events` has been exhausted."""

    @property
    def notes(self) -> dict[str, Any]:
        """Facts for the report: camera, focal length and where it came from, kind of GPS."""


class Source(Described, Protocol):
    """One recording: what its cameras are, where its world lies, and its events in order of time."""

    @property
    def rig(self) -> Rig:
        """The cameras, in the order of `Frame.images`."""

    @property
    def photos(self) -> Sequence[PhotoFacts]:
        """What was understood of each photo, of a set of photos; complete once `events` has been exhausted."""

    @property
    def truth_trajectory(self) -> Trajectory | None:
        """True body poses in the world, where the recording has them."""

    @property
    def imu_noise(self) -> ImuNoise:
        """Noise that the recording states for its IMU."""

    @property
    def schedule(self) -> Schedule | None:
        """Of a live run that was recorded: which exposures each lane used."""

    @property
    def flown_with(self) -> Settings | None:
        """The settings of a live run that was recorded."""

    @property
    def length(self) -> int:
        """Exposures that `events` will try to yield."""

    def digest(self) -> str:
        """Of everything that is read, where work is saved by it (photos); else empty."""

    def events(self) -> Iterator[Event]:
        """Yield frames, navigation and inertial samples in order of time, images decoded one at a time.

        Every call starts from the beginning. A navigation sample comes before the frame of the same time.
        """


class Findings:
    """What a source could not read: losses are gathered into one sentence a group, however often they are met."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._sentences: dict[str, None] = {}
        self._totals: dict[str, int] = {}
        self._lost: dict[str, dict[str, str]] = {}

    def say(self, sentence: str) -> None:
        """Note one whole sentence, once."""
        self._sentences[sentence] = None

    def expect(self, group: str, total: int) -> None:
        """Say how many items a group ("cam0 images") has, lost ones included."""
        self._totals[group] = self.counts[group] = total

    def lose(self, group: str, item: str, why: str) -> None:
        """Note that one named item of a group could not be used; the same item twice counts once."""
        self._lost.setdefault(group, {}).setdefault(item, why)
        self.counts[f"{group} left out"] = len(self._lost[group])

    def loss(self, group: str) -> str:
        """How many items of a group could not be used, and the first with its reason; empty: none."""
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
    """What both kinds of source tell of themselves, from the notebook `_findings`."""

    _findings: Findings
    length: int
    schedule: Schedule | None = None
    flown_with: Settings | None = None

    @property
    def photos(self) -> Sequence[PhotoFacts]:
        """None."""
        return ()

    def digest(self) -> str:
        """Nothing is saved."""
        return ""

    @property
    def counts(self) -> dict[str, int]:
        """How much was read and lost."""
        return {**self._findings.counts, "exposures": self.length}

    @property
    def warnings(self) -> list[str]:
        """What could not be read and why."""
        return self._findings.warnings
