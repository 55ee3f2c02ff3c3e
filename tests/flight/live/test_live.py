"""A flight on threads: the same bits as in turn, whatever was dropped; failing and slow lanes."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_lanes import Fault, FaultyJudging, FaultyMapping, FaultyNavigation, IdleOrBusy
from length import first, long
from numpy.testing import assert_allclose
from some_run import candidate
from stereo_flight import SMALL, flight
from waiting import wait_until

from alight.flight.live.health import LaneState, Watch
from alight.flight.live.lane_process import LaneLost, LaneProcess, LaneSpec
from alight.flight.live.live import Listener, Live, LiveOptions
from alight.flight.live.mailbox import Closed, Mailbox
from alight.flight.live.run import MOST_CELLS, for_flight
from alight.pipeline import Decision, Pipeline, PipelineOptions, ScheduledPolicy, Verdict
from alight.pipeline.navigation.filter_lane import EventBatcher, FilterLane, FrameBatch
from alight.pipeline.policy import EffortControl
from alight.records import (
    AlightError,
    ElevationMap,
    Frame,
    ImuSample,
    Motion,
    MotionState,
    NavSample,
    Schedule,
    SettingsError,
    Sites,
    p_safe_text,
)
from alight.records.executive import Need
from alight.settings import Settings, load_settings

WAIT: dict[str, Any] = {"drop": False, "schedule": None}


def settings(*more: str) -> Settings:
    return load_settings("", [*SMALL, "sites.every=3", *more])


@cache
def in_turn() -> tuple[Motion, ...]:
    """Motions of the navigation lane alone, one event after the other."""
    lane = FilterLane(flight()[0].rig, settings().stages(), history=False)
    found = [lane.feed(e) for e in flight()[1]]
    return tuple(n.motion for n in found if n is not None and n.motion is not None)


def bits(motions: list[Motion] | tuple[Motion, ...]) -> list[bytes]:
    return [m.world_from_cams[0].matrix.tobytes() + m.covariance.tobytes() for m in motions]


def map_bits(m: ElevationMap) -> list[bytes]:
    return [getattr(m, f).tobytes() for f in ("height", "sigma", "flags", "views", "rgb", "residual")]


def verdict_bits(v: Verdict | Decision) -> list[object]:
    """Return grid, map, P(safe), reasons and sites, as bytes and text."""
    assert v.elevation is not None
    assert v.hazards is not None
    p_safe, reasons = v.hazards.p_safe.tobytes(), v.hazards.reasons.tobytes()
    return [v.elevation.grid, *map_bits(v.elevation), p_safe, reasons, repr(v.sites)]


class Results:
    """Recorder of the motions and verdicts of a live run or a replay."""

    def __init__(self) -> None:
        self.motions, self.verdicts = list[Motion](), list[Verdict]()

    @property
    def listener(self) -> Listener:
        return Listener(self.motions.append, lambda verdict, t_ns: self.verdicts.append(verdict))


def test_the_map_of_a_long_flight_is_bounded_for_a_small_computer() -> None:
    """Judging 16 million cells, the limit of a recording, took 8.5 GB; a smaller limit of the user stays."""
    assert for_flight(Settings()).elevation.most_cells == MOST_CELLS
    few = Settings.model_validate({"elevation": {"most_cells": 50_000}})
    assert for_flight(few) == few


def test_it_navigates() -> None:
    f, _ = flight()
    last = in_turn()[-1]
    off = last.world_from_body.rotation @ f.pose(last.t_ns).rotation.T
    assert last.state is MotionState.GOOD
    assert np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)) < np.radians(2.0)
    assert last.tracks >= 16


def test_a_trajectory_that_is_not_smoothed_leaves_in_the_world_too() -> None:
    """All exposures are moved by the newest offset, which is no error afterwards."""
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


# -- lanes as processes


@pytest.fixture(scope="module", autouse=True)
def _warm(warm: None) -> None:
    """A lane that compiles does not answer."""


def faulty(lane: str, fault: Fault) -> dict[str, Callable[..., Any]]:
    return {lane: partial(FaultyNavigation if lane == "navigation" else FaultyMapping, fault)}


def feed_all(run: Live, pause: float = 0.0) -> Decision:
    for e in flight()[1]:
        if isinstance(e, Frame):
            time.sleep(pause)
        run.feed(e)
    return run.finish()


def replayed(schedule: Schedule) -> tuple[Results, Decision]:
    """Run the pipeline in turn, with the schedule of a live run."""
    results = Results()
    options = PipelineOptions(policy=ScheduledPolicy(schedule), on_verdict=results.listener.verdict, history=False)
    p = Pipeline(flight()[0].rig, "flight", settings(), options)
    for e in flight()[1]:
        motion = p.feed(e)
        results.motions += [motion] if motion else []
    return results, p.finish()


def assert_flies_again(results: Results, decision: Decision, schedule: Schedule) -> None:
    """Assert that the schedule gives the same motions, heights, P and sites, in flight and at the end."""
    again, same = replayed(schedule)
    assert bits(results.motions) == bits(again.motions)
    assert [m.frame_id for m in results.motions] == [m.frame_id for m in again.motions]
    assert [verdict_bits(v) for v in results.verdicts] == [verdict_bits(v) for v in again.verdicts]
    assert decision.terrain is not None
    assert same.terrain is not None
    assert decision.terrain.label.tobytes() == same.terrain.label.tobytes()
    assert verdict_bits(decision) == verdict_bits(same)


def live(results: Results, **more: Any) -> Live:
    return Live(flight()[0].rig, settings(), LiveOptions(**{"listener": results.listener, **WAIT, **more}))


def stamps() -> tuple[int, ...]:
    return tuple(flight()[0].frame_times.tolist())


def stamp(k: int) -> int:
    return int(flight()[0].frame_times[k])


def test_processes_give_what_one_gives() -> None:
    """Nothing is dropped: every exposure is tracked and mapped, and the motions are those of the lane in turn. All
    loops are loaded before the flight, and none is compiled in it."""
    results = Results()
    run = live(results)
    feed_all(run)
    assert run.schedule.tracked == run.schedule.mapped == stamps()
    assert bits(results.motions) == bits(in_turn())
    assert run.counts["frames used"] == run.counts["frames"] == 22
    assert run.compiled == []
    assert len(run.watch.timings.stages["frame to pose"]) == 22


def test_what_was_used_flies_again_bit_for_bit() -> None:
    """Slow mapping leaves out exposures, and so does navigation when many come at once."""
    results = Results()
    slow = Fault("slow", frozenset(flight()[0].frame_times.tolist()), 0.3)
    run = live(results, drop=True, waiting=1, makers=faulty("mapping", slow))
    for lane in run.lanes.values():
        lane.wait_until_ready()
    for e in flight()[1]:
        if isinstance(e, Frame):
            time.sleep(0.0 if stamp(14) < e.t_ns < stamp(18) else 0.15)
        run.feed(e)
    decision = run.finish()
    schedule = run.schedule
    assert len(schedule.tracked) < 22
    assert len(schedule.mapped) < len(schedule.tracked)
    assert schedule.judged
    assert [m.t_ns for m in results.motions] == list(schedule.tracked)
    left_out = sum(n for name, n in run.counts.items() if name.startswith("navigation: exposures left out"))
    assert len(schedule.tracked) + left_out == run.counts["frames"] == 22
    assert_flies_again(results, decision, schedule)


def test_verdicts_about_a_place_fly_again_bit_for_bit() -> None:
    """A landing needs verdicts about the place of its look: the replay shows each map the same place."""
    results = Results()
    run = live(results)
    places = {6: np.array([-3.7, 2.1]), 11: np.array([4.3, 1.9]), 16: None}
    for e in flight()[1]:
        if isinstance(e, Frame) and (k := stamps().index(e.t_ns)) in places:
            wait_until(lambda: len(results.motions) >= k)
            run.policy.need = Need(0.5, places[k])
        run.feed(e)
    decision, schedule = run.finish(), run.schedule
    assert len(schedule.about) == len(schedule.judged)
    assert {(-3.7, 2.1), (4.3, 1.9), None} == set(schedule.about)
    assert_flies_again(results, decision, schedule)
    without, _ = replayed(replace(schedule, about=(None,) * len(schedule.judged)))
    assert [verdict_bits(v) for v in results.verdicts] != [verdict_bits(v) for v in without.verdicts]


# -- lanes that fail


@pytest.mark.parametrize("kind", first(1, ["raise", "hang", "die"]))
def test_navigation_that_fails_begins_anew(kind: str) -> None:
    """The exposure is lost, the motion has another frame number, and the map is dropped; the replay does the same."""
    results, lost = Results(), list[str]()
    fault = Fault(kind, frozenset({stamp(9)}))
    listener = replace(results.listener, lost=lambda lane, why: lost.append(why))
    run = live(results, listener=listener, makers=faulty("navigation", fault))
    for e in flight()[1]:
        if e.t_ns == stamp(9) and isinstance(e, Frame):
            wait_until(lambda: len(results.motions) >= 9)
        run.feed(e)
    decision = run.finish()
    assert len(lost) == 1
    assert {"raise": "a fault that a test wants", "die": "died", "hang": "no answer within 0.9 s"}[kind] in lost[0]
    schedule = run.schedule
    assert stamp(9) not in schedule.tracked
    assert schedule.navigation_anew == (stamp(10),)
    assert [m.frame_id for m in results.motions] == [0] * 9 + [1] * 12
    assert any("navigation lane was lost" in w for w in decision.warnings)
    assert_flies_again(results, decision, schedule)


@pytest.mark.parametrize("kind", first(1, ["die", "raise"]))
def test_mapping_that_fails_begins_another_map_and_judging_that_fails_leaves_one_out(kind: str, tmp_path: Path) -> None:
    """The motions stay the same, and the memory of earlier maps survives."""
    results = Results()
    judging = partial(FaultyJudging, Fault("die", frozenset({2})), tmp_path / "count")
    mapping = faulty("mapping", Fault(kind, frozenset({stamp(11)})))
    run = live(results, makers={**mapping, "judging": judging})
    decision = feed_all(run)
    assert bits(results.motions) == bits(in_turn())
    assert run.schedule.mapping_anew == (stamp(12),)
    assert run.counts["mapping: restarted"] == run.counts["judging: restarted"] == 1
    assert len(results.verdicts) == (tmp_path / "count").stat().st_size - 2  # one is lost, and one is the last
    assert_flies_again(results, decision, run.schedule)


def test_the_line_shows_the_best_place_of_the_newest_verdict_and_its_age() -> None:
    watch = Watch(("navigation",))
    assert watch.line(0).startswith("no verdict yet")
    watch.arrived(stamp(0))
    watch.judged(stamp(0), Sites((), "nothing", candidates=(candidate(),)))
    p_safe = p_safe_text(candidate().p_safe)
    said = rf"candidate at east 5.0 north -2.0 m, P\(safe\) {p_safe}, \d+\.\d s old; "
    assert re.match(said, watch.line(0))
    watch.judged(stamp(1), Sites((), "nothing"))
    assert watch.line(0).startswith("no place, ")


def test_a_lane_that_hangs_is_called_late_and_holds_up_no_other() -> None:
    results = Results()
    fault = Fault("hang", frozenset(stamps()[5:]))
    run = live(results, drop=True, makers=faulty("mapping", fault))
    run.lanes["mapping"].patience = 3.0
    states, lines = [], list[str]()
    for e in flight()[1]:
        if isinstance(e, Frame):
            time.sleep(0.12)
            states.append((e.t_ns, run.watch.state("mapping")))
            lines.append(run.health)
        run.feed(e)
    run.finish()
    left_out = run.counts.get("navigation: exposures left out, busy", 0)  # none on a quiet machine
    assert len(results.motions) + left_out == 22
    assert len(results.motions) > 16  # a lane that waited for its patience would lose 16
    assert LaneState.LATE in [s for t, s in states if t > stamp(12)]
    assert any("mapping late" in line for line in lines)


def test_a_lane_that_cannot_be_made_says_so() -> None:
    run = live(Results(), makers={"navigation": partial(int, "none")})
    with pytest.raises(AlightError, match="navigation lane is lost: it cannot be started"):
        feed_all(run)
    run.close()
    assert not any(t.is_alive() for t in run.threads)


# -- incoming events


def test_a_flood_costs_exposures_and_nothing_else() -> None:
    results = Results()
    run = live(results, drop=True)
    feed_all(run)
    used, counts = len(results.motions), run.counts
    assert used < 22
    assert used + counts["navigation: exposures left out, busy"] == counts["frames"] == 22
    assert counts["frames used"] == used


def test_a_camera_that_stops_and_returns() -> None:
    """For 1.7 s without a picture the motion goes on by GPS/INS and IMU; then pictures are used again.

    Before, every exposure comes twice; the repeated ones are reported, and change nothing.
    """
    results = Results()
    run = live(results)
    for e in flight()[1]:
        if not (isinstance(e, Frame) and stamp(5) < e.t_ns < stamp(15)):
            run.feed(e)
        if isinstance(e, Frame) and e.t_ns <= stamp(5):
            run.feed(e)
    assert any("6 exposures have the stamp of an earlier one" in w for w in run.finish().warnings)
    assert [m.t_ns for m in results.motions] == [stamp(k) for k in (*range(6), *range(15, 22))]
    off = results.motions[-1].world_from_body.translation - flight()[0].pose(stamp(21)).translation
    assert np.linalg.norm(off) < 3.0
    assert results.motions[-1].state is MotionState.GOOD


def test_exposures_that_come_300_ms_late_are_used_and_nothing_grows_with_the_flight() -> None:
    """The exposures are used at their own stamps, and the motion is as good as without the delay.

    With a limit of five entries the schedule keeps the last five, and nothing is smoothed for any setting.
    """
    late = sorted(flight()[1], key=lambda e: e.t_ns + (300_000_000 if isinstance(e, Frame) else 0))
    results = Results()
    run = live(results, schedule=5)
    for e in late:
        run.feed(e)
    decision = run.finish()
    assert [m.t_ns for m in results.motions] == flight()[0].frame_times.tolist()
    for m in results.motions[5:]:
        off = m.world_from_body.translation - flight()[0].pose(m.t_ns).translation
        assert np.linalg.norm(off - (0 if m.offset_world is None else -m.offset_world)) < 3.0
    assert [m.t_ns for m in results.motions][-5:] == list(run.schedule.tracked) == list(run.schedule.mapped)
    assert [m.t_ns for m in decision.motions] == [results.motions[-1].t_ns]
    assert "as it was in flight" in str(decision.notes["motion"])


def test_no_exposure_no_motion() -> None:
    results = Results()
    run = live(results, drop=True, schedule=1000)
    for e in flight()[1]:
        if isinstance(e, NavSample | ImuSample):
            run.feed(e)
    assert "no motion" in run.finish().sites.reason
    assert results.motions == []


# -- queues between lanes


def test_cameras_that_fail_leave_nothing_waiting() -> None:
    """Without exposures for long, at the start or later, the filter still gets all rows, in parts."""
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


def test_the_rows_of_a_dropped_exposure_are_used() -> None:
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


# -- rates that adapt


def test_effort_falls_with_late_steps_and_rises_with_fast_ones() -> None:
    pace, found = EffortControl(deadline=0.2), list[int]()
    for seconds in (0.1, 0.3, 0.3, 0.1, 0.3, 0.9, 0.9, *[0.05] * 13, *[0.15] * 9, *[0.05] * 6):
        pace.took(seconds)
        found.append(pace.effort)
    assert found[:7] == [0, 1, 2, 2, 3, 3, 3]
    assert found[7:20] == [3] * 5 + [2] * 6 + [1] * 2
    assert found[20:29] == [1] * 9
    assert found[-1] == 0


@long
def test_less_effort_flies_again_bit_for_bit() -> None:
    """Every step is late, so that all levels of effort are used; the schedule records them."""
    results = Results()
    slow = Fault("slow", frozenset(stamps()), 0.26)
    run = live(results, makers=faulty("mapping", slow))
    decision = feed_all(run)
    assert set(run.schedule.effort) == {0, 1, 2, 3}
    assert len(run.schedule.effort) == len(run.schedule.mapped)
    assert_flies_again(results, decision, run.schedule)


def test_a_process_that_is_not_let_run_is_not_taken_for_hanging(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call is lost if the process sleeps, or has worked for longer than the patience; otherwise it gets its time."""
    monkeypatch.setattr("alight.flight.live.lane_process.HARD_TIMEOUT_FACTOR", 1e3)  # on a machine that is never busy
    lane = LaneProcess(LaneSpec("any", IdleOrBusy, (), patience=1.0))
    assert lane.call("work", 0.2) == 0.2
    lane.patience = 0.5
    assert lane.call("work", 0.45) == 0.45
    lane.patience = 0.3
    with pytest.raises(LaneLost, match=r"no answer within 0\.3 s"):
        lane.call("work", 5.0)
    with pytest.raises(LaneLost, match=r"no answer within 0\.3 s"):
        lane.call("sleep", 1e4)
    lane.close()
