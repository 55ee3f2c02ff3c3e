"""Health of the motion, from the measurements that pass their gates, and detection of a wrong state (M24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.motion.ekf.state import AT, FilterState
from alight.records import MotionState

NEVER_NS = -(1 << 62)  # ns, a time before all events
_MIN_SUPPORT = 8  # features that must pass their gates, and at least as many as fail, to support the motion
_FEW = 4  # fewer suffice if this many pass for each that fails: a pose has six degrees of freedom
_DROPPED_FRAME = 0.5  # s without a supported exposure that are treated as a dropped frame
PHOTO_INTERVALS = 2.5  # the same time in intervals between exposures: photos come every few seconds
_SETTLING = 3  # supported exposures that end the initialisation
_START, _START_INTERVALS = 3.0, 10.0  # s, intervals that end it in any case: a hover has no parallax
_CONTRADICTIONS = 5  # exposures in a row in which most features contradict the state, until it is wrong
MAX_REJECTIONS = 3  # times in a row that a GPS position or a landmark may fail its gate by chance; then it is wrong
_MAX_INNOVATION = 3.0  # mean squared innovation over its variance; above it observations are worse than claimed
_INNOVATION_GAIN = 0.2  # weight of the last exposure in the running mean
_MAX_TILT_SIGMA, _MAX_VELOCITY_SIGMA = 0.2, 20.0  # rad, m/s; above these the state has diverged


@dataclass(frozen=True)
class GateCounts:
    """Numbers of features of one exposure that passed and failed their gates."""

    passed: int = 0  # number of features that passed: landmarks, and tracks used in this exposure
    failed: int = 0
    innovation: float = 0.0  # mean squared distance per row of the features that passed, 1 expected; 0: none passed

    @classmethod
    def of(cls, tried: Mask, passed: Mask, distance: F64, rows: I64) -> GateCounts:
        """Count the features that passed and failed.

        `tried`, `passed`: (N,) masks. `distance`: (N,) squared Mahalanobis distances. `rows`: (N,) numbers of rows.
        """
        mean = float(distance[passed].sum() / max(rows[passed].sum(), 1))
        return cls(int(passed.sum()), int((tried & ~passed).sum()), mean)

    def __add__(self, other: GateCounts) -> GateCounts:
        n = max(self.passed + other.passed, 1)
        mean = (self.innovation * self.passed + other.innovation * other.passed) / n
        return GateCounts(self.passed + other.passed, self.failed + other.failed, mean)


class Health:
    """Rates the motion at every exposure, from the outcome of all gates."""

    def __init__(self, coast: float) -> None:
        """Set `coast`, the seconds without support from either images or GPS/INS after which the motion is lost."""
        self._coast = coast
        self._supported_ns = self._nav_ns = self._position_ns = self._exposure_ns = NEVER_NS
        self._start_ns = NEVER_NS  # time of the first exposure
        self._settled = self._contradictions = 0
        self._innovation = 1.0
        self._interval = 0.0  # s between the last two exposures
        self._gps_rejections = 0  # rejections in a row
        self._gps_rejected_since = 0  # ns, time of the first of these rejections

    def restart(self, t_ns: int) -> None:
        """Reset the history, because the filter was initialised again from GPS/INS at `t_ns`."""
        self._nav_ns = self._position_ns = t_ns
        self._start_ns = NEVER_NS
        self._settled = self._contradictions = self._gps_rejections = 0

    def on_gps(self, t_ns: int, position: bool | None, other: bool) -> float:
        """Record the outcome of one row of GPS/INS.

        Args:
            position: whether the position passed its gate; None: not measured.
            other: whether any other quantity passed its gate.

        Returns:
            Seconds since the positions began to fail their gate; 0 if the last position passed.
        """
        if position or other:
            self._nav_ns = t_ns
        if position is not None:
            self._position_ns = t_ns if position else self._position_ns
            self._gps_rejected_since = t_ns if position or not self._gps_rejections else self._gps_rejected_since
            self._gps_rejections = 0 if position else self._gps_rejections + 1
        return (t_ns - self._gps_rejected_since) * 1e-9 if self._gps_rejections else 0.0

    def on_exposure(self, t_ns: int, counts: GateCounts) -> bool:
        """Record one exposure; return whether the last exposures' observations show that the state must be wrong."""
        self._interval = max((t_ns - self._exposure_ns) * 1e-9, 0.0)
        self._exposure_ns = t_ns
        self._start_ns = t_ns if self._start_ns == NEVER_NS else self._start_ns
        if counts.passed >= _MIN_SUPPORT and counts.passed >= counts.failed:
            self._supported_ns, self._settled = t_ns, self._settled + 1
        elif counts.passed >= _FEW * max(counts.failed, 1):
            self._supported_ns = t_ns  # near the ground only a few metres are in view, which pass in some exposures
        if self._supported_ns == t_ns:
            self._innovation += _INNOVATION_GAIN * (counts.innovation - self._innovation)
        contradicts = counts.failed >= _MIN_SUPPORT and counts.failed > 2 * counts.passed
        self._contradictions = self._contradictions + 1 if contradicts else 0
        if self._contradictions >= _CONTRADICTIONS:
            self._contradictions = 0
            return True
        return False

    @property
    def _unsupported(self) -> float:
        """Seconds at the last exposure since the last supported one."""
        return (self._exposure_ns - self._supported_ns) * 1e-9

    @property
    def sees(self) -> bool:
        """Whether the pictures support the motion."""
        return self._unsupported <= max(_DROPPED_FRAME, PHOTO_INTERVALS * self._interval)

    @property
    def trusts_pictures(self) -> bool:
        """Whether the pictures support the motion, and scatter as they claim."""
        return self.sees and self._settled >= _SETTLING and self._innovation <= _MAX_INNOVATION

    def judge(self, state: FilterState) -> tuple[MotionState, str]:
        """Return the motion state at the last exposure, and the reason if it is not GOOD."""
        t, unsupported, seen = self._exposure_ns, self._unsupported, self.sees
        coast = max(self._coast, PHOTO_INTERVALS * self._interval)
        position, nav = (t - self._position_ns) * 1e-9 <= coast, (t - self._nav_ns) * 1e-9 <= coast
        if not nav and unsupported > coast:
            return MotionState.LOST, "neither the pictures nor GPS/INS hold the motion"
        if is_diverged(state):
            return MotionState.LOST, "attitude or velocity are not known any more"
        if self._settled < _SETTLING and nav:
            if (t - self._start_ns) * 1e-9 <= max(_START, _START_INTERVALS * self._interval):
                return MotionState.INITIALISING, "the first features are being learned"
            return MotionState.DEGRADED, "GPS/INS only: no features are learned yet; they are when the vehicle moves"
        if not seen:
            return MotionState.DEGRADED, "GPS/INS only: too few features, or they contradict the motion"
        if self._gps_rejections >= MAX_REJECTIONS:
            return MotionState.DEGRADED, "vision only: GPS is at odds with it"
        if not position:
            return MotionState.DEGRADED, "vision only: GPS is silent"
        if self._innovation > _MAX_INNOVATION:
            return MotionState.DEGRADED, "features scatter by more than they claim"
        return MotionState.GOOD, ""


def is_diverged(state: FilterState) -> bool:
    """Whether the covariance of tilt or velocity is too large for use, or the state is not finite."""
    variance = np.diag(state.P)
    small = variance[AT.att][:2].max() <= _MAX_TILT_SIGMA**2 and variance[AT.vel].max() <= _MAX_VELOCITY_SIGMA**2
    return not (bool(small) and bool(np.isfinite(state.core).all()))
