"""The simulated autopilot's estimate of its motion: the true motion with errors of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from alight.arrays import F64


@dataclass(frozen=True, eq=False)
class NavigationError:
    """Errors of a navigation solution at one instant."""

    position: F64  # (3,) metres, world
    attitude: F64  # (3, 3) rotation, multiplied to the true attitude from the right
    heading: F64  # (3, 3) rotation, multiplied to the true attitude from the left
    velocity: F64  # (3,) m/s, world
    sigma: F64  # (3,) metres, reported for the position
    blind: float  # s since the receiver's last position


class Estimate(Protocol):
    """Interface of a simulated estimate: its present errors, and a step forward in time."""

    @property
    def now(self) -> NavigationError: ...
    def step(self, dt: float) -> None: ...


@dataclass
class EstimateError:
    """Error of the estimated position: a constant offset plus a random walk, in metres east, north, up.

    While `receives` is false, the receiver has no position. A position that is led away grows by `led`, and the
    velocity is wrong by as much.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    walk: float = 0.0  # metres per square root of a second
    seed: int = 0
    receives: bool = True
    led: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s
    error: F64 = field(init=False)  # (3,) metres, at present

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self.error = np.array(self.offset, dtype=np.float64)
        self._blind = 0.0  # s since the receiver's last position

    @property
    def now(self) -> NavigationError:
        """Present errors, of position and velocity."""
        sigma = np.array([0.8, 0.8, 1.2])
        return NavigationError(self.error, np.eye(3), np.eye(3), np.array(self.led), sigma, self._blind)

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        self._blind = 0.0 if self.receives else self._blind + dt
        self.error = self.error + dt * np.array(self.led)
        if self.walk > 0:
            self.error = self.error + self.walk * dt**0.5 * self._rng.standard_normal(3)
