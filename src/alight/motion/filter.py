"""The structure-from-motion filter: tracks and GPS/INS (and IMU) to one consistent chain of poses.

An error-state EKF on SO(3) x R^k after the 2004 paper, whose state is X = (x_1..x_n, R, T, omega, v); what was added
and where it departs is in docs/method-motion.md.
"""

from __future__ import annotations

import logging
from bisect import bisect_left
from collections import deque

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose, so3_exp
from alight.motion.dynamics import (
    Step,
    bias_walk,
    constant_step,
    constant_transition,
    inertial_step,
    inertial_transition,
    nav_decay,
    spread,
)
from alight.motion.inertial import Preintegral, preintegrate, segments
from alight.motion.navigation import initial_state, measurements, rate_measurement, sigmas
from alight.motion.points import Gate, measure, take_up
from alight.motion.ring import Refined, refine
from alight.motion.smoother import Recording, smooth
from alight.motion.state import ACC, ATT, CORE, GYRO, MOUNT, NAV_POS, OFFSET, POS, VEL, State
from alight.motion.vision import sight_sigma
from alight.motion.window import Poses, Sights, as_rows, eliminate, linearise, meet
from alight.records import F64, ImuSample, Motion, MotionState, NavSample, Rig, Tracks
from alight.settings import Filter

log = logging.getLogger(__name__)

Ints = NDArray[np.int64]


def _contains(ids: Ints, id_: int) -> bool:
    at = int(np.searchsorted(ids, id_))
    return at < len(ids) and int(ids[at]) == id_


_SUPPORT = 8  # points inside their gates below which the cameras do not hold the motion
_JUMP = 5  # GPS/INS positions in a row outside the gate that are taken as a jump
_MISSES = 3  # exposures in a row outside its gate after which a point is dropped: it moves
_LEAST_POSES = 3  # that must have seen a feature for its sights to measure them
_KEEP_NS = 1_000_000_000  # ns of IMU samples kept


class MotionFilter:
    """Feed it what comes, in order of time; every exposure gives a `Motion` as soon as GPS/INS has been heard."""

    def __init__(self, rig: Rig, settings: Filter) -> None:
        self._cams = tuple(c.body_from_cam for c in rig.cameras)
        self._settings = settings
        self._camera = rig.cameras[0].camera
        self._gate = Gate(settings.gate)
        self._imu: deque[ImuSample] = deque()
        self._inertial = False
        self._state: State | None = None
        self._first: Step | None = None  # the state as last predicted: where Jacobians are taken
        self._nav_sigma = np.ones(9)
        self._waiting = Sights.none(len(rig.cameras))  # the sub-filter: sights that the state has not used
        self._outside = 0  # GPS/INS positions in a row outside the gate
        self._last_nav_ns = self._last_good_ns = self._last_exposure_ns = -(1 << 62)
        self._settled = 0
        self._recording = Recording(rig, settings) if settings.smooth else None

    def feed_imu(self, sample: ImuSample) -> None:
        """Take one inertial measurement; it is used when the next exposure or GPS/INS row comes."""
        if self._imu and sample.t_ns <= self._imu[-1].t_ns:
            return
        if not (np.isfinite(sample.angular_velocity_body).all() and np.isfinite(sample.specific_force_body).all()):
            return
        self._imu.append(sample)
        if self._recording:
            self._recording.imu.append(sample)
        if not self._inertial:
            self._inertial = True
            if self._state is not None:
                self._start_biases(self._state)
        while self._imu[0].t_ns < sample.t_ns - _KEEP_NS:
            self._imu.popleft()

    def feed_nav(self, sample: NavSample) -> None:
        """Take one row of the GPS/INS solution; rows that are older than the state are left out."""
        sigma = sigmas(sample, self._settings)
        if self._state is None:
            self._start(sample, sigma)
            return
        if sample.t_ns < self._state.t_ns:
            return
        self._propagate(self._state, sample.t_ns)
        self._nav_sigma = sigma
        if self._recording:
            self._recording.nav.append(sample)
        self._measure_nav(self._state, sample, sigma)

    def feed_tracks(self, tracks: Tracks) -> Motion | None:
        """Take the features of one exposure and return the motion; None: no GPS/INS row yet, or out of order."""
        state = self._state
        if state is None or tracks.t_ns < state.t_ns or tracks.t_ns <= self._last_exposure_ns:
            return None
        self._last_exposure_ns = tracks.t_ns
        self._propagate(state, tracks.t_ns)
        passed, tried = self._see(state, tracks) if len(tracks.ids) else (0, 0)
        motion = self._motion(state, self._judge(state, passed, tried), passed)
        if self._recording:
            self._recording.exposures.append((motion, tracks, self._snapshot(state)))
        return motion

    def ring(self) -> tuple[Motion, ...]:
        """The keyframes held, refined together with all that was seen from them (M23): consistent with each other.

        Their covariances are marginals; GPS/INS corrections move all of them together.
        """
        s = self._state
        if s is None or not s.clones:
            return ()
        found = refine(s, self._waiting, self._cams, self._settings.vague_share)
        return tuple(self._held(s, i, found) for i in range(len(s.clones)))

    def _held(self, s: State, i: int, found: Refined) -> Motion:
        rows = 6 * i + np.array([3, 4, 5, 0, 1, 2])
        rig = Pose(found.R[i], found.p[i])
        body = Pose(found.R[i] @ so3_exp(s.core[MOUNT]).T, found.p[i])
        covariance = s.in_world(found.covariance[np.ix_(rows, rows)], found.offset_cross[rows])
        offset = s.core[OFFSET].copy()
        return Motion(s.clones[i].t_ns, body, tuple(rig @ x for x in self._cams), covariance, offset_world=offset)

    def predict(self, t_ns: int) -> tuple[Pose, ...] | None:
        """Where the cameras will be at `t_ns`, world_from_cam each; None before the first GPS/INS row."""
        s = self._state
        if s is None:
            return None
        step, _ = self._step(s, max(t_ns, s.t_ns))
        rig = Pose(step.R @ so3_exp(s.core[MOUNT]), step.position)
        return tuple(rig @ c for c in self._cams)

    def smoothed(self) -> list[Motion]:
        """The motions of all exposures so far, refined together (docs/method-motion.md, M18-M22).

        Empty when `smooth` is off in the settings; the filter's own where a batch is not possible.
        """
        return smooth(self._recording) if self._recording else []

    # -- time ------------------------------------------------------------------------------------------------------

    def _start(self, sample: NavSample, sigma: F64) -> None:
        self._state = initial_state(sample, sigma, self._settings)
        if self._state is None:
            return
        self._nav_sigma, self._last_nav_ns = sigma, sample.t_ns
        if self._inertial:
            self._start_biases(self._state)
        else:
            self._state.P[GYRO, GYRO] = np.eye(3) * 0.5**2  # rad/s: any
            if sample.angular_velocity_body is not None:
                self._state.core[GYRO] = sample.angular_velocity_body
        if self._recording:
            self._recording.nav.append(sample)
        self._first = self._here(self._state)

    def _start_biases(self, state: State) -> None:
        for part, sigma in ((GYRO, self._settings.gyro_bias_sigma), (ACC, self._settings.accelerometer_bias_sigma)):
            state.core[part] = 0.0
            state.P[part, :], state.P[:, part] = 0.0, 0.0
            state.P[part, part] = np.eye(3) * sigma**2

    @staticmethod
    def _here(state: State) -> Step:
        return Step(state.R, state.core[POS].copy(), state.core[VEL].copy())

    def _summed(self, state: State, t_ns: int) -> Preintegral:
        start = max(bisect_left(self._imu, state.t_ns, key=lambda s: s.t_ns) - 1, 0)
        samples = [self._imu[i] for i in range(start, len(self._imu))]
        return preintegrate(segments(samples, state.t_ns, t_ns), state.core[GYRO], state.core[ACC], self._settings)

    def _step(self, state: State, t_ns: int) -> tuple[Step, Preintegral | None]:
        p, v = state.core[POS], state.core[VEL]
        if self._inertial:
            m = self._summed(state, t_ns)
            return inertial_step(state.R, p, v, m), m
        return constant_step(state.R, p, v, state.core[GYRO], (t_ns - state.t_ns) * 1e-9), None

    def _propagate(self, state: State, t_ns: int) -> None:
        dt = (t_ns - state.t_ns) * 1e-9
        if dt <= 0 or self._first is None:
            return
        after, m = self._step(state, t_ns)
        if m is not None:
            F, Q = inertial_transition(self._first, after, m)
            Q[range(15), range(15)] += bias_walk(dt, self._settings)
        else:
            F, Q = constant_transition(state.R, state.core[GYRO], dt, self._settings)
        decay, drift = nav_decay(dt, self._nav_sigma, self._settings)
        spread(state, F, Q, decay, drift)
        state.R, state.core[POS], state.core[VEL] = after.R, after.position, after.velocity
        state.core[15:24] *= decay
        state.t_ns = t_ns
        self._first = self._here(state)

    # -- GPS/INS ---------------------------------------------------------------------------------------------------

    def _measure_nav(self, state: State, sample: NavSample, sigma: F64) -> None:
        rows = measurements(state, sample, sigma, self._settings)
        rate = None if self._inertial else rate_measurement(state, sample, self._settings)
        passed = [row for row in [*rows, *([rate] if rate else [])] if self._inside(state, *row)]
        if sample.position_world is not None:
            inside = bool(passed) and passed[0] is rows[0]
            self._outside = 0 if inside else self._outside + 1
        if passed:
            self._last_nav_ns = sample.t_ns
            state.update(*(np.concatenate([row[k] for row in passed]) for k in range(3)))
        if self._outside >= _JUMP and sample.position_world is not None:
            self._jump(state, sample.position_world)

    def _inside(self, state: State, residual: F64, H: F64, variance: F64) -> bool:
        return self._gate.passes(residual, H @ state.P @ H.T + np.diag(variance))

    def _jump(self, state: State, position: F64) -> None:
        """The solution jumped: what it is off by is set anew, so that the jump does not pull the vehicle along."""
        expected = state.core[POS] + state.core[OFFSET]
        log.warning("GPS/INS position jumped by %.1f m", np.linalg.norm(position - expected - state.core[NAV_POS]))
        state.core[NAV_POS] = position - expected
        known = -state.P[POS] - state.P[OFFSET]  # (3, n): of the new error with everything
        known[:, NAV_POS] = 0.0
        own = -known[:, POS] - known[:, OFFSET] + np.eye(3) * self._settings.nav_position_white**2
        state.P[NAV_POS], state.P[:, NAV_POS], state.P[NAV_POS, NAV_POS] = known, known.T, own
        self._outside = 0

    # -- cameras ---------------------------------------------------------------------------------------------------

    def _see(self, state: State, tracks: Tracks) -> tuple[int, int]:
        """One exposure (M11-M17): use up what ended, measure the points held, take up what became well known."""
        order = np.argsort(tracks.ids)
        ids, seen = tracks.ids[order], tracks.normalised[order]
        sigma = sight_sigma(tracks, self._camera, self._settings)[order]
        gone = self._superfluous(state)
        self._use_up(state, ids, gone)
        lost = [i for i, x in enumerate(state.points) if x.misses >= _MISSES or not _contains(ids, x.id)]
        state.drop(clones=gone, points=lost)
        state.add_clone()
        passed, tried, _ = measure(state, ids, seen, sigma, self._cams, self._gate)
        new = ~np.isin(ids, [x.id for x in state.points])
        self._waiting = self._waiting.without_poses(gone).at_next_pose(ids[new], seen[new], sigma[new])
        self._take_up(state)
        return passed, tried

    def _superfluous(self, state: State) -> list[int]:
        """The last clone if it is no keyframe; else the oldest when there are too many."""
        c = state.clones
        if len(c) >= 3 and np.linalg.norm(c[-1].p - c[-2].p) < self._settings.keyframe_baseline * self._distance(state):
            return [len(c) - 1]
        return [0] if len(c) >= self._settings.clones else []

    @staticmethod
    def _distance(state: State) -> float:
        far = [float(np.linalg.norm(x.x - state.core[POS])) for x in state.points]
        return float(np.median(far)) if far else 0.0

    def _use_up(self, state: State, ids: Ints, gone: list[int]) -> None:
        """Measure the poses by the features that are seen no more, or whose first pose is about to be forgotten."""
        w = self._waiting
        if not len(w.ids):
            return
        ended = ~np.isin(w.ids, ids)
        if gone == [0]:
            ended |= w.where[:, 0]
        useful = ended & (w.where.sum(axis=1) >= _LEAST_POSES)
        self._absorb(state, w.rows(useful))
        self._waiting = w.rows(~ended)

    def _absorb(self, state: State, sights: Sights) -> None:
        if not len(sights.ids):
            return
        poses, columns = Poses.of(state.clones), state.clone_columns()
        x = meet(sights, poses, self._cams)
        found = eliminate(linearise(sights, poses, self._cams, x))
        known = self._known(found.point_covariance, x, state, self._settings.vague_share) & (found.freedom > 0)
        inside = found.distances(state.P[np.ix_(columns, columns)]) <= self._gate.limits(np.maximum(found.freedom, 0))
        if (known & inside).any():
            state.correct(*as_rows(*found.information((known & inside).astype(float))), columns)

    @staticmethod
    def _known(covariance: F64, x: F64, state: State, share: float) -> NDArray[np.bool_]:
        distance = np.linalg.norm(x - state.core[POS], axis=1)
        return np.asarray(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]) < share * distance)

    def _take_up(self, state: State) -> None:
        """Fill the free places, longest seen features first."""
        s, w = self._settings, self._waiting
        free, poses = s.points - len(state.points), w.where.sum(axis=1)
        ready = np.flatnonzero((poses >= 3) & w.where[:, -1])
        if free <= 0 or not len(ready):
            return
        ready = ready[np.argsort(-poses[ready], kind="stable")][: 2 * free]
        x = meet(w.rows(ready), Poses.of(state.clones), self._cams)
        found = eliminate(linearise(w.rows(ready), Poses.of(state.clones), self._cams, x))
        taken = []
        for i in np.flatnonzero(self._known(found.point_covariance, x, state, s.depth_share))[:free]:
            one = ready[i : i + 1]
            if take_up(state, w.rows(one), x[i : i + 1], self._cams, self._gate):
                taken.append(int(one[0]))
        self._waiting = w.rows(np.setdiff1d(np.arange(len(w.ids)), taken))

    # -- what goes out ---------------------------------------------------------------------------------------------

    def _judge(self, state: State, passed: int, tried: int) -> MotionState:
        """How far to trust this exposure: cameras and GPS/INS both there and agreeing, one of them, none."""
        seen = passed >= _SUPPORT and 2 * passed >= tried
        if seen:
            self._last_good_ns, self._settled = state.t_ns, self._settled + 1
        coast = self._settings.coast * 1e9
        nav = state.t_ns - self._last_nav_ns <= coast
        if not nav and state.t_ns - self._last_good_ns > coast:
            return MotionState.LOST
        if seen and nav and self._outside == 0:
            return MotionState.GOOD if self._settled >= 3 else MotionState.INITIALISING
        return MotionState.INITIALISING if self._settled == 0 and nav else MotionState.DEGRADED

    def _motion(self, state: State, judged: MotionState, support: int) -> Motion:
        rig, order = Pose(state.rig, state.core[POS]), np.r_[POS, ATT]
        return Motion(
            state.t_ns,
            Pose(state.R, state.core[POS]),
            tuple(rig @ c for c in self._cams),
            state.in_world(state.P[np.ix_(order, order)], state.P[order, OFFSET]),
            state.core[VEL].copy(),
            judged,
            support,
            state.core[OFFSET].copy(),
        )

    @staticmethod
    def _snapshot(state: State) -> F64:
        return state.core[:CORE].copy()
