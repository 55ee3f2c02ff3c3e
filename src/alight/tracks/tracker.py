"""Feature tracks: Shi-Tomasi corners followed in time and across the rig by pyramidal Lucas-Kanade.

The search starts where the predicted motion puts a feature and is bounded about that place; every match is made
forward and backward; matches between cameras are held against the patch and the epipolar line (docs/method-motion.md,
M1-M3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose
from alight.records import F32, F64, U8, Frame, Prediction, Rig, Tracks
from alight.settings import TracksSettings
from alight.tracks.corners import BORDER, corners, spread_corners, strength
from alight.tracks.epipolar import epipolar_distance, inverse_depth
from alight.tracks.global_alignment import (
    TURNS,
    agreement,
    common_shift,
    factor_of,
    found_again,
    lit_as,
    shrunken,
    warp_whole,
)
from alight.tracks.lens import Lens
from alight.tracks.patches import Anchors, FeaturePatches, GroundPlane, smooth_image, view_warps
from alight.tracks.search_region import scatter, within

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]
Poses = tuple[Pose, ...]
Stop = tuple[int, int, float]

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)  # iterations; px
_STOP_ROUGH = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.03)  # of the way back, and where patches settle


def grey(image: U8) -> U8:
    """Return the (H, W) grey image of a grey or RGB one."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(eq=False)
class _Memory:
    """What is kept of the last exposure that had a left image."""

    t_ns: int
    image: U8
    poses: Poses | None
    ids: Ids
    pixels: F32  # (N, 2)
    depth: F64  # (N,) metres in the left camera, NaN = unknown


@dataclass(frozen=True, eq=False)
class Guess:
    """Where features are looked for."""

    pixels: F32  # (N, 2)
    scatter: F64 | None = None  # (N, 2, 2) px^2, covariance of these; None: nothing is known of it


class Tracker:
    """Follows features through the exposures of a rig; `feed` gives one `TracksSettings` an exposure."""

    def __init__(self, rig: Rig, settings: TracksSettings) -> None:
        self._settings = settings
        self._cameras = [c.camera for c in rig.cameras]
        self._lenses = [Lens(c) for c in self._cameras]
        first = rig.cameras[0].body_from_cam
        self._cam_from_first = [c.body_from_cam.inverse @ first for c in rig.cameras]
        arms = [float(np.linalg.norm(p.translation)) * self._cameras[0].fu for p in self._cam_from_first[1:]]
        self._arm = max([a for a in arms if a > 0], default=np.inf)  # m px: over depth, the parallax that gave it
        self._anchors = Anchors(self._lenses[0], settings.patch_span * self._cameras[0].width, settings)
        self._off = [np.inf] * len(rig.cameras)  # px, of nine of ten guesses: in time for camera 0, across for others
        self._next_id = 0
        self._memory: _Memory | None = None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the exposure that features are followed from; None: none yet."""
        return self._memory.t_ns if self._memory else None

    def feed(self, frame: Frame, prediction: Prediction | None = None) -> Tracks:
        """Follow the features into one exposure and take up new ones where the image has none.

        Args:
            prediction: the cameras at this exposure as the motion expects them, seen from that at `last_ns`.

        Returns:
            the features seen; no rows when the left image is missing (the features wait for the next one).
        """
        if frame.images[0] is None:
            return self._record(frame.t_ns, np.empty(0, np.int64), np.empty((0, len(self._cameras), 2)), np.empty(0))
        image = grey(frame.images[0])
        ids, pixels, depth = self._follow(image, prediction)
        poses = prediction.world_from_cams if prediction else None
        pose, soft = poses[0] if poses and self._off[0] < self._settings.sure_px else None, smooth_image(image)
        pixels = self._anchors.hold(soft, ids, pixels.astype(np.float64), pose, depth).astype(np.float32)
        ids, pixels, depth = self._take_up(image, ids, pixels, depth)
        self._anchors.renew(soft, ids, pixels.astype(np.float64), pose)
        seen, depth = self._across(frame, image, soft, pixels, depth, pose)
        self._memory = _Memory(frame.t_ns, image, poses, ids, pixels, depth)
        return self._record(frame.t_ns, ids, seen, strength(image, pixels, self._settings.window_px))

    def _follow(self, image: U8, prediction: Prediction | None) -> tuple[Ids, F32, F64]:
        m = self._memory
        if m is None or not len(m.ids):
            return np.empty(0, np.int64), np.empty((0, 2), np.float32), np.empty(0)
        earlier = (prediction.earlier or m.poses) if prediction else None
        now_from_then = prediction.world_from_cams[0].inverse @ earlier[0] if prediction and earlier else None
        if prediction is None or now_from_then is None:
            guess = Guess(found_again(m.image, image, m.pixels, (0.0,)))
        else:
            guess = self._expected(m, image, now_from_then, prediction.covariance)
        pixels, good = self._matched(m, image, guess, now_from_then is not None)
        if good.mean() < 0.5 and now_from_then is not None:
            pixels, good = self._matched(m, image, Guess(guess.pixels))
        if good.mean() < self._settings.few_share:  # the prediction may be wrong as a whole
            other = self._matched(m, image, Guess(found_again(m.image, image, m.pixels, TURNS)))
            pixels, good = other if other[1].sum() > good.sum() else (pixels, good)
        good &= spread_corners(m.ids, pixels, good, self._cell, self._settings.most_in_cell)
        depth = self._carried(m, pixels, now_from_then) if now_from_then is not None else m.depth
        return m.ids[good], pixels[good], depth[good]

    def _expected(self, m: _Memory, image: U8, now_from_then: Pose, change: F64 | None) -> Guess:
        """Where the motion puts the features; where that is far away, its common error is found first (M1c)."""
        known = bool(np.isfinite(m.depth).any())
        depth = m.depth if known else self._swept(m, image, now_from_then)
        guess = self._transfer(m.pixels, depth, now_from_then, self._cameras[0], change)
        if np.linalg.norm(guess.pixels - m.pixels, axis=1).mean() > self._settings.far_px:
            s = self._settings
            shift = common_shift(m.image, image, m.pixels, guess.pixels, s.common_reach_px, s.least_overlap)
            return Guess(guess.pixels + shift)
        return guess if known and change is not None else Guess(guess.pixels)

    def _matched(self, m: _Memory, image: U8, guess: Guess, expected: bool = False) -> tuple[F32, Mask]:
        held = expected and self._off[0] < self._settings.close_px
        then, start = (m.image, m.pixels) if held else warp_whole(m.image, m.pixels, guess.pixels)
        return self._match(then, image, start, guess, 0, expected)

    def _swept(self, m: _Memory, image: U8, now_from_then: Pose) -> F64:
        """One depth for all features when none is known: the plane across the view that makes the pictures agree (M1c).

        Without it a camera alone could not be followed over the 127 px between two photos.
        """
        way, camera = float(np.linalg.norm(now_from_then.translation)), self._cameras[0]
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # shift, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / self._settings.depth_step))
        if way * camera.fu < least:
            return m.depth
        small, now = shrunken(m.image), shrunken(image)
        scores = [
            agreement(
                small,
                now,
                m.pixels,
                self._transfer(m.pixels, depth, now_from_then, camera).pixels,
                factor_of(image),
                self._settings.least_overlap,
            )
            for depth in (np.full(len(m.ids), way / s) for s in shifts)
        ]
        return np.full(len(m.ids), way / shifts[int(np.argmax(scores))])

    def _carried(self, m: _Memory, pixels: F32, now_from_then: Pose) -> F64:
        """Depths in the present view: by parallax where there is enough, else the old ones carried on."""
        camera = self._cameras[0]
        then, now = (self._lenses[0].normalise(p.astype(np.float64)) for p in (m.pixels, pixels))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * camera.fu > self._settings.depth_parallax_px, 1.0 / np.maximum(w, 1e-9), m.depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])

    def _flow(self, a: U8, b: U8, pixels: F32, guess: F32, levels: int, stop: Stop) -> tuple[F32, Mask]:
        window = (self._settings.window_px, self._settings.window_px)
        options: dict[str, Any] = {"winSize": window, "maxLevel": levels - 1, "criteria": stop}
        there, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, pixels, guess.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
        )
        return np.asarray(there), np.asarray(ok[:, 0] > 0)

    def _transfer(
        self, pixels: F32, depth: F64, other_from_first: Pose, other: Camera, change: F64 | None = None
    ) -> Guess:
        """Take pixels of the left camera at their depth (unknown: the median, else infinity) into another view."""
        known = np.isfinite(depth)
        z = np.where(known, depth, np.median(depth[known]) if known.any() else 1e6)
        flat = self._lenses[0].normalise(pixels.astype(np.float64))
        points = np.column_stack([flat, np.ones(len(flat))]) * z[:, None]
        there = other_from_first.apply(points)
        out = other.project(there).astype(np.float32)
        s = self._settings
        parallax = np.minimum(self._arm / np.maximum(z, 1e-9), s.depth_parallax_px)
        vague = np.where(known, s.depth_sigma_px / parallax, s.unknown_depth_share)
        by_depth = (points * vague[:, None]) @ other_from_first.rotation.T
        open_ = scatter(there, by_depth, other.fu, change) if known.any() else None
        return Guess(np.where(np.isfinite(out), out, pixels), open_)

    def _match(self, a: U8, b: U8, pixels: F32, guess: Guess, cam: int, expected: bool = False) -> tuple[F32, Mask]:
        """Lucas-Kanade from `a` to `b` (of camera `cam`), in time there and back; good near the guess and inside.

        Args:
            expected: the guesses are good to some pixels, so the coarse levels are not needed.
        """
        s = self._settings
        a, near = lit_as(a, b, s), 1 if self._off[cam] < s.close_px else 2
        held = expected and near == 1  # its patch settles it
        levels, stop = min(s.levels, near) if expected else s.levels, _STOP_ROUGH if held else _STOP
        there, ok = self._flow(a, b, pixels, guess.pixels, levels, stop)
        good = ok & _inside(there, self._cameras[cam])
        if cam == 0:  # a match in another camera is held against its patch instead
            back, ok = self._flow(b, a, there, pixels, 1, _STOP_ROUGH)  # from where it must end: wrong ones slide away
            good &= ok & (np.linalg.norm(back - pixels, axis=1) < s.forward_backward_px)
        off = there - guess.pixels
        far = np.linalg.norm(off, axis=1)
        good &= far < s.search_px
        if guess.scatter is not None:
            good &= within(off, guess.scatter, s.search_sigmas, s.search_sigma_px)
        self._off[cam] = float(np.sort(far[good])[int(0.9 * good.sum())]) if good.mean() > 0.5 else np.inf
        return there, good

    @property
    def _cell(self) -> float:
        camera = self._cameras[0]
        return float(np.sqrt(camera.width * camera.height / self._settings.count))

    def _take_up(self, image: U8, ids: Ids, pixels: F32, depth: F64) -> tuple[Ids, F32, F64]:
        new = corners(image, pixels, self._cell, self._settings.texture)
        fresh = np.arange(self._next_id, self._next_id + len(new))
        self._next_id += len(new)
        return (
            np.concatenate([ids, fresh]),
            np.ascontiguousarray(np.vstack([pixels, new]), dtype=np.float32),
            np.concatenate([depth, np.full(len(new), np.nan)]),
        )

    def _across(self, frame: Frame, image: U8, soft: U8, pixels: F32, depth: F64, pose: Pose | None) -> tuple[F64, F64]:
        """Match the features of the left camera in every other camera; pixels (N, cameras, 2) and depth (N,)."""
        patches = FeaturePatches.cut(
            soft, np.arange(len(pixels)), pixels.astype(np.float64), self._settings.window_px | 1
        )
        seen = np.full((len(pixels), len(self._cameras), 2), np.nan)
        seen[:, 0] = pixels
        for i in range(1, len(self._cameras)):
            other = frame.images[i]
            if other is not None and len(pixels):
                found, z = self._stereo(i, image, grey(other), pixels, depth, (patches, pose))
                seen[:, i] = found
                depth = np.where(np.isfinite(z), z, depth)
        return seen, depth

    def _stereo(
        self, i: int, left: U8, right: U8, pixels: F32, depth: F64, soft: tuple[FeaturePatches, Pose | None]
    ) -> tuple[F64, F64]:
        """Match along the epipolar line from the expected disparity on; pixels (N, 2) and depth (N,), NaN = none."""
        pose, camera = self._cam_from_first[i], self._cameras[i]
        guess = self._transfer(pixels, depth, pose, camera)
        there, good = self._match(left, right, pixels, guess, i, bool(np.isfinite(depth).any()))
        there = self._settled(i, smooth_image(right), *soft, there, good, depth)
        found = np.where(good[:, None], there.astype(np.float64), np.nan)
        a, b = self._lenses[0].normalise(pixels.astype(np.float64)), self._lenses[i].normalise(found)
        with np.errstate(invalid="ignore", divide="ignore"):
            w, arm = inverse_depth(a, b, pose)
            good &= epipolar_distance(a, b, pose) * camera.fu < self._settings.epipolar_px
            good &= w > -2.0 / (camera.fu * arm)  # behind the camera by more than two pixels: a wrong match
            z = np.where(good & (w * arm * camera.fu > 1.0), 1.0 / w, np.nan)  # under a pixel it says nothing
        found[~good] = np.nan
        return found, z

    def _settled(
        self, i: int, right: U8, patches: FeaturePatches, pose: Pose | None, there: F32, good: Mask, depth: F64
    ) -> F32:
        """Matches in another camera made better by their patches; those that are not found so are no longer good."""
        held = patches.rows(good[patches.ids])
        to_first, at = self._cam_from_first[i].inverse, held.ids
        ground = GroundPlane.below(pose @ to_first if pose is not None else None, depth)
        guess = there[at].astype(np.float64)
        turn = view_warps(guess, self._lenses[i], [to_first], ground, held.pixels, self._lenses[0])
        there[at], good[at] = held.found(right, guess, turn, self._settings)
        return there

    def _record(self, t_ns: int, ids: Ids, pixels: F64, texture: F64) -> Tracks:
        normalised = np.full_like(pixels, np.nan)
        for i, lens in enumerate(self._lenses):
            normalised[:, i] = lens.normalise(pixels[:, i])
        return Tracks(t_ns, ids, pixels, normalised, texture)


def _inside(pixels: F32, camera: Camera) -> Mask:
    x, y = pixels[:, 0], pixels[:, 1]
    b = BORDER
    return np.asarray((x >= b) & (y >= b) & (x <= camera.width - 1 - b) & (y <= camera.height - 1 - b))
