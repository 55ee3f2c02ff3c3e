"""People and cars that move: differences between levelled pictures that no height explains.

A levelled picture is what a camera that looks straight down from the same place would see. Between two of them, level
ground moves by a scale and a shift, and what stands above it by more, depending on its height alone. So each pixel of
the newest picture is compared with two earlier pictures over planes of all heights. What no height explains has moved
(docs/method/third-parties.md, G23).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64, U8, U16
from alight.raster import grey_levels
from alight.records import MovingBody, View

SIDE = 360  # pixels of a levelled picture, a multiple of 8
WIDE = 0.75  # tangent of half its field of view, or less (`LevelPicture.of`)
FINE = 0.06  # metres on the ground, of pixels that show a person
APART_NS = 150_000_000  # least time between two pictures that are compared
LASTS_NS = 600_000_000  # time for which a trail is kept without a new patch
STEPS, UNSEEN = 128, 65535  # steps of a grey level; where a picture shows nothing
WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
PLANES, STEP_PX = 24, 2.0  # most planes of a comparison; pixels between two of them
TALL = 0.6  # share of the camera's height up to which things may stand
LIGHT = 0.1  # largest change of the log brightness between two pictures that a cloud's shadow makes
DIFFERENT = (1.5, 2.5)  # mean over 5 x 5 pixels, in usual differences, on quiet ground and where all is restless
FASTEST = 12.0  # m/s, of a person or car
ENOUGH = 90  # pixels of all patches of a trail of three; five times as many of one of two, ten times of a single one
FOOT = 0.03  # m^2, of the smallest patch that counts from low down


@dataclass(frozen=True, eq=False)
class LevelPicture:
    """A picture on a level plane at unit depth: columns to the east, rows to the south, the nadir in the middle."""

    view: View
    depth: float  # metres from the camera down to the ground
    focal: float  # pixels

    @classmethod
    def of(cls, view: View, ground: float) -> LevelPicture:
        """Return the levelled picture of a view; `ground`: ground height, metres. No finer than the view."""
        depth = float(view.centre[2]) - ground
        return cls(view, depth, min(view.camera.fu, max(0.5 * (SIDE - 1) / WIDE, depth / FINE)))

    @cached_property
    def grey(self) -> F32:
        """(SIDE, SIDE) grey levels, NaN outside the view."""
        camera, knots = self.view.camera, np.linspace(-0.5, 0.5, 26) * (SIDE - 1) / self.focal
        x, y = np.meshgrid(knots, -knots)
        rays = np.stack([x, y, np.full_like(x, -1.0)], -1) @ self.view.world_from_cam.rotation
        at = np.nan_to_num(camera.project(rays), nan=-1e4).astype(np.float32)
        pixels = cv2.remap(at, *_between(len(knots)), cv2.INTER_LINEAR)
        image, finer = grey_levels(self.view.image), camera.fu / self.focal
        if finer > 1:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 * finer), np.uint8)
        grey = cv2.remap(image.astype(np.float32), pixels, None, cv2.INTER_LINEAR, borderValue=np.nan)
        return np.asarray(grey, np.float32)

    @cached_property
    def bytes(self) -> U8:
        """(SIDE, SIDE) grey levels, 0 outside the view."""
        return _bytes(self.grey)

    @cached_property
    def corners(self) -> F32:
        """(N, 1, 2) pixels (column, row) of corners that can be followed into another picture."""
        points = cv2.goodFeaturesToTrack(self.bytes, 300, 0.005, 8, mask=_inner(self.grey))
        return np.empty((0, 1, 2), np.float32) if points is None else np.asarray(points, np.float32)

    @cached_property
    def levels(self) -> U16:
        """(SIDE, SIDE) grey levels in steps of 1 / STEPS, UNSEEN outside the view."""
        return np.where(np.isfinite(self.grey), self.grey * STEPS, UNSEEN).astype(np.uint16)

    def transfer(self, then: LevelPicture, up: float) -> F64:
        """Return the (2, 3) affine map from pixels of this picture to those of `then`, of a plane `up` metres high."""
        now, before, middle = self.view.centre, then.view.centre, 0.5 * (SIDE - 1)
        scale = (now[2] - up) / (before[2] - up) * then.focal / self.focal
        east, north = (now[:2] - before[:2]) / (before[2] - up) * then.focal
        rest = middle * (1 - scale)
        return np.array([[scale, 0.0, rest + east], [0.0, scale, rest - north]])

    def warped(self, transfer: F64) -> F32:
        """Return the grey levels in the pixels of another picture; `transfer`: (2, 3), from those to its own."""
        return np.asarray(cv2.warpAffine(self.grey, transfer, (SIDE, SIDE), flags=WARP, borderValue=np.nan))

    def excess(self, levels: U16, transfer: F64) -> U16:
        """Return how far `levels` of another picture lie beyond all levels of this one within a pixel."""
        shown = cv2.warpAffine(self.levels, transfer, (SIDE, SIDE), flags=WARP, borderValue=UNSEEN)
        high, low = cv2.dilate(shown, np.ones((3, 3), np.uint8)), cv2.erode(shown, np.ones((3, 3), np.uint8))
        return np.asarray(cv2.max(cv2.subtract(levels, high), cv2.subtract(low, levels)), np.uint16)


@cache
def _between(knots: int) -> tuple[F32, F32]:
    along = np.linspace(0, knots - 1, SIDE, dtype=np.float32)
    x, y = np.meshgrid(along, along)
    return x, y


def planes_between(now: LevelPicture, then: LevelPicture) -> F64 | None:
    """Return the heights of planes to compare, (N,) metres, the ground first; None: the pictures are too far apart."""
    ground = float(now.view.centre[2]) - now.depth
    corners = np.array([[x, y, 1.0] for x in (0, SIDE - 1) for y in (0, SIDE - 1)])
    apart = now.transfer(then, ground + TALL * now.depth) - now.transfer(then, ground)
    count = math.ceil(np.abs(corners @ apart.T).max() / STEP_PX)
    if count > PLANES or not TALL * now.depth < then.depth:
        return None
    nearer = TALL / (1 - TALL) * np.arange(count + 1) / max(count, 1)  # even steps in pixels
    return np.asarray(ground + now.depth * nearer / (1 + nearer))


class Unexplained(NamedTuple):
    """Differences of a picture from earlier ones that no height explains."""

    excess: F32  # (SIDE, SIDE) grey levels beyond all levels within a pixel; 0 where not seen by all pictures
    usual: float  # grey levels, median difference of level ground


def unexplained(now: LevelPicture, earlier: Sequence[LevelPicture]) -> Unexplained | None:
    """Compare a picture with earlier ones at all heights; None: they are too far apart."""
    least, seen, usual = np.full((SIDE, SIDE), np.inf, np.float32), np.isfinite(now.grey), 2.0
    for then in earlier:
        if (planes := planes_between(now, then)) is None:
            return None
        ground = now.transfer(then, planes[0])
        correction = np.vstack([registration(now, then.warped(ground)), [0.0, 0.0, 1.0]])
        shown = then.warped(ground @ correction)
        seen &= np.isfinite(shown)
        light = _light(now, shown)
        off = np.abs(now.grey - light * shown)[::4, ::4]  # a sixteenth has the same median
        usual = float(np.nanmax([usual, np.nanmedian(off)])) if np.isfinite(off).any() else usual
        levels = np.nan_to_num(now.grey / light * STEPS).clip(0, UNSEEN).astype(np.uint16)
        own = np.full_like(levels, UNSEEN)
        for up in planes:
            own = cv2.min(own, then.excess(levels, now.transfer(then, up) @ correction))
        least = np.minimum(least, own * light / STEPS)
    return Unexplained(np.where(seen, least, np.float32(0)), usual)


def registration(now: LevelPicture, before: F32) -> F64:
    """Return the (2, 3) affine map from pixels of a picture to those of the same ground in another, (SIDE, SIDE).

    It corrects the errors of both poses and the slope of the ground; without features it changes nothing.
    """
    unchanged = np.eye(2, 3)
    at = now.corners[:, 0].astype(int)
    points = now.corners[_inner(before)[at[:, 1], at[:, 0]] > 0]
    if len(points) < 12:  # twice the numbers of an affine map
        return unchanged
    moved, ok, _ = cv2.calcOpticalFlowPyrLK(
        now.bytes, _bytes(before), points, np.empty(0), winSize=(13, 13), maxLevel=2
    )
    good = ok.ravel() == 1
    if good.sum() < 12:
        return unchanged
    found, _ = cv2.estimateAffine2D(points[good], moved[good], ransacReprojThreshold=1.0)
    return unchanged if found is None else np.asarray(found, np.float64)


def _bytes(grey: F32) -> U8:
    return np.asarray(np.nan_to_num(grey).clip(0, 255).astype(np.uint8))


def _inner(grey: F32) -> U8:
    """Return where a picture is known for 4 pixels around, (SIDE, SIDE) 0 or 1."""
    return np.asarray(cv2.erode(np.isfinite(grey).astype(np.uint8), np.ones((9, 9), np.uint8)), np.uint8)


def _light(now: LevelPicture, shown: F32) -> F32:
    """Return the factor of the light between two pictures, (SIDE, SIDE), smooth over a few metres: clouds drift."""
    known, small = np.isfinite(now.grey) & np.isfinite(shown), (SIDE // 8, SIDE // 8)
    one, two, share = (
        cv2.resize(np.where(known, p, np.float32(0)), small, interpolation=cv2.INTER_AREA)
        for p in (now.grey, shown, np.float32(1))
    )
    whole, factor = share > 0.5, np.log((one + 1) / (two + 1))
    common = float(np.median(factor[whole])) if whole.any() else 0.0
    apart = np.where(whole, np.clip(factor - common, -LIGHT, LIGHT), 0.0).astype(np.float32)
    width = 2.5 * now.focal / now.depth / 8  # 2.5 m
    apart, share = (cv2.GaussianBlur(p, (0, 0), width) for p in (apart, whole.astype(np.float32)))
    return np.asarray(cv2.resize(np.exp(common + apart / np.maximum(share, 0.1)), (SIDE, SIDE)), np.float32)


class _Patch(NamedTuple):
    """Connected pixels that no height explains."""

    place: F64  # (2,) metres
    pixels: int
    reach: float  # metres


@dataclass(frozen=True, eq=False)
class _Trail:
    """Patches of successive exposures that follow each other."""

    t_ns: int
    newest: _Patch
    start: F64  # (2,) metres
    velocity: F64 | None = None  # (2,) m/s; None: a single patch
    pixels: int = 0  # of all patches
    count: int = 1  # number of patches

    @property
    def moves(self) -> bool:
        """Whether it is a person or car: it goes on, or is larger than what ground that sways or glitters shows."""
        away = math.dist(self.newest.place, self.start)
        enough = ENOUGH if self.count > 2 else 5 * ENOUGH
        return self.newest.pixels >= 10 * ENOUGH or (self.pixels >= enough and away > self.newest.reach / 2)

    def distance(self, patch: _Patch, t_ns: int) -> float:
        """Return the distance of a patch at `t_ns` from where this trail leads, metres; inf: it is too far away."""
        seconds = (t_ns - self.t_ns) * 1e-9
        way, within = (0.0, FASTEST) if self.velocity is None else (self.velocity * seconds, FASTEST / 8)
        away = float(np.linalg.norm(patch.place - self.newest.place - way))
        return away if away < within * seconds + max(patch.reach, self.newest.reach) else math.inf

    def followed_by(self, patch: _Patch, t_ns: int) -> _Trail:
        """Return the trail with one more patch."""
        velocity = (patch.place - self.newest.place) / ((t_ns - self.t_ns) * 1e-9)
        if self.velocity is not None:
            velocity = 0.5 * (velocity + self.velocity)
        return _Trail(t_ns, patch, self.start, velocity, self.pixels + patch.pixels, self.count + 1)


class MovingWatch:
    """Finds who moves, in each exposure of a camera that looks down."""

    def __init__(self) -> None:
        self._shown = list[LevelPicture]()  # the last three that were compared
        self._movers: tuple[MovingBody, ...] = ()
        self._trails: list[_Trail] = []
        self._usual = math.inf  # grey levels, usual difference; it grows slowly, as somebody may fill a picture

    def feed(self, view: View, ground: float) -> tuple[MovingBody, ...]:
        """Add the newest view; return the people and cars that move. `ground`: ground height, metres.

        A view that follows the one before within `APART_NS` is not compared: the movers stay.
        """
        if self._shown and 0 <= view.t_ns - self._shown[-1].view.t_ns < APART_NS:
            return self._movers
        now = LevelPicture.of(view, ground)
        lasting = [p for p in self._shown if 0 < view.t_ns - p.view.t_ns < LASTS_NS and p.depth > 0]
        self._shown, self._movers = [*lasting, now][-3:], ()
        found = unexplained(now, self._shown[-2::-1]) if len(self._shown) == 3 and now.depth > 0 else None
        if found is None:
            self._trails = []
            return ()
        self._usual = min(found.usual, 1.2 * self._usual)
        self._follow(_patches(now, found.excess / np.float32(self._usual)), view.t_ns)
        self._movers = tuple(
            MovingBody(t.newest.place, np.zeros(2) if t.velocity is None else t.velocity, t.newest.reach)
            for t in self._trails
            if t.t_ns == view.t_ns and t.moves
        )
        return self._movers

    def _follow(self, patches: Sequence[_Patch], t_ns: int) -> None:
        """Join each patch to the trail that leads to it, or let it begin a trail."""
        before, self._trails = [t for t in self._trails if t_ns - t.t_ns <= LASTS_NS], []
        for patch in patches:
            nearest = min(before, key=lambda t: t.distance(patch, t_ns), default=None)
            if nearest is None or math.isinf(nearest.distance(patch, t_ns)):
                self._trails.append(_Trail(t_ns, patch, patch.place, None, patch.pixels))
            else:
                before.remove(nearest)
                self._trails.append(nearest.followed_by(patch, t_ns))
        self._trails += before


def _patches(now: LevelPicture, differences: F32) -> list[_Patch]:
    """Return the largest patches of pixels that differ, the largest first."""
    near = cv2.blur(np.minimum(differences, 8.0), (5, 5))
    around = cv2.blur(near, (SIDE // 6 | 1, SIDE // 6 | 1))  # plants that sway, edges of shadows
    differs = (near > np.minimum(DIFFERENT[0] + 4 * around, DIFFERENT[1])).astype(np.uint8)
    _, _, stats, middles = cv2.connectedComponentsWithStats(differs, connectivity=8)
    sizes, cell, out = stats[1:, cv2.CC_STAT_AREA], now.depth / now.focal, list[_Patch]()
    for k in np.argsort(-sizes, kind="stable")[:16]:
        east, south = cell * (middles[1 + k] - 0.5 * (SIDE - 1))
        if sizes[k] >= max(ENOUGH / 12, FOOT / cell**2):
            place = now.view.centre[:2] + np.array([east, -south])
            out.append(_Patch(place, int(sizes[k]), 0.5 * math.sqrt(sizes[k]) * cell))
    return out
