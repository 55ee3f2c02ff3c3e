"""The end of a flown landing, with its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from alight.checks.result import CheckResult
from alight.flight.live.run import LiveRun
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session.pilot import LandingPilot
from alight.flight.session.request import FlightRequest
from alight.records import RunResult, Telemetry, p_safe_text
from alight.records.executive import FlightDiary, FlightState
from alight.runs import flown_home, with_home


@dataclass(frozen=True, eq=False)
class FlightOutcome:
    """The end of a flight: its checks, the reason in words, and the result if a landing was begun."""

    checks: Sequence[CheckResult]
    why: str  # reason of the end, in words
    state: FlightState | None = None  # None: no landing was begun
    result: RunResult | None = None


def landing_outcome(
    plan: FlightRequest, checks: Sequence[CheckResult], pilot: LandingPilot, run: LiveRun, feed: TelemetryFeed,
    stopped: str,
) -> FlightOutcome:  # fmt: skip
    """End the lanes of a landing, and return its outcome.

    `stopped`: the vehicle's action in words after a stop by the user; empty: the landing ended by itself.
    """
    assert feed.autopilot.vehicle is not None
    reports = feed.autopilot.vehicle.telemetry
    ended, why = pilot.diary.end or (pilot.state, "")
    why = f"ended by the user; {stopped}" if stopped else why
    run.live.watch.counts.update({f"link: messages {cause}": n for cause, n in feed.autopilot.dropped.items()})
    found = run.finish()
    if ended is FlightState.LANDED:  # the answer is where it stands; other sites, and a route, mislead
        why, found = f"{why}{_landing_place(reports, pilot.diary)}", replace(found, route=None)
    result = replace(
        with_home(found, flown_home(plan.home, reports, plan.separation)), diary=pilot.diary,
        timings={**found.timings, **{k: list(v) for k, v in pilot.delays.items() if v}},
        notes={**found.notes, "landing": ended.value},
    )  # fmt: skip
    return FlightOutcome(checks, why, ended, result)


def _landing_place(reports: Telemetry, diary: FlightDiary) -> str:
    place, p_safe = reports.place, diary.transitions[-1].p_safe
    at = "" if place is None else f", at {place.latitude:.7f} {place.longitude:.7f}"
    return at if p_safe is None else f"{at}, P(safe) {p_safe_text(p_safe)}"
