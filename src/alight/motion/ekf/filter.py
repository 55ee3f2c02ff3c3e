"""The structure-from-motion filter: tracks, GPS/INS and IMU to one consistent chain of poses.

An error-state EKF on SO(3) x R^k after the paper of 2004, with state X = (x_1..x_n, R, T, omega, v). Extensions:
multi-state constraints (MSCKF, Mourikis and Roumeliotis 2007), first-estimates Jacobians (Huang et al. 2008),
preintegrated IMU (Forster et al. 2017). See docs/method/motion.md.
"""

from __future__ import annotations

import logging
from collections import deque
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, so3_log
from alight.motion.dynamics import MAX_RATE_AGE, Step, add_bias_walk, nav_decay, propagate
from alight.motion.ekf.fixes import MAX_GPS_AGE, FixWatch
from alight.motion.ekf.health import NEVER_NS, GateCounts, Health, is_diverged
from alight.motion.ekf.initial_attitude import MAX_START_SIGMA, MIN_SHARED, CourseAttitude, PositionedExposure
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.nav_update import NavUpdate
from alight.motion.ekf.prediction import MotionPredictor, instant
from alight.motion.ekf.state import AT, POSITION_FIRST, FilterState, moment_in_world
from alight.motion.ekf.state_kernels import propagate_errors
from alight.motion.ekf.visual_update import VisualUpdate
from alight.motion.gps_ins import Quantity, initial_state, sigmas
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import OPEN_RATE_SIGMA, preintegrate
from alight.records import ImuSample, Motion, MotionState, NavSample, Odometry, RefinedMotions, Rig, Tracks
from alight.settings import FilterSettings

log = logging.getLogger(__name__)

_IMU_KEEP_NS = 1_000_000_000  # ns of IMU samples kept beyond the largest lateness
_MIN_AHEAD_NS = 3_000_000  # ns by which an exposure must follow its stamp to wait for the IMU
_RATE_HALF_WINDOW_NS = 15_000_000  # ns, half of the time over which the angular velocity is averaged
_RATE_MARGIN = 100.0  # on the variance of that mean: an error of the rate would look like a time offset
_ATTITUDE_INFLATION = np.repeat([0.03, 0.3], [2, 1])  # rad about east, north, up: added when observations contradict
_ODOMETRY = np.r_[AT.pos, AT.att, AT.vel]  # rows of the covariance of an odometry
_MAX_INFLATIONS = 3  # inflations without a good exposure between, after which the filter starts again


@dataclass(eq=False)
class FilterMemory:
    """Everything in the filter that changes from event to event, except IMU samples and the recorded flight."""

    visual: VisualUpdate
    health: Health
    fixes: FixWatch
    state: FilterState | None = None
    predicted: Step | None = None  # pose and velocity as last predicted, before updates: Jacobians are taken here
    inertial: bool = False  # whether an IMU drives the motion
    nav_sigma: F64 = field(default_factory=lambda: np.ones(9))  # (9,) 1-sigma of the last GPS/INS row
    last_exposure_ns: int = NEVER_NS
    inflations: int = 0  # inflations of the attitude in a row
    frame_id: int = 0
    resets: int = 0  # events at which the pose may have jumped
    seen: bool = True  # whether the pictures supported the motion at the last exposure
    lost: bool = False
    last_nav: NavSample | None = None
    last_positioned: PositionedExposure | None = None  # first exposure of the pair that M26 looks for

    @property
    def t_ns(self) -> int:
        """Time of the state by the clock of GPS/INS, ns."""
        return NEVER_NS if self.state is None else self.state.t_ns

    def copy(self) -> FilterMemory:
        """Return an independent copy; records and arrays that are only replaced, never changed, are shared."""
        state = self.state.copy() if self.state is not None else None
        return replace(
            self, visual=copy(self.visual), health=copy(self.health), fixes=copy(self.fixes), state=state
        )  # fmt: skip


@dataclass(eq=False)
class RecordedFlight:
    """Input of the smoother: the measurements of a flight, and the motions that the filter returned."""

    rig: Rig
    settings: FilterSettings
    imu: list[ImuSample] = field(default_factory=list)
    nav: list[NavSample] = field(default_factory=list)
    exposures: list[tuple[Motion, Tracks, F64]] = field(default_factory=list)  # motion, tracks, core of the state


@dataclass(frozen=True, eq=False)
class _Processed:
    t_ns: int
    event: NavSample | Tracks
    before: FilterMemory
    exposures: int  # exposures recorded before it
    rows: int  # rows of GPS/INS recorded before it
    imu_ns: int  # stamp of the last inertial measurement at that time


class MotionFilter:
    """Estimates the motion from events; every exposure gives a `Motion` once there has been a row of GPS/INS.

    Events are stamped correctly but may arrive out of sequence, as over radio links, by up to `lateness`. The filter
    then returns to its state before such an event and processes the later events again. Motions returned before are not
    changed; later ones include the event.

    Args:
        frame_id: number of the first map frame; a filter that replaces another one goes on with the next number.
    """

    def __init__(self, rig: Rig, settings: FilterSettings, frame_id: int = 0) -> None:
        self._cams = tuple(c.body_from_cam for c in rig.cameras)
        self._settings = settings
        self._vague = False  # whether a warning on the sigmas of GPS/INS was given
        self._late_ns = round(settings.lateness * 1e9)
        self._nav = NavUpdate(settings)
        visual, health = VisualUpdate(rig.cameras[0].camera, self._cams, settings), Health(settings.coast)
        self._memory = FilterMemory(visual, health, FixWatch(settings), frame_id=frame_id)
        self._recording = RecordedFlight(rig, settings) if settings.smooth else None
        self._processed: deque[_Processed] = deque()
        self.imu = ImuBuffer()  # the last inertial measurements
        self.too_late = 0  # events left out because they came later than `lateness`

    def feed(self, event: NavSample | ImuSample | Tracks) -> Motion | None:
        """Process one event and return the motion if the event holds the features of an exposure.

        Return None for other events, and for an exposure before the first row of GPS/INS, with a repeated stamp, or too
        late. An inertial measurement is used when the next exposure or row of GPS/INS arrives.
        """
        if isinstance(event, ImuSample):
            self._keep_imu(event)
            return None
        self._repeat_last_exposure()
        t, later = self._time_of(event), list[_Processed]()
        if t < self._memory.t_ns:
            while self._processed and self._processed[-1].t_ns > t:
                later.append(self._processed.pop())
            if not later or later[-1].before.t_ns > t:
                self._processed.extend(reversed(later))
                self.too_late += 1
                return None
            self._restore(later[-1])
        motion = self._process(event)
        for e in reversed(later):
            self._process(e.event)
        return motion

    def _keep_imu(self, sample: ImuSample) -> None:
        m = self._memory
        if not self.imu.append(sample):
            return
        if self._recording:
            self._recording.imu.append(sample)
        if not m.inertial:
            m.inertial = True
            if m.state is not None:
                self._start_biases(m.state)
        used_ns = m.state.t_ns - self._late_ns if m.state is not None else sample.t_ns
        self.imu.forget_before(min(sample.t_ns - _IMU_KEEP_NS - self._late_ns, used_ns))

    def clone_window(self) -> CloneWindow | None:
        """Return a copy of the clones, from which the joint posterior follows; None before any exposure."""
        m = self._memory
        if m.state is None or m.last_exposure_ns == NEVER_NS:
            return None
        return m.visual.window(m.state, m.last_exposure_ns, m.frame_id)

    def predictor(self) -> MotionPredictor | None:
        """Return a predictor of the cameras at later exposures; None before the first row of GPS/INS."""
        m = self._memory
        return None if m.state is None else MotionPredictor.of(m.state, self._cams, m.inertial, self._settings)

    def refined(self) -> RefinedMotions:
        """Return the motions of all exposures so far, smoothed together (docs/method/smoother.md).

        The result is empty if `smooth` is off in the settings, or if the batch has no solution.
        """
        if self._recording is None:
            return RefinedMotions((), None)
        from alight.motion.smoother.smoother import smooth_flight

        return smooth_flight(self._recording)

    @property
    def state(self) -> FilterState | None:
        """Copy of the state, for inspection; None before the first row of GPS/INS."""
        return self._memory.state.copy() if self._memory.state is not None else None

    # -- out of sequence -------------------------------------------------------------------------------------------

    def _time_of(self, event: NavSample | Tracks) -> int:
        """Return the time of an event on the clock of GPS/INS, ns; for tracks, by the estimated time offset."""
        state = self._memory.state
        return event.t_ns if isinstance(event, NavSample) or state is None else instant(event.t_ns, state.core)

    def _repeat_last_exposure(self) -> None:
        """Process the last exposure again if IMU samples that it had to do without have arrived since."""
        last = self._processed[-1] if self._processed else None
        if last is None or not isinstance(last.event, Tracks) or last.t_ns - last.event.t_ns < _MIN_AHEAD_NS:
            return
        if len(self.imu) and last.imu_ns < last.t_ns <= self.imu.last_ns:
            self._restore(self._processed.pop())
            self._process(last.event)

    def _restore(self, event: _Processed) -> None:
        self._memory = event.before
        if self._recording:
            del self._recording.exposures[event.exposures :], self._recording.nav[event.rows :]

    def _process(self, event: NavSample | Tracks) -> Motion | None:
        if self._late_ns:
            r, imu_ns = self._recording, self.imu.last_ns if len(self.imu) else 0
            recorded = (len(r.exposures), len(r.nav)) if r else (0, 0)
            self._processed.append(_Processed(self._time_of(event), event, self._memory.copy(), *recorded, imu_ns))
            while self._processed[0].t_ns < self._processed[-1].t_ns - self._late_ns:
                self._processed.popleft()
        if isinstance(event, Tracks):
            return self._use_tracks(event)
        self._use_nav(event)
        return None

    # -- events in order -------------------------------------------------------------------------------------------

    def _use_nav(self, sample: NavSample) -> None:
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
        if sample.height_world is not None:  # a row without position: the error of the height goes on as before
            sigma[Quantity.POSITION.rows] = m.nav_sigma[Quantity.POSITION.rows]
        m.nav_sigma = sigma
        self._nav.update(m.state, sample, sigma, m.inertial, m.health, m.fixes)
        if self._recording:
            drifts = m.fixes.drifts
            self._recording.nav.append(replace(sample, position_world=None, velocity_world=None) if drifts else sample)
        if is_diverged(m.state):
            self._start_over(m.state, sample, sigma)

    def _use_tracks(self, tracks: Tracks) -> Motion | None:
        m = self._memory
        if tracks.t_ns <= m.last_exposure_ns or self._time_of(tracks) < m.t_ns:
            return None
        course = self._course(tracks)
        m.last_exposure_ns = tracks.t_ns
        if m.state is None and course is not None and m.last_nav is not None:
            row, course = course.row(m.last_nav, tracks.t_ns), None
            self._start(row, sigmas(row, self._settings))
        state = m.state
        if state is None:
            return None
        self._propagate(state, self._time_of(tracks))
        if course is not None:
            residual, unit = so3_log(course.R @ state.R.T), 1.0 / course.sigma
            state.correct(residual * unit, np.diag(unit), np.arange(AT.att.start, AT.att.stop))
        counts = m.visual.on_exposure(state, tracks) if len(tracks.ids) else GateCounts()
        if m.health.on_exposure(tracks.t_ns, counts):
            self._inflate_attitude(state)
        if m.fixes.on_exposure(self._time_of(tracks)):
            log.warning("motion: %s", m.fixes.why)
            state.anchor()
        motion = self._motion(state, tracks.t_ns, counts)
        if self._recording:
            self._recording.exposures.append((motion, tracks, state.core.copy()))
        return motion

    def _course(self, tracks: Tracks) -> CourseAttitude | None:
        """Return the attitude by course and images if GPS gives none, at the start and between photos; else None."""
        m, nav = self._memory, self._memory.last_nav
        if nav is None or nav.position_world is None or nav.world_from_body is not None:
            return None
        if (tracks.t_ns - nav.t_ns) * 1e-9 > MAX_GPS_AGE:
            return None
        if m.state is not None and (tracks.t_ns - m.last_exposure_ns) * 1e-9 <= MAX_RATE_AGE:
            return None
        before, now = m.last_positioned, PositionedExposure(tracks, nav)
        found = None if before is None else before.course_to(now, self._cams[0], self._settings)
        if m.state is None and found is not None and found.sigma[2] > MAX_START_SIGMA:
            found = None
        if found is not None or before is None or len(np.intersect1d(before.tracks.ids, tracks.ids)) < MIN_SHARED:
            m.last_positioned = now
        return found

    # -- time ------------------------------------------------------------------------------------------------------

    def _start(self, sample: NavSample, sigma: F64) -> bool:
        """Initialise the state from a row of 1-sigma `sigma` (9,); return False if it lacks position or attitude."""
        m, state = self._memory, initial_state(sample, sigma, self._settings)
        if state is None:
            return False
        if m.state is not None:
            m.frame_id, m.resets = m.frame_id + 1, m.resets + 1
            log.warning("motion: started anew from GPS/INS as map %d; earlier poses use another frame", m.frame_id)
            state.core[AT.time], state.P[AT.time, AT.time] = m.state.core[AT.time], m.state.P[AT.time, AT.time]
            state.refused = m.state.refused
        m.state, m.nav_sigma, m.inflations = state, sigma, 0
        m.visual.reset(state)
        m.health.restart(sample.t_ns)
        m.fixes.restart(sample.t_ns)
        if m.inertial:
            self._start_biases(state)
        else:
            state.P[AT.gyro, AT.gyro] = np.eye(3) * OPEN_RATE_SIGMA**2
            if sample.angular_velocity_body is not None:
                state.core[AT.gyro] = sample.angular_velocity_body
        if self._recording:
            self._recording.nav.append(sample)
        m.predicted = Step.at(state)
        return True

    def _start_over(self, state: FilterState, sample: NavSample, sigma: F64) -> None:
        """Initialise the diverged state again from a row of 1-sigma `sigma` (9,), unless the row is as uncertain."""
        fresh = initial_state(sample, sigma, self._settings)
        if fresh is None or not (is_diverged(fresh) and np.isfinite(state.core).all()):
            self._start(sample, sigma)
        elif not self._vague:
            self._vague = True
            claim = "motion: GPS/INS claims the attitude to %.2f rad and the velocity to %.1f m/s only (1-sigma): "
            log.warning(claim + "it is lost until IMU or pictures make them better", *sigma[[3, 6]])

    def _start_biases(self, state: FilterState) -> None:
        s = self._settings
        for part, sigma in ((AT.gyro, s.gyro_bias_sigma), (AT.acc, s.accelerometer_bias_sigma)):
            state.core[part] = 0.0
            state.P[part, :], state.P[:, part] = 0.0, 0.0
            state.P[part, part] = np.eye(3) * sigma**2

    def _propagate(self, state: FilterState, t_ns: int) -> None:
        """Propagate the state to a later time `t_ns`, in place (M8-M10)."""
        m, dt, s = self._memory, (t_ns - state.t_ns) * 1e-9, self._settings
        if dt <= 0 or m.predicted is None:
            return
        imu = preintegrate(self.imu, state.t_ns, t_ns, state.core[AT.biases], s) if m.inertial else None
        after, F, Q = propagate(Step.at(state), state.core[AT.gyro], imu, dt, s, m.predicted)
        if m.inertial:
            add_bias_walk(Q, dt, s)
        decay, drift = nav_decay(dt, m.nav_sigma, s)
        propagate_errors(state.P, F, Q, decay, drift)
        state.R, state.core[AT.pos], state.core[AT.vel] = after.R, after.position, after.velocity
        state.core[AT.nav] *= decay
        state.t_ns = t_ns
        if m.inertial:  # the mean over 30 ms, with its variance as used in M27
            state.rate = self.imu.mean_rate(t_ns, _RATE_HALF_WINDOW_NS) - state.core[AT.gyro]
            state.rate_variance = _RATE_MARGIN * s.gyro_noise**2 / (2e-9 * _RATE_HALF_WINDOW_NS)
        else:
            state.rate = state.core[AT.gyro].copy()
            state.rate_variance = float(state.P[AT.gyro, AT.gyro].diagonal().max())
        m.predicted = Step.at(state)

    def _inflate_attitude(self, state: FilterState) -> None:
        """Inflate the attitude covariance, because consistent observations contradict the state (M25)."""
        self._memory.inflations += 1
        self._memory.resets += 1
        self._memory.fixes.forget()
        log.warning("motion: the pictures contradict the state; its attitude is taken as less sure")
        self._memory.visual.reset(state)
        variance = np.diag(_ATTITUDE_INFLATION**2)
        state.P[AT.att, AT.att] += variance
        state.P[AT.nav_att, AT.nav_att] += variance
        state.P[AT.att, AT.nav_att] -= variance
        state.P[AT.nav_att, AT.att] -= variance

    # -- results ---------------------------------------------------------------------------------------------------

    def _motion(self, state: FilterState, stamp_ns: int, counts: GateCounts) -> Motion:
        m = self._memory
        judged, why = m.health.judge(state)
        m.inflations = 0 if judged is MotionState.GOOD else m.inflations
        if m.lost and judged is not MotionState.LOST:
            m.frame_id, m.resets = m.frame_id + 1, m.resets + 1
            log.warning("motion: found again, as map %d; GPS/INS alone ties it to the earlier poses", m.frame_id)
        m.lost = judged is MotionState.LOST
        core, P, at, rig = state.core, state.P, AT.offset, Pose(state.rig, state.core[AT.pos])
        own, cross = P[np.ix_(POSITION_FIRST, POSITION_FIRST)], P[POSITION_FIRST, at]
        return Motion(
            stamp_ns, Pose(state.R, core[AT.pos]), tuple(rig @ c for c in self._cams),
            moment_in_world(own, cross, core[at], P[at, at]), core[AT.vel].copy(), judged, counts.passed,
            core[at].copy(), why, m.frame_id, odometry=self._odometry(state, judged, counts),
        )  # fmt: skip

    def _odometry(self, state: FilterState, judged: MotionState, counts: GateCounts) -> Odometry:
        m, P = self._memory, state.P
        m.resets += m.health.sees and not m.seen  # what was not seen may have moved the state
        m.seen = m.health.sees
        works = m.seen and judged is not MotionState.LOST
        share = min(counts.passed / self._settings.points, 1.0) * counts.passed / max(counts.passed + counts.failed, 1)
        return Odometry(
            P[np.ix_(_ODOMETRY, _ODOMETRY)], state.rate.copy(), share if works else 0.0, m.resets, m.fixes.state,
            m.fixes.why, m.fixes.unaided(state.t_ns),
        )  # fmt: skip
