"""The pilot: situations for the executive from the lanes and the autopilot, its orders out. No thread and no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import RemoteVehicle
from alight.flight.executive import Executive
from alight.flight.session.battery import BatteryWatch
from alight.flight.session.motor_stop import MotorStop
from alight.flight.session.near import own_way
from alight.flight.session.order_taker import OrderTaker
from alight.flight.session.orders import OrderSender
from alight.flight.session.pictures import PictureWatch
from alight.flight.session.verdicts import for_executive, look_picture
from alight.geometry import LocalFrame
from alight.pipeline import FlightPolicy, Verdict
from alight.records import Frame, Motion, MotionState, Notice, NoticeKind
from alight.records.executive import FlightDiary, FlightState, LookRecord, MapVerdict, Situation, Transition
from alight.settings import Settings

TICK_NS = 100_000_000  # between two decisions of the executive
ENDS = (FlightState.LANDED, FlightState.HANDED_OVER)
KEPT = 20_000  # times that are kept for the summary
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
    """One landing. Feed it pictures, motions and verdicts; after `begin`, call `tick` twenty times a second.

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
        self._vehicle, self._local, self._policy, self._log = vehicle, local, policy, log
        self._begin_ns: int | None = None
        stages = settings.stages()
        self.executive, k = Executive(stages), stages.executive
        self._stale = k.stale
        farthest = FAR * k.search_side, k.search_height + FAR_UP
        self._sender = OrderSender(vehicle, hand, local, farthest, k.stale, lambda words: log.note("autopilot", words))
        self._motor_stop = MotorStop(hand, lambda words: log.note("autopilot", words))
        self.pictures, self._battery = PictureWatch(), BatteryWatch()
        self.motion: Motion | None = None
        self._known: Motion | None = None  # that the newest situation's position is of; None: it has none
        self._seen: MapVerdict | None = None
        self._seen_ns = self._acted_ns = 0  # newest exposure of the newest verdict, and of the one acted upon
        self._guided_ns = 0  # newest motion that a set-point was made of
        self._number = 0
        self._waiting = False  # a verdict, for a decision
        self._tick_ns: int | None = None
        self._starts = vehicle.starts
        self._flying, self._had_position, self._written = False, True, (0, 0)
        self._order = ""
        self.way_point_times = deque[float](maxlen=KEPT)  # s, exposure to the first order of the verdict that holds it
        self.set_point_times = deque[float](maxlen=KEPT)  # s, exposure to the first set-point relative to its motion

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

    # -- inputs, from any thread

    def saw(self, frame: Frame, now_ns: int) -> Frame | None:
        """Take an exposure that came at `now_ns`; return it with its new pictures alone, None where there is none."""
        before = self.pictures.stuck
        fresh = self.pictures.fresh(frame, now_ns)
        if (stuck := self.pictures.stuck) != before:
            which = ", ".join(str(cam) for cam in stuck)
            self._log.note("cameras", f"frozen: {which}; its pictures are left out" if stuck else "none is frozen")
        return fresh

    def moved(self, motion: Motion) -> None:
        """Take the motion of the newest tracked exposure."""
        self.motion = motion

    def judged(self, verdict: Verdict, t_ns: int) -> None:
        """Take a verdict.

        Args:
            verdict: in the frame of its map.
            t_ns: the newest exposure that its map holds.
        """
        if self._begin_ns is None:
            return
        self._number += 1
        self.take_seen(for_executive(verdict, self._number, (t_ns - self._begin_ns) * 1e-9), t_ns)

    def take_seen(self, seen: MapVerdict, t_ns: int) -> None:
        """Take a verdict in the frame of its map; numbers rise. The next tick decides by it, whenever it comes."""
        self._seen, self._seen_ns, self._waiting = seen, t_ns, True

    def noticed(self, notice: Notice) -> None:
        """Take a notice of the autopilot; answers to commands are passed on."""
        if notice.kind in (NoticeKind.COMMAND, NoticeKind.UPLOAD):
            self._sender.answered(notice.ticket, notice.ok, notice.t_ns)

    # -- the step

    def begin(self, now_ns: int, flying: bool = False) -> None:
        """Begin the landing.

        Args:
            now_ns: the seconds of its diary count from here.
            flying: we have taken off: if we are no longer in control, somebody else is, and keeps it.
        """
        self._begin_ns, self._starts, self._flying = now_ns, self._vehicle.starts, flying

    def tick(self, now_ns: int) -> PilotView:
        """Decide ten times a second; on the last metres, and after a new verdict, at every call."""
        fresh, self._waiting = self._waiting, False  # before the situation: a verdict may come any time
        now = self._situation(now_ns)
        due = self._tick_ns is None or now_ns - self._tick_ns >= TICK_NS or self.state is FlightState.COMMIT
        if due or fresh:
            self._tick_ns = now_ns
            self._decide(now, now_ns)
        return self._view(now)

    def stop(self, now_ns: int) -> bool:
        """Order the autopilot to hold by itself, after a stop by the user. False: not ordered yet, call it again."""
        return self._sender.hand.in_control and self._sender.stop(now_ns)

    def _situation(self, now_ns: int) -> Situation:
        assert self._begin_ns is not None
        m, heard = self.motion, self._vehicle.telemetry
        state = MotionState.LOST if m is None or self._lags(m) else m.state
        if not heard.has_position:  # it cannot follow a set-point
            state = MotionState.LOST
        self._note_position(heard.has_position)
        known = state in (MotionState.GOOD, MotionState.DEGRADED)
        wind = heard.wind_world
        self._flying |= self._sender.hand.in_control
        rebooted = self._vehicle.starts != self._starts
        position = self._position(m, now_ns) if m is not None and known else None
        self._known = m if position is not None else None
        return Situation(
            (now_ns - self._begin_ns) * 1e-9,
            position,
            state,
            0 if m is None else m.frame_id,
            self._seen,
            self.pictures.age(now_ns),
            self.pictures.frozen > 0,
            link=self._vehicle.alive and not rebooted,
            pilot=self._flying and not self._sender.hand.in_control and not rebooted,
            standing=heard.is_down,
            battery=self._battery.share(heard, now_ns * 1e-9),
            wind=wind if np.isfinite(wind[:2]).all() else None,
            holds=heard.has_position,
        )

    def _lags(self, motion: Motion) -> bool:
        """True if pictures come without their motions; missing pictures are reported by `pictures.age` instead."""
        newest = self.pictures.newest_ns
        return newest is not None and (newest - motion.t_ns) * 1e-9 > self._stale

    def _position(self, motion: Motion, now_ns: int) -> F64 | None:
        """(3,) metres in the map's frame now: the newest motion plus the autopilot's own displacement since then."""
        way = own_way(self._vehicle, self._local, motion.t_ns, now_ns).way
        if way is None and (now_ns - motion.t_ns) * 1e-9 > self._stale:
            return None
        here = motion.world_from_body.translation + (0.0 if way is None else way)
        return here if np.isfinite(here).all() else None

    def _note_position(self, known: bool) -> None:
        if known is not self._had_position:
            self._log.note("autopilot", f"its estimator has {'a' if known else 'no'} position on Earth")
        self._had_position = known

    def _decide(self, now: Situation, now_ns: int) -> None:
        order = self.executive.tick(now)
        self._policy.need = self.executive.need
        self._order = self._sender.obey(order, self.state, self._known, now_ns)
        self._motor_stop.tick(self._vehicle.telemetry, now_ns)
        if not self.over:
            self._log.order(now_ns, self.state.value, self._order)
        self._write_diary(now_ns)
        self._time(now_ns, order.what in ("fly", "land"))

    def _time(self, now_ns: int, moves: bool) -> None:
        """Note the delays of the order: from the verdict (also for a hold), and from the motion if it moves."""
        if self._seen_ns > self._acted_ns:
            self._acted_ns = self._seen_ns
            self.way_point_times.append((now_ns - self._seen_ns) * 1e-9)
        if moves and self._known is not None and self._known.t_ns > self._guided_ns:
            self._guided_ns = self._known.t_ns
            self.set_point_times.append((now_ns - self._known.t_ns) * 1e-9)

    def _write_diary(self, now_ns: int) -> None:
        first_look, first_transition = self._written
        for look in self.diary.looks[first_look:]:
            if self._seen is not None:
                self.diary.pictures.append(look_picture(look, self._seen))
        fresh: list[LookRecord | Transition] = [*self.diary.looks[first_look:]]
        fresh += self.diary.transitions[first_transition:]
        for entry in fresh:
            self._log.landing(now_ns, entry)
        self._written = len(self.diary.looks), len(self.diary.transitions)

    def _view(self, now: Situation) -> PilotView:
        place = self.executive.target
        ground = place.up if place is not None else self._seen.ground if self._seen is not None else None
        height = None if now.position is None or ground is None else float(now.position[2]) - ground
        if place is None:
            return PilotView(now.t, self.state, self._order, now, height=height)
        at = (place.east, place.north, place.up)
        return PilotView(now.t, self.state, self._order, now, place.kind, at, place.p_safe, height)
