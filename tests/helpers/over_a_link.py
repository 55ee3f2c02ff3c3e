"""Our side of an autopilot over a real link."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

from alight.flight.autopilot import Autopilot, Link, TelemetryEvents, open_link
from alight.records import InputError


def free_port() -> int:
    """A UDP port of this machine that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def drive(link: Link, ours: Autopilot, seconds: float, until: Callable[[], bool]) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for data in link.read(0.02):
            ours.receive(data, time.monotonic_ns())
        ours.tick(time.monotonic_ns())
        for data in ours.pending():
            link.write(data)
        if until():
            return True
    return False


def ready_vehicle(sitl: str, events: TelemetryEvents) -> tuple[Any, Autopilot, Any]:
    """Return the link to a simulator that was just started, our side of it, and its vehicle, ready to fly."""
    link, end = None, time.monotonic() + 30
    while link is None:
        try:
            link = open_link(sitl)
        except InputError:
            assert time.monotonic() < end
            time.sleep(0.5)
    ours = Autopilot(events=events)
    assert drive(link, ours, 90, lambda: ours.telemetry is not None and ours.telemetry.ready), ours.notices()
    vehicle = ours.vehicle
    assert vehicle is not None
    return link, ours, vehicle
