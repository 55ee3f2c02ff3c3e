"""Options of a run, and the lanes that they and the settings call for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from alight import terrain
from alight.elevation import TileStore
from alight.jobs import InTurn, Jobs
from alight.pipeline.judging import Verdict
from alight.pipeline.mapping import MappingLane
from alight.pipeline.navigation import NavigationLane, TimedPoses
from alight.pipeline.policy import FlightPolicy
from alight.pipeline.timing import Clock, Timings
from alight.records import PriorHeights, Rig, SettingsError
from alight.settings import ImuNoise, StageSettings


@dataclass(frozen=True, eq=False)
class PipelineOptions:
    """Options of a run; none is needed."""

    poses: TimedPoses | None = None  # body poses that replace the estimated ones, for evaluation
    navigation: NavigationLane | None = None  # used instead of the usual lane
    appearance: terrain.Model | None = None  # None: land cover from the map's own evidence alone
    imu: ImuNoise | None = None  # noise of the recording's IMU
    prior: PriorHeights | None = None  # heights from elsewhere, with which the search at the end begins
    policy: FlightPolicy | None = None  # None: one by `sites.every`
    on_verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None  # with the stamp of its newest exposure
    clock: Clock = lambda: 0.0  # seconds, for the time of the stages; the core has no clock of its own
    tile_store: TileStore | None = None  # of the tiles that the vehicle has left behind; None: memory
    jobs: Jobs | None = None  # workers for photos and tiles; None: this process
    history: bool = True  # keep the data for `finish`; without it a flight may last for ever


def navigation_lane(
    rig: Rig, kind: Literal["flight", "photos"], settings: StageSettings, options: PipelineOptions
) -> NavigationLane:
    """Choose the way to find the motion.

    Raises:
        SettingsError: the settings choose bundle adjustment, whose lane is the caller's.
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
    """Choose the way to map; `at_end`: all motions come at the end of the recording."""
    if not at_end and (settings.parallax.method == "recursive" or not options.history):  # no end, no batch
        from alight.pipeline.mapping.recursive_mapper import RecursiveMapper

        anew = options.policy.mapping_anew if options.policy is not None else ()
        return RecursiveMapper(rig, settings, options.tile_store, timings, options.history, anew)
    from alight.pipeline.mapping.batch_mapper import BatchMapper, PhotoMapper

    mapper = PhotoMapper if at_end else BatchMapper
    return mapper(rig, settings, options.tile_store, timings, options.jobs or InTurn(), options.prior)
