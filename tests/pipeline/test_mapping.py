"""The mapping lane: the frame store, the ground of a recording over relief, the ground found again, and the end."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from descent_views import LENS, level_flight
from meadow_flight import batch_mapper, flight, mapped, settings_of
from some_run import site

from alight.geometry import Grid, Pose
from alight.landing.reserve import Reserve
from alight.parallax.sparse_points import height_range
from alight.parallax.views import prepare_view
from alight.pipeline.judging import JudgingLane
from alight.pipeline.lanes import conclude
from alight.pipeline.mapping import FinishedMap, ground_map
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.recursive_map import RecursiveMap, RecursiveMapper
from alight.pipeline.navigation import Trajectory
from alight.pipeline.navigation.given import GivenLane
from alight.pipeline.timing import Timings
from alight.records import Frame, Motion, Rig, View
from alight.records.map_frame import MapFrame, in_world
from alight.settings import Settings

DOWN = np.diag([1.0, -1.0, -1.0])
DARK = np.zeros((LENS.height, LENS.width), np.uint8)


# -- the frame store


def test_keyframes_of_two_map_frames_are_each_placed_by_their_own_offset() -> None:
    """Both exposures were taken at one place; the first map frame is 3 m off, and the motion then began anew."""

    def motion(t_ns: int, place: list[float], offset: list[float], frame_id: int) -> Motion:
        pose = Pose(DOWN, np.array(place))
        return Motion(t_ns, pose, (pose,), np.eye(6), offset_world=np.array(offset), frame_id=frame_id)

    early, late = motion(1, [8.0, 1.0, 17.0], [2.0, -1.0, 1.0], 0), motion(2, [8.0, 1.0, 17.0], [2.0, -1.0, 3.0], 0)
    anew = motion(3, [10.0, 0.0, 20.0], [0.0, 0.0, 0.0], 1)
    placed = in_world([early, late, anew])
    assert len(placed) == 3
    for m in placed:  # the newest offset of a frame is the best one
        np.testing.assert_allclose(m.world_from_body.translation, [10.0, 0.0, 20.0])


def test_a_full_store_without_ground_keeps_every_second_keyframe(caplog: pytest.LogCaptureFixture) -> None:
    """Nothing could be mapped, so the older half is not forgotten."""
    s = settings_of().stages()
    small = replace(s, parallax=s.parallax.model_copy(update={"store_mb": 10 * 160 * 120 * 3 / 1e6}))
    mapper, (f, events) = batch_mapper(small), flight()
    lane = GivenLane(f.rig, f.truth_trajectory, Settings().motion)
    blank = [replace(e, images=tuple(0 * i for i in e.images)) for e in events if isinstance(e, Frame)]
    with caplog.at_level(logging.INFO):
        for e in blank[:14]:
            navigation = lane.feed(e)
            assert navigation is not None
            mapper.feed(navigation)
    assert [k.frame.t_ns for k in mapper.store.keyframes] == [e.t_ns for e in (*blank[0:11:2], *blank[11:14])]
    assert "every second keyframe is forgotten" in caplog.text
    assert "was mapped" not in caplog.text


# -- the ground


def above(places: np.ndarray) -> list[View]:
    """Views from places (N, 3), straight down."""
    return [View(k, 0, DARK, LENS, Pose(DOWN, p)) for k, p in enumerate(places)]


def points(high: float, rise: float = 0.0, seed: int = 0) -> np.ndarray:
    """(N, 3) metres: ground that rises to the east, and a hut of a height."""
    xy = np.random.default_rng(seed).uniform([-15, -15], [215, 15], (8000, 2))
    hut = (np.abs(xy[:, 0] - 8.0) < 3.0) & (np.abs(xy[:, 1]) < 3.0)
    return np.column_stack([xy, rise * xy[:, 0] + high * hut])


@pytest.mark.parametrize("lowest", [30.0, 5.0, 0.3])
def test_a_recording_that_contains_its_take_off_keeps_what_is_higher_than_the_lowest_camera(lowest: float) -> None:
    views = above(np.array([[0.0, 0.0, lowest], *([x, 0.0, 30.0] for x in range(1, 20))]))
    lane = BatchMap(Settings().stages())
    assert lane.find_ground(views, points=points(6.0))
    assert lane.searched_heights(Grid(5.0, 3.0, 0.05, 120, 120), 30.0)[1] > 7.0


def test_no_height_of_the_points_lies_beyond_the_range_to_search() -> None:
    """On a hill the ground may lie higher than most cameras of the recording: the range once turned round."""
    hill = np.column_stack([np.zeros((500, 2)), np.random.default_rng(0).normal(150.0, 1.0, 500)])
    low, high = height_range(hill, 130.0)
    assert low < np.percentile(hill[:, 2], 1)
    assert high >= np.percentile(hill[:, 2], 99)


def test_a_recording_along_a_slope_is_matched_everywhere_for_the_ground_below() -> None:
    """A flight 15 m above a slope that rises by 40 m: the median ground lies below some cameras and above others."""
    x = np.linspace(0, 200, 51)
    views = above(np.column_stack([x, 0 * x, 15 + 0.2 * x]))
    lane = BatchMap(Settings().stages())
    assert lane.find_ground(views, points=points(0.0, 0.2))
    np.testing.assert_allclose(lane.ground_under(views), 0.2 * x, atol=1.0)
    assert len(list(lane.levels(views))) == 1
    assert lane.elevation is not None
    for east in (10.0, 100.0, 190.0):
        block = lane.block_of(Grid(east - 5.0, 5.0, 0.1, 100, 100), views, views)
        assert block.above == pytest.approx(15.0, abs=1.0)
        low, high = block.searched
        assert 0.2 * east - 4 < low < 0.2 * east - 1
        assert 0.2 * east + 1 < high < 0.2 * east + 4
        for v, ground in zip(block.views, block.grounds, strict=True):
            assert prepare_view(v, 0.2, float(ground)).ratio == pytest.approx(0.2 * LENS.fu / 15.0 / 2, rel=0.1)


def test_the_ground_under_a_view_is_that_of_all_where_it_shows_few_points() -> None:
    lane, views = BatchMap(Settings().stages()), above(np.array([[0.0, 0.0, 15.0], [5.0, 0.0, 15.0]]))
    some = points(0.0, 0.2)
    assert lane.find_ground(views, points=some[some[:, 0] > 60.0])
    assert set(lane.ground_under(views)) == {lane.ground}


def test_points_of_an_earlier_search_are_replaced() -> None:
    """In flight they have the poses of the map frame, and at the end those of the world."""
    lane, views = BatchMap(Settings().stages()), above(np.array([[0.0, 0.0, 30.0], [5.0, 0.0, 30.0]]))
    assert lane.find_ground(views, points=points(0.0) + np.array([0.0, 0.0, 4.0]))
    assert lane.find_ground(views, points=points(0.0))
    assert lane.searched_heights(Grid(0.0, 5.0, 0.1, 100, 100), 30.0)[1] < 3.0
    assert not lane.find_ground(views[:1])
    assert len(lane.points)


def test_a_ground_that_is_found_again_is_searched_for_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map knows a plateau, and behind its edge the ground lies 12 m deeper than all that was searched."""
    views = level_flight(10, 20.0)
    lane = RecursiveMap(Settings().stages())
    assert lane.find_ground(views), lane.reason
    for v in views:
        lane.step([v])
    assert lane.estimator is not None
    assert lane.elevation is not None
    known = lane.elevation.read(lane.elevation.layer(lane.level).window((-6.0, 6.0), (-6.0, 6.0)))
    assert known.trusted.sum() > 7 * lane.settings.mapping.least_known
    for _ in range(20):
        lane.estimator.blocks.visited((slice(0, 8), slice(0, 8)), *2 * [np.zeros((2, 2), bool)], 4)
    lane.estimator.blocks.begins = False
    deep = points(0.0) - np.array([0.0, 0.0, 12.0])
    monkeypatch.setattr(ground_map, "find_points", lambda *_: deep)
    lane.find_ground_again(views, 0.08)
    assert lane.ground_height == -12.0
    assert lane.estimator.beginning
    assert lane.searched_heights(known.grid, 20.0, known, lane.estimator.beginning)[0] < -12.0
    assert lane.searched_heights(known.grid, 20.0, known, lane.estimator.beginning)[1] > 0.5


# -- the end


def test_a_recording_that_ends_before_the_ground_is_found_in_flight_has_a_map() -> None:
    """Seven keyframes: the ground is sought with every eighth."""
    f, events = flight()
    mapper = RecursiveMapper(f.rig, settings_of("parallax.method=recursive").stages(), None, Timings(), history=True)
    found = mapped(mapper, tuple(e for e in events if e.t_ns <= f.frame_times[6]))
    assert mapper.store.taken == 7
    assert found.elevation.trusted.sum() > 100


def test_without_a_prior_the_map_is_not_read_to_compare_it(monkeypatch: pytest.MonkeyPatch) -> None:
    lane = BatchMap(Settings().stages())
    monkeypatch.setattr(BatchMap, "snapshot", None)
    assert lane.against_prior() is None


def test_a_flight_that_ends_without_a_map_gives_out_what_was_judged_before() -> None:
    """The motion began anew at the end, and the new map has no height yet."""
    lane, here = JudgingLane(Settings().stages(), None, Timings()), MapFrame(0, np.zeros(3), 1e-6 * np.eye(3))
    kept = replace(lane.memory.with_reserve(Reserve((site(),)), here), warnings=("the motion began anew",))
    lane.memory = kept
    motion = Motion(0, Pose(np.eye(3), np.zeros(3)), (), np.eye(6))
    navigation = SimpleNamespace(finish=lambda progress: Trajectory((motion,), Rig(())))
    mapping = SimpleNamespace(finish=lambda trajectory, progress: FinishedMap(None, "fog", ("too dark",)))
    found = conclude(navigation, mapping, lane, Settings().stages(), Timings())  # type: ignore[arg-type]
    assert found.sites.reason == "fog"
    assert found.warnings == ["too dark", "the motion began anew"]
    assert len(found.notes["sites in reserve"]) == 1  # type: ignore[arg-type]
