"""What a recording says about landing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from alight.pipeline.judging import Verdict
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Trajectory
from alight.records import ElevationMap, HazardMap, Motion, Route, Sites, TerrainMap


@dataclass(frozen=True, eq=False)
class Decision:
    """Everything that was found out, in the world."""

    sites: Sites
    motions: list[Motion]
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    height_above_ground: float | None = None  # metres
    warnings: list[str] = field(default_factory=list)
    notes: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def none(cls, trajectory: Trajectory, reason: str, *warnings: str) -> Decision:
        """No site, and why."""
        said = [*trajectory.warnings, *warnings]
        return cls(Sites((), reason), list(trajectory.motions), warnings=said, notes=trajectory.notes)

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        seen: MapSnapshot,
        verdict: Verdict,
        route: Route | None,
        warnings: tuple[str, ...],
        notes: Mapping[str, object],
    ) -> Decision:
        """The verdict on the finished map, and the way to the best site."""
        return cls(
            verdict.sites, list(trajectory.motions), verdict.elevation, verdict.cover, verdict.danger, route,
            seen.vehicle.height_above_ground, [*trajectory.warnings, *warnings, *verdict.warnings],
            {**trajectory.notes, **notes},
        )  # fmt: skip
