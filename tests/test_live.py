"""A flight on threads: the same bits as in turn, whatever was dropped; what a failing or slow lane does."""

from __future__ import annotations

import threading
import time
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from alight.geometry import Camera
from alight.pipeline import Decision, Pipeline, Schedule, Verdict
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import FilterLane, FrameBatch, TrackedFrame
from alight.pipeline.navigation.filter_lane import EventBatcher, prediction_for
from alight.records import (
    ElevationMap,
    Event,
    Frame,
    ImuSample,
    Motion,
    MotionState,
    NavSample,
    Rig,
    RigCamera,
    SettingsError,
)
from alight.runner.live import Capacity, Listener, Live
from alight.runner.mailbox import Closed, Mailbox
from alight.settings import Settings, load_settings
from alight_sim import SimulatedFlight, default_rig, fly

LENS = Camera(160, 120, 120.0, 120.0, 79.3, 59.8)
WAIT = Capacity(drop=False, schedule=None)


@cache
def flight() -> tuple[SimulatedFlight, tuple[Event, ...]]:
    """40 m over the demo's meadow, 15 m above it, two cameras of 160 x 120."""
    rig = Rig(tuple(RigCamera(c.name, LENS, c.body_from_cam) for c in default_rig().cameras))
    f = fly("demo", 1, 5.0, rig=rig, rate_hz=6.0, height=15.0)
    return f, tuple(f.events())


def settings(*more: str) -> Settings:
    small = ["tuning.tracks.count=40", "tuning.filter.points=16", "parallax.cell=0.25", "tuning.elevation.tile=64"]
    return load_settings("", [*small, "sites.every=3", "hazards.p_safe=0.3", "sites.margin=0", *more])


@cache
def in_turn() -> tuple[Motion, ...]:
    """The navigation lane alone, one event after the other."""
    lane = FilterLane(flight()[0].rig, settings().stages(), history=False)
    found = [lane.feed(e) for e in flight()[1]]
    return tuple(n.motion for n in found if n is not None and n.motion is not None)


def bits(motions: list[Motion] | tuple[Motion, ...]) -> list[bytes]:
    return [m.world_from_cams[0].matrix.tobytes() + m.covariance.tobytes() for m in motions]


def map_bits(m: ElevationMap) -> list[bytes]:
    return [getattr(m, f).tobytes() for f in ("height", "sigma", "flags", "views", "rgb", "residual")]


def verdict_bits(v: Verdict | Decision) -> list[object]:
    """Heights, P and sites."""
    danger = v.danger if isinstance(v, Verdict) else v.hazards
    assert v.elevation is not None
    assert danger is not None
    return [v.elevation.grid, *map_bits(v.elevation), danger.p_safe.tobytes(), danger.reasons.tobytes(), repr(v.sites)]


class Heard:
    """Everything that a live run or a replay gives out."""

    def __init__(self) -> None:
        self.motions, self.verdicts = list[Motion](), list[Verdict]()

    @property
    def listener(self) -> Listener:
        return Listener(self.motions.append, self.verdicts.append)


# -- the prediction rule


def test_every_exposure_is_predicted_from_the_last_but_one() -> None:
    assert [prediction_for(k) for k in range(5)] == [0, 1, 1, 2, 3]


def test_tracking_may_run_ahead_of_the_filter_by_one_exposure() -> None:
    """Exposure k is tracked before k - 1 is taken in: the same bits."""
    lane, waiting, found = (
        FilterLane(flight()[0].rig, settings().stages(), history=False),
        list[TrackedFrame](),
        list[Motion](),
    )

    def take_in() -> None:
        navigation = lane.update(waiting.pop(0))
        if navigation is not None and navigation.motion is not None:
            found.append(navigation.motion)

    batches = [b for e in flight()[1] if (b := lane.batch(e)) is not None]
    assert len(batches) == 31
    for k, batch in enumerate(batches):
        if k < 2:  # 0 needs the rows before it, 1 the state after 0
            lane.hear(batch)
        tracked = lane.track(batch)
        assert tracked is not None
        while waiting:
            take_in()
        if k >= 2:
            lane.hear(batch)
        waiting.append(tracked)
        if k < 1:
            take_in()
    take_in()
    assert bits(found) == bits(in_turn())


def test_it_navigates() -> None:
    f, _ = flight()
    last = in_turn()[-1]
    off = last.world_from_body.rotation @ f.pose(last.t_ns).rotation.T
    assert last.state is MotionState.GOOD
    assert np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)) < np.radians(2.0)
    assert last.tracks >= 16


def test_a_trajectory_that_is_not_smoothed_leaves_in_the_world_too() -> None:
    """All exposures moved by the newest offset, which is no error any more."""
    lane = FilterLane(flight()[0].rig, settings("tuning.filter.smooth=false").stages())
    given = [n.motion for e in flight()[1] if (n := lane.feed(e)) is not None and n.motion is not None]
    motions = lane.finish(lambda share: None).motions
    offset = given[-1].offset_world
    assert offset is not None
    assert np.linalg.norm(offset) > 1e-3
    for before, after in zip(given, motions, strict=True):
        assert_allclose(after.world_from_cams[1].translation, before.world_from_cams[1].translation + offset)
        assert after.offset_world is None
        assert np.trace(after.covariance) <= np.trace(before.covariance)


def test_a_flight_needs_the_filter() -> None:
    with pytest.raises(SettingsError, match=r"motion\.method"):
        Live(flight()[0].rig, settings("motion.method=bundle"))


# -- threads


def live(heard: Heard, capacity: Capacity) -> Live:
    return Live(flight()[0].rig, settings(), heard.listener, capacity)


def feed_all(run: Live) -> Decision:
    for e in flight()[1]:
        run.feed(e)
    return run.finish()


def replayed(schedule: Schedule) -> tuple[Heard, Decision]:
    """The pipeline in turn, with the schedule of a live run."""
    heard = Heard()
    p = Pipeline(flight()[0].rig, "flight", settings(), history=False, schedule=schedule)
    judge = p.judge

    def told(seen: MapSnapshot) -> Verdict:
        heard.verdicts.append(judge(seen))
        return heard.verdicts[-1]

    p.judge = told  # type: ignore[method-assign]
    for e in flight()[1]:
        motion = p.feed(e)
        heard.motions += [motion] if motion else []
    return heard, p.finish()


def test_threads_give_what_one_gives() -> None:
    """Nothing dropped: every exposure is tracked and mapped, and the motions are those of the lane in turn."""
    heard = Heard()
    run = live(heard, WAIT)
    feed_all(run)
    stamps = tuple(flight()[0].frame_times.tolist())
    assert run.schedule.tracked == run.schedule.mapped == stamps
    assert bits(heard.motions) == bits(in_turn())


def test_what_was_used_flies_again_bit_for_bit() -> None:
    """Lanes that are too slow leave out exposures; the schedule, through text, gives the same motions, heights, P and
    sites again: of every verdict on the way and of the last one."""
    heard = Heard()
    run = live(heard, Capacity(tracking=1, mapping=1, schedule=None))
    slow_map, slow_judge = run.pipeline.map, run.pipeline.judge
    run.pipeline.map = lambda n: (time.sleep(0.3), slow_map(n))[1]  # type: ignore[method-assign]
    run.pipeline.judge = lambda seen: (time.sleep(0.5), slow_judge(seen))[1]  # type: ignore[method-assign]
    frames = 0
    for e in flight()[1]:
        if isinstance(e, Frame):
            frames += 1
            time.sleep(0.0 if 20 < frames < 24 else 0.2)
        run.feed(e)
    decision = run.finish()
    schedule = run.schedule
    assert len(schedule.tracked) < 31
    assert len(schedule.mapped) < len(schedule.tracked)
    assert schedule.judged
    again, same = replayed(Schedule.from_json(schedule.to_json()))
    assert bits(heard.motions) == bits(again.motions)
    assert [m.t_ns for m in heard.motions] == list(schedule.tracked)
    assert [verdict_bits(v) for v in heard.verdicts] == [verdict_bits(v) for v in again.verdicts[:-1]]
    assert decision.terrain is not None
    assert same.terrain is not None
    assert decision.terrain.label.tobytes() == same.terrain.label.tobytes()
    assert verdict_bits(decision) == verdict_bits(same)


def test_a_lane_that_fails_says_so(caplog: pytest.LogCaptureFixture) -> None:
    run = live(Heard(), WAIT)
    wrong = Frame(1, (np.zeros((3, 3, 3, 3), np.uint8), None))
    run.feed(wrong)
    with pytest.raises(cv2.error):
        run.finish()
    with pytest.raises(cv2.error):
        run.feed(wrong)
    assert "has failed" in caplog.text
    assert not any(t.is_alive() for t in run.threads)


def test_mapping_that_fails_stops_the_flight(caplog: pytest.LogCaptureFixture) -> None:
    """Mailboxes that nobody empties any more let go of whoever waits for them."""
    run = live(Heard(), WAIT)

    def fails(navigation: object) -> None:
        raise RuntimeError("no map")

    run.pipeline.map = fails  # type: ignore[assignment,method-assign]
    with pytest.raises(RuntimeError, match="no map"):
        feed_all(run)
    assert "has failed" in caplog.text
    for t in run.threads:
        t.join(10.0)
    assert not any(t.is_alive() for t in run.threads)


def test_nothing_grows_with_the_flight() -> None:
    """Asked to keep five entries of the schedule, it keeps the last five; nothing is smoothed, whatever is set."""
    heard = Heard()
    run = live(heard, Capacity(drop=False, schedule=5))
    decision = feed_all(run)
    assert [m.t_ns for m in heard.motions][-5:] == list(run.schedule.tracked) == list(run.schedule.mapped)
    assert len(heard.motions) == 31
    assert [m.t_ns for m in decision.motions] == [heard.motions[-1].t_ns]
    assert "as it was in flight" in str(decision.notes["motion"])


def test_what_is_left_out_is_said_as_in_a_replay() -> None:
    """Every exposure comes twice; the run ends soon."""
    run, events = live(Heard(), WAIT), flight()[1]
    last = flight()[0].frame_times[5]
    for e in events:
        if e.t_ns <= last:
            run.feed(e)
            if isinstance(e, Frame):
                run.feed(e)
    assert any("6 exposures or GPS/INS rows have the stamp of an earlier one" in w for w in run.finish().warnings)


def test_no_exposure_no_motion() -> None:
    heard = Heard()
    run = live(heard, Capacity())
    for e in flight()[1]:
        if isinstance(e, NavSample | ImuSample):
            run.feed(e)
    assert "no motion" in run.finish().sites.reason
    assert heard.motions == []


# -- what goes between


def test_cameras_that_fail_leave_nothing_waiting() -> None:
    """No exposure for long, at the start or later: the filter hears of all rows all the same, in parts."""
    rows = [e for e in flight()[1] if not isinstance(e, Frame)] * 4
    batcher, frame = EventBatcher(), next(e for e in flight()[1] if isinstance(e, Frame))
    later = Frame(frame.t_ns + 1, frame.images)
    found = [b for b in (batcher.take(e) for e in [*rows, frame, *rows, later]) if b is not None]
    assert [b.frame for b in found if b.frame is not None] == [frame, later]
    assert [e for b in found for e in b.rows] == rows * 2
    assert max(len(b.rows) for b in found) <= 1001


def test_an_exposure_that_comes_twice_is_taken_once() -> None:
    batcher, frame = EventBatcher(), Frame(7, (None,))
    assert batcher.take(frame) is not None
    assert batcher.take(frame) is None
    assert batcher.repeated == 1


def test_the_rows_of_a_dropped_exposure_are_heard() -> None:
    rows = [e for e in flight()[1] if isinstance(e, NavSample)][:4]
    kept = FrameBatch(Frame(2, (None,)), tuple(rows[2:])).after(FrameBatch(Frame(1, (None,)), tuple(rows[:2])))
    assert kept.frame is not None
    assert kept.frame.t_ns == 2
    assert list(kept.rows) == rows


def test_a_full_mailbox_waits_or_merges() -> None:
    merging = Mailbox[list[int]](2, lambda a, b: a + b)
    for k in range(4):
        merging.put([k])
    assert [merging.get(), merging.get()] == [[0, 1, 2], [3]]
    waiting, done = Mailbox[int](1), threading.Event()

    def send() -> None:
        waiting.put(1)
        waiting.put(2)
        done.set()

    thread = threading.Thread(target=send)
    thread.start()
    assert not done.wait(0.05)
    assert [waiting.get(), waiting.get()] == [1, 2]
    thread.join()
    waiting.close()
    with pytest.raises(Closed):
        waiting.get()
