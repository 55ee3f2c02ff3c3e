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
from alight.flight.live.health import FlightHealth
from alight.flight.live.live import Listener
from alight.flight.live.run import LiveRequest, LiveRun
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.flight.session.dry_run import DryRunVehicle, VehicleCommands
from alight.flight.session.loop import STEP, TAKEN, FlightLoop
from alight.flight.session.pilot import LandingPilot, PilotView
from alight.outputs import prepare_folder
from alight.outputs.recorder import Recorder
from alight.pipeline import FlightPolicy
from alight.records import Event, Frame, Home, InputError, NoticeKind, RunResult, Telemetry
from alight.records.executive import FlightState, LookRecord, Transition
from alight.runs import flown_home, with_home
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.live import LiveSource, as_they_arrive, open_sensors

PATIENCE = 90.0  # s that the checks may take until no result is bad: an autopilot that was just started needs 40
SETTLED = 8.0  # s after which warnings are accepted
SHOW_EVERY = 0.2  # s between two statuses, and two recorded reports of the autopilot
USUAL_RATE = 5.0  # exposures a second, assumed before the first has come
UNEXPECTED = (NoticeKind.TAKEOVER, NoticeKind.REBOOT, NoticeKind.LINK_LOST, NoticeKind.LINK_BACK, NoticeKind.TEXT)
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

    def validate(self) -> None:
        """Raise InputError, with the remedy, if no landing can be flown with these options."""
        executive = self.settings.executive
        if self.dry_run and self.take_off is not None:
            raise InputError("--take-off: a dry run sends nothing; leave it out, or leave out --dry-run")
        if self.take_off is not None and self.take_off < executive.search_height:
            raise InputError(
                f"--take-off {self.take_off:g}: the search begins where the climb ends, before a map tells what stands "
                f"there; give at least executive.search_height, {executive.search_height:g} m, or lower that"
            )
        if self.settings.too_low:
            raise InputError(self.settings.too_low)
        if not executive.look_again:
            raise InputError("executive.look_again=false lands without looking: it is for campaigns; leave it out")


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


OnStatus = Callable[[FlightStatus], None]
OnLine = Callable[[str], None]


def fly_vehicle(
    plan: FlightRequest, on_status: OnStatus = lambda status: None, on_line: OnLine = lambda line: None
) -> FlightOutcome:
    """Check, take off if wanted, search, look, land or give up. Ctrl-C ends it with the vehicle holding.

    Args:
        on_status: called with the status, some times a second.
        on_line: called with one line each for notices of the autopilot, changes of state, orders of a dry run.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written; the message says how to mend it.
    """
    plan.validate()
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
        checks = wait_for_vehicle(plan, feed, machine, on_status, on_line)
        if not feed.located:
            return FlightOutcome(checks, REFUSED)
        session = open_session(plan, opened, feed, machine, on_status, on_line)
        try:
            return session.fly(over)
        finally:
            over.set()
            session.close()
    finally:
        over.set()
        feed.close()


def wait_for_vehicle(
    plan: FlightRequest, feed: TelemetryFeed, machine: Sequence[CheckResult], on_status: OnStatus, on_line: OnLine
) -> list[CheckResult]:
    """Wait until an autopilot has reported its position, or for `PATIENCE`; return the newest checks."""
    begin, found, refused = time.monotonic(), list[CheckResult](), ""
    while not feed.located and time.monotonic() - begin < PATIENCE:
        with feed.lock:
            notices = feed.autopilot.notices()
            refused = next((n.text for n in reversed(notices) if n.kind is NoticeKind.FOUND and not n.ok), refused)
            found = [*machine, *autopilot_checks(plan, feed, refused)]
        for notice in notices:
            if notice.kind is NoticeKind.TEXT:
                on_line(f"autopilot: {notice.text}")
        on_status(FlightStatus("checks", found))
        time.sleep(STEP)
    return found


def autopilot_checks(plan: FlightRequest, feed: TelemetryFeed, refused: str = "") -> list[CheckResult]:
    """Check the link and the autopilot behind it; the feed's lock must be held."""
    vehicle = feed.autopilot.vehicle
    found = preflight.judge_link(plan.link, feed.autopilot.messages, vehicle, refused)
    if vehicle is None:
        return found
    take_off, home = plan.take_off is not None, plan.home is not None
    missing = feed.events_of.missing
    checks = preflight.judge_vehicle(vehicle, missing, plan.settings, take_off, plan.dry_run, home)
    return [*found, *checks, preflight.judge_imu(vehicle, plan.imu_rate)]


class FlightChecks:
    """The checks of a vehicle with its cameras, before it takes off or lands."""

    def __init__(self, plan: FlightRequest, loop: FlightLoop, machine: Sequence[CheckResult]) -> None:
        self._plan, self._loop, self._machine = plan, loop, machine
        self.arrivals = preflight.Arrivals()
        self.failed: list[BaseException] = []  # errors of the source

    def before(self, motion: bool) -> list[CheckResult]:
        """Check the machine, the autopilot and the cameras; `motion`: the motion as well."""
        with self._loop.feed.lock:
            found = [*self._machine, *autopilot_checks(self._plan, self._loop.feed)]
        facts = self.arrivals.facts(time.monotonic_ns(), self._loop.pilot.inputs.pictures.frozen)
        found.append(preflight.judge_cameras(facts))
        found += [bad("source", str(e), "see that it goes on") for e in self.failed]
        return [*found, self.motion()] if motion else found

    def motion(self) -> CheckResult:
        """Check that the motion is known."""
        m = self._loop.pilot.inputs.motion
        return preflight.judge_motion(m, math.inf if m is None else (time.monotonic_ns() - m.t_ns) * 1e-9)


class SessionLog:
    """Log of a landing (`LandingLog`): into the recording, where one is made, and as lines of text."""

    def __init__(self, on_line: OnLine) -> None:
        self.on_line = on_line
        self.recorder: Recorder | None = None

    def order(self, t_ns: int, state: str, words: str) -> None:
        """As `LandingLog.order`."""
        if self.recorder is not None:
            self.recorder.order(t_ns, state, words)

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """As `LandingLog.landing`."""
        if self.recorder is not None:
            self.recorder.landing(t_ns, entry)
        self.on_line(entry.line)

    def note(self, lane: str, words: str) -> None:
        """As `LandingLog.note`."""
        if self.recorder is not None:
            self.recorder.note(lane, words)
        self.on_line(f"{lane}: {words}")


def open_session(
    plan: FlightRequest, opened: LiveSource, feed: TelemetryFeed, machine: Sequence[CheckResult], on_status: OnStatus,
    on_line: OnLine,
) -> FlightSession:  # fmt: skip
    """Open the lanes of a flight; arguments as of `FlightSession`."""
    local, vehicle = feed.events_of.local, feed.autopilot.vehicle
    assert local is not None
    assert vehicle is not None
    assert isinstance(opened.source, CalibratedFolder)
    opened.source.locate(local)
    commands: VehicleCommands = vehicle
    if plan.dry_run:
        commands = DryRunVehicle(lambda text: on_line(f"order, not sent: {text}"))
    log, policy = SessionLog(on_line), FlightPolicy(every=0)  # judged as the executive needs it
    pilot = LandingPilot(plan.settings, local, vehicle, commands, policy, log)
    listener = Listener(pilot.inputs.add_motion, pilot.inputs.add_verdict)
    request = LiveRequest(plan.out, plan.settings, plan.record, True, plan.overwrite)
    run = LiveRun(opened.source, request, listener, policy)
    log.recorder, loop = run.recorder, FlightLoop(feed, vehicle, pilot, plan.dry_run)
    checks, events = FlightChecks(plan, loop, machine), as_they_arrive(opened.events, feed.events())
    return FlightSession(plan, events, run, loop, checks, log, on_status)


class FlightSession:
    """The lanes, the pilot and the vehicle of one flight.

    Args:
        on_status: called with the status, some times a second.
    """

    def __init__(
        self, plan: FlightRequest, events: Iterator[Event], run: LiveRun, loop: FlightLoop, checks: FlightChecks,
        log: SessionLog, on_status: OnStatus,
    ) -> None:  # fmt: skip
        self._plan, self._events, self._run, self._loop = plan, events, run, loop
        self._checks, self._log, self._on_status = checks, log, on_status
        self._shown = self._recorded = -math.inf
        self._found: list[CheckResult] = []  # by the newest checks

    def close(self) -> None:
        """End the lanes."""
        self._run.close()

    def fly(self, over: threading.Event) -> FlightOutcome:
        """Check, take off, land. `over` is set when the landing has ended, and ends the events."""
        self._run.live.wait_until_ready()
        feeder = threading.Thread(target=self._feed, args=(over,), daemon=True)
        feeder.start()
        try:
            if why := self._refusal():
                return FlightOutcome(self._found, why)
            stopped = self._land()
        except BaseException:
            if not self._loop.taken:
                self._log.on_line(f"fly: {self._loop.hold()}")
            raise
        over.set()
        feeder.join(12.0)  # as long as a camera may be silent
        return self._outcome(stopped)

    def _feed(self, over: threading.Event) -> None:
        """Pass the events to the lanes."""
        try:
            for event in self._events:
                if over.is_set():
                    return
                fresh: Event | None = event
                if isinstance(event, Frame):
                    now_ns = time.monotonic_ns()
                    of_now = self._checks.arrivals.add(event, now_ns)
                    fresh = self._loop.pilot.inputs.add_frame(event, now_ns) if of_now else None
                if fresh is not None:
                    self._run.live.feed(fresh)
        except BaseException as e:  # the executive notices that pictures or motions do not come, and gives up
            self._checks.failed.append(e)

    def _on_step(self, phase: str, view: PilotView | None = None) -> None:
        """Log new notices, record the telemetry, and show the status."""
        now_ns, notices = time.monotonic_ns(), self._loop.listen()
        with self._loop.feed.lock:
            reports = self._loop.vehicle.telemetry
        for notice in notices:
            if notice.kind in UNEXPECTED or not notice.ok:
                self._log.note("autopilot", notice.text)
        if now_ns * 1e-9 - self._recorded > SHOW_EVERY and self._log.recorder is not None:
            self._recorded = now_ns * 1e-9
            self._log.recorder.telemetry(now_ns, reports)
        if (now := time.monotonic()) - self._shown > SHOW_EVERY:
            self._shown = now
            self._on_status(FlightStatus(phase, self._found, view, reports, self._run.live.health))

    def _refusal(self) -> str:
        """Check and take off; return the reason why no landing is begun, or an empty string."""
        height = self._plan.take_off
        if not self._is_well(lambda: self._checks.before(motion=height is None)):
            return REFUSED
        if height is None:
            return ""
        if why := self._loop.take_off(height, self._on_step, lambda hint: self._log.note("take-off", hint)):
            return f"take-off: {why}"
        known = self._is_well(lambda: [self._checks.motion()], lambda: self._loop.taken)
        if self._loop.taken:  # a landing would take control from somebody else
            return TAKEN
        return "" if known else f"the motion is not known after the take-off; {self._loop.hold()}"

    def _is_well(self, checks: Callable[[], list[CheckResult]], over: Callable[[], bool] = lambda: False) -> bool:
        """Wait until no check is bad, and up to `SETTLED` s for warnings to end, or until `over`; False: one is bad."""
        begin = time.monotonic()
        while True:
            self._found = checks()
            self._on_step("checks")
            verdicts, waited = {c.verdict for c in self._found}, time.monotonic() - begin
            well = Judged.BAD not in verdicts
            settled = waited > SETTLED or Judged.WARNING not in verdicts
            if (well and settled) or waited > PATIENCE or over():
                return well
            time.sleep(STEP)

    def _land(self) -> str:
        """Land; return the vehicle's action after a stop by the user, else an empty string."""
        try:
            self._loop.land(self._plan.take_off is not None, self._on_step)
        except KeyboardInterrupt:
            stopped = self._loop.hold()
            self._run.live.warnings.append(f"fly: ended by Ctrl-C; {stopped}")
            return stopped
        return ""

    def _outcome(self, stopped: str) -> FlightOutcome:
        pilot, plan = self._loop.pilot, self._plan
        ended, why = pilot.diary.end or (pilot.state, "")
        why = f"ended by the user; {stopped}" if stopped else why
        times = {
            "image to way-point": list(pilot.delays.of_verdicts),
            "image to set-point": list(pilot.delays.of_motions),
        }
        found = self._run.finish()
        result = replace(
            with_home(found, flown_home(plan.home, self._loop.vehicle.telemetry, plan.separation)), diary=pilot.diary,
            timings={**found.timings, **{k: v for k, v in times.items() if v}},
            notes={**found.notes, "landing": ended.value},
        )  # fmt: skip
        return FlightOutcome(self._found, why, ended, result, *times.values())
