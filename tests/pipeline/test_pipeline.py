"""The core from events to a decision, on a tiny simulated flight with true poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from meadow_flight import FORWARD, LENS, batch_mapper, flight, mapped, one_camera, settings_of

from alight.arrays import I64
from alight.elevation import NullStore
from alight.pipeline import Decision, FlightPolicy, Pipeline, PipelineOptions, Verdict
from alight.pipeline.mapping import recursive_map
from alight.pipeline.mapping.ground_map import lone, nice_cell
from alight.pipeline.mapping.keyframes import FrameStore
from alight.pipeline.mapping.recursive_map import RecursiveMapper
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.pipeline.navigation.given import GivenLane
from alight.pipeline.remembered import CELL
from alight.pipeline.timing import Timings
from alight.records import (
    ElevationMap,
    Event,
    Flag,
    Frame,
    Hazard,
    Motion,
    MotionState,
    NavSample,
    Rig,
    RigCamera,
)
from alight.records.executive import Need
from alight.settings import Settings, load_settings
from alight.settings.tuning import MappingTuning
from alight_sim import SimulatedFlight, default_rig, fly
from alight_sim.faults import Faults


@dataclass(frozen=True)
class Run:
    """A decision, and the motions on the way to it."""

    decision: Decision
    given: list[Motion | None]  # result of `feed` for each exposure


def run(settings: Settings, events: tuple[Event, ...] | None = None, rig: Rig | None = None) -> Run:
    f, all_events = flight()
    p = Pipeline(rig or f.rig, "flight", settings, PipelineOptions(f.truth_trajectory))
    given = []
    for e in events or all_events:
        motion = p.feed(e)
        if isinstance(e, Frame):
            given.append(motion)
    return Run(p.finish(), given)


def brief_mapper() -> RecursiveMapper:
    """Return the mapper of a flight of unlimited length."""
    settings = settings_of("parallax.method=recursive").stages()
    return RecursiveMapper(flight()[0].rig, settings, NullStore(), Timings(), history=False)


@cache
def batch() -> Run:
    return run(settings_of())


@cache
def recursive() -> Run:
    return run(settings_of("parallax.method=recursive"))


def errors(elevation: ElevationMap) -> np.ndarray:
    """Found minus true height of every cell; NaN where nothing was found or outside the world."""
    f, _ = flight()
    x, y = np.meshgrid(*elevation.grid.xy())
    whole = f.world.truth()
    g = whole.grid
    row, col = (np.round(k).astype(int) for k in g.index(x, y))
    inside = (row >= 0) & (row < g.rows) & (col >= 0) & (col < g.cols)
    truth = np.where(inside, whole.height[row.clip(0, g.rows - 1), col.clip(0, g.cols - 1)], np.nan)
    return np.asarray(elevation.height - truth)


def trusted_of(d: Decision) -> ElevationMap:
    assert d.elevation is not None
    return d.elevation


def with_frames(**changes: object) -> tuple[Event, ...]:
    """Return the flight's events with every frame changed."""
    return tuple(replace(e, **changes) if isinstance(e, Frame) else e for e in flight()[1])  # type: ignore[arg-type]


# -- the whole way


@pytest.mark.parametrize("method", ["batch", "recursive"])
def test_heights_are_right(method: str) -> None:
    """The median error is below half a percent of the height above ground, with 160 x 120 pixels."""
    d = (batch() if method == "batch" else recursive()).decision
    m = trusted_of(d)
    error = errors(m)[m.trusted]
    error = error[np.isfinite(error)]
    assert len(error) > 5000
    assert abs(np.median(error)) < 0.03
    assert np.median(np.abs(error)) < 0.005 * 15.0
    assert np.percentile(np.abs(error), 95) < 0.3
    assert d.height_above_ground == pytest.approx(15.0, abs=0.7)
    assert d.hazards is not None
    assert d.terrain is not None
    assert len(d.motions) == flight()[0].length


def test_a_site_is_found_and_a_way_to_it() -> None:
    d = batch().decision
    best = d.sites.sites[0]
    f, _ = flight()
    assert abs(f.world.height_at(best.east, best.north) - best.up) < 0.15
    assert d.route is not None
    assert np.allclose(d.route.waypoints[-1].position_world[:2], [best.east, best.north])


def test_the_map_lies_on_its_raster_and_uses_the_cell_asked_for() -> None:
    g = trusted_of(batch().decision).grid
    assert g.cell == 0.25
    assert (g.east / g.cell - 0.5) % 1.0 == pytest.approx(0.0, abs=1e-6)
    assert (g.north / g.cell - 0.5) % 1.0 == pytest.approx(0.0, abs=1e-6)


def test_the_same_events_give_the_same_bits() -> None:
    again = run(settings_of()).decision
    a, b = trusted_of(batch().decision), trusted_of(again)
    assert a.grid == b.grid
    for f in ("height", "sigma", "flags", "views", "rgb", "residual"):
        assert getattr(a, f).tobytes() == getattr(b, f).tobytes(), f
    assert again.sites == batch().decision.sites


def test_motion_is_given_out_as_it_becomes_known() -> None:
    f, _ = flight()
    given = batch().given
    assert [m.t_ns for m in given if m] == f.frame_times.tolist()
    assert given[7] is not None
    assert np.allclose(given[7].world_from_body.matrix, f.pose(int(f.frame_times[7])).matrix)


def test_what_is_too_vague_is_refused() -> None:
    d = run(settings_of("parallax.method=recursive", "elevation.max_sigma=0.04")).decision
    m = trusted_of(d)
    assert not m.trusted[m.sigma > 0.04].any()
    assert ((m.flags[m.sigma > 0.04] & np.uint16(Flag.UNSURE)) != 0).all()
    assert m.trusted.sum() < trusted_of(recursive().decision).trusted.sum()


# -- memory


def test_a_height_among_refused_ones_is_refused() -> None:
    given = np.zeros((100, 120), np.bool_)
    given[5, 5] = given[20:34, 60:74] = True  # one cell, and 196 of 1681
    given[60:, :] = True  # a half-plane: at its border half of the surrounding cells are given out
    given[75:80, 60:65] = False
    alone = lone(given, (slice(0, 100), slice(0, 120)), MappingTuning())
    assert alone.sum() == 197
    assert not alone[60:].any()


def test_a_full_store_bounds_memory_and_loses_no_ground() -> None:
    """Sixteen frames fit: the older half is mapped before it is forgotten, also in tiles that both halves see."""
    frame = 160 * 120 * 3
    s = settings_of().stages()
    small = replace(s, parallax=s.parallax.model_copy(update={"store_mb": 16 * frame / 1e6}))
    mapper = batch_mapper(small)
    bounded = mapped(mapper)
    assert mapper.store.taken > 20
    assert bounded.most_bytes <= 17 * frame
    a, b = trusted_of(batch().decision), bounded.elevation
    assert b.trusted.sum() > 0.95 * a.trusted.sum()
    r, c = round((a.grid.north - b.grid.north) / 0.25), round((b.grid.east - a.grid.east) / 0.25)
    rows = slice(max(0, -r), min(a.grid.rows - r, b.grid.rows))  # rows of b that are in a, too
    cols = slice(max(0, -c), min(a.grid.cols - c, b.grid.cols))
    part = np.s_[rows.start + r : rows.stop + r, cols.start + c : cols.stop + c]
    both = b.trusted[rows, cols] & a.trusted[part]
    assert both.sum() > 0.9 * a.trusted.sum()
    apart = np.abs(b.height[rows, cols] - a.height[part])[both]
    assert np.median(apart) < 0.03
    assert np.percentile(apart, 95) < 0.15
    error = errors(b)[b.trusted]
    assert np.nanmedian(np.abs(error)) < 0.005 * 15.0


def test_a_flight_without_history_makes_the_same_map_and_holds_little() -> None:
    whole = trusted_of(recursive().decision)
    brief = mapped(brief_mapper())
    assert brief.most_keyframes <= 17
    b = brief.elevation
    e, n = b.grid.xy()
    row, col = (np.rint(k).astype(int) for k in whole.grid.index(e, n))
    same = whole.height[np.ix_(row, col)]
    both = np.isfinite(b.height)
    assert both.sum() > 5000  # forgotten ground may be missing
    assert (same[both] == b.height[both]).all()


def test_a_full_store_of_a_flight_forgets_the_oldest() -> None:
    """Pixels of twelve frames fit, and no more are held; the map has used the others already and is the same."""
    frame, s = 160 * 120 * 3, settings_of("parallax.method=recursive").stages()
    small = replace(s, parallax=s.parallax.model_copy(update={"store_mb": 12 * frame / 1e6}))
    mapper = RecursiveMapper(flight()[0].rig, small, None, Timings(), history=True)
    found = mapped(mapper)
    assert mapper.store.taken > 20
    assert found.most_bytes <= 12 * frame
    assert found.elevation.height.tobytes() == trusted_of(recursive().decision).height.tobytes()


def test_without_history_only_the_last_motion_is_kept() -> None:
    f, events = flight()
    lane = GivenLane(f.rig, f.truth_trajectory, Settings().motion, history=False)
    given = [n.motion for e in events if (n := lane.feed(e)) is not None]
    assert len(given) > 20
    assert lane.finish(lambda share: None).motions == (given[-1],)


def test_a_hover_without_history_holds_little() -> None:
    """In 40 exposures on the spot no keyframes accumulate."""
    f, mapper = flight()[0], brief_mapper()
    frames = [e for e in flight()[1] if isinstance(e, Frame)]
    lane = GivenLane(f.rig, (f.frame_times, [f.pose(frames[0].t_ns)] * len(frames)), Settings().motion, history=False)
    for e in frames:
        navigation = lane.feed(e)
        assert navigation is not None
        mapper.feed(navigation)
    assert len(mapper.store.keyframes) == 1


def test_in_flight_the_ground_is_judged_again_and_sites_stay_in_reserve() -> None:
    """Sites of earlier keyframes are kept although the newest keyframe does not see them any more."""
    f, events = flight()
    settings = settings_of("parallax.method=recursive", "hazards.p_safe=0.1", "sites.margin=0")
    policy, verdicts = FlightPolicy(every=5), list[Verdict]()
    options = PipelineOptions(
        f.truth_trajectory, policy=policy, on_verdict=lambda verdict, t_ns: verdicts.append(verdict), history=False
    )
    p = Pipeline(f.rig, "flight", settings, options)
    reserves = [p.reserve]
    for e in events:
        policy.need = Need(0.0) if e.t_ns == f.frame_times[-1] else None
        p.feed(e)
        if p.reserve is not reserves[-1]:
            reserves.append(p.reserve)
    assert max(len(r.sites) for r in reserves) >= 2
    now = verdicts[-1]
    held = p.reserve.sites
    assert held[: len(now.sites.sites)] == now.sites.sites
    east, _ = now.elevation.grid.xy()
    behind = [s for s in held[len(now.sites.sites) :] if not (east[0] <= s.east <= east[-1])]
    assert behind
    end = p.finish()
    earlier = p.reserve.sites[len(end.sites.sites) :]
    assert len(end.notes.get("sites in reserve", [])) == len(earlier)
    given_up = [why for r in [*reserves, p.reserve] for _, why in r.lost]
    assert given_up
    assert [line.split(": ")[1] for line in end.notes.get("sites given up", [])] == given_up


def test_the_end_of_a_flight_knows_what_moved_and_who_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best place of the flight lies on a street: a car passes it once, and the last verdict still refuses it."""
    f, events = flight()
    settings = settings_of("parallax.method=recursive", "sites.every=0", "sites.margin=0", "terrain.enabled=false")

    def end(moves: I64) -> Decision:
        monkeypatch.setattr(recursive_map, "what_moves", lambda grid, flags, anew: moves)
        p = Pipeline(f.rig, "flight", settings, PipelineOptions(f.truth_trajectory))
        for e in events:
            p.feed(e)
        return p.finish()

    best = end(np.zeros((0, 2), np.int64)).sites.sites[0]
    here = np.array([best.east, best.north])
    passed = end(np.floor(here / CELL).astype(np.int64)[None])
    assert passed.hazards is not None
    r, c = (int(np.rint(v)) for v in passed.hazards.grid.index(best.east, best.north))
    assert Hazard.TRAFFIC in Hazard(int(passed.hazards.reasons[r, c]))
    assert all(np.hypot(s.east - best.east, s.north - best.north) > 1.0 for s in passed.sites.sites)


def test_a_place_that_is_asked_about_is_judged_though_the_newest_keyframe_does_not_look_there() -> None:
    """The executive needs a verdict on the place that it flies to, and the map still has the ground there."""
    f, events = flight()
    settings, policy, verdicts = settings_of("parallax.method=recursive"), FlightPolicy(every=0), list[Verdict]()
    options = PipelineOptions(
        f.truth_trajectory, policy=policy, on_verdict=lambda verdict, t_ns: verdicts.append(verdict), history=False
    )
    p = Pipeline(f.rig, "flight", settings, options)
    for e in events:
        if isinstance(e, Frame) and e.t_ns == f.frame_times[-2]:
            policy.need = Need(0.0)
        if isinstance(e, Frame) and e.t_ns == f.frame_times[-1]:
            grid = verdicts[-1].elevation.grid
            place = np.array([grid.east - 4.0, grid.north - grid.cell * grid.rows / 2])  # behind, west of the map
            policy.need = Need(0.0, place)
        p.feed(e)
    _, there = verdicts
    r, c = (int(np.rint(v)) for v in there.hazards.grid.index(place[0], place[1]))
    assert np.isfinite(there.elevation.height[r - 5 : r + 6, c - 5 : c + 6]).any()
    assert there.elevation.grid.east <= place[0] - settings.stages().sites.lowest_look + 0.5


def test_a_map_is_judged_when_the_need_calls_for_it_and_the_lane_is_free() -> None:
    """Time is that of the exposures, 0.1 s apart: a verdict each 0.3 s, the first at once; one waits for the lane."""
    policy, place = FlightPolicy(every=0), np.array([1.0, 2.0])

    def judged(exposures: Iterable[int], free: bool = True) -> list[int]:
        shown = [(k, Navigation(Frame(k * 100_000_000, ()), None)) for k in exposures]
        return [k for k, n in shown if policy.due_verdict(n, 0, free)]

    assert judged(range(3)) == []
    policy.need = Need(0.3, place)
    assert judged(range(3, 11)) == [3, 6, 9]
    assert judged(range(11, 15), free=False) == []
    assert judged(range(15, 20)) == [15, 18]
    assert judged([17, 12, 20]) == []  # those that come late
    due = policy.due_verdict(Navigation(Frame(2_100_000_000, ()), None), 0)
    assert due is not None
    assert due.about is place
    policy.need = None
    assert judged(range(22, 40)) == []


def test_nothing_is_judged_in_flight_where_it_is_not_asked_for() -> None:
    f, events = flight()
    p = Pipeline(
        f.rig, "flight", settings_of("parallax.method=recursive", "sites.every=0"), PipelineOptions(f.truth_trajectory)
    )
    for e in events:
        p.feed(e)
    assert p.reserve.sites == ()
    assert "hazards" not in p.timings


# -- reasons


def test_no_navigation_no_site() -> None:
    """Without navigation the filter cannot start, and the reason names this."""
    f, events = flight()
    p = Pipeline(f.rig, "flight", settings_of())
    for e in events:
        if isinstance(e, Frame):
            assert p.feed(e) is None
    d = p.finish()
    assert not d.sites.sites
    assert "no motion" in d.sites.reason
    assert "nav0" in d.sites.reason
    assert d.elevation is None


def test_nothing_at_all_is_a_reason_too() -> None:
    d = Pipeline(one_camera(), "flight", settings_of()).finish()
    assert not d.sites.sites
    assert "no motion" in d.sites.reason


def test_a_camera_that_looks_ahead_finds_nothing() -> None:
    d = run(settings_of(), rig=one_camera(FORWARD)).decision
    assert not d.sites.sites
    assert "no camera looks down" in d.sites.reason


def test_a_blank_picture_shows_no_parallax() -> None:
    blank = with_frames(images=(np.full((120, 160, 3), 90, np.uint8),))
    d = run(settings_of(), blank[: len(blank) // 3]).decision
    assert not d.sites.sites
    assert "no parallax" in d.sites.reason


def test_an_aircraft_that_stands_still_shows_no_parallax() -> None:
    f, events = flight()
    frames = [e for e in events if isinstance(e, Frame)]
    still = (f.frame_times, [f.pose(int(f.frame_times[0]))] * f.length)
    p = Pipeline(f.rig, "flight", settings_of(), PipelineOptions(still))
    for e in frames:
        p.feed(replace(e, images=frames[0].images))
    d = p.finish()
    assert not d.sites.sites
    assert "the aircraft did not move" in d.sites.reason


def test_frames_without_a_picture_or_a_pose_are_left_out() -> None:
    """Every third image is missing, and the poses end early; the rest is mapped, with a warning."""
    f, events = flight()
    times, poses = f.truth_trajectory
    last = f.frame_times[30]
    early = times <= last
    given = times[early], [q for q, e in zip(poses, early, strict=True) if e]
    p = Pipeline(f.rig, "flight", settings_of(), PipelineOptions(given))
    n = 0
    for e in events:
        if isinstance(e, Frame):
            n += 1
            e = replace(e, images=(None,)) if n % 3 == 0 else e
        p.feed(e)
    d = p.finish()
    assert trusted_of(d).trusted.sum() > 4000
    assert len(d.motions) == 31
    assert [w for w in d.warnings if "none for 10 exposures" in w]


def test_given_poses_replace_what_navigation_says() -> None:
    """True poses are used as they are, and navigation samples that are far off change nothing."""
    wrong = tuple(
        replace(e, position_world=np.asarray(e.position_world) + 500.0) if isinstance(e, NavSample) else e
        for e in flight()[1]
    )
    found = trusted_of(run(settings_of("parallax.method=recursive"), wrong).decision)
    assert found.height.tobytes() == trusted_of(recursive().decision).height.tobytes()


# -- the cell


@pytest.mark.parametrize(
    ("sampling", "cell"), [(0.0125, 0.02), (0.05, 0.1), (0.06, 0.1), (0.028, 0.05), (0.22, 0.5), (0.55, 1.0)]
)
def test_cells_are_round_numbers_near_two_pixels(sampling: float, cell: float) -> None:
    assert nice_cell(1.8 * sampling) == cell


# -- damaged streams through the lane


def navigated(faults: Faults) -> tuple[Trajectory, SimulatedFlight]:
    """Run tracker and filter on a flight with faults."""
    rig = Rig(tuple(RigCamera(c.name, LENS, c.body_from_cam) for c in default_rig().cameras))
    f = fly("demo", 1, 3.0, rig=rig, rate_hz=6.0, height=15.0, faults=faults)
    lane = FilterLane(f.rig, load_settings("", ["tuning.tracks.count=60", "tuning.filter.points=16"]).stages())
    for e in f.events():
        lane.feed(e)
    return lane.finish(lambda share: None), f


def test_late_frames_are_used() -> None:
    """A third of the exposures arrives up to a second late, with right stamps: each has its motion, in order."""
    found, f = navigated(Faults(late=0.35, late_by=0.2))
    motions = found.motions
    stamps = f.exposures.stamp_ns
    assert (np.diff(stamps[f.exposures.order]) < 0).any()
    assert [m.t_ns for m in motions] == sorted(stamps.tolist())
    assert motions[-1].state is MotionState.GOOD
    off = [m.world_from_body.translation - f.pose(m.t_ns).translation for m in motions]
    assert np.abs(np.std(off, axis=0)).max() < 0.15
    assert not [w for w in found.warnings if "left out" in w]


def test_of_frames_with_one_stamp_the_first_is_used() -> None:
    """A frame with a repeated stamp is left out and reported, as by the reader of logs."""
    found, f = navigated(Faults(repeated=0.25))
    motions = found.motions
    single = np.unique(f.exposures.stamp_ns)
    assert len(single) < len(f.exposures.stamp_ns)
    assert [m.t_ns for m in motions] == single.tolist()
    assert [w for w in found.warnings if f"{len(f.exposures.stamp_ns) - len(single)} exposures" in w]
    assert motions[-1].state is MotionState.GOOD


# -- the frames that are kept


def test_thinning_keeps_the_newest_and_every_second() -> None:
    store = FrameStore()
    for k in range(7):
        store.keep(Frame(k, (np.zeros((2, 3), np.uint8),)))
    store.thin()
    assert [k.frame.t_ns for k in store.keyframes] == [0, 2, 4, 6]
    assert store.bytes == 4 * 6
    store.keep(Frame(7, (np.zeros((2, 3), np.uint8),)))
    store.thin()
    assert [k.frame.t_ns for k in store.keyframes] == [0, 4, 7]
    assert store.bytes == 3 * 6
    assert store.taken == 8


def test_what_could_not_be_refined_together_is_said() -> None:
    """Two exposures are too few for a batch: the poses of the flight stay, and the run reports this."""
    f, events = flight()
    lane = FilterLane(f.rig, load_settings("", ["tuning.tracks.count=60", "tuning.filter.points=16"]).stages())
    given = 0
    for e in events:
        given += lane.feed(e) is not None
        if given == 2:
            break
    found = lane.finish(lambda share: None)
    assert len(found.motions) == 2
    assert found.joint is not None  # errors as of one body, with the covariance of the last motion
    np.testing.assert_array_equal(found.joint.covariance[-6:, -6:], found.motions[-1].covariance)
    assert any("could not be refined" in w for w in found.warnings)
    assert "as it was in flight" in str(found.notes["motion"])
