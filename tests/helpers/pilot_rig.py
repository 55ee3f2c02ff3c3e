"""A landing in virtual time: the real executive, orders and protocol; a simulated autopilot; made-up verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from autopilot_rig import LOCAL, Rig
from made_up_ground import Ground, clearer_from_below
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.live.sight import SightNavigation
from alight.flight.session.dry_run import VehicleCommands
from alight.flight.session.pilot import LandingLog, LandingPilot, PilotView
from alight.flight.session.take_off import TakeOff
from alight.geometry import Pose
from alight.pipeline import FlightPolicy
from alight.pipeline.navigation import Navigation
from alight.records import NO_ZONES, Frame, GpsState, Motion, MotionState, Odometry
from alight.records.executive import FlightEvent, FlightState, LookRecord, MapVerdict, Order, Situation, Transition
from alight.records.telemetry import FirmwareName
from alight.settings import load_settings
from alight_sim.autopilot import PX4_CONTROLLER, EstimateError
from alight_sim.autopilot.dialects import Doing
from alight_sim.point_mass import FlightLimits, PointMass

WRONG = (3.0, -2.0, 1.0)  # m, error of the autopilot's estimate
LATE = 0.15  # s from an exposure to its motion
VERDICT = 0.4  # s from an exposure to its verdict
EXPOSURE = 0.2  # s between two exposures
HARMLESS = {"HEARTBEAT", "TIMESYNC", "ODOMETRY"}
SET_MESSAGE_INTERVAL = 511
LATER = 1_000  # ns from the newest message to the tick that uses it: no heartbeat is of this very instant

See = Callable[[int, float, np.ndarray], MapVerdict]  # number, second, place of the vehicle


def seldom(r: Rig, period: float) -> None:
    """Let the autopilot send a position every `period` seconds only."""
    make, newest = r.sim.reports.makers["GLOBAL_POSITION_INT"], [-np.inf]

    def seldom_made(now: Any) -> Any:
        if now.boot - newest[0] < period - 1e-3:
            return None
        newest[0] = now.boot
        return make(now)

    r.sim.reports.makers["GLOBAL_POSITION_INT"] = seldom_made


class PilotRig(Rig, LandingLog):
    """Both ends of a link, and a pilot at ours.

    Steps of 0.1 s are twice as fast as those of 0.05 s; no message comes more often than steps are made.
    """

    def __init__(
        self, see: See, dialect: FirmwareName = "ardupilot", settings: tuple[str, ...] = (), step: float = 0.1,
        **more: Any,
    ) -> None:  # fmt: skip
        # it leans in 0.1 s, as a real one: over a slow link targets are turned by the attitude of another moment
        self.odometry = bool(more.pop("odometry", False))  # whether it sends odometry
        limits = PX4_CONTROLLER if dialect == "px4" else FlightLimits(lag=0.1)
        more = {"vehicle": PointMass(limits), **more}
        super().__init__(dialect, step=step, estimate=EstimateError(WRONG), odometry=self.odometry, **more)
        self.gps, self.quality, self.drift = GpsState.USED, 1.0, np.zeros(3)  # of the filter; metres, of its position
        self.see, self.settings = see, load_settings("", ["executive.search_side=60", *settings])
        self._pilot: LandingPilot | None = None
        self.zones = NO_ZONES
        self.policy, self.judges = FlightPolicy(every=0), True  # False: no verdict comes
        self.pictures, self.positions = True, True
        self.frame_id, self.motion_state = 0, MotionState.GOOD
        self.freeze = False
        self.wire: list[Any] = []  # our messages, with the time
        self.orders: list[str] = []
        self.entries: list[Transition | LookRecord] = []
        self.view: PilotView | None = None
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._image, self._number, self._begun = np.zeros((12, 16), np.uint8), 0, 0.0
        self._reader = mavlink.MAVLink(None)
        put = self.up.put

        def listen(data: bytes, t: float) -> None:
            self.wire += [(t, m) for m in self._reader.parse_buffer(data) or ()]
            put(data, t)

        self.up.put = listen  # type: ignore[method-assign]
        tick, self._passed = self.ours.tick, 0
        self.ours.tick = lambda now_ns: tick(now_ns + LATER)  # type: ignore[method-assign]
        self.each_step = self.fly_on
        self.ticks = True  # False: somebody else ticks the pilot

    @property
    def pilot(self) -> LandingPilot:
        assert self._pilot is not None
        return self._pilot

    @property
    def state(self) -> FlightState:
        return self.pilot.state

    @property
    def events(self) -> list[FlightEvent]:
        return [t.event for t in self.pilot.diary.transitions]

    @property
    def doing(self) -> Doing:
        return self.sim.logic.doing

    def begin(self, commands: VehicleCommands | None = None, flying: bool = False) -> None:
        """Begin the landing."""
        self._pilot = LandingPilot(
            self.settings, LOCAL, self.vehicle, commands or self.vehicle, self.policy, self, self.zones
        )
        if self.odometry:
            self.pilot.sight = SightNavigation(self.vehicle, commands or self.vehicle, self.note)
        self._expose()
        self.run(1.0)
        self._begun = self.t
        self.pilot.begin(self.now_ns, flying)

    def take_off(self, height: float) -> TakeOff:
        """Begin a take-off when the vehicle is ready; from now on, every step goes on with it."""
        self.ready()
        climb = TakeOff(self.vehicle, height, self.now_ns)

        def tick() -> None:
            climb.tick(self.now_ns)
            for notice in self.heard[self._passed :]:
                climb.on_notice(notice)
            self._passed = len(self.heard)

        self.each_step = tick
        return climb

    def fly(self, until: FlightState, seconds: float = 400.0) -> bool:
        """Run until the executive is in a state; False: it never was."""
        return self.run(seconds, lambda: self.state is until)

    def moving_since(self, t: float) -> list[str]:
        """Messages sent after `t` that may move the vehicle, by name and command."""
        out = []
        for then, m in self.wire:
            name = m.get_type()
            asks = name == "COMMAND_LONG" and m.command == SET_MESSAGE_INTERVAL
            if then > t and name not in HARMLESS and not asks:
                out.append(f"{name} {getattr(m, 'command', '')}")
        return out

    def targets_since(self, t: float) -> list[np.ndarray]:
        """Targets that were sent after `t`, each (3,) metres from the simulated home."""
        sent = self.sent_since(t, "SET_POSITION_TARGET_GLOBAL_INT")
        return [self.sim.home.metres(m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt) for m in sent]

    def sent_since(self, t: float, kind: str) -> list[Any]:
        """Messages of a kind that were sent after `t`."""
        return [m for then, m in self.wire if then > t and m.get_type() == kind]

    def executive_orders(self) -> list[Order]:
        """The list that records the executive's orders from now on."""
        tick, out = self.pilot.executive.tick, list[Order]()

        def recorded(now: Situation) -> Order:
            out.append(tick(now))
            return out[-1]

        self.pilot.executive.tick = recorded  # type: ignore[method-assign]
        return out

    # -- the log of the pilot

    def order(self, t_ns: int, state: str, words: str) -> None:
        self.orders.append(words)

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        self.entries.append(entry)

    def note(self, lane: str, words: str) -> None:
        self.orders.append(f"{lane}: {words}")

    # -- every step

    def fly_on(self) -> None:
        """Do at a step what our end does: expose, judge, and tick the pilot."""
        if self._pilot is None:
            return
        for due, do in [x for x in self._later if x[0] <= self.t]:
            self._later.remove((due, do))
            do()
        if round(self.t / self.dt) % round(EXPOSURE / self.dt) == 0:
            self._expose()
        for notice in self.heard[self._passed :]:
            self.pilot.on_notice(notice)
        self._passed = len(self.heard)
        if self._begun and self.ticks:
            self.view = self.pilot.tick(self.now_ns + LATER)

    def _expose(self) -> None:
        """Make an exposure now, with its motion a little later."""
        if not self.pictures:
            return
        if not self.freeze:
            self._image = self._image + np.uint8(1)
        frame = Frame(self.now_ns, (self._image,))
        self.pilot.inputs.add_frame(frame, self.now_ns)
        pose = Pose(np.eye(3), self.truth() + self.drift)
        odometry = Odometry(0.01 * np.eye(9), np.zeros(3), self.quality, 0, self.gps) if self.odometry else None
        motion = Motion(
            self.now_ns, pose, (), np.eye(6), self.sim.vehicle.body.velocity, self.motion_state,
            frame_id=self.frame_id, odometry=odometry,
        )  # fmt: skip
        self._later.append((self.t + LATE, lambda: self.pilot.on_motion(motion, self.now_ns)))
        if self.policy.due_verdict(Navigation(frame, motion), 0, self.judges):
            self._judge()

    def _judge(self) -> None:
        at, t, t_ns = self.truth(), self.t - self._begun, self.now_ns
        self._number += 1
        number = self._number
        self._later.append((self.t + VERDICT, lambda: self.pilot.inputs.add_map_verdict(self.see(number, t, at), t_ns)))


PLACE = (10.0, 5.0)  # of the site


def flying(
    dialect: FirmwareName = "ardupilot", *settings: str, see: See | None = None, height: float = 16.0, **more: Any
) -> PilotRig:
    """Return a vehicle whose landing has begun; `see`: else there is a site at `PLACE`.

    From 16 m the place is in so little doubt that it is looked at at once; from 30 m all is searched first.
    """
    found = PilotRig(see or Ground({PLACE: clearer_from_below}).seen, dialect, settings, **more)
    found.up_and_flying(height)
    found.begin()
    return found


def raised(ground: Ground, up: float) -> See:
    """Return the same ground, `up` metres higher."""

    def see(number: int, t: float, at: np.ndarray) -> MapVerdict:
        low = ground.seen(number, t, at - [0.0, 0.0, up])
        sites, rest = (tuple(replace(s, up=up) for s in some) for some in (low.sites.sites, low.sites.candidates))
        elevation = replace(low.elevation, height=low.elevation.height + np.float32(up))
        return replace(low, sites=replace(low.sites, sites=sites, candidates=rest), elevation=elevation, ground=up)

    return see
