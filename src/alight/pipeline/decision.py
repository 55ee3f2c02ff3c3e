"""The end of a run: the landing decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

from alight.landing.route import plan_route
from alight.pipeline.judging import JudgingLane, reserve_notes
from alight.pipeline.mapping import MappingLane, MapSnapshot
from alight.pipeline.navigation import NavigationLane
from alight.pipeline.timing import StageProgress, Timings
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


def unreported(stage: str, share: float) -> None:
    """Report no progress. Another process can import this function, and call it."""


def conclude(
    navigation: NavigationLane, mapping: MappingLane, judging: JudgingLane, settings: StageSettings, timings: Timings,
    progress: StageProgress = unreported,
) -> Decision:  # fmt: skip
    """Refine the motion, build the map, judge it and choose; all results are in the world."""
    with timings.of("motion, all frames together"):
        trajectory = navigation.finish(partial(progress, "motion"))
    motions, warnings, photos = list(trajectory.motions), list(trajectory.warnings), trajectory.photos
    if not trajectory.usable:
        sites = Sites((), trajectory.reason)
        return Decision(sites, motions, warnings=warnings, notes=trajectory.notes, photos=photos)
    found = mapping.finish(trajectory, partial(progress, "heights"))
    warnings += found.warnings
    if found.snapshot is None:
        notes = {**trajectory.notes, **reserve_notes(judging.memory.reserve.sites)}
        warnings += judging.memory.warnings
        return Decision(Sites((), found.reason), motions, warnings=warnings, notes=notes, photos=photos)
    progress("judging", 0.2)
    seen = found.snapshot
    if trajectory.distrust:
        seen = replace(seen, elevation=seen.elevation.refused())
    verdict = judging.judge(seen).in_world()
    sites = replace(verdict.sites, reason=trajectory.distrust or verdict.sites.reason)
    route = _route(sites, seen, settings.route)
    progress("judging", 1.0)
    return Decision(
        sites, motions, verdict.elevation, verdict.land_cover, verdict.hazards, route,
        seen.vehicle.height_above_ground, [*warnings, *judging.memory.warnings, *verdict.warnings],
        {**trajectory.notes, **found.notes, **judging.notes(verdict)}, photos,
    )  # fmt: skip


def _route(sites: Sites, seen: MapSnapshot, settings: RouteSettings) -> Route | None:
    """The way to the best of the sites, planned in the world."""
    if not sites.sites:
        return None
    vehicle, elevation = seen.frame.point(seen.vehicle.position), seen.frame.elevation(seen.elevation)
    way = plan_route(sites.sites[0], elevation, vehicle, settings)
    return replace(way, frame_id=seen.frame.frame_id)
