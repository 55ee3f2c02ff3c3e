"""All results of one run: the results from the recording, and facts about the recording and the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from alight.geometry import Camera, LocalFrame
from alight.records.evidence import MapEvidence
from alight.records.landing import HazardMap, Route, Sites
from alight.records.motion import Motion
from alight.records.photos import PhotoOutcome, PhotoRow
from alight.records.surface import ElevationMap, TerrainMap
from alight.records.telemetry import Home
from alight.records.zones import NO_ZONES, GroundZone, ZonesOnPlane
from alight.settings import Settings

if TYPE_CHECKING:
    from alight.records.executive import FlightDiary


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """All results from a recording, in the world frame; a result that could not be computed is None or empty."""

    sites: Sites
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    zones: ZonesOnPlane = NO_ZONES  # zones of the user
    others: Sequence[GroundZone] = ()  # roads, cars, people and buildings that the map shows
    motions: Sequence[Motion] = ()
    height_above_ground: float | None = None  # metres, median over the exposures
    notes: Mapping[str, object] = field(default_factory=dict)  # facts by name: "focal": "held", "points": 19472
    warnings: Sequence[str] = ()
    evidence: MapEvidence | None = None  # of the judgement, to judge another lander; None: nothing was judged
    outcomes: Sequence[PhotoOutcome] = ()  # agreement of the pictures with each photo's tags


@dataclass(frozen=True, eq=False, kw_only=True)
class RunResult(Decision):
    """All results of one run: the content of the output folder and the report.

    A result that a run could not compute is None or empty; `not_written` gives the reasons by file name.
    """

    source_name: str  # display name of the folder or file
    source_kind: str  # "flight", "photos" or, for `alight hazards`, "heights"
    local: LocalFrame
    georeferenced: bool  # False: `local` is a placeholder and the world has no absolute position
    settings: Settings
    cameras: Sequence[Camera] = ()  # of the rig, or of the set of photos
    home: Home | None = None  # home of the vehicle that will fly the route
    diary: FlightDiary | None = None  # diary of a landing that was flown
    counts: Mapping[str, int] = field(default_factory=dict)  # "frames read": 32, "frames dropped, cut off": 1
    photos: Sequence[PhotoRow] = ()  # all photos of a set, used or not
    timings: Mapping[str, Sequence[float]] = field(default_factory=dict)  # durations of all steps, seconds, by stage
    not_written: Mapping[str, str] = field(default_factory=dict)  # reason by file name

    @property
    def terrain_as_mapped(self) -> TerrainMap | None:
        """Land cover on the grid of the elevation, which files and pictures share."""
        if self.terrain is None or self.elevation is None:
            return self.terrain
        return self.terrain.on(self.elevation.grid)

    @property
    def hazards_as_mapped(self) -> HazardMap | None:
        """Hazards on the grid of the elevation, which files and pictures share."""
        if self.hazards is None or self.elevation is None:
            return self.hazards
        return self.hazards.on(self.elevation.grid)
