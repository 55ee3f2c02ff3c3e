"""The executive's orders as an autopilot takes them: modes, guided set-points and landing targets, or words of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.autopilot import EstimateTie, RemoteVehicle, Setpoint
from alight.geometry import LocalFrame
from alight.records import FlightMode, Landed, Motion, Place
from alight.records.executive import FlightState, Order
from alight.runner.fly.near import near_way, own_way

AGAIN_NS = 2_000_000_000  # until a mode that was refused is asked for again
OFTEN = 3  # refusals in a row, after which a person is told
GRACE_NS = 2_000_000_000  # from the answer to a mode until heartbeats must show it
HIGH_SITE = 8.0  # m above the autopilot's home, from which its LAND would come down fast
TOUCH, BELOW = 1.0, 1.5  # m above such a site, where no sinking means contact; and below it, where guidance leads
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


@dataclass(frozen=True, eq=False)
class _Leg:
    """The way to a target, in our frame and the autopilot's."""

    tie: EstimateTie
    here: F64  # (3,) metres in our frame, the vehicle now
    way: F64  # (3,) metres, from it to the target
    goal: Place  # the target


class OrderSender:
    """Carries out the executive's orders, one call a tick.

    Places go out relative to the autopilot's own estimate of the instant of the motion that they are relative to.

    Args:
        vehicle: what the autopilot reports.
        hand: takes the orders.
        local: the world, for degrees.
        farthest: metres over the ground and upwards to a target: beyond that a position has jumped.
        tell: is told in words what a person must know.
    """

    def __init__(
        self, vehicle: RemoteVehicle, hand: OrderTaker, local: LocalFrame,
        farthest: tuple[float, float] = (math.inf, math.inf), tell: Callable[[str], None] = lambda words: None,
    ) -> None:  # fmt: skip
        self._vehicle, self.hand, self._local, self._farthest, self._tell = vehicle, hand, local, farthest, tell
        self._next = near_way if hand is vehicle else _whole_way  # orders that are said are said with their goal
        self._mode: FlightMode | None = None  # asked for
        self._ticket, self._refused_ns, self._refusals = -1, -AGAIN_NS, 0
        self._accepted_ns: int | None = None  # when the mode was
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

    def stop(self, now_ns: int) -> bool:
        """Have the autopilot hold by itself; False: it was not told yet, call it again."""
        return self._fly_as(FlightMode.HOLD, now_ns)

    def answered(self, ticket: int | None, ok: bool, now_ns: int) -> None:
        """Take the answer to a command: a mode that was refused is asked for again, a little later."""
        if ticket != self._ticket:
            return
        self._ticket = -1
        if ok:
            self._accepted_ns, self._refusals = now_ns, 0
            return
        self._refusals += 1
        if self._refusals == OFTEN and self._mode is not None:
            self._tell(f"{self._mode.value} was refused {OFTEN} times: be ready to take over")
        self._mode, self._refused_ns = None, now_ns

    def strayed(self, now_ns: int) -> str:
        """Return in words that another mode is flown than the one that was ordered and accepted; empty: it is that one.

        A change of mode within seconds of our own order looks like its effect: this tells them apart later.
        """
        heard = self._vehicle.telemetry
        if self._mode is None or self._accepted_ns is None or not (self.hand.in_control and heard.armed):
            return ""
        if heard.mode is self._mode or self._heartbeat_ns(now_ns) < self._accepted_ns + GRACE_NS:
            return ""
        ends = heard.landed in (Landed.GROUND, Landed.UNKNOWN)  # what it does by itself at the end of a task
        if ends and (self._mode, heard.mode) in self._vehicle.firmware.natural:
            return ""
        return f"{heard.mode_name} is flown, and {self._mode.value} was ordered: somebody else has changed it"

    def _heartbeat_ns(self, now_ns: int) -> int:
        """When the newest one came."""
        return now_ns - round(1e9 * self._vehicle.telemetry.ages.get("HEARTBEAT", 1e3))

    def _fly_as(self, mode: FlightMode, now_ns: int) -> bool:
        """Ask for a mode, once; False: not yet.

        Once we fly, the next heartbeat is waited for: a pilot who has switched since the last one is not switched back.
        """
        if self._mode is mode:
            self._wanted = None  # of another mode: it is not to be asked for by an old heartbeat later
            return True
        if self._wanted is None or self._wanted[0] is not mode:
            self._wanted = mode, now_ns
        stale = self.hand.in_control and self._heartbeat_ns(now_ns) < self._wanted[1]
        if stale or now_ns - self._refused_ns < AGAIN_NS:
            return False
        self._wanted = self._heading = self._accepted_ns = None
        self._mode = mode
        self._ticket = self.hand.set_mode(mode)
        return True

    def _hold(self, state: FlightState, now_ns: int) -> str:
        """Between two way-points it stays under guidance; while something is missing the autopilot holds by itself."""
        here = self._vehicle.telemetry.place
        if state in (FlightState.HOLD, FlightState.ABORT) or here is None:
            self._held = None  # a place of an estimate that has jumped since would be flown to
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
        leg = self._leg(to, motion, now_ns)
        if leg is None:
            return self._lost(now_ns)
        self._fly_as(FlightMode.GUIDED, now_ns)
        return self._guide(leg, order)

    def _lost(self, now_ns: int) -> str:
        return f"{self._hold(FlightState.HOLD, now_ns)}: the autopilot's place is not known, or has jumped"

    def _guide(self, leg: _Leg, order: Order) -> str:
        """Send the next target on the way, whatever mode is flown."""
        self._held = None
        speed, sink = (max(v, LEAST_SPEED) for v in (order.speed, order.sink))
        to = leg.here + self._next(leg.way, speed, sink)
        self.hand.guide(Setpoint(to, None, self._nose(), speed, sink), leg.tie)
        return f"fly to {words_of(leg.goal)}"

    def _land(self, place: F64, order: Order, motion: Motion, now_ns: int) -> str:
        """Over the place, or down with the target reported: where that is not used it goes straight down."""
        site = self._leg(place, motion, now_ns)
        goal = self._report(site, now_ns)
        over = np.array([*place[:2], motion.world_from_body.translation[2]])
        lands = self._mode is FlightMode.LAND
        if site is None:
            stays = lands and order.down and self._fly_as(FlightMode.LAND, now_ns)
            return "land" if stays else self._lost(now_ns)
        if not order.down:
            return self._go(over, order, motion, now_ns)
        if site.goal.above_home > HIGH_SITE and not lands:
            over = np.array([*place[:2], place[2] - BELOW])
            if not self._touches(site, order.sink):
                return self._go(over, order, motion, now_ns)
            over[:2] = site.here[:2]  # no push to the side on the ground
        if not self._fly_as(FlightMode.LAND, now_ns):  # it stays in its mode until LAND may be asked for, again
            leg = self._leg(over, motion, now_ns)
            return "land: not yet" if leg is None else self._guide(leg, order)
        return "land" if goal is None else f"land on {words_of(goal)}"

    def _touches(self, site: _Leg, sink: float) -> bool:
        """Whether the vehicle stands on a high site: guided down to it, for LAND sinks fast as high above home.

        LAND would reach 1.1 m/s from 0.7 m above it (ArduPilot, 1 m/s^2; PX4 more).
        """
        heard = self._vehicle.telemetry
        stopped = -site.way[2] < TOUCH and not heard.velocity_world[2] < -0.4 * sink
        return stopped or heard.landed is Landed.GROUND

    def _report(self, site: _Leg | None, now_ns: int) -> Place | None:
        """Report the target; return its place, None: not known now.

        Before the landing, too: ArduPilot needs two seconds of it, and stops where it lands without.
        """
        attitude = self._vehicle.telemetry.world_from_body
        if site is None or attitude is None:
            return None
        return site.goal if self.hand.land_on(now_ns, site.way, attitude) else None

    def _leg(self, to: F64, motion: Motion, now_ns: int) -> _Leg | None:
        """The way to a target; None: the autopilot's place is not known, or one of the positions cannot be true."""
        tie = self._vehicle.tie(self._local, motion.world_from_body.translation, motion.t_ns)
        flown = own_way(self._vehicle, self._local, motion.t_ns, now_ns)
        if tie is None or flown is None:
            return None
        here = motion.world_from_body.translation + flown
        way = np.asarray(to - here)
        over, up = self._farthest
        if not (np.isfinite(way).all() and math.hypot(way[0], way[1]) <= over and way[2] <= up):
            return None
        return _Leg(tie, here, way, tie.place_of(to))


def _whole_way(way: F64, speed: float, sink: float) -> F64:
    return way
