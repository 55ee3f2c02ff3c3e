"""The end of a run: the landing decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from alight.landing.route import plan_route
from alight.pipeline.judging import Verdict, reserve_notes
from alight.pipeline.lanes import Judge
from alight.pipeline.mapping import FinishedMap, MappingLane, MapSnapshot
from alight.pipeline.navigation import MotionSource, Trajectory
from alight.pipeline.timing import Tell, Timings
from alight.records import ElevationMap, HazardMap, Motion, PhotoOutcome, Route, Sites, TerrainMap
from alight.settings import RouteSettings, StageSettings


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
            said, notes = [*said, *judge.memory.warnings], notes | reserve_notes(judge.memory.reserve.sites)
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
        warnings = [*trajectory.warnings, *found.warnings, *judge.memory.warnings, *verdict.warnings]
        above = None if found.snapshot is None else found.snapshot.vehicle.height_above_ground
        return cls(
            verdict.sites, list(trajectory.motions), verdict.elevation, verdict.land_cover, verdict.hazards, route,
            above, warnings, {**trajectory.notes, **found.notes, **judge.notes(verdict)}, trajectory.photos,
        )  # fmt: skip


def conclude(
    navigation: MotionSource, mapping: MappingLane, judging: Judge, settings: StageSettings, timings: Timings,
    tell: Tell = lambda stage, share: None,
) -> Decision:  # fmt: skip
    """Refine the motion, build the map, judge it and choose; all results are in the world."""
    with timings.of("motion, all frames together"):
        trajectory = navigation.finish(lambda f: tell("motion", f))
    if not trajectory.usable:
        return Decision.none(trajectory, trajectory.reason)
    found = mapping.finish(trajectory, lambda f: tell("heights", f))
    if found.snapshot is None:
        return Decision.none(trajectory, found.reason, *found.warnings, judge=judging)
    tell("judging", 0.2)
    verdict = judging.judge(found.snapshot).in_world()
    way = _route(verdict.sites, found.snapshot, settings.route)
    tell("judging", 1.0)
    return Decision.of(trajectory, found, verdict, way, judging)


def _route(sites: Sites, seen: MapSnapshot, settings: RouteSettings) -> Route | None:
    """The way to the best of the sites, planned in the world."""
    if not sites.sites:
        return None
    vehicle, elevation = seen.frame.point(seen.vehicle.position), seen.frame.elevation(seen.elevation)
    way = plan_route(sites.sites[0], elevation, vehicle, settings)
    return replace(way, frame_id=seen.frame.frame_id)
