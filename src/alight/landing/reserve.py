"""Sites held in reserve from map to map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.landing.sites import REASON_WORDS
from alight.records import Hazard, HazardMap, Site, Sites

SIGMAS_OF_TIE = 2.0  # sigmas that the clearance of a site must cover, to be a site in another frame


@dataclass(frozen=True)
class Reserve:
    """The sites found so far in a flight, and those that the newest map refused."""

    sites: tuple[Site, ...] = ()
    lost: tuple[tuple[Site, str], ...] = ()  # by the newest map
    frame_id: int = 0  # of the map that their places belong to

    def moved(self, shift: F64) -> Reserve:
        """All sites moved by `shift`, (3,) metres."""
        lost = tuple((s.moved(shift), why) for s, why in self.lost)
        return replace(self, sites=tuple(s.moved(shift) for s in self.sites), lost=lost)

    def tied(self, shift: F64, sigma: float, frame_id: int) -> Reserve:
        """Move all sites into another frame; sites whose clearance does not cover the error of the tie are lost.

        Args:
            shift: (3,) metres, to add.
            sigma: metres, 1-sigma of it on the ground.
            frame_id: of the other frame.
        """
        moved = self.moved(shift).sites
        kept = [s for s in moved if s.clearance >= SIGMAS_OF_TIE * sigma]
        why = f"the motion began anew, and its place is known to {sigma:.2f} m only"
        lost = tuple((s, why) for s in moved if s not in kept)
        return Reserve(tuple(replace(s, rank=i + 1) for i, s in enumerate(kept)), lost, frame_id)

    def updated(self, found: Sites, hazards: HazardMap, apart: float) -> Reserve:
        """Merge with the sites of a newer map; older ones stay until a map refuses them.

        Args:
            found: chosen from the newer map.
            hazards: of the newer map; it confirms, refuses or does not see the older sites.
            apart: metres within which two sites are the same.

        Returns:
            The newer sites first, then older ones that the newer map does not see; refused ones are lost.
        """
        kept, lost = list(found.sites), []
        for old in self.sites:
            if any(math.hypot(old.east - s.east, old.north - s.north) <= apart for s in kept):
                continue
            why = _refusal(hazards, old)
            if why is None:
                kept.append(old)
            else:
                lost.append((old, why))
        return replace(self, sites=tuple(replace(s, rank=i + 1) for i, s in enumerate(kept)), lost=tuple(lost))


def _refusal(hazards: HazardMap, site: Site) -> str | None:
    """The reasons against the place of a site in words; None if there are none, or the map does not show the place."""
    row, col = (int(np.rint(v)) for v in hazards.grid.index(np.array(site.east), np.array(site.north)))
    if not (0 <= row < hazards.grid.rows and 0 <= col < hazards.grid.cols):
        return None
    reasons = Hazard(int(hazards.reasons[row, col])) & ~(Hazard.EDGE | Hazard.UNKNOWN)
    return ", ".join(REASON_WORDS[bit] for bit in reasons) or None
