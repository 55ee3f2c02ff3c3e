"""The inputs of a landing as one situation: pictures, motions, verdicts and the autopilot's reports."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from alight.arrays import F64, U8
from alight.flight.autopilot import RemoteVehicle, on_plane
from alight.flight.session.wind import WindWatch
from alight.geometry import LocalFrame
from alight.pipeline import Verdict
from alight.records import FlightMode, Frame, GpsState, Motion, MotionState, PlaceSigma, Telemetry
from alight.records.executive import MapVerdict, SightQuality, Situation

WIND_KNOWN = 2.0  # m/s, 1-sigma up to which an estimated wind is used
SILENT = 20.0  # s without a report, after which a battery that was reported is unknown


class PictureWatch:
    """Watches the pictures as they come, and drops pictures of an earlier flight or of a frozen camera.

    Sensor noise makes every picture a little different. So a picture that repeats the previous one bit for bit comes
    from a camera or a driver that hangs. A motion estimated from it would stand still while the vehicle flies.
    """

    def __init__(self) -> None:
        self._last: dict[int, U8] = {}  # every fourth pixel of the newest picture, by camera
        self._arrivals = deque[float](maxlen=1000)  # s
        self._begun = False  # whether a current exposure has come
        self.frames, self.delay = 0, math.nan  # exposures so far; s from the newest stamp to its arrival
        self.newest_ns: int | None = None  # arrival of the last new picture
        self.frozen = 0  # consecutive exposures without a new picture
        self.stuck: tuple[int, ...] = ()  # cameras whose newest picture repeats the previous one

    def fresh(self, frame: Frame, now_ns: int) -> Frame | None:
        """Process an exposure that arrives at `now_ns`; return it with only its new pictures; None: no new pictures.

        Pictures that a folder held before the flight all arrive at once. They are dropped until the first current
        exposure, as the gap before it would look like a jump of the camera's clock.
        """
        self.frames, self.delay = self.frames + 1, (now_ns - frame.t_ns) * 1e-9
        self._begun = self._begun or self.delay < 1.0
        if not self._begun:
            return None
        self._arrivals.append(now_ns * 1e-9)
        small = {cam: np.asarray(i)[::4, ::4].copy() for cam, i in enumerate(frame.images) if i is not None}
        repeated = {cam for cam, i in small.items() if cam in self._last and np.array_equal(i, self._last[cam])}
        self._last.update(small)
        self.stuck = tuple(sorted((set(self.stuck) - set(small)) | repeated))
        if len(repeated) == len(small):
            self.frozen += bool(small)
            return None
        self.newest_ns, self.frozen = now_ns, 0
        if not repeated:
            return frame
        return replace(frame, images=tuple(None if cam in repeated else i for cam, i in enumerate(frame.images)))

    def rate(self, now_ns: int) -> float:
        """Return the number of exposures per second, over the last three seconds, without those before the flight."""
        return sum(now_ns * 1e-9 - t < 3.0 for t in tuple(self._arrivals)) / 3.0

    def age(self, now_ns: int) -> float:
        """Return the seconds since the last new picture; inf: no picture has come."""
        return math.inf if self.newest_ns is None else (now_ns - self.newest_ns) * 1e-9


class BatteryWatch:
    """The last reported charge of the battery; after a long silence the charge is unknown, not full."""

    def __init__(self) -> None:
        self._share, self._at = math.nan, math.inf  # last report, and its time in s

    def share(self, reports: Telemetry, now: float) -> float:
        """Return the charge, 0 to 1; NaN: it was reported once, but no longer is. A charge never reported is 1.

        `now`: present time, s.
        """
        age = reports.ages.get("SYS_STATUS", math.inf)
        if not math.isnan(reports.battery.share) and age < SILENT:
            self._share, self._at = reports.battery.share, now - age
        if math.isnan(self._share):
            return 1.0
        return self._share if now - self._at < SILENT else math.nan


class LandingInputs:
    """The newest inputs, on which the decisions of a landing are based. They may come from any thread.

    Args:
        local: the world frame.
        stale: age in s from which a motion or a position is not used.
        note: called with the name of a lane and a note in words.
    """

    def __init__(
        self, vehicle: RemoteVehicle, local: LocalFrame, stale: float, note: Callable[[str, str], None]
    ) -> None:
        self._vehicle, self._local, self._stale, self._note = vehicle, local, stale, note
        self.pictures, self._battery = PictureWatch(), BatteryWatch()
        self.wind_watch, self._wind_noted = WindWatch(), False
        self._last_wind: F64 | None = None  # the newest that was known by GPS
        self.motion: Motion | None = None  # of the newest tracked exposure
        self.verdict: MapVerdict | None = None  # the newest
        self.verdict_ns = 0  # stamp of the newest exposure in its map
        self.is_new = False  # whether the verdict is new; cleared by the pilot
        self._begin_ns: int | None = None
        self._starts, self._flying, self._had_position = vehicle.starts, False, True

    def begin(self, now_ns: int, flying: bool) -> None:
        """Begin the landing; see `LandingPilot.begin` for the arguments."""
        self._begin_ns, self._starts, self._flying = now_ns, self._vehicle.starts, flying

    def add_frame(self, frame: Frame, now_ns: int) -> Frame | None:
        """Process an exposure that came at `now_ns`; return it with only its new pictures; None: no new pictures."""
        before = self.pictures.stuck
        fresh = self.pictures.fresh(frame, now_ns)
        if (stuck := self.pictures.stuck) != before:
            which = ", ".join(str(cam) for cam in stuck)
            self._note("cameras", f"frozen: {which}; its pictures are left out" if stuck else "none is frozen")
        return fresh

    def add_motion(self, motion: Motion) -> None:
        """Store the motion of the newest tracked exposure."""
        self.motion = motion

    def add_verdict(self, verdict: Verdict, t_ns: int) -> None:
        """Store a verdict; it is dropped if the landing has not begun.

        Args:
            t_ns: stamp of the newest exposure in the map of the verdict.
        """
        if self._begin_ns is None:
            return
        number, elevation = 1 + (0 if self.verdict is None else self.verdict.number), verdict.elevation
        heights, t = elevation.height[elevation.trusted], (t_ns - self._begin_ns) * 1e-9
        ground, frame_id = float(np.median(heights)) if heights.size else 0.0, verdict.frame.frame_id
        found = MapVerdict(number, t, frame_id, verdict.sites, verdict.hazards, elevation, ground)
        self.add_map_verdict(found, t_ns)

    def add_map_verdict(self, verdict: MapVerdict, t_ns: int) -> None:
        """Store a verdict, with a larger number than the previous verdict; `t_ns`: see `add_verdict`."""
        self.verdict, self.verdict_ns, self.is_new = verdict, t_ns, True

    def situation(self, now_ns: int, in_control: bool) -> tuple[Situation, Motion | None]:
        """Return the situation at `now_ns`, and the motion that gave its position; None: the position is unknown.

        `in_control`: whether we control the vehicle.
        """
        assert self._begin_ns is not None
        m, reports = self.motion, self._vehicle.telemetry
        located = reports.has_position  # else the autopilot cannot follow a set-point
        newest = self.pictures.newest_ns  # missing pictures are reported by their age instead
        lags = m is not None and newest is not None and (newest - m.t_ns) * 1e-9 > self._stale
        state = MotionState.LOST if m is None or lags or not located else m.state
        if located is not self._had_position:
            self._note("autopilot", f"its estimator has {'a' if located else 'no'} position on Earth")
        self._had_position = located
        self._flying |= in_control
        sight = _sight(m) if reports.by_sight else None
        known = state in (MotionState.GOOD, MotionState.DEGRADED) and (sight is None or sight.sees)
        rebooted = self._vehicle.starts != self._starts
        position = self._position(m, now_ns) if m is not None and known else None
        now = Situation(
            (now_ns - self._begin_ns) * 1e-9,
            position,
            state,
            0 if m is None else m.frame_id,
            self.verdict,
            self.pictures.age(now_ns),
            self.pictures.frozen > 0,
            link=self._vehicle.alive and not rebooted,
            failsafe=self._vehicle.failsafe,
            pilot=self._flying and not in_control and not rebooted,
            contact=reports.has_contact,
            standing=reports.is_down,
            battery=self._battery.share(reports, now_ns * 1e-9),
            wind=self._wind(reports),
            holds=reports.can_hold and (sight is None or sight.sees),
            sight=sight,
            lands=reports.mode is FlightMode.LAND,
            steers=self._vehicle.firmware.takes_targets,
            offset=None if m is None or position is None else self._offset(m),
            movers=() if m is None or position is None else m.movers,
        )
        return now, m if position is not None else None

    def _wind(self, reports: Telemetry) -> F64 | None:
        """Return the wind, (3,) m/s as reported or (2,) m/s by the lean; None: unknown. By sight it is the last one."""
        if not reports.by_sight:
            self._last_wind = self._present_wind(reports)
        return self._last_wind

    def _present_wind(self, reports: Telemetry) -> F64 | None:
        if np.isfinite(reports.wind_world[:2]).all():
            return reports.wind_world
        self.wind_watch.add(reports)
        wind, sigma = self.wind_watch.estimate
        if sigma > WIND_KNOWN:
            return None
        if not self._wind_noted:
            self._wind_noted = True
            self._note("autopilot", f"wind by the lean: {math.hypot(*wind):.1f} m/s, 1-sigma {sigma:.1f}")
        return wind

    def _offset(self, motion: Motion) -> F64 | None:
        """Return the way, (2,) metres, from the map frame to the plane of the autopilot's fence; None: unknown.

        It is unknown where the autopilot fuses a GPS that lies: the fence stays where it is in the map.
        """
        gps = None if motion.odometry is None else motion.odometry.gps
        if self._vehicle.odometry.fuses_gps and gps in (GpsState.JUMPED, GpsState.DRIFTS):
            return None
        place = self._vehicle.place_at(motion.t_ns)
        return None if place is None else on_plane(self._local, place) - motion.world_from_body.translation[:2]

    def _position(self, motion: Motion, now_ns: int) -> F64 | None:
        """Return the present position, (3,) metres: of `motion`, plus the displacement since then; None: unknown."""
        flown = self._vehicle.displacement(self._local, motion.t_ns, now_ns).vector
        if flown is None and (now_ns - motion.t_ns) * 1e-9 > self._stale:
            return None
        here = motion.world_from_body.translation + (0.0 if flown is None else flown)
        return here if np.isfinite(here).all() else None


def _sight(motion: Motion | None) -> SightQuality:
    """Return how well a motion is known in flight by sight."""
    if motion is None or motion.odometry is None:
        return SightQuality(math.inf, math.inf, False)
    P, known = motion.odometry.covariance, motion.state in (MotionState.GOOD, MotionState.DEGRADED)
    position, velocity = (PlaceSigma.of(P[k : k + 3, k : k + 3]).horizontal for k in (0, 6))
    return SightQuality(position, velocity, known and motion.odometry.quality > 0)
