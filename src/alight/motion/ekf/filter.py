"""The structure-from-motion filter: tracks and GPS/INS (and IMU) to one consistent chain of poses.

An error-state EKF on SO(3) x R^k after the 2004 paper, whose state is X = (x_1..x_n, R, T, omega, v); what was added
and where it departs is in docs/method/motion.md.
"""

from __future__ import annotations

import logging
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from alight.geometry import Pose, so3_exp, so3_log
from alight.motion.dynamics import (
    LONG,
    Step,
    bias_walk,
    constant_step,
    constant_transition,
    inertial_step,
    inertial_transition,
    nav_decay,
    propagate_covariance,
)
from alight.motion.ekf.health import Health, Votes, is_diverged
from alight.motion.ekf.initial_attitude import SIGMA, WAY, attitude_from_course
from alight.motion.ekf.keyframe_posterior import RefinedPoses
from alight.motion.ekf.landmarks import Gate
from alight.motion.ekf.prediction import MotionPredictor, instant, summed
from alight.motion.ekf.state import ACC, ATT, CORE, GYRO, MOUNT, NAV_ATT, NAV_POS, OFFSET, POS, TIME, VEL, FilterState
from alight.motion.ekf.visual_update import VisualUpdate
from alight.motion.gps_ins import initial_state, measurements, rate_measurement, sigmas
from alight.motion.preintegration import Preintegral
from alight.motion.smoother.smoother import RecordedFlight, smooth_flight
from alight.records import F64, ImuSample, KeyframePosterior, Motion, MotionState, NavSample, Prediction, Rig, Tracks
from alight.settings import FilterSettings

log = logging.getLogger(__name__)

_JUMP = (
    5.0  # s of GPS positions outside their gate after which they are taken as a jump, and not as a fault that passes
)
_FRESH = 0.2  # s between a GPS position and the exposure that it is taken for
_KEEP_NS = 1_000_000_000  # ns of IMU samples kept beyond what may come late
_RATE_NS, _RATE_SAMPLES = 15_000_000, 7  # ns about an instant over which the angular velocity is averaged
_NEVER = -(1 << 62)  # ns
_DOUBT = np.repeat([0.03, 0.3], [2, 1])  # rad about east, north, up: added to a state that the pictures contradict
_PLACE_FIRST = np.array([3, 4, 5, 0, 1, 2])  # the order of what goes out, of a clone's rows
_HOPELESS = 3  # doubts in a row without a good exposure between, after which the state is made anew


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A filter at one moment."""

    t_ns: int
    state: FilterState | None
    parts: dict[str, Any]  # the other attributes
    exposures: int  # that had been recorded
    rows: int


class MotionFilter:
    """Feed it what comes, in order of time; every exposure gives a `Motion` as soon as GPS/INS has been heard."""

    def __init__(self, rig: Rig, settings: FilterSettings) -> None:
        self._cams = tuple(c.body_from_cam for c in rig.cameras)
        self._settings = settings
        self._camera = rig.cameras[0].camera
        self._gate = Gate(settings.gate)
        self._features = VisualUpdate(self._camera, self._cams, settings)
        self._health = Health(settings.coast)
        self._imu: deque[ImuSample] = deque()
        self._keep_ns = _KEEP_NS + round(settings.lateness * 1e9)
        self._inertial = False
        self._state: FilterState | None = None
        self._first: Step | None = None  # the state as last predicted: where Jacobians are taken
        self._nav_sigma = np.ones(9)
        self._last_exposure_ns = _NEVER
        self._doubts = 0  # in a row
        self._map, self._lost = 0, False
        self._heard: NavSample | None = None  # the last row
        self._before: tuple[Tracks, F64] | None = None  # the last exposure with a GPS position and no attitude
        self._recording = RecordedFlight(rig, settings) if settings.smooth else None

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
        while self._imu[0].t_ns < sample.t_ns - self._keep_ns:
            self._imu.popleft()

    def feed_nav(self, sample: NavSample) -> None:
        """Take one row of the GPS/INS solution; rows that are older than the state are left out."""
        sigma = sigmas(sample, self._settings)
        self._heard = sample
        if self._state is None:
            self._start(sample, sigma)
            return
        if sample.t_ns < self._state.t_ns:
            return
        self._propagate(self._state, sample.t_ns)
        if self._doubts >= _HOPELESS and self._start(sample, sigma):
            return
        self._nav_sigma = sigma
        if self._recording:
            self._recording.nav.append(sample)
        self._measure_nav(self._state, sample, sigma)
        if is_diverged(self._state):
            self._start(sample, sigma)

    def feed_tracks(self, tracks: Tracks) -> Motion | None:
        """Take the features of one exposure and return the motion; None: no GPS/INS row yet, or out of order."""
        if tracks.t_ns <= self._last_exposure_ns or self.time_of(tracks) < self.time_ns:
            return None
        self._last_exposure_ns = tracks.t_ns
        self._orient(tracks)
        state = self._state
        if state is None:
            return None
        self._propagate(state, self.time_of(tracks))
        votes = self._features.see(state, tracks) if len(tracks.ids) else Votes()
        if self._health.look(tracks.t_ns, votes):
            self._doubt(state)
        motion = self._motion(state, tracks.t_ns, votes.inside)
        if self._recording:
            self._recording.exposures.append((motion, tracks, self._snapshot(state)))
        return motion

    def _orient(self, tracks: Tracks) -> None:
        """Where GPS comes without attitude, the pictures give it: at the start, and between photos (M26)."""
        heard, before = self._heard, self._before
        if heard is None or heard.position_world is None or heard.world_from_body is not None:
            return
        if (tracks.t_ns - heard.t_ns) * 1e-9 > _FRESH:
            return
        if before is not None and np.linalg.norm((heard.position_world - before[1])[:2]) < WAY:
            return
        self._before = (tracks, heard.position_world)
        if before is None:
            return
        found = attitude_from_course(before[0], tracks, heard.position_world - before[1], self._cams[0])
        if found is None:
            return
        if self._state is None:
            row = replace(heard, t_ns=tracks.t_ns, world_from_body=found, sigma_attitude=np.abs(found.T) @ SIGMA)
            self._start(row, sigmas(row, self._settings))
        elif tracks.t_ns - before[0].t_ns > LONG * 1e9:
            e = so3_log(found @ self._state.R.T)
            self._state.correct(e / SIGMA, np.diag(1.0 / SIGMA), np.arange(ATT.start, ATT.stop))

    def posterior(self) -> KeyframePosterior:
        """The keyframes held, oldest first, refined with all that was seen from them (M23): consistent with each other.

        Covariances of the single motions are marginals in the world; the joint one is in the map, whose place in the
        world (`offset_world`) no picture tells. GPS/INS corrections move all of them together.
        """
        s = self._state
        if s is None or not s.clones:
            return KeyframePosterior((), np.zeros((0, 0)))
        found, K = self._features.ring(s), len(s.clones)
        order = (6 * np.arange(K)[:, None] + _PLACE_FIRST).ravel()
        return KeyframePosterior(
            tuple(self._held(s, i, found) for i in range(K)), found.covariance[np.ix_(order, order)]
        )

    def _held(self, s: FilterState, i: int, found: RefinedPoses) -> Motion:
        rows = 6 * i + _PLACE_FIRST
        rig = Pose(found.R[i], found.p[i])
        body = Pose(found.R[i] @ so3_exp(s.core[MOUNT]).T, found.p[i])
        covariance = s.in_world(found.covariance[np.ix_(rows, rows)], found.offset_cross[rows])
        offset = s.core[OFFSET].copy()
        cams = tuple(rig @ x for x in self._cams)
        return Motion(s.clones[i].t_ns, body, cams, covariance, offset_world=offset, map=self._map)

    def predict(self, stamp_ns: int, before_ns: int | None = None) -> Prediction | None:
        """Where the cameras will be at an exposure, as seen from that at `before_ns`; None before any GPS/INS row."""
        return None if self._state is None else self.forecast_of(self._state).cameras(stamp_ns, before_ns, self._imu)

    def forecast(self) -> MotionPredictor | None:
        """What can be said of later exposures now; None before the first GPS/INS row."""
        return None if self._state is None else self.forecast_of(self._state)

    def forecast_of(self, state: FilterState) -> MotionPredictor:
        """What a state of this filter says of later exposures."""
        return MotionPredictor.of(state, self._cams, self._inertial, self._settings)

    def smoothed(self) -> list[Motion]:
        """The motions of all exposures so far, refined together (docs/method/smoother.md, M18-M22).

        Empty when `smooth` is off in the settings, and where a batch is not possible.
        """
        return smooth_flight(self._recording) if self._recording else []

    @property
    def time_ns(self) -> int:
        """Of the state, by the clock of GPS/INS."""
        return self._state.t_ns if self._state is not None else _NEVER

    def time_of(self, event: NavSample | Tracks) -> int:
        """When an event was, by the clock of GPS/INS."""
        if isinstance(event, NavSample) or self._state is None:
            return event.t_ns
        return instant(event.t_ns, self._state.core)

    @property
    def imu(self) -> Sequence[ImuSample]:
        """The last inertial measurements."""
        return self._imu

    def snapshot(self) -> Snapshot:
        """The filter as it is now; inertial measurements and the recording are not copied."""
        parts = {k: v for k, v in vars(self).items() if k not in ("_imu", "_recording", "_state")}
        parts |= {"_health": copy(self._health), "_features": self._features.copy()}
        r, state = self._recording, self._state.copy() if self._state is not None else None
        return Snapshot(self.time_ns, state, parts, len(r.exposures) if r else 0, len(r.nav) if r else 0)

    def restore(self, earlier: Snapshot) -> None:
        """Go back; a snapshot serves once."""
        vars(self).update(earlier.parts)
        self._state = earlier.state
        if self._recording:
            del self._recording.exposures[earlier.exposures :], self._recording.nav[earlier.rows :]

    # -- time ------------------------------------------------------------------------------------------------------

    def _start(self, sample: NavSample, sigma: F64) -> bool:
        """Begin with a row that has position and attitude: the first time, or in a new map after all was lost."""
        state = initial_state(sample, sigma, self._settings)
        if state is None:
            return False
        if self._state is not None:
            self._map += 1
            log.warning(
                "motion: started anew from GPS/INS in map %d, which poses from before do not belong to", self._map
            )
            state.core[TIME], state.P[TIME, TIME] = self._state.core[TIME], self._state.P[TIME, TIME]
        self._state, self._nav_sigma, self._doubts = state, sigma, 0
        self._features.forget(state)
        self._health.restart(sample.t_ns)
        if self._inertial:
            self._start_biases(state)
        else:
            state.P[GYRO, GYRO] = np.eye(3) * 0.5**2  # rad/s: any
            if sample.angular_velocity_body is not None:
                state.core[GYRO] = sample.angular_velocity_body
        if self._recording:
            self._recording.nav.append(sample)
        self._first = self._here(state)
        return True

    def _start_biases(self, state: FilterState) -> None:
        for part, sigma in ((GYRO, self._settings.gyro_bias_sigma), (ACC, self._settings.accelerometer_bias_sigma)):
            state.core[part] = 0.0
            state.P[part, :], state.P[:, part] = 0.0, 0.0
            state.P[part, part] = np.eye(3) * sigma**2

    @staticmethod
    def _here(state: FilterState) -> Step:
        return Step(state.R, state.core[POS].copy(), state.core[VEL].copy())

    def _step(self, state: FilterState, t_ns: int) -> tuple[Step, Preintegral | None]:
        p, v = state.core[POS], state.core[VEL]
        if self._inertial:
            m = summed(self._imu, state.t_ns, t_ns, state.core, self._settings)
            return inertial_step(state.R, p, v, m), m
        return constant_step(state.R, p, v, state.core[GYRO], (t_ns - state.t_ns) * 1e-9), None

    def _propagate(self, state: FilterState, t_ns: int) -> None:
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
        propagate_covariance(state, F, Q, decay, drift)
        state.R, state.core[POS], state.core[VEL] = after.R, after.position, after.velocity
        state.core[15:24] *= decay
        state.t_ns = t_ns
        state.rate, state.rate_variance = self._rate(state)
        self._first = self._here(state)

    def _rate(self, state: FilterState) -> tuple[F64, float]:
        """(3,) rad/s in the body about now, the mean of some samples, and its variance."""
        if not self._inertial:
            return state.core[GYRO].copy(), float(state.P[GYRO, GYRO].diagonal().max())
        first = bisect_left(self._imu, state.t_ns - _RATE_NS, key=lambda s: s.t_ns)
        some = [self._imu[i].angular_velocity_body for i in range(first, len(self._imu))][:_RATE_SAMPLES]
        mean = np.mean(some or [self._imu[-1].angular_velocity_body], axis=0)
        return mean - state.core[GYRO], self._settings.gyro_noise**2 / (2e-9 * _RATE_NS)

    # -- GPS/INS ---------------------------------------------------------------------------------------------------

    def _measure_nav(self, state: FilterState, sample: NavSample, sigma: F64) -> None:
        rows = measurements(state, sample, sigma, self._settings)
        rate = None if self._inertial else rate_measurement(state, sample, self._settings)
        passed = [row for row in [*rows, *([rate] if rate else [])] if self._inside(state, *row)]
        place = sample.position_world is not None
        inside = place and bool(passed) and passed[0] is rows[0]
        if passed:
            state.update(*(np.concatenate([row[k] for row in passed]) for k in range(3)))
        outside = self._health.hear(sample.t_ns, inside if place else None, len(passed) > inside)
        if outside > _JUMP and sample.position_world is not None:
            self._jump(state, sample.position_world)

    def _inside(self, state: FilterState, residual: F64, H: F64, variance: F64) -> bool:
        return self._gate.passes(residual, H @ state.P @ H.T + np.diag(variance))

    def _jump(self, state: FilterState, position: F64) -> None:
        """The solution jumped: what it is off by is set anew, so that the jump does not pull the vehicle along."""
        expected = state.core[POS] + state.core[OFFSET]
        log.warning("GPS/INS position jumped by %.1f m", np.linalg.norm(position - expected - state.core[NAV_POS]))
        state.core[NAV_POS] = position - expected
        known = -state.P[POS] - state.P[OFFSET]  # (3, n): of the new error with everything
        known[:, NAV_POS] = 0.0
        own = -known[:, POS] - known[:, OFFSET] + np.eye(3) * self._settings.nav_position_white**2
        state.P[NAV_POS], state.P[:, NAV_POS], state.P[NAV_POS, NAV_POS] = known, known.T, own
        self._health.hear(state.t_ns, True, True)

    def _doubt(self, state: FilterState) -> None:
        """The pictures agree with each other and not with the state: its attitude may be wrong, INS and all (M25)."""
        self._doubts += 1
        log.warning("motion: the pictures contradict the state; its attitude is taken as less sure")
        self._features.forget(state)
        spread = np.diag(_DOUBT**2)
        state.P[ATT, ATT] += spread
        state.P[NAV_ATT, NAV_ATT] += spread
        state.P[ATT, NAV_ATT] -= spread
        state.P[NAV_ATT, ATT] -= spread

    # -- what goes out ---------------------------------------------------------------------------------------------

    def _motion(self, state: FilterState, stamp_ns: int, support: int) -> Motion:
        judged, why = self._health.judge(state)
        self._doubts = 0 if judged is MotionState.GOOD else self._doubts
        if self._lost and judged is not MotionState.LOST:
            self._map += 1
            log.warning(
                "motion: found again, in map %d: the way from the poses before is known by GPS/INS only", self._map
            )
        self._lost = judged is MotionState.LOST
        rig, order = Pose(state.rig, state.core[POS]), np.r_[POS, ATT]
        return Motion(
            stamp_ns,
            Pose(state.R, state.core[POS]),
            tuple(rig @ c for c in self._cams),
            state.in_world(state.P[np.ix_(order, order)], state.P[order, OFFSET]),
            state.core[VEL].copy(),
            judged,
            support,
            state.core[OFFSET].copy(),
            why,
            self._map,
        )

    @staticmethod
    def _snapshot(state: FilterState) -> F64:
        return state.core[:CORE].copy()
