"""Modes and landing of the simulated autopilot. Positions are its own estimate: ENU metres from its home."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from alight.arrays import F64
from alight_sim.autopilot.dialects import Dialect, Doing
from alight_sim.point_mass import Wanted

_SINK, _RUSH, _SLOW_BELOW = 0.5, 1.5, 10.0  # landing: sink rate, m/s; sink rate above _SLOW_BELOW, m/s; metres
_INPUT_AGE, _VELOCITY_AGE = 1.0, 3.0  # s, for which an input stays valid; a set-point that is only a velocity
_STREAM = 0.5  # s of set-points that are needed before guided flight


@dataclass
class FlightLogic:
    """State machine of the autopilot, which turns its mode and the received set-points into the vehicle's set-point."""

    dialect: Dialect
    armed: bool = False
    disarms: bool = True  # whether it disarms after a landing; False: like PX4 with COM_DISARM_LAND below 0
    interlock: bool | None = None  # whether a helicopter's rotor may turn; None: it has no such switch
    doing: Doing = Doing.PILOT
    failsafe: bool = False  # whether its heartbeat reports a critical state
    texts: list[str] = field(default_factory=list)  # status texts since they were last read

    def __post_init__(self) -> None:
        self._wanted = Wanted()
        self._set_at = self._set_since = -math.inf
        self._turning_since: float | None = None  # time at which a helicopter's rotor started
        self._speed = self._sink = math.inf
        self._target: tuple[float, F64] | None = None  # s of the newest report, and its position
        self._target_since = math.inf  # s, begin of reports without a gap
        self._target_seen = False
        self._landing_since: float | None = None
        self._controller = ""  # kind of guided flight: take-off, positions, velocities, or both
        self._stood_since: float | None = None
        self._here = np.zeros(3)
        self._anchor = np.zeros(3)
        self._stands = True
        self._t, self._lifted_at = 0.0, -math.inf  # s, time of the last step, and of the last lift-off
        self._armable = Doing.HOLD  # the last mode that allows arming

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE: 1 on the ground, 2 in the air, 4 landing."""
        if (self._stands and not self._is_blind) or self._t - self._lifted_at < self.dialect.lift_off_delay:
            return 1
        return 4 if self.doing is Doing.LAND else 2

    @property
    def _is_blind(self) -> bool:
        """Whether the autopilot cannot detect the ground while it flies to positions, as in some dialects."""
        guided = self.armed and self.doing is Doing.GUIDED and self._wanted.velocity is None
        return guided and not self.dialect.lands_in_guided

    def enter(self, doing: Doing, t: float) -> bool:
        """Change the mode at time `t` (s); return false if the change is refused."""
        stale = t - self._set_at > _INPUT_AGE / 2 or t - self._set_since < _STREAM
        if doing is Doing.GUIDED and self.dialect.needs_setpoints and stale:
            return False
        if doing is not self.doing:
            self._settle(doing)
        return True

    def arm(self, wanted: bool) -> bool:
        """Arm the motors if `wanted`, else disarm them; return false if the mode or a flight in progress forbids it."""
        if not wanted:
            if not self._stands:
                return False
        elif self.doing in (Doing.LAND, Doing.RETURN, Doing.HOLD) and not self.dialect.needs_setpoints:
            return False
        if self.armed and not wanted:
            self._disarm()
        self.armed = wanted
        self._stood_since = None
        return True

    def take_off(self, height: float) -> bool:
        """Start a climb to `height` metres above the home; return false if the command is refused."""
        if not self.armed or (self.doing is not Doing.GUIDED and not self.dialect.needs_setpoints):
            return False
        if self.interlock is False or not self._stands:
            return False
        if self.dialect.needs_setpoints:
            self._settle(Doing.TAKE_OFF)
        self._control("take-off")
        self._wanted = Wanted(np.array([self._here[0], self._here[1], height]))
        return True

    def guide(self, wanted: Wanted, t: float) -> None:
        """Handle a set-point received at time `t` (s): it is flown to if the mode is guided."""
        if t - self._set_at > _STREAM:
            self._set_since = t
        self._set_at = t
        if self.doing is Doing.GUIDED:
            self._control(f"position {wanted.position is not None} velocity {wanted.velocity is not None}")
            self._wanted = wanted

    def _control(self, kind: str) -> None:
        """Select the controller for guided flight by a name (`kind`); a change resets the commanded speed limits."""
        if kind != self._controller:
            self._controller = kind
            self._speed = self._sink = math.inf

    def limit(self, kind: float, speed: float) -> bool:
        """Limit a speed, m/s, by its SPEED_TYPE `kind`: ground speed (0, 1) or sink (3); return false if not allowed.

        PX4 accepts the command but applies it in missions only, which are not simulated.
        """
        if not self.dialect.speeds_by_command:
            return True
        if self.doing not in (Doing.GUIDED, Doing.RETURN) or speed <= 0:
            return False
        if kind in (0, 1):
            self._speed = speed
        elif kind == 3:
            self._sink = speed
        return True

    def aim_landing(self, target: F64, t: float) -> None:
        """Store the reported position of a landing target, (3,) ENU metres from home, received at time `t` (s)."""
        if self._target is None or t - self._target[0] > 0.5:
            self._target_since = t
        self._target = (t, target)

    def step(self, t: float, here: F64, stands: bool) -> Wanted | None:
        """Return the set-point at time `t` (s); None: motors off.

        `here`: (3,) metres, estimated position. `stands`: whether the vehicle is on the ground.
        """
        if self._stands and not stands and self.armed and self.doing is not Doing.LAND:
            self._lifted_at = t
        self._t, self._here, self._stands = t, here, stands
        self._disarm_on_ground(t)
        if not self.armed or not self._runs(t):
            return None
        wanted = self._by_mode(t)
        heading = wanted.heading
        if heading is None and self.dialect.turns_to_course and self.doing is Doing.GUIDED:
            heading = self._course(wanted)
        return Wanted(wanted.position, wanted.velocity, heading, self._speed, self._sink)

    def _runs(self, t: float) -> bool:
        """Whether the motors lift at `t` (s): ArduPilot needs a take-off command, a helicopter a rotor at speed."""
        waits = self._stands and self.doing is Doing.GUIDED and self._controller != "take-off"
        if waits and not self.dialect.needs_setpoints:
            return False
        if self.interlock is None or not self._stands:
            return True
        if not self.interlock:
            self._turning_since = None
        elif self._turning_since is None:
            self._turning_since = t
        return self._turning_since is not None and t - self._turning_since > 4.0

    def _course(self, wanted: Wanted) -> float | None:
        if self._controller == "take-off" and self.doing is Doing.GUIDED:
            return None
        way = wanted.velocity if wanted.position is None else wanted.position - self._here
        far = way is not None and math.hypot(*way[:2]) > 1.0  # m or m/s
        return math.atan2(float(way[0]), float(way[1])) if far and way is not None else None

    def _settle(self, doing: Doing) -> None:
        self.doing = doing
        self._armable = self._armable if doing in (Doing.LAND, Doing.RETURN) else doing
        self._anchor = self._here.copy()
        self._wanted = Wanted(self._anchor)
        self._landing_since = None
        self._controller = ""
        self._speed = self._sink = math.inf

    def _by_mode(self, t: float) -> Wanted:
        if self.doing is Doing.GUIDED:
            return self._guided(t)
        if self.doing is Doing.TAKE_OFF:
            if self._near(self._wanted.position):
                self._settle(Doing.HOLD)
            return self._wanted
        if self.doing is Doing.LAND:
            return self._landing(self._anchor, t)
        if self.doing is Doing.RETURN:
            over = np.array([0.0, 0.0, max(self._anchor[2], 5.0)])
            return self._landing(np.zeros(3), t) if self._over(over) else Wanted(over)
        return Wanted(self._anchor)

    def _guided(self, t: float) -> Wanted:
        if self.dialect.needs_setpoints and t - self._set_at > _INPUT_AGE:
            self.texts.append("Offboard set-points lost")
            self._settle(Doing.HOLD)
        elif self._wanted.position is None and t - self._set_at > _VELOCITY_AGE:
            self._wanted = Wanted(self._here.copy())
        return self._wanted

    def _landing(self, place: F64, t: float) -> Wanted:
        """Return the set-point of a landing at `place` (3,), or at a reported target: fly over it, then descend."""
        seen = self._target is not None and t - self._target[0] < _INPUT_AGE
        seen &= t - self._target_since >= self.dialect.target_delay
        self._target_seen |= seen
        self._landing_since = t if self._landing_since is None else self._landing_since
        early = t - self._landing_since < 7.0  # s that it waits for a target
        waits = math.isfinite(self.dialect.target_delay) and early and not self._target_seen
        goal = self._target[1] if seen and self._target is not None else place
        if seen and self.doing is Doing.LAND:
            self._anchor = self._here.copy()  # if the target is lost, it descends vertically
        fast = self._here[2] - goal[2] > _SLOW_BELOW and not seen
        sink = _RUSH if fast else _SINK
        near = not waits and bool(np.hypot(*(goal[:2] - self._here[:2])) < 2.0)
        velocity = np.array([0.0, 0.0, -sink if near else 0.0])
        return Wanted(np.array([goal[0], goal[1], self._here[2]]), velocity)

    def _near(self, place: F64 | None) -> bool:
        return place is not None and bool(np.linalg.norm(place - self._here) < 0.4)

    def _over(self, place: F64) -> bool:
        return bool(np.hypot(*(place[:2] - self._here[:2])) < 0.4)

    def _disarm_on_ground(self, t: float) -> None:
        landing = self.landed_state == 4 or self.doing in (Doing.LAND, Doing.RETURN)
        rises = self.doing is Doing.TAKE_OFF or (self._controller == "take-off" and self.interlock is not False)
        kept = self._is_blind or (landing and not self.disarms)
        if not (self.armed and self._stands) or (rises and not landing) or kept:
            self._stood_since = None
        elif self._stood_since is None:
            self._stood_since = t
        elif t - self._stood_since > (1.0 if landing else 10.0):
            self._disarm()
            self.texts.append("Disarming motors")

    def _disarm(self) -> None:
        self.armed = False
        if self.dialect.returns_at_disarm:
            self.doing = self._armable
