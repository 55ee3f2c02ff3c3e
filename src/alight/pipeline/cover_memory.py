"""Land cover of earlier maps: the look at the most familiar ground counts (docs/method/p-safe.md, T8)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import F32, F64
from alight.geometry import Grid
from alight.records import TerrainMap

FADES = 60.0  # s after which an earlier look counts as twice as unlike known ground
SURE = 0.3  # metres, most sigma of a tie between map frames with which earlier looks still count


def _nothing() -> F32:
    return np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class CoverMemory:
    """The most familiar look at every cell of the newest map, by value; in the map's frame.

    The land cover is fitted to pictures from several metres and more. A puddle that is plain from 10 m looks like wet
    asphalt from 3 m, and its novelty (T6) is larger there. So the odds of the look with the least novelty stay.
    """

    grid: Grid | None = None  # None: nothing was seen yet
    bears: F32 = field(default_factory=_nothing)  # (R, C) probability of ground that bears and is dry; NaN: not seen
    novelty: F32 = field(default_factory=_nothing)  # (R, C) at that look, and more the older it is
    t_ns: int = 0

    def with_seen(self, land_cover: TerrainMap, t_ns: int) -> CoverMemory:
        """The memory after a newer look at `t_ns`; only the cells of its grid are kept."""
        if land_cover.bears is None or land_cover.novelty is None:
            return self
        bears, novelty = land_cover.bears, land_cover.novelty
        if self.grid is not None:
            age = max(t_ns - self.t_ns, 0) * 1e-9
            before = self.grid.nearest_on(land_cover.grid, self.bears, np.nan)
            unlike = self.grid.nearest_on(land_cover.grid, self.novelty, np.nan) * np.float32(2 ** (age / FADES))
            keeps = ~np.isnan(before) & (np.isnan(bears) | ~(unlike >= novelty))
            bears, novelty = np.where(keeps, before, bears), np.where(keeps, unlike, novelty)
        return CoverMemory(land_cover.grid, bears, novelty, t_ns)

    def doubted(self, land_cover: TerrainMap) -> TerrainMap:
        """The land cover on the memory's grid, with the lower of both probabilities: a memory never permits."""
        if land_cover.bears is None or self.grid != land_cover.grid:
            return land_cover
        return replace(land_cover, bears=np.where(self.bears < land_cover.bears, self.bears, land_cover.bears))

    def moved(self, shift: F64, sigma: float) -> CoverMemory:
        """The memory in a frame where positions are larger by `shift`, metres; nothing where that is not known well."""
        if self.grid is None or not sigma <= SURE:
            return NO_COVER_SEEN
        east, north = self.grid.east + float(shift[0]), self.grid.north + float(shift[1])
        return replace(self, grid=replace(self.grid, east=east, north=north))


NO_COVER_SEEN = CoverMemory()
