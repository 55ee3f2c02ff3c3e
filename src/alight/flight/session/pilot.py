"""The pilot: gives the executive the situation, and its orders to the vehicle. No thread and no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from alight.flight.autopilot import RemoteVehicle, on_plane
from alight.flight.executive.bounds import Bounds
from alight.flight.executive.executive import Executive
from alight.flight.executive.search import Goal
from alight.flight.live.sight import SightNavigation
from alight.flight.session.dry_run import VehicleCommands
from alight.flight.session.inputs import LandingInputs
from alight.flight.session.orders import REFUSALS, OrderSender
from alight.geometry import Grid, LocalFrame
from alight.outputs.reading import EarlierSite
from alight.outputs.recorder import Recorder
from alight.pipeline import FlightPolicy
from alight.records import NO_ZONES, FlightMode, Landed, Motion, Notice, NoticeKind, Site, Telemetry, ZonesOnPlane
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
STANDS_NS = 5_000_000_000  # from the touchdown to the first request to stop the motors, and between requests
ENDS = (FlightState.LANDED, FlightState.HANDED_OVER)


class LandingLog:
    """Log of a landing, in order of time; this class stores nothing. Times are of our clock, in nanoseconds."""

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Log an order in words, with the state of the executive that gave it."""

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Log a new entry of the diary."""

    def note(self, lane: str, words: str) -> None:
        """Log a note, in words, on `lane`: the name of a lane, `cameras` or `autopilot`."""


class SessionLog(LandingLog):
    """Log of a landing: written to the recording, if one is made, and printed as lines of text."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self.on_line = on_line
        self.recorder: Recorder | None = None

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Write an order to the recording; orders are too many to be printed."""
        if self.recorder is not None:
            self.recorder.order(t_ns, state, words)

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Write an entry of the diary to the recording, and print it."""
        if self.recorder is not None:
            self.recorder.landing(t_ns, entry)
        self.on_line(entry.line)

    def note(self, lane: str, words: str) -> None:
        """Write a note to the recording, and print it."""
        if self.recorder is not None:
            self.recorder.note(lane, words)
        self.on_line(f"{lane}: {words}")


class MotorStop:
    """Requests a stop of the motors that still turn seconds after a landing (PX4 with COM_DISARM_LAND below 0).

    Args:
        commands: receiver of the request; an autopilot refuses it in the air.
        warn: called with each warning to a person.
    """

    def __init__(self, commands: VehicleCommands, warn: Callable[[str], None]) -> None:
        self._commands, self._warn = commands, warn
        self._since_ns: int | None = None  # of the touchdown or the newest request; None: motors off, or in the air
        self._requests = 0

    def tick(self, reports: Telemetry, now_ns: int) -> None:
        """Check the reports of the vehicle, and request the stop if it is due. Call it several times per second."""
        lands = self._commands.in_control and reports.mode in (FlightMode.LAND, FlightMode.RETURN)
        if not (lands and reports.armed and reports.landed is Landed.GROUND):
            self._since_ns, self._requests = None, 0
            return
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < STANDS_NS or self._requests > REFUSALS:
            return
        self._since_ns, self._requests = now_ns, self._requests + 1
        if self._requests > REFUSALS:
            self._warn(f"it stands, and its motors were not stopped at {REFUSALS} requests: stop them by hand")
            return
        self._commands.disarm()
        self._warn("it stands, and its motors still turn: they are ordered to stop")


@dataclass(frozen=True, eq=False)
class PilotView:
    """A landing at one moment, for a display: state, order, situation, visited location and height."""

    t: float  # s since the landing began
    state: FlightState
    order: str  # action, in words
    situation: Situation
    target: Site | None = None  # visited location, in the map frame
    height: float | None = None  # metres above that location, or above the ground


class LandingPilot:
    """Flies one landing. Feed `inputs` with pictures, motions and verdicts; after `begin`, call `tick` at 20 Hz.

    Args:
        local: the world frame.
        vehicle: the vehicle that reports.
        commands: receiver of the orders: the vehicle itself, or a `DryRunVehicle`.
        policy: policy of the lanes; it gets the needed verdicts at every decision.
        log: receiver of orders, diary entries and notes.
        zones: zones of the user, in the world.
    """

    def __init__(
        self, settings: Settings, local: LocalFrame, vehicle: RemoteVehicle, commands: VehicleCommands,
        policy: FlightPolicy, log: LandingLog, zones: ZonesOnPlane = NO_ZONES,
    ) -> None:  # fmt: skip
        self._vehicle, self._commands, self._policy, self._log = vehicle, commands, policy, log
        stages = settings.stages()
        self.executive, k = Executive(stages), stages.executive
        self._stages, self._local, self._zones = stages, local, zones
        self.inputs = LandingInputs(vehicle, local, k.stale, log.note)
        self.delays = {name: deque[float](maxlen=20_000) for name in ("image to way-point", "image to set-point")}
        self._led = dict.fromkeys(self.delays, 0)  # newest exposures that led to an order
        warn = partial(log.note, "autopilot")
        self.orders, self._motor_stop = OrderSender(vehicle, commands, local, k, warn), MotorStop(commands, warn)
        self.sight: SightNavigation | None = None  # sends odometry; None: it flies by GPS alone
        self._decided_ns: int | None = None
        self._written = 0, 0  # numbers of logged looks and transitions
        self._order = ""

    @property
    def state(self) -> FlightState:
        """State of the executive."""
        return self.executive.state

    @property
    def diary(self) -> FlightDiary:
        """Diary of the landing so far: transitions, looks and their pictures."""
        return self.executive.diary

    @property
    def in_control(self) -> bool:
        """Whether we are in control: from our first order to a takeover."""
        return self._commands.in_control

    @property
    def over(self) -> bool:
        """Whether the vehicle has landed or was handed over."""
        return self.state in ENDS

    def on_motion(self, motion: Motion, now_ns: int) -> None:
        """Process the motion of the newest tracked exposure, which comes at `now_ns` of our clock."""
        self.inputs.add_motion(motion)
        if self.sight is not None:
            self.sight.chooses, self.sight.stays = self.in_control, self.state is FlightState.COMMIT
            self.sight.on_motion(motion, now_ns)

    def on_notice(self, notice: Notice) -> None:
        """Process a notice of the autopilot; answers to commands go to `orders`."""
        if self.sight is not None:
            self.sight.on_notice(notice)
        if notice.kind is NoticeKind.COMMAND:
            self.orders.on_answer(notice.ticket, notice.ok, notice.t_ns)

    def begin(self, now_ns: int, flying: bool = False, goals: Sequence[EarlierSite] = ()) -> None:
        """Begin the landing, within the fence that was read from the autopilot and the zones.

        Args:
            now_ns: present time of our clock, time zero of the diary.
            flying: whether we took off. If so, lost control is a takeover, and control is not taken back.
            goals: places to look at first, in this order.
        """
        self.inputs.begin(now_ns, flying)
        place = self._vehicle.telemetry.place
        start = np.zeros(2) if place is None else on_plane(self._local, place)
        bounds = Bounds(self._stages, self._vehicle.fence_of(self._local), start, self._zones)
        within = list[Goal]()
        for goal in (Goal(g.name, on_plane(self._local, g)) for g in goals):
            if why := bounds.objection(goal.position):
                self._log.note("sites", f"{goal.name} is left out: {why}")
            else:
                within.append(goal)
        self.executive.confine(bounds, within)

    def tick(self, now_ns: int) -> PilotView:
        """Decide if due (at 10 Hz; while landing or after a new verdict, at every call); return the present view."""
        is_new, self.inputs.is_new = self.inputs.is_new, False  # before the situation: a verdict may come any time
        now, located = self.inputs.situation(now_ns, self.in_control)
        waits = self._decided_ns is not None and now_ns - self._decided_ns < TICK_NS
        if is_new or not waits or self.state is FlightState.COMMIT:
            self._decided_ns = now_ns
            self._decide(now, located, now_ns)
        return self._view(now)

    def stop(self, now_ns: int) -> bool:
        """Order the autopilot to hold by itself, after a stop by the user; return False while the order must wait."""
        return self.in_control and self.orders.stop(now_ns)

    def _decide(self, now: Situation, located: Motion | None, now_ns: int) -> None:
        order = self.executive.tick(now)
        self._policy.need = self.executive.need
        self._order = self.orders.obey(order, self.state, located, now_ns)
        self._motor_stop.tick(self._vehicle.telemetry, now_ns)
        if not self.over:
            self._log.order(now_ns, self.state.value, self._order)
        self._write_diary(now_ns)
        self._measure("image to way-point", self.inputs.verdict_ns, now_ns)
        if located is not None and order.what in ("fly", "land"):
            self._measure("image to set-point", located.t_ns, now_ns)

    def _measure(self, name: str, t_ns: int, now_ns: int) -> None:
        """Record as `name` the delay, s, from the exposure `t_ns` to the first order (`now_ns`) based on it."""
        if t_ns > self._led[name]:
            self._led[name] = t_ns
            self.delays[name].append((now_ns - t_ns) * 1e-9)

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
    """Return the picture and P(safe) of the ground at a look, by the verdict `seen` after it.

    The picture reaches `reach` metres to each side, and is `size` pixels wide and high.
    """
    cell, (east, north, _) = 2 * reach / size, look.place
    edge = reach - cell / 2  # the middle of the first pixel
    shown = Grid(east - edge, north + edge, cell, size, size)
    photo = seen.elevation.grid.nearest_on(shown, seen.elevation.rgb)
    return LookPicture(look, photo, seen.hazards.grid.nearest_on(shown, seen.hazards.p_safe), reach)
