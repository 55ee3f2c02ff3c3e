"""Position estimate of the simulated autopilot: the true position with an error of its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from alight.arrays import F64


@dataclass
class EstimateError:
    """Error of the estimated position: constant offset plus random walk, (3,) metres east north up."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    walk: float = 0.0  # metres per square root of a second
    seed: int = 0
    error: F64 = field(init=False)  # (3,) metres, at present

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self.error = np.array(self.offset, dtype=np.float64)

    def step(self, dt: float) -> None:
        """Advance the random walk by `dt` seconds."""
        if self.walk > 0:
            self.error = self.error + self.walk * dt**0.5 * self._rng.standard_normal(3)
