"""The map of a flight: improved with every keyframe, and ready to be judged at any time."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from alight.arrays import F64, U16, Mask
from alight.elevation import TiledElevation, TileStore, doublings_up_to
from alight.elevation.tiles import bytes_a_cell
from alight.geometry import Box, Grid, box_of
from alight.parallax.recursive import RecursiveParallax
from alight.pipeline.mapping import NO_HEIGHT, FinishedMap, MapSnapshot, map_at_end
from alight.pipeline.mapping.ground_map import GroundMap, refuse_too_large
from alight.pipeline.mapping.keyframes import FrameStore, Keyframe, bounds, is_keyframe, looking_down, views_of
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.remembered import NOWHERE, Remembered, around, what_moves, who_came
from alight.pipeline.timing import Progress, Timings
from alight.records import (
    ElevationMap,
    Flag,
    Heights,
    KeyframePosterior,
    Motion,
    MotionState,
    Rig,
    View,
    is_flagged,
    is_trusted,
)
from alight.records.map_frame import MapFrame, Tie
from alight.settings import StageSettings

log = logging.getLogger(__name__)

BYTES_A_STEP = 150.0  # bytes per cell during a step
COARSE = 4  # cells, stride of the heights used for the ground height


@dataclass(eq=False)
class RecursiveMap(GroundMap):
    """Recursive parallax over a window of keyframes."""

    by_quality: ClassVar[bool] = False

    ground_here: float | None = None  # metres above the origin, under the newest keyframe; None before the first step
    out_of_range: bool = False  # whether many newest heights are at a limit of the search range, or none is trusted
    level: int = 0  # level of the newest keyframe's cells
    passed: Remembered = NOWHERE  # cells that moving objects crossed, in the map frame
    came: Remembered = NOWHERE  # cells where a person or object came to stand, in the map frame
    moved: Remembered = NOWHERE  # cells near which pictures showed somebody who moves, in the map frame
    estimator: RecursiveParallax | None = None

    @property
    def ground_height(self) -> float | None:
        """Best known ground height under the vehicle, metres above the origin."""
        return self.ground if self.ground_here is None else self.ground_here

    def find_ground_again(self, views: Sequence[View], least: float) -> None:
        """Find the ground again after it left the searched heights; reset the height sweep, but keep the heights.

        `least`: least baseline over height.
        """
        if self.find_ground(views, least):
            self.ground_here = self.ground
            if self.estimator is not None:
                self.estimator.reset_sweep()
        self.out_of_range = False

    def begin_anew(self, shift: F64, sigma: float = 0.0) -> bool:
        """Move to a map frame in which positions are larger by `shift`, (3,) metres, and drop the heights.

        The ground height is kept, as it is accurate enough for the height search. Cells of traffic and people are kept
        and grown by the horizontal 1-sigma of the shift, `sigma` in metres.

        Returns:
            Whether there were any heights.
        """
        if self.elevation is None or self.ground is None:
            return False
        mapped = self.ground_here is not None
        for name in list(self.tile_store or ()):
            del self.tile_store[name]  # type: ignore[union-attr]
        self.elevation = self._empty(self.elevation.cell)
        self.ground, self.points = self.ground + float(shift[2]), self.points + shift
        self.ground_here = None if self.ground_here is None else self.ground_here + float(shift[2])
        self.estimator, self.datum, self.out_of_range = None, None, False
        self.passed, self.came = self.passed.moved(shift, sigma), self.came.moved(shift, sigma)
        self.moved = self.moved.moved(shift, sigma)
        return mapped

    def step(self, views: Sequence[View], poses: KeyframePosterior | None = None, effort: int = 0) -> bool:
        """Add a keyframe to the window and improve the map; return False if there is no baseline yet.

        `poses`: joint posterior of the last keyframes, refined together with the map; None: the poses are exact.
        `effort`: from 0 (full) to 3 (least).
        """
        down = looking_down(views)
        if self.elevation is None or self.ground is None or not down:
            return False
        newest = down[0]
        here = self.ground if self.ground_here is None else self.ground_here
        least = self.settings.executive.abort_height  # below it, no finer map can stop a landing
        self.ground_here = min(here, float(newest.centre[2]) - least)
        self.level = self.level_of(newest, self.ground_here, self.level)
        cell = self.elevation.cell_at(self.level)
        if self.estimator is None:
            self.estimator = RecursiveParallax(self.settings.parallax, cell, self.ground_here)
        self.estimator.work_at(cell, self.ground_here)
        self.estimator.push(down, poses)
        return self._improve(down, self.estimator, self.ground_here, effort)

    def _improve(self, down: list[View], estimator: RecursiveParallax, ground: float, effort: int) -> bool:
        assert self.elevation is not None
        low, high = bounds(down, ground)
        grid = _window(self.elevation, low, high, self.level, BYTES_A_STEP)
        known, up = self.elevation.start(grid), float(down[0].centre[2])
        parts = estimator.step(grid, known, *self.searched_heights(grid, up, known, estimator.beginning), effort)
        if estimator.alignment.plane.any():
            self.elevation.add_plane(estimator.alignment.plane, estimator.alignment.about)
            known = replace(known, height=known.height + estimator.alignment.plane_on(grid))
        if not parts:
            return False
        self.datum = parts[0].datum
        height, flags = known.height[::COARSE, ::COARSE].copy(), known.flags.copy()
        given, anew = is_trusted(known.flags), np.zeros(grid.shape, np.bool_)
        for part in parts:
            where = box_in(grid, part.grid)
            found = self._without_doubtful(part, up - ground, given, where)
            rows, cols = (slice(-s.start % COARSE, None, COARSE) for s in where)
            at = tuple(slice(-(-s.start // COARSE), -(-s.stop // COARSE)) for s in where)
            height[at] = found.height[rows, cols]
            flags[where], anew[where] = found.flags, True
            self.elevation.add(changed(found, known, where), replace_all=True)
        self._note_traffic(grid, flags, anew, down[0].t_ns, up - ground)
        self._note_who_came(estimator, down[0].t_ns)
        at_an_end = ((flags[::COARSE, ::COARSE] & np.uint16(Flag.RANGE)) != 0).mean()
        self.out_of_range = bool(at_an_end > self.settings.mapping.beyond or not is_trusted(flags).any())
        heights = height[np.isfinite(height)]
        if len(heights) >= self.settings.mapping.least_known // 4:
            self.ground_here = float(np.median(heights))
        self.elevation.roll((down[0].centre[0], down[0].centre[1]), float(np.linalg.norm(high - low)))
        return True

    def _note_traffic(self, grid: Grid, flags: U16, anew: Mask, t_ns: int, height: float) -> None:
        """Remember cells with moving objects, if seen from a sufficient `height` above ground, metres (G6b).

        `flags` and `anew`: (R, C), as in `what_moves`.
        """
        keys = self.settings.hazards
        self.passed = self.passed.since(t_ns - round(keys.traffic_memory * 1e9))
        if height >= keys.traffic_height and keys.traffic_memory > 0:
            self.passed = self.passed.with_seen(what_moves(grid, flags, anew), t_ns)

    def note_movers(self, motion: Motion) -> None:
        """Remember where people and cars move in an exposure."""
        if len(cells := around(motion.movers, self.settings.hazards.traffic_margin)):
            self.moved = self.moved.with_seen(cells, motion.t_ns)

    def _note_who_came(self, estimator: RecursiveParallax, t_ns: int) -> None:
        """Remember the cells on which a person or object came to stand in the estimator's last step, `t_ns` (G6c).

        Only those who were seen to move count: plants that sway and errors of the poses make views disagree, too.
        """
        since = t_ns - round(self.settings.hazards.came_memory * 1e9)
        self.came, self.moved = self.came.since(since), self.moved.since(since)
        for grid, came in estimator.came:
            self.came = self.came.with_seen(self.moved.among(who_came(grid, came)), t_ns)

    def under(self, views: Sequence[View], about: F64 | None = None) -> ElevationMap | None:
        """Return the map of the ground in the views, and around `about`, (2,) metres; None if nothing trusted was seen.

        Of unseen ground, only a margin is kept. The cell size is that of the newest keyframe, doubled as often as the
        lander's judging cell allows.

        Raises:
            SettingsError: the map would be too large for any memory, as when the ground height is wrong.
        """
        if self.elevation is None or self.ground_here is None or not views:
            return None
        low, high = bounds(views, self.ground_here)
        if about is not None:
            reach = self.settings.sites.lowest_look  # metres that a look from there shows to each side
            low, high = np.minimum(low, about - reach), np.maximum(high, about + reach)
        here = self.elevation.cell_at(self.level)
        level = self.level + doublings_up_to(here, self.settings.lander.judging_cell)
        found = self.elevation.read(_window(self.elevation, low, high, level, bytes_a_cell()))
        if not found.trusted.any():
            return None
        shown = ~is_flagged(found.flags, Flag.UNSEEN)
        if about is not None:
            shown[found.grid.box_about(np.array([about - reach, about + reach]))] = True
        beside = self.settings.mapping.given_cells // 2  # cells, and steps of these, so that blocks of cells stay whole
        rows, cols = (
            slice(max(s.start - beside, 0) // beside * beside, min(s.stop + beside, n))
            for s, n in zip(box_of(shown), found.grid.shape, strict=True)
        )
        return replace(found.part((rows, cols)), datum=self.datum)


def _window(elevation: TiledElevation, low: F64, high: F64, level: int, each: float) -> Grid:
    """Return the grid of `level` between the south-west corner `low` and the north-east corner `high`, (2,) metres.

    Raises:
        SettingsError: the grid is too large at `each` bytes per cell.
    """
    refuse_too_large(low, high, elevation.cell_at(level), each)
    return elevation.layer(level).window((low[0], high[0]), (low[1], high[1]))


def box_in(grid: Grid, part: Grid) -> Box:
    """Return the rows and columns of a grid that `part` covers; `part` is a grid on the same cells."""
    row, col = (round(float(v)) for v in grid.index(np.array(part.east), np.array(part.north)))
    return slice(row, row + part.rows), slice(col, col + part.cols)


def changed(found: Heights, known: ElevationMap, where: Box) -> Heights:
    """Return the heights `found` for the box `where` of the map `known`, with unchanged cells set to UNSEEN."""
    height, sigma, flags, rgb = (getattr(known, k)[where] for k in ("height", "sigma", "flags", "rgb"))
    same = (found.height == height) & (found.sigma == sigma) & (found.flags == flags)
    same &= (found.rgb == rgb).all(axis=2)
    return replace(found, flags=np.where(same, np.uint16(Flag.UNSEEN), found.flags).astype(np.uint16))


class RecursiveMapper:
    """Mapping lane that first finds the ground, and then improves the map with every keyframe.

    Args:
        history: whether more keyframes are kept for the end of a recording.
        anew: times of the exposures before which the lane is restarted, as after a loss in flight.
    """

    def __init__(
        self, rig: Rig, settings: StageSettings, tile_store: TileStore | None, timings: Timings, history: bool,
        anew: Collection[int] = (),
    ) -> None:  # fmt: skip
        self._rig, self._settings, self._timings = rig, settings, timings
        self._few = 2 * settings.mapping.find_every  # keyframes in which the ground is sought: those of two searches
        self._tile_store, self._anew = tile_store, frozenset(anew)
        self._most = settings.mapping.kept_to_look if history else self._few
        self._begin()

    def _begin(self) -> None:
        self._map = RecursiveMap(self._settings, self._tile_store)
        self.store, self._first_step = FrameStore(), self._settings.mapping.first_step
        self._newest: Navigation | None = None  # newest keyframe
        self._frame: MapFrame | None = None  # frame of the map, from the newest exposure
        self._newest_ns = -(1 << 62)  # time of the newest exposure
        self._warnings: list[str] = []

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Keep the exposure if it is a keyframe, and improve the map with it; return the number of steps."""
        if navigation.frame.t_ns in self._anew:
            self._begin()
        motion = navigation.motion
        if motion is None or motion.state is MotionState.LOST:
            return 0
        if not self._follows(MapFrame.of(motion), motion.t_ns):
            return 0
        self._map.note_movers(motion)
        if not is_keyframe(motion, self.store.last, self._map.ground_height, self._first_step, self._settings):
            return 0
        self.store.keep(navigation.frame, motion)
        self._newest = navigation
        steps = self._grow(navigation, effort)
        del self.store.keyframes[: -self._most]
        while self.store.bytes > self._settings.parallax.store_mb * 1_000_000:
            del self.store.keyframes[0]
        return steps

    def _follows(self, frame: MapFrame, t_ns: int) -> bool:
        """Adopt the map frame of an exposure; drop the map if the frame changed. Return whether the exposure is usable.

        An exposure out of sequence, from another frame, is not usable.
        """
        if self._frame is not None and frame.frame_id != self._frame.frame_id:
            if t_ns < self._newest_ns:
                return False
            self._drop_map(frame.frame_id, self._frame.tie(frame))
        self._frame, self._newest_ns = frame, max(t_ns, self._newest_ns)
        return True

    def _drop_map(self, frame_id: int, tie: Tie) -> None:
        self.store.keyframes, self.store.last, self._newest = [], None, None
        if self._map.begin_anew(*tie):
            warning = (
                f"map: the motion began anew (frame {frame_id}), and the map of before is dropped: its place in the "
                f"new frame is known to {tie.sigma:.2f} m only"
            )
            log.warning(warning)
            self._warnings.append(warning)

    def _grow(self, navigation: Navigation, effort: int) -> int:
        """Find the ground, or improve the map with the newest keyframe; return the number of steps."""
        due = self.store.taken % self._settings.mapping.find_every == 0
        least = self._settings.parallax.recursive.first_baseline
        if self._map.ground is not None:
            steps = self._advance(self.store.keyframes[-1:], navigation, effort)
            if self._map.out_of_range and due:
                self._map.find_ground_again(self._views_now(), least)
            return steps
        for view in looking_down(self._views_now(1))[:1]:
            self._map.features.of(view)  # each as it comes; all of them at once would take a second
        if self.store.taken >= self._settings.mapping.find_every and self._map.find_ground(self._views_now(), least):
            return self._advance(self.store.keyframes, navigation, effort)
        if len(self.store.keyframes) >= self._few:  # height and required baseline are unknown
            self.store.thin()
            self._first_step *= 2
        return 0

    def _advance(self, keyframes: Sequence[Keyframe], navigation: Navigation, effort: int) -> int:
        steps = 0
        for k in keyframes:
            assert k.motion is not None
            with self._timings.of("heights"):
                poses = _posterior_with(k.motion, navigation.posterior)
                steps += self._map.step(views_of([k], self._rig), poses, effort)
        return steps

    def _views_now(self, most: int | None = None) -> list[View]:
        """Return the `most` newest keyframes (None: as many as the window holds) as views, with their newest poses."""
        known = self._newest.posterior if self._newest is not None else None
        newer = {m.t_ns: m for m in known.motions} if known is not None else None
        return views_of(self.store.keyframes[-(most or self._few) :], self._rig, newer)

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """Return the present map under the newest keyframe and around `about`; None if there is no map."""
        views = looking_down(self._views_now())
        elevation = self._map.under(views[-len(self._rig.cameras) :], about)
        if elevation is None or self._frame is None:
            return None
        centre, attitude = views[-1].centre, self._newest is None or self._newest.attitude
        return MapSnapshot(
            elevation, tuple(views), centre, float(centre[2] - (self._map.ground_height or 0.0)), self._frame, attitude,
            self._map.passed, self._map.came,
        )  # fmt: skip

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """Return the final map; if the ground was never found in flight, build the map from all keyframes."""
        views = self._views_now(self._most)
        if self._map.elevation is None:
            with self._timings.of("ground"):
                found = self._map.find_ground(views)
            if not found or self._newest is None:
                return FinishedMap(None, self._map.reason, tuple(self._warnings))
            self._advance(self.store.keyframes, self._newest, 0)
        with self._timings.of("map"):
            elevation = self._map.snapshot()
        if elevation is None or self._frame is None:
            return FinishedMap(None, NO_HEIGHT, tuple(self._warnings))
        seen = map_at_end(elevation, views, trajectory, self._map.ground, self._frame)
        seen = replace(seen, passed=self._map.passed, came=self._map.came)
        return FinishedMap(seen, warnings=tuple(self._warnings))


def _posterior_with(motion: Motion, posterior: KeyframePosterior | None) -> KeyframePosterior | None:
    """Return `posterior`, or if it lacks the motion, a posterior of the motion alone; None (exact poses) stays None."""
    if posterior is None or motion.t_ns in {m.t_ns for m in posterior.motions}:
        return posterior
    return KeyframePosterior((motion,), np.asarray(motion.covariance))
