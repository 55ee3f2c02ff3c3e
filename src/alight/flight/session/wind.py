"""Wind by the lean of the vehicle and its velocity, for an autopilot that reports none."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.constants import g

from alight.arrays import F64
from alight.records import Landed, Telemetry

DRAG, DRAG_SIGMA = 0.2, 0.1  # 1/s, of multirotors: deceleration per speed through the air
NOISE, BIAS = 0.3, 0.1  # m/s^2, 1-sigma of the acceleration of one second; of the lean, by 0.6 degrees of misalignment
DRIFT = 0.05  # m/s^2 per square root of a second, 1-sigma of the change of the drag by wind


class WindEstimate(NamedTuple):
    """Estimated velocity of the air."""

    wind: F64  # (2,) m/s, east and north
    sigma: float  # m/s, 1-sigma of its worst component


class WindWatch:
    """Estimates the wind in flight, once a second, by a Kalman filter.

    The lean gives the level acceleration a by the thrust; the drag takes k (v - w) of it: a = dv/dt + k v - k w. The
    state is k and the vector k w. A hover shows only k w; legs in several directions show k too.
    """

    def __init__(self) -> None:
        self._state = np.array([DRAG, 0.0, 0.0])  # k, 1/s, and k w, (2,) m/s^2
        self._covariance = np.diag([DRAG_SIGMA, 10.0 * DRAG, 10.0 * DRAG]) ** 2
        self._begun: tuple[int, F64] | None = None  # boot time, ns, and velocity at the start of the second
        self._means: list[F64] = []  # accelerations by the lean, and velocities, each (2, 2)

    def add(self, reports: Telemetry) -> None:
        """Process a snapshot of the telemetry; call it several times per second."""
        R, velocity = reports.world_from_body, reports.velocity_world[:2]
        flies = reports.armed and reports.landed in (Landed.AIR, Landed.LANDING)
        if not flies or R is None or not (np.isfinite(velocity).all() and R[2, 2] > 0.5):
            self._begun = None
            return
        if self._begun is None:
            self._begun, self._means = (reports.boot_ns, velocity), []
        self._means.append(np.stack([g * R[:2, 2] / R[2, 2], velocity]))
        dt = (reports.boot_ns - self._begun[0]) * 1e-9
        if dt < 1.0:
            return
        if dt < 2.0:  # else reports have been missing
            lean, mean = np.mean(self._means, axis=0)
            self._update(lean - (velocity - self._begun[1]) / dt, mean, dt)
        self._begun, self._means = (reports.boot_ns, velocity), []

    def _update(self, drag: F64, velocity: F64, dt: float) -> None:
        P = self._covariance + np.diag([0.0, DRIFT**2 * dt, DRIFT**2 * dt])
        H = np.column_stack([velocity, -np.eye(2)])
        gain = np.linalg.solve(H @ P @ H.T + NOISE**2 * np.eye(2), H @ P).T
        self._state = self._state + gain @ (drag - H @ self._state)
        self._covariance = (np.eye(3) - gain @ H) @ P

    @property
    def estimate(self) -> WindEstimate:
        """The present wind; before the first second of flight its sigma is large."""
        k = max(float(self._state[0]), 0.05)
        wind = self._state[1:] / k
        J = np.column_stack([-wind / k, np.eye(2) / k])
        covariance = J @ self._covariance @ J.T
        return WindEstimate(wind, math.hypot(math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])), BIAS / k))
