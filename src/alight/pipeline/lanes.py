"""Lanes of a run: their options, their choice, and the landing decision at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeVar

from alight import terrain
from alight.elevation import TileStore
from alight.jobs import InTurn, Jobs
from alight.landing.route import plan_route
from alight.landing.zones import MapZones
from alight.pipeline.judging import JudgingLane, Verdict, reserve_notes
from alight.pipeline.mapping import MappingLane
from alight.pipeline.navigation import NavigationLane, TimedPoses
from alight.pipeline.policy import FlightPolicy
from alight.pipeline.timing import Clock, StageProgress, Timings, unreported
from alight.records import NO_ZONES, Decision, MapEvidence, PriorHeights, Rig, SettingsError, Sites
from alight.settings import ImuNoise, RouteSettings, StageSettings


@dataclass(frozen=True, eq=False)
class PipelineOptions:
    """Options of a run, all with defaults."""

    poses: TimedPoses | None = None  # body poses that replace the estimated ones, for evaluation
    navigation: NavigationLane | None = None  # replaces the lane that the settings choose
    appearance: terrain.Model | None = None  # None: land cover without an appearance model
    imu: ImuNoise | None = None  # noise of the recording's IMU
    zones: MapZones | None = None  # zones of the user, in the world
    prior: PriorHeights | None = None  # external DEM that narrows the height search of the batch map
    policy: FlightPolicy | None = None  # None: `FlightPolicy` with `sites.every`
    on_verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None  # gets the time of the exposure, too
    clock: Clock = lambda: 0.0  # seconds, to time the stages; the core has no clock
    tile_store: TileStore | None = None  # store of far tiles; None: memory
    jobs: Jobs | None = None  # workers for photos and tiles; None: this process
    history: bool = True  # whether data are kept for `finish`; False: memory stays bounded


def navigation_lane(
    rig: Rig, kind: Literal["flight", "photos"], settings: StageSettings, options: PipelineOptions
) -> NavigationLane:
    """Return the navigation lane that the options or settings choose.

    Raises:
        SettingsError: the settings choose bundle adjustment, whose lane the caller must pass.
    """
    if options.navigation is not None:
        return options.navigation
    if options.poses is not None:
        from alight.pipeline.navigation.given import GivenLane

        return GivenLane(rig, options.poses, settings.motion, options.history)
    if settings.motion.bundles(kind):
        raise SettingsError("motion.method: give the lane of the bundle adjustment as `navigation`, or use filter")
    from alight.pipeline.navigation.filter_lane import FilterLane

    anew = options.policy.navigation_anew if options.policy is not None else ()
    return FilterLane(rig, settings, options.history, photos=kind == "photos", anew=anew)


def mapping_lane(
    rig: Rig, settings: StageSettings, options: PipelineOptions, timings: Timings, at_end: bool
) -> MappingLane:
    """Return the mapping lane that settings and options choose; `at_end`: whether all motions come at the end."""
    if not at_end and (settings.parallax.method == "recursive" or not options.history):  # a batch needs the end
        from alight.pipeline.mapping.recursive_map import RecursiveMapper

        anew = options.policy.mapping_anew if options.policy is not None else ()
        return RecursiveMapper(rig, settings, options.tile_store, timings, options.history, anew)
    from alight.pipeline.mapping.batch_map import BatchMapper

    return BatchMapper(rig, settings, options.tile_store, timings, options.jobs or InTurn(), options.prior)


def conclude(
    navigation: NavigationLane, mapping: MappingLane, judging: JudgingLane, settings: StageSettings, timings: Timings,
    progress: StageProgress = unreported, zones: MapZones | None = None,
) -> Decision:  # fmt: skip
    """Finish all lanes: refine the motion, build and judge the map; return the decision, in the world frame."""
    given = {} if zones is None else {"zones": zones.plane.note}
    progress("motion", 0.0)
    with timings.of("motion, all frames together"):
        trajectory = navigation.finish(partial(progress, "motion"))
    warnings = [*(zones.plane.warnings if zones else ()), *trajectory.warnings]
    moved = Decision(
        sites=Sites((), trajectory.reason), motions=trajectory.motions, notes={**given, **trajectory.notes},
        warnings=warnings, outcomes=trajectory.photos, zones=zones.plane if zones else NO_ZONES,
    )  # fmt: skip
    if not trajectory.usable:
        return moved
    progress("heights", 0.0)
    found = mapping.finish(trajectory, partial(progress, "heights"))
    warnings += found.warnings
    if found.snapshot is None:
        warnings += judging.memory.warnings
        notes = {**moved.notes, **reserve_notes(judging.memory.reserve.sites)}
        return replace(moved, sites=Sites((), found.reason), notes=notes)
    progress("judging", 0.2)
    seen = found.snapshot
    if trajectory.distrust:
        seen = replace(seen, elevation=seen.elevation.refused())
    verdict = judging.judge_at_end(seen)
    assert verdict.evidence is not None
    evidence = replace(verdict.evidence, distrust=trajectory.distrust)
    decision = replace(
        moved, evidence=evidence, height_above_ground=evidence.height_above_ground,
        notes={**moved.notes, **found.notes, **judging.notes(replace(verdict, evidence=None))},
        warnings=[*warnings, *judging.memory.warnings, *verdict.warnings],
    )  # fmt: skip
    decision = with_verdict(decision, verdict, evidence, settings.route, zones)
    progress("judging", 1.0)
    return decision


Decided = TypeVar("Decided", bound=Decision)


def with_verdict(
    decision: Decided, verdict: Verdict, evidence: MapEvidence, settings: RouteSettings, zones: MapZones | None = None
) -> Decided:
    """Return the decision with a verdict and the route to its best site, in the world frame."""
    world, frame = verdict.in_world(), evidence.frame
    sites, route = replace(world.sites, reason=evidence.distrust or world.sites.reason), None
    if sites.sites:
        vehicle, elevation = frame.point(evidence.vehicle), frame.elevation(evidence.elevation)
        route = plan_route(sites.sites[0], elevation, vehicle, settings, world.hazards.wires, zones)
        route = replace(route, frame_id=frame.frame_id)
    return replace(
        decision, sites=sites, elevation=world.elevation, terrain=world.land_cover, hazards=world.hazards, route=route,
        others=verdict.others,
    )  # fmt: skip
