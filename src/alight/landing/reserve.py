"""Sites that are held in reserve from map to map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.landing.sites import REASON_WORDS
from alight.records import Hazard, HazardMap, Site, Sites

SIGMAS_OF_TIE = 2.0  # number of sigmas of the tie that a site's clearance must cover to stay a site


@dataclass(frozen=True)
class Reserve:
    """Sites of all maps so far that no newer map refuses, and the sites that the newest map refused."""

    sites: tuple[Site, ...] = ()
    lost: tuple[tuple[Site, str], ...] = ()  # sites refused by the newest map, with the reasons in words
    frame_id: int = 0  # map number of the frame of the positions

    def moved(self, shift: F64) -> Reserve:
        """Return the reserve with all sites moved by `shift`, (3,) metres."""
        lost = tuple((s.moved(shift), why) for s, why in self.lost)
        return replace(self, sites=tuple(s.moved(shift) for s in self.sites), lost=lost)

    def tied(self, shift: F64, sigma: float, frame_id: int) -> Reserve:
        """Move all sites into another map frame; a site is lost if its clearance does not cover the error of the move.

        Args:
            shift: (3,) metres, to add to every position.
            sigma: horizontal 1-sigma of the shift, metres.
            frame_id: number of the other map frame.
        """
        moved = self.moved(shift).sites
        kept = [s for s in moved if s.clearance >= SIGMAS_OF_TIE * sigma]
        why = f"the motion began anew, and its place is known to {sigma:.2f} m only"
        lost = tuple((s, why) for s in moved if s not in kept)
        return Reserve(tuple(replace(s, rank=i + 1) for i, s in enumerate(kept)), lost, frame_id)

    def updated(self, found: Sites, hazards: HazardMap, apart: float) -> Reserve:
        """Merge with the sites of a newer map; older sites stay until a map refuses them.

        Args:
            found: sites of the newer map.
            hazards: hazards of the newer map, which confirm, refuse or do not show the older sites.
            apart: distance in metres within which two sites are treated as one.

        Returns:
            The newer sites first, then the older sites that the newer map does not refuse. Refused sites are in `lost`.
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
    """Return why the hazards refuse a site, in words; None if they do not refuse it, or do not show it."""
    row, col = (int(np.rint(v)) for v in hazards.grid.index(np.array(site.east), np.array(site.north)))
    if not (0 <= row < hazards.grid.rows and 0 <= col < hazards.grid.cols):
        return None
    unseen = Hazard.EDGE | Hazard.UNKNOWN
    return hazards.words({bit: words for bit, words in REASON_WORDS.items() if bit not in unseen}, row, col) or None
