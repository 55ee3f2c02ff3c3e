"""Features held to what they looked like: matches from picture to picture add up their errors, these do not (M1e)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.records import F64, U8
from alight.settings import TracksSettings
from alight.tracks.lens import Lens
from alight.tracks.patch_kernels import settle

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]

_MARGIN = 9  # px of a patch about the window: room to turn in
_BLUR = 0.7  # px; without, linear sampling follows the pixels and not the ground (M1e)
_STOP, _ROUNDS = 0.01, 12  # px; steps
_FAR = 1e6  # m, of features without any depth
_ARM = 4.0  # px over which a map is differenced
_ARMS = _ARM * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
_SHALLOW = 0.2  # of the way down: rays that come in flatter are taken across the view


def smooth_image(image: U8) -> U8:
    """Return the picture as patches are cut from it and looked for in it."""
    return np.asarray(cv2.GaussianBlur(image, (3, 3), _BLUR))


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """The plane under the features as a camera sees it: level, through their median depth."""

    up: F64  # (3,) in the camera
    depth: float  # m along the optical axis

    @classmethod
    def below(cls, pose: Pose | None, depth: F64) -> GroundPlane:
        """Under a camera at `pose` (world_from_cam; None: across the view); depths of features, NaN: unknown."""
        known = depth[np.isfinite(depth)]
        up = pose.rotation[2] if pose is not None else np.array([0.0, 0.0, -1.0])
        return cls(up, float(np.median(known)) if len(known) else _FAR)

    def depths(self, rays: F64) -> F64:
        """(...) of (..., 3) rays, z = 1."""
        down = rays @ self.up / min(float(self.up[2]), -1e-9)  # 1 along the optical axis
        steep = (down > _SHALLOW) & (self.up[2] < -_SHALLOW)
        return np.asarray(self.depth / np.where(steep, down, 1.0))


def _about(lens: Lens, pixels: F64) -> F64:
    """(N, 4, 2) ideal coordinates either side of (N, 2) pixels."""
    return lens.normalise((pixels[:, None] + _ARMS).reshape(-1, 2)).reshape(-1, 4, 2)


def _slopes(values: F64) -> F64:
    """(N, 2, 2) differences of what was taken either side."""
    return np.asarray((values[:, ::2] - values[:, 1::2]).transpose(0, 2, 1))


def view_warps(pixels: F64, lens: Lens, views: Sequence[Pose], ground: GroundPlane, there: F64, other: Lens) -> F64:
    """(N, 2, 2) px in other views by px here, for the ground about features.

    Args:
        pixels: (N, 2) here.
        views: other_from_here, one for each feature or one for all.
        there: (N, 2) pixels in the other views, through the lens `other`.
    """
    flat = _about(lens, pixels)
    rays = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=2)
    R, t = np.array([p.rotation for p in views]), np.array([p.translation for p in views])
    x = (rays * ground.depths(rays)[..., None]) @ R.transpose(0, 2, 1) + t[:, None]
    return np.asarray(np.linalg.solve(_slopes(_about(other, there)), _slopes(x[..., :2] / x[..., 2:])))


@dataclass(frozen=True, eq=False)
class FeaturePatches:
    """What N features looked like."""

    ids: Ids  # (N,) growing
    grey: U8  # (N, S, S)
    places: F64  # (N, 2) column and row in the patch
    pixels: F64  # (N, 2) in the picture that it was cut from
    picture: Ids  # (N,) which that was

    @classmethod
    def cut(cls, image: U8, ids: Ids, pixels: F64, window: int, picture: int = 0) -> FeaturePatches:
        """Cut patches out of a smooth picture; features too near its edge get none."""
        side = window + 2 * _MARGIN
        corner = np.rint(pixels).astype(np.int64) - side // 2
        inside = ((corner >= 0) & (corner + side <= image.shape[::-1])).all(axis=1)
        corner, pixels = corner[inside], pixels[inside]
        fits = min(image.shape) >= side
        grey = sliding_window_view(image, (side, side)) if fits else np.empty((1, 1, side, side), np.uint8)
        cuts = np.ascontiguousarray(grey[corner[:, 1], corner[:, 0]])
        return cls(ids[inside], cuts, pixels - corner, pixels, np.full(len(corner), picture))

    def rows(self, which: Mask) -> FeaturePatches:
        """Those of some features."""
        return FeaturePatches(*(getattr(self, f.name)[which] for f in fields(self)))

    def and_of(self, other: FeaturePatches) -> FeaturePatches:
        """Both, in the order of ids."""
        order = np.argsort(np.concatenate([self.ids, other.ids]))
        both = (np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self))
        return FeaturePatches(*(x[order] for x in both))

    def found(self, image: U8, guess: F64, turn: F64, settings: TracksSettings) -> tuple[F64, Mask]:
        """Where they are in a smooth picture, from (N, 2) guesses on, and which of them truly are."""
        there, fit, window = guess.copy(), np.empty(len(guess)), settings.window_px | 1
        lay, slopes = np.empty((window + 2, window + 2), np.float32), np.empty((2, window, window), np.float32)
        settle(self.grey, self.places, turn, image, _STOP, _ROUNDS, lay, slopes, there, fit)
        good = fit > settings.patch_correlation
        good &= np.linalg.norm(there - guess, axis=1) < settings.patch_moved_px
        return np.where(good[:, None], there, guess), good


class Anchors:
    """The patches of the features of one camera, and where it was when they were cut."""

    def __init__(self, lens: Lens, span: float, settings: TracksSettings) -> None:
        """Take the lens, and px that a feature may move before it takes a new patch."""
        self._lens, self._span, self._settings = lens, span, settings
        self._window = settings.window_px | 1
        self._poses: dict[int, Pose] = {}
        self._patches = self._none()

    def _none(self) -> FeaturePatches:
        return FeaturePatches.cut(np.zeros((1, 1), np.uint8), np.empty(0, np.int64), np.empty((0, 2)), self._window)

    def hold(self, image: U8, ids: Ids, pixels: F64, pose: Pose | None, depth: F64) -> F64:
        """Take features where the last picture led to, to where they look as they did; (N, 2) pixels.

        Args:
            image: smooth.
            ids: (N,) growing.
            pose: predicted world_from_cam; without it nothing is known of how patches turn, and nothing is done.
        """
        if pose is None:
            self._patches, self._poses = self._none(), {}
            return pixels
        held = self._patches.rows(np.isin(self._patches.ids, ids))
        at = np.searchsorted(ids, held.ids)
        if not len(at):
            return pixels
        then_from_now = {k: p.inverse @ pose for k, p in self._poses.items()}
        views = [then_from_now[k] for k in held.picture.tolist()]
        turn = view_warps(pixels[at], self._lens, views, GroundPlane.below(pose, depth), held.pixels, self._lens)
        there, good = held.found(image, pixels[at], turn, self._settings)
        good &= np.linalg.norm(there - held.pixels, axis=1) < self._span
        out = pixels.copy()
        out[at] = there
        self._patches = held.rows(good)
        return out

    def renew(self, image: U8, ids: Ids, pixels: F64, pose: Pose | None) -> None:
        """Cut patches of the features that have none."""
        if pose is None:
            return
        new, picture = ~np.isin(ids, self._patches.ids), max(self._poses, default=-1) + 1
        self._patches = self._patches.and_of(FeaturePatches.cut(image, ids[new], pixels[new], self._window, picture))
        self._poses = {k: p for k, p in self._poses.items() if (self._patches.picture == k).any()} | {picture: pose}
