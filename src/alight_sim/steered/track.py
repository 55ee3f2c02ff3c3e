"""The true motion of a vehicle that is stepped, at any time of its last seconds."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp, so3_log
from alight_sim.sensors import TrueMotion

_KEPT = 3.0  # s of motion that are kept at least


class TrueTrack:
    """Pieces of constant turn rate and acceleration, one a step. Times: seconds of the flight."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._pieces: list[tuple[TrueMotion, F64, float]] = []  # motion at the start; (3,) place at the end; seconds

    def add(self, start: float, seconds: float, before: TrueMotion, place: F64, turned: F64) -> TrueMotion:
        """Append a step of `seconds` from `before` to a place (3,) and a rotation (3, 3); return its initial motion."""
        rate = np.asarray(so3_log(before.world_from_body.T @ turned)) / seconds
        motion = TrueMotion(before.position_world, before.velocity_world, before.world_from_body, rate)
        self._times.append(start)
        self._pieces.append((motion, place, seconds))
        if len(self._times) > 4096 and self._times[2048] < start - _KEPT:
            del self._times[:2048], self._pieces[:2048]
        return motion

    def at(self, seconds: float) -> TrueMotion:
        """The motion at one time; before the first step and after the last one it is extrapolated."""
        k = max(bisect_right(self._times, seconds) - 1, 0)
        motion, place, whole = self._pieces[k]
        s = seconds - self._times[k]
        bend = (place - motion.position_world - motion.velocity_world * whole) / whole**2
        return TrueMotion(
            motion.position_world + motion.velocity_world * s + bend * s * s,
            motion.velocity_world + 2.0 * bend * s,
            motion.world_from_body @ so3_exp(motion.angular_velocity_body * s),
            motion.angular_velocity_body,
        )

    def poses(self, seconds: F64) -> tuple[F64, F64]:
        """(N, 3, 3) rotations `world_from_body` and (N, 3) places at times (N,)."""
        motions = [self.at(float(s)) for s in seconds]
        return np.stack([m.world_from_body for m in motions]), np.stack([m.position_world for m in motions])
