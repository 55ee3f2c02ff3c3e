"""The motion of one moment carried on by itself: what the tracker predicts from while the filter is at work."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from alight.geometry import Pose, skew, so3_exp
from alight.motion.dynamics import (
    Step,
    constant_step,
    constant_transition,
    inertial_step,
    inertial_transition,
)
from alight.motion.ekf.state import ACC, CLONE, GYRO, MOUNT, POS, TIME, VEL, Clone, FilterState
from alight.motion.preintegration import Preintegral, preintegrate, segments
from alight.records import F64, ImuSample, Prediction
from alight.settings import FilterSettings

_CORE = np.r_[0:15, MOUNT]  # of a state, that move a pose
_MOVING = slice(CLONE, CLONE + 15)  # in a forecast's covariance: ATT to ACC


def instant(stamp_ns: int, core: F64) -> int:
    """When an exposure was, by the clock of GPS/INS (M27)."""
    return stamp_ns - round(float(core[TIME][0]) * 1e9)


def summed(imu: Sequence[ImuSample], start_ns: int, end_ns: int, core: F64, noise: FilterSettings) -> Preintegral:
    """What the IMU says of the time from `start_ns` to `end_ns`, biases taken out (M4-M6)."""
    first = max(bisect_left(imu, start_ns, key=lambda s: s.t_ns) - 1, 0)
    pieces = segments([imu[i] for i in range(first, len(imu))], start_ns, end_ns)
    return preintegrate(pieces, core[GYRO], core[ACC], noise)


@dataclass(frozen=True, eq=False)
class MotionPredictor:
    """A state's pose, velocity and biases, and how they move on: by the IMU, or at constant velocity."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) as in `FilterState`
    last: Clone | None  # the rig at the last exposure
    P: F64  # (24, 24) joint: `last` (6; zero without it), ATT to ACC, MOUNT
    cams: tuple[Pose, ...]  # body_from_cam
    inertial: bool
    noise: FilterSettings

    @classmethod
    def of(cls, state: FilterState, cams: tuple[Pose, ...], inertial: bool, noise: FilterSettings) -> MotionPredictor:
        """What a state says; later changes of it are not seen."""
        last = copy(state.clones[-1]) if state.clones else None
        rows = _CORE if last is None else np.r_[state.clone_at(len(state.clones) - 1), _CORE]
        P = np.zeros((CLONE + len(_CORE), CLONE + len(_CORE)))
        P[-len(rows) :, -len(rows) :] = state.P[np.ix_(rows, rows)]
        return cls(state.t_ns, state.R, state.core.copy(), last, P, cams, inertial, noise)

    def cameras(self, stamp_ns: int, before_ns: int | None, imu: Sequence[ImuSample]) -> Prediction:
        """Where the cameras are at an exposure, as seen from that at `before_ns`; of the past: where they are now."""
        last = self.last if self.last is not None and self.last.t_ns == before_ns else None
        if last is None and before_ns is not None and (there := instant(before_ns, self.core)) >= self.t_ns:
            return self._moved(before_ns, there, imu).cameras(stamp_ns, before_ns, imu)
        after, F, Q = self._carried(max(instant(stamp_ns, self.core), self.t_ns), imu)
        now = self._placed(after.R @ so3_exp(self.core[MOUNT]), after.position)
        if last is None:
            return Prediction(now)
        return Prediction(now, self._placed(last.R, last.p), self._change(last, after, F, Q))

    def _carried(self, t_ns: int, imu: Sequence[ImuSample]) -> tuple[Step, F64, F64]:
        """The step to a later time, its (15, 15) transition and noise."""
        here = Step(self.R, self.core[POS], self.core[VEL])
        if self.inertial and imu:
            m = summed(imu, self.t_ns, t_ns, self.core, self.noise)
            after = inertial_step(self.R, here.position, here.velocity, m)
            return after, *inertial_transition(here, after, m)
        dt, rate = (t_ns - self.t_ns) * 1e-9, self.core[GYRO]
        after = constant_step(self.R, here.position, here.velocity, rate, dt)
        return after, *constant_transition(self.R, rate, dt, self.noise)

    def _moved(self, stamp_ns: int, t_ns: int, imu: Sequence[ImuSample]) -> MotionPredictor:
        """This one carried on to an exposure that the state has not heard of yet."""
        after, F, Q = self._carried(t_ns, imu)
        core, P = self.core.copy(), self.P.copy()
        core[POS], core[VEL] = after.position, after.velocity
        P[_MOVING] = F @ P[_MOVING]
        P[:, _MOVING] = P[:, _MOVING] @ F.T
        P[_MOVING, _MOVING] += Q
        R = after.R @ so3_exp(core[MOUNT])
        H = np.eye(len(P))
        H[:CLONE], H[:3, CLONE : CLONE + 3], H[3:CLONE, CLONE + 3 : 2 * CLONE] = 0.0, np.eye(3), np.eye(3)
        H[:3, -3:] = after.R
        last = Clone(stamp_ns, R, after.position, R, after.position)
        return replace(self, t_ns=t_ns, R=after.R, core=core, last=last, P=H @ P @ H.T)

    def _change(self, last: Clone, after: Step, F: F64, Q: F64) -> F64:
        """(6, 6) covariance of what turns and moves earlier points in camera 0 (`Prediction`)."""
        cam, rig = self.cams[0], after.R @ so3_exp(self.core[MOUNT])
        to_cam, arms = (rig @ cam.rotation).T, (last.R @ cam.translation, rig @ cam.translation)
        way = after.position + arms[1] - last.p - arms[0]
        J = np.zeros((6, 2 * CLONE))  # by (rotation, position) of the rig then, now
        J[:3, :3], J[:3, 6:9] = to_cam, -to_cam
        J[3:, :3], J[3:, 3:6] = -to_cam @ (skew(way) + skew(arms[0])), to_cam
        J[3:, 6:9], J[3:, 9:] = to_cam @ skew(arms[1]), -to_cam
        H = np.zeros((2 * CLONE, len(self.P)))
        H[:CLONE, :CLONE], H[CLONE:, _MOVING], H[CLONE : CLONE + 3, -3:] = np.eye(CLONE), F[:CLONE], after.R
        joint = H @ self.P @ H.T
        joint[CLONE:, CLONE:] += Q[:CLONE, :CLONE]
        return np.asarray(J @ joint @ J.T)

    def _placed(self, R: F64, p: F64) -> tuple[Pose, ...]:
        rig = Pose(R, p)
        return tuple(rig @ c for c in self.cams)
