"""The difference between the autopilot's estimate of the position and ours, averaged."""

from __future__ import annotations

from collections import deque

import numpy as np

from alight.arrays import F64

COUNT = 8  # newest differences that are averaged: reports of the autopilot's estimate are noisy
JUMP = 2.0  # m, of a difference from their mean: the autopilot's estimate has jumped, and older ones are void


class MeanTie:
    """Ties commands to the autopilot's own estimate.

    Each difference has the noise of one report. A command that follows it makes the vehicle restless near the ground.
    """

    def __init__(self) -> None:
        self._differences = deque[F64](maxlen=COUNT)
        self.frame_id = -1  # of our positions; -1: there is no difference yet

    @property
    def mean(self) -> F64:
        """(3,) metres, to be added to a position in our frame; 0 without a difference."""
        return np.asarray(np.mean(self._differences, axis=0)) if self._differences else np.zeros(3)

    def add(self, difference: F64, frame_id: int) -> None:
        """Take the difference (3,) metres of one instant, the autopilot's estimate less ours.

        Those of another frame, and from before a jump, are forgotten.
        """
        if frame_id != self.frame_id or np.linalg.norm(difference - self.mean) > JUMP:
            self._differences.clear()
        self._differences.append(difference)
        self.frame_id = frame_id
