"""Position fixes against the pictures: lost, jumped, drifting, and back (docs/method/motion.md, M29-M31)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.motion.ekf.health import MAX_REJECTIONS, NEVER_NS, PHOTO_INTERVALS
from alight.motion.ekf.visual_update import gate_limits
from alight.records import GpsState
from alight.settings import FilterSettings

MAX_GPS_REJECTION = 5.0  # s of GPS positions outside their gate that are a jump, not a short fault
MAX_GPS_AGE = 0.2  # s, largest age of a GPS position at the exposure for which it is used
_AIDED = (GpsState.USED, GpsState.VAGUE)  # states in which positions are used
_WHY = {
    GpsState.LOST: "GPS is silent",
    GpsState.JUMPED: "GPS is at odds with the pictures",
    GpsState.RETURNING: "GPS is back and is compared",
    GpsState.VAGUE: "GPS claims a large sigma",
}


class FixWatch:
    """Decides which positions of GPS/INS are used.

    Attributes are replaced, never changed in place, so that `copy.copy` gives an independent copy.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self._coast, self._tau, self._white = settings.coast, settings.nav_position_tau, settings.nav_position_white
        self._limit = gate_limits(np.array([3]), settings.gate)[0]
        self.restart(NEVER_NS)

    def restart(self, t_ns: int) -> None:
        """Begin anew, with the filter, at a position that it starts from."""
        self.state, self._drift = GpsState.USED, np.zeros(3)  # m/s, of the positions against the pictures
        self._fix_ns = self._used_ns = t_ns
        self._interval = 0.0  # s between the last two positions
        self._in_row = 0  # positions in a row that contradict the state: outside their gate while used, else inside
        self.forget()

    def on_blind(self, t_ns: int) -> None:
        """Forget the way flown, as the pictures do not show it; a drift goes on until they show otherwise."""
        self.forget()
        if self.drifts:
            self._drifted_ns = t_ns

    def forget(self) -> None:
        """Forget the way flown, and a drift."""
        # s, position less estimate (3), velocity (3), slow variance (3), sums of corrections (6), P of velocity
        self._way = np.empty((0, 25))
        self._moved, self._sped = np.zeros(3), np.zeros(3)  # m, m/s, sums of the corrections by GPS/INS
        self._drifted_ns, self._lasts = NEVER_NS, False  # the last time of a drift; whether half of it is left

    @property
    def aided(self) -> bool:
        """Whether positions are used."""
        return self.state in _AIDED

    @property
    def drifts(self) -> bool:
        """Whether positions drift against the pictures."""
        return self.state is GpsState.DRIFTS

    @property
    def why(self) -> str:
        """Reason why positions are not USED; empty: they are."""
        if self.drifts:
            return f"GPS drifts against the pictures at {np.linalg.norm(self._drift):.1f} m/s"
        return _WHY.get(self.state, "")

    def unaided(self, t_ns: int) -> float:
        """Return the seconds since the last position that was used."""
        return max((t_ns - self._used_ns) * 1e-9, 0.0)

    def on_exposure(self, t_ns: int) -> bool:
        """Note at an exposure whether positions still come; return whether they have just ceased to be used."""
        aided = self.aided
        if (t_ns - self._fix_ns) * 1e-9 > max(self._coast, PHOTO_INTERVALS * self._interval):
            self.state, self._in_row = GpsState.LOST, 0
        return aided and not self.aided

    def compare(self, t_ns: int, off: F64, velocity: F64, covariance: F64, sigma: F64) -> None:
        """Compare the way by positions with that of the pictures (M30).

        Args:
            off: (3,) m, the position less the estimate in the map frame.
            velocity, covariance: (3,) m/s and (3, 3), as estimated.
            sigma: (3,) m, claimed for the position.
        """
        t = t_ns * 1e-9
        self._moved = self._moved + (self._sped * (t - self._way[-1, 0]) if len(self._way) else 0.0)
        slow = np.maximum(sigma, self._white) ** 2
        row = np.concatenate([[t], off, velocity, slow, self._moved, self._sped, covariance.ravel()])
        kept = self._way[self._way[:, 0] >= row[0] - MAX_GPS_REJECTION]
        self._way = way = np.concatenate([kept, row[None]])
        longest = (len(way) - 1) // MAX_REJECTIONS
        if longest < 1:
            return
        k = np.arange(1, longest + 1)[:, None] * np.arange(MAX_REJECTIONS + 1)  # rows back of the ends of the windows
        ends = way[-1 - k]
        steps = ends[:, :-1] - ends[:, 1:]  # (N, 3 windows, 25), the newest first
        seconds = steps[..., 0]
        aided = steps[..., 1:4]  # the estimate follows the positions; not so without the corrections since the start
        moved = aided + steps[..., 10:13] - ends[:, -1:, 13:16] * seconds[..., None]
        slow = 2.0 * ends[:, :-1, 7:10] * -np.expm1(-seconds / self._tau)[..., None] + 2.0 * self._white**2
        S = ends[:, -1:, 16:].reshape(-1, 1, 3, 3) * seconds[..., None, None] ** 2  # as it was before the corrections
        S = S + slow[..., None] * np.eye(3)
        late = MAX_GPS_AGE * steps[..., 4:7]  # the way of a late position while the velocity changes
        S += late[..., :, None] * late[..., None, :]
        mean = moved.mean(axis=1, keepdims=True)
        outer = ends[:, (0, -1), 4:7] * (MAX_GPS_AGE / (12.0**0.5 * MAX_REJECTIONS))  # positions of any age up to that
        S_mean = S.mean(axis=1) + outer.swapaxes(1, 2) @ outer
        distance = (mean @ np.linalg.solve(S_mean, mean.swapaxes(1, 2)))[:, 0, 0]
        steady = ((aided - 0.5 * mean) * mean).sum(axis=2).min(axis=1) > 0.0
        if found := np.flatnonzero((distance > self._limit) & steady).tolist():
            self._drifted_ns, self._drift = t_ns, mean[found[-1], 0] / seconds[found[-1]].mean()
        rate = mean[-1, 0] / seconds[-1].mean()
        self._lasts = self.drifts and bool((rate - 0.5 * self._drift) @ self._drift > 0.0)

    def corrected(self, by_position: F64, by_velocity: F64) -> None:
        """Note by how much a row of GPS/INS corrected position (3,) and velocity (3,): the pictures did not show it."""
        self._moved, self._sped = self._moved + by_position, self._sped + by_velocity

    def admit(self, t_ns: int, passed: bool, vague: bool) -> bool:
        """Return whether a position is used.

        Args:
            passed: whether it passed its gate.
            vague: whether it claims to be far less certain than the estimate.
        """
        self._interval = max((t_ns - self._fix_ns) * 1e-9, 0.0) if self._fix_ns != NEVER_NS else 0.0
        self._fix_ns = t_ns
        if self._lasts or (t_ns - self._drifted_ns) * 1e-9 <= MAX_GPS_REJECTION:
            self.state, self._in_row = GpsState.DRIFTS, 0
            return False
        self._in_row = self._in_row + 1 if passed is not self.aided else 0
        if self._in_row >= MAX_REJECTIONS:
            self.state, self._in_row = GpsState.USED if passed else GpsState.JUMPED, 0
        elif not self.aided:
            self.state = GpsState.RETURNING if passed else GpsState.JUMPED
        if not (self.aided and passed):
            return False
        self.state, self._used_ns = GpsState.VAGUE if vague else GpsState.USED, t_ns
        return True

    def accept(self, t_ns: int) -> None:
        """Use positions again from now on, as their jump was assigned to their error."""
        self.state, self._used_ns, self._in_row = GpsState.USED, t_ns, 0
