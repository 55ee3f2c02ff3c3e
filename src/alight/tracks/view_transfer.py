"""Features carried from view to view: predicted pixels with covariance, and depths (M1, M1c, M1f)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, F64, I64, U8
from alight.geometry import Camera, Pose
from alight.settings import TracksSettings
from alight.tracks.epipolar import inverse_depth
from alight.tracks.global_alignment import downsampled, downsampling_factor, image_correlation
from alight.tracks.lens import Lens
from alight.tracks.patches import median_depth
from alight.tracks.search_region import pixel_covariance
from alight.tracks.transfer_kernels import carry_points

_SAME_PLACE = 1e-5  # m between two views, below which no depth shifts a feature


@dataclass(frozen=True, eq=False)
class PredictedPixels:
    """Predicted pixels of features, where the search starts."""

    pixels: F32  # (N, 2)
    depth: F64  # (N,) m in that view, NaN = unknown
    covariance: F64 | None = None  # (N, 2, 2) px^2 of the prediction; None: unknown

    def select(self, which: I64) -> PredictedPixels:
        """Return the predictions of some features."""
        covariance = None if self.covariance is None else self.covariance[which]
        return PredictedPixels(self.pixels[which], self.depth[which], covariance)


class ViewTransfer:
    """Carries features of the left camera to another time or another camera of the rig.

    Args:
        cameras, lenses: of the rig.
        cam_from_first: each camera from the left one.
        settings: sigmas of depths.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        lenses: Sequence[Lens],
        cam_from_first: Sequence[Pose],
        settings: TracksSettings,
    ) -> None:
        self._cameras, self._lenses, self._settings = cameras, lenses, settings
        baselines = [float(np.linalg.norm(p.translation)) * cameras[0].fu for p in cam_from_first[1:]]
        self._rig_baseline_px = max([b for b in baselines if b > 0], default=np.inf)  # m px: over the depth, disparity

    def predicted(
        self, pixels: F32, depth: F64, other_from_first: Pose, other: int, relative_covariance: F64 | None = None
    ) -> PredictedPixels:
        """Project pixels of the left camera at their depth (unknown: the median, else infinity) into another view.

        Args:
            pixels: (N, 2) in the left camera.
            depth: (N,) m, NaN = unknown.
            other_from_first: the other view from that of the pixels.
            other: index of its camera.
            relative_covariance: (6, 6) of the rotation and shift between the views; None: exact.
        """
        has_depth, s, n = np.isfinite(depth), self._settings, len(pixels)
        common = median_depth(depth, 1e6)
        z = np.where(has_depth, depth, common)
        moved, out = np.empty((n, 3)), np.empty((n, 2))
        flat = self._lenses[0].normalise(pixels.astype(np.float64))
        R, t, lens = other_from_first.rotation, other_from_first.translation, self._lenses[other]
        carry_points(flat, z, R, t, lens.pinhole, lens.model, lens.coefficients, moved, out)
        there = np.where(has_depth, moved[:, 2], np.nan)
        predicted = np.where(np.isfinite(out), out, pixels).astype(np.float32)
        if not has_depth.any():
            return PredictedPixels(predicted, there)
        parallax = np.minimum(self._rig_baseline_px / np.maximum(z, 1e-9), s.depth_parallax_px)
        relative_sigma = np.where(has_depth, s.depth_sigma_px / parallax, s.unknown_depth_share)
        by_depth = (moved - t) * relative_sigma[:, None]
        return PredictedPixels(
            predicted, there, pixel_covariance(moved, by_depth, self._cameras[other].fu, relative_covariance)
        )

    def common_depth(self, images: tuple[U8, U8], pixels: F32, depth: F64, now_from_then: Pose) -> F64:
        """Return one depth for all features when none is known: that of the best correlation of the images (M1c).

        A single camera needs it between photos, where features move by more than a search covers.
        """
        baseline, camera = float(np.linalg.norm(now_from_then.translation)), self._cameras[0]
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # shift, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / self._settings.depth_step))
        if baseline < _SAME_PLACE:
            return depth
        small, now = (downsampled(image) for image in images)
        scores = [
            image_correlation(
                small,
                now,
                pixels,
                self.predicted(pixels, tried, now_from_then, 0).pixels,
                downsampling_factor(images[1]),
                self._settings.least_overlap,
            )
            for tried in (np.full(len(pixels), baseline / s) for s in shifts)
        ]
        return np.full(len(pixels), baseline / shifts[int(np.argmax(scores))])

    def updated_depths(self, before: F32, pixels: F32, depth: F64, now_from_then: Pose) -> F64:
        """Return depths in the present view: by parallax where it suffices, else the old depths moved on."""
        camera = self._cameras[0]
        then, now = (self._lenses[0].normalise(p.astype(np.float64)) for p in (before, pixels))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * camera.fu > self._settings.depth_parallax_px, 1.0 / np.maximum(w, 1e-9), depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])
