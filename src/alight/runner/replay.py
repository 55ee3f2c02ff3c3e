"""A run of all stages over a recording: a source in, a `RunResult` out."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from alight.jobs import InTurn, Jobs
from alight.loop_forms import compile_loops
from alight.outputs import FileStore, is_finished, prepare_folder
from alight.pipeline import Pipeline, PipelineOptions, ScheduledPolicy, TimedPoses
from alight.pipeline.navigation import NavigationLane
from alight.pipeline.timing import StageProgress, unreported, with_whole
from alight.records import Frame, Home, InputError, PhotoRow, PriorHeights, RunResult
from alight.runner.opening import open_source
from alight.runs import appearance_of, result_of, with_home, zones_of
from alight.settings import Settings
from alight.sources import Source

log = logging.getLogger(__name__)


def given_poses(source: Source, poses: str | None) -> TimedPoses | None:
    """Return the given poses: the recording's own (`truth`), or a TUM file's (ENU); None: the motion is estimated.

    Raises:
        InputError: the recording has no truth, or the file cannot be used.
    """
    if poses is None:
        return None
    if poses != "truth":
        from alight.sources.tum import read_tum

        return read_tum(Path(poses), source.local)
    if source.truth_trajectory is None:
        raise InputError(f"--poses truth: {source.name} has no state_groundtruth_estimate0; give a TUM file instead")
    return source.truth_trajectory


def replay(
    source: Source,
    settings: Settings,
    poses: str | None = None,
    progress: StageProgress = unreported,
    options: PipelineOptions | None = None,
) -> RunResult:
    """Run the pipeline over a source and return the result.

    Args:
        source, settings: the recording, and all settings.
        poses: `truth` or a TUM file of body poses in ENU, instead of the estimated motion; None: estimate the motion.
        progress: called with the stage and the share of it that is done.
        options: its tile store, workers, prior heights and zones are used; None: there are none.

    Raises:
        InputError: no part of the recording can be used.
    """
    given, options = given_poses(source, poses), options or PipelineOptions()
    if shifts := source.notes.get("timeshift_cam_imu"):
        from alight.checks.clock_offset import contradicted_shift

        if why := contradicted_shift(source.rig, source.events(), shifts[0] or 0.0):
            source.findings.warn(why)
    options = replace(
        options, poses=given, navigation=_adjustment(source, settings, options.jobs) if given is None else None,
        appearance=appearance_of(settings), imu=source.imu_noise, clock=time.perf_counter,
        policy=None if source.schedule is None else ScheduledPolicy(source.schedule), history=source.schedule is None,
    )  # fmt: skip
    progress = with_whole(progress, usual_parts(settings.motion.bundles(source.kind)))
    pipeline = Pipeline(source.rig, source.kind, settings, options)
    log.info("%s: %d exposures of %d camera(s)", source.name, source.length, len(source.rig.cameras))
    frames = 0
    for event in source.events():
        pipeline.feed(event)
        if isinstance(event, Frame):
            frames += 1
            progress("reading", frames / max(source.length, 1))
    if not frames:
        raise InputError(f"{source.name}: not one image could be read; {' '.join(source.warnings[:2])}")
    decision = pipeline.finish(progress)
    for stage, seconds in pipeline.timings.items():
        log.info("%s: %.2f s in %d step(s)", stage, sum(seconds), len(seconds))
    outcomes = {o.t_ns: o for o in decision.outcomes}
    photos = [PhotoRow(p, None if p.t_ns is None else outcomes.get(p.t_ns)) for p in source.photos]
    for row in photos:
        log.info("%s", row.line)
    return result_of(source, settings, decision, pipeline.timings, photos)


def usual_parts(bundled: bool) -> dict[str, float]:
    """Return the usual share of each stage of a run, %, in order; `bundled`: whether all poses are adjusted at the end.

    Measured on 32 photos, and on a stereo flight of 12 s.
    """
    shares = (1.0, 41.0, 52.0, 6.0) if bundled else (8.0, 9.0, 73.0, 10.0)
    return dict(zip(("reading", "motion", "heights", "judging"), shares, strict=True))


def _adjustment(source: Source, settings: Settings, jobs: Jobs | None) -> NavigationLane | None:
    if not settings.motion.bundles(source.kind):
        return None
    from alight.photos.bundle.adjust import BundleLane

    above = {p.t_ns: p.above_takeoff for p in source.photos if p.t_ns is not None and p.above_takeoff is not None}
    return BundleLane(source.rig, settings.stages(source.imu_noise).motion.bundle, jobs or InTurn(), above)


def prior_heights(source: Source, settings: Settings, dem: Path | None) -> PriorHeights | None:
    """Read the heights of a DEM from another source for the map of a recording; None: no file is given.

    Raises:
        InputError: the source or the settings do not allow a DEM, or the file cannot be used.
    """
    if dem is None:
        return None
    if not source.georeferenced:
        raise InputError(f"--prior-dem: {source.name} has no place on Earth; run it without")
    if settings.parallax.method == "recursive":
        raise InputError("--prior-dem: is for maps made at the end; run it without, or with parallax.method=batch")
    from alight.sources.prior_dem import read_prior

    return read_prior(dem, source.local)


def settings_for(source: Source, given: Settings) -> Settings:
    """Return the flight's settings if the source is a recorded flight and `given` has no key set, else `given`.

    A key that is set to its default is treated as given.
    """
    return given if source.flown_with is None or given.model_fields_set else source.flown_with


@dataclass(frozen=True)
class Find:
    """Options of one run over a recording."""

    settings: Settings
    poses: str | None = None  # see `replay`
    overwrite: bool = False  # whether to write into a folder that holds other files
    resume: bool = False  # whether to continue from the saved work of an interrupted run of photos
    prior: Path | None = None  # DEM from another source
    scheduler: str | None = None  # address of a Dask cluster that does the work of photos
    home: Home | None = None  # home of the vehicle that will fly the route
    places: Path | None = None  # file with the positions of photos
    geoid: Path | None = None  # grid of geoid heights, for altitudes of photos above sea level
    topics: Mapping[str, str] = field(default_factory=dict)  # topics of a ROS bag by role
    zones: Path | None = None  # file of zones


def find(path: Path, out: Path, how: Find, progress: StageProgress = unreported) -> RunResult:
    """Find landing sites in a flight log, a recording or photos; write the results to `out`, which is checked first.

    Unless settings are given, a recording is replayed with its flight's settings, and gives bit-identical results.
    The work of photos is saved in the folder piece by piece until the results are written.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written.
    """
    source = open_source(path, how.settings, places=how.places, geoid=how.geoid, topics=how.topics)
    settings = settings_for(source, how.settings)
    if how.geoid is not None and how.home is None and source.kind != "photos":
        raise InputError(f"--geoid {how.geoid}: is for --home and for photos; give the home as well")
    digest = source.digest()
    if not digest and (option := "--resume" if how.resume else how.scheduler and "--scheduler"):
        raise InputError(f"{option}: is for folders of photos, and {source.name} is none; run without it")
    if how.resume and is_finished(out):
        raise InputError(f"--resume: {out} holds a finished run; run without it to begin anew")
    given_poses(source, how.poses)  # wrong ones are reported before any work
    if how.home is not None and not source.georeferenced:
        raise InputError(f"--home: {source.name} has no place on Earth; run it without")
    options = PipelineOptions(
        prior=prior_heights(source, settings, how.prior), zones=zones_of(source, settings, how.zones)
    )
    given = [Path(how.poses)] if how.poses and how.poses != "truth" else []
    given += [file for file in (how.prior, how.places, how.geoid, how.zones) if file is not None and file.is_file()]
    prepare_folder(out, how.overwrite, [*given, *([path] if path.is_file() else [])])
    compile_loops(source.kind, progress=progress)
    with closing(FileStore(out)) as tile_store:
        options = replace(options, tile_store=tile_store)
        if not digest:
            return with_home(replay(source, settings, how.poses, progress, options), how.home)
        from alight.cluster import open_jobs
        from alight.photos.work import SavedJobs, WorkFolder, work_key

        with open_jobs(how.scheduler) as jobs:
            work = WorkFolder(out, work_key(source, digest, settings, *given), how.resume)
            try:
                options = replace(options, jobs=SavedJobs(jobs, work))
                return with_home(replay(source, settings, how.poses, progress, options), how.home)
            except KeyboardInterrupt:
                log.warning("%d pieces of work are kept in %s: the same with --resume goes on", len(work), out)
                raise
