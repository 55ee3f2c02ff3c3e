"""Transfer of features between views: rays, predicted pixels with covariance, and depths (M1, M1c, M1f, M2, M3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Camera, Pose, skew
from alight.settings import TracksSettings
from alight.tracks.corner_kernels import interpolate_rays
from alight.tracks.global_alignment import downsampled, downsampling_factor, image_correlation
from alight.tracks.transfer_kernels import carry_points, line_distances, pixel_covariances, triangulate_matches


class Lens:
    """Lens of a camera; the normalised coordinates of pixels are interpolated in a table."""

    def __init__(self, camera: Camera) -> None:
        # (H + 2, W + 2, 2) rays of all pixels and of a margin of one pixel: each frame needs hundreds, several times
        u, v = np.meshgrid(np.arange(-1.0, camera.width + 1.0), np.arange(-1.0, camera.height + 1.0))
        self.table = np.ascontiguousarray(camera.rays(np.stack([u, v], axis=-1))[..., :2])
        self.camera = camera
        self.pinhole = np.array([camera.fu, camera.fv, camera.cu, camera.cv])  # px, focal lengths and principal point

    def normalise(self, pixels: F64) -> F64:
        """Return (N, 2) normalised coordinates x/z, y/z of pixels; NaN stays NaN, pixels outside move to the edge."""
        out = np.empty((len(pixels), 2))
        interpolate_rays(self.table, np.asarray(pixels, dtype=np.float64) + 1.0, out)
        return out


def inverse_depth(first: F64, other: F64, other_from_first: Pose) -> tuple[F64, F64]:
    """Triangulate matches of normalised coordinates `first` and `other`, (N, 2) each (M2).

    Returns:
        (N,) inverse depth in the first camera, 1/m, negative where the rays diverge; (N,) `arm`, m. The sigma of the
        inverse depth is the sigma of a normalised coordinate divided by `arm`.
    """
    depth, arm = np.empty(len(first)), np.empty(len(first))
    triangulate_matches(first, other, other_from_first.rotation, other_from_first.translation, depth, arm)
    return depth, arm


def epipolar_distance(first: F64, other: F64, other_from_first: Pose) -> F64:
    """Return the (N,) distance of `other` from the epipolar line of `first`, in normalised coordinates (N, 2) (M3)."""
    out = np.empty(len(first))
    line_distances(first, other, skew(other_from_first.translation) @ other_from_first.rotation, out)
    return out


def pixel_covariance(points: F64, by_depth: F64, focal: float, relative_covariance: F64 | None) -> F64:
    """Return the (N, 2, 2) covariance of pixels predicted in a view, px^2.

    Args:
        points: (N, 3) predicted points in the camera of that view, m.
        by_depth: (N, 3) motion of each point by one sigma of its depth, m.
        focal: focal length, px.
        relative_covariance: (6, 6) covariance of the rotation and shift of all points in that camera; None: exact.
    """
    root = np.zeros((6, 0))
    if relative_covariance is not None:
        value, vector = np.linalg.eigh(relative_covariance)
        root = vector * np.sqrt(np.maximum(value, 0.0))
    out = np.empty((len(points), 2, 2))
    pixel_covariances(points, by_depth, focal, root, out)
    return out


def inside_search_region(offset: F32 | F64, covariance: F64, sigmas: float, least: float) -> Mask:
    """Return a mask (N,) of the offsets (N, 2) from a predicted pixel that lie within `sigmas` standard deviations.

    Args:
        covariance: (N, 2, 2) covariance of the prediction, px^2.
        least: sigma added in every direction, px, for the match and for errors that the covariance leaves out.
    """
    a, b, c = covariance[:, 0, 0] + least**2, covariance[:, 0, 1], covariance[:, 1, 1] + least**2
    x, y = offset[:, 0].astype(np.float64), offset[:, 1].astype(np.float64)
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= sigmas**2 * (a * c - b * b))


def median_depth(depth: F64, otherwise: float) -> float:
    """Return the (upper) median of the finite depths; `otherwise` if there are none."""
    known = depth[np.isfinite(depth)]
    middle = len(known) // 2
    return float(np.partition(known, middle)[middle]) if len(known) else otherwise


@dataclass(frozen=True, eq=False)
class PredictedPixels:
    """Predicted pixels of N features, where the search for them starts."""

    pixels: F32  # (N, 2)
    depth: F64  # (N,) depth in that view, m, NaN = unknown
    covariance: F64 | None = None  # (N, 2, 2) px^2 of the prediction; None: unknown

    def select(self, which: I64) -> PredictedPixels:
        """Return the predictions of the features at the indices `which`."""
        covariance = None if self.covariance is None else self.covariance[which]
        return PredictedPixels(self.pixels[which], self.depth[which], covariance)


class ViewTransfer:
    """Transfers features of the left camera to another time or another camera of the rig."""

    def __init__(self, lenses: Sequence[Lens], cam_from_first: Sequence[Pose], settings: TracksSettings) -> None:
        self._lenses, self._settings = lenses, settings
        baselines = [float(np.linalg.norm(p.translation)) * lenses[0].camera.fu for p in cam_from_first[1:]]
        self._rig_baseline_px = max([b for b in baselines if b > 0], default=np.inf)  # m px; over depth: disparity

    def predicted(
        self, pixels: F32, depth: F64, other_from_first: Pose, other: int, relative_covariance: F64 | None = None
    ) -> PredictedPixels:
        """Return pixels of the left camera projected into another view, at their depth.

        Pixels of unknown depth get the median depth, or infinity if no depth is known.

        Args:
            pixels: (N, 2) pixels in the left camera.
            depth: (N,) m, NaN = unknown.
            other_from_first: pose of the left camera in the other view.
            other: index of the camera of the other view.
            relative_covariance: (6, 6) covariance of the rotation and shift between the views; None: exact.
        """
        has_depth, s, n = np.isfinite(depth), self._settings, len(pixels)
        common = median_depth(depth, 1e6)
        z = np.where(has_depth, depth, common)
        moved, out = np.empty((n, 3)), np.empty((n, 2))
        flat = self._lenses[0].normalise(pixels.astype(np.float64))
        R, t, lens = other_from_first.rotation, other_from_first.translation, self._lenses[other]
        carry_points(flat, z, R, t, lens.pinhole, lens.camera.code, lens.camera.coefficients, moved, out)
        there = np.where(has_depth, moved[:, 2], np.nan)
        predicted = np.where(np.isfinite(out), out, pixels).astype(np.float32)
        if not has_depth.any():
            return PredictedPixels(predicted, there)
        parallax = np.minimum(self._rig_baseline_px / np.maximum(z, 1e-9), s.depth_parallax_px)
        relative_sigma = np.where(has_depth, s.search_sigma_px / parallax, 1.0)  # unknown: as large as the depth
        by_depth = (moved - t) * relative_sigma[:, None]
        covariance = pixel_covariance(moved, by_depth, lens.camera.fu, relative_covariance)
        return PredictedPixels(predicted, there, covariance)

    def common_depth(self, images: tuple[U8, U8], pixels: F32, depth: F64, now_from_then: Pose) -> F64:
        """Return the (N,) equal depths, m, at which the earlier and the present image correlate best (M1c)."""
        # for photos by a single camera, without known depths: their features move farther than a search reaches
        baseline, camera = float(np.linalg.norm(now_from_then.translation)), self._lenses[0].camera
        if baseline < 1e-5:  # m: no depth shifts a feature
            return depth
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # range of shifts, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / self._settings.depth_step))
        small, now = (downsampled(image) for image in images)
        factor, scores = downsampling_factor(images[1]), list[float]()
        for shift in shifts:
            tried = self.predicted(pixels, np.full(len(pixels), baseline / shift), now_from_then, 0).pixels
            scores.append(image_correlation(small, now, pixels, tried, factor, self._settings.least_overlap))
        return np.full(len(pixels), baseline / shifts[int(np.argmax(scores))])

    def updated_depths(self, before: F32, pixels: F32, depth: F64, now_from_then: Pose) -> F64:
        """Return the (N,) depths in the present view, m, NaN = unknown.

        They follow from the parallax between the earlier pixels `before` and the present `pixels`, (N, 2), where it
        suffices, else from the earlier `depth` (N,).
        """
        focal = self._lenses[0].camera.fu
        then, now = (self._lenses[0].normalise(p.astype(np.float64)) for p in (before, pixels))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * focal > self._settings.depth_parallax_px, 1.0 / np.maximum(w, 1e-9), depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])
