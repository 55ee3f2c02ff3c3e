"""The navigation lane on two threads: the same motions as in turn, bit for bit, and what it drops when too slow."""

from __future__ import annotations

import threading
import time
from functools import cache

import cv2
import numpy as np
import pytest

from alight.geometry import Camera
from alight.live import Closed, Mailbox, SideBySide
from alight.pipeline.side_by_side import Desk, FilterStep, TrackingStep, forecast_for
from alight.records import Event, Frame, ImuSample, Motion, MotionState, NavSample, Rig, RigCamera
from alight.settings import Settings, load_settings
from alight_sim import SimulatedFlight, default_rig, fly

LENS = Camera(160, 120, 120.0, 120.0, 79.3, 59.8)


@cache
def flight() -> tuple[SimulatedFlight, tuple[Event, ...]]:
    """40 m over the demo's meadow, 15 m above it, two cameras of 160 x 120."""
    rig = Rig(tuple(RigCamera(c.name, LENS, c.body_from_cam) for c in default_rig().cameras))
    f = fly("demo", 1, 5.0, rig=rig, rate_hz=6.0, height=15.0)
    return f, tuple(f.events())


def settings() -> Settings:
    return load_settings("", ["tuning.tracks.count=40", "tuning.filter.points=16", "tuning.filter.smooth=false"])


def in_turn(events: tuple[Event, ...]) -> list[Motion]:
    """The two steps one after the other: what the threads must give."""
    rig, desk, out = flight()[0].rig, Desk(), []
    tracking, filtering = TrackingStep(rig, settings().stages()), FilterStep(rig, settings().stages())
    forecasts = []
    for e in events:
        job = desk.take(e)
        if job is not None:
            tracking.hear(job.before)
            heard = filtering.hear(job.before)
            if job.frame is None:
                continue
            forecasts = forecasts or [heard]
            motion, forecast = filtering.see(tracking.run(job.frame, forecasts[forecast_for(len(forecasts) - 1)]))
            forecasts.append(forecast)
            out += [motion] if motion else []
    return out


def bits(motions: list[Motion]) -> list[bytes]:
    return [m.world_from_cams[0].matrix.tobytes() + m.covariance.tobytes() for m in motions]


def test_two_threads_give_what_one_gives() -> None:
    rig, events = flight()[0].rig, flight()[1]
    told: list[Motion] = []
    lane = SideBySide(rig, settings(), drop=False, tell=told.append)
    for e in events:
        lane.feed(e)
    motions = lane.finish()
    assert len(motions) == 31
    assert told == motions
    assert motions[-1].state is MotionState.GOOD
    assert bits(motions) == bits(in_turn(events))


def test_it_is_as_good_as_predicting_from_the_last_exposure() -> None:
    f, events = flight()
    last = in_turn(events)[-1]
    off = last.world_from_body.rotation @ f.pose(last.t_ns).rotation.T
    assert np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)) < np.radians(2.0)
    assert last.tracks >= 16


def test_what_was_used_flies_again_bit_for_bit() -> None:
    """A mailbox of one and events as fast as they go: exposures are dropped, GPS/INS and IMU rows are not; the
    exposures that were used, fed again in turn, give the same bits."""
    rig, events = flight()[0].rig, flight()[1]
    lane = SideBySide(rig, settings(), size=1)
    slow = lane._tracking.run
    lane._tracking.run = lambda frame, forecast: (time.sleep(0.02), slow(frame, forecast))[1]  # type: ignore[method-assign]
    for e in events:
        if isinstance(e, Frame):
            time.sleep(0.005)
        lane.feed(e)
    motions = lane.finish()
    assert len(lane.consumed) < 31
    used = tuple(e for e in events if not isinstance(e, Frame) or e.t_ns in set(lane.consumed))
    assert [m.t_ns for m in motions] == list(lane.consumed)
    assert bits(motions) == bits(in_turn(used))


def test_a_thread_that_fails_says_so(caplog: pytest.LogCaptureFixture) -> None:
    lane = SideBySide(flight()[0].rig, settings(), drop=False)
    wrong = Frame(1, (np.zeros((3, 3, 3, 3), np.uint8), None))
    lane.feed(wrong)
    with pytest.raises(cv2.error):
        lane.finish()
    with pytest.raises(cv2.error):
        lane.feed(wrong)
    assert "has failed" in caplog.text
    assert not any(t.is_alive() for t in lane._threads)


def test_nothing_grows_with_the_flight() -> None:
    """Asked to keep five exposures, it keeps the last five; the filter records nothing, whatever the settings say."""
    rig, events = flight()[0].rig, flight()[1]
    told: list[int] = []
    smoothing = load_settings("", ["tuning.tracks.count=40"])
    lane = SideBySide(rig, smoothing, drop=False, tell=lambda m: told.append(m.t_ns), keep=5)
    for e in events:
        lane.feed(e)
    assert [m.t_ns for m in lane.finish()] == list(lane.consumed) == told[-5:]
    assert len(told) == 31
    assert lane._filtering.filter.smoothed() == []


def test_cameras_that_fail_leave_nothing_waiting() -> None:
    """No exposure for long: before the first, old rows go; after it, the filter hears of all of them all the same."""
    rows = [e for e in flight()[1] if not isinstance(e, Frame)] * 4
    desk, frame = Desk(), next(e for e in flight()[1] if isinstance(e, Frame))
    assert all(desk.take(e) is None for e in rows)
    first = desk.take(frame)
    assert first is not None
    assert list(first.before) == rows[-1000:]
    jobs = [j for j in (desk.take(e) for e in [*rows, frame]) if j is not None]
    assert [j.frame for j in jobs] == [None] * (len(jobs) - 1) + [frame]
    assert [e for j in jobs for e in j.before] == rows
    assert max(len(j.before) for j in jobs) <= 1001


def test_no_exposure_no_motion() -> None:
    lane = SideBySide(flight()[0].rig, settings())
    for e in flight()[1]:
        if isinstance(e, NavSample | ImuSample):
            lane.feed(e)
    assert lane.finish() == []


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
