"""Search of the best cells (G11, G11a) of a map that is at hand as a whole or in parts: the places found are the same.

A part keeps its best cell. It is read again only if a place found elsewhere lies so near that the cell is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from alight.arrays import F32, F64, U16, Mask
from alight.geometry import Grid
from alight.geometry.grid import Box
from alight.raster import RIM, clearance_of, disc_mean, disc_window
from alight.records import ElevationMap, Hazard, HazardMap, Observer, TerrainMap, keeps_margin
from alight.settings import Lander, SitesSettings

R = TypeVar("R")
Cell = tuple[int, int]  # row, column in the whole map
DOUBT, AVOID = Hazard.DOUBT, Hazard.AVOID


class WantedTouchdowns(NamedTuple):
    """Which touchdowns are searched, by the reasons against them."""

    reasons: Hazard  # that they have
    or_not: Hazard = Hazard(0)  # that they may have besides
    no_limit: Hazard = Hazard(0)  # that do not end their clearance
    candidates: bool = False  # whether their P(safe) counts more than their score

    def among(self, reasons: U16) -> Mask:
        """Return the mask of the touchdowns, (R, C)."""
        return np.asarray((reasons & ~np.uint16(self.or_not)) == np.uint16(self.reasons))


SAFE = WantedTouchdowns(Hazard(0))
# a candidate's clearance is the distance to refused cells; undecided cells do not reduce it
UNDECIDED = WantedTouchdowns(DOUBT, no_limit=DOUBT | AVOID, candidates=True)
AVOIDED = WantedTouchdowns(AVOID, DOUBT, DOUBT | AVOID, candidates=True)
AVOIDED_SITES = WantedTouchdowns(AVOID, no_limit=AVOID)


class Scale(NamedTuple):
    """Range of the scores of all searched touchdowns, for terms that compare them; infinite without any."""

    low: float = np.inf
    high: float = -np.inf
    preferred: float = -np.inf  # highest score in zones whose sites rank higher

    def joined(self, other: Scale) -> Scale:
        """Return the range of both."""
        return Scale(min(self.low, other.low), *map(max, self[1:], other[1:]))

    @property
    def lift(self) -> float:
        """What lifts a preferred touchdown above all others."""
        return self.high - self.low + 1.0

    @property
    def best(self) -> float:
        """Highest score after the lift."""
        return max(self.high, self.preferred + self.lift)


class Best(NamedTuple):
    """A touchdown with its score."""

    score: float  # -inf: none is left
    cell: Cell


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a map with what its touchdowns are scored by; its `core` holds the cells that are searched in it."""

    hazards: HazardMap
    land_cover: TerrainMap | None
    elevation: ElevationMap | None  # None: of a part that is searched but has no site to report
    settings: SitesSettings
    lander: Lander
    observer: Observer | None
    first: Cell = (0, 0)  # row and column of its first cell in the whole map
    core: Box = (slice(None), slice(None))
    farthest: float = np.inf  # metres, largest clearance that is looked for

    def clearance(self, wanted: WantedTouchdowns) -> F32:
        """Return the clearance of each touchdown, (R, C) metres."""
        if not wanted.no_limit:
            return self.hazards.clearance
        if wanted.no_limit not in self._clearances:
            self._clearances[wanted.no_limit] = self._clearance(wanted.no_limit)
        return self._clearances[wanted.no_limit]

    @cached_property
    def _clearances(self) -> dict[Hazard, F32]:
        return {}

    @cached_property
    def _ranked(self) -> dict[tuple[WantedTouchdowns, Scale], F64]:
        return {}

    def _clearance(self, no_limit: Hazard) -> F32:
        free = (self.hazards.reasons & ~np.uint16(no_limit)) == 0
        return np.minimum(clearance_of(free, self.hazards.grid.cell), np.float32(self.farthest))

    def score(self, wanted: WantedTouchdowns) -> F64:
        """Compute the score of each cell (G11) by quality, clearance, P(safe) and distance; -inf if not searched."""
        hazards, settings = self.hazards, self.settings
        allowed = np.zeros(hazards.grid.shape, np.bool_)
        allowed[self.core] = wanted.among(hazards.reasons[self.core])
        if not allowed.any():
            return np.full(allowed.shape, -np.inf)
        clearance = self.clearance(wanted)
        allowed &= keeps_margin(clearance, settings.margin) & np.isfinite(hazards.quality)
        room = np.minimum(clearance / settings.roomy, 1.0)
        doubt = 1 - np.nan_to_num(hazards.p_safe).astype(np.float64)
        score = hazards.quality + room - settings.doubt_weight * doubt
        if self.observer is not None and settings.distance_weight > 0:
            east, north = hazards.grid.xy()
            vehicle = self.observer.position
            distance = np.hypot(east[None, :] - vehicle[0], north[:, None] - vehicle[1])
            score -= settings.distance_weight * distance
        return np.where(allowed, score, -np.inf)

    def scale(self, wanted: WantedTouchdowns) -> Scale:
        """Return the range of the scores."""
        score, preferred = self.score(wanted), self.hazards.preferred
        found = score[np.isfinite(score)]
        if not found.size:
            return Scale()
        above = -np.inf if preferred is None else float(score[preferred].max(initial=-np.inf))
        return Scale(float(found.min()), float(found.max()), above)

    def ranked(self, wanted: WantedTouchdowns, scale: Scale) -> F64:
        """Compute what ranks the cells, (R, C): the score or, for candidates, mean P(safe) in steps, then the score."""
        score, hazards = self.score(wanted), self.hazards
        if hazards.preferred is not None and np.isfinite(scale.best):
            score[hazards.preferred] += scale.lift
        if not wanted.candidates or not np.isfinite(score).any():
            return score
        chance = disc_mean(np.nan_to_num(hazards.p_safe), self.settings.margin, hazards.grid.cell)
        steps = np.floor(chance / self.settings.chance_step)
        return np.where(np.isfinite(score), steps + 0.99 * np.exp(score - scale.best), -np.inf)

    def best(self, wanted: WantedTouchdowns, scale: Scale, taken: Sequence[Best] = (), apart: float = 0.0) -> Best:
        """Return the best cell of the part, more than `apart` metres from all `taken`."""
        if (wanted, scale) not in self._ranked:
            self._ranked[wanted, scale] = self.ranked(wanted, scale)
        left, (first_row, first_col) = self._ranked[wanted, scale].copy(), self.first
        for row, col in (best.cell for best in taken):
            row, col = row - first_row, col - first_col
            reach = math.floor(apart / self.hazards.grid.cell + RIM)
            if -reach <= row < left.shape[0] + reach and -reach <= col < left.shape[1] + reach:
                rows, cols, disc = disc_window(left.shape, row, col, apart / self.hazards.grid.cell)
                left[rows, cols][disc] = -np.inf
        row, col = divmod(int(np.argmax(left)), left.shape[1])
        return Best(float(left[row, col]), (row + first_row, col + first_col))


class SearchedMap(Protocol):
    """A map that is at hand as a whole or in parts."""

    @property
    def grid(self) -> Grid:
        """Grid of the map."""

    @property
    def zoned(self) -> bool:
        """Whether zones are against touchdowns."""

    @property
    def preferring(self) -> bool:
        """Whether the sites of a zone rank higher."""

    @property
    def judged(self) -> int:
        """Number of cells with a P(safe)."""

    @property
    def cores(self) -> Sequence[Box]:
        """Rows and columns of each part."""

    def of_parts(self, do: Callable[[Part], R], numbers: Iterable[int]) -> Iterable[R]:
        """Yield the result of `do` for each part that is named by its number."""

    def about(self, cell: Cell) -> Part:
        """Return a part around a cell, with all that a site is reported with."""


@dataclass(frozen=True, eq=False)
class WholeMap:
    """A map that is at hand as a whole."""

    whole: Part

    @property
    def grid(self) -> Grid:
        """Grid of the map."""
        return self.whole.hazards.grid

    @property
    def zoned(self) -> bool:
        """Whether zones are against touchdowns."""
        return self.whole.hazards.zone is not None

    @property
    def preferring(self) -> bool:
        """Whether the sites of a zone rank higher."""
        return self.whole.hazards.preferred is not None

    @property
    def judged(self) -> int:
        """Number of cells with a P(safe)."""
        return int(np.isfinite(self.whole.hazards.p_safe).sum())

    @property
    def cores(self) -> Sequence[Box]:
        """Rows and columns of the only part."""
        return [(slice(0, self.grid.rows), slice(0, self.grid.cols))]

    def of_parts(self, do: Callable[[Part], R], numbers: Iterable[int]) -> Iterable[R]:
        """Yield the result for the whole map."""
        return (do(self.whole) for _ in numbers)

    def about(self, cell: Cell) -> Part:
        """Return the whole map."""
        return self.whole


class SiteSearch:
    """Search of touchdowns of one kind."""

    def __init__(self, ground: SearchedMap, wanted: WantedTouchdowns) -> None:
        self.ground, self._wanted, self._scale = ground, wanted, Scale()
        if wanted.candidates or ground.preferring:
            for scale in ground.of_parts(lambda part: part.scale(wanted), range(len(ground.cores))):
                self._scale = self._scale.joined(scale)

    @cached_property
    def _best(self) -> list[Best]:
        """The best cell of each part."""
        do = partial(Part.best, wanted=self._wanted, scale=self._scale)
        return list(self.ground.of_parts(do, range(len(self.ground.cores))))

    def peaks(self, count: int, apart: float, taken: Sequence[Best] = ()) -> list[Best]:
        """Return up to `count` best cells, best first, more than `apart` metres from each other and from `taken`.

        Of equal cells the first in the order of rows, then of columns, is the best.
        """
        left, found = list(self._best), list[Best]()
        while len(found) < count:
            number = min(range(len(left)), key=lambda k: (-left[k].score, left[k].cell))
            best, others = left[number], [*taken, *found]
            if not np.isfinite(best.score):
                break
            if not self._is_taken([best.cell], others, apart):
                found.append(best)
            elif self._is_taken(corners(self.ground.cores[number]), others, apart):
                left[number] = Best(-np.inf, best.cell)
            else:
                do = partial(Part.best, wanted=self._wanted, scale=self._scale, taken=others, apart=apart)
                left[number] = next(iter(self.ground.of_parts(do, [number])))
        return found

    def _is_taken(self, cells: Sequence[Cell], others: Sequence[Best], apart: float) -> bool:
        """Whether all of the cells lie within `apart` metres of one of the others."""
        rows, cols = np.array(cells).T
        most = apart / self.ground.grid.cell + RIM
        return any((np.hypot(cols - col, rows - row) <= most).all() for row, col in (other.cell for other in others))


def corners(box: Box) -> list[Cell]:
    """Return the corner cells of a box."""
    rows, cols = box
    return [(row, col) for row in (rows.start, rows.stop - 1) for col in (cols.start, cols.stop - 1)]
