"""Feature tracks: Shi-Tomasi corners followed in time and across the rig by pyramidal Lucas-Kanade.

The search starts where the predicted motion puts a feature and is bounded about that place; every match is made
forward and backward, and matches between cameras are checked against the epipolar line (docs/method-motion.md, M1-M3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose
from alight.records import F32, F64, U8, Frame, Rig, Tracks
from alight.settings import Tracks as TracksSettings
from alight.tracks.corners import BORDER, corners, spread, strength
from alight.tracks.epipolar import epipolar_distance, inverse_depth
from alight.tracks.lens import Lens
from alight.tracks.patches import Anchors, Ground, Patches, smooth, turns
from alight.tracks.whole import TURNS, agreement, common_shift, factor_of, found_again, lit_as, shrunken, turned

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]
Poses = tuple[Pose, ...]
Stop = tuple[int, int, float]

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)  # iterations; px
_STOP_ROUGH = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.03)  # of the way back, and where patches settle
_FAR = 40.0  # px between two pictures from which on the common error of the prediction is looked for first
_FEW = 0.1  # share of the features found below which the prediction is doubted
_PARALLAX = 10.0  # px of motion due to depth above which it gives the depth
_SWEEP_STEP = 0.12  # of the logarithm of depth
_SURE = 5.0  # px; where nine of ten guesses were off by more, nobody knows how patches lie (photos: 0.08, 0.04 degrees)
_SPAN = 0.125  # of the width; features that moved further look otherwise by now
_CLOSE = 1.5  # px; guesses that were last off by less (nine of ten) need no pyramid, others two levels


def grey(image: U8) -> U8:
    """Return the (H, W) grey image of a grey or RGB one."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(eq=False)
class _Memory:
    """What is kept of the last exposure that had a left image."""

    image: U8
    poses: Poses | None
    ids: Ids
    pixels: F32  # (N, 2)
    depth: F64  # (N,) metres in the left camera, NaN = unknown


class Tracker:
    """Follows features through the exposures of a rig; `feed` gives one `Tracks` an exposure."""

    def __init__(self, rig: Rig, settings: TracksSettings) -> None:
        self._settings = settings
        self._cameras = [c.camera for c in rig.cameras]
        self._lenses = [Lens(c) for c in self._cameras]
        first = rig.cameras[0].body_from_cam
        self._cam_from_first = [c.body_from_cam.inverse @ first for c in rig.cameras]
        self._anchors = Anchors(self._lenses[0], _SPAN * self._cameras[0].width, settings.window_px)
        self._off = [np.inf] * len(rig.cameras)  # px, of nine of ten guesses: in time for camera 0, across for others
        self._next_id = 0
        self._memory: _Memory | None = None

    def feed(self, frame: Frame, prediction: Poses | None = None) -> Tracks:
        """Follow the features into one exposure and take up new ones where the image has none.

        Args:
            prediction: world_from_cam a camera at this exposure as the motion predicts it; None: unknown.

        Returns:
            the features seen; no rows when the left image is missing (the features wait for the next one).
        """
        if frame.images[0] is None:
            return self._record(frame.t_ns, np.empty(0, np.int64), np.empty((0, len(self._cameras), 2)), np.empty(0))
        image = grey(frame.images[0])
        ids, pixels, depth = self._follow(image, prediction)
        pose, soft = prediction[0] if prediction and self._off[0] < _SURE else None, smooth(image)
        pixels = self._anchors.hold(soft, ids, pixels.astype(np.float64), pose, depth).astype(np.float32)
        ids, pixels, depth = self._take_up(image, ids, pixels, depth)
        self._anchors.renew(soft, ids, pixels.astype(np.float64), pose)
        seen, depth = self._across(frame, image, soft, pixels, depth, pose)
        self._memory = _Memory(image, prediction, ids, pixels, depth)
        return self._record(frame.t_ns, ids, seen, strength(image, pixels, self._settings.window_px))

    def _follow(self, image: U8, prediction: Poses | None) -> tuple[Ids, F32, F64]:
        m = self._memory
        if m is None or not len(m.ids):
            return np.empty(0, np.int64), np.empty((0, 2), np.float32), np.empty(0)
        now_from_then = prediction[0].inverse @ m.poses[0] if prediction and m.poses else None
        if now_from_then is None:
            guess = found_again(m.image, image, m.pixels, (0.0,))
        else:
            depth = m.depth if np.isfinite(m.depth).any() else self._swept(m, image, now_from_then)
            guess = self._transfer(m.pixels, depth, now_from_then, self._cameras[0])
            if np.linalg.norm(guess - m.pixels, axis=1).mean() > _FAR:
                guess = guess + common_shift(m.image, image, m.pixels, guess)
        pixels, good = self._matched(m, image, guess, now_from_then is not None)
        if good.mean() < 0.5 and now_from_then is not None:
            pixels, good = self._matched(m, image, guess)
        if good.mean() < _FEW:  # the prediction may be wrong as a whole
            other = self._matched(m, image, found_again(m.image, image, m.pixels, TURNS))
            pixels, good = other if other[1].sum() > good.sum() else (pixels, good)
        good &= spread(m.ids, pixels, good, self._cell)
        depth = self._carried(m, pixels, now_from_then) if now_from_then is not None else m.depth
        return m.ids[good], pixels[good], depth[good]

    def _matched(self, m: _Memory, image: U8, guess: F32, expected: bool = False) -> tuple[F32, Mask]:
        then, start = (m.image, m.pixels) if expected and self._off[0] < _CLOSE else turned(m.image, m.pixels, guess)
        return self._match(then, image, start, guess, 0, expected)

    def _swept(self, m: _Memory, image: U8, now_from_then: Pose) -> F64:
        """One depth for all features when none is known: the plane across the view that makes the pictures agree (M1c).

        Without it a camera alone could not be followed over the 127 px between two photos.
        """
        way, camera = float(np.linalg.norm(now_from_then.translation)), self._cameras[0]
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # shift, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / _SWEEP_STEP))
        if way * camera.fu < least:
            return m.depth
        small, now = shrunken(m.image), shrunken(image)
        scores = [
            agreement(small, now, m.pixels, self._transfer(m.pixels, depth, now_from_then, camera), factor_of(image))
            for depth in (np.full(len(m.ids), way / s) for s in shifts)
        ]
        return np.full(len(m.ids), way / shifts[int(np.argmax(scores))])

    def _carried(self, m: _Memory, pixels: F32, now_from_then: Pose) -> F64:
        """Depths in the present view: by parallax where there is enough, else the old ones carried on."""
        camera = self._cameras[0]
        then, now = (self._lenses[0].normalise(p.astype(np.float64)) for p in (m.pixels, pixels))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * camera.fu > _PARALLAX, 1.0 / np.maximum(w, 1e-9), m.depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])

    def _flow(self, a: U8, b: U8, pixels: F32, guess: F32, levels: int, stop: Stop) -> tuple[F32, Mask]:
        window = (self._settings.window_px, self._settings.window_px)
        options: dict[str, Any] = {"winSize": window, "maxLevel": levels - 1, "criteria": stop}
        there, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, pixels, guess.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
        )
        return np.asarray(there), np.asarray(ok[:, 0] > 0)

    def _transfer(self, pixels: F32, depth: F64, other_from_first: Pose, other: Camera) -> F32:
        """Take pixels of the left camera at their depth (unknown: the median, else infinity) into another view."""
        known = np.isfinite(depth)
        z = np.where(known, depth, np.median(depth[known]) if known.any() else 1e6)
        flat = self._lenses[0].normalise(pixels.astype(np.float64))
        points = np.column_stack([flat, np.ones(len(flat))]) * z[:, None]
        out = other.project(other_from_first.apply(points)).astype(np.float32)
        return np.where(np.isfinite(out), out, pixels)

    def _match(self, a: U8, b: U8, pixels: F32, guess: F32, cam: int, expected: bool = False) -> tuple[F32, Mask]:
        """Lucas-Kanade from `a` to `b` (of camera `cam`) and back; good where both agree, near the guess and inside.

        Args:
            expected: the guesses are good to some pixels, so the coarse levels are not needed.
        """
        a, s, near = lit_as(a, b), self._settings, 1 if self._off[cam] < _CLOSE else 2
        held = expected and near == 1  # its patch settles it
        levels, stop = min(s.levels, near) if expected else s.levels, _STOP_ROUGH if held else _STOP
        there, ok = self._flow(a, b, pixels, guess, levels, stop)
        back, ok_back = self._flow(b, a, there, pixels, 1, _STOP_ROUGH)  # from where it must end: wrong ones slide away
        good, off = ok & ok_back & _inside(there, self._cameras[cam]), np.linalg.norm(there - guess, axis=1)
        good &= (np.linalg.norm(back - pixels, axis=1) < s.forward_backward_px) & (off < s.search_px)
        self._off[cam] = float(np.sort(off[good])[int(0.9 * good.sum())]) if good.mean() > 0.5 else np.inf
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
        patches = Patches.cut(soft, np.arange(len(pixels)), pixels.astype(np.float64), self._settings.window_px | 1)
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
        self, i: int, left: U8, right: U8, pixels: F32, depth: F64, soft: tuple[Patches, Pose | None]
    ) -> tuple[F64, F64]:
        """Match along the epipolar line from the expected disparity on; pixels (N, 2) and depth (N,), NaN = none."""
        pose, camera = self._cam_from_first[i], self._cameras[i]
        guess = self._transfer(pixels, depth, pose, camera)
        there, good = self._match(left, right, pixels, guess, i, bool(np.isfinite(depth).any()))
        there = self._settled(i, smooth(right), *soft, there, good, depth)
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
        self, i: int, right: U8, patches: Patches, pose: Pose | None, there: F32, good: Mask, depth: F64
    ) -> F32:
        """Matches in another camera made better by their patches; those that are not found so are no longer good."""
        held = patches.rows(good[patches.ids])
        to_first, at = self._cam_from_first[i].inverse, held.ids
        ground = Ground.below(pose @ to_first if pose is not None else None, depth)
        guess = there[at].astype(np.float64)
        turn = turns(guess, self._lenses[i], [to_first], ground, held.pixels, self._lenses[0])
        there[at], good[at] = held.found(right, guess, turn, self._settings.window_px | 1)
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
