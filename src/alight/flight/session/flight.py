"""The whole of a flown landing: checks, take-off, search to touchdown, and a folder of results."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from alight import compiled
from alight.checks.result import CheckResult, Judged, bad
from alight.flight.autopilot import RemoteVehicle
from alight.flight.live.health import FlightHealth
from alight.flight.live.live import Listener
from alight.flight.live.run import LiveRequest, LiveRun
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.flight.session.arrivals import Arrivals
from alight.flight.session.loop import STEP, TAKEN, FlightLoop
from alight.flight.session.order_taker import OrderTaker, SpokenVehicle
from alight.flight.session.pilot import LandingPilot, PilotView
from alight.outputs import prepare_folder
from alight.pipeline import FlightPolicy
from alight.records import Event, Frame, Home, InputError, NoticeKind, RunResult, Telemetry
from alight.records.executive import FlightState, LookRecord, Transition
from alight.runs import flown_home, with_home
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.live import LiveSource, as_they_arrive, open_sensors

PATIENCE = 90.0  # s that the checks may take until no result is bad: an autopilot that was just started needs 40
SETTLED = 8.0  # s after which warnings are accepted
TELL_EVERY, TELEMETRY_EVERY = 0.2, 0.2  # s
USUAL_RATE = 5.0  # exposures a second, assumed before the first has come
UNASKED = (NoticeKind.TAKEOVER, NoticeKind.REBOOT, NoticeKind.LINK_LOST, NoticeKind.LINK_BACK, NoticeKind.TEXT)
REFUSED = "the checks before the flight found something bad"


@dataclass(frozen=True)
class FlightRequest:
    """Options of one flown landing."""

    link: str  # udp:127.0.0.1:14550
    camera: str  # cameras, or a folder that is being filled
    out: Path
    settings: Settings
    rig: Path | None = None  # calibration of cameras
    dry_run: bool = False  # orders are written in words, not sent
    home: Home | None = None  # for route.plan; None: the autopilot's; without a separation, the receiver's
    separation: float | None = None  # metres, ellipsoid minus sea level; None: the receiver's
    take_off: float | None = None  # metres above home; None: it flies already
    imu_rate: float = 100.0  # Hz requested of the autopilot; 0: no IMU
    record: bool = True
    overwrite: bool = False


@dataclass(frozen=True, eq=False)
class FlightStatus:
    """A flight at one moment, for a display; None where a part does not exist yet."""

    phase: str  # checks, take-off, landing
    checks: Sequence[CheckResult] = ()
    view: PilotView | None = None
    telemetry: Telemetry | None = None
    health: FlightHealth | None = None


@dataclass(frozen=True, eq=False)
class FlightOutcome:
    """The end of a flight: its checks, the reason in words, and the result where a landing was begun."""

    checks: Sequence[CheckResult]
    why: str
    state: FlightState | None = None  # None: it was not begun
    result: RunResult | None = None
    way_point_times: Sequence[float] = ()  # s, exposure to the first order of the verdict that holds it
    set_point_times: Sequence[float] = ()  # s, exposure to the first set-point relative to its motion


Tell = Callable[[FlightStatus], None]
Say = Callable[[str], None]


def fly_vehicle(plan: FlightRequest, tell: Tell = lambda status: None, say: Say = lambda line: None) -> FlightOutcome:
    """Check, take off if wanted, search, look, land or give up. Ctrl-C ends it with the vehicle holding.

    Args:
        plan: options of the landing.
        tell: called with the status, some times a second.
        say: called with one line each for notices of the autopilot, changes of state, orders of a dry run.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written; the message says how to mend it.
    """
    if plan.dry_run and plan.take_off is not None:
        raise InputError("--take-off: a dry run sends nothing; leave it out, or leave out --dry-run")
    if plan.take_off is not None and plan.take_off < plan.settings.executive.search_height:
        raise InputError(
            f"--take-off {plan.take_off:g}: the search begins where the climb ends, before a map tells what stands "
            f"there; give at least executive.search_height, {plan.settings.executive.search_height:g} m, or lower that"
        )
    if plan.settings.too_low:
        raise InputError(plan.settings.too_low)
    if not plan.settings.executive.look_again:
        raise InputError("executive.look_again=false lands without looking: it is for campaigns; leave it out")
    prepare_folder(plan.out, plan.overwrite)
    over = threading.Event()
    opened = open_sensors(plan.camera, plan.settings, plan.rig, over.is_set)
    machine = preflight.judge_machine(
        compiled.is_warm(), plan.out, opened.source.rig, USUAL_RATE, plan.settings.executive.time_budget, plan.record
    )
    if any(c.verdict is Judged.BAD for c in machine):
        return FlightOutcome(machine, REFUSED)
    feed = TelemetryFeed(plan.link, None, plan.separation, {"HIGHRES_IMU": plan.imu_rate})
    try:
        met = _Meeting(plan, feed, tell, say)
        checks = met.wait(machine)
        if not feed.located:
            return FlightOutcome(checks, REFUSED)
        cabin = _Cabin(plan, opened, feed, machine, tell, say, over)
        try:
            return cabin.fly()
        finally:
            cabin.close()
    finally:
        over.set()
        feed.close()


def _until_well(
    checks: Callable[[], list[CheckResult]], tell: Callable[[list[CheckResult]], None], over: Callable[[], bool]
) -> list[CheckResult]:
    """Wait until no check is bad, and up to `SETTLED` s for warnings to end; `PATIENCE` s at most, or until `over`."""
    begin = time.monotonic()
    while True:
        found = checks()
        tell(found)
        verdicts, waited = {c.verdict for c in found}, time.monotonic() - begin
        settled = waited > SETTLED or Judged.WARNING not in verdicts
        if (Judged.BAD not in verdicts and settled) or waited > PATIENCE or over():
            return found
        time.sleep(STEP)


class _Meeting:
    """Waits until an autopilot is heard and reports its position."""

    def __init__(self, plan: FlightRequest, feed: TelemetryFeed, tell: Tell, say: Say) -> None:
        self._plan, self._feed, self._tell, self._say, self._refused = plan, feed, tell, say, ""

    def wait(self, machine: Sequence[CheckResult]) -> list[CheckResult]:
        """Return the findings, those of the machine first, when its position is known or `PATIENCE` is over."""
        begin, found = time.monotonic(), list[CheckResult]()
        while not self._feed.located and time.monotonic() - begin < PATIENCE:
            found = [*machine, *self._checks()]
            self._tell(FlightStatus("checks", found))
            time.sleep(STEP)
        return found

    def _checks(self) -> list[CheckResult]:
        with self._feed.lock:
            notices = self._feed.autopilot.notices()
            refused = [n.text for n in notices if n.kind is NoticeKind.FOUND and not n.ok]
            self._refused = refused[-1] if refused else self._refused
            found = autopilot_checks(self._plan, self._feed, self._refused)
        for notice in notices:
            if notice.kind is NoticeKind.TEXT:
                self._say(f"autopilot: {notice.text}")
        return found


def autopilot_checks(plan: FlightRequest, feed: TelemetryFeed, refused: str = "") -> list[CheckResult]:
    """Check the link and the autopilot behind it; the feed's lock must be held."""
    vehicle = feed.autopilot.vehicle
    found = preflight.judge_link(plan.link, feed.autopilot.counts.messages, vehicle, refused)
    if vehicle is None:
        return found
    take_off, home = plan.take_off is not None, plan.home is not None
    missing = feed.events_of.missing
    checks = preflight.judge_vehicle(vehicle, missing, plan.settings, take_off, plan.dry_run, home)
    return [*found, *checks, preflight.judge_imu(vehicle, plan.imu_rate)]


class _Cabin:
    """The lanes, the pilot and the vehicle of one flight."""

    def __init__(
        self, plan: FlightRequest, opened: LiveSource, feed: TelemetryFeed, machine: Sequence[CheckResult],
        tell: Tell, say: Say, over: threading.Event,
    ) -> None:  # fmt: skip
        assert feed.events_of.local is not None
        assert feed.autopilot.vehicle is not None
        assert isinstance(opened.source, CalibratedFolder)
        opened.source.locate(feed.events_of.local)
        self._plan, self._opened, self._feed, self._over = plan, opened, feed, over
        self._machine, self._tell, self._say = machine, tell, say
        self._vehicle: RemoteVehicle = feed.autopilot.vehicle
        self._hand: OrderTaker = SpokenVehicle(self._said_order) if plan.dry_run else self._vehicle
        settings, policy = plan.settings, FlightPolicy(every=0)  # judged as the executive needs it
        self._pilot = LandingPilot(settings, feed.events_of.local, self._vehicle, self._hand, policy, self)
        self._loop = FlightLoop(feed, self._vehicle, self._hand, self._pilot, self._status)
        listener = Listener(self._pilot.inputs.add_motion, self._pilot.inputs.add_verdict)
        request = LiveRequest(plan.out, settings, plan.record, True, plan.overwrite)
        self._run = LiveRun(opened.source, request, listener, policy)
        self._arrivals, self._failed = Arrivals(), list[BaseException]()
        self._told = self._recorded = -math.inf
        self._checks: list[CheckResult] = []
        self._stopped = ""  # in words, after a stop by the user, with the vehicle's action

    def close(self) -> None:
        """End the lanes."""
        self._over.set()
        self._run.close()

    def fly(self) -> FlightOutcome:
        """Check, take off, land."""
        self._run.live.wait_until_ready()
        events = as_they_arrive(self._opened.events, self._feed.events())
        feeder = threading.Thread(target=self._pass_on, args=(events,), daemon=True)
        feeder.start()
        try:
            if why := self._refusal():
                return FlightOutcome(self._checks, why)
            self._land()
        except BaseException:
            if not self._loop.taken:
                self._say(f"fly: {self._loop.hold()}")
            raise
        self._over.set()
        feeder.join(12.0)  # as long as a camera may be silent
        return self._finished()

    def _pass_on(self, events: Iterator[Event]) -> None:
        try:
            for event in events:
                if self._over.is_set():
                    return
                fresh: Event | None = event
                if isinstance(event, Frame):
                    now_ns = time.monotonic_ns()
                    known = self._arrivals.saw(event, now_ns)
                    fresh = self._pilot.inputs.add_frame(event, now_ns) if known else None
                if fresh is not None:
                    self._run.live.feed(fresh)
        except BaseException as e:  # the executive notices that pictures or motions do not come, and gives up
            self._failed.append(e)

    # -- recording and lines of text

    def order(self, t_ns: int, state: str, words: str) -> None:
        """As `LandingLog.order`: record it."""
        if self._run.recorder is not None:
            self._run.recorder.order(t_ns, state, words)

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """As `LandingLog.landing`: record it and pass on its line."""
        if self._run.recorder is not None:
            self._run.recorder.landing(t_ns, entry)
        self._say(entry.line)

    def note(self, lane: str, words: str) -> None:
        """As `LandingLog.note`: record it and pass on its line."""
        if self._run.recorder is not None:
            self._run.recorder.note(lane, words)
        self._say(f"{lane}: {words}")

    def _said_order(self, words: str) -> None:
        self._say(f"order, not sent: {words}")

    def _hear(self) -> Telemetry:
        """Pass new notices to the pilot and record the telemetry; return it."""
        now_ns, notices = time.monotonic_ns(), self._loop.listen()
        with self._feed.lock:
            heard = self._vehicle.telemetry
        for notice in notices:
            if notice.kind in UNASKED or not notice.ok:
                self.note("autopilot", notice.text)
        if now_ns * 1e-9 - self._recorded > TELEMETRY_EVERY and self._run.recorder is not None:
            self._recorded = now_ns * 1e-9
            self._run.recorder.telemetry(now_ns, heard)
        return heard

    def _status(self, phase: str, view: PilotView | None = None) -> None:
        heard, now = self._hear(), time.monotonic()
        if now - self._told > TELL_EVERY:
            self._told = now
            self._tell(FlightStatus(phase, self._checks, view, heard, self._run.live.health))

    # -- before the landing

    def _refusal(self) -> str:
        """Check and take off; return the reason why no landing is begun, or an empty string."""
        height = self._plan.take_off
        if not self._well(lambda: self._before(motion=height is None)):
            return REFUSED
        if height is None:
            return ""
        if why := self._loop.take_off(height, lambda hint: self.note("take-off", hint)):
            return f"take-off: {why}"
        known = self._well(lambda: [self._motion_check()], lambda: self._loop.taken)
        if self._loop.taken:  # a landing would take control from somebody else
            return TAKEN
        return "" if known else f"the motion is not known after the take-off; {self._loop.hold()}"

    def _well(self, checks: Callable[[], list[CheckResult]], over: Callable[[], bool] = lambda: False) -> bool:
        def tell(found: list[CheckResult]) -> None:
            self._checks = found
            self._status("checks")

        self._checks = _until_well(checks, tell, over)
        return not any(c.verdict is Judged.BAD for c in self._checks)

    def _before(self, motion: bool) -> list[CheckResult]:
        with self._feed.lock:
            found = [*self._machine, *autopilot_checks(self._plan, self._feed)]
        facts = self._arrivals.facts(time.monotonic_ns(), self._pilot.inputs.pictures.frozen)
        found.append(preflight.judge_cameras(facts))
        found += [bad("source", str(e), "see that it goes on") for e in self._failed]
        return [*found, self._motion_check()] if motion else found

    def _motion_check(self) -> CheckResult:
        m = self._pilot.inputs.motion
        return preflight.judge_motion(m, math.inf if m is None else (time.monotonic_ns() - m.t_ns) * 1e-9)

    # -- the landing

    def _land(self) -> None:
        try:
            self._loop.land(self._plan.take_off is not None, self._ended)
        except KeyboardInterrupt:
            self._stopped = self._loop.hold()
            self._run.live.warnings.append(f"fly: ended by Ctrl-C; {self._stopped}")

    def _ended(self) -> bool:
        return self._pilot.over or (self._plan.dry_run and self._pilot.state is FlightState.RETURN)

    def _finished(self) -> FlightOutcome:
        pilot, plan = self._pilot, self._plan
        ended, why = pilot.diary.end or (pilot.state, "")
        why = f"ended by the user; {self._stopped}" if self._stopped else why
        times = {
            "image to way-point": list(pilot.delays.of_verdicts),
            "image to set-point": list(pilot.delays.of_motions),
        }
        found = self._run.finish()
        result = replace(
            with_home(found, flown_home(plan.home, self._vehicle.telemetry, plan.separation)), diary=pilot.diary,
            timings={**found.timings, **{k: v for k, v in times.items() if v}},
            notes={**found.notes, "landing": ended.value},
        )  # fmt: skip
        return FlightOutcome(self._checks, why, ended, result, *times.values())
