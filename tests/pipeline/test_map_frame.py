"""The map frame and the world: results have the offset applied; a new frame moves or drops earlier results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from meadow_flight import flight, settings_of
from numpy.testing import assert_allclose
from some_run import LOCAL, candidate, elevation, hazards, site, some_run

from alight.geometry import Pose
from alight.landing.reserve import Reserve
from alight.outputs import rasters, vectors
from alight.pipeline import Decision, Pipeline, PipelineOptions, Verdict
from alight.pipeline.mapping.recursive_map import RecursiveMapper
from alight.pipeline.navigation import Navigation, NavigationLane, Trajectory
from alight.pipeline.navigation.given import GivenLane
from alight.pipeline.timing import Progress, Timings
from alight.records import Datum, ElevationMap, Event, Frame, Motion, Rig, Sites
from alight.records.map_frame import MapFrame
from alight.settings import Settings

OFFSET = np.array([1.25, -0.5, 0.75])  # metres; whole cells
EXACT, VAGUE = np.eye(3) * 1e-6, np.eye(3) * 9.0  # m^2


def frame_of(offset: np.ndarray = OFFSET, frame_id: int = 0, covariance: np.ndarray = EXACT) -> MapFrame:
    return MapFrame(frame_id, offset, covariance)


# -- one by one


def test_a_motion_knows_where_its_frame_lies() -> None:
    """The covariance is a second moment that includes the offset; once applied, the offset is no error any more."""
    own = np.diag([0.04, 0.09, 0.16, 1e-6, 1e-6, 1e-6])
    second = own.copy()
    second[:3, :3] += np.outer(OFFSET, OFFSET)
    pose = Pose(np.eye(3), np.array([3.0, 2.0, 1.0]))
    motion = Motion(5, pose, (pose,), second, offset_world=OFFSET, frame_id=2)
    frame = MapFrame.of(motion)
    assert frame.frame_id == 2
    assert_allclose(frame.covariance, own[:3, :3], atol=1e-12)
    there = frame.motion(motion)
    assert_allclose(there.world_from_body.translation, [4.25, 1.5, 1.75])
    assert_allclose(there.world_from_cams[0].translation, [4.25, 1.5, 1.75])
    assert_allclose(there.covariance, own, atol=1e-12)
    assert there.offset_world is None
    assert frame.motion(there) is there


def test_a_map_moves_as_one() -> None:
    before = replace(elevation(), datum=Datum(1.0, 2.0, np.diag([0.6, 1e-4, 1e-4])))
    after = frame_of(frame_id=3).elevation(before)
    assert (after.grid.east, after.grid.north) == (before.grid.east + 1.25, before.grid.north - 0.5)
    assert_allclose(after.height, before.height + 0.75, rtol=1e-6)
    assert after.frame_id == 3
    assert after.position_covariance is EXACT
    assert after.datum is not None
    assert (after.datum.east, after.datum.north) == (2.25, 1.5)
    assert_allclose(np.diag(after.datum.covariance), [0.6 - 0.75**2, 1e-4, 1e-4], rtol=1e-9)


def test_without_an_offset_every_bit_stays() -> None:
    before = elevation()
    after = frame_of(np.zeros(3)).elevation(before)
    assert after.grid == before.grid
    assert after.height is before.height


def test_sites_and_views_move_with_it() -> None:
    there = frame_of().sites(Sites((site(),))).sites[0]
    assert (there.east, there.north) == (site().east + 1.25, site().north - 0.5)
    assert there.up == pytest.approx(site().up + 0.75)
    seen = frame_of(frame_id=3).sites(Sites((site(),), candidates=(candidate(2),)))
    assert seen.frame_id == 3
    assert seen.sites == (there,)
    look, before = seen.candidates[0].look, candidate().look
    assert look is not None
    assert before is not None
    assert_allclose(look.position_world, before.position_world + OFFSET)
    assert look.height == before.height


def test_a_verdict_stays_in_the_frame_of_its_map_until_it_leaves() -> None:
    verdict = Verdict(elevation(), None, hazards(), Sites((site(),)), frame_of(frame_id=3))
    there = verdict.in_world()
    assert there.elevation.grid == there.hazards.grid == frame_of().grid(elevation().grid)
    assert_allclose(there.elevation.height, elevation().height + 0.75, rtol=1e-6)
    assert there.sites.sites == frame_of().sites(Sites((site(),))).sites
    assert there.sites.frame_id == there.elevation.frame_id == there.frame.frame_id == 3
    again = there.in_world()
    assert again.elevation.height is there.elevation.height
    assert again.sites == there.sites


def test_a_tie_adds_up_what_is_not_known_of_both_places() -> None:
    tie = frame_of(covariance=np.diag([0.09, 0.01, 1.0])).tie(
        frame_of(np.zeros(3), 1, covariance=np.diag([0.16, 0.01, 1.0]))
    )
    assert_allclose(tie.shift, OFFSET)
    assert tie.sigma == pytest.approx(0.5)


def test_a_site_in_reserve_is_moved_where_its_clearance_covers_the_tie() -> None:
    """Clearances are 6.3 and 0.5 m, the tie is known to 1 m: the first stays a site, the second may be in a hazard."""
    near = replace(site(2, 20.0, 3.0), clearance=0.5)
    after = Reserve((site(), near)).tied(OFFSET, 1.0, 4)
    assert [(s.rank, s.east) for s in after.sites] == [(1, site().east + 1.25)]
    assert [s.east for s, _ in after.lost] == [21.25]
    assert "1.00 m" in after.lost[0][1]
    assert after.frame_id == 4


# -- files


def test_the_place_of_the_map_stands_in_the_files() -> None:
    covariance = np.diag([0.25, 0.04, 0.09])
    tags = rasters.dem_raster(replace(elevation(), position_covariance=covariance), LOCAL, True).file_tags
    assert tags["POSITION_SIGMA_M"] == "0.5000,0.2000,0.3000"
    assert "POSITION_SIGMA_M" not in rasters.dem_raster(elevation(), LOCAL, True).file_tags
    found: dict[str, Any] = vectors.sites_geojson(some_run().sites, LOCAL, covariance)
    assert found["accuracy"] == {"horizontal_m": 0.5, "vertical_m": 0.3}
    assert "accuracy" not in vectors.sites_geojson(some_run().sites, LOCAL)


# -- the whole way


@dataclass
class FramedLane:
    """Lane with given poses in map frames: from exposure `change` on in frame 1 with another offset."""

    given: GivenLane
    covariance: np.ndarray
    offsets: tuple[np.ndarray, np.ndarray] = (OFFSET, -2.0 * OFFSET)
    change: int = 1_000_000
    exposures: int = 0

    def feed(self, event: Event) -> Navigation | None:
        found = self.given.feed(event)
        if found is None or found.motion is None:
            return None
        k = int(self.exposures >= self.change)
        self.exposures += 1
        motion = _in_frame(found.motion, k, self.offsets[k], self.covariance)
        return Navigation(found.frame, motion, None)

    def finish(self, progress: Progress) -> Trajectory:
        return self.given.finish(progress)


def _in_frame(motion: Motion, frame_id: int, offset: np.ndarray, own: np.ndarray) -> Motion:
    def back(pose: Pose) -> Pose:
        return Pose(pose.rotation, pose.translation - offset)

    covariance = np.eye(6) * 1e-6
    covariance[:3, :3] = own + np.outer(offset, offset)
    cams = tuple(back(c) for c in motion.world_from_cams)
    return replace(
        motion, world_from_body=back(motion.world_from_body), world_from_cams=cams, covariance=covariance,
        offset_world=offset, frame_id=frame_id,
    )  # fmt: skip


SETTINGS = ("parallax.method=recursive", "sites.every=5", "hazards.p_safe=0.3", "sites.margin=0")


def _flown_by(lane: NavigationLane, rig: Rig) -> Pipeline:
    settings = settings_of(*SETTINGS)
    return Pipeline(rig, "flight", settings, PipelineOptions(navigation=lane))


def flown(covariance: np.ndarray, change: int = 1_000_000) -> tuple[list[Reserve], Decision]:
    """Fly with map frames; return the reserve after each event, and the decision."""
    f, events = flight()
    lane = FramedLane(GivenLane(f.rig, f.truth_trajectory, Settings().motion), covariance, change=change)
    p, reserves = _flown_by(lane, f.rig), []
    for e in events:
        p.feed(e)
        reserves.append(p.reserve)
    return reserves, p.finish()


@cache
def in_the_world() -> Decision:
    """Fly the same events with poses that have no offset."""
    f, events = flight()
    p = Pipeline(f.rig, "flight", settings_of(*SETTINGS), PipelineOptions(f.truth_trajectory))
    for e in events:
        p.feed(e)
    return p.finish()


def difference(a: ElevationMap, b: ElevationMap) -> np.ndarray:
    """Absolute height differences of two maps in metres, for cells that are trusted in both."""
    (row, r), (col, c) = (_shared(*i) for i in zip(b.grid.index(*a.grid.xy()), b.grid.shape, strict=True))
    here, there = np.ix_(r, c), np.ix_(row, col)
    both = a.trusted[here] & b.trusted[there]
    return np.asarray(np.abs(a.height[here] - b.height[there])[both])


def _shared(index: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the second grid that coincide with rows of the first, and the rows of the first that have one."""
    nearest = np.rint(index).astype(int)
    assert_allclose(index, nearest, atol=1e-6)  # one raster
    has = np.flatnonzero((nearest >= 0) & (nearest < size))
    return nearest[has], has


def test_what_leaves_the_pipeline_is_in_the_world() -> None:
    """In a map frame 1.5 m beside the world, map, sites and route are those of poses in the world."""
    reserves, there = flown(EXACT)
    here = in_the_world()
    assert there.elevation is not None
    assert here.elevation is not None
    apart = difference(there.elevation, here.elevation)
    assert len(apart) > 4000
    assert np.median(apart) < 0.002
    assert np.percentile(apart, 95) < 0.05
    best = there.sites.sites[0]
    assert abs(flight()[0].world.height_at(best.east, best.north) - best.up) < 0.15
    assert there.route is not None
    assert_allclose(there.route.waypoints[0].position_world, there.motions[-1].world_from_body.translation)
    assert there.terrain is not None
    assert there.hazards is not None
    assert there.terrain.grid == there.hazards.grid == there.elevation.grid
    assert there.height_above_ground == pytest.approx(here.height_above_ground, abs=0.01)
    assert_allclose(there.elevation.position_covariance, EXACT, atol=1e-12)
    world = flight()[0].world
    seen = [r for r in reserves if r.sites]
    assert seen
    assert all(abs(world.height_at(s.east, s.north) - s.up) < 0.3 for r in seen for s in r.sites)


def test_a_restart_moves_the_sites_where_the_tie_is_known() -> None:
    reserves, end = flown(EXACT, change=22)
    last_old = next(r for r in reversed(reserves) if r.frame_id == 0)
    first_new = next(r for r in reserves if r.frame_id == 1)
    assert last_old.sites
    moved = {(round(s.east, 3), round(s.north, 3)) for s in first_new.sites}
    newest = {(round(s.east, 3), round(s.north, 3)) for s in last_old.sites}
    assert moved & newest  # their place in the world stays
    assert {end.sites.frame_id, end.elevation.frame_id if end.elevation else None} == {1}
    assert any("map: the motion began anew (frame 1)" in w for w in end.warnings)
    assert any("are moved into the new frame" in w for w in end.warnings)
    if end.route is not None:
        assert end.route.frame_id == 1
    world = flight()[0].world
    assert all(abs(world.height_at(s.east, s.north) - s.up) < 0.3 for s in end.sites.sites)


def test_a_restart_drops_what_no_tie_holds() -> None:
    """With GPS/INS good to 3 m, nothing from before stays in the map or in reserve, and the run reports this."""
    reserves, end = flown(VAGUE, change=22)
    last_old = next(r for r in reversed(reserves) if r.frame_id == 0)
    first_new = next(r for r in reserves if r.frame_id == 1)
    old = {(round(s.east, 3), round(s.north, 3)) for s in last_old.sites}
    assert old
    assert not old & {(round(s.east, 3), round(s.north, 3)) for s in first_new.sites}
    assert any(f"{len(old)} are dropped" in w for w in end.warnings)
    assert any("known to 4.24 m only" in str(line) for line in end.notes["sites given up"])  # type: ignore[attr-defined]
    assert end.elevation is not None
    f, events = flight()
    first = f.pose(next(e.t_ns for e in events if isinstance(e, Frame))).translation
    row, col = (int(np.rint(v)) for v in end.elevation.grid.index(first[0], first[1]))
    inside = 0 <= row < end.elevation.grid.rows and 0 <= col < end.elevation.grid.cols
    assert not inside or not end.elevation.trusted[row, col]  # the start of the flight was seen in the old frame only


def test_a_late_exposure_of_the_old_frame_drops_nothing() -> None:
    """The exposure arrives after the restart: it has no place in the new map, and is no second restart."""
    f, events = flight()
    lane = FramedLane(GivenLane(f.rig, f.truth_trajectory, Settings().motion), EXACT, change=22)
    fed = [n for e in events if (n := lane.feed(e)) is not None]
    late = fed.pop(20)
    fed.insert(30, late)
    mapper = RecursiveMapper(f.rig, settings_of(*SETTINGS).stages(), None, Timings(), history=True)
    updates = [mapper.feed(n) for n in fed]
    assert updates[30] == 0
    assert late.frame.t_ns not in {k.frame.t_ns for k in mapper.store.keyframes}
    found = mapper.finish(lane.finish(lambda share: None), lambda share: None)
    assert len(found.warnings) == 1
    assert found.snapshot is not None
    assert found.snapshot.frame.frame_id == 1
