"""Result of a recording: the landing decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from alight.pipeline.judging import Verdict, reserve_notes
from alight.pipeline.lanes import Judge
from alight.pipeline.mapping import FinishedMap
from alight.pipeline.navigation import Trajectory
from alight.records import ElevationMap, HazardMap, Motion, PhotoOutcome, Route, Sites, TerrainMap


@dataclass(frozen=True, eq=False)
class Decision:
    """All results of a recording, in the world."""

    sites: Sites
    motions: list[Motion]
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    height_above_ground: float | None = None  # metres
    warnings: list[str] = field(default_factory=list)
    notes: Mapping[str, object] = field(default_factory=dict)
    photos: tuple[PhotoOutcome, ...] = ()

    @classmethod
    def none(cls, trajectory: Trajectory, reason: str, *warnings: str, judge: Judge | None = None) -> Decision:
        """Decision without a site, with the reason, and the warnings of a judge and its sites in reserve."""
        said, notes = [*trajectory.warnings, *warnings], dict(trajectory.notes)
        if judge is not None:
            said, notes = [*said, *judge.warnings], notes | reserve_notes(judge.reserve.sites)
        return cls(Sites((), reason), list(trajectory.motions), warnings=said, notes=notes, photos=trajectory.photos)

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        found: FinishedMap,
        verdict: Verdict,
        route: Route | None,
        judge: Judge,
    ) -> Decision:
        """The verdict on the finished map, in the world, and the way to the best site."""
        warnings = [*trajectory.warnings, *found.warnings, *judge.warnings, *verdict.warnings]
        above = None if found.snapshot is None else found.snapshot.vehicle.height_above_ground
        return cls(
            verdict.sites, list(trajectory.motions), verdict.elevation, verdict.land_cover, verdict.hazards, route,
            above, warnings, {**trajectory.notes, **found.notes, **judge.notes(verdict)}, trajectory.photos,
        )  # fmt: skip
