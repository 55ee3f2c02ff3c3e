"""Prediction of camera poses from a copy of the state, for the tracker while the filter is busy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, skew, so3_exp
from alight.motion.dynamics import Step, propagate
from alight.motion.ekf.state import AT, CLONE, FilterState
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.observations import Clones
from alight.motion.preintegration import preintegrate
from alight.records import Prediction
from alight.settings import FilterSettings

_CORE = np.r_[AT.motion, AT.mount]  # rows of the errors on which predicted poses depend
_MOVING = slice(CLONE, CLONE + AT.motion.stop)  # rows of attitude to accelerometer bias in a predictor's covariance


def instant(stamp_ns: int, core: F64) -> int:
    """Return the time of an exposure on the clock of GPS/INS, ns, by the time offset in `core` (31,) (M27)."""
    return stamp_ns - round(float(core[AT.time][0]) * 1e9)


@dataclass(frozen=True, eq=False)
class MotionPredictor:
    """Copy of a filter state from which cameras at later exposures are predicted, by the IMU or constant velocity."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) as in `FilterState`
    last: Clones  # the rig at the last exposure; empty before the first one
    P: F64  # (24, 24) covariance of pose `last` (6; zero if empty), attitude to accelerometer bias (15), AT.mount
    cams: tuple[Pose, ...]  # body_from_cam
    inertial: bool  # whether the IMU drives the motion
    noise: FilterSettings

    @classmethod
    def of(cls, state: FilterState, cams: tuple[Pose, ...], inertial: bool, noise: FilterSettings) -> MotionPredictor:
        """Copy the part of a state that a prediction needs; see the fields for `cams`, `inertial` and `noise`."""
        last = state.clones.select(range(len(state.clones))[-1:])
        rows = np.concatenate([np.arange(state.landmark_start - CLONE, state.landmark_start), _CORE])
        P = state.P[rows[:, None], rows]
        if not len(last):
            P[:CLONE], P[:, :CLONE] = 0.0, 0.0
        return cls(state.t_ns, state.R, state.core.copy(), last, P, cams, inertial, noise)

    def cameras(self, stamp_ns: int, before_ns: int | None, imu: ImuBuffer) -> Prediction:
        """Predict the cameras at the exposure stamped `stamp_ns`, relative to exposure `before_ns` (a stamp, or None).

        For an exposure before the state's time, the cameras are predicted at the state's time. The prediction has no
        earlier poses if the exposure `before_ns` is no longer held.
        """
        held = before_ns in self.last.stamps
        if not held and before_ns is not None and (before := instant(before_ns, self.core)) >= self.t_ns:
            return self._at_exposure(before_ns, before, imu).cameras(stamp_ns, before_ns, imu)
        after, F, Q = self._propagated(max(instant(stamp_ns, self.core), self.t_ns), imu)
        now = self._cameras_of(after.R @ so3_exp(self.core[AT.mount]), after.position)
        if not held:
            return Prediction(now)
        earlier = self._cameras_of(self.last.R[0], self.last.p[0])
        return Prediction(now, earlier, self._relative_covariance(after, F, Q))

    def _propagated(self, t_ns: int, imu: ImuBuffer) -> tuple[Step, F64, F64]:
        here = Step(self.R, self.core[AT.pos], self.core[AT.vel])
        driven = self.inertial and len(imu)
        m = preintegrate(imu, self.t_ns, t_ns, self.core[AT.biases], self.noise) if driven else None
        return propagate(here, self.core[AT.gyro], m, (t_ns - self.t_ns) * 1e-9, self.noise)

    def _at_exposure(self, stamp_ns: int, t_ns: int, imu: ImuBuffer) -> MotionPredictor:
        """Return the predictor propagated to the time `t_ns` of a new exposure, `stamp_ns`, which becomes `last`."""
        after, F, Q = self._propagated(t_ns, imu)
        core, P = self.core.copy(), self.P.copy()
        core[AT.pos], core[AT.vel] = after.position, after.velocity
        P[_MOVING] = F @ P[_MOVING]
        P[:, _MOVING] = P[:, _MOVING] @ F.T
        P[_MOVING, _MOVING] += Q
        R = after.R @ so3_exp(core[AT.mount])
        H = np.eye(len(P))
        H[:CLONE], H[:3, CLONE : CLONE + 3], H[3:CLONE, CLONE + 3 : 2 * CLONE] = 0.0, np.eye(3), np.eye(3)
        H[:3, -3:] = after.R
        last = Clones.none().with_pose(stamp_ns, R, after.position)
        return replace(self, t_ns=t_ns, R=after.R, core=core, last=last, P=H @ P @ H.T)

    def _relative_covariance(self, after: Step, F: F64, Q: F64) -> F64:
        """Return `Prediction.covariance` after propagation to `after` by the transition `F` with noise `Q` (15, 15)."""
        cam, rig, last = self.cams[0], after.R @ so3_exp(self.core[AT.mount]), self.last
        cam_from_world, arms = (rig @ cam.rotation).T, (last.R[0] @ cam.translation, rig @ cam.translation)
        baseline = after.position + arms[1] - last.p[0] - arms[0]
        J = np.zeros((6, 2 * CLONE))  # by (rotation, position) of the rig at the last and at this exposure
        J[:3, :3], J[:3, 6:9] = cam_from_world, -cam_from_world
        J[3:, :3], J[3:, 3:6] = -cam_from_world @ (skew(baseline) + skew(arms[0])), cam_from_world
        J[3:, 6:9], J[3:, 9:] = cam_from_world @ skew(arms[1]), -cam_from_world
        H = np.zeros((2 * CLONE, len(self.P)))
        H[:CLONE, :CLONE], H[CLONE:, _MOVING], H[CLONE : CLONE + 3, -3:] = np.eye(CLONE), F[:CLONE], after.R
        joint = H @ self.P @ H.T
        joint[CLONE:, CLONE:] += Q[:CLONE, :CLONE]
        return np.asarray(J @ joint @ J.T)

    def _cameras_of(self, R: F64, p: F64) -> tuple[Pose, ...]:
        rig = Pose(R, p)
        return tuple(rig @ c for c in self.cams)
