"""Counts of the cells of a hazard map, which add up over the parts of a large map."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import Mask
from alight.records.landing import Hazard, HazardMap


@dataclass(frozen=True)
class Tally:
    """How many cells of a map can be judged, are safe, or are refused for a reason."""

    cells: int = 0
    judged: int = 0  # with a P(safe)
    safe: int = 0
    room: float = 0.0  # metres, largest clearance of a safe cell
    reasons: Counter[Hazard] = field(default_factory=Counter)
    zones: Counter[tuple[Hazard, str]] = field(default_factory=Counter)  # by reason and label, over all cells

    @classmethod
    def of(cls, hazards: HazardMap, where: Mask | None = None) -> Tally:
        """Count the cells of a map, or those of a mask (R, C)."""
        at = slice(None) if where is None else where
        reasons, p_safe = hazards.reasons[at], hazards.p_safe[at]
        safe = reasons == 0
        zones = Counter({(b, z): n for b in (Hazard.ZONE, Hazard.AVOID) for z, n in hazards.zones_behind(b).items()})
        return cls(
            cells=reasons.size,
            judged=int(np.isfinite(p_safe).sum()),
            safe=int(safe.sum()),
            room=float(hazards.clearance[at][safe].max(initial=0.0)),
            reasons=Counter({bit: int(((reasons & np.uint16(bit)) != 0).sum()) for bit in Hazard}),
            zones=zones,
        )

    def __add__(self, other: Tally) -> Tally:
        """Add the counts of another part of the map."""
        return Tally(
            self.cells + other.cells,
            self.judged + other.judged,
            self.safe + other.safe,
            max(self.room, other.room),
            self.reasons + other.reasons,
            self.zones + other.zones,
        )

    def with_room(self, room: float) -> Tally:
        """Return the counts with a clearance, metres, that safe cells have somewhere."""
        return replace(self, room=max(self.room, room))

    def share(self, bit: Hazard) -> float:
        """Return the share of the cells that a reason refuses."""
        return self.reasons[bit] / max(self.cells, 1)
