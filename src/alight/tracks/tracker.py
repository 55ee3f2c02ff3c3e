"""Feature tracks: Shi-Tomasi corners followed in time and across the rig by pyramidal Lucas-Kanade.

The search starts at the predicted pixel of a feature and is limited to a region about it. Each match in time is checked
forward and backward. Matches between cameras are checked by the patch and the epipolar line (docs/method/tracks.md,
M1-M3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Camera, Pose
from alight.raster import grey_levels
from alight.records import Frame, Prediction, Rig, Tracks
from alight.settings import TracksSettings
from alight.tracks.corners import BORDER, corner_response, detect_corners, oldest_per_cell
from alight.tracks.global_alignment import common_shift, likely_turns, match_brightness, relocate, warp_affine
from alight.tracks.patches import FeaturePatches, follow_patches, smooth_image
from alight.tracks.view_transfer import (
    Lens,
    PredictedPixels,
    ViewTransfer,
    epipolar_distance,
    inside_search_region,
    inverse_depth,
)

Poses = tuple[Pose, ...]


@dataclass(frozen=True, eq=False)
class _Exposure:
    t_ns: int
    image: U8
    soft: U8  # the image smoothed for patches
    poses: Poses | None  # predicted world_from_cams
    pose: Pose | None  # pose of the left camera, if the last prediction was good enough for warps
    ids: I64
    pixels: F32  # (N, 2)
    depth: F64  # (N,) metres in the left camera, NaN = unknown
    patches: FeaturePatches  # patches of this image; their ids are the rows of the features


@dataclass(frozen=True, eq=False)
class _Found:
    """Features found again in the present exposure."""

    ids: I64  # (N,) ascending
    pixels: F32  # (N, 2)
    depth: F64  # (N,) m, NaN = unknown
    anchored: Mask  # (N,) whether the feature's own patch was aligned already


class Tracker:
    """Tracks features through the exposures of a rig; `feed` returns one `Tracks` per exposure."""

    def __init__(self, rig: Rig, settings: TracksSettings) -> None:
        self._settings = settings
        self._lenses = [Lens(c.camera) for c in rig.cameras]
        first = rig.cameras[0].body_from_cam
        self._cam_from_first = [c.body_from_cam.inverse @ first for c in rig.cameras]
        self._views = ViewTransfer(self._lenses, self._cam_from_first, settings)
        self._anchors = FeaturePatches.none(settings.window_px | 1)  # first patches of the features in the left camera
        # px, 90th percentile over the last matches: in time for camera 0, across the rig for other cameras
        self._prediction_error = [np.inf] * len(rig.cameras)
        self._next_id = 0
        self._last: _Exposure | None = None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the exposure from which features are tracked, ns; None before the first."""
        return self._last.t_ns if self._last else None

    def feed(self, frame: Frame, prediction: Prediction | None = None) -> Tracks:
        """Track the features into one exposure, and add new corners where the image has no feature.

        Args:
            frame: images of one exposure.
            prediction: poses of the cameras at this exposure, relative to the exposure at `last_ns`.

        Returns:
            The features observed; no features if the left image is missing (tracking goes on at the next exposure).
        """
        if frame.images[0] is None:
            return self._tracks_of(frame.t_ns, np.empty(0, np.int64), np.empty((0, len(self._lenses), 2)), np.empty(0))
        image = grey_levels(frame.images[0])
        soft = smooth_image(image)
        found, poses = self._track_in_time(image, soft, prediction), prediction.world_from_cams if prediction else None
        pose = poses[0] if poses and self._prediction_error[0] < self._settings.sure_px else None
        ids, pixels, depth = found.ids, self._refine_in_time(soft, found, pose), found.depth
        ids, pixels, depth = self._add_corners(soft, ids, pixels, depth)
        if pose is not None:
            self._anchors = self._anchors.with_new(soft, ids, pixels.astype(np.float64), pose)
        rows, window = np.arange(len(pixels)), self._settings.window_px | 1
        patches = FeaturePatches.whole(soft, rows, pixels.astype(np.float64), window)
        exposure = _Exposure(frame.t_ns, image, soft, poses, pose, ids, pixels, depth, patches)
        observed, self._last = self._match_across_rig(frame, exposure)
        return self._tracks_of(frame.t_ns, ids, observed, corner_response(image, pixels, self._settings.window_px))

    def _track_in_time(self, image: U8, soft: U8, prediction: Prediction | None) -> _Found:
        m = self._last
        if m is None or not len(m.ids):
            return _Found(np.empty(0, np.int64), np.empty((0, 2), np.float32), np.empty(0), np.empty(0, bool))
        earlier = (prediction.earlier or m.poses) if prediction else None
        now_from_then = prediction.world_from_cams[0].inverse @ earlier[0] if prediction and earlier else None
        if prediction is None or now_from_then is None:
            predicted = PredictedPixels(relocate(m.image, image, m.pixels, (0.0,)), m.depth)
        else:
            predicted = self._predicted_pixels(m, image, now_from_then, prediction.covariance)
        anchored = np.zeros(len(m.ids), bool)
        if prediction is not None and now_from_then is not None and self._is_close(0):
            pixels, good, anchored = self._align_in_time(m, soft, predicted, prediction.world_from_cams[0])
        else:
            pixels, good = self._match_in_time(m, image, predicted, now_from_then is not None)
        if good.mean() < 0.5 and now_from_then is not None:
            anchored[:] = False
            pixels, good = self._match_in_time(m, image, replace(predicted, covariance=None))
        if good.mean() < self._settings.least_overlap:  # the prediction may be wrong as a whole: try without it
            covariance = prediction.covariance if prediction is not None else None
            turns = likely_turns(now_from_then, covariance, self._settings.search_sigmas)
            anywhere = PredictedPixels(relocate(m.image, image, m.pixels, turns), m.depth)
            other = self._match_in_time(m, image, anywhere)
            pixels, good = other if other[1].sum() > good.sum() else (pixels, good)
        good &= oldest_per_cell(m.ids, pixels, good, self._cell, self._settings.most_in_cell)
        depth = (
            self._views.updated_depths(m.pixels, pixels, m.depth, now_from_then)
            if now_from_then is not None
            else m.depth
        )
        return _Found(m.ids[good], pixels[good], depth[good], anchored[good])

    def _is_close(self, cam: int) -> bool:
        """Whether the last predictions for camera `cam` were good enough to find patches directly from them."""
        return self._prediction_error[cam] < self._settings.close_px

    def _align_in_time(self, m: _Exposure, soft: U8, predicted: PredictedPixels, pose: Pose) -> tuple[F32, Mask, Mask]:
        """Align features of the last exposure `m` in the smoothed image `soft`: by their own patches, else by new ones.

        New patches are cut from the last image. `pose`: predicted world_from_cam. Return the (N, 2) pixels, the (N,)
        mask of features found, and the (N,) mask of those found by their own patch.
        """
        start = predicted.pixels.astype(np.float64)
        pixels, anchored = self._locate_anchors(soft, m.ids, start, pose, predicted.depth)
        good = anchored & self._in_search_region(0, pixels, predicted)
        rest = np.flatnonzero(~good)
        if len(rest):
            some = predicted.select(rest)
            moved, same = follow_patches(m.soft, soft, m.pixels[rest].astype(np.float64), some.pixels, self._settings)
            settled, own = self._locate_anchors(soft, m.ids[rest], moved, pose, predicted.depth)
            pixels[rest], good[rest] = settled, same & self._in_search_region(0, settled, some)
            anchored[rest] = own
        self._note_prediction_error(0, pixels, predicted, good)
        return pixels.astype(np.float32), good, anchored & good

    def _refine_in_time(self, soft: U8, found: _Found, pose: Pose | None) -> F32:
        """Return the (N, 2) pixels of `found`, refined by the features' own patches in the smoothed image `soft`.

        `pose`: predicted world_from_cam; None: the pixels are returned unchanged.
        """
        if pose is None:
            self._anchors = FeaturePatches.none(self._settings.window_px | 1)
            return found.pixels
        pixels, anchored = found.pixels.astype(np.float64), found.anchored
        if not anchored.any():
            pixels, anchored = self._locate_anchors(soft, found.ids, pixels, pose, found.depth)
        held, at = self._anchors.of(found.ids[anchored])
        moved = pixels[anchored][at] - held.pixels  # far from where it was cut, a patch is no longer useful
        most = self._settings.patch_span * self._lenses[0].camera.width
        self._anchors = held.select((moved * moved).sum(axis=1) < most**2)
        return pixels.astype(np.float32)

    def _locate_anchors(self, soft: U8, ids: I64, pixels: F64, pose: Pose, depth: F64) -> tuple[F64, Mask]:
        """Locate the features' own patches in the image `soft` near pixels (N, 2); `ids` (N,) are ascending.

        Return the (N, 2) pixels, unchanged where a feature has no patch or it does not fit, and the (N,) mask of
        patches that fit. `pose` is the predicted world_from_cam; `depth` (N,) is in metres, NaN = unknown.
        """
        held, at = self._anchors.of(ids)
        out, found, lens = np.array(pixels, dtype=np.float64), np.zeros(len(ids), bool), self._lenses[0]
        if len(at):
            warp = held.warps(lens, out[at], lens, pose, pose.rotation[2], depth)
            out[at], found[at] = held.locate(soft, out[at], warp, self._settings)
        return out, found

    def _predicted_pixels(
        self, m: _Exposure, image: U8, now_from_then: Pose, relative_covariance: F64 | None
    ) -> PredictedPixels:
        """Predict the pixels of the last exposure `m` in `image`; if features move far, correct a common error (M1c).

        `relative_covariance`: (6, 6) of `now_from_then`, rotation first; None: unknown.
        """
        has_depth = bool(np.isfinite(m.depth).any())
        depth = m.depth if has_depth else self._views.common_depth((m.image, image), m.pixels, m.depth, now_from_then)
        predicted = self._views.predicted(m.pixels, depth, now_from_then, 0, relative_covariance)
        if np.linalg.norm(predicted.pixels - m.pixels, axis=1).mean() > self._settings.search_px:
            shift = common_shift(m.image, image, m.pixels, predicted.pixels, self._settings.least_overlap)
            return replace(predicted, pixels=predicted.pixels + shift, covariance=None)
        return predicted if has_depth and relative_covariance is not None else replace(predicted, covariance=None)

    def _match_in_time(
        self, m: _Exposure, image: U8, predicted: PredictedPixels, expected: bool = False
    ) -> tuple[F32, Mask]:
        then, start = warp_affine(m.image, m.pixels, predicted.pixels)
        return self._match(then, image, start, predicted, 0, expected)

    def _lucas_kanade(self, a: U8, b: U8, pixels: F32, predicted: F32, levels: int, stop: float) -> tuple[F32, Mask]:
        options: dict[str, Any] = {
            "winSize": (self._settings.window_px, self._settings.window_px), "maxLevel": levels - 1,
            "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, stop),
        }  # fmt: skip
        found, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, pixels, predicted.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
        )
        return np.asarray(found), np.asarray(ok[:, 0] > 0)

    def _match(
        self, a: U8, b: U8, pixels: F32, predicted: PredictedPixels, cam: int, expected: bool = False
    ) -> tuple[F32, Mask]:
        """Match pixels (N, 2) of image `a` in image `b` by Lucas-Kanade, starting from `predicted`.

        Return the (N, 2) pixels and the (N,) mask of matches. `cam` is the camera of `b`; 0 means a match in time,
        which is checked backward. `expected`: whether the prediction is good to a few pixels.
        """
        s = self._settings
        a = match_brightness(a, b, s)
        levels = min(s.levels, 1 if self._is_close(cam) else 2) if expected else s.levels
        found, good = self._lucas_kanade(a, b, pixels, predicted.pixels, levels, 0.005)
        if cam == 0:  # a match in another camera is checked by its patch instead
            # the backward match starts where it must end: wrong matches drift away
            back, ok = self._lucas_kanade(b, a, found, pixels, 1, 0.03)
            good &= ok & (np.linalg.norm(back - pixels, axis=1) < s.forward_backward_px)
        good &= self._in_search_region(cam, found, predicted)
        self._note_prediction_error(cam, found, predicted, good)
        return found, good

    def _in_search_region(self, cam: int, found: F32 | F64, predicted: PredictedPixels) -> Mask:
        """Return the mask of pixels `found` (N, 2) that are inside camera `cam` and near enough to `predicted`."""
        s, error = self._settings, found - predicted.pixels
        good: Mask = _inside(found, self._lenses[cam].camera) & ((error * error).sum(axis=1) < s.search_px**2)
        if predicted.covariance is not None:
            good &= inside_search_region(error, predicted.covariance, s.search_sigmas, s.search_sigma_px)
        return good

    def _note_prediction_error(self, cam: int, found: F32 | F64, predicted: PredictedPixels, good: Mask) -> None:
        distance = np.sort(np.linalg.norm((found - predicted.pixels)[good], axis=1))
        count = len(distance)
        self._prediction_error[cam] = float(distance[int(0.9 * count)]) if count > 0.5 * len(good) else np.inf

    @property
    def _cell(self) -> float:
        camera = self._lenses[0].camera
        return float(np.sqrt(camera.width * camera.height / self._settings.count))

    def _add_corners(self, soft: U8, ids: I64, pixels: F32, depth: F64) -> tuple[I64, F32, F64]:
        border = self._settings.window_px // 2 + BORDER // 2  # patches need their whole window
        new = detect_corners(soft, pixels, self._cell, self._settings.texture, border)
        fresh = np.arange(self._next_id, self._next_id + len(new))
        self._next_id += len(new)
        return (
            np.concatenate([ids, fresh]),
            np.ascontiguousarray(np.vstack([pixels, new]), dtype=np.float32),
            np.concatenate([depth, np.full(len(new), np.nan)]),
        )

    def _match_across_rig(self, frame: Frame, left: _Exposure) -> tuple[F64, _Exposure]:
        """Match features of the left camera in all others; return pixels (N, cameras, 2) and `left` with new depths."""
        observed = np.full((len(left.pixels), len(self._lenses), 2), np.nan)
        observed[:, 0] = left.pixels
        for i in range(1, len(self._lenses)):
            other = frame.images[i]
            if other is not None and len(left.pixels):
                observed[:, i], z = self._match_stereo(i, left, grey_levels(other))
                left = replace(left, depth=np.where(np.isfinite(z), z, left.depth))
        return observed, left

    def _match_stereo(self, i: int, left: _Exposure, right: U8) -> tuple[F64, F64]:
        """Match features of `left` in image `right`, camera `i`; return pixels (N, 2), depths (N,), NaN = no match."""
        pose, focal = self._cam_from_first[i], self._lenses[i].camera.fu
        pixels, depth = left.pixels, left.depth
        predicted, soft_right = self._views.predicted(pixels, depth, pose, i), smooth_image(right)
        expected = bool(np.isfinite(depth).any())
        matched, good = predicted.pixels.astype(np.float64), np.zeros(len(pixels), bool)
        if expected and self._is_close(i):
            good[left.patches.ids] = True
            reach = np.where(np.isfinite(depth), self._settings.close_px, self._settings.sure_px)
            matched = self._refine_by_patches(i, left, soft_right, matched, good, reach)
            good &= self._in_search_region(i, matched, predicted)
            self._note_prediction_error(i, matched, predicted, good)
        if good.mean() < 0.5:
            rough, good = self._match(left.image, right, pixels, predicted, i, expected)
            matched = self._refine_by_patches(i, left, soft_right, rough.astype(np.float64), good)
        found = np.where(good[:, None], matched, np.nan)
        a, b = self._lenses[0].normalise(pixels.astype(np.float64)), self._lenses[i].normalise(found)
        with np.errstate(invalid="ignore", divide="ignore"):
            w, arm = inverse_depth(a, b, pose)
            good &= epipolar_distance(a, b, pose) * focal < self._settings.close_px
            good &= w > -2.0 / (focal * arm)  # behind the camera by more than two pixels: a wrong match
            # a disparity of less than a pixel does not determine the depth
            z = np.where(good & (w * arm * focal > 1.0), 1.0 / w, np.nan)
        found[~good] = np.nan
        return found, z

    def _refine_by_patches(
        self, i: int, left: _Exposure, right: U8, found: F64, good: Mask, reach: F64 | None = None
    ) -> F64:
        """Refine the matches `found` (N, 2) in camera `i`, whose smoothed image is `right`, by patches.

        `good` (N,) becomes False where a patch does not fit. `reach`: see `FeaturePatches.locate`.
        """
        patched = left.patches.select(good[left.patches.ids])
        to_first, at = self._cam_from_first[i].inverse, patched.ids
        up = np.array([0.0, 0.0, -1.0]) if left.pose is None else (left.pose @ to_first).rotation[2]
        warps = patched.warps(self._lenses[0], found[at], self._lenses[i], to_first, up, left.depth)
        out, limit = found.copy(), None if reach is None else reach[at]
        out[at], good[at] = patched.locate(right, found[at], warps, self._settings, limit)
        return out

    def _tracks_of(self, t_ns: int, ids: I64, pixels: F64, texture: F64) -> Tracks:
        normalised = np.full_like(pixels, np.nan)
        for i, lens in enumerate(self._lenses):
            normalised[:, i] = lens.normalise(pixels[:, i])
        return Tracks(t_ns, ids, pixels, normalised, texture)


def _inside(pixels: F32 | F64, camera: Camera) -> Mask:
    x, y = pixels[:, 0], pixels[:, 1]
    b = BORDER
    return np.asarray((x >= b) & (y >= b) & (x <= camera.width - 1 - b) & (y <= camera.height - 1 - b))
