"""The vehicle at the other end of the link: its reports, and the orders to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from alight.arrays import F64
from alight.flight.autopilot.border import EstimateTie
from alight.flight.autopilot.clock import Pace, VehicleClock
from alight.flight.autopilot.commands import CommandAnswer, CommandQueue
from alight.flight.autopilot.control import ControlWatch
from alight.flight.autopilot.firmware import Firmware
from alight.flight.autopilot.framing import Heard
from alight.flight.autopilot.link_watch import LinkWatch
from alight.flight.autopilot.pymavlink_dialect import message
from alight.flight.autopilot.setpoints import Setpoint, Target, hold_at, target_of
from alight.flight.autopilot.speeds import SpeedKeeper
from alight.flight.autopilot.status_text import SpokenText, TextJoiner
from alight.flight.autopilot.streams import StreamKeeper, StreamRate
from alight.flight.autopilot.vehicle_state import VehicleState, boot_time_ns
from alight.geometry import LocalFrame
from alight.records import FlightMode, NoticeKind, Place, Telemetry

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
_TAKEOFF, _DO_SET_MODE, _ARM = 22, 176, 400  # MAV_CMD
_SETPOINT_NS, _TIMESYNC_NS, _FIRST_TIMESYNC_NS = 200_000_000, 200_000_000, 100_000_000
_FIRST_TIMESYNCS = 10
_BEFORE_GUIDED_NS = 1_000_000_000  # of set-points, until PX4 accepts guided mode
_HELICOPTER = 4  # MAV_TYPE
_FRESH_NS = 800_000_000  # an answer to TIMESYNC that took longer is no evidence of a new start


class RemoteVehicle:
    """One vehicle that was heard; `Autopilot` makes it.

    Every order returns a ticket at once. Its outcome comes later as a notice with this ticket.
    `set_mode` and `take_off` take control. After a takeover, no message that moves the vehicle is sent until one of
    them is called again.
    """

    def __init__(
        self, firmware: Firmware, system: int, us: tuple[int, int], rates: Mapping[str, float],
        send: Callable[[Any], None], note: Callable[..., None], kind: int = 0,
    ) -> None:  # fmt: skip
        self.firmware, self.system, self._us = firmware, system, us
        self.helicopter = kind == _HELICOPTER
        self._send, self._note = send, note
        self._state, self._control = VehicleState(firmware), ControlWatch(firmware)
        self.clock, self._pace = VehicleClock(), Pace()
        self._commands = CommandQueue(send)
        self._commands.target = (system, AUTOPILOT)
        wanted = {name: rate for name, rate in {**firmware.rates, **rates}.items() if rate > 0}
        self._streams, self._speeds = StreamKeeper(wanted, self._commands), SpeedKeeper(self._commands)
        self._texts, self._link = TextJoiner(), LinkWatch()
        self._ordered: dict[int, FlightMode] = {}  # by the newest command of each kind
        self._target: Target | None = None
        self._ahead: Target | None = None  # on the way to it, as it was sent last
        self._target_ns = self._timesync_ns = self._now_ns = 0
        self._timesyncs = 0
        self._aiming_ns = 0  # since when set-points have been sent without a pause
        self.starts = 1  # counted up by each reboot
        self._handshakes: dict[str, Callable[[Any], None]] = {
            "COMMAND_ACK": self._command_ack,
            "TIMESYNC": self._timesync,
            "STATUSTEXT": lambda m: self._said(self._texts.take(m, self._now_ns)),
        }

    # reports

    @property
    def telemetry(self) -> Telemetry:
        """The newest report of everything heard from the vehicle; it does not change later."""
        return self._state.telemetry(self._now_ns)

    @property
    def alive(self) -> bool:
        """True if its heartbeat is heard, and a thread listens for it."""
        return self._link.alive

    @property
    def in_control(self) -> bool:
        """True from our first order to a takeover: we fly."""
        return self._control.in_control

    @property
    def patience_ns(self) -> int:
        """Clock of the time-outs, ns: the autopilot's own, or ours while it is silent."""
        return self._pace.t_ns

    def place_at(self, t_ns: int) -> Place | None:
        """Return the autopilot's estimate of its position.

        Args:
            t_ns: instant of our clock.

        Returns:
            Degrees, and metres above sea level and home; None: no report near that instant, or clocks not tied.
        """
        return self._state.place_at(self.clock.theirs_ns(t_ns)) if self.clock.known else None

    @property
    def doubts_place(self) -> bool:
        """True if its newest positions contradict the accepted ones: it has jumped."""
        return self._state.places.doubted

    @property
    def place_age(self) -> float:
        """Age of its newest position, seconds; inf: there is none."""
        return self._state.places.age(self.clock.theirs_ns(self._now_ns)) if self.clock.known else math.inf

    @property
    def oldest_place(self) -> float:
        """Greatest age of its newest position during the last five seconds, in seconds; inf: there is none."""
        return self._state.places.oldest(self._now_ns, self.clock) if self.clock.known else math.inf

    def tie(self, local: LocalFrame, position_world: F64, t_ns: int) -> EstimateTie | None:
        """Tie our position to the autopilot's of the same instant.

        Args:
            local: our world.
            position_world: (3,) metres, ours.
            t_ns: the instant, of our clock.

        Returns:
            The tie; None: the autopilot has no position near that instant.
        """
        place = self.place_at(t_ns)
        return None if place is None else EstimateTie(local, position_world, place)

    @property
    def missing_streams(self) -> list[str]:
        """Names of messages that were requested and do not come."""
        return self._streams.dry(self._pace.t_ns)

    @property
    def stream_rates(self) -> dict[str, StreamRate]:
        """Rates of the messages that come, by name."""
        return self._streams.rates(self._pace.t_ns)

    # orders

    def set_mode(self, mode: FlightMode) -> int:
        """Fly in this mode from now on; the newest order counts. Guided flight begins where the vehicle is."""
        now = self.telemetry
        begins = mode is FlightMode.GUIDED and self.firmware.repeats_setpoints and now.mode is not FlightMode.GUIDED
        if mode is not FlightMode.GUIDED:
            self._target = None
        elif begins and now.place is not None:
            self._aim(hold_at(now.place))  # the mode is refused without a set-point, and an old one must not be flown
        self._take_control(_DO_SET_MODE, mode)
        wait_ns = max(_BEFORE_GUIDED_NS - (self._now_ns - self._aiming_ns), 0) if begins else 0
        parameters = self.firmware.mode_parameters(mode)
        return self._commands.replace(f"mode {mode.value}", _DO_SET_MODE, parameters, self._pace.t_ns, wait_ns)

    def arm(self) -> int:
        """Start the motors; refused by the autopilot while its own checks fail."""
        return self._commands.submit("arm", _ARM, (1.0,), self._pace.t_ns)

    def disarm(self) -> int:
        """Stop the motors; refused in the air."""
        return self._commands.submit("disarm", _ARM, (0.0,), self._pace.t_ns)

    def take_off(self, height: float) -> int:
        """Climb to a height in metres above the home (ArduPilot: in guided mode)."""
        self._take_control(_TAKEOFF, FlightMode.TAKE_OFF)
        self._speeds.forget()
        self._target = None
        parameters = self.firmware.take_off_parameters(height, self.telemetry)
        return self._commands.submit("take off", _TAKEOFF, parameters, self._pace.t_ns)

    def release(self) -> None:
        """Give control away: no message that moves the vehicle is sent until control is taken again."""
        self._control.released()
        self._target = None
        self._commands.drop()

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Fly to a set-point (in guided mode). It is repeated if the autopilot needs that.

        Returns:
            False: not sent, somebody else flies.

        Raises:
            ValueError: the set-point is empty, not finite, without speed, or has a position and no tie.
        """
        target = target_of(setpoint, tie)
        if self._control.in_control:
            self._aim(target)
        return self._control.in_control

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Report the target of a precision landing, twenty times a second while it lands.

        Args:
            t_ns: instant at which this held, our clock.
            target_world: (3,) metres from the vehicle's reference point to the target, world axes.
            world_from_body: (3, 3) attitude of that instant.

        Returns:
            False: not sent; somebody else flies, or it is a PX4, whose landing uses none.
        """
        sent = self.firmware.landing_target(t_ns, target_world, world_from_body) if self._control.in_control else None
        if sent is not None:
            self._send(sent)
        return sent is not None

    def _take_control(self, number: int, mode: FlightMode) -> None:
        self._control.ordered(mode, self._pace.t_ns)
        self._ordered[number] = mode

    def _aim(self, target: Target) -> None:
        """Send a set-point near the vehicle towards a target; the target itself while its place is unknown."""
        if self._target is None:
            self._aiming_ns, self._ahead = self._now_ns, None
        elif (target.place is None) is not (self._target.place is None):
            self._speeds.forget()  # ArduPilot changes its controller
        self._target, self._target_ns = target, self._now_ns
        here = self.place_at(self._now_ns) or self._state.place
        if here is not None:
            self._ahead = target.near(here, self.firmware.reach)
        elif target.place is None or self._ahead is None or self._ahead.place is None:
            self._ahead = target  # else the last one again while the place is unknown: the whole way is too far
        self._send(self._ahead.message(self._now_ns, self.system, AUTOPILOT))
        if self.firmware.takes_speeds and self._state.mode is FlightMode.GUIDED:
            self._speeds.keep(target.speed, target.sink, self._pace.t_ns)

    # time

    def tick(self, now_ns: int) -> None:
        """Let time pass: requests, retries, set-points."""
        self._now_ns = now_ns
        self._pace.tick(now_ns)
        self._lost(self._link.tick(now_ns, self._pace.t_ns))
        self._said(self._texts.overdue(now_ns))
        if not self.alive:
            return
        self._ask_time()
        self._streams.tick(self._pace.t_ns)
        for answer in self._commands.tick(self._pace.t_ns):
            self._answered(answer)
        if self._target is not None and self.firmware.repeats_setpoints and now_ns - self._target_ns >= _SETPOINT_NS:
            self._aim(self._target)

    def look(self, now_ns: int) -> bool:
        """As `Autopilot.look`."""
        self._now_ns = max(now_ns, self._now_ns)  # so that the last messages grow old
        self._lost(self._link.look(now_ns))
        return not self._link.is_deaf(now_ns)

    def _lost(self, why: str) -> None:
        if why:
            self._note(NoticeKind.LINK_LOST, why, ok=False)

    def _ask_time(self) -> None:
        period = _TIMESYNC_NS if self._timesyncs >= _FIRST_TIMESYNCS else _FIRST_TIMESYNC_NS
        if self._now_ns - self._timesync_ns >= period or not self._timesyncs:
            self._timesync_ns = self._now_ns
            self._timesyncs += 1
            self._send(message("TIMESYNC", tc1=0, ts1=self.clock.question(self._now_ns)))

    # hearing

    def hear(self, heard: Heard, now_ns: int) -> bool:
        """Take a message of the vehicle; False: it is no telemetry, not accepted, or overtaken by a newer one."""
        self._now_ns = max(now_ns, self._now_ns)
        m, name = heard.message, heard.name
        handshake = self._handshakes.get(name)
        if handshake is not None:
            handshake(m)
        if handshake is not None or heard.late:
            return False
        boot_ns = boot_time_ns(m)
        if boot_ns is not None and not heard.overtaken:
            self._keep_pace(boot_ns)
        self._streams.hear(name, self._pace.t_ns)
        believed = self._state.hear(name, m, self._now_ns)
        if name == "HEARTBEAT":
            self._heartbeat()
        elif name == "RC_CHANNELS" and self._state.sticks is not None:
            self._watch(self._control.sticks(self._state.sticks))
        return believed

    def _keep_pace(self, boot_ns: int) -> None:
        if self._pace.heard(boot_ns, self._now_ns):
            self._rebooted()

    def _heartbeat(self) -> None:
        if self._link.hear(self._now_ns, self._pace.t_ns):
            self._note(NoticeKind.LINK_BACK, "the vehicle is heard again")
        now, before = self._state.telemetry(self._now_ns), self._control.mode_name
        unanswered = {mode for number, mode in self._ordered.items() if self._commands.waiting(number)}
        on_ground = self._state.is_on_ground(self._now_ns)
        reason = self._control.mode(now.mode, now.mode_name, self._pace.t_ns, unanswered, on_ground, now.armed)
        self._watch(reason)
        if before != now.mode_name:
            self._speeds.forget()
        if reason is None and before != now.mode_name:
            self._note(NoticeKind.MODE, now.mode_name, mode=now.mode)

    def _watch(self, takeover: str | None) -> None:
        if takeover is None:
            return
        self.release()
        self._note(NoticeKind.TAKEOVER, takeover, ok=False, mode=self._state.telemetry(self._now_ns).mode)

    def _rebooted(self) -> None:
        self.starts += 1
        self._state.rebooted()
        self._control.rebooted()
        self._target = None
        self.clock.forget()
        self._timesyncs = 0
        self._commands.drop(everything=True)
        self._streams.rebooted()
        self._note(NoticeKind.REBOOT, "the autopilot has started again", ok=False)

    def _is_for_us(self, m: Any) -> bool:
        system, component = getattr(m, "target_system", 0), getattr(m, "target_component", 0)
        return system in (0, self._us[0]) and component in (0, self._us[1])  # 0: all

    def _command_ack(self, m: Any) -> None:
        if self._is_for_us(m) and (answer := self._commands.hear(m.command, m.result, self._pace.t_ns)) is not None:
            self._answered(answer)

    def _answered(self, answer: CommandAnswer) -> None:
        if answer.ok and answer.number in self._ordered:
            self._control.accepted(self._ordered[answer.number], self._pace.t_ns)
        streams = self._streams.answered(answer.ticket, answer.refused)  # missing streams are requested again
        if not (streams or self._speeds.is_quiet(answer.ticket, answer.ok)):
            self._note(NoticeKind.COMMAND, answer.text, answer.ok, ticket=answer.ticket)

    def _timesync(self, m: Any) -> None:
        if m.tc1 == 0:  # a question; its stamp comes back with ours
            self._send(message("TIMESYNC", tc1=self._now_ns, ts1=m.ts1))
        elif self.clock.answer(m.ts1, m.tc1, self._now_ns) and self._now_ns - m.ts1 < _FRESH_NS:
            self._keep_pace(m.tc1)

    def _said(self, texts: list[SpokenText]) -> None:
        for said in texts:
            self._note(NoticeKind.TEXT, said.text, ok=said.ok)
