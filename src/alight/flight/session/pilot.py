"""The pilot: a situation for the executive, and its orders to the vehicle. No thread and no clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from alight.flight.autopilot import RemoteVehicle
from alight.flight.executive import Executive
from alight.flight.session.delays import OrderDelays
from alight.flight.session.inputs import LandingInputs
from alight.flight.session.motor_stop import MotorStop
from alight.flight.session.order_taker import OrderTaker
from alight.flight.session.orders import OrderSender
from alight.flight.session.verdicts import look_picture
from alight.geometry import LocalFrame
from alight.pipeline import FlightPolicy
from alight.records import Motion, Notice, NoticeKind
from alight.records.executive import FlightDiary, FlightState, LookRecord, Situation, Transition
from alight.settings import Settings

TICK_NS = 100_000_000  # between two decisions of the executive
ENDS = (FlightState.LANDED, FlightState.HANDED_OVER)
FAR, FAR_UP = 2.0, 60.0  # of the searched side, and m above the height of the search: no target lies beyond


class LandingLog(Protocol):
    """Log of a landing, in order; the recorder is one. Times are of our clock, in nanoseconds."""

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Write an order in words, with the state in which it was given."""

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Write a new entry of the diary."""

    def note(self, lane: str, words: str) -> None:
        """Write a note on the cameras, the autopilot or a lane."""


@dataclass(frozen=True, eq=False)
class PilotView:
    """A landing at one moment, for a display."""

    t: float  # s since it began
    state: FlightState
    order: str
    situation: Situation
    kind: str = ""  # of the place that it is about: site, candidate
    place: tuple[float, float, float] | None = None  # of it, metres in the map's frame
    p_safe: float | None = None
    height: float | None = None  # metres above that place, or above the ground


class LandingPilot:
    """One landing. Feed its `inputs` pictures, motions and verdicts; after `begin`, call `tick` twenty times a second.

    Args:
        settings: all settings.
        local: the world.
        vehicle: the autopilot's reports.
        hand: takes the orders: the vehicle itself, or a `SpokenVehicle`.
        policy: of the lanes; it is given the verdicts that are needed, at every decision.
        log: takes orders, entries of the diary and notes.
    """

    def __init__(
        self, settings: Settings, local: LocalFrame, vehicle: RemoteVehicle, hand: OrderTaker,
        policy: FlightPolicy, log: LandingLog,
    ) -> None:  # fmt: skip
        self._vehicle, self._policy, self._log = vehicle, policy, log
        stages = settings.stages()
        self.executive, k = Executive(stages), stages.executive
        self.inputs, self.delays = LandingInputs(vehicle, local, k.stale, log.note), OrderDelays()
        farthest = FAR * k.search_side, k.search_height + FAR_UP
        self._sender = OrderSender(vehicle, hand, local, farthest, k.stale, lambda words: log.note("autopilot", words))
        self._motor_stop = MotorStop(hand, lambda words: log.note("autopilot", words))
        self._decided_ns: int | None = None
        self._written = 0, 0  # looks and transitions
        self._order = ""

    @property
    def state(self) -> FlightState:
        """State of the executive."""
        return self.executive.state

    @property
    def diary(self) -> FlightDiary:
        """Transitions, looks and their pictures so far."""
        return self.executive.diary

    @property
    def over(self) -> bool:
        """True if the vehicle has landed or was handed over."""
        return self.state in ENDS

    def noticed(self, notice: Notice) -> None:
        """Take a notice of the autopilot; answers to commands are passed on."""
        if notice.kind is NoticeKind.COMMAND:
            self._sender.answered(notice.ticket, notice.ok, notice.t_ns)

    def begin(self, now_ns: int, flying: bool = False) -> None:
        """Begin the landing.

        Args:
            now_ns: the seconds of its diary count from here.
            flying: we have taken off: if we are no longer in control, somebody else is, and keeps it.
        """
        self.inputs.begin(now_ns, flying)

    def tick(self, now_ns: int) -> PilotView:
        """Decide ten times a second; on the last metres, and after a new verdict, at every call."""
        is_new, self.inputs.is_new = self.inputs.is_new, False  # before the situation: a verdict may come any time
        now, located = self.inputs.situation(now_ns, self._sender.hand.in_control)
        waits = self._decided_ns is not None and now_ns - self._decided_ns < TICK_NS
        if is_new or not waits or self.state is FlightState.COMMIT:
            self._decided_ns = now_ns
            self._decide(now, located, now_ns)
        return self._view(now)

    def stop(self, now_ns: int) -> bool:
        """Order the autopilot to hold by itself, after a stop by the user. False: not ordered yet, call it again."""
        return self._sender.hand.in_control and self._sender.stop(now_ns)

    def _decide(self, now: Situation, located: Motion | None, now_ns: int) -> None:
        order = self.executive.tick(now)
        self._policy.need = self.executive.need
        self._order = self._sender.obey(order, self.state, located, now_ns)
        self._motor_stop.tick(self._vehicle.telemetry, now_ns)
        if not self.over:
            self._log.order(now_ns, self.state.value, self._order)
        self._write_diary(now_ns)
        self.delays.add_order(now_ns, self.inputs.verdict_ns, located if order.what in ("fly", "land") else None)

    def _write_diary(self, now_ns: int) -> None:
        first_look, first_transition = self._written
        looks, verdict = self.diary.looks[first_look:], self.inputs.verdict
        if verdict is not None:
            self.diary.pictures += [look_picture(look, verdict) for look in looks]
        entries: list[Transition | LookRecord] = [*looks, *self.diary.transitions[first_transition:]]
        for entry in entries:
            self._log.landing(now_ns, entry)
        self._written = len(self.diary.looks), len(self.diary.transitions)

    def _view(self, now: Situation) -> PilotView:
        place, verdict = self.executive.target, self.inputs.verdict
        ground = place.up if place is not None else None if verdict is None else verdict.ground
        height = None if now.position is None or ground is None else float(now.position[2]) - ground
        if place is None:
            return PilotView(now.t, self.state, self._order, now, height=height)
        at = (place.east, place.north, place.up)
        return PilotView(now.t, self.state, self._order, now, place.kind, at, place.p_safe, height)
