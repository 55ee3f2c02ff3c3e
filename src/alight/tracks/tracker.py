"""Feature tracks: Shi-Tomasi corners followed in time and across the rig by pyramidal Lucas-Kanade.

The search starts at the predicted pixel of a feature and is bounded about it. Each match in time is checked forward and
backward; matches between cameras are checked by the patch and the epipolar line (docs/method/tracks.md, M1-M3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Camera, Pose
from alight.records import Frame, Prediction, Rig, Tracks
from alight.settings import TracksSettings
from alight.tracks.corners import BORDER, corner_response, detect_corners, oldest_per_cell
from alight.tracks.epipolar import epipolar_distance, inverse_depth
from alight.tracks.global_alignment import (
    TURNS,
    common_shift,
    downsampled,
    downsampling_factor,
    image_correlation,
    match_brightness,
    relocate,
    warp_affine,
)
from alight.tracks.lens import Lens
from alight.tracks.patches import AnchorPatches, FeaturePatches, GroundPlane, patch_warps, smooth_image
from alight.tracks.search_region import inside_search_region, pixel_covariance

Poses = tuple[Pose, ...]
Stop = tuple[int, int, float]

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)  # iterations; px
_STOP_ROUGH = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.03)  # backward, and before patches


def grey(image: U8) -> U8:
    """Return the (H, W) grey image of a grey or RGB one."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(eq=False)
class _LastExposure:
    """The last exposure that had a left image."""

    t_ns: int
    image: U8
    poses: Poses | None
    ids: I64
    pixels: F32  # (N, 2)
    depth: F64  # (N,) metres in the left camera, NaN = unknown


@dataclass(frozen=True, eq=False)
class PredictedPixels:
    """Predicted pixels of features, where the search starts."""

    pixels: F32  # (N, 2)
    covariance: F64 | None = None  # (N, 2, 2) px^2 of the prediction; None: unknown


class Tracker:
    """Follows features through the exposures of a rig; `feed` returns one `Tracks` an exposure."""

    def __init__(self, rig: Rig, settings: TracksSettings) -> None:
        self._settings = settings
        self._cameras = [c.camera for c in rig.cameras]
        self._lenses = [Lens(c) for c in self._cameras]
        first = rig.cameras[0].body_from_cam
        self._cam_from_first = [c.body_from_cam.inverse @ first for c in rig.cameras]
        baselines = [float(np.linalg.norm(p.translation)) * self._cameras[0].fu for p in self._cam_from_first[1:]]
        self._rig_baseline_px = max(
            [b for b in baselines if b > 0], default=np.inf
        )  # m px: over the depth, the disparity
        self._anchors = AnchorPatches(self._lenses[0], settings.patch_span * self._cameras[0].width, settings)
        # px, 90th percentile of the last matches: in time for camera 0, across the rig for others
        self._prediction_error = [np.inf] * len(rig.cameras)
        self._next_id = 0
        self._last: _LastExposure | None = None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the exposure from which features are tracked; None: none yet."""
        return self._last.t_ns if self._last else None

    def feed(self, frame: Frame, prediction: Prediction | None = None) -> Tracks:
        """Track the features into one exposure and add new corners where the image has none.

        Args:
            prediction: of the cameras at this exposure, relative to that at `last_ns`.

        Returns:
            the features observed; none when the left image is missing (tracking goes on at the next one).
        """
        if frame.images[0] is None:
            return self._tracks_of(frame.t_ns, np.empty(0, np.int64), np.empty((0, len(self._cameras), 2)), np.empty(0))
        image = grey(frame.images[0])
        ids, pixels, depth = self._track_in_time(image, prediction)
        poses = prediction.world_from_cams if prediction else None
        pose, soft = (
            poses[0] if poses and self._prediction_error[0] < self._settings.sure_px else None,
            smooth_image(image),
        )
        pixels = self._anchors.refine(soft, ids, pixels.astype(np.float64), pose, depth).astype(np.float32)
        ids, pixels, depth = self._add_corners(image, ids, pixels, depth)
        self._anchors.add_missing(soft, ids, pixels.astype(np.float64), pose)
        observed, depth = self._match_across_rig(frame, image, soft, pixels, depth, pose)
        self._last = _LastExposure(frame.t_ns, image, poses, ids, pixels, depth)
        return self._tracks_of(frame.t_ns, ids, observed, corner_response(image, pixels, self._settings.window_px))

    def _track_in_time(self, image: U8, prediction: Prediction | None) -> tuple[I64, F32, F64]:
        m = self._last
        if m is None or not len(m.ids):
            return np.empty(0, np.int64), np.empty((0, 2), np.float32), np.empty(0)
        earlier = (prediction.earlier or m.poses) if prediction else None
        now_from_then = prediction.world_from_cams[0].inverse @ earlier[0] if prediction and earlier else None
        if prediction is None or now_from_then is None:
            predicted = PredictedPixels(relocate(m.image, image, m.pixels, (0.0,)))
        else:
            predicted = self._predicted_pixels(m, image, now_from_then, prediction.covariance)
        pixels, good = self._match_in_time(m, image, predicted, now_from_then is not None)
        if good.mean() < 0.5 and now_from_then is not None:
            pixels, good = self._match_in_time(m, image, PredictedPixels(predicted.pixels))
        if good.mean() < self._settings.few_share:  # the prediction may be wrong as a whole: try without it
            other = self._match_in_time(m, image, PredictedPixels(relocate(m.image, image, m.pixels, TURNS)))
            pixels, good = other if other[1].sum() > good.sum() else (pixels, good)
        good &= oldest_per_cell(m.ids, pixels, good, self._cell, self._settings.most_in_cell)
        depth = self._updated_depths(m, pixels, now_from_then) if now_from_then is not None else m.depth
        return m.ids[good], pixels[good], depth[good]

    def _predicted_pixels(
        self, m: _LastExposure, image: U8, now_from_then: Pose, relative_covariance: F64 | None
    ) -> PredictedPixels:
        """Predict pixels from the motion; where they move far, their common error is corrected first (M1c)."""
        has_depth = bool(np.isfinite(m.depth).any())
        depth = m.depth if has_depth else self._common_depth(m, image, now_from_then)
        predicted = self._transfer(m.pixels, depth, now_from_then, self._cameras[0], relative_covariance)
        if np.linalg.norm(predicted.pixels - m.pixels, axis=1).mean() > self._settings.far_px:
            s = self._settings
            shift = common_shift(m.image, image, m.pixels, predicted.pixels, s.common_reach_px, s.least_overlap)
            return PredictedPixels(predicted.pixels + shift)
        return predicted if has_depth and relative_covariance is not None else PredictedPixels(predicted.pixels)

    def _match_in_time(
        self, m: _LastExposure, image: U8, predicted: PredictedPixels, expected: bool = False
    ) -> tuple[F32, Mask]:
        patched = expected and self._prediction_error[0] < self._settings.close_px
        then, start = (m.image, m.pixels) if patched else warp_affine(m.image, m.pixels, predicted.pixels)
        return self._match(then, image, start, predicted, 0, expected)

    def _common_depth(self, m: _LastExposure, image: U8, now_from_then: Pose) -> F64:
        """Return one depth for all features when none is known: that of the best correlation of the images (M1c).

        A single camera needs it between photos, where features move by more than a search covers.
        """
        baseline, camera = float(np.linalg.norm(now_from_then.translation)), self._cameras[0]
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # shift, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / self._settings.depth_step))
        if baseline * camera.fu < least:
            return m.depth
        small, now = downsampled(m.image), downsampled(image)
        scores = [
            image_correlation(
                small,
                now,
                m.pixels,
                self._transfer(m.pixels, depth, now_from_then, camera).pixels,
                downsampling_factor(image),
                self._settings.least_overlap,
            )
            for depth in (np.full(len(m.ids), baseline / s) for s in shifts)
        ]
        return np.full(len(m.ids), baseline / shifts[int(np.argmax(scores))])

    def _updated_depths(self, m: _LastExposure, pixels: F32, now_from_then: Pose) -> F64:
        """Return depths in the present view: by parallax where it suffices, else the old depths moved on."""
        camera = self._cameras[0]
        then, now = (self._lenses[0].normalise(p.astype(np.float64)) for p in (m.pixels, pixels))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * camera.fu > self._settings.depth_parallax_px, 1.0 / np.maximum(w, 1e-9), m.depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])

    def _lucas_kanade(self, a: U8, b: U8, pixels: F32, predicted: F32, levels: int, stop: Stop) -> tuple[F32, Mask]:
        window = (self._settings.window_px, self._settings.window_px)
        options: dict[str, Any] = {"winSize": window, "maxLevel": levels - 1, "criteria": stop}
        found, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, pixels, predicted.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
        )
        return np.asarray(found), np.asarray(ok[:, 0] > 0)

    def _transfer(
        self, pixels: F32, depth: F64, other_from_first: Pose, other: Camera, relative_covariance: F64 | None = None
    ) -> PredictedPixels:
        """Project pixels of the left camera at their depth (unknown: the median, else infinity) into another view."""
        has_depth = np.isfinite(depth)
        z = np.where(has_depth, depth, np.median(depth[has_depth]) if has_depth.any() else 1e6)
        flat = self._lenses[0].normalise(pixels.astype(np.float64))
        points = np.column_stack([flat, np.ones(len(flat))]) * z[:, None]
        moved = other_from_first.apply(points)
        out = other.project(moved).astype(np.float32)
        relative_sigma = np.where(
            has_depth,
            self._settings.depth_sigma_px
            / np.minimum(self._rig_baseline_px / np.maximum(z, 1e-9), self._settings.depth_parallax_px),
            self._settings.unknown_depth_share,
        )
        by_depth = (points * relative_sigma[:, None]) @ other_from_first.rotation.T
        covariance = pixel_covariance(moved, by_depth, other.fu, relative_covariance) if has_depth.any() else None
        return PredictedPixels(np.where(np.isfinite(out), out, pixels), covariance)

    def _match(
        self, a: U8, b: U8, pixels: F32, predicted: PredictedPixels, cam: int, expected: bool = False
    ) -> tuple[F32, Mask]:
        """Lucas-Kanade from `a` to `b` (of camera `cam`), in time forward and backward.

        Args:
            a, b: images.
            pixels: (N, 2) in `a`.
            predicted: in `b`.
            cam: index of the camera of `b`; 0: a match in time.
            expected: the prediction is good to some pixels, so that coarse pyramid levels are not needed.

        Returns:
            (N, 2) pixels in `b`; (N,) which are inside the image and the search region.
        """
        s = self._settings
        a = match_brightness(a, b, s)
        enough_levels = 1 if self._prediction_error[cam] < self._settings.close_px else 2
        patched = expected and enough_levels == 1  # refined by its patch afterwards
        levels, stop = min(s.levels, enough_levels) if expected else s.levels, _STOP_ROUGH if patched else _STOP
        found, ok = self._lucas_kanade(a, b, pixels, predicted.pixels, levels, stop)
        good = ok & _inside(found, self._cameras[cam])
        if cam == 0:  # a match in another camera is checked by its patch instead
            # the backward match starts where it must end: wrong matches drift away
            back, ok = self._lucas_kanade(b, a, found, pixels, 1, _STOP_ROUGH)
            good &= ok & (np.linalg.norm(back - pixels, axis=1) < s.forward_backward_px)
        error = found - predicted.pixels
        distance = np.linalg.norm(error, axis=1)
        good &= distance < s.search_px
        if predicted.covariance is not None:
            good &= inside_search_region(error, predicted.covariance, s.search_sigmas, s.search_sigma_px)
        self._prediction_error[cam] = (
            float(np.sort(distance[good])[int(0.9 * good.sum())]) if good.mean() > 0.5 else np.inf
        )
        return found, good

    @property
    def _cell(self) -> float:
        camera = self._cameras[0]
        return float(np.sqrt(camera.width * camera.height / self._settings.count))

    def _add_corners(self, image: U8, ids: I64, pixels: F32, depth: F64) -> tuple[I64, F32, F64]:
        new = detect_corners(image, pixels, self._cell, self._settings.texture)
        fresh = np.arange(self._next_id, self._next_id + len(new))
        self._next_id += len(new)
        return (
            np.concatenate([ids, fresh]),
            np.ascontiguousarray(np.vstack([pixels, new]), dtype=np.float32),
            np.concatenate([depth, np.full(len(new), np.nan)]),
        )

    def _match_across_rig(
        self, frame: Frame, image: U8, soft: U8, pixels: F32, depth: F64, pose: Pose | None
    ) -> tuple[F64, F64]:
        """Match features of the left camera in all other cameras; pixels (N, cameras, 2) and depths (N,)."""
        patches = FeaturePatches.cut(
            soft, np.arange(len(pixels)), pixels.astype(np.float64), self._settings.window_px | 1
        )
        observed = np.full((len(pixels), len(self._cameras), 2), np.nan)
        observed[:, 0] = pixels
        for i in range(1, len(self._cameras)):
            other = frame.images[i]
            if other is not None and len(pixels):
                found, z = self._match_stereo(i, image, grey(other), pixels, depth, (patches, pose))
                observed[:, i] = found
                depth = np.where(np.isfinite(z), z, depth)
        return observed, depth

    def _match_stereo(
        self, i: int, left: U8, right: U8, pixels: F32, depth: F64, soft: tuple[FeaturePatches, Pose | None]
    ) -> tuple[F64, F64]:
        """Match in camera `i`, starting at the expected disparity; pixels (N, 2) and depths (N,), NaN = no match."""
        pose, camera = self._cam_from_first[i], self._cameras[i]
        predicted = self._transfer(pixels, depth, pose, camera)
        matched, good = self._match(left, right, pixels, predicted, i, bool(np.isfinite(depth).any()))
        matched = self._refine_by_patches(i, smooth_image(right), *soft, matched, good, depth)
        found = np.where(good[:, None], matched.astype(np.float64), np.nan)
        a, b = self._lenses[0].normalise(pixels.astype(np.float64)), self._lenses[i].normalise(found)
        with np.errstate(invalid="ignore", divide="ignore"):
            w, arm = inverse_depth(a, b, pose)
            good &= epipolar_distance(a, b, pose) * camera.fu < self._settings.epipolar_px
            good &= w > -2.0 / (camera.fu * arm)  # behind the camera by more than two pixels: a wrong match
            # a disparity of less than a pixel does not determine the depth
            z = np.where(good & (w * arm * camera.fu > 1.0), 1.0 / w, np.nan)
        found[~good] = np.nan
        return found, z

    def _refine_by_patches(
        self, i: int, right: U8, patches: FeaturePatches, pose: Pose | None, found: F32, good: Mask, depth: F64
    ) -> F32:
        """Refine matches in another camera by their patches; a match that fails is marked in `good`."""
        patched = patches.select(good[patches.ids])
        to_first, at = self._cam_from_first[i].inverse, patched.ids
        ground = GroundPlane.under(pose @ to_first if pose is not None else None, depth)
        predicted = found[at].astype(np.float64)
        warps = patch_warps(predicted, self._lenses[i], [to_first], ground, patched.pixels, self._lenses[0])
        found[at], good[at] = patched.locate(right, predicted, warps, self._settings)
        return found

    def _tracks_of(self, t_ns: int, ids: I64, pixels: F64, texture: F64) -> Tracks:
        normalised = np.full_like(pixels, np.nan)
        for i, lens in enumerate(self._lenses):
            normalised[:, i] = lens.normalise(pixels[:, i])
        return Tracks(t_ns, ids, pixels, normalised, texture)


def _inside(pixels: F32, camera: Camera) -> Mask:
    x, y = pixels[:, 0], pixels[:, 1]
    b = BORDER
    return np.asarray((x >= b) & (y >= b) & (x <= camera.width - 1 - b) & (y <= camera.height - 1 - b))
