"""The session of `alight fly` in virtual time, around the vehicle of a rig."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pilot_rig import PilotRig
from some_run import some_run

from alight.checks.result import bad, good
from alight.flight.session.checks import FlightChecks
from alight.flight.session.flight import FlightSession
from alight.flight.session.pilot import SessionLog
from alight.flight.session.request import FlightRequest
from alight.settings import Settings


class Clock:
    """Replacement of the module `time`: a sleep lets the rig step on."""

    def __init__(self, r: PilotRig) -> None:
        self._r = r

    def monotonic(self) -> float:
        return self._r.t

    def monotonic_ns(self) -> int:
        return self._r.now_ns

    def sleep(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / self._r.dt))):
            self._r.step()


def session_of(
    r: PilotRig,
    monkeypatch: pytest.MonkeyPatch,
    lines: list[str],
    on_status: Any = lambda status: None,
    take_off: float | None = None,
) -> FlightSession:
    """Return the session of `alight fly` around the rig's vehicle, in the rig's time, without lanes and files."""
    r.ticks = False
    for module in ("checks", "flight"):
        monkeypatch.setattr(f"alight.flight.session.{module}.time", Clock(r))
    feed: Any = SimpleNamespace(lock=nullcontext(), autopilot=r.ours, flush=lambda: None)
    watch = SimpleNamespace(counts={})
    live = SimpleNamespace(wait_until_ready=lambda: None, warnings=[], health=None, watch=watch)
    run: Any = SimpleNamespace(live=live, finish=some_run)
    plan = FlightRequest("udp:x", "camera:0", Path("out"), Settings(), take_off=take_off)
    checks = FlightChecks(plan, feed, [])
    monkeypatch.setattr(checks, "before_flight", lambda inputs, motion: [good("link", "it is")])
    monkeypatch.setattr(checks, "of_motion", lambda inputs: bad("motion", "none is known yet", "wait"))
    return FlightSession(plan, feed, checks, r.pilot, run, iter(()), SessionLog(lines.append), on_status)
