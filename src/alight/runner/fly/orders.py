"""The executive's orders as an autopilot takes them: modes, guided set-points and landing targets, or words of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.autopilot import EstimateTie, RemoteVehicle, Setpoint
from alight.geometry import LocalFrame
from alight.records import FlightMode, Motion, Place
from alight.records.executive import FlightState, Order

AGAIN_NS = 2_000_000_000  # until a mode that was refused is asked for again
SAID_AGAIN = 0.5  # m by which a set-point has to move until its words are said again
SAID_SPEED = 0.1  # m/s, the same of its speed
LEAST_SPEED = 0.2  # m/s: an autopilot refuses none at all


class OrderTaker(Protocol):
    """Takes orders: a `RemoteVehicle`, or a `SpokenVehicle`. An order returns the ticket of its answer."""

    @property
    def in_control(self) -> bool:
        """Whether we fly: from our first order to a takeover."""

    def set_mode(self, mode: FlightMode) -> int:
        """Fly in this mode from now on; takes control."""

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Fly to a set-point, tied to the autopilot's estimate where it has a position; False: not sent."""

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Report the target of a landing.

        Args:
            t_ns: instant at which this held, our clock.
            target_world: (3,) metres from the vehicle to the target, world axes.
            world_from_body: (3, 3) attitude of that instant.

        Returns:
            False: not sent.
        """

    def arm(self) -> int:
        """Start the motors."""

    def take_off(self, height: float) -> int:
        """Climb to a height in metres above the home; takes control."""

    def release(self) -> None:
        """Give control away: nothing is sent any more that moves the vehicle."""


class SpokenVehicle:
    """Takes orders and says them; nothing is sent.

    Args:
        say: is told each order in words; a set-point again when it has moved by half a metre.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._last = say, ""
        self._place: Place | None = None
        self._speed = math.inf
        self.in_control = False

    def set_mode(self, mode: FlightMode) -> int:
        """Say the mode."""
        self.in_control, self._place = True, None
        return self._spoken(f"mode: {mode.value}")

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Say the set-point, and its speed where it is a new one."""
        assert tie is not None
        assert setpoint.position_world is not None
        if math.isfinite(setpoint.speed) and not abs(setpoint.speed - self._speed) < SAID_SPEED:
            self._speed = setpoint.speed
            self._spoken(f"speed: {setpoint.speed:.1f} m/s")
        place = tie.place_of(setpoint.position_world)
        if self._place is None or _apart(place, self._place) > SAID_AGAIN:
            self._place = place
            self._spoken(f"fly to {words_of(place)}")
        return self.in_control

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Say where the target is, as often as it changes by half a metre."""
        east, north, up = np.round(2 * target_world) / 2 + 0.0
        words = f"landing target {-up:.1f} m below, {east:+.1f} m east, {north:+.1f} m north of the vehicle"
        if words != self._last:
            self._spoken(words)
        return self.in_control

    def arm(self) -> int:
        """Say it."""
        return self._spoken("arm")

    def take_off(self, height: float) -> int:
        """Say the height."""
        return self._spoken(f"take off to {height:.0f} m above home")

    def release(self) -> None:
        """No more orders."""
        if self.in_control:
            self._spoken("control is given away")
        self.in_control = False

    def _spoken(self, words: str) -> int:
        self._last = words
        self._say(words)
        return 0


def words_of(place: Place) -> str:
    """Return a place in words: degrees, metres above the sea, and above home where that is known."""
    above = "" if math.isnan(place.above_home) else f", {place.above_home:.1f} m above home"
    return f"{place.latitude:.7f} {place.longitude:.7f}, {place.altitude_msl:.1f} m above the sea{above}"


def _apart(a: Place, b: Place) -> float:
    """Metres."""
    north = (a.latitude - b.latitude) * 111_132.0
    east = (a.longitude - b.longitude) * 111_132.0 * math.cos(math.radians(a.latitude))
    return math.hypot(north, east, a.altitude_msl - b.altitude_msl)


class OrderSender:
    """Carries out the executive's orders, one call a tick.

    Places go out relative to the autopilot's own estimate of the instant of the motion that they are relative to.

    Args:
        vehicle: what the autopilot reports.
        hand: takes the orders.
        local: the world, for degrees.
    """

    def __init__(self, vehicle: RemoteVehicle, hand: OrderTaker, local: LocalFrame) -> None:
        self._vehicle, self.hand, self._local = vehicle, hand, local
        self._mode: FlightMode | None = None  # asked for
        self._ticket, self._refused_ns = -1, -AGAIN_NS
        self._heading: float | None = None  # of the nose under guidance, rad clockwise from north
        self._wanted: tuple[FlightMode, int] | None = None  # to be asked for, and since when
        self._held: Place | None = None

    def obey(self, order: Order, state: FlightState, motion: Motion | None, now_ns: int) -> str:
        """Carry out an order; return in words what was done.

        Args:
            order: in the frame of the motion.
            state: of the executive.
            motion: the newest one; None: not known.
            now_ns: our clock.
        """
        if order.what == "nothing":
            self.hand.release()
            return "nothing"
        if order.what == "return":
            self._fly_as(FlightMode.RETURN, now_ns)
            return "return"
        if order.position is None or motion is None:
            return self._hold(state, now_ns)
        if order.what == "land":
            return self._land(order.position, order, motion, now_ns)
        return self._go(order.position, order, motion, now_ns)

    def answered(self, ticket: int | None, ok: bool, now_ns: int) -> None:
        """Take the answer to a command: a mode that was refused is asked for again, a little later."""
        if ticket == self._ticket and not ok:
            self._mode, self._refused_ns = None, now_ns

    def _fly_as(self, mode: FlightMode, now_ns: int) -> bool:
        """Ask for a mode, once; False: not yet.

        Once we fly, the next heartbeat is waited for: a pilot who has switched since the last one is not switched back.
        """
        if self._mode is mode:
            return True
        if self._wanted is None or self._wanted[0] is not mode:
            self._wanted = mode, now_ns
        age_ns = round(1e9 * self._vehicle.telemetry.ages.get("HEARTBEAT", 1e3) if self.hand.in_control else 0)
        if now_ns - age_ns < self._wanted[1] or now_ns - self._refused_ns < AGAIN_NS:
            return False
        self._wanted = self._heading = None
        self._mode = mode
        self._ticket = self.hand.set_mode(mode)
        return True

    def _hold(self, state: FlightState, now_ns: int) -> str:
        """Between two way-points it stays under guidance; while something is missing the autopilot holds by itself."""
        here = self._vehicle.telemetry.place
        if state in (FlightState.HOLD, FlightState.ABORT) or here is None:
            self._fly_as(FlightMode.HOLD, now_ns)
            return "hold"
        self._fly_as(FlightMode.GUIDED, now_ns)
        self._held = self._held or here
        stay = Setpoint(np.zeros(3), heading=self._nose())
        self.hand.guide(stay, EstimateTie(self._local, np.zeros(3), self._held))
        return "stay"

    def _nose(self) -> float | None:
        """The heading at which guidance began: without one ArduPilot turns the nose, and the pictures, on every leg."""
        R = self._vehicle.telemetry.world_from_body
        if self._heading is None and R is not None:
            self._heading = math.atan2(float(R[0, 0]), float(R[1, 0]))
        return self._heading

    def _go(self, to: F64, order: Order, motion: Motion, now_ns: int) -> str:
        tie = self._tie(motion)
        if tie is None:
            return "stay: the autopilot's place at the last exposure is not known"
        self._fly_as(FlightMode.GUIDED, now_ns)
        self._held = None
        speeds = (max(v, LEAST_SPEED) for v in (order.speed, order.sink))
        self.hand.guide(Setpoint(to, None, self._nose(), *speeds), tie)
        return f"fly to {words_of(tie.place_of(to))}"

    def _land(self, place: F64, order: Order, motion: Motion, now_ns: int) -> str:
        """Over the place, or down with the target reported: where that is not used it goes straight down."""
        goal = self._report(place, motion, now_ns)
        if not order.down or not self._fly_as(FlightMode.LAND, now_ns):
            height = motion.world_from_body.translation[2]
            return self._go(np.array([*place[:2], height]), order, motion, now_ns)
        return "land" if goal is None else f"land on {words_of(goal)}"

    def _report(self, place: F64, motion: Motion, now_ns: int) -> Place | None:
        """Report the target; return its place, None: not known now.

        Before the landing, too: ArduPilot needs two seconds of it, and stops where it lands without.
        """
        tie = self._tie(motion)
        own, attitude = self._vehicle.place_at(now_ns), self._vehicle.telemetry.world_from_body
        if tie is None or own is None or attitude is None:
            return None
        goal = tie.place_of(place)
        there = self._local.to_enu(goal.latitude, goal.longitude, goal.altitude_msl)
        way = there - self._local.to_enu(own.latitude, own.longitude, own.altitude_msl)
        return goal if self.hand.land_on(now_ns, way, attitude) else None

    def _tie(self, motion: Motion) -> EstimateTie | None:
        return self._vehicle.tie(self._local, motion.world_from_body.translation, motion.t_ns)
