"""Memory of the filter from event to event: one record, copied for out-of-sequence measurements."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import F64
from alight.motion.dynamics import Step
from alight.motion.ekf.health import NEVER_NS, Health
from alight.motion.ekf.initial_attitude import PositionedExposure
from alight.motion.ekf.state import FilterState
from alight.motion.ekf.visual_update import VisualUpdate
from alight.records import NavSample


@dataclass(eq=False)
class FilterMemory:
    """All that changes from event to event, except the inertial measurements and the recording of the flight."""

    visual: VisualUpdate
    health: Health
    state: FilterState | None = None
    predicted: Step | None = None  # the state as last predicted: first estimate, where Jacobians are taken
    inertial: bool = False  # True: an IMU drives the motion
    nav_sigma: F64 = field(default_factory=lambda: np.ones(9))  # of the last GPS/INS row
    last_exposure_ns: int = NEVER_NS
    inflations: int = 0  # of the attitude, in a row
    map_number: int = 0
    lost: bool = False
    last_nav: NavSample | None = None
    last_positioned: PositionedExposure | None = None  # first exposure of the pair that M26 looks for

    def copy(self) -> FilterMemory:
        """Return an independent copy; records and arrays that are only replaced, never changed, are shared."""
        state = self.state.copy() if self.state is not None else None
        return replace(self, visual=self.visual.copy(), health=copy(self.health), state=state)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A filter at one moment."""

    t_ns: int
    memory: FilterMemory
    exposures: int  # recorded so far
    rows: int  # of GPS/INS, recorded so far

    @property
    def state(self) -> FilterState | None:
        """State of the filter; None before the first GPS/INS row."""
        return self.memory.state
