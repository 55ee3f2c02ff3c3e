"""The vehicle at the other end of the link: its reports, and the orders to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot.border import EstimateTie
from alight.flight.autopilot.clock import LinkWatch, TimeoutClock, VehicleClock
from alight.flight.autopilot.commands import CommandAnswer, CommandQueue
from alight.flight.autopilot.control import ControlWatch
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.fence import fence_region
from alight.flight.autopilot.firmware import Firmware
from alight.flight.autopilot.framing import ReceivedMessage
from alight.flight.autopilot.odometry import ExternalPose, OdometryLink
from alight.flight.autopilot.onboard import OnboardData
from alight.flight.autopilot.setpoints import Guidance, Setpoint, Target
from alight.flight.autopilot.status_texts import StatusText, TextJoiner
from alight.flight.autopilot.streams import StreamKeeper, StreamRate
from alight.flight.autopilot.vehicle_state import VehicleState, boot_time_ns
from alight.geometry import LocalFrame
from alight.geometry.zones import Region
from alight.records import FlightMode, NoticeKind, Place, Telemetry

_FRESH_NS = 800_000_000  # an answer to TIMESYNC that took longer is no evidence of a reboot
_fence_region = lru_cache(maxsize=4)(fence_region)  # checks before a flight are repeated


class Displacement(NamedTuple):
    """Displacement of a vehicle, as estimated by the autopilot."""

    vector: F64 | None  # (3,) metres, world axes; None: unknown, as the autopilot's positions are late or have jumped
    jumped: bool = False  # whether the positions contradict each other


class RemoteVehicle:
    """A vehicle on the link, made by `Autopilot`.

    Commands return a ticket at once; the outcome comes later as a notice with this ticket. `set_mode` and `take_off`
    take control. After a takeover, no message that moves the vehicle is sent until one of these is called again.

    Args:
        rates: Hz of further streams, or non-default rates of default streams, by message; 0: not requested.
    """

    def __init__(
        self, heartbeat: ReceivedMessage, firmware: Firmware, us: tuple[int, int], rates: Mapping[str, float],
        send: Callable[[Any], None], note: Callable[..., None],
    ) -> None:  # fmt: skip
        self.firmware, self.system, self._us, self._send, self._note = firmware, heartbeat.system, us, send, note
        self.helicopter = heartbeat.message.type == mavlink.MAV_TYPE_HELICOPTER
        self._state, self._control = VehicleState(firmware), ControlWatch(firmware)
        self.clock, self._timeouts, self._link, self._texts = VehicleClock(), TimeoutClock(), LinkWatch(), TextJoiner()
        address = heartbeat.system, heartbeat.component
        self._commands = CommandQueue(send, address)
        wanted = {name: rate for name, rate in {**firmware.rates, **rates}.items() if rate > 0}
        self._streams = StreamKeeper(wanted, self._commands)
        self._guidance = Guidance(firmware, address, send, self._commands)
        self.onboard = OnboardData(firmware, address, us, send)
        self.odometry = OdometryLink(firmware, self._state, self.clock, send, self._commands)
        self._now_ns = 0
        self._taken_by_failsafe = False
        self.starts = 1  # number of the autopilot's boots so far

    # reports

    @property
    def telemetry(self) -> Telemetry:
        """Snapshot of everything received from the vehicle so far."""
        return self._state.telemetry(self._now_ns)

    @property
    def alive(self) -> bool:
        """Whether heartbeats come, and a thread listens for them."""
        return self._link.alive

    @property
    def in_control(self) -> bool:
        """Whether we are in control: from our first order to a takeover."""
        return self._control.in_control

    @property
    def failsafe(self) -> str:
        """Failsafe of the autopilot that ended our control, by its warnings of the last 2 s; empty: none did."""
        recent = "; ".join(self._texts.warnings(self._now_ns))
        return (recent or "its state is critical") if self._taken_by_failsafe else ""

    @property
    def throttle_low(self) -> bool:
        """Whether the pilot's throttle stick is below its middle, so that the vehicle would sink after a takeover."""
        return self._state.sticks is not None and self._state.sticks[2] < 1300  # microseconds, the middle is 1500

    def place_at(self, t_ns: int) -> Place | None:
        """Return the autopilot's estimate of its position at an instant of our clock, extrapolated by its velocity.

        None: no report is near that instant, the reports have jumped, or the clocks are not tied.
        """
        return self._state.positions.at(self.clock.theirs_ns(t_ns)) if self.clock.known else None

    @property
    def place_jumped(self) -> bool:
        """Whether the newest positions contradict the accepted positions."""
        return self._state.positions.doubted

    @property
    def place_resets(self) -> int:
        """Number of resets of the autopilot's estimate, which moved its positions by metres, since it flew by sight."""
        return self._state.positions.resets

    @property
    def place_age(self) -> float:
        """Age of the newest position, seconds; inf: no position."""
        return self._state.positions.age(self.clock.theirs_ns(self._now_ns)) if self.clock.known else math.inf

    @property
    def oldest_place(self) -> float:
        """Greatest age, s, of the newest position at any time in the last five seconds; inf: no position."""
        return self._state.positions.oldest(self._now_ns, self.clock) if self.clock.known else math.inf

    def fence_of(self, local: LocalFrame) -> Region:
        """Return the region that its fence allows, in the plane of `local` (`on_plane`); without a fence, everything.

        Raises:
            InputError: the fence cannot be understood; the message names the item.
        """
        united = self.firmware.unites_inclusions(self.onboard.parameters)
        return _fence_region(self.onboard.fence.items or (), local, united)

    def tie(self, local: LocalFrame, position_world: F64, t_ns: int) -> EstimateTie | None:
        """Tie our position, `position_world` at `t_ns` of our clock, to the autopilot's position at the same instant.

        An estimate that drifts is carried on to the present.

        Returns:
            The tie; None: the autopilot has no position near that instant.
        """
        place = self.place_at(t_ns)
        drifted = self.odometry.drift * (self._now_ns - t_ns) * 1e-9
        return None if place is None else EstimateTie(local, position_world - drifted, place)

    def displacement(self, local: LocalFrame, since_ns: int, now_ns: int) -> Displacement:
        """Return the displacement from `since_ns` to `now_ns` of our clock, by the autopilot, in axes of `local`.

        It is without the drift of the autopilot's estimate.
        """
        if self.place_jumped:
            return Displacement(None, jumped=True)
        then, now = self.place_at(since_ns), self.place_at(now_ns)
        if then is None or now is None:
            return Displacement(None)
        a, b = (local.to_enu(p.latitude, p.longitude, p.altitude_msl) for p in (then, now))
        vector = np.asarray(b - a) - self.odometry.drift * (now_ns - since_ns) * 1e-9
        farthest = 5.0 + 25.0 * (now_ns - since_ns) * 1e-9  # m: beyond that it was not flown
        jumped = not float(np.linalg.norm(vector)) <= farthest
        return Displacement(None if jumped else vector, jumped)

    @property
    def missing_streams(self) -> list[str]:
        """Names of requested messages that do not come."""
        return self._streams.missing(self._timeouts.t_ns)

    @property
    def stream_rates(self) -> dict[str, StreamRate]:
        """Rates of the messages that come, by name of the message."""
        return self._streams.rates(self._timeouts.t_ns)

    # orders

    def set_mode(self, mode: FlightMode) -> int:
        """Order a flight mode and drop earlier orders of modes; return the ticket. GUIDED begins with a hold."""
        number, now = mavlink.MAV_CMD_DO_SET_MODE, self._state.newest
        guided = mode is FlightMode.GUIDED
        begins = guided and self.firmware.repeats_setpoints and now.mode is not FlightMode.GUIDED
        if not guided:
            self._guidance.target = None
        elif begins and now.place is not None:
            self._aim(Target(now.place))  # the mode is refused without a set-point, and an old one must not be flown
        self._control.ordered(mode, self._timeouts.t_ns)
        # PX4 accepts guided mode after a second of set-points
        wait_ns = max(1_000_000_000 - (self._now_ns - self._guidance.since_ns), 0) if begins else 0
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *self.firmware.parameters[mode])
        self._commands.give_up(number)
        t_ns = self._timeouts.t_ns
        return self._commands.submit(f"mode {mode.value}", number, parameters, t_ns, mode=mode, wait_ns=wait_ns)

    def arm(self) -> int:
        """Start the motors; return the ticket. The autopilot refuses while its own checks fail."""
        return self._commands.submit("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), self._timeouts.t_ns)

    def disarm(self) -> int:
        """Stop the motors; return the ticket. The autopilot refuses in the air."""
        return self._commands.submit("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,), self._timeouts.t_ns)

    def take_off(self, height: float) -> int:
        """Command a climb to `height` metres above home; return the ticket. ArduPilot must be in guided mode."""
        mode, t_ns = FlightMode.TAKE_OFF, self._timeouts.t_ns
        self._control.ordered(mode, t_ns)
        self._guidance.forget_speeds()
        self._guidance.target = None
        parameters = (0.0, 0.0, 0.0, *self.firmware.take_off_altitude(height, self._state.newest))
        return self._commands.submit("take off", mavlink.MAV_CMD_NAV_TAKEOFF, parameters, t_ns, mode=mode)

    def release(self) -> None:
        """Give control away: no message that moves the vehicle is sent until control is taken again."""
        self._control.released()
        self._guidance.target = None
        self._commands.drop()

    def send_odometry(self, pose: ExternalPose) -> bool:
        """Send the motion of an exposure as external navigation; return False if the clocks are not tied."""
        return self.alive and self.odometry.send(pose)

    def fly_by_sight(self, wanted: bool) -> int | None:
        """Order it to fly by our odometry, or by GPS; return the ticket, None if it needs no order (PX4 fuses both)."""
        return self.odometry.use(wanted, self._timeouts.t_ns)

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Send a set-point, for a vehicle in guided mode; repeat it later if the autopilot needs that.

        Args:
            tie: converts the position of the set-point; None: the set-point has no position.

        Returns:
            False if it is not sent: we are not in control, or the vehicle is disarmed on the ground.

        Raises:
            ValueError: the set-point is empty, not finite, without speed, or has a position and no tie.
        """
        target = Target.of(setpoint, tie)
        sends = self._control.in_control and not self._state.newest.is_down
        if sends:
            self._aim(target)
        return sends

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Report the target of a precision landing; call it twenty times per second during the landing.

        Args:
            t_ns: instant of the relative position and attitude, our clock.
            target_world: (3,) metres from the vehicle's reference point to the target, world axes.
            world_from_body: (3, 3) attitude at that instant.

        Returns:
            False if it is not sent: we are not in control, or the autopilot (PX4) uses no targets.
        """
        sent = self.firmware.landing_target(t_ns, target_world, world_from_body) if self._control.in_control else None
        if sent is not None:
            self._send(sent)
        return sent is not None

    def _aim(self, target: Target) -> None:
        now = self._state.newest
        here, drift = self.place_at(self._now_ns) or now.place, self.odometry.drift
        self._guidance.aim(target, here, now.velocity_world, drift, self._now_ns)
        if now.mode is FlightMode.GUIDED:
            self._guidance.keep_speeds(self._timeouts.t_ns)

    # time

    def tick(self, now_ns: int) -> None:
        """Send what is due now: requests, retries, set-points."""
        self._now_ns = now_ns
        self._timeouts.tick(now_ns)
        self._note_lost(self._link.tick(now_ns, self._timeouts.t_ns))
        self._note_texts(self._texts.overdue(now_ns))
        if not self.alive:
            return
        if self.clock.is_request_due(now_ns):
            self._send(mavlink.MAVLink_timesync_message(0, self.clock.request(now_ns)))
        self._streams.tick(self._timeouts.t_ns)
        self.onboard.tick(self._timeouts.t_ns)
        self._on_answers(self._commands.tick(self._timeouts.t_ns))
        if self._guidance.target is not None and self._guidance.is_due(now_ns):
            self._aim(self._guidance.target)

    def has_listener(self, now_ns: int) -> bool:
        """Whether `tick` is still called; see `Autopilot.has_listener`."""
        self._now_ns = max(now_ns, self._now_ns)  # so that the last messages grow old
        self._note_lost(self._link.check(now_ns))
        return self._link.has_ticks(now_ns)

    def _note_lost(self, why: str) -> None:
        if why:
            self.release()
            self._commands.drop(everything=True)  # nothing old must be sent when it is back
            self._note(NoticeKind.LINK_LOST, why, ok=False)

    # messages

    def on_message(self, received: ReceivedMessage, now_ns: int) -> bool:
        """Process a message of the vehicle; return False if it is no telemetry, not accepted, or overtaken."""
        self._now_ns = max(now_ns, self._now_ns)
        m, name = received.message, received.name
        if name in ("COMMAND_ACK", "TIMESYNC", "STATUSTEXT"):
            self._on_handshake(name, m)
            return False
        if self.onboard.on_message(m, self._timeouts.t_ns) or received.late:
            return False
        boot_ns = boot_time_ns(m)
        if boot_ns is not None and not received.overtaken:
            self._on_stamp(boot_ns)
        self._streams.on_message(name, self._timeouts.t_ns)
        was_armed = self._state.newest.armed
        accepted = self._state.on_message(name, m, self._now_ns)
        if was_armed and not self._state.newest.armed:
            self._guidance.target = None  # when it is armed again, it must not fly to an old set-point
        if name == "HEARTBEAT":
            self._on_heartbeat()
        elif name == "RC_CHANNELS" and self._state.sticks is not None:
            self._on_takeover(self._control.sticks(self._state.sticks), failsafe=False)
        return accepted

    def _on_handshake(self, name: str, m: Any) -> None:
        if name == "COMMAND_ACK":
            for_us = getattr(m, "target_system", 0), getattr(m, "target_component", 0)  # 0: all
            if all(to in (0, us) for to, us in zip(for_us, self._us, strict=True)):
                self._on_answers(self._commands.on_ack(m.command, m.result, self._timeouts.t_ns))
        elif name == "STATUSTEXT":
            self._note_texts(self._texts.add(m, self._now_ns))
        elif m.tc1 == 0:  # a request; its stamp goes back with ours
            self._streams.on_message(name, self._timeouts.t_ns)
            self._send(mavlink.MAVLink_timesync_message(self._now_ns, m.ts1))
        elif self.clock.add_answer(m.ts1, m.tc1, self._now_ns) and self._now_ns - m.ts1 < _FRESH_NS:
            self._on_stamp(m.tc1)

    def _on_stamp(self, boot_ns: int) -> None:
        if not self._timeouts.add_stamp(boot_ns, self._now_ns):
            return
        self.starts += 1
        self._state.rebooted()
        self._control.rebooted()
        self._guidance.target = None
        self.clock.restart()
        self._commands.drop(everything=True)
        self._streams.rebooted()
        self.onboard.rebooted()
        self._note(NoticeKind.REBOOT, "the autopilot has started again", ok=False)

    def _on_heartbeat(self) -> None:
        if self._link.on_heartbeat(self._now_ns, self._timeouts.t_ns):
            self._note(NoticeKind.LINK_BACK, "the vehicle is back")
        now, before = self._state.newest, self._control.mode_name
        unanswered, on_ground = self._commands.waiting_modes(), self._state.is_on_ground(self._now_ns)
        why = self._control.mode(now.mode, now.mode_name, self._timeouts.t_ns, unanswered, on_ground, now.armed)
        self._on_takeover(why, now.failsafe)
        if before != now.mode_name:
            self._guidance.forget_speeds()
            if not why:
                self._note(NoticeKind.MODE, now.mode_name, mode=now.mode)

    def _on_takeover(self, why: str, failsafe: bool) -> None:
        if why:
            self.release()
            self._taken_by_failsafe = failsafe
            text = f"a failsafe of the autopilot: {why}" if failsafe else why
            self._note(NoticeKind.TAKEOVER, text, ok=False, mode=self._state.newest.mode)

    def _on_answers(self, answers: Iterable[CommandAnswer]) -> None:
        for answer in answers:
            if answer.ok and answer.mode is not None:
                self._control.accepted(answer.mode, self._timeouts.t_ns)
            of_stream = self._streams.on_answer(answer.ticket, answer.refused)  # missing streams are requested again
            if not (of_stream or self._guidance.is_quiet(answer.ticket, answer.ok)):
                self._note(NoticeKind.COMMAND, answer.text, answer.ok, ticket=answer.ticket)

    def _note_texts(self, texts: list[StatusText]) -> None:
        for text in texts:
            self._note(NoticeKind.TEXT, text.text, ok=text.ok)
