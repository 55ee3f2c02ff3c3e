"""Pieces of wires joined to wires, the surest first; what a wire explains in any view is not used again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.parallax.wires.line_kernels import BLOCK
from alight.parallax.wires.residuals import LONG, PlaneView
from alight.parallax.wires.segments import FEWEST, LEAST, STILL, LineSums, Nearby, Pieces

SURE = 5.0  # score of the best piece of a wire
BESIDE = 0.35, 2.0  # metres, and cells, between a piece and the wire that it belongs to
ASTRAY = 0.16  # rad between them
GAP = 8.0  # metres along the wire between its pieces, or over which no view shows it
HIGHER = 1.0  # metres of height between a piece and its wire
ASIDE = 0.2  # metres by which a piece is unsure aside for each metre by which its height is
SLOPE = 0.06  # 1-sigma of the rise of a wire over its length
STEEPEST = 0.2  # rise of a wire over its length; steeper lines are posts and rims of crowns
COVERS = 4.0  # cells beside its image in a view that a wire explains


@dataclass(frozen=True, eq=False)
class Strand:
    """A wire as it grows: a straight line over the plane."""

    place: F64  # (2,) east, north
    along: F64  # (2,) unit vector
    height: float  # metres above the plane, at `place`
    slope: float  # rise over length
    low: float  # metres along, of both ends
    high: float
    members: Mask  # (K,) its pieces

    @classmethod
    def of(cls, s: Pieces, k: int) -> Strand:
        """Return a strand of one piece."""
        half = float(s.half[k])
        return cls(s.place[k], s.along[k], float(s.height[k]), 0.0, -half, half, np.arange(len(s.own)) == k)

    def _at(self, places: F64) -> tuple[F64, F64]:
        """Return the positions of (K, 2) places along and across the strand, metres."""
        away = places - self.place
        return away @ self.along, away @ self.across

    @property
    def across(self) -> F64:
        """Horizontal unit vector across, (2,)."""
        return np.array([-self.along[1], self.along[0]])

    def gathers(self, s: Pieces, cell: float) -> Mask:
        """Return the mask of the pieces (K,) that continue the strand."""
        a, b = self._at(s.place)
        vague = STILL * s.vague
        out = (np.abs(b) < BESIDE[0] + BESIDE[1] * cell + ASIDE * vague) & (np.abs(s.along @ self.across) < ASTRAY)
        out &= np.abs(s.height - self.height - self.slope * a) < HIGHER + vague
        return np.asarray(out & (a > self.low - GAP) & (a < self.high + GAP))

    def fitted(self, s: Pieces, members: Mask) -> Strand:
        """Return the strand through its pieces, weighted by their scores."""
        own = s.of(members)
        a, b = self._at(own.place)
        out = replace(self, low=float((a - own.half).min()), high=float((a + own.half).max()), members=members)
        if len(a) < 3 or np.ptp(a) < 2.0:
            return out
        lever = np.column_stack([np.ones_like(a), a])
        aside, turn = np.linalg.lstsq(lever * own.score[:, None], b * own.score, rcond=None)[0]
        sigma = own.vague * np.sqrt(len(a))  # pieces of one wire are not independent
        prior = np.append(0.0, 1 / SLOPE)
        height, slope = np.linalg.lstsq(
            np.vstack([lever / sigma[:, None], prior]), np.append(own.height / sigma, 0.0), rcond=None
        )[0]
        along = self.along + turn * self.across
        return replace(
            out, place=self.place + aside * self.across, along=along / np.linalg.norm(along), height=float(height),
            slope=float(slope),
        )  # fmt: skip

    def ends(self, beyond: float) -> F64:
        """Return both ends, (2, 3): east, north, height above the plane; continued by `beyond` metres."""
        at = np.array([self.low - beyond, self.high + beyond])
        return np.column_stack([self.place + at[:, None] * self.along, self.height + self.slope * at])

    def _sign(self, s: Pieces) -> float:
        """Return 1 if most pieces are brighter than the ground, else -1."""
        return float(np.sign(s.sign[self.members].sum()) or 1.0)

    def shown(self, s: Pieces, sums: LineSums) -> list[Nearby]:
        """Return what the views show along the strand, a piece apart, so that the noise is independent."""
        own, apart = _most_common(s.own[self.members]), 1.6 * float(np.median(s.half[self.members]))
        count = max(int((self.high - self.low) / apart), 1)
        at = 0.5 * (self.low + self.high) + apart * (np.arange(count) - 0.5 * (count - 1))
        places, heights = self.place + at[:, None] * self.along, np.asarray(self.height + self.slope * at)
        return sums.around(own, places, self.along, self._sign(s), heights)

    def evidence(self, s: Pieces, sums: LineSums) -> float:
        """Return the sum of the scores along the strand over the root of their number: noise of one score.

        One lucky piece of ground makes no wire.
        """
        scores = [n.score for n in self.shown(s, sums)]
        return float(np.sum(scores) / np.sqrt(len(scores)))

    def followed(self, s: Pieces, sums: LineSums) -> Strand:
        """Return the strand from end to end: to where no line is left, over what too few views show."""
        own, sign = _most_common(s.own[self.members]), self._sign(s)
        stride = BLOCK * sums.views[0].grid.cell
        middles = self._at(s.place[self.members])[0]
        ends = []
        for way, at in ((-1.0, float(middles.min())), (1.0, float(middles.max()))):
            height, unseen = self.height + self.slope * at, 0.0
            while True:
                place = self.place + (at + way * stride) * self.along
                (n,) = sums.around(own, place[None], self.along, sign, np.array([height]))
                if n.strength >= LEAST:
                    height, unseen = n.height, 0.0
                elif n.views >= FEWEST - 1 or unseen >= GAP:
                    break
                else:
                    unseen += stride
                at += way * stride
            ends.append(at)
        return replace(self, low=ends[0], high=ends[1])

    def explains(self, s: Pieces, views: Sequence[PlaneView]) -> Mask:
        """Return the mask of the pieces (K,) that lie on its image in their own views."""
        centres = np.array([v.above for v in views])[:, None]
        cells, ends = np.array([v.grid.cell for v in views])[s.own], self.ends(3.0)
        far = centres[..., 2:] / np.maximum(centres[..., 2:] - ends[:, 2:], 0.2)
        images = centres[..., :2] + (ends[:, :2] - centres[..., :2]) * far  # (V, 2, 2)
        begin, way = images[s.own, 0], (images[:, 1] - images[:, 0])[s.own]
        length = np.linalg.norm(way, axis=1)
        way = way / np.maximum(length, 1e-9)[:, None]
        away = s.shown - begin
        along, aside = (away * way).sum(axis=1), np.abs(away[:, 1] * way[:, 0] - away[:, 0] * way[:, 1])
        half = 0.5 * LONG * cells
        return np.asarray((aside < COVERS * cells) & (along > -half) & (along < length + half))


def _most_common(numbers: I64) -> int:
    return int(np.bincount(numbers).argmax())


def _support(s: Pieces, cell: float) -> F64:
    """Return the sum of the scores (K,) of all pieces that lie on the line of each: a wire is shown again and again."""
    place, along = s.place.astype(np.float32), s.along.astype(np.float32)
    away = place[None] - place[:, None]  # (K, K, 2)
    ahead = (away * along[:, None]).sum(axis=2)
    aside = away[..., 1] * along[:, None, 0] - away[..., 0] * along[:, None, 1]
    turned = along[:, None, 0] * along[None, :, 1] - along[:, None, 1] * along[None, :, 0]
    height = s.height.astype(np.float32)
    vague = (STILL * s.vague).astype(np.float32)
    near = (np.abs(aside) < BESIDE[0] + BESIDE[1] * cell + ASIDE * vague) & (np.abs(turned) < ASTRAY)
    near &= np.abs(ahead) < GAP
    near &= np.abs(height[None] - height[:, None]) < HIGHER + vague
    return np.asarray(near @ s.score)


def strands(s: Pieces, views: Sequence[PlaneView], most: int = 40) -> list[Strand]:
    """Return up to `most` strands, the one with the best supported piece first."""
    free, out = s.score >= LEAST, list[Strand]()
    cell = views[0].grid.cell if views else 0.0
    support = _support(s, cell)
    while len(out) < most and free.any():
        k = int(np.argmax(np.where(free & (s.score >= SURE), support, 0.0)))
        if not free[k] or s.score[k] < SURE:
            break
        one = Strand.of(s, k)
        for _ in s.own:
            members = free & one.gathers(s, cell)
            members[k] = True
            if np.array_equal(members, one.members):
                break
            one = one.fitted(s, members)
        out.append(one)
        free &= ~(one.members | one.explains(s, views))
    return out
