"""The simulated autopilot's estimate of its motion: the true motion with errors of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from alight.arrays import F64


class Estimate(Protocol):
    """Errors of the estimate at present. ENU, metres, m/s."""

    @property
    def error(self) -> F64:
        """(3,) metres, of the position."""

    @property
    def velocity_error(self) -> F64:
        """(3,) m/s."""

    @property
    def accuracy(self) -> tuple[float, float]:
        """1-sigma that the receiver claims, over the ground and in height, metres."""

    @property
    def blind(self) -> float:
        """Seconds since the last position of the receiver."""

    def attitude(self, world_from_body: F64) -> F64:
        """The estimated attitude (3, 3) at a true one."""

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""


@dataclass
class EstimateError:
    """Error of the estimated position alone: constant offset plus random walk, (3,) metres east north up."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    walk: float = 0.0  # metres per square root of a second
    seed: int = 0
    error: F64 = field(init=False)  # (3,) metres, at present
    velocity_error: F64 = field(default_factory=lambda: np.zeros(3), init=False)
    accuracy: tuple[float, float] = (0.8, 1.2)
    blind: float = 0.0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self.error = np.array(self.offset, dtype=np.float64)

    def attitude(self, world_from_body: F64) -> F64:
        """The true attitude."""
        return world_from_body

    def step(self, dt: float) -> None:
        """Advance the random walk by `dt` seconds."""
        if self.walk > 0:
            self.error = self.error + self.walk * dt**0.5 * self._rng.standard_normal(3)
