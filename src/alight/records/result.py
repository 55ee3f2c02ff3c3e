"""All results of one run: the decision on what was recorded, and the facts about the recording and the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from alight.geometry import LocalFrame
from alight.records.landing import HazardMap, Route, Sites
from alight.records.motion import Motion
from alight.records.photos import PhotoOutcome, PhotoRow
from alight.records.surface import ElevationMap, TerrainMap
from alight.records.telemetry import Home
from alight.settings import Settings

if TYPE_CHECKING:
    from alight.records.executive import FlightDiary


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """All results of a recording, in the world; one that could not be made is None or empty."""

    sites: Sites
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    motions: Sequence[Motion] = ()
    height_above_ground: float | None = None  # metres, median over the exposures
    notes: Mapping[str, object] = field(default_factory=dict)  # words, numbers, lists: "focal": "held", "points": 19472
    warnings: Sequence[str] = ()
    outcomes: Sequence[PhotoOutcome] = ()  # of the tags of each photo


@dataclass(frozen=True, eq=False, kw_only=True)
class RunResult(Decision):
    """All results of one run: the content of the output folder and the report.

    A result that a run could not make is None or empty; `not_written` has the reason, by file name.
    """

    source_name: str  # the folder or file, as a person would call it
    source_kind: str  # "flight", "photos"; of `alight hazards` "heights"
    local: LocalFrame
    georeferenced: bool  # False: `local` is a stand-in and the world has no place on Earth
    settings: Settings
    home: Home | None = None  # of the vehicle that is to fly the route
    diary: FlightDiary | None = None  # of a landing that was flown
    counts: Mapping[str, int] = field(default_factory=dict)  # "frames read": 32, "frames dropped, cut off": 1
    photos: Sequence[PhotoRow] = ()  # of a set of photos, those that were not used included
    timings: Mapping[str, Sequence[float]] = field(default_factory=dict)  # seconds of every step, by stage
    not_written: Mapping[str, str] = field(default_factory=dict)  # file name: reason

    @property
    def terrain_as_mapped(self) -> TerrainMap | None:
        """The land cover on the grid of the elevation, which files and pictures share."""
        if self.terrain is None or self.elevation is None:
            return self.terrain
        return self.terrain.on(self.elevation.grid)

    @property
    def hazards_as_mapped(self) -> HazardMap | None:
        """The hazards on the grid of the elevation, which files and pictures share."""
        if self.hazards is None or self.elevation is None:
            return self.hazards
        return self.hazards.on(self.elevation.grid)
