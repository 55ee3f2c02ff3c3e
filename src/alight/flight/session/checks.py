"""The checks before a landing, repeated until none is bad."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future

from alight.checks.result import CheckResult, Judged, bad, unknown
from alight.flight.autopilot.interference import counts_text
from alight.flight.live.sight import SightNavigation
from alight.flight.live.speed import Speed
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.flight.session.inputs import LandingInputs
from alight.flight.session.request import FlightRequest, FlightStatus, OnLine, OnStatus
from alight.records import NoticeKind

STEP = 0.05  # s between two ticks
PATIENCE = 90.0  # s, longest wait until no check is bad: an autopilot needs 40 s after its boot
SETTLED = 8.0  # s after which warnings are accepted


class FlightChecks:
    """The checks before a landing: of this computer, the link, the autopilot, the cameras and the motion.

    Args:
        plan: the landing.
        feed: its telemetry.
        machine: results of the checks of this computer that were made before.
    """

    def __init__(self, plan: FlightRequest, feed: TelemetryFeed, machine: Sequence[CheckResult]) -> None:
        self._plan, self._feed = plan, feed
        self.found = list(machine)  # the newest result of each check
        self.failed: list[BaseException] = []  # errors of the source of pictures
        self.sight: SightNavigation | None = None  # of the landing; None: no odometry is sent

    def wait_for_vehicle(self, speed: Future[Speed], on_status: OnStatus, on_line: OnLine) -> bool:
        """Wait until an autopilot has reported its position, and the speed of this computer is measured.

        After `PATIENCE` seconds, or once a bad result will not change, nothing is waited for any more.

        Args:
            speed: measurement that is being made.
            on_status, on_line: see `fly_vehicle`.

        Returns:
            Whether the position has come.
        """
        begin, machine, refused = time.monotonic(), self.found, ""
        while True:
            over = time.monotonic() - begin > PATIENCE
            is_measured, located = speed.done(), self._feed.located
            if is_measured:
                computer = preflight.judge_speed(speed.result(), self._plan.settings.stages().executive.unjudged)
            else:
                why = f"its speed was not measured in {PATIENCE:.0f} s" if over else "its speed is being measured"
                computer = unknown("computer", why)
            with self._feed.lock:
                notices = self._feed.autopilot.notices()
                refused = next((n.text for n in reversed(notices) if n.kind is NoticeKind.FOUND and not n.ok), refused)
                self.found = [*machine, computer, *self._of_autopilot(refused)]
            for notice in notices:
                if notice.kind in (NoticeKind.TEXT, NoticeKind.INTERFERENCE):
                    on_line(f"autopilot: {notice.text}")
            on_status(FlightStatus("checks", self.found))
            if located and (is_measured or over):
                self.found = [*machine, computer]  # the others are repeated
                return True
            if over or _is_hopeless(self.found):
                return False
            time.sleep(STEP)

    def repeat(
        self,
        checks: Callable[[], list[CheckResult]],
        on_step: Callable[[], object],
        is_over: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Repeat the checks until no result is bad, `is_over()` is true or time is up; return whether none is bad.

        A bad result that will not change ends them at once.
        Results of earlier checks are kept, unless one of the same name replaces them. `on_step` is called after each
        repetition.
        """
        begin, before = time.monotonic(), self.found
        while True:
            found = checks()
            names = {c.name for c in found}
            self.found = [*(c for c in before if c.name not in names), *found]
            on_step()
            verdicts, waited = {c.verdict for c in found}, time.monotonic() - begin
            well = Judged.BAD not in verdicts
            settled = waited > SETTLED or Judged.WARNING not in verdicts
            if (well and settled) or waited > PATIENCE or _is_hopeless(found) or is_over():
                return well
            time.sleep(STEP)

    def before_flight(self, inputs: LandingInputs, motion: bool) -> list[CheckResult]:
        """Return the checks of the autopilot and the cameras; with `motion`, also of the motion."""
        with self._feed.lock:
            found = self._of_autopilot()
        p = inputs.pictures
        found.append(preflight.judge_cameras(p.frames, p.rate(time.monotonic_ns()), p.delay, p.frozen))
        found += [bad("source", str(e), "see that it goes on") for e in self.failed]
        return [*found, self.of_motion(inputs), *self._of_odometry()] if motion else found

    def after_climb(self, inputs: LandingInputs) -> list[CheckResult]:
        """Return the checks that are only possible after the climb: of the motion and of the throttle stick."""
        with self._feed.lock:
            vehicle = self._feed.autopilot.vehicle
            throttle = [] if vehicle is None else preflight.judge_throttle(vehicle)
        return [self.of_motion(inputs), *self._of_odometry(), *throttle]

    def of_motion(self, inputs: LandingInputs) -> CheckResult:
        """Return the check that the motion is known."""
        m = inputs.motion
        return preflight.judge_motion(m, math.inf if m is None else (time.monotonic_ns() - m.t_ns) * 1e-9)

    def _of_odometry(self) -> list[CheckResult]:
        return [] if self.sight is None else [preflight.judge_odometry(self.sight)]

    def _of_autopilot(self, refused: str = "") -> list[CheckResult]:
        """Return the checks of the link and its autopilot; `refused`: see `judge_link`. The feed must be locked."""
        plan, feed, vehicle = self._plan, self._feed, self._feed.autopilot.vehicle
        dropped = counts_text(feed.autopilot.dropped)
        found = preflight.judge_link(plan.link, feed.autopilot.messages, vehicle, refused, dropped)
        if vehicle is None:
            return found
        take_off, home = plan.take_off is not None, plan.home is not None
        missing = feed.events_of.missing
        checks = preflight.judge_vehicle(vehicle, missing, plan.settings, take_off, plan.dry_run, home)
        stored = [*preflight.judge_parameters(vehicle, plan.odometry), *preflight.judge_fence(vehicle, plan.settings)]
        if plan.zones is not None:
            stored.append(preflight.judge_zones(vehicle, plan.zones, feed.events_of.local, plan.settings))
        return [*found, *checks, preflight.judge_imu(vehicle, plan.imu_rate), *stored]


def _is_hopeless(found: Sequence[CheckResult]) -> bool:
    """Whether a check found a fault that no wait mends."""
    return any(c.verdict is Judged.BAD and c.lasts for c in found)
