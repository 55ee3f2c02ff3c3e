"""The thread that listens to an autopilot: it survives errors, and a flight detects the end of listening."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
from over_a_link import free_port

from alight.flight.autopilot import RemoteVehicle
from alight.flight.live.telemetry import TelemetryFeed
from alight.records import FlightMode, NoticeKind
from alight_sim.autopilot import SimulatedAutopilot, UdpServer
from alight_sim.autopilot.dialects import Doing

LOCAL = "127.0.0.1"


@pytest.fixture
def pair() -> Iterator[tuple[TelemetryFeed, UdpServer]]:
    """A feed, and the simulated autopilot that it listens to."""
    port = free_port()
    feed = TelemetryFeed(f"udp:{LOCAL}:{port}")
    server = UdpServer(SimulatedAutopilot(), (LOCAL, port), speed=5.0)
    with server:
        assert wait(60.0, feed, lambda: feed.located)
        yield feed, server
        feed.close()


def wait(seconds: float, feed: TelemetryFeed, until: Callable[[], bool]) -> bool:
    """Test twenty times a second, as a flight does, and send the pending messages."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        feed.flush()
        if until():
            return True
        time.sleep(0.05)
    return until()


def vehicle(feed: TelemetryFeed) -> RemoteVehicle:
    assert feed.autopilot.vehicle is not None
    return feed.autopilot.vehicle


def test_the_listener_outlives_errors(
    pair: tuple[TelemetryFeed, UdpServer], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    feed, server = pair
    read, left = feed.link.read, [5]

    def faulty(timeout: float = 0.0) -> list[bytes]:
        left[0] -= 1
        if left[0] >= 0:
            raise ValueError("file descriptor cannot be a negative integer (-1)")
        return read(timeout)

    with caplog.at_level(logging.ERROR):
        monkeypatch.setattr(feed.link, "read", faulty)
        assert wait(60.0, feed, lambda: left[0] < -5)
    assert vehicle(feed).alive
    assert len(caplog.records) == 1  # the same error is logged once
    server.autopilot.pilot(Doing.RETURN)
    assert wait(60.0, feed, lambda: vehicle(feed).telemetry.mode is FlightMode.RETURN)


@pytest.mark.parametrize("dies", [True, False])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_flight_knows_when_nobody_listens(
    pair: tuple[TelemetryFeed, UdpServer], monkeypatch: pytest.MonkeyPatch, dies: bool
) -> None:
    """If the listener hangs or has ended, the link is lost, heartbeats grow old, and no order is sent any more."""
    feed, server = pair
    go_on, held = threading.Event(), threading.Event()

    def stuck(timeout: float = 0.0) -> list[bytes]:
        held.set()
        if dies:
            raise SystemExit
        go_on.wait(20.0)
        return []

    now = time.monotonic_ns()
    monkeypatch.setattr(
        "alight.flight.live.telemetry.time", SimpleNamespace(monotonic_ns=lambda: now, sleep=time.sleep)
    )
    monkeypatch.setattr(feed.link, "read", stuck)
    assert wait(60.0, feed, held.is_set)

    def pass_time(seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass until the condition holds; return the seconds that it took."""
        nonlocal now
        end = now + round(seconds * 1e9)
        while now < end and not until():
            now += 50_000_000
            feed.flush()
        return seconds - (end - now) * 1e-9

    assert 0.8 < pass_time(4.0, lambda: not vehicle(feed).alive) < 3.0
    pass_time(0.3)
    assert vehicle(feed).telemetry.ages["HEARTBEAT"] > 1.0
    assert [n.text for n in feed.autopilot.notices() if n.kind is NoticeKind.LINK_LOST] == [
        "nobody listens to the link"
    ]
    server.autopilot.pilot(Doing.PILOT)  # the takeover is not seen
    with feed.lock:
        vehicle(feed).set_mode(FlightMode.RETURN)
    wait(0.5, feed, lambda: False)
    assert server.autopilot.logic.doing is Doing.PILOT
    go_on.set()


def test_a_listener_that_comes_back_hears_the_vehicle_again(
    pair: tuple[TelemetryFeed, UdpServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    feed, _ = pair
    read, go_on = feed.link.read, threading.Event()

    def stuck(timeout: float = 0.0) -> list[bytes]:
        go_on.wait(20.0)
        return []

    monkeypatch.setattr(feed.link, "read", stuck)
    assert wait(60.0, feed, lambda: not vehicle(feed).alive)
    monkeypatch.setattr(feed.link, "read", read)
    go_on.set()
    assert wait(60.0, feed, lambda: vehicle(feed).alive)


def test_the_link_of_a_vehicle_that_is_lost_is_opened_again(
    pair: tuple[TelemetryFeed, UdpServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    feed, server = pair
    pending, opened = server.autopilot.pending, list[bool]()
    reopen = feed.link.reopen
    monkeypatch.setattr(feed.link, "reopen", lambda: (opened.append(True), reopen()))
    monkeypatch.setattr(server.autopilot, "pending", lambda: [])
    assert wait(60.0, feed, lambda: bool(opened))
    assert not vehicle(feed).alive
    monkeypatch.setattr(server.autopilot, "pending", pending)
    assert wait(60.0, feed, lambda: vehicle(feed).alive)
    assert len(opened) == 1


def test_a_flight_that_stood_still_itself_has_lost_nothing(pair: tuple[TelemetryFeed, UdpServer]) -> None:
    """The flight holds the lock for two seconds: the listener is blocked, and continues at once."""
    feed, _ = pair
    with feed.lock:
        time.sleep(2.0)
    feed.flush()
    assert vehicle(feed).alive
    wait(1.0, feed, lambda: False)
    assert not [n for n in feed.autopilot.notices() if n.kind is NoticeKind.LINK_LOST]
