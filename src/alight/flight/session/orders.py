"""The executive's orders as commands to an autopilot: modes, guided set-points and landing targets."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import EstimateTie, RemoteVehicle, Setpoint, metres_between
from alight.flight.session.dry_run import VehicleCommands, place_text
from alight.geometry import LocalFrame
from alight.records import FlightMode, Motion, Place, Telemetry
from alight.records.executive import FlightState, Order
from alight.settings import ExecutiveSettings

TOUCH, LOW = 1.0, 3.0  # m above the estimated height of the site
TOUCH_NS, STILL_NS = 800_000_000, 2_000_000_000  # time without sinking at a touchdown: below TOUCH, and below LOW
AGAIN_NS = 2_000_000_000  # until a refused mode is ordered again
REFUSALS = 3  # of one mode, or of a stop of the motors, in a row: a person is warned, a mode to stop by is given up
LEAST_SPEED = 0.2  # m/s: an autopilot refuses a speed of 0


class Contact:
    """Detects a touchdown by the end of sinking, as PX4 reports no touchdown in Offboard mode."""

    def __init__(self) -> None:
        self._still_ns: int | None = None  # since when the vehicle does not sink; None: it sinks

    def forget(self) -> None:
        """Reset the detection; call it when the vehicle is not ordered down."""
        self._still_ns = None

    def is_felt(self, height: float | None, sink: float, reports: Telemetry, now_ns: int) -> bool:
        """Whether the vehicle is on the ground. Call it at every tick while the vehicle is ordered down.

        Args:
            height: estimated height above the site, metres; None: unknown, but low.
            sink: ordered speed downwards, m/s.
            reports: telemetry of the vehicle; an unknown velocity shows no contact.
        """
        still = reports.mode is FlightMode.GUIDED and bool(reports.velocity_world[2] >= -0.4 * sink)
        if not still or (height is not None and height > LOW):
            self._still_ns = None
        elif self._still_ns is None:
            self._still_ns = now_ns
        least = TOUCH_NS if height is not None and height < TOUCH else STILL_NS
        stopped = self._still_ns is not None and now_ns - self._still_ns >= least
        return stopped or reports.has_contact


@dataclass(frozen=True, eq=False)
class _Leg:
    tie: EstimateTie
    here: F64  # (3,) metres in our frame, present position of the vehicle
    way: F64  # (3,) metres, from the vehicle to the target
    goal: Place  # the target


class OrderSender:
    """Carries out the executive's orders, one call per tick.

    A target is computed from a motion. It is sent relative to the autopilot's own position at the time of that motion.

    Args:
        vehicle, commands: see `LandingPilot`.
        local: the world frame, for positions in degrees.
        warn: called with each warning to a person.
    """

    def __init__(
        self, vehicle: RemoteVehicle, commands: VehicleCommands, local: LocalFrame, keys: ExecutiveSettings,
        warn: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._vehicle, self._commands, self._local, self._warn = vehicle, commands, local, warn
        self._stale = keys.stale  # s, age of its position beyond which the autopilot is ordered to hold by itself
        self._farthest = 2.0 * keys.search_side, keys.search_height + 60.0  # m, longest path: over the ground, upwards
        self._mode: FlightMode | None = None  # ordered
        self._ticket, self._refused_ns = -1, -AGAIN_NS
        self._refusals = Counter[FlightMode | None]()  # by mode, since an order of a mode was accepted
        self.stop_mode = FlightMode.HOLD  # or LAND once HOLD was refused, as without a position; until guided again
        self._heading: float | None = None  # rad clockwise from north, of the nose under guidance
        self._wanted: tuple[FlightMode, int] | None = None  # mode to order, and since when it is wanted
        # held position, instant of its last order, and resets of the estimate until then
        self._held: tuple[Place, int, int] | None = None
        self._contact = Contact()  # with a high site
        self._site_above: float | None = None  # metres above home, of the site of this landing; None: unknown

    def obey(self, order: Order, state: FlightState, motion: Motion | None, now_ns: int) -> str:
        """Carry out an order; return the action in words.

        Args:
            order: order in the frame of the motion.
            state: state of the executive that gave the order.
            motion: newest motion; None: unknown. An order to land then leads straight down.
        """
        if order.what == "nothing":
            self._commands.release()
            return "nothing"
        if order.what == "return":
            self.order_mode(FlightMode.RETURN, now_ns)
            return "return"
        lands, known = order.what == "land", order.position is not None and motion is not None
        if not (lands and order.down):
            self._contact.forget()
        if lands and order.down and not known:
            return self._down(order, now_ns)
        if order.position is None or motion is None:
            return self._hold(state, now_ns)
        if lands:
            return self._land(order.position, order, motion, now_ns)
        self._site_above = None
        return self._go(order.position, order, motion, now_ns)

    def stop(self, now_ns: int) -> bool:
        """Order the autopilot to hold by itself or, if it refuses, to land; if it refuses that too, order nothing.

        Return False while no order is given.
        """
        return not self._cannot_stop and self.order_mode(self.stop_mode, now_ns)

    def on_answer(self, ticket: int | None, ok: bool, now_ns: int) -> None:
        """Process the answer to a command; a mode that was refused is ordered again after `AGAIN_NS`.

        An answer whose ticket is not of the last order of a mode has no effect. `ok`: whether it was accepted.
        """
        if ticket != self._ticket:
            return
        self._ticket = -1
        if ok:
            self._refusals.clear()
            return
        refused, self._mode, self._refused_ns = self._mode, None, now_ns
        self._refusals[refused] += 1
        now = self._vehicle.telemetry
        fails = refused is FlightMode.HOLD and now.mode is not FlightMode.HOLD
        if fails and (self._refusals[refused] >= REFUSALS or not now.can_hold):
            self.stop_mode, self._refused_ns = FlightMode.LAND, -AGAIN_NS
            self._warn("hold was refused: it is ordered to land where it is")
        elif refused is not None and self._refusals[refused] == REFUSALS:
            self._warn(f"{refused.value} was refused {REFUSALS} times: be ready to take over")

    @property
    def _cannot_stop(self) -> bool:
        return self.stop_mode is FlightMode.LAND and self._refusals[FlightMode.LAND] >= REFUSALS

    def order_mode(self, mode: FlightMode, now_ns: int) -> bool:
        """Order a mode once; return False while the order must wait.

        While we are in control, the command waits for the next heartbeat. So it does not undo a mode that a pilot has
        switched to since the last heartbeat. Guided mode waits for a position of the autopilot.
        """
        if self._mode is mode:
            self._wanted = None  # another mode must not be ordered later by an old heartbeat
            return True
        if self._wanted is None or self._wanted[0] is not mode:
            self._wanted = mode, now_ns
        heartbeat_ns = now_ns - round(1e9 * self._vehicle.telemetry.ages.get("HEARTBEAT", 1e3))
        stale = self._commands.in_control and heartbeat_ns < self._wanted[1]
        astray = mode is FlightMode.GUIDED and not self._vehicle.telemetry.can_hold
        if stale or astray or now_ns - self._refused_ns < AGAIN_NS:
            return False
        self._wanted = self._heading = None
        self._mode = mode
        if mode is FlightMode.GUIDED:
            self.stop_mode = FlightMode.HOLD
        self._ticket = self._commands.set_mode(mode)
        return True

    def _hold(self, state: FlightState, now_ns: int) -> str:
        """Hold in guided mode or, in state HOLD or ABORT or without a new position, by `stop`; return the action."""
        here = self._vehicle.place_at(now_ns) or self._vehicle.telemetry.place
        if state in (FlightState.HOLD, FlightState.ABORT) or here is None or self._vehicle.place_age > self._stale:
            self._held = None  # else it would fly to a position from before a jump of the estimate
            self.stop(now_ns)
            return "nothing: hold and land were refused" if self._cannot_stop else self.stop_mode.value
        self.order_mode(FlightMode.GUIDED, now_ns)
        kept = self._kept(here, now_ns)
        self._held = kept, now_ns, self._vehicle.place_resets
        stay = Setpoint(np.zeros(3), None, self._nose(), speed=1.0, sink=0.5)
        self._commands.guide(stay, EstimateTie(self._local, np.zeros(3), kept))
        return "stay"

    def _kept(self, here: Place, now_ns: int) -> Place:
        """Return the position held so far, or `here` after a jump of the autopilot's estimate."""
        if self._held is None or metres_between(self._held[0], here) > 5.0 or self._vehicle.odometry.drift.any():
            return here  # a position of an estimate that drifts moves over the ground
        if self._held[2] != self._vehicle.place_resets:
            return here
        flown = self._vehicle.displacement(self._local, self._held[1], now_ns).vector
        return here if flown is None else self._held[0]

    def _nose(self) -> float | None:
        """Return the heading at which guidance began, rad; without it ArduPilot turns nose and cameras on every leg."""
        R = self._vehicle.telemetry.world_from_body
        if self._heading is None and R is not None:
            self._heading = math.atan2(float(R[0, 0]), float(R[1, 0]))
        return self._heading

    def _go(self, to: F64, order: Order, motion: Motion, now_ns: int) -> str:
        leg = self._leg(to, motion, now_ns)
        if leg is None:
            return self._lost(motion, now_ns)
        self.order_mode(FlightMode.GUIDED, now_ns)
        return self._guide(leg, order)

    def _lost(self, motion: Motion, now_ns: int) -> str:
        """Hold, or keep the last target for a while if the autopilot's positions are only late; return the action."""
        missing = self._vehicle.place_at(motion.t_ns) is None and not self._vehicle.place_jumped
        if missing and self._vehicle.place_age <= self._stale:
            return "wait: the autopilot's position is late"
        self._contact.forget()
        return f"{self._hold(FlightState.HOLD, now_ns)}: the autopilot's place is not known, or has jumped"

    def _guide(self, leg: _Leg, order: Order) -> str:
        self._held = None
        speed, sink = (max(v, LEAST_SPEED) for v in (order.speed, order.sink))
        self._commands.guide(Setpoint(leg.here + leg.way, None, self._nose(), speed, sink), leg.tie)
        return f"fly to {place_text(leg.goal)}"

    def _land(self, place: F64, order: Order, motion: Motion, now_ns: int) -> str:
        """Fly over the site at `place`, (3,) metres, or land on it; report the landing target; return the action."""
        site = self._leg(place, motion, now_ns)
        goal = self._report(site, now_ns)
        over = np.array([*place[:2], motion.world_from_body.translation[2] if order.height is None else order.height])
        lands = self._mode is FlightMode.LAND
        if site is None:
            stays = lands and order.down and self.order_mode(FlightMode.LAND, now_ns)
            return "land" if stays else self._lost(motion, now_ns)
        self._site_above = site.goal.above_home
        if not order.down:
            action = self._go(over, order, motion, now_ns)
            if lands and self._mode is FlightMode.GUIDED:
                beside = math.hypot(site.way[0], site.way[1])
                self._warn(f"the descent waits {-site.way[2]:.1f} m above the site, {beside:.1f} m beside it")
            return action
        if self._touches_guided and not lands:
            over = np.array([*place[:2], place[2] - 1.5])  # below the site
            if not self._contact.is_felt(-float(site.way[2]), order.sink, self._vehicle.telemetry, now_ns):
                return self._go(over, order, motion, now_ns)
            over[:2] = site.here[:2]  # no push to the side on the ground
        if not self.order_mode(FlightMode.LAND, now_ns):  # it stays in its mode until LAND may be ordered (again)
            leg = self._leg(over, motion, now_ns)
            return "land: not yet" if leg is None else self._guide(leg, order)
        return "land" if goal is None else f"land on {place_text(goal)}"

    def _down(self, order: Order, now_ns: int) -> str:
        """Descend straight down without a reported target: the vehicle is low, and its position is unknown."""
        self._held = None
        guided = self._touches_guided and self._mode is not FlightMode.LAND
        if guided and not self._contact.is_felt(None, order.sink, self._vehicle.telemetry, now_ns):
            self.order_mode(FlightMode.GUIDED, now_ns)
            return self._sink(order)
        return "land: straight down" if self.order_mode(FlightMode.LAND, now_ns) else self._sink(order)

    def _sink(self, order: Order) -> str:
        sink = max(order.sink, LEAST_SPEED)
        self._commands.guide(Setpoint(None, np.array([0.0, 0.0, -sink]), self._nose()))
        return f"straight down at {sink:.1f} m/s"

    @property
    def _touches_guided(self) -> bool:
        """Whether the vehicle is guided to the ground, as the autopilot's LAND would come down fast, or astray.

        It is fast where the site is high above home: on the last 0.7 m it would reach 1.1 m/s (ArduPilot, at 1 m/s^2;
        PX4 is faster). It goes astray where GPS lies and the autopilot uses it all the same.
        """
        now, firmware = self._vehicle.telemetry, self._vehicle.firmware
        if self._vehicle.odometry.fuses_gps:
            return True
        above = (
            self._site_above if self._site_above is not None else None if now.place is None else now.place.above_home
        )
        return above is not None and above > firmware.high_site

    def _report(self, site: _Leg | None, now_ns: int) -> Place | None:
        """Report the site, the end of a leg, as landing target, even before LAND; return its position, None if unknown.

        ArduPilot needs reports from two seconds before LAND on; without them it stops the descent.
        """
        attitude = self._vehicle.telemetry.world_from_body
        if site is None or attitude is None:
            return None
        return site.goal if self._commands.land_on(now_ns, site.way, attitude) else None

    def _leg(self, to: F64, motion: Motion, now_ns: int) -> _Leg | None:
        """Return the path to `to`, (3,) metres; None: the autopilot's position is unknown, or a position is impossible.

        If the autopilot's newest positions are late, the path begins at the position of the exposure.
        """
        tie = self._vehicle.tie(self._local, motion.world_from_body.translation, motion.t_ns)
        flown = self._vehicle.displacement(self._local, motion.t_ns, now_ns)
        late = flown.vector is None and self._vehicle.place_age > self._stale
        if tie is None or flown.jumped or late:
            return None
        here = motion.world_from_body.translation + (0.0 if flown.vector is None else flown.vector)
        way = np.asarray(to - here)
        over, up = self._farthest
        if not (np.isfinite(way).all() and math.hypot(way[0], way[1]) <= over and way[2] <= up):
            return None
        return _Leg(tie, here, way, tie.place_of(to))
