"""The motion of one moment carried on by itself: what the tracker predicts from while the filter is at work."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

from alight.geometry import Pose, so3_exp
from alight.motion.dynamics import Step, constant_step, inertial_step
from alight.motion.inertial import Preintegral, preintegrate, segments
from alight.motion.state import ACC, GYRO, MOUNT, POS, TIME, VEL, State
from alight.records import F64, ImuSample
from alight.settings import Filter


def instant(stamp_ns: int, core: F64) -> int:
    """When an exposure was, by the clock of GPS/INS (M27)."""
    return stamp_ns - round(float(core[TIME][0]) * 1e9)


def summed(imu: Sequence[ImuSample], start_ns: int, end_ns: int, core: F64, noise: Filter) -> Preintegral:
    """What the IMU says of the time from `start_ns` to `end_ns`, biases taken out (M4-M6)."""
    first = max(bisect_left(imu, start_ns, key=lambda s: s.t_ns) - 1, 0)
    pieces = segments([imu[i] for i in range(first, len(imu))], start_ns, end_ns)
    return preintegrate(pieces, core[GYRO], core[ACC], noise)


@dataclass(frozen=True, eq=False)
class Forecast:
    """A state's pose, velocity and biases, and how they move on: by the IMU, or at constant velocity."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) as in `State`
    cams: tuple[Pose, ...]  # body_from_cam
    inertial: bool
    noise: Filter

    @classmethod
    def of(cls, state: State, cams: tuple[Pose, ...], inertial: bool, noise: Filter) -> Forecast:
        """What a state says; later changes of it are not seen."""
        return cls(state.t_ns, state.R, state.core.copy(), cams, inertial, noise)

    def cameras(self, stamp_ns: int, imu: Sequence[ImuSample]) -> tuple[Pose, ...]:
        """Where the cameras are at an exposure, world_from_cam each; of the past: where they are now."""
        return self.placed(self._carried(max(instant(stamp_ns, self.core), self.t_ns), imu))

    def _carried(self, t_ns: int, imu: Sequence[ImuSample]) -> Step:
        p, v = self.core[POS], self.core[VEL]
        if self.inertial and imu:
            return inertial_step(self.R, p, v, summed(imu, self.t_ns, t_ns, self.core, self.noise))
        return constant_step(self.R, p, v, self.core[GYRO], (t_ns - self.t_ns) * 1e-9)

    def placed(self, step: Step) -> tuple[Pose, ...]:
        """The cameras of a body that is where a step ends."""
        rig = Pose(step.R @ so3_exp(self.core[MOUNT]), step.position)
        return tuple(rig @ c for c in self.cams)
