"""The core: events in, a landing decision out. No file, clock or thread: replay and flight run the same code."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from alight import terrain
from alight.elevation import TileStore
from alight.geometry import Grid
from alight.landing import route
from alight.landing.reserve import Reserve
from alight.pipeline.judging import Judge, Verdict, without_water
from alight.pipeline.navigation import BundleLane, FilterLane, GivenLane, Lane, TimedPoses
from alight.pipeline.store import FIRST_STEP, FrameStore, views_of
from alight.pipeline.terrain_lane import TerrainLane, footprint, looking_down
from alight.records import (
    ElevationMap,
    Event,
    Frame,
    HazardMap,
    KeyframePosterior,
    Motion,
    MotionState,
    Rig,
    Route,
    Sites,
    TerrainMap,
    View,
)
from alight.settings import Settings

log = logging.getLogger(__name__)

__all__ = ["Decision", "Pipeline", "TimedPoses", "Verdict", "without_water"]

Tell = Callable[[str, float], None]  # stage, share done
LAST_STEPS = 1000  # whose times are kept in flight
FIND_EVERY = 8  # keyframes: how often the ground is looked for until it is found
FIND_BASELINE = 0.08  # of the height, that it takes in flight: at 97 m 4 m found a ground that was 36 m too high
KEPT_BY_RING = 16  # keyframes that find the ground: the ring's own, and a few
KEPT_TO_LOOK = 64  # keyframes whose pixels stay, to look at the ground more finely than at its heights


@dataclass(frozen=True, eq=False)
class Decision:
    """What a recording says about landing."""

    sites: Sites
    motions: list[Motion]
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    height_above_ground: float | None = None  # metres
    warnings: list[str] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)


class Pipeline:
    """Feed it the events of a recording in order of time, then `finish`.

    Args:
        rig: the cameras.
        kind: `flight` (continuous, filter) or `photos` (far apart, bundle adjustment); the settings may say otherwise.
        poses: body poses that replace the estimated ones, for evaluation.
        clock: seconds, for the time of the stages; the core has none of its own.
        far: where the map puts what the vehicle has left behind: a file's mapping, `NullStore`, or by default memory.
        history: keep what `finish` needs of a recording. Without it a flight may last for ever: the motions are
            those that were given out in flight, and none older than the keyframes that are held.
        appearance: what ground looks like; None: the map's own evidence alone says what covers it.
    """

    def __init__(
        self,
        rig: Rig,
        kind: Literal["flight", "photos"],
        settings: Settings,
        poses: TimedPoses | None = None,
        clock: Callable[[], float] = lambda: 0.0,
        far: TileStore | None = None,
        history: bool = True,
        appearance: terrain.Model | None = None,
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._history = history
        self._navigation = _lane(rig, kind, settings, poses, history)
        self._everything = isinstance(self._navigation, BundleLane)
        self._recursive = settings.parallax.method == "ring" and not self._everything
        self._terrain = TerrainLane(settings, far)
        self._judging = Judge(settings, appearance, self._timed)
        self._store, self._first_step = FrameStore(), FIRST_STEP
        self._motions: dict[int, Motion] = {}
        self._since_judged = 0  # keyframes
        self.timings: dict[str, deque[float]] = {}  # seconds of every step, by stage; in flight the last ones

    def _timed(self, stage: str, since: float) -> float:
        now = self._clock()
        self.timings.setdefault(stage, deque(maxlen=None if self._history else LAST_STEPS)).append(now - since)
        return now

    def feed(self, event: Event) -> Motion | None:
        """Take one event; an exposure gives its motion when that is known at once."""
        start = self._clock()
        motion = self._navigation.feed(event)
        if isinstance(event, Frame):
            self._timed("motion", start)
            if motion is not None:
                self._motions[event.t_ns] = motion
            self._keep(event, motion)
            if not self._history:
                held = {f.t_ns for f in self._store.frames}
                self._motions = {t: m for t, m in self._motions.items() if t in held}
        return motion

    def _keep(self, frame: Frame, motion: Motion | None) -> None:
        if self._everything:
            self._store.offer(frame, None, None)
        elif motion is not None and motion.state is not MotionState.LOST:
            above = self._first_step if self._terrain.ground is None else self._step(motion)
            if self._store.offer(frame, motion, above):
                self._grow()
            if self._store.bytes > self._settings.parallax.store_mb * 1_000_000:
                self._make_room()

    def _grow(self) -> None:
        """Find the ground first; then, in the recursive way, step the map with every keyframe."""
        look = self._store.taken % FIND_EVERY == 0
        if not self._recursive:
            if self._terrain.ground is None and look:
                self._terrain.learn(self._views())
        elif self._terrain.ground is not None:
            self._advance(self._store.frames[-1:])
            if self._terrain.beyond and look:
                self._terrain.learn_anew(self._views_now(), FIND_BASELINE)
        elif look and self._terrain.learn(self._views_now(), FIND_BASELINE):
            self._advance(self._store.frames)
        elif len(self._store.frames) >= KEPT_BY_RING:  # the height is not known, so the baseline that it takes is not
            self._store.thin()
            self._first_step *= 2
        if self._recursive:
            most = KEPT_TO_LOOK if self._history else KEPT_BY_RING
            self._store.drop_oldest(max(0, len(self._store.frames) - most))

    def _advance(self, frames: list[Frame]) -> None:
        for frame in frames:
            start = self._clock()
            motion, poses = self._motions[frame.t_ns], self._navigation.posterior()
            if poses is not None and frame.t_ns not in {m.t_ns for m in poses.motions}:
                poses = KeyframePosterior((motion,), motion.covariance)  # held before the ground was found
            stepped = self._terrain.step(views_of([frame], self._motions, self._navigation.rig), motion.map, poses)
            self._timed("heights", start)
            if stepped:
                self._since_judged += 1
        if self._settings.sites.every and self._since_judged >= self._settings.sites.every:
            self.judge_now()

    @property
    def reserve(self) -> Reserve:
        """The sites of all maps judged so far, and those that the newest one gave up, with the reason."""
        return self._judging.reserve

    def judge_now(self) -> Verdict | None:
        """Judge the ground under the newest keyframe as the map has it by now; None without a map there.

        In the recursive way it is called every `sites.every` keyframes; an executive may ask at its way-points.
        """
        start, self._since_judged = self._clock(), 0
        views = looking_down(self._views_now())
        elevation = self._terrain.map_under(views[-len(self._navigation.rig.cameras) :]) if views else None
        if elevation is None:
            return None
        vehicle = views[-1].centre
        below = self._terrain.ground if self._terrain.below is None else self._terrain.below
        return self._judging.judge(elevation, views, vehicle, float(vehicle[2] - (below or 0.0)), start)

    def _step(self, motion: Motion) -> float:
        ground = self._terrain.ground if self._terrain.below is None else self._terrain.below
        above = motion.world_from_body.translation[2] - (ground or 0.0)
        return float(self._settings.parallax.keyframe_baseline * max(above, 1.0))

    def _views(self) -> list[View]:
        return views_of(self._store.frames, self._motions, self._navigation.rig)

    def _views_now(self) -> list[View]:
        """The same in flight: with what is known of the last poses by now."""
        newer = self._navigation.posterior()
        motions = self._motions if newer is None else self._motions | {m.t_ns: m for m in newer.motions}
        return views_of(self._store.frames[-KEPT_BY_RING:], motions, self._navigation.rig)

    def _make_room(self) -> None:
        """Match every tile that the older half of the store sees, then forget that half: memory is bounded.

        Tiles that the newer half sees as well are matched again later, and the better height of each cell stays.
        """
        half = len(self._store.frames) // 2
        older = looking_down(views_of(self._store.frames[:half], self._motions, self._navigation.rig))
        self._terrain.learn(self._views())
        if self._terrain.ground is not None and older:
            behind = np.concatenate([footprint(v, self._terrain.ground) for v in older])
            low, high = behind.min(axis=0), behind.max(axis=0)

            def leaving(grid: Grid) -> bool:
                e, n = grid.xy()
                return bool(e[-1] >= low[0] and e[0] <= high[0] and n[0] >= low[1] and n[-1] <= high[1])

            self._terrain.build(self._views(), lambda _: None, leaving)
        self._store.drop_oldest(half)
        log.info("frame store full: the older half was mapped and forgotten")

    def finish(self, tell: Tell = lambda stage, share: None) -> Decision:
        """Refine the motion, build the map, judge it and choose."""
        start = self._clock()
        motions = self._navigation.finish(lambda f: tell("motion", f))
        self._motions = {m.t_ns: m for m in motions if m.state is not MotionState.LOST}
        start = self._timed("motion, all frames together", start)
        warnings, notes = list(self._navigation.warnings), dict(self._navigation.notes)
        if not self._motions:
            why = "no motion: " + (
                warnings[-1] if warnings else "there is no GPS/INS to start from (nav0), or no picture could be placed"
            )
            return Decision(Sites((), why), motions, warnings=warnings, notes=notes)
        views = self._views()
        if (
            not (self._recursive and self._terrain.elevation)
            and not self._terrain.learn(views)
            and not self._terrain.elevation
        ):
            return Decision(Sites((), self._terrain.reason), motions, warnings=warnings, notes=notes)
        start = self._timed("ground", start)
        if not self._recursive:
            self._terrain.build(views, lambda f: tell("heights", f))
            self._timed("heights", start)
        above = float(
            np.median([m.world_from_body.translation[2] for m in self._motions.values()]) - (self._terrain.ground or 0)
        )
        return self._judge(motions, above, warnings, notes, tell)

    def _judge(
        self, motions: list[Motion], above: float, warnings: list[str], notes: dict[str, Any], tell: Tell
    ) -> Decision:
        start = self._clock()
        elevation = self._terrain.map()
        start = self._timed("map", start)
        if elevation is None:
            why = "no height could be measured: no place was seen by two views"
            return Decision(Sites((), why), motions, warnings=warnings, notes=notes)
        tell("judging", 0.2)
        last = np.array(motions[-1].world_from_body.translation)
        found = self._judging.judge(elevation, looking_down(self._views()), last, above, start)
        tell("judging", 0.9)
        best = found.sites.sites[:1]
        way = route.plan_route(best[0], elevation, last, self._settings.route) if best else None
        notes |= self._judging.notes(found)
        tell("judging", 1.0)
        return Decision(found.sites, motions, found.elevation, found.cover, found.danger, way, above, warnings, notes)


def _lane(rig: Rig, kind: str, settings: Settings, poses: TimedPoses | None, history: bool) -> Lane:
    if poses is not None:
        return GivenLane(rig, poses, settings.motion, history)
    method = settings.motion.method
    if method == "bundle" or (method == "auto" and kind == "photos"):
        return BundleLane(rig, settings)
    return FilterLane(rig, settings, history)
