"""From a map to a decision, as often as there is a newer map; what was found earlier stays in reserve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight import hazards, terrain
from alight.landing import sites
from alight.landing.next_view import next_view
from alight.landing.reserve import Reserve
from alight.parallax import orthophoto
from alight.records import F64, ElevationMap, Flag, HazardMap, NextView, Sites, TerrainMap, View
from alight.settings import Settings

Timed = Callable[[str, float], float]  # stage, when it began: now
WET = np.uint16(Flag.WATER)
MOST_LOST = 100  # sites whose loss is remembered


@dataclass(frozen=True, eq=False)
class Verdict:
    """What one map says about landing."""

    elevation: ElevationMap  # with the heights of water refused
    cover: TerrainMap | None
    danger: HazardMap
    sites: Sites
    look: NextView | None  # a view that would help, where there is no site


class Judge:
    """Judges one map after the other, and keeps the sites of earlier ones until a newer one refuses them.

    Args:
        appearance: what ground looks like; None: the map's own evidence alone says what covers it.
        timed: told of every stage.
    """

    def __init__(self, settings: Settings, appearance: terrain.Model | None, timed: Timed) -> None:
        self._settings, self._appearance, self._timed = settings, appearance, timed
        self.reserve = Reserve()
        self.lost: list[str] = []  # in words, the newest last

    def says(self, elevation: ElevationMap) -> str:
        """In words, what the classes of a map are made of."""
        return terrain.describe(elevation, self._settings.terrain, self._appearance)

    def judge(
        self, elevation: ElevationMap, views: Sequence[View], vehicle: F64, above: float, start: float
    ) -> Verdict:
        """Judge a map.

        Args:
            elevation: heights.
            views: what looked at it, for pixels finer than the heights.
            vehicle: (3,) metres, where it is.
            above: metres, its usual height above the ground.
            start: when it begins, by the clock of `timed`.
        """
        s = self._settings
        cover = None
        if s.terrain.enabled:
            elevation = replace(elevation, fine=orthophoto(views, elevation))
            start = self._timed("finer pixels", start)
            cover = terrain.classify(elevation, s.terrain, self._appearance)
        start = self._timed("terrain", start)
        danger = hazards.assess(elevation, cover, s.lander, s.hazards)
        start = self._timed("hazards", start)
        chosen = sites.choose_sites(danger, cover, elevation, s.sites, s.lander, vehicle)
        look = None if chosen.sites else next_view(danger, elevation, s.lander, above)
        self._remember(chosen, danger)
        self._timed("sites", start)
        return Verdict(without_water(elevation, cover), cover, danger, chosen, look)

    def _remember(self, found: Sites, danger: HazardMap) -> None:
        apart = self._settings.sites.separation or 2 * self._settings.lander.radius
        self.reserve = self.reserve.updated(found, danger, apart)
        said = [f"east {s.east:.1f} north {s.north:.1f} m: {why}" for s, why in self.reserve.lost]
        self.lost = (self.lost + said)[-MOST_LOST:]

    def notes(self, found: Verdict) -> dict[str, object]:
        """What a run's notes say of it: the next look, sites of earlier maps, and why others were given up."""
        out: dict[str, object] = {"terrain": self.says(found.elevation)}
        if found.look is not None:
            out["look next"] = in_words(found.look)
        earlier = self.reserve.sites[len(found.sites.sites) :]
        if earlier:
            out["sites in reserve"] = [f"east {s.east:.1f} north {s.north:.1f} m, P {s.p_safe:.3f}" for s in earlier]
        if self.lost:
            out["sites given up"] = list(self.lost)
        return out


def in_words(look: NextView) -> str:
    """The proposal as a sentence."""
    east, north, up = np.asarray(look.position_world)
    return f"east {east:.1f} north {north:.1f} up {up:.1f} m, where P(safe) is {look.p_safe:.2f}"


def without_water(elevation: ElevationMap, cover: TerrainMap | None) -> ElevationMap:
    """The map with the heights of water refused: flat, smooth and confident, they are those of the bed.

    On the sample flight this takes the wrong heights that are given out from 10 % of all to 1 %.
    """
    if cover is None:
        return elevation
    return replace(elevation, flags=elevation.flags | np.where(terrain.open_water(cover), WET, np.uint16(0)))
