"""Anchor patches: features are matched with their first appearance, so that errors do not accumulate (M1e)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from alight.arrays import F64, I64, U8, Mask
from alight.geometry import Pose
from alight.settings import TracksSettings
from alight.tracks.lens import Lens
from alight.tracks.patch_kernels import align_patches

_PATCH_MARGIN = 9  # px of a patch around the window: room for rotation and scale
_BLUR = 0.7  # px; without it linear interpolation biases matches towards whole pixels (M1e)
_MAX_LAST_STEP, _MAX_STEPS = 0.01, 12  # px; steps
_NO_DEPTH = 1e6  # m, depth of the ground where no feature has one
_DIFFERENCE = 4.0  # px over which the map between two views is differenced
_DIFFERENCES = _DIFFERENCE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
_MIN_DESCENT = 0.2  # cosine; shallower rays meet a plane across the view instead


def smooth_image(image: U8) -> U8:
    """Return the smoothed image from which patches are cut and in which they are located."""
    return np.asarray(cv2.GaussianBlur(image, (3, 3), _BLUR))


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """The ground under the features in a camera: a level plane through their median depth."""

    up: F64  # (3,) unit, in the camera frame
    depth: float  # m along the optical axis

    @classmethod
    def under(cls, pose: Pose | None, depth: F64) -> GroundPlane:
        """Return the ground under a camera at `pose` (world_from_cam; None: across the view); NaN depth = unknown."""
        known = depth[np.isfinite(depth)]
        up = pose.rotation[2] if pose is not None else np.array([0.0, 0.0, -1.0])
        return cls(up, float(np.median(known)) if len(known) else _NO_DEPTH)

    def depths(self, rays: F64) -> F64:
        """(...) depths in m where (..., 3) rays with z = 1 meet the plane."""
        down = rays @ self.up / min(float(self.up[2]), -1e-9)  # 1 along the optical axis
        steep = (down > _MIN_DESCENT) & (self.up[2] < -_MIN_DESCENT)
        return np.asarray(self.depth / np.where(steep, down, 1.0))


def _neighbour_rays(lens: Lens, pixels: F64) -> F64:
    """(N, 4, 2) normalised coordinates on both sides of (N, 2) pixels, along x and y."""
    return lens.normalise((pixels[:, None] + _DIFFERENCES).reshape(-1, 2)).reshape(-1, 4, 2)


def _differences(values: F64) -> F64:
    """(N, 2, 2) central differences of (N, 4, 2) values."""
    return np.asarray((values[:, ::2] - values[:, 1::2]).transpose(0, 2, 1))


def patch_warps(pixels: F64, lens: Lens, views: Sequence[Pose], ground: GroundPlane, there: F64, other: Lens) -> F64:
    """Return the (N, 2, 2) derivative of pixels in other views by pixels here, for the ground around features.

    Args:
        pixels: (N, 2) here.
        lens: of this view.
        views: other_from_here, one for each feature or one for all.
        ground: seen from here.
        there: (N, 2) pixels in the other views.
        other: lens of the other views.
    """
    flat = _neighbour_rays(lens, pixels)
    rays = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=2)
    R, t = np.array([p.rotation for p in views]), np.array([p.translation for p in views])
    x = (rays * ground.depths(rays)[..., None]) @ R.transpose(0, 2, 1) + t[:, None]
    return np.asarray(
        np.linalg.solve(_differences(_neighbour_rays(other, there)), _differences(x[..., :2] / x[..., 2:]))
    )


@dataclass(frozen=True, eq=False)
class FeaturePatches:
    """Appearance of N features."""

    ids: I64  # (N,) ascending
    grey: U8  # (N, S, S)
    places: F64  # (N, 2) column and row in the patch
    pixels: F64  # (N, 2) in the image from which it was cut
    image_number: I64  # (N,) number of that image

    @classmethod
    def cut(cls, image: U8, ids: I64, pixels: F64, window: int, image_number: int = 0) -> FeaturePatches:
        """Cut patches out of a smoothed image; features too close to its edge get none."""
        side = window + 2 * _PATCH_MARGIN
        corner = np.rint(pixels).astype(np.int64) - side // 2
        inside = ((corner >= 0) & (corner + side <= image.shape[::-1])).all(axis=1)
        corner, pixels = corner[inside], pixels[inside]
        fits = min(image.shape) >= side
        grey = sliding_window_view(image, (side, side)) if fits else np.empty((1, 1, side, side), np.uint8)
        cuts = np.ascontiguousarray(grey[corner[:, 1], corner[:, 0]])
        return cls(ids[inside], cuts, pixels - corner, pixels, np.full(len(corner), image_number))

    def select(self, which: Mask) -> FeaturePatches:
        """Return the patches of some features."""
        return FeaturePatches(*(getattr(self, f.name)[which] for f in fields(self)))

    def merged(self, other: FeaturePatches) -> FeaturePatches:
        """Return the patches of both, in the order of ids."""
        order = np.argsort(np.concatenate([self.ids, other.ids]))
        both = (np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self))
        return FeaturePatches(*(x[order] for x in both))

    def locate(self, image: U8, predicted: F64, warp: F64, settings: TracksSettings) -> tuple[F64, Mask]:
        """Locate patches in a smoothed image from (N, 2) predicted pixels on; (N, 2) pixels, and which were found."""
        there, fit, window = predicted.copy(), np.empty(len(predicted)), settings.window_px | 1
        lay, slopes = np.empty((window + 2, window + 2), np.float32), np.empty((2, window, window), np.float32)
        align_patches(self.grey, self.places, warp, image, _MAX_LAST_STEP, _MAX_STEPS, lay, slopes, there, fit)
        good = fit > settings.patch_correlation
        good &= np.linalg.norm(there - predicted, axis=1) < settings.patch_moved_px
        return np.where(good[:, None], there, predicted), good


class AnchorPatches:
    """Patches of the features of one camera, with the camera poses at which they were cut."""

    def __init__(self, lens: Lens, span: float, settings: TracksSettings) -> None:
        """Take the lens, and the px that a feature may move before it needs a new patch."""
        self._lens, self._span, self._settings = lens, span, settings
        self._window = settings.window_px | 1
        self._poses: dict[int, Pose] = {}
        self._patches = self._none()

    def _none(self) -> FeaturePatches:
        return FeaturePatches.cut(np.zeros((1, 1), np.uint8), np.empty(0, np.int64), np.empty((0, 2)), self._window)

    def refine(self, image: U8, ids: I64, pixels: F64, pose: Pose | None, depth: F64) -> F64:
        """Refine tracked pixels by the anchor patches of their features; (N, 2) pixels.

        Args:
            image: smoothed.
            ids: (N,) ascending.
            pixels: (N, 2) from tracking in time.
            pose: predicted world_from_cam; without it the warp of patches is unknown and pixels are returned as given.
            depth: (N,) m, NaN = unknown.
        """
        if pose is None:
            self._patches, self._poses = self._none(), {}
            return pixels
        held = self._patches.select(np.isin(self._patches.ids, ids))
        at = np.searchsorted(ids, held.ids)
        if not len(at):
            return pixels
        then_from_now = {k: p.inverse @ pose for k, p in self._poses.items()}
        views = [then_from_now[k] for k in held.image_number.tolist()]
        warp = patch_warps(pixels[at], self._lens, views, GroundPlane.under(pose, depth), held.pixels, self._lens)
        there, good = held.locate(image, pixels[at], warp, self._settings)
        good &= np.linalg.norm(there - held.pixels, axis=1) < self._span
        out = pixels.copy()
        out[at] = there
        self._patches = held.select(good)
        return out

    def add_missing(self, image: U8, ids: I64, pixels: F64, pose: Pose | None) -> None:
        """Cut patches of the features that have none yet."""
        if pose is None:
            return
        new, image_number = ~np.isin(ids, self._patches.ids), max(self._poses, default=-1) + 1
        self._patches = self._patches.merged(
            FeaturePatches.cut(image, ids[new], pixels[new], self._window, image_number)
        )
        self._poses = {k: p for k, p in self._poses.items() if (self._patches.image_number == k).any()} | {
            image_number: pose
        }
