"""Patches: features are matched with their first appearance, so that errors do not accumulate (M1e)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Pose
from alight.settings import TracksSettings
from alight.tracks.patch_kernels import align_patches, warp_patches
from alight.tracks.view_transfer import Lens, median_depth

STEPS = 0.01, 12  # px, largest last step of an alignment; largest number of steps


def smooth_image(image: U8) -> U8:
    """Return the image, smoothed so that linear interpolation does not bias matches towards whole pixels (M1e)."""
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.7))


@dataclass(frozen=True, eq=False)
class FeaturePatches:
    """Grey-level patches of N features, by which they are found in later images."""

    ids: I64  # (N,) ascending
    grey: U8  # (M, S, T) patches, or whole images
    slots: I64  # (N,) index into `grey`
    places: F64  # (N, 2) column and row of the feature in its patch
    pixels: F64  # (N, 2) pixel in the image from which the patch was cut
    R: F64  # (N, 3, 3) pose of the camera of that image, world_from_cam
    t: F64  # (N, 3)

    @classmethod
    def none(cls, window: int) -> FeaturePatches:
        """Return an empty set of patches of `window` px, with 9 px around them for rotation and scale."""
        side, empty = window + 2 * 9, np.empty(0, np.int64)
        pixels, R, t = (np.empty((0, *shape)) for shape in ((2,), (3, 3), (3,)))
        return cls(empty, np.empty((0, side, side), np.uint8), empty, pixels, pixels, R, t)

    @classmethod
    def whole(cls, image: U8, ids: I64, pixels: F64, window: int) -> FeaturePatches:
        """Return patches for features of a smoothed image; all share the whole image, which is not copied.

        Features too close to the edge of the image get no patch. The frame of the camera is used as world.
        """
        margin, (height, width) = window // 2 + 2, image.shape
        inside = ((pixels >= margin) & (pixels <= [width - 1 - margin, height - 1 - margin])).all(axis=1)
        ids, pixels = ids[inside], pixels[inside]
        n = len(ids)
        return cls(
            ids, image[None], np.zeros(n, np.int64), pixels, pixels, np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        )

    def select(self, which: Mask | I64) -> FeaturePatches:
        """Return the patches of the features at the indices or mask `which`; the images are shared."""
        own = (f.name for f in fields(self) if f.name != "grey")
        return replace(self, **{name: getattr(self, name)[which] for name in own})

    def of(self, ids: I64) -> tuple[FeaturePatches, I64]:
        """Return the patches held for the features `ids` (ascending), and the (N,) index in `ids` of each patch."""
        at = np.searchsorted(ids, self.ids)
        present = np.append(ids, -1)[at] == self.ids
        return self.select(present), at[present]

    def with_new(self, image: U8, ids: I64, pixels: F64, pose: Pose) -> FeaturePatches:
        """Return these patches and new ones, cut from a smoothed image, for features that have none yet.

        Features too close to the edge of the image get no patch. `pose`: world_from_cam of the image.
        """
        side, new = self.grey.shape[1], ~np.isin(ids, self.ids)
        ids, pixels = ids[new], pixels[new]
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
            np.concatenate([self.R, np.tile(pose.rotation, (len(ids), 1, 1))])[order],
            np.concatenate([self.t, np.tile(pose.translation, (len(ids), 1))])[order],
        )

    def warps(self, own: Lens, pixels: F64, lens: Lens, pose: Pose, up: F64, depth: F64) -> F64:
        """Return the (N, 2, 2) derivative of the pixels of these patches with respect to the pixels of another view.

        The ground is assumed to be a level plane at the median depth of all features.

        Args:
            own: lens of the patches.
            pixels: (N, 2) pixels in the other view.
            lens: lens of the other view.
            pose: world_from_cam of the other view.
            up: (3,) unit vector upwards in the other camera.
            depth: (M,) depth of all features in the other camera, m, NaN = unknown.
        """
        own_from_world, out = self.R.transpose(0, 2, 1), np.empty((len(pixels), 2, 2))
        off = own_from_world @ (pose.translation - self.t)[..., None]
        # the loop is compiled once, not for each layout
        R, t, up = (np.array(v, order="C") for v in (own_from_world @ pose.rotation, off[..., 0], up))
        which, level = np.arange(len(pixels)), median_depth(depth, 1e6)
        warp_patches(pixels, lens.table, R, t, which, up, level, self.pixels, own.table, out)
        return out

    def locate(
        self, image: U8, start: F64, warp: F64, settings: TracksSettings, reach: F64 | None = None
    ) -> tuple[F64, Mask]:
        """Locate the patches in a smoothed image.

        Args:
            image: smoothed image.
            start: (N, 2) pixels where the search starts.
            warp: (N, 2, 2) derivative of pixels of the patch with respect to pixels of the image.
            settings: least correlation, and largest distance from the start.
            reach: (N,) largest distance from the start, px; None: that of the settings.

        Returns:
            (N, 2) pixels, the start where a patch was not found; (N,) mask of the patches found.
        """
        there, fit = np.array(start, dtype=np.float64), np.empty(len(start))
        window = settings.window_px | 1
        align_patches(self.grey, self.slots, self.places, warp, image, window, *STEPS, there, fit)
        shift = there - start
        far = (shift * shift).sum(axis=1) >= (settings.close_px if reach is None else reach) ** 2
        good = (fit > settings.patch_correlation) & ~far
        return np.where(good[:, None], there, start), good


def follow_patches(then: U8, now: U8, pixels: F64, start: F32, settings: TracksSettings) -> tuple[F64, Mask]:
    """Follow features from one smoothed image to the next by patches of both images, forward and backward.

    Args:
        pixels: (N, 2) pixels in the image `then`.
        start: (N, 2) pixels in the image `now` where the search starts.

    Returns:
        (N, 2) pixels in the image `now`; (N,) mask of the features found in both directions.
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
