"""A complete flown landing: checks, take-off, search to touchdown, and a folder of results."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from alight import compiled
from alight.checks.result import Judged
from alight.flight.autopilot import RemoteVehicle
from alight.flight.live.live import Listener
from alight.flight.live.run import LiveRequest, LiveRun
from alight.flight.live.sight import SightNavigation
from alight.flight.live.signing_key import read_signing_key
from alight.flight.live.speed import measuring_speed
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.flight.session.checks import STEP, FlightChecks
from alight.flight.session.dry_run import DryRunVehicle, report_parameters
from alight.flight.session.outcome import FlightOutcome, landing_outcome
from alight.flight.session.pilot import LandingPilot, PilotView, SessionLog
from alight.flight.session.request import FlightRequest, FlightStatus, OnLine, OnStatus
from alight.flight.session.take_off import TakeOff
from alight.landing.zones import MapZones
from alight.outputs import prepare_folder
from alight.pipeline import FlightPolicy
from alight.records import NO_ZONES, Event, FlightMode, Frame, Motion, Notice, NoticeKind
from alight.records.executive import FlightState
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.live import LiveSource, as_they_arrive, open_sensors

SHOW_EVERY = 0.2  # s between two statuses, and two recorded reports of the autopilot
USUAL_RATE = 5.0  # exposures per second, assumed before the first has come
UNEXPECTED = (NoticeKind.TAKEOVER, NoticeKind.REBOOT, NoticeKind.LINK_LOST, NoticeKind.LINK_BACK, NoticeKind.TEXT)
TAKEN = "somebody else flies now: nothing is sent to the vehicle any more"
SILENT = "the vehicle is silent: nothing is sent to it any more"
LANDS = "the vehicle lands where it is, as the autopilot has refused to hold"
UNCONFIRMED = "the vehicle was ordered to hold and has not confirmed it: take over"
REFUSED = "the checks before the flight found something bad"


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
    feed = TelemetryFeed(plan.link, plan.separation, {"HIGHRES_IMU": plan.imu_rate}, key, plan.odometry)
    try:
        if plan.dry_run:  # before the cameras, which may need half a minute
            report_parameters(feed, on_line)
        # a folder that pauses is no end: the executive notices, and the rows of GPS/INS go on
        opened = open_sensors(plan.camera, plan.settings, plan.rig, over.is_set, math.inf)
        machine = preflight.judge_machine(
            compiled.is_warm(), plan.out, opened.source.rig, USUAL_RATE, plan.settings.executive.time_budget,
            plan.record,
        )  # fmt: skip
        if any(c.verdict is Judged.BAD for c in machine):
            return FlightOutcome(machine, REFUSED)
        checks = FlightChecks(plan, feed, machine)
        with measuring_speed(opened.source.rig, plan.settings, USUAL_RATE) as speed:
            located = checks.wait_for_vehicle(speed, on_status, on_line)
        if not located:
            return FlightOutcome(checks.found, REFUSED)
        session = open_session(plan, opened, feed, checks, SessionLog(on_line), on_status)
        try:
            return session.fly(over)
        finally:
            over.set()
            session.run.close()
    finally:
        over.set()
        feed.close()


def open_session(
    plan: FlightRequest, opened: LiveSource, feed: TelemetryFeed, checks: FlightChecks, log: SessionLog,
    on_status: OnStatus,
) -> FlightSession:  # fmt: skip
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
    zones = NO_ZONES if plan.zones is None else plan.zones.in_world(local)
    pilot = LandingPilot(plan.settings, local, vehicle, commands, policy, log, zones)
    if plan.odometry:
        pilot.sight = checks.sight = SightNavigation(vehicle, commands, log.note)
        pilot.delays["image to odometry"] = pilot.sight.delays
    listener = Listener(partial(_on_motion, feed, pilot), pilot.inputs.add_verdict)
    on_maps = MapZones(zones, plan.settings.lander.reach) if plan.zones is not None else None
    request = LiveRequest(plan.out, plan.settings, plan.record, True, plan.overwrite, zones=on_maps)
    run = LiveRun(opened.source, request, listener, policy)
    log.recorder = run.recorder
    events = as_they_arrive(opened.events, feed.events())
    return FlightSession(plan, feed, checks, pilot, run, events, log, on_status)


def _on_motion(feed: TelemetryFeed, pilot: LandingPilot, motion: Motion) -> None:
    """Pass a motion to the pilot, on the thread of its lane, and send odometry at once."""
    if pilot.sight is None:
        pilot.inputs.add_motion(motion)
        return
    with feed.lock:
        pilot.on_motion(motion, time.monotonic_ns())
    feed.flush()


@dataclass(eq=False)
class FlightSession:
    """One flight with its lanes, pilot and vehicle: checks, take-off, landing, and a hold if the flight ends early."""

    plan: FlightRequest
    feed: TelemetryFeed
    checks: FlightChecks
    pilot: LandingPilot
    run: LiveRun
    events: Iterator[Event]
    log: SessionLog
    on_status: OnStatus  # called with the status, several times per second
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
                return FlightOutcome(self.checks.found, why)
            stopped = self._land()
        except BaseException:
            if not self.taken:
                self.log.on_line(f"fly: {self.hold()}")
            raise
        over.set()
        feeder.join(12.0)  # as long as a camera may be silent
        return landing_outcome(self.plan, self.checks.found, self.pilot, self.run, self.feed, stopped)

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
            self.checks.failed.append(e)

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
            self.on_status(FlightStatus(phase, self.checks.found, view, reports, self.run.live.health))
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
        height, checks, inputs = self.plan.take_off, self.checks, self.pilot.inputs
        on_step = partial(self._on_step, "checks")
        if not checks.repeat(lambda: checks.before_flight(inputs, motion=height is None), on_step):
            return REFUSED
        if height is None:
            return ""
        if why := self._take_off(height):
            return f"take-off: {why}"
        known = checks.repeat(lambda: checks.after_climb(inputs), on_step, lambda: self.taken)
        if self.taken:  # a landing would take control from somebody else
            return self.loss
        return "" if known else f"the motion is not known after the take-off; {self.hold()}"

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
