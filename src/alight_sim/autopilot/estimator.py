"""The simulated autopilot's estimator: it flies by GPS, by external navigation (ODOMETRY), or by dead reckoning.

After ArduPilot's pages "Non-GPS Position Estimation" and "EKF Source Selection and Switching", and PX4's on external
position estimation: sets of sources, delays, rejection by the innovation, resets, and a position that is lost when
nothing was fused for some seconds. Heights are the barometer's.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.spatial.transform import Rotation

from alight.arrays import F64
from alight_sim.autopilot.dialects import Dialect
from alight_sim.autopilot.estimate import Estimate

_GAIN = 0.2  # share of an innovation by which the estimate is moved


class Estimator:
    """Position and velocity as an autopilot estimates them; without external navigation those of `estimate`.

    Times are seconds of the autopilot's clock. VISO_TYPE or EKF2_EV_CTRL switches external navigation on.

    Args:
        dialect, parameters: of the autopilot.
        estimate: errors of GPS/INS.
    """

    def __init__(self, dialect: Dialect, estimate: Estimate, parameters: Mapping[str, float]) -> None:
        self._dialect, self._px4 = dialect, dialect.firmware == "px4"
        self._estimate, self._parameters = estimate, parameters
        self.by_odometry = False  # whether it uses the set of sources of external navigation, as ArduPilot has it
        self._error, self._velocity_error = estimate.now.position, estimate.now.velocity
        self._bias = np.zeros(2)  # metres, of external positions, as PX4 learns it while it has GPS
        self._fused_at = -math.inf
        self._resets: int | None = None  # counter of the newest message; None: the next one resets the estimate
        self._past = deque[tuple[float, F64, F64]](maxlen=100)  # time, estimated position and velocity
        self._offset: float | None = None  # s, PX4's clock minus the sender's by TIMESYNC, and ArduPilot's by arrivals
        self.rejected = 0  # number of messages

    @property
    def takes_odometry(self) -> bool:
        """Whether external navigation is switched on."""
        return any(self._parameters.get(name, 0.0) > 0 for name in ("VISO_TYPE", "EKF2_EV_CTRL"))

    @property
    def error(self) -> F64:
        """Error of the position, (3,) metres."""
        return self._error if self.takes_odometry else self._estimate.now.position

    @property
    def velocity_error(self) -> F64:
        """Error of the velocity, (3,) m/s."""
        return self._velocity_error if self.takes_odometry else self._estimate.now.velocity

    @property
    def _by_gps(self) -> bool:
        return not self.by_odometry and self._estimate.now.blind < 0.3

    def is_located(self, t: float) -> bool:
        """Whether the position is valid: it is kept for some time after the last one that was fused."""
        blind = math.inf if self.by_odometry else self._estimate.now.blind
        return min(blind, t - self._fused_at) < self._dialect.dead_reckoning

    def select(self, number: float) -> bool:
        """Select a set of sources, as MAV_CMD_SET_EKF_SOURCE_SET does; return false if there is none."""
        if self._px4 or number not in (1.0, 2.0):
            return False
        self.by_odometry, self._resets = number == 2.0, None
        return True

    def step(self, t: float, dt: float, position: F64, velocity: F64) -> None:
        """Advance by `dt` s to `t`; `position` (3,) metres and `velocity` (3,) m/s are the true ones."""
        now = self._estimate.now
        if self._by_gps:
            self._error = now.position
            self._velocity_error = self._velocity_error + _GAIN * (now.velocity - self._velocity_error)
        else:
            self._error = np.array([*(self._error + dt * self._velocity_error)[:2], now.position[2]])
        self._past.append((t, position + self._error, velocity + self._velocity_error))

    def on_timesync(self, requested: float, sender: float, t: float) -> None:
        """Process an answer to TIMESYNC at `t`: own clock at the request, and the sender's clock, s."""
        if self._px4:
            self._offset = 0.5 * (requested + t) - sender

    def _taken(self, stamp: float, t: float) -> float:
        """Return when what came at `t` was measured: each autopilot corrects the sender's `stamp` in its way.

        PX4 converts it by its own TIMESYNC; without, it takes the arrival. ArduPilot takes the least delay so far for
        none. Both correct that by a parameter.
        """
        if self._px4:
            known = t if self._offset is None else stamp + self._offset
            return known - 1e-3 * self._parameters.get("EKF2_EV_DELAY", 0.0)
        self._offset = min(t - stamp, math.inf if self._offset is None else self._offset)
        return stamp + self._offset - 1e-3 * self._parameters.get("VISO_DELAY_MS", 10.0)

    def on_odometry(self, m: Any, t: float) -> None:
        """Fuse an ODOMETRY message that has come at `t`, if it is used."""
        if not self.takes_odometry or not self._is_accepted(m) or not self._past:
            return
        taken = self._taken(m.time_usec * 1e-6, t)
        then, position, velocity = min(self._past, key=lambda past: abs(past[0] - taken))
        measured = np.array([m.y, m.x]) - position[:2]
        if self._px4 and self._by_gps:
            self._bias, self._resets = measured, m.reset_counter
        dropped = self._px4 and t - taken > 1e-3 * self._parameters.get("EKF2_DELAY_MAX", 200.0) + 0.1
        if dropped or abs(then - taken) > 0.2 or self._by_gps or not (self._px4 or self.by_odometry):
            return
        jumped = self._resets != m.reset_counter
        self._bias = np.zeros(2) if jumped else self._bias
        moved = measured - self._bias
        sigma = math.hypot(self._parameters.get("VISO_POS_M_NSE", 0.1), math.sqrt(m.pose_covariance[0]))
        if not jumped and math.hypot(*moved) > 5.0 * sigma and t - self._fused_at < self._dialect.dead_reckoning:
            self.rejected += 1
            return
        north, east, _ = Rotation.from_quat([*m.q[1:], m.q[0]]).apply([m.vx, m.vy, m.vz])
        share = 1.0 if jumped else _GAIN
        self._error = self._error + share * np.array([*moved, 0.0])
        self._velocity_error = self._velocity_error + share * np.array([east - velocity[0], north - velocity[1], 0.0])
        self._resets, self._fused_at = m.reset_counter, t

    def _is_accepted(self, m: Any) -> bool:
        """Whether it takes the frames and the quality; PX4 takes failed poses too unless it has a least quality."""
        frame = mavlink.MAV_FRAME_LOCAL_NED if self._px4 else mavlink.MAV_FRAME_LOCAL_FRD
        given = self._parameters.get("EKF2_EV_QMIN" if self._px4 else "VISO_QUAL_MIN", 0.0)
        least = -1.0 if self._px4 and not given else given
        right = m.frame_id == frame and m.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
        return bool(right and m.quality >= least)
