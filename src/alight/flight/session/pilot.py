"""The pilot: a situation for the executive, and its orders to the vehicle. No thread and no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from alight.flight.autopilot import RemoteVehicle
from alight.flight.executive import Executive
from alight.flight.session.dry_run import VehicleCommands
from alight.flight.session.inputs import LandingInputs
from alight.flight.session.orders import OrderSender
from alight.flight.session.touchdown import MotorStop
from alight.geometry import Grid, LocalFrame
from alight.pipeline import FlightPolicy
from alight.records import Motion, Notice, NoticeKind, Site
from alight.records.executive import (
    FlightDiary,
    FlightState,
    LookPicture,
    LookRecord,
    MapVerdict,
    Situation,
    Transition,
)
from alight.settings import Settings

TICK_NS = 100_000_000  # between two decisions of the executive
ENDS = (FlightState.LANDED, FlightState.HANDED_OVER)


class LandingLog(Protocol):
    """Log of a landing, in order; the recorder is one. Times are of our clock, in nanoseconds."""

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Write an order in words, with the state in which it was given."""

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Write a new entry of the diary."""

    def note(self, lane: str, words: str) -> None:
        """Write a note on the cameras, the autopilot or a lane."""


class OrderDelays:
    """Delays from an exposure to the first order of its verdict, and to the first set-point relative to its motion."""

    def __init__(self) -> None:
        self._verdict_ns = self._motion_ns = 0  # newest exposures that led to an order
        self.of_verdicts, self.of_motions = deque[float](maxlen=20_000), deque[float](maxlen=20_000)  # s

    def add_order(self, now_ns: int, verdict_ns: int, motion: Motion | None) -> None:
        """Take an order at `now_ns`.

        Args:
            verdict_ns: newest exposure of the newest verdict.
            motion: that its set-point is relative to; None: it has none.
        """
        if verdict_ns > self._verdict_ns:
            self._verdict_ns = verdict_ns
            self.of_verdicts.append((now_ns - verdict_ns) * 1e-9)
        if motion is not None and motion.t_ns > self._motion_ns:
            self._motion_ns = motion.t_ns
            self.of_motions.append((now_ns - motion.t_ns) * 1e-9)


@dataclass(frozen=True, eq=False)
class PilotView:
    """A landing at one moment, for a display."""

    t: float  # s since it began
    state: FlightState
    order: str
    situation: Situation
    target: Site | None = None  # the place that it is about, in the map's frame
    height: float | None = None  # metres above that place, or above the ground


class LandingPilot:
    """One landing. Feed its `inputs` pictures, motions and verdicts; after `begin`, call `tick` twenty times a second.

    Args:
        commands: takes the orders: the vehicle itself, or a `DryRunVehicle`.
        policy: of the lanes; it is given the verdicts that are needed, at every decision.
        log: takes orders, entries of the diary and notes.
    """

    def __init__(
        self, settings: Settings, local: LocalFrame, vehicle: RemoteVehicle, commands: VehicleCommands,
        policy: FlightPolicy, log: LandingLog,
    ) -> None:  # fmt: skip
        self._vehicle, self._commands, self._policy, self._log = vehicle, commands, policy, log
        stages = settings.stages()
        self.executive, k = Executive(stages), stages.executive
        self.inputs, self.delays = LandingInputs(vehicle, local, k.stale, log.note), OrderDelays()
        farthest = 2.0 * k.search_side, k.search_height + 60.0  # m: no target lies beyond
        self.orders = OrderSender(vehicle, commands, local, farthest, k.stale, lambda text: log.note("autopilot", text))
        self._motor_stop = MotorStop(commands, lambda text: log.note("autopilot", text))
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
    def in_control(self) -> bool:
        """True from our first order to a takeover: we fly."""
        return self._commands.in_control

    @property
    def over(self) -> bool:
        """True if the vehicle has landed or was handed over."""
        return self.state in ENDS

    def on_notice(self, notice: Notice) -> None:
        """Take a notice of the autopilot; answers to commands are passed on."""
        if notice.kind is NoticeKind.COMMAND:
            self.orders.on_answer(notice.ticket, notice.ok, notice.t_ns)

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
        now, located = self.inputs.situation(now_ns, self.in_control)
        waits = self._decided_ns is not None and now_ns - self._decided_ns < TICK_NS
        if is_new or not waits or self.state is FlightState.COMMIT:
            self._decided_ns = now_ns
            self._decide(now, located, now_ns)
        return self._view(now)

    def stop(self, now_ns: int) -> bool:
        """Order the autopilot to hold by itself, after a stop by the user. False: not ordered yet, call it again."""
        return self.in_control and self.orders.stop(now_ns)

    def _decide(self, now: Situation, located: Motion | None, now_ns: int) -> None:
        order = self.executive.tick(now)
        self._policy.need = self.executive.need
        self._order = self.orders.obey(order, self.state, located, now_ns)
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
        return PilotView(now.t, self.state, self._order, now, place, height)


def look_picture(look: LookRecord, seen: MapVerdict, reach: float = 5.0, size: int = 200) -> LookPicture:
    """The ground about the place of a look, `reach` metres each way, on `size` pixels a side."""
    cell, (east, north, _) = 2 * reach / size, look.place
    edge = reach - cell / 2  # the middle of the first pixel
    shown = Grid(east - edge, north + edge, cell, size, size)
    photo = seen.elevation.grid.nearest_on(shown, seen.elevation.rgb)
    return LookPicture(look, photo, seen.hazards.grid.nearest_on(shown, seen.hazards.p_safe), reach)
