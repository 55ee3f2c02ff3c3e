"""The structure-from-motion filter: tracks, GPS/INS and IMU to one consistent chain of poses.

An error-state EKF on SO(3) x R^k after the paper of 2004, with state X = (x_1..x_n, R, T, omega, v). Extensions:
multi-state constraints (MSCKF, Mourikis and Roumeliotis 2007), first-estimates Jacobians (Huang et al. 2008),
preintegrated IMU (Forster et al. 2017). See docs/method/motion.md.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, so3_log
from alight.motion.dynamics import (
    MAX_RATE_AGE,
    Step,
    bias_walk,
    constant_step,
    constant_transition,
    inertial_step,
    inertial_transition,
    nav_decay,
    propagate_covariance,
)
from alight.motion.ekf.health import NEVER_NS, GateCounts, Health, is_diverged
from alight.motion.ekf.initial_attitude import MAX_START_SIGMA, CourseAttitude, PositionedExposure
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.landmarks import Gate
from alight.motion.ekf.memory import FilterMemory, Snapshot
from alight.motion.ekf.prediction import MotionPredictor, instant, preintegrated
from alight.motion.ekf.state import (
    ACC,
    ATT,
    CORE,
    GYRO,
    MOTION,
    NAV,
    NAV_ATT,
    NAV_POS,
    OFFSET,
    POS,
    TIME,
    VEL,
    FilterState,
    moment_in_world,
)
from alight.motion.ekf.state_kernels import squared_distance
from alight.motion.ekf.visual_update import VisualUpdate
from alight.motion.gps_ins import NavMeasurement, Quantity, initial_state, measurements, rate_measurement, sigmas
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import OPEN_RATE_SIGMA, Preintegral
from alight.motion.projection import POSITION_FIRST
from alight.motion.smoother.recorded_flight import RecordedFlight
from alight.records import (
    ImuSample,
    Motion,
    MotionState,
    NavSample,
    RefinedMotions,
    Rig,
    Tracks,
)
from alight.settings import FilterSettings

log = logging.getLogger(__name__)

_MAX_GPS_REJECTION = 5.0  # s of GPS positions outside their gate after which they count as a jump, not a short fault
_MAX_GPS_AGE = 0.2  # s between a GPS position and the exposure that it is used for
_IMU_KEEP_NS = 1_000_000_000  # ns of IMU samples kept beyond the largest lateness
_RATE_HALF_WINDOW_NS = 15_000_000  # ns, half of the time over which the angular velocity is averaged
_RATE_MARGIN = 100.0  # over the variance of that mean: each exposure has its own error, and so seems to tell the offset
_ATTITUDE_INFLATION = np.repeat([0.03, 0.3], [2, 1])  # rad about east, north, up: added when observations contradict
_MAX_INFLATIONS = 3  # in a row without a good exposure between, after which the filter starts anew


class MotionFilter:
    """Feed events in order of time; every exposure gives a `Motion` once there has been a row of GPS/INS.

    Args:
        map_number: of its first map; a filter that replaces another one goes on with the next number.
    """

    def __init__(self, rig: Rig, settings: FilterSettings, map_number: int = 0) -> None:
        self._cams = tuple(c.body_from_cam for c in rig.cameras)
        self._settings = settings
        self._gate = Gate(settings.gate)
        self._imu = ImuBuffer()
        self._vague = False  # True: a warning on the sigmas of GPS/INS was given
        self._late_ns = round(settings.lateness * 1e9)
        self._memory = FilterMemory(
            VisualUpdate(rig.cameras[0].camera, self._cams, settings), Health(settings.coast), map_number=map_number
        )
        self._recording = RecordedFlight(rig, settings) if settings.smooth else None

    def feed_imu(self, sample: ImuSample) -> None:
        """Take one inertial measurement; it is used when the next exposure or GPS/INS row comes."""
        m = self._memory
        if not self._imu.append(sample):
            return
        if self._recording:
            self._recording.imu.append(sample)
        if not m.inertial:
            m.inertial = True
            if m.state is not None:
                self._start_biases(m.state)
        used_ns = m.state.t_ns - self._late_ns if m.state is not None else sample.t_ns
        self._imu.forget_before(min(sample.t_ns - _IMU_KEEP_NS - self._late_ns, used_ns))

    def feed_nav(self, sample: NavSample) -> None:
        """Take one row of the GPS/INS solution; rows that are older than the state are left out."""
        m, sigma = self._memory, sigmas(sample, self._settings)
        m.last_nav = sample
        if m.state is None:
            self._start(sample, sigma)
            return
        if sample.t_ns < m.state.t_ns:
            return
        self._propagate(m.state, sample.t_ns)
        if m.inflations >= _MAX_INFLATIONS and self._start(sample, sigma):
            return
        m.nav_sigma = sigma
        if self._recording:
            self._recording.nav.append(sample)
        self._update_from_nav(m.state, sample, sigma)
        if is_diverged(m.state):
            self._start_over(m.state, sample, sigma)

    def feed_tracks(self, tracks: Tracks) -> Motion | None:
        """Take the features of one exposure and return the motion; None: no GPS/INS row yet, or out of order."""
        m = self._memory
        if tracks.t_ns <= m.last_exposure_ns or self.time_of(tracks) < self.time_ns:
            return None
        course = self._course(tracks)
        m.last_exposure_ns = tracks.t_ns
        if m.state is None and course is not None and m.last_nav is not None:
            row, course = course.row(m.last_nav, tracks.t_ns), None
            self._start(row, sigmas(row, self._settings))
        state = m.state
        if state is None:
            return None
        self._propagate(state, self.time_of(tracks))
        if course is not None:
            residual, unit = so3_log(course.R @ state.R.T), 1.0 / course.sigma
            state.correct(residual * unit, np.diag(unit), np.arange(ATT.start, ATT.stop))
        counts = m.visual.on_exposure(state, tracks) if len(tracks.ids) else GateCounts()
        if m.health.on_exposure(tracks.t_ns, counts):
            self._inflate_attitude(state)
        motion = self._motion(state, tracks.t_ns, counts.passed)
        if self._recording:
            self._recording.exposures.append((motion, tracks, state.core[:CORE].copy()))
        return motion

    def _course(self, tracks: Tracks) -> CourseAttitude | None:
        """Estimate the attitude from images where GPS comes without it: at the start, and between photos (M26)."""
        m, nav = self._memory, self._memory.last_nav
        if nav is None or nav.position_world is None or nav.world_from_body is not None:
            return None
        if (tracks.t_ns - nav.t_ns) * 1e-9 > _MAX_GPS_AGE:
            return None
        if m.state is not None and (tracks.t_ns - m.last_exposure_ns) * 1e-9 <= MAX_RATE_AGE:
            return None
        before, now = m.last_positioned, PositionedExposure(tracks, nav)
        found = None if before is None else before.course_to(now, self._cams[0], self._settings)
        if m.state is None and found is not None and found.sigma[2] > MAX_START_SIGMA:
            found = None
        if found is not None or before is None or before.is_out_of_view(now):
            m.last_positioned = now
        return found

    def clone_window(self) -> CloneWindow | None:
        """Return the clones by value, from which the joint posterior follows; None before any exposure."""
        m = self._memory
        if m.state is None or m.last_exposure_ns == NEVER_NS:
            return None
        return m.visual.window(m.state, m.last_exposure_ns, m.map_number)

    def predictor(self) -> MotionPredictor | None:
        """Return the predictor of later exposures; None before the first GPS/INS row."""
        m = self._memory
        return None if m.state is None else MotionPredictor.of(m.state, self._cams, m.inertial, self._settings)

    def refined(self) -> RefinedMotions:
        """All exposures so far, refined together, with their joint covariance (docs/method/smoother.md, M18-M22b).

        Empty when `smooth` is off in the settings, and where a batch is not possible.
        """
        if self._recording is None:
            return RefinedMotions((), None)
        from alight.motion.smoother.smoother import smooth_flight

        return smooth_flight(self._recording)

    @property
    def time_ns(self) -> int:
        """Time of the state, by the clock of GPS/INS."""
        return self._memory.state.t_ns if self._memory.state is not None else NEVER_NS

    @property
    def state(self) -> FilterState | None:
        """A copy of the state, to be inspected; None before the first GPS/INS row."""
        return self._memory.state.copy() if self._memory.state is not None else None

    def time_of(self, event: NavSample | Tracks) -> int:
        """Time of an event, by the clock of GPS/INS."""
        if isinstance(event, NavSample) or self._memory.state is None:
            return event.t_ns
        return instant(event.t_ns, self._memory.state.core)

    @property
    def imu(self) -> ImuBuffer:
        """The last inertial measurements."""
        return self._imu

    def snapshot(self) -> Snapshot:
        """Return the filter as it is now; inertial measurements and the recording are not copied."""
        r = self._recording
        return Snapshot(self.time_ns, self._memory.copy(), len(r.exposures) if r else 0, len(r.nav) if r else 0)

    def restore(self, earlier: Snapshot) -> None:
        """Go back to a snapshot; it can be used once, since the filter goes on with its memory."""
        self._memory = earlier.memory
        if self._recording:
            del self._recording.exposures[earlier.exposures :], self._recording.nav[earlier.rows :]

    # -- time ------------------------------------------------------------------------------------------------------

    def _start(self, sample: NavSample, sigma: F64) -> bool:
        """Start from a row with position and attitude: the first time, or in a new map when the state is lost."""
        m, state = self._memory, initial_state(sample, sigma, self._settings)
        if state is None:
            return False
        if m.state is not None:
            m.map_number += 1
            log.warning(
                "motion: started anew from GPS/INS in map %d, which poses from before do not belong to", m.map_number
            )
            state.core[TIME], state.P[TIME, TIME] = m.state.core[TIME], m.state.P[TIME, TIME]
            state.refused = m.state.refused
        m.state, m.nav_sigma, m.inflations = state, sigma, 0
        m.visual.reset(state)
        m.health.restart(sample.t_ns)
        if m.inertial:
            self._start_biases(state)
        else:
            state.P[GYRO, GYRO] = np.eye(3) * OPEN_RATE_SIGMA**2
            if sample.angular_velocity_body is not None:
                state.core[GYRO] = sample.angular_velocity_body
        if self._recording:
            self._recording.nav.append(sample)
        m.predicted = Step.at(state)
        return True

    def _start_over(self, state: FilterState, sample: NavSample, sigma: F64) -> None:
        """Start anew where the state has diverged; not if the row itself claims as little as that."""
        fresh = initial_state(sample, sigma, self._settings)
        if fresh is None or not (is_diverged(fresh) and np.isfinite(state.core).all()):
            self._start(sample, sigma)
        elif not self._vague:
            self._vague = True
            claim = "motion: GPS/INS claims the attitude to %.2f rad and the velocity to %.1f m/s only (1-sigma): "
            log.warning(claim + "it is lost until IMU or pictures make them better", *sigma[[3, 6]])

    def _start_biases(self, state: FilterState) -> None:
        """Set the biases of the IMU to zero with their prior covariance."""
        for part, sigma in ((GYRO, self._settings.gyro_bias_sigma), (ACC, self._settings.accelerometer_bias_sigma)):
            state.core[part] = 0.0
            state.P[part, :], state.P[:, part] = 0.0, 0.0
            state.P[part, part] = np.eye(3) * sigma**2

    def _step(self, state: FilterState, t_ns: int) -> tuple[Step, Preintegral | None]:
        """Return pose and velocity at a later time, with the preintegral where an IMU drives the motion."""
        p, v = state.core[POS], state.core[VEL]
        if self._memory.inertial:
            m = preintegrated(self._imu, state.t_ns, t_ns, state.core, self._settings)
            return inertial_step(state.R, p, v, m), m
        return constant_step(state.R, p, v, state.core[GYRO], (t_ns - state.t_ns) * 1e-9), None

    def _propagate(self, state: FilterState, t_ns: int) -> None:
        """EKF prediction to a later time (M8-M10)."""
        dt, predicted = (t_ns - state.t_ns) * 1e-9, self._memory.predicted
        if dt <= 0 or predicted is None:
            return
        after, m = self._step(state, t_ns)
        if m is not None:
            F, Q = inertial_transition(predicted, after, m)
            Q[np.diag_indices(MOTION.stop)] += bias_walk(dt, self._settings)
        else:
            F, Q = constant_transition(state.R, state.core[GYRO], dt, self._settings)
        decay, drift = nav_decay(dt, self._memory.nav_sigma, self._settings)
        propagate_covariance(state, F, Q, decay, drift)
        state.R, state.core[POS], state.core[VEL] = after.R, after.position, after.velocity
        state.core[NAV] *= decay
        state.t_ns = t_ns
        state.rate, state.rate_variance = self._rate(state)
        self._memory.predicted = Step.at(state)

    def _rate(self, state: FilterState) -> tuple[F64, float]:
        """(3,) rad/s angular velocity in the body, the mean over 30 ms, and its variance as it counts for M27."""
        if not self._memory.inertial:
            return state.core[GYRO].copy(), float(state.P[GYRO, GYRO].diagonal().max())
        mean = self._imu.mean_rate(state.t_ns, _RATE_HALF_WINDOW_NS)
        return mean - state.core[GYRO], _RATE_MARGIN * self._settings.gyro_noise**2 / (2e-9 * _RATE_HALF_WINDOW_NS)

    # -- GPS/INS ---------------------------------------------------------------------------------------------------

    def _update_from_nav(self, state: FilterState, sample: NavSample, sigma: F64) -> None:
        """Update by the quantities of a GPS/INS row that pass their gates (M14-M16)."""
        rows = measurements(state, sample, sigma, self._settings)
        rate = None if self._memory.inertial else rate_measurement(state, sample, self._settings)
        rows += [rate] if rate else []
        passed = self._correct_by_passed(state, rows) if rows else []
        quantities = {z.quantity for z in passed}
        position = Quantity.POSITION in quantities if sample.position_world is not None else None
        rejected = self._memory.health.on_gps(sample.t_ns, position, bool(quantities - {Quantity.POSITION}))
        if rejected > _MAX_GPS_REJECTION and sample.position_world is not None:
            self._accept_jump(state, sample.position_world)

    def _correct_by_passed(self, state: FilterState, rows: Sequence[NavMeasurement]) -> list[NavMeasurement]:
        """Update by the measurements that pass their gates, each by itself; return these."""
        H = np.concatenate([z.H for z in rows])
        residual, unit = np.concatenate([z.residual for z in rows]), np.concatenate([z.variance for z in rows]) ** -0.5
        residual, HP = residual * unit, (H @ state.P[:CORE]) * unit[:, None]
        S = (HP[:, :CORE] @ H.T) * unit
        passed, used, limit = list[NavMeasurement](), np.zeros(len(H), bool), self._gate.limit(3)
        for i, z in enumerate(rows):
            at = slice(3 * i, 3 * i + 3)
            if squared_distance(residual[at], S[at, at]) <= limit:
                passed.append(z)
                used[at] = True
        if passed:
            state.correct_by(residual[used], HP[used], np.ascontiguousarray(S[used][:, used]))
        return passed

    def _accept_jump(self, state: FilterState, position: F64) -> None:
        """Set the slow error of the GPS/INS position anew after a jump, so that the jump does not move the vehicle."""
        expected = state.core[POS] + state.core[OFFSET]
        log.warning("GPS/INS position jumped by %.1f m", np.linalg.norm(position - expected - state.core[NAV_POS]))
        state.core[NAV_POS] = position - expected
        cross = -state.P[POS] - state.P[OFFSET]  # (3, n): covariance of the new error with all errors
        cross[:, NAV_POS] = 0.0
        own = -cross[:, POS] - cross[:, OFFSET] + np.eye(3) * self._settings.nav_position_white**2
        state.P[NAV_POS], state.P[:, NAV_POS], state.P[NAV_POS, NAV_POS] = cross, cross.T, own
        self._memory.health.on_gps(state.t_ns, True, True)

    def _inflate_attitude(self, state: FilterState) -> None:
        """Inflate the attitude, because consistent observations contradict the state: INS may be wrong (M25)."""
        self._memory.inflations += 1
        log.warning("motion: the pictures contradict the state; its attitude is taken as less sure")
        self._memory.visual.reset(state)
        variance = np.diag(_ATTITUDE_INFLATION**2)
        state.P[ATT, ATT] += variance
        state.P[NAV_ATT, NAV_ATT] += variance
        state.P[ATT, NAV_ATT] -= variance
        state.P[NAV_ATT, ATT] -= variance

    # -- results ---------------------------------------------------------------------------------------------------

    def _motion(self, state: FilterState, stamp_ns: int, support: int) -> Motion:
        """Return the motion of the present exposure, with its health."""
        m = self._memory
        judged, why = m.health.judge(state)
        m.inflations = 0 if judged is MotionState.GOOD else m.inflations
        if m.lost and judged is not MotionState.LOST:
            m.map_number += 1
            log.warning(
                "motion: found again, in map %d: the way from the poses before is known by GPS/INS only", m.map_number
            )
        m.lost = judged is MotionState.LOST
        rig, rows = Pose(state.rig, state.core[POS]), POSITION_FIRST[:, None]
        return Motion(
            stamp_ns,
            Pose(state.R, state.core[POS]),
            tuple(rig @ c for c in self._cams),
            moment_in_world(
                state.P[rows, POSITION_FIRST],
                state.P[POSITION_FIRST, OFFSET],
                state.core[OFFSET],
                state.P[OFFSET, OFFSET],
            ),
            state.core[VEL].copy(),
            judged,
            support,
            state.core[OFFSET].copy(),
            why,
            m.map_number,
        )
