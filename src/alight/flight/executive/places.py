"""Locations: the opinion of a verdict on a location, and the locations that a search has seen and refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from itertools import compress

import numpy as np

from alight.arrays import F64
from alight.flight.executive.bounds import Bounds
from alight.landing.sites import REASON_WORDS
from alight.records import Hazard, Site, Terrain, keeps_margin
from alight.records.executive import MapVerdict
from alight.settings import StageSettings


class Standing(Enum):
    """The result of a verdict for one location."""

    SITE = "site"
    CANDIDATE = "candidate"
    REFUSED = "refused"
    NOT_SEEN = "not seen"


@dataclass(frozen=True)
class Opinion:
    """Opinion of one verdict on one location: its standing, P(safe) and reason."""

    standing: Standing
    place: Site  # the listed site or candidate that is treated as the location; else the location itself
    p_safe: float
    why: str = ""  # reason why it is not a site


def opinion(
    place: Site,
    seen: MapVerdict,
    same: float,
    least: float = 0.0,
    free: Callable[[Site], bool] = lambda listed: True,
    margin: float = 0.0,
) -> Opinion:
    """Return the opinion of a verdict on a location.

    A site or candidate that is listed near by is treated as the same location. Otherwise the map's cell at the location
    decides, as good ground is not listed if a better location lies a few metres away.

    Args:
        place: location to judge.
        seen: the verdict.
        same: distance in metres within which a listed location is treated as the same.
        least: P(safe) below which an unlisted location is refused.
        free: returns whether a listed location may be treated as the same.
        margin: least clearance of a site, metres; a cell with less is at best a candidate.
    """
    listed = [s for s in seen.sites.listed if free(s) and (place.avoid or not s.avoid)]
    near = [s for s in listed if math.hypot(s.east - place.east, s.north - place.north) <= same]
    if near:
        best = max(near, key=lambda s: s.p_safe)
        is_site = best.kind == "site" or best.doubt == "zone"  # it is visited after all others
        return Opinion(Standing.SITE if is_site else Standing.CANDIDATE, best, best.p_safe, best.doubt or "")
    grid = seen.hazards.grid
    row, col = (int(np.rint(v)) for v in grid.index(np.array(place.east), np.array(place.north)))
    if not (0 <= row < grid.rows and 0 <= col < grid.cols):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "outside the map")
    reasons, p = Hazard(int(seen.hazards.reasons[row, col])), float(seen.hazards.p_safe[row, col])
    doubts = Hazard.DOUBT | Hazard.AVOID if place.avoid else Hazard.DOUBT
    if reasons & (Hazard.UNKNOWN | Hazard.EDGE) and not reasons & ~(Hazard.UNKNOWN | Hazard.EDGE):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "not seen whole")
    if reasons & ~doubts:
        words = seen.hazards.words(REASON_WORDS, row, col)
        return Opinion(Standing.REFUSED, place, 0.0 if math.isnan(p) else p, words)
    if math.isnan(p):
        return Opinion(Standing.NOT_SEEN, place, 0.0, "not judged")
    found = replace(place, p_safe=p)
    if p < least:
        return Opinion(Standing.REFUSED, found, p, "P(safe) is too low")
    roomy = place.avoid or keeps_margin(seen.hazards.clearance[row, col], margin)
    why = "doubt" if reasons & Hazard.DOUBT else "" if roomy else f"another is refused within {margin:.1f} m"
    return Opinion(Standing.CANDIDATE if why else Standing.SITE, found, p, why)


class KnownPlaces:
    """Sites and candidates as last seen, without the refused locations."""

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._near = settings.executive, 2.0 * settings.lander.radius  # m, at which footprints overlap
        self._noted: list[Site] = []
        self._noted_by = 0  # number of the newest verdict noted
        self._refused: list[tuple[float, float]] = []

    @property
    def refusals(self) -> int:
        """Number of locations that were refused."""
        return len(self._refused)

    def fates(self, bounds: Bounds) -> str:
        """Return why no location was landed on, as the end of a sentence; empty: no location was known."""
        refused = f"; {self.refusals} places were refused from near by" if self._refused else ""
        at = [p.position_world for p in self._ranked()]
        outside = [bounds.limit(p) for p in at if not bounds.allows_site(p)]
        fence = f"; {len(outside)} are outside the {bounds.name} ({', '.join(sorted({*outside}))})" if outside else ""
        left = self.best(lambda place: bounds.allows_site(place.position_world)) is not None
        return f"{refused}{fence}{'; something stands beside what is left' if left else ''}"

    def note(self, seen: MapVerdict) -> None:
        """Remember the locations that a new verdict lists; forget earlier locations on ground that the verdict sees."""
        if seen.number <= self._noted_by:
            return
        self._noted_by = seen.number
        listed = [p for p in seen.sites.listed if self._keys.look_again or self.worth_a_visit(p)]
        unseen = (opinion(p, seen, self._keys.same_place).standing is Standing.NOT_SEEN for p in self._noted)
        self._noted = [*compress(self._noted, unseen), *listed]

    def refuse(self, place: Site | None) -> None:
        """Exclude a location from all later visits; None has no effect."""
        if place is not None:
            self._refused.append((place.east, place.north))

    def is_refused(self, place: Site) -> bool:
        """Whether a location is at or near a refused location."""
        return any(math.hypot(place.east - e, place.north - n) < self._near for e, n in self._refused)

    def forget(self) -> None:
        """Forget all locations, noted and refused."""
        self._refused.clear()
        self._noted.clear()

    def best(self, is_open: Callable[[Site], bool] = lambda place: True) -> Site | None:
        """Return the best location that was not refused; None: there is none.

        Sites come first, then candidates, by P(safe) and land cover. After k candidates were refused from near by, the
        next candidate is a site with probability 1 / (k + 2) (rule of succession). After `executive.visits` refusals,
        candidates are left out.

        Args:
            is_open: returns whether a path across a location is clear.
        """
        hopeless = len(self._refused) >= self._keys.visits
        counts = (p for p in self._ranked() if p.kind == "site" or not hopeless)
        return next(filter(is_open, counts), None)

    def nearest_site(self, position: F64, is_open: Callable[[Site], bool]) -> Site | None:
        """Return the nearest site that was not refused to a position, (3,) metres; None: there is none.

        `is_open`: see `best`.
        """
        sites = [p for p in self._noted if p.kind == "site" and not (p.avoid or self.is_refused(p))]
        near = sorted(sites, key=lambda p: math.dist(position[:2], (p.east, p.north)))
        return next(filter(is_open, near), None)

    def _ranked(self) -> list[Site]:
        """Return the locations that were not refused: sites, then candidates, each by P(safe) and land cover."""
        plain = {Terrain.BARE: self._keys.plain, Terrain.PAVED: self._keys.plain}  # near looks settle doubt here
        free = [p for p in self._noted if not self.is_refused(p)]

        def rank(p: Site) -> tuple[bool, bool, bool, float]:
            preferred = p.preferred and (p.kind == "site" or p.p_safe >= self._keys.probable)
            return not p.avoid, p.kind == "site", preferred, p.p_safe + plain.get(p.terrain, 0.0)

        return sorted(free, key=rank, reverse=True)

    def worth_a_visit(self, place: Site) -> bool:
        """Whether a location is a site or, while few were refused, a good candidate; a search stops for it."""
        few = len(self._refused) < self._keys.tries_at_once
        return not place.avoid and (place.kind == "site" or (few and place.p_safe >= self._keys.probable))

    def better(self, place: Site, is_open: Callable[[Site], bool] = lambda place: True) -> Site | None:
        """Return a location worth a visit and clearly better than `place`, which is in doubt; None: there is none.

        `is_open`: see `best`.
        """
        others = (p for p in self._ranked() if math.hypot(p.east - place.east, p.north - place.north) > self._near)
        best = next((p for p in others if self.worth_a_visit(p) and is_open(p)), None)
        return best if best is not None and best.p_safe >= place.p_safe + self._keys.clearly else None
