"""Anchor patches: features are matched with their first appearance, so that errors do not accumulate (M1e)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Pose
from alight.settings import TracksSettings
from alight.tracks.patch_kernels import align_patches, warp_patches
from alight.tracks.view_transfer import Lens, median_depth

STEPS = 0.01, 12  # largest last step of an alignment, px; most steps


def smooth_image(image: U8) -> U8:
    """Return the smoothed image from which patches are cut and in which they are located.

    Without it linear interpolation biases matches towards whole pixels (M1e).
    """
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.7))


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """The ground under the features in a camera: a level plane through their median depth."""

    up: F64  # (3,) unit, in the camera frame
    depth: float  # m along the optical axis

    @classmethod
    def under(cls, pose: Pose | None, depth: F64) -> GroundPlane:
        """Return the ground under a camera at `pose` (world_from_cam; None: across the view); NaN depth = unknown."""
        up = pose.rotation[2] if pose is not None else np.array([0.0, 0.0, -1.0])
        return cls(up, median_depth(depth, 1e6))


def patch_warps(
    pixels: F64, lens: Lens, views: tuple[F64, F64], which: I64, ground: GroundPlane, there: F64, other: Lens
) -> F64:
    """Return the (N, 2, 2) derivative of pixels in other views by pixels here, for the ground around features.

    Args:
        pixels: (N, 2) here.
        lens: of this view.
        views: (V, 3, 3), (V, 3) rotation and translation, other_from_here.
        which: (N,) of them, for each feature.
        ground: seen from here.
        there: (N, 2) pixels in the other views.
        other: lens of the other views.
    """
    out = np.empty((len(pixels), 2, 2))
    R, t, up = (np.array(v, order="C") for v in (*views, ground.up))  # the loop is compiled once, not for each layout
    warp_patches(pixels, lens.table, R, t, which, up, ground.depth, there, other.table, out)
    return out


@dataclass(frozen=True, eq=False)
class FeaturePatches:
    """Appearance of N features."""

    ids: I64  # (N,) ascending
    grey: U8  # (M, S, T) patches, or whole images
    slots: I64  # (N,) which of them
    places: F64  # (N, 2) column and row in it
    pixels: F64  # (N, 2) in the image from which it was cut
    image_number: I64  # (N,) number of that image

    @classmethod
    def none(cls, window: int) -> FeaturePatches:
        """Return no patches, for a window of that many px; nine px around it are room for rotation and scale."""
        side, empty = window + 2 * 9, np.empty(0, np.int64)
        return cls(empty, np.empty((0, side, side), np.uint8), empty, np.empty((0, 2)), np.empty((0, 2)), empty)

    @classmethod
    def whole(cls, image: U8, ids: I64, pixels: F64, window: int) -> FeaturePatches:
        """Take a whole smoothed image as the patch of its features: nothing is copied.

        Features too close to its edge have none.
        """
        margin, (height, width) = window // 2 + 2, image.shape
        inside = ((pixels >= margin) & (pixels <= [width - 1 - margin, height - 1 - margin])).all(axis=1)
        ids, pixels = ids[inside], pixels[inside]
        zero = np.zeros(len(ids), np.int64)
        return cls(ids, image[None], zero, pixels, pixels, zero)

    def select(self, which: Mask | I64) -> FeaturePatches:
        """Return the patches of some features; their pixels are shared."""
        return replace(
            self, ids=self.ids[which], slots=self.slots[which], places=self.places[which], pixels=self.pixels[which],
            image_number=self.image_number[which],
        )  # fmt: skip

    def with_new(self, image: U8, ids: I64, pixels: F64, image_number: int) -> FeaturePatches:
        """Return these patches and new ones, cut out of a smoothed image; features too close to its edge get none."""
        side = self.grey.shape[1]
        corner = np.rint(pixels).astype(np.int64) - side // 2
        inside = ((corner >= 0) & (corner + side <= image.shape[::-1])).all(axis=1)
        if not inside.any():
            return self
        ids, corner, pixels = ids[inside], corner[inside], pixels[inside]
        joined = np.concatenate([self.ids, ids])
        order = np.argsort(joined)
        cut = sliding_window_view(image, (side, side))[corner[:, 1], corner[:, 0]]
        return FeaturePatches(
            joined[order],
            np.concatenate([self.grey[self.slots], cut]),
            order,
            np.concatenate([self.places, pixels - corner])[order],
            np.concatenate([self.pixels, pixels])[order],
            np.concatenate([self.image_number, np.full(len(ids), image_number)])[order],
        )

    def locate(
        self, image: U8, start: F64, warp: F64, settings: TracksSettings, reach: F64 | None = None
    ) -> tuple[F64, Mask]:
        """Locate patches in a smoothed image.

        Args:
            image: smoothed.
            start: (N, 2) pixels.
            warp: (N, 2, 2) derivative of pixels of the patch by pixels of the image.
            settings: least correlation, and the largest distance from the start.
            reach: (N,) px, another largest distance.

        Returns:
            (N, 2) pixels, the start where a patch was not found; (N,) which were found.
        """
        there, fit = np.array(start, dtype=np.float64), np.empty(len(start))
        window = settings.window_px | 1
        align_patches(self.grey, self.slots, self.places, warp, image, window, *STEPS, there, fit)
        shift = there - start
        far = (shift * shift).sum(axis=1) >= (settings.patch_moved_px if reach is None else reach) ** 2
        good = (fit > settings.patch_correlation) & ~far
        return np.where(good[:, None], there, start), good


def follow_patches(then: U8, now: U8, pixels: F64, start: F32, settings: TracksSettings) -> tuple[F64, Mask]:
    """Follow features from one smoothed image to the next one by patches of these two, forward and backward.

    Args:
        pixels: (N, 2) in the earlier image.
        start: (N, 2) in the later one, where the search begins.

    Returns:
        (N, 2) pixels in the later image; (N,) which were found, and found back.
    """
    zero, upright, fit = np.zeros(len(pixels), np.int64), np.tile(np.eye(2), (len(pixels), 1, 1)), np.empty(len(pixels))
    numbers = settings.window_px | 1, *STEPS
    found, back, fit_back = start.astype(np.float64), pixels.copy(), np.empty(len(pixels))
    align_patches(then[None], zero, pixels, upright, now, *numbers, found, fit)
    align_patches(now[None], zero, found, upright, then, *numbers, back, fit_back)
    off = back - pixels
    good = (np.minimum(fit, fit_back) > settings.patch_correlation) & (
        (off * off).sum(axis=1) < settings.forward_backward_px**2
    )
    return found, good


class AnchorPatches:
    """Patches of the features of one camera, with the camera poses at which they were cut."""

    def __init__(self, lens: Lens, settings: TracksSettings) -> None:
        self._lens, self._settings = lens, settings
        self._span = settings.patch_span * lens.camera.width  # px that a feature may move before it needs a new patch
        self._window = settings.window_px | 1
        self.clear()

    def clear(self) -> None:
        """Drop all patches: their warps are not known any more."""
        self._numbers, self._next = np.empty(0, np.int64), 0
        self._R, self._t = np.empty((0, 3, 3)), np.empty((0, 3))  # world_from_cam of each of these images
        self._patches = FeaturePatches.none(self._window)

    def locate(self, image: U8, ids: I64, pixels: F64, pose: Pose, depth: F64) -> tuple[F64, Mask]:
        """Locate the anchor patches of features near given pixels.

        Args:
            image: smoothed.
            ids: (N,) ascending.
            pixels: (N, 2) where the search begins.
            pose: predicted world_from_cam.
            depth: (N,) m, NaN = unknown.

        Returns:
            (N, 2) pixels, as given where there is no patch or it does not fit; (N,) which fit.
        """
        held, at = self._held_of(ids)
        out, found = np.array(pixels, dtype=np.float64), np.zeros(len(ids), bool)
        if not len(at):
            return out, found
        then_from_world = self._R.transpose(0, 2, 1)
        off = then_from_world @ (pose.translation - self._t)[..., None]
        views, which = (then_from_world @ pose.rotation, off[..., 0]), np.searchsorted(self._numbers, held.image_number)
        ground = GroundPlane.under(pose, depth)
        warp = patch_warps(out[at], self._lens, views, which, ground, held.pixels, self._lens)
        out[at], found[at] = held.locate(image, out[at], warp, self._settings)
        return out, found

    def retain(self, ids: I64, pixels: F64) -> None:
        """Keep the patches of features that are still served by them; the others get new ones.

        Args:
            ids: (N,) ascending.
            pixels: (N, 2) where they are now.
        """
        held, at = self._held_of(ids)
        moved = pixels[at] - held.pixels
        self._patches = held.select((moved * moved).sum(axis=1) < self._span**2)

    def _held_of(self, ids: I64) -> tuple[FeaturePatches, I64]:
        """Return the patches held of given features, and (N,) where these are in `ids`."""
        at = np.searchsorted(ids, self._patches.ids)
        present = np.append(ids, -1)[at] == self._patches.ids
        return self._patches.select(present), at[present]

    def add_missing(self, image: U8, ids: I64, pixels: F64, pose: Pose) -> None:
        """Cut patches of the features that have none yet."""
        has = np.zeros(len(ids), bool)
        has[np.searchsorted(ids, self._patches.ids)] = True
        used = np.searchsorted(self._numbers, np.unique(self._patches.image_number))
        self._patches = self._patches.with_new(image, ids[~has], pixels[~has], self._next)
        self._numbers = np.append(self._numbers[used], self._next)
        self._R = np.concatenate([self._R[used], pose.rotation[None]])
        self._t = np.concatenate([self._t[used], pose.translation[None]])
        self._next += 1
