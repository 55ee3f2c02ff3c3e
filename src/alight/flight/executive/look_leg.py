"""The way of a look: past the place, because one camera straight above sees no parallax."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64

ABOVE = 0.3  # m, within which the vehicle is straight above the place


@dataclass(frozen=True, eq=False)
class LookLeg:
    """A leg across a place, at one height, against the wind where there is one."""

    place: F64  # (3,) metres, at the height of the look
    half: float  # metres, half its length
    position: F64  # (3,) metres, of the vehicle
    downwind: F64 | None  # (2,) unit vector, where the air goes; None: calm, or not known
    turned: float = 0.0  # rad, from the direction that suits the wind and the vehicle best

    @property
    def start(self) -> F64:
        """(3,) metres: downwind of the place, so that the leg leads against the wind; else on the vehicle's side."""
        return self._beside(self._side if self.downwind is None else self._turn(self.downwind))

    @property
    def end(self) -> F64:
        """(3,) metres: on the side of the place opposite to the vehicle."""
        return self._beside(-self._side)

    def _beside(self, towards: F64) -> F64:
        return np.array([*(self.place[:2] + self.half * towards), self.place[2]])

    @property
    def _side(self) -> F64:
        """(2,) unit vector from the place to the vehicle's side, along the wind where there is one."""
        away = self.position[:2] - self.place[:2]
        if self.downwind is not None:
            along = self._turn(self.downwind)
            return along if float(along @ away) >= 0.0 else -along
        distance = float(np.hypot(*away))
        return self._turn(away / distance if distance > ABOVE else np.array([0.0, 1.0]))

    def _turn(self, v: F64) -> F64:
        c, s = math.cos(self.turned), math.sin(self.turned)
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])
