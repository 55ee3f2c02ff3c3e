"""Look up one place in the verdict on a map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from alight.landing.reasons import REASON_WORDS
from alight.records import Hazard, Site, keeps_margin
from alight.records.executive import MapVerdict


class Standing(Enum):
    """The verdict on one place."""

    SITE = "site"
    CANDIDATE = "candidate"
    REFUSED = "refused"
    NOT_SEEN = "not seen"


@dataclass(frozen=True)
class Opinion:
    """Opinion of one verdict on one place."""

    standing: Standing
    place: Site  # moved to the listed place that counts as it
    p_safe: float
    why: str = ""  # reason why it is no site


def opinion(
    place: Site,
    seen: MapVerdict,
    same: float,
    least: float = 0.0,
    free: Callable[[Site], bool] = lambda listed: True,
    margin: float = 0.0,
) -> Opinion:
    """Look up the verdict on one place.

    A listed place near by counts as it. For a place that is not listed, its cell decides: it may be good ground that is
    not listed because of a better place a few metres away. Where it keeps no margin, it is a candidate at best.

    Args:
        place: in the frame of the verdict's map.
        seen: the verdict.
        same: metres within which a listed place is the same.
        least: P(safe) below which a place that is only in doubt counts as refused.
        free: True if a listed place may count as it.
        margin: metres to the nearest refused touchdown that a site keeps; listed sites keep it already.
    """
    listed = [s for s in seen.sites.listed if free(s)]
    near = [s for s in listed if math.hypot(s.east - place.east, s.north - place.north) <= same]
    if near:
        best = max(near, key=lambda s: s.p_safe)
        return Opinion(Standing(best.kind), best, best.p_safe, best.doubt or "")
    grid = seen.hazards.grid
    row, col = (int(np.rint(v)) for v in grid.index(np.array(place.east), np.array(place.north)))
    if not (0 <= row < grid.rows and 0 <= col < grid.cols):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "outside the map")
    reasons, p = Hazard(int(seen.hazards.reasons[row, col])), float(seen.hazards.p_safe[row, col])
    if reasons & (Hazard.UNKNOWN | Hazard.EDGE) and not reasons & ~(Hazard.UNKNOWN | Hazard.EDGE):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "not seen whole")
    if reasons & ~Hazard.DOUBT:
        words = ", ".join(REASON_WORDS[bit] for bit in reasons if bit in REASON_WORDS)
        return Opinion(Standing.REFUSED, place, 0.0 if math.isnan(p) else p, words)
    if math.isnan(p):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "not judged")
    found = replace(place, p_safe=p)
    if p < least:
        return Opinion(Standing.REFUSED, found, p, "P(safe) is too low")
    roomy = keeps_margin(seen.hazards.clearance[row, col], margin)
    why = "doubt" if reasons & Hazard.DOUBT else "" if roomy else f"another is refused within {margin:.1f} m"
    return Opinion(Standing.CANDIDATE if why else Standing.SITE, found, p, why)
