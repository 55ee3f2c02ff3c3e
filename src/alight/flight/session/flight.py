"""A complete flown landing: checks, take-off, search to touchdown, and a folder of results."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

from alight import compiled
from alight.checks.result import CheckResult, Judged, bad
from alight.flight.autopilot import RemoteVehicle
from alight.flight.autopilot.interference import counts_text
from alight.flight.live.live import Listener
from alight.flight.live.run import LiveRequest, LiveRun
from alight.flight.live.signing_key import read_signing_key
from alight.flight.live.speed import measure_speed
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.flight.session.dry_run import DryRunVehicle, report_parameters
from alight.flight.session.pilot import LandingPilot, PilotView, SessionLog
from alight.flight.session.take_off import TakeOff
from alight.outputs import prepare_folder
from alight.outputs.reading import EarlierSite
from alight.pipeline import FlightPolicy
from alight.records import (
    Event,
    FlightMode,
    Frame,
    Home,
    InputError,
    Notice,
    NoticeKind,
    RunResult,
    Telemetry,
    p_safe_text,
)
from alight.records.executive import FlightState
from alight.runs import flown_home, with_home
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.live import LiveSource, as_they_arrive, open_sensors

STEP = 0.05  # s between two ticks
PATIENCE = 90.0  # s, longest wait until no check is bad: an autopilot needs 40 s after its boot
SETTLED = 8.0  # s after which warnings are accepted
SHOW_EVERY = 0.2  # s between two statuses, and two recorded reports of the autopilot
USUAL_RATE = 5.0  # exposures per second, assumed before the first has come
UNEXPECTED = (NoticeKind.TAKEOVER, NoticeKind.REBOOT, NoticeKind.LINK_LOST, NoticeKind.LINK_BACK, NoticeKind.TEXT)
TAKEN = "somebody else flies now: nothing is sent to the vehicle any more"
SILENT = "the vehicle is silent: nothing is sent to it any more"
LANDS = "the vehicle lands where it is, as the autopilot has refused to hold"
UNCONFIRMED = "the vehicle was ordered to hold and has not confirmed it: take over"
REFUSED = "the checks before the flight found something bad"


@dataclass(frozen=True)
class FlightRequest:
    """Options of one flown landing."""

    link: str  # udp:127.0.0.1:14550
    camera: str  # cameras, or a folder that is being filled
    out: Path
    settings: Settings
    rig: Path | None = None  # calibration of cameras
    dry_run: bool = False  # whether orders are only written in words
    home: Home | None = None  # for route.plan; None: the autopilot's. A missing separation is the receiver's
    separation: float | None = None  # metres, ellipsoidal height minus altitude above the sea; None: the receiver's
    take_off: float | None = None  # metres above home; None: the vehicle flies already
    imu_rate: float = 100.0  # Hz requested of the autopilot; 0: no IMU
    signing_key: Path | None = None  # file with the passphrase of the link's signatures
    record: bool = True
    overwrite: bool = False
    goals: tuple[EarlierSite, ...] = ()  # places to look at before the search, in this order

    def validate(self) -> None:
        """Raise InputError, with the remedy, if no landing can be flown with these options."""
        executive = self.settings.executive
        if self.dry_run and self.take_off is not None:
            raise InputError("--take-off: a dry run sends nothing; leave it out, or leave out --dry-run")
        if self.take_off is not None and self.take_off < executive.search_height:
            raise InputError(
                f"--take-off {self.take_off:g}: the search begins where the climb ends, before a map shows what stands "
                f"there; give at least executive.search_height, {executive.search_height:g} m, or lower that"
            )
        if self.settings.too_low:
            raise InputError(self.settings.too_low)
        if not executive.look_again:
            raise InputError("executive.look_again=false lands without looking: it is for campaigns; leave it out")


@dataclass(frozen=True, eq=False)
class FlightStatus:
    """A flight at one moment, for a display; a field is None until its part exists."""

    phase: str  # checks, take-off, landing
    checks: Sequence[CheckResult] = ()
    view: PilotView | None = None
    telemetry: Telemetry | None = None
    health: str | None = None  # state of the lanes, in one line


@dataclass(frozen=True, eq=False)
class FlightOutcome:
    """The end of a flight: its checks, the reason in words, and the result if a landing was begun."""

    checks: Sequence[CheckResult]
    why: str  # reason of the end, in words
    state: FlightState | None = None  # None: no landing was begun
    result: RunResult | None = None


OnStatus = Callable[[FlightStatus], None]
OnLine = Callable[[str], None]


def fly_vehicle(
    plan: FlightRequest, on_status: OnStatus = lambda status: None, on_line: OnLine = lambda line: None
) -> FlightOutcome:
    """Fly a landing, from the checks to its end, and return the outcome. After Ctrl-C the vehicle holds.

    Args:
        plan: options of the landing.
        on_status: called with the status several times per second.
        on_line: called with each notice of the autopilot, change of state, and order of a dry run, as one line.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written; the message names the remedy.
    """
    plan.validate()
    key = None if plan.signing_key is None else read_signing_key(plan.signing_key)
    prepare_folder(plan.out, plan.overwrite)
    over = threading.Event()
    feed = TelemetryFeed(plan.link, plan.separation, {"HIGHRES_IMU": plan.imu_rate}, key)
    try:
        if plan.dry_run:  # before the cameras, which may need half a minute
            report_parameters(feed, on_line)
        opened = open_sensors(plan.camera, plan.settings, plan.rig, over.is_set)
        machine = preflight.judge_machine(
            compiled.is_warm(), plan.out, opened.source.rig, USUAL_RATE, plan.settings.executive.time_budget,
            plan.record,
        )  # fmt: skip
        if any(c.verdict is Judged.BAD for c in machine):
            return FlightOutcome(machine, REFUSED)
        with ThreadPoolExecutor(1) as meanwhile:
            speed = meanwhile.submit(measure_speed, opened.source.rig, plan.settings, USUAL_RATE)
            checks = wait_for_vehicle(plan, feed, machine, on_status, on_line)
            machine.append(preflight.judge_speed(speed.result(), plan.settings.stages().executive.unjudged))
        if not feed.located:
            return FlightOutcome(checks, REFUSED)
        session = open_session(plan, opened, feed, SessionLog(on_line), on_status)
        session.machine = machine
        try:
            return session.fly(over)
        finally:
            over.set()
            session.run.close()
    finally:
        over.set()
        feed.close()


def wait_for_vehicle(
    plan: FlightRequest, feed: TelemetryFeed, machine: Sequence[CheckResult], on_status: OnStatus, on_line: OnLine
) -> list[CheckResult]:
    """Wait until an autopilot has reported its position, at most `PATIENCE` seconds; return the newest checks.

    The list begins with `machine`, the checks of this computer. `on_status`, `on_line`: see `fly_vehicle`.
    """
    begin, found, refused = time.monotonic(), list[CheckResult](), ""
    while not feed.located and time.monotonic() - begin < PATIENCE:
        with feed.lock:
            notices = feed.autopilot.notices()
            refused = next((n.text for n in reversed(notices) if n.kind is NoticeKind.FOUND and not n.ok), refused)
            found = [*machine, *autopilot_checks(plan, feed, refused)]
        for notice in notices:
            if notice.kind in (NoticeKind.TEXT, NoticeKind.INTERFERENCE):
                on_line(f"autopilot: {notice.text}")
        on_status(FlightStatus("checks", found))
        time.sleep(STEP)
    return found


def autopilot_checks(plan: FlightRequest, feed: TelemetryFeed, refused: str = "") -> list[CheckResult]:
    """Return the checks of the link and its autopilot; `refused`: see `judge_link`. The feed must be locked."""
    vehicle = feed.autopilot.vehicle
    dropped = counts_text(feed.autopilot.dropped)
    found = preflight.judge_link(plan.link, feed.autopilot.messages, vehicle, refused, dropped)
    if vehicle is None:
        return found
    take_off, home = plan.take_off is not None, plan.home is not None
    missing = feed.events_of.missing
    checks = preflight.judge_vehicle(vehicle, missing, plan.settings, take_off, plan.dry_run, home)
    stored = [*preflight.judge_parameters(vehicle), *preflight.judge_fence(vehicle, plan.settings)]
    return [*found, *checks, preflight.judge_imu(vehicle, plan.imu_rate), *stored]


def open_session(
    plan: FlightRequest, opened: LiveSource, feed: TelemetryFeed, log: SessionLog, on_status: OnStatus
) -> FlightSession:
    """Open the lanes of a flight, and return the session that flies it.

    The pictures come from `opened`. `feed` must have a vehicle and its position. `on_status`: see `fly_vehicle`.
    """
    local, vehicle = feed.events_of.local, feed.autopilot.vehicle
    assert local is not None
    assert vehicle is not None
    assert isinstance(opened.source, CalibratedFolder)
    opened.source.locate(local)
    commands = DryRunVehicle(lambda text: log.on_line(f"order, not sent: {text}")) if plan.dry_run else vehicle
    policy = FlightPolicy(every=0)  # maps are judged as the executive needs verdicts
    pilot = LandingPilot(plan.settings, local, vehicle, commands, policy, log)
    listener = Listener(pilot.inputs.add_motion, pilot.inputs.add_verdict)
    request = LiveRequest(plan.out, plan.settings, plan.record, True, plan.overwrite)
    run = LiveRun(opened.source, request, listener, policy)
    log.recorder = run.recorder
    return FlightSession(plan, feed, pilot, run, as_they_arrive(opened.events, feed.events()), log, on_status)


@dataclass(eq=False)
class FlightSession:
    """One flight with its lanes, pilot and vehicle: checks, take-off, landing, and a hold if the flight ends early."""

    plan: FlightRequest
    feed: TelemetryFeed
    pilot: LandingPilot
    run: LiveRun
    events: Iterator[Event]
    log: SessionLog
    on_status: OnStatus  # called with the status, several times per second
    machine: Sequence[CheckResult] = ()  # checks of this computer
    found: list[CheckResult] = field(default_factory=list)  # results of the newest checks
    failed: list[BaseException] = field(default_factory=list)  # errors of the source
    shown: float = -math.inf  # s, time of the newest status

    @property
    def vehicle(self) -> RemoteVehicle:
        """The vehicle at the other end of the link."""
        assert self.feed.autopilot.vehicle is not None
        return self.feed.autopilot.vehicle

    @property
    def taken(self) -> bool:
        """Whether we are not in control: not yet, or no longer."""
        return not self.pilot.in_control

    @property
    def loss(self) -> str:
        """Reason why we are not in control any more, in words."""
        return TAKEN if self.vehicle.alive else SILENT

    def fly(self, over: threading.Event) -> FlightOutcome:
        """Check, take off and land; return the outcome. `over` is set when the landing has ended, to end the events."""
        self.run.live.wait_until_ready()
        feeder = threading.Thread(target=self._feed_lanes, args=(over,), daemon=True)
        feeder.start()
        try:
            if why := self._refusal():
                return FlightOutcome(self.found, why)
            stopped = self._land()
        except BaseException:
            if not self.taken:
                self.log.on_line(f"fly: {self.hold()}")
            raise
        over.set()
        feeder.join(12.0)  # as long as a camera may be silent
        return self._outcome(stopped)

    def _feed_lanes(self, over: threading.Event) -> None:
        try:
            for event in self.events:
                if over.is_set():
                    return
                fresh: Event | None = event
                if isinstance(event, Frame):
                    fresh = self.pilot.inputs.add_frame(event, time.monotonic_ns())
                if fresh is not None:
                    self.run.live.feed(fresh)
        except BaseException as e:  # the executive notices that pictures or motions do not come, and gives up
            self.failed.append(e)

    def _on_step(self, phase: str, view: PilotView | None = None) -> list[Notice]:
        notices = self._listen()
        for notice in notices:
            if notice.kind in UNEXPECTED or not notice.ok:
                self.log.note("autopilot", notice.text)
        if (now := time.monotonic()) - self.shown > SHOW_EVERY:
            self.shown = now
            with self.feed.lock:
                reports = self.vehicle.telemetry
            if self.log.recorder is not None:
                self.log.recorder.telemetry(time.monotonic_ns(), reports)
            self.on_status(FlightStatus(phase, self.found, view, reports, self.run.live.health))
        return notices

    def _listen(self) -> list[Notice]:
        self.feed.flush()
        with self.feed.lock:
            notices = self.feed.autopilot.notices()
            for notice in notices:
                self.pilot.on_notice(notice)
        return notices

    # -- before the landing

    def _refusal(self) -> str:
        """Check and take off; return the reason why no landing begins, or an empty string."""
        height = self.plan.take_off
        if not self._is_well(lambda: self.check_all(motion=height is None)):
            return REFUSED
        if height is None:
            return ""
        if why := self._take_off(height):
            return f"take-off: {why}"
        known = self._is_well(self.check_climbed, lambda: self.taken)
        if self.taken:  # a landing would take control from somebody else
            return self.loss
        return "" if known else f"the motion is not known after the take-off; {self.hold()}"

    def _is_well(self, checks: Callable[[], list[CheckResult]], over: Callable[[], bool] = lambda: False) -> bool:
        """Repeat the checks until no result is bad, `over()` is true or time is up; return whether no result is bad.

        Results of earlier checks are kept, unless one of the same name replaces them.
        """
        begin, before = time.monotonic(), self.found
        while True:
            found = checks()
            names = {c.name for c in found}
            self.found = [*(c for c in before if c.name not in names), *found]
            self._on_step("checks")
            verdicts, waited = {c.verdict for c in found}, time.monotonic() - begin
            well = Judged.BAD not in verdicts
            settled = waited > SETTLED or Judged.WARNING not in verdicts
            if (well and settled) or waited > PATIENCE or over():
                return well
            time.sleep(STEP)

    def check_all(self, motion: bool) -> list[CheckResult]:
        """Return the checks of the machine, the autopilot and the cameras; with `motion`, also of the motion."""
        with self.feed.lock:
            found = [*self.machine, *autopilot_checks(self.plan, self.feed)]
        p = self.pilot.inputs.pictures
        found.append(preflight.judge_cameras(p.frames, p.rate(time.monotonic_ns()), p.delay, p.frozen))
        found += [bad("source", str(e), "see that it goes on") for e in self.failed]
        return [*found, self.check_motion()] if motion else found

    def check_climbed(self) -> list[CheckResult]:
        """Return the checks that are only possible after the climb: of the motion and of the throttle stick."""
        with self.feed.lock:
            return [self.check_motion(), *preflight.judge_throttle(self.vehicle)]

    def check_motion(self) -> CheckResult:
        """Check that the motion is known."""
        m = self.pilot.inputs.motion
        return preflight.judge_motion(m, math.inf if m is None else (time.monotonic_ns() - m.t_ns) * 1e-9)

    def _take_off(self, height: float) -> str:
        climb, shown = TakeOff(self.vehicle, height, time.monotonic_ns()), ""
        while not climb.done and not climb.failed:
            with self.feed.lock:
                climb.tick(time.monotonic_ns())
                hint = climb.hint
            if hint and hint != shown:
                shown = hint
                self.log.note("take-off", hint)
            for notice in self._on_step("take-off"):
                climb.on_notice(notice)
            time.sleep(STEP)
        return climb.failed

    # -- the landing

    def _land(self) -> str:
        """Fly the landing; return the vehicle's action in words after a stop by the user, else an empty string."""
        dry = self.plan.dry_run
        try:
            self.pilot.begin(time.monotonic_ns(), self.plan.take_off is not None, self.plan.goals)
            due = time.monotonic()
            while not self.pilot.over and not (dry and self.pilot.state is FlightState.RETURN):
                with self.feed.lock:
                    view = self.pilot.tick(time.monotonic_ns())
                self._on_step("landing", view)
                due = max(due + STEP, time.monotonic())
                time.sleep(max(due - time.monotonic(), 0.001))
        except KeyboardInterrupt:
            stopped = self.hold()
            self.run.live.warnings.append(f"fly: ended by Ctrl-C; {stopped}")
            return stopped
        return ""

    def hold(self) -> str:
        """Make the autopilot hold by itself, and give control away; return the vehicle's action in words.

        The command waits for a heartbeat and may be refused or lost. So it is repeated until the vehicle holds.
        Meanwhile nothing is shown or written, as the display or the disk may have failed.
        """
        if self.plan.dry_run:
            return "nothing was sent to the vehicle"
        if self.taken:
            return self.loss
        end = time.monotonic() + 6.0  # for a heartbeat before the order, one after it, and a lost packet
        while not (held := self._holds()) and not self.taken and time.monotonic() < end:
            time.sleep(STEP)
            self._listen()
        taken = self.taken
        with self.feed.lock:
            self.vehicle.release()
        if taken:
            return self.loss
        lands = self.pilot.orders.stop_mode is FlightMode.LAND
        return UNCONFIRMED if not held else LANDS if lands else "the vehicle holds its place"

    def _holds(self) -> bool:
        with self.feed.lock:
            ordered = self.pilot.stop(time.monotonic_ns())
            return ordered and self.vehicle.alive and self.vehicle.telemetry.mode is self.pilot.orders.stop_mode

    def _landing_place(self) -> str:
        place, last = self.vehicle.telemetry.place, self.pilot.diary.transitions[-1]
        at = "" if place is None else f", at {place.latitude:.7f} {place.longitude:.7f}"
        return at if last.p_safe is None else f"{at}, P(safe) {p_safe_text(last.p_safe)}"

    def _outcome(self, stopped: str) -> FlightOutcome:
        pilot, plan = self.pilot, self.plan
        ended, why = pilot.diary.end or (pilot.state, "")
        why = f"ended by the user; {stopped}" if stopped else why
        self.run.live.watch.counts.update(
            {f"link: messages {why}": n for why, n in self.feed.autopilot.dropped.items()}
        )
        found = self.run.finish()
        if ended is FlightState.LANDED:  # the answer is where it stands; other sites, and a route, mislead
            why, found = f"{why}{self._landing_place()}", replace(found, route=None)
        result = replace(
            with_home(found, flown_home(plan.home, self.vehicle.telemetry, plan.separation)), diary=pilot.diary,
            timings={**found.timings, **{k: list(v) for k, v in pilot.delays.items() if v}},
            notes={**found.notes, "landing": ended.value},
        )  # fmt: skip
        return FlightOutcome(self.found, why, ended, result)
