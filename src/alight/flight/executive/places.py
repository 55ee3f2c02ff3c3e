"""Places: the opinion of a verdict on one, and those that a search has seen and refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from itertools import compress

import numpy as np

from alight.landing.sites import REASON_WORDS
from alight.records import Hazard, Site, Terrain, keeps_margin
from alight.records.executive import MapVerdict
from alight.settings import StageSettings


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


class KnownPlaces:
    """Listed places as they were seen last, without those that were refused."""

    def __init__(self, settings: StageSettings) -> None:
        self._keys = settings.executive
        self._noted: list[Site] = []
        self._noted_by = 0  # verdict
        self._refused: list[tuple[float, float]] = []

    @property
    def fates(self) -> str:
        """Reason why no place was landed on, in words to end a sentence with; empty: no place was known."""
        refused = f"; {len(self._refused)} places were refused from near by" if self._refused else ""
        return f"{refused}; something stands beside what is left" if self.best() is not None else refused

    def note(self, seen: MapVerdict) -> None:
        """Remember the listed places of a new verdict, in place of earlier ones on the same ground."""
        if seen.number <= self._noted_by:
            return
        self._noted_by = seen.number
        listed = [p for p in seen.sites.listed if self._keys.look_again or self.worth_a_visit(p)]
        unseen = (opinion(p, seen, self._keys.same_place).standing is Standing.NOT_SEEN for p in self._noted)
        self._noted = [*compress(self._noted, unseen), *listed]

    def refuse(self, place: Site | None) -> None:
        """Never visit a place again."""
        if place is not None:
            self._refused.append((place.east, place.north))

    def is_refused(self, place: Site) -> bool:
        """True if the place is, or lies beside, one that was refused."""
        return any(math.hypot(place.east - e, place.north - n) < self._keys.banned for e, n in self._refused)

    def forget(self) -> None:
        """Forget all places, noted and refused."""
        self._refused.clear()
        self._noted.clear()

    def best(self, is_open: Callable[[Site], bool] = lambda place: True) -> Site | None:
        """The best place known that was not refused before: sites first, then candidates by P(safe) and kind of ground.

        Args:
            is_open: True if a way across a place is clear.

        After k candidates refused from near by, the next one is a site with a probability of 1 / (k + 2) (rule of
        succession). When that is small, they are not worth the time and the battery.
        """
        hopeless = len(self._refused) >= self._keys.visits
        counts = (p for p in self._ranked() if p.kind == "site" or not hopeless)
        return next(filter(is_open, counts), None)

    def _ranked(self) -> list[Site]:
        """Places that were not refused: sites, then candidates by P(safe).

        Bare and paved ground counts more: near looks settle doubt there, not on grass.
        """
        plain = {Terrain.BARE: self._keys.plain, Terrain.PAVED: self._keys.plain}
        free = [p for p in self._noted if not self.is_refused(p)]
        return sorted(free, key=lambda p: (p.kind == "site", p.p_safe + plain.get(p.terrain, 0.0)), reverse=True)

    def worth_a_visit(self, place: Site) -> bool:
        """True if the search is broken off for a place: a site, or a good candidate as long as few were refused."""
        few = len(self._refused) < self._keys.tries_at_once
        return place.kind == "site" or (few and place.p_safe >= self._keys.probable)

    def better(self, place: Site, is_open: Callable[[Site], bool] = lambda place: True) -> Site | None:
        """The place to visit instead of one in doubt: one for which a search is broken off, and clearly better."""
        others = (
            p for p in self._ranked() if math.hypot(p.east - place.east, p.north - place.north) > self._keys.banned
        )
        best = next((p for p in others if self.worth_a_visit(p) and is_open(p)), None)
        return best if best is not None and best.p_safe >= place.p_safe + self._keys.clearly else None
