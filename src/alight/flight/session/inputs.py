"""Inputs of a landing: pictures, motions, verdicts and the autopilot's reports, as one situation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import RemoteVehicle
from alight.flight.session.battery import BatteryWatch
from alight.flight.session.near import own_way
from alight.flight.session.pictures import PictureWatch
from alight.flight.session.verdicts import for_executive
from alight.geometry import LocalFrame
from alight.pipeline import Verdict
from alight.records import Frame, Motion, MotionState
from alight.records.executive import MapVerdict, Situation


class LandingInputs:
    """The newest of everything that a landing decides by. Its inputs may come from any thread.

    Args:
        vehicle: the autopilot's reports.
        local: the world.
        stale: s, age from which a motion or a position is not used.
        note: called with the lane and a note in words.
    """

    def __init__(
        self, vehicle: RemoteVehicle, local: LocalFrame, stale: float, note: Callable[[str, str], None]
    ) -> None:
        self._vehicle, self._local, self._stale, self._note = vehicle, local, stale, note
        self.pictures, self._battery = PictureWatch(), BatteryWatch()
        self.motion: Motion | None = None  # of the newest tracked exposure
        self.verdict: MapVerdict | None = None  # the newest
        self.verdict_ns = 0  # its newest exposure
        self.is_new = False  # the verdict; whoever decides by it clears this
        self._begin_ns: int | None = None
        self._starts, self._flying, self._had_position = vehicle.starts, False, True

    def begin(self, now_ns: int, flying: bool) -> None:
        """As `LandingPilot.begin`."""
        self._begin_ns, self._starts, self._flying = now_ns, self._vehicle.starts, flying

    def add_frame(self, frame: Frame, now_ns: int) -> Frame | None:
        """Take an exposure that came at `now_ns`; return it with its new pictures alone, None where there is none."""
        before = self.pictures.stuck
        fresh = self.pictures.fresh(frame, now_ns)
        if (stuck := self.pictures.stuck) != before:
            which = ", ".join(str(cam) for cam in stuck)
            self._note("cameras", f"frozen: {which}; its pictures are left out" if stuck else "none is frozen")
        return fresh

    def add_motion(self, motion: Motion) -> None:
        """Take the motion of the newest tracked exposure."""
        self.motion = motion

    def add_verdict(self, verdict: Verdict, t_ns: int) -> None:
        """Take a verdict; before the landing begins it is left out.

        Args:
            verdict: in the frame of its map.
            t_ns: the newest exposure that its map holds.
        """
        if self._begin_ns is not None:
            number = 1 + (0 if self.verdict is None else self.verdict.number)
            self.add_map_verdict(for_executive(verdict, number, (t_ns - self._begin_ns) * 1e-9), t_ns)

    def add_map_verdict(self, verdict: MapVerdict, t_ns: int) -> None:
        """Take a verdict whose number is larger than that of the one before."""
        self.verdict, self.verdict_ns, self.is_new = verdict, t_ns, True

    def situation(self, now_ns: int, in_control: bool) -> tuple[Situation, Motion | None]:
        """The situation at `now_ns`, and the motion that its position is of; None: the position is not known.

        Args:
            now_ns: our clock.
            in_control: we fly.
        """
        assert self._begin_ns is not None
        m, reports = self.motion, self._vehicle.telemetry
        state = MotionState.LOST if m is None or self._lags(m) else m.state
        if not reports.has_position:  # it cannot follow a set-point
            state = MotionState.LOST
        if reports.has_position is not self._had_position:
            self._note("autopilot", f"its estimator has {'no' if self._had_position else 'a'} position on Earth")
        self._had_position = reports.has_position
        known = state in (MotionState.GOOD, MotionState.DEGRADED)
        wind = reports.wind_world
        self._flying |= in_control
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
            pilot=self._flying and not in_control and not rebooted,
            standing=reports.is_down,
            battery=self._battery.share(reports, now_ns * 1e-9),
            wind=wind if np.isfinite(wind[:2]).all() else None,
            holds=reports.has_position,
        )
        return now, m if position is not None else None

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
