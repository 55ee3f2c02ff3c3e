"""Update of the EKF by a row of GPS/INS: gates, positions that are not used, and jumps (M14-M16, M31)."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from alight.arrays import F64
from alight.motion.ekf.fixes import MAX_GPS_REJECTION, FixWatch
from alight.motion.ekf.health import Health
from alight.motion.ekf.state import AT, CORE, FilterState
from alight.motion.ekf.state_kernels import squared_distance
from alight.motion.ekf.visual_update import gate_limits
from alight.motion.gps_ins import NavMeasurement, Quantity, measurements
from alight.records import GpsState, NavSample
from alight.settings import FilterSettings

log = logging.getLogger(__name__)


class NavUpdate:
    """Updates the state by rows of GPS/INS; what is remembered of them stands in `Health` and `FixWatch`."""

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self._limits = gate_limits(np.arange(4), settings.gate)  # by degrees of freedom

    def update(
        self, state: FilterState, sample: NavSample, sigma: F64, inertial: bool, health: Health, fixes: FixWatch
    ) -> None:
        """Update the state by those quantities of a GPS/INS row, with `sigma` (9,), that pass their gates (M14-M16).

        Args:
            inertial: whether an IMU drives the motion.
            health, fixes: record the outcome.
        """
        rows, position = measurements(state, sample, sigma, self._settings, inertial), sample.position_world
        if not rows:
            health.on_gps(sample.t_ns, None, False)
            return
        H = np.concatenate([z.H for z in rows])
        residual, unit = np.concatenate([z.residual for z in rows]), np.concatenate([z.variance for z in rows]) ** -0.5
        residual, HP = residual * unit, (H @ state.P[:CORE]) * unit[:, None]
        S = (HP[:, :CORE] @ H.T) * unit
        used = self._passed(rows, residual, S)
        if position is not None:
            passed, aided = Quantity.POSITION in used, fixes.aided
            if health.trusts_pictures:
                off, velocity = position - state.core[AT.pos], state.core[AT.vel]
                fixes.compare(sample.t_ns, off, velocity, state.P[AT.vel, AT.vel], sigma[Quantity.POSITION.rows])
            else:
                fixes.on_blind(sample.t_ns)
            if not fixes.admit(sample.t_ns, passed, self._is_vague(state, sigma)):
                # a velocity would correct the heading, and with it the whole way since the loss: a jump
                used -= {Quantity.POSITION} if fixes.aided else {Quantity.POSITION, Quantity.VELOCITY}
            if fixes.aided is not aided:
                log.warning("motion: %s", fixes.why or "GPS agrees with the pictures again and is used")
                state.anchor()
                HP = (H @ state.P[:CORE]) * unit[:, None]
        if used:
            kept = np.repeat([z.quantity in used for z in rows], [len(z.H) for z in rows])
            before = state.core.copy()
            state.correct_by(residual[kept], HP[kept], np.ascontiguousarray(S[kept][:, kept]))
            by = state.core - before
            fixes.corrected(by[AT.pos], by[AT.vel])
        waits = position is None or (fixes.state is GpsState.RETURNING)
        rejected = health.on_gps(
            sample.t_ns, None if waits else Quantity.POSITION in used, bool(used - {Quantity.POSITION})
        )
        if rejected > MAX_GPS_REJECTION and position is not None and not fixes.drifts:
            self._accept_jump(state, position, health, fixes)

    def _passed(self, rows: Sequence[NavMeasurement], residual: F64, S: F64) -> set[Quantity]:
        """Return the quantities that pass their own gates; `residual` (m,), `S` (m, m): of all rows, of unit noise."""
        out, k = set[Quantity](), 0
        for z in rows:
            own = slice(k, k := k + len(z.H))
            if squared_distance(residual[own], np.ascontiguousarray(S[own, own])) <= self._limits[len(z.H)]:
                out.add(z.quantity)
        return out

    def _is_vague(self, state: FilterState, sigma: F64) -> bool:
        """Whether a row of 1-sigma `sigma` (9,) claims its position to be far less certain than the estimate."""
        P, claimed = state.P, (sigma[Quantity.POSITION.rows] ** 2)[:2].sum()
        own = P[AT.pos, AT.pos] + P[AT.offset, AT.offset] + P[AT.pos, AT.offset] + P[AT.offset, AT.pos]
        return bool(claimed > self._limits[3] * np.trace(own[:2, :2]))

    def _accept_jump(self, state: FilterState, position: F64, health: Health, fixes: FixWatch) -> None:
        """Assign a jump of the GPS/INS `position` (3,) to its slow error, so that the estimate does not move."""
        expected = state.core[AT.pos] + state.core[AT.offset]
        log.warning("GPS/INS position jumped by %.1f m", np.linalg.norm(position - expected - state.core[AT.nav_pos]))
        state.anchor()
        state.core[AT.nav_pos] = position - expected
        cross = -state.P[AT.pos] - state.P[AT.offset]  # (3, n): covariance of the new error with all errors
        cross[:, AT.nav_pos] = 0.0
        own = -cross[:, AT.pos] - cross[:, AT.offset] + np.eye(3) * self._settings.nav_position_white**2
        state.P[AT.nav_pos], state.P[:, AT.nav_pos], state.P[AT.nav_pos, AT.nav_pos] = cross, cross.T, own
        health.on_gps(state.t_ns, True, True)
        fixes.accept(state.t_ns)
