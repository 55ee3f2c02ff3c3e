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

from alight.geometry import Camera, Pose, skew
from alight.records import F32, F64, U8, Frame, Rig, Tracks
from alight.settings import Tracks as TracksSettings

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]
Poses = tuple[Pose, ...]

_BORDER = 4  # px; nearer to the edge the SSD window hangs over it
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)  # iterations; px
_LEAST = 12  # features that a common turn of the image is told from
_SMALL = 160  # px, about the shorter side of a picture shrunk to be looked at as a whole
_SWEEP_STEP = 0.12  # of the logarithm of depth
_FAR = 40.0  # px between two pictures from which on the common error of the prediction is looked for first
_OVERLAP = 0.2  # share of the image that two pictures must have in common in it
_FEW = 0.1  # share of the features found below which the prediction is doubted
_TURNS = tuple(np.radians(np.arange(0.0, 360.0, 15.0)).tolist())  # rad about the optical axis, tried then
_REACH = 160  # px, at most
_PARALLAX = 10.0  # px of motion due to depth above which it gives the depth
_PER_CELL = 3  # features that may run together in one cell of the grid before the younger are dropped


def grey(image: U8) -> U8:
    """Return the (H, W) grey image of a grey or RGB one."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def normalise(camera: Camera, pixels: F64) -> F64:
    """Take (N, 2) pixels to x/z, y/z with the lens taken out; NaN stays NaN."""
    out = np.full_like(pixels, np.nan)
    seen = np.isfinite(pixels).all(axis=-1)
    out[seen] = camera.rays(pixels[seen])[:, :2]
    return out


def inverse_depth(first: F64, other: F64, other_from_first: Pose) -> tuple[F64, F64]:
    """Triangulate normalised matches: inverse depth in the first camera (M2).

    Args:
        first, other: (N, 2) normalised coordinates.

    Returns:
        (N,) inverse depth [1/m], negative where the rays diverge; (N,) length of its derivative's inverse, so that
        the sigma of the inverse depth is the sigma of a normalised coordinate over it.
    """
    ones = np.ones((len(first), 1))
    a = np.hstack([first, ones]) @ other_from_first.rotation.T
    x = np.hstack([other, ones])
    arm = np.cross(np.broadcast_to(other_from_first.translation, x.shape), x)
    square = np.maximum((arm * arm).sum(axis=1), 1e-18)
    return -(np.cross(a, x) * arm).sum(axis=1) / square, np.sqrt(square)


def epipolar_distance(first: F64, other: F64, other_from_first: Pose) -> F64:
    """Return the (N,) distance of `other` from the epipolar line of `first`, both normalised (M3)."""
    E = skew(other_from_first.translation) @ other_from_first.rotation
    lines = np.hstack([first, np.ones((len(first), 1))]) @ E.T
    norm = np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)
    return np.asarray(np.abs((lines[:, :2] * other).sum(axis=1) + lines[:, 2]) / norm)


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
        first = rig.cameras[0].body_from_cam
        self._cam_from_first = [c.body_from_cam.inverse @ first for c in rig.cameras]
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
        ids, pixels, depth = self._take_up(image, ids, pixels, depth)
        seen, depth = self._across(frame, image, pixels, depth)
        self._memory = _Memory(image, prediction, ids, pixels, depth)
        return self._record(frame.t_ns, ids, seen, strength(image, pixels, self._settings.window_px))

    def _follow(self, image: U8, prediction: Poses | None) -> tuple[Ids, F32, F64]:
        m = self._memory
        if m is None or not len(m.ids):
            return np.empty(0, np.int64), np.empty((0, 2), np.float32), np.empty(0)
        now_from_then = prediction[0].inverse @ m.poses[0] if prediction and m.poses else None
        if now_from_then is None:
            guess = _found_again(m.image, image, m.pixels, (0.0,))
        else:
            depth = m.depth if np.isfinite(m.depth).any() else self._swept(m, image, now_from_then)
            guess = self._transfer(m.pixels, depth, now_from_then, self._cameras[0])
            if np.linalg.norm(guess - m.pixels, axis=1).mean() > _FAR:
                guess = guess + _common_shift(m.image, image, m.pixels, guess)
        pixels, good = self._matched(m, image, guess)
        if good.mean() < _FEW:  # the prediction may be wrong as a whole
            other = self._matched(m, image, _found_again(m.image, image, m.pixels, _TURNS))
            pixels, good = other if other[1].sum() > good.sum() else (pixels, good)
        good &= _spread(m.ids, pixels, good, self._cell)
        depth = self._carried(m, pixels, now_from_then) if now_from_then is not None else m.depth
        return m.ids[good], pixels[good], depth[good]

    def _matched(self, m: _Memory, image: U8, guess: F32) -> tuple[F32, Mask]:
        then, start = turned(m.image, m.pixels, guess)
        return self._match(then, image, start, guess, self._cameras[0])

    def _swept(self, m: _Memory, image: U8, now_from_then: Pose) -> F64:
        """One depth for all features when none is known: the plane across the view that makes the pictures agree (M1c).

        Without it a camera alone could not be followed over the 127 px between two photos.
        """
        way, camera = float(np.linalg.norm(now_from_then.translation)), self._cameras[0]
        least, most = 4.0 / camera.fu, 0.6 * camera.width / camera.fu  # shift, tried in steps of an eighth
        shifts = np.geomspace(least, most, int(np.log(most / least) / _SWEEP_STEP))
        if way * camera.fu < least:
            return m.depth
        small, now = _shrunken(m.image), _shrunken(image)
        scores = [
            _agreement(small, now, m.pixels, self._transfer(m.pixels, depth, now_from_then, camera), _factor(image))
            for depth in (np.full(len(m.ids), way / s) for s in shifts)
        ]
        return np.full(len(m.ids), way / shifts[int(np.argmax(scores))])

    def _carried(self, m: _Memory, pixels: F32, now_from_then: Pose) -> F64:
        """Depths in the present view: by parallax where there is enough, else the old ones carried on."""
        camera = self._cameras[0]
        then, now = normalise(camera, m.pixels.astype(np.float64)), normalise(camera, pixels.astype(np.float64))
        w, arm = inverse_depth(then, now, now_from_then)
        z = np.where(w * arm * camera.fu > _PARALLAX, 1.0 / np.maximum(w, 1e-9), m.depth)
        points = np.column_stack([then, np.ones(len(then))]) * z[:, None]
        return np.asarray(now_from_then.apply(points)[:, 2])

    def _flow(self, a: U8, b: U8, pixels: F32, guess: F32, levels: int) -> tuple[F32, Mask]:
        window = (self._settings.window_px, self._settings.window_px)
        options: dict[str, Any] = {"winSize": window, "maxLevel": levels - 1, "criteria": _STOP}
        there, ok, _ = cv2.calcOpticalFlowPyrLK(
            a, b, pixels, guess.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **options
        )
        return np.asarray(there), np.asarray(ok[:, 0] > 0)

    def _transfer(self, pixels: F32, depth: F64, other_from_first: Pose, other: Camera) -> F32:
        """Take pixels of the left camera at their depth (unknown: the median, else infinity) into another view."""
        known = np.isfinite(depth)
        z = np.where(known, depth, np.median(depth[known]) if known.any() else 1e6)
        points = self._cameras[0].rays(pixels) * z[:, None]
        out = other.project(other_from_first.apply(points)).astype(np.float32)
        return np.where(np.isfinite(out), out, pixels)

    def _match(self, a: U8, b: U8, pixels: F32, guess: F32, camera: Camera) -> tuple[F32, Mask]:
        """Lucas-Kanade from `a` to `b` and back; good where both agree, near the guess and inside the image."""
        s = self._settings
        there, ok = self._flow(a, b, pixels, guess, s.levels)
        back, ok_back = self._flow(b, a, there, pixels, s.levels)
        good = ok & ok_back & (np.linalg.norm(back - pixels, axis=1) < s.forward_backward_px)
        good &= np.linalg.norm(there - guess, axis=1) < s.search_px
        return there, good & _inside(there, camera)

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

    def _across(self, frame: Frame, image: U8, pixels: F32, depth: F64) -> tuple[F64, F64]:
        """Match the features of the left camera in every other camera; pixels (N, cameras, 2) and depth (N,)."""
        seen = np.full((len(pixels), len(self._cameras), 2), np.nan)
        seen[:, 0] = pixels
        for i in range(1, len(self._cameras)):
            other = frame.images[i]
            if other is not None and len(pixels):
                found, z = self._stereo(i, image, grey(other), pixels, depth)
                seen[:, i] = found
                depth = np.where(np.isfinite(z), z, depth)
        return seen, depth

    def _stereo(self, i: int, left: U8, right: U8, pixels: F32, depth: F64) -> tuple[F64, F64]:
        """Match along the epipolar line from the expected disparity on; pixels (N, 2) and depth (N,), NaN = none."""
        pose, camera = self._cam_from_first[i], self._cameras[i]
        there, good = self._match(left, right, pixels, self._transfer(pixels, depth, pose, camera), camera)
        found = np.where(good[:, None], there.astype(np.float64), np.nan)
        a, b = normalise(self._cameras[0], pixels.astype(np.float64)), normalise(camera, found)
        with np.errstate(invalid="ignore", divide="ignore"):
            w, arm = inverse_depth(a, b, pose)
            good &= epipolar_distance(a, b, pose) * camera.fu < self._settings.epipolar_px
            good &= w > -2.0 / (camera.fu * arm)  # behind the camera by more than two pixels: a wrong match
            z = np.where(good & (w * arm * camera.fu > 1.0), 1.0 / w, np.nan)  # under a pixel it says nothing
        found[~good] = np.nan
        return found, z

    def _record(self, t_ns: int, ids: Ids, pixels: F64, texture: F64) -> Tracks:
        normalised = np.full_like(pixels, np.nan)
        for i, camera in enumerate(self._cameras):
            normalised[:, i] = normalise(camera, pixels[:, i])
        return Tracks(t_ns, ids, pixels, normalised, texture)


def turned(image: U8, pixels: F32, guess: F32) -> tuple[U8, F32]:
    """Turn, scale and shear an earlier image as a whole to how the motion lets expect the present one (M1b).

    The SSD window only shifts: at 0.03 rad a frame its matches drift by 0.17 px in five frames, so by 0.014 px; on the
    sample flight the relative error over a second falls from 0.091 to 0.037 px and the tilt from 1.9 to 0.5 mrad.
    Returns the image and the features' (N, 2) places in it; unchanged where there are too few to tell.
    """
    if len(pixels) < _LEAST:
        return image, pixels
    ones = np.column_stack([pixels, np.ones(len(pixels))]).astype(np.float64)
    affine = np.linalg.lstsq(ones, guess.astype(np.float64), rcond=None)[0].T
    back = np.linalg.inv(np.vstack([affine, [0.0, 0.0, 1.0]]))[:2].astype(np.float32)
    y, x = np.indices(image.shape, dtype=np.float32)
    u, v = (row[0] * x + row[1] * y + row[2] for row in back)
    # linear as the matching itself samples: cubic doubles the drift; cv2.warpAffine rounds places to 1/32 px
    warped = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped), (ones @ affine.T).astype(np.float32)


def _common_shift(then: U8, now: U8, pixels: F32, guess: F32) -> F32:
    """Return the (2,) px that all guesses are off by alike: a degree of tilt is 34 px, more than a search may bound."""
    a, b = _shrunken(then), _shrunken(now)
    k = _factor(now)
    warped, there = _warped(a, b, pixels, guess, k)
    r = _REACH // k
    if there.mean() < _OVERLAP or min(a.shape) <= 4 * r:
        return np.zeros(2, np.float32)
    high = [_high(warped), _high(b)]
    inner = high[0][r:-r, r:-r] * there[r:-r, r:-r]
    score = cv2.matchTemplate(high[1], inner, cv2.TM_CCORR_NORMED, mask=there[r:-r, r:-r].astype(np.float32))
    y, x = np.unravel_index(int(np.argmax(score)), score.shape)
    return np.array([(x - r) * k, (y - r) * k], np.float32)


def _found_again(then: U8, now: U8, pixels: F32, turns: tuple[float, ...]) -> F32:
    """Where (N, 2) pixels of one picture are in another of which nothing is known: turned about the axis and shifted.

    Phase correlation of shrunken pictures; the turn whose peak is the highest.
    """
    middle = (np.array([then.shape[1], then.shape[0]], np.float64) - 1.0) / 2.0
    k, a, b = _factor(now), _shrunken(then), _shrunken(now)
    window = cv2.createHanningWindow((b.shape[1], b.shape[0]), cv2.CV_32F)
    best, found = -1.0, pixels
    for turn in turns:
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        guess = ((pixels - middle) @ R.T + middle).astype(np.float32)
        warped, _ = _warped(a, b, pixels, guess, k)
        shift, peak = cv2.phaseCorrelate(_high(warped), _high(b), window)
        if peak > best:
            best, found = peak, guess + np.array(shift, np.float32) * k
    return found.astype(np.float32)


def _high(image: U8) -> F32:
    """A picture less its slow changes."""
    x = image.astype(np.float32)
    return np.asarray(x - cv2.GaussianBlur(x, (0, 0), 4.0), dtype=np.float32)


def _factor(image: U8) -> int:
    return max(1, round(int(min(image.shape)) / _SMALL))


def _shrunken(image: U8) -> U8:
    k = 1.0 / _factor(image)
    return np.asarray(cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA))


def _warped(then: U8, now: U8, pixels: F32, guess: F32, factor: int) -> tuple[U8, Mask]:
    """A shrunken picture under the affine map from `pixels` to `guess` (full size), and where it has something."""
    a, b = ((x.astype(np.float64) + 0.5) / factor - 0.5 for x in (pixels, guess))
    affine = np.linalg.lstsq(np.column_stack([a, np.ones(len(a))]), b, rcond=None)[0].T
    size = (now.shape[1], now.shape[0])
    there = cv2.warpAffine(np.ones_like(then), affine, size, flags=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.warpAffine(then, affine, size)), np.asarray(there)


def _agreement(then: U8, now: U8, pixels: F32, guess: F32, factor: int) -> float:
    """Correlation of two shrunken pictures where the affine map from `pixels` to `guess` (full size) overlaps them."""
    warped, there = _warped(then, now, pixels, guess, factor)
    if there.mean() < _OVERLAP:
        return -1.0
    x, y = warped[there].astype(np.float64), now[there].astype(np.float64)
    return float(np.corrcoef(x, y)[0, 1]) if x.std() > 0 and y.std() > 0 else -1.0


def strength(image: U8, pixels: F32, window_px: int) -> F64:
    """Return the (N,) Shi-Tomasi response a pixel over the SSD window: how sharp the minimum of the SSD is."""
    response = cv2.cornerMinEigenVal(image, window_px)
    height, width = image.shape
    x = np.clip(np.round(pixels[:, 0]).astype(int), 0, width - 1)
    y = np.clip(np.round(pixels[:, 1]).astype(int), 0, height - 1)
    return np.asarray(response[y, x], dtype=np.float64)


def _inside(pixels: F32, camera: Camera) -> Mask:
    x, y = pixels[:, 0], pixels[:, 1]
    b = _BORDER
    return np.asarray((x >= b) & (y >= b) & (x <= camera.width - 1 - b) & (y <= camera.height - 1 - b))


def _cells(pixels: F32, cell: float) -> list[tuple[int, int]]:
    """(column, row) of the grid cell that each pixel lies in."""
    return [(int(x), int(y)) for x, y in np.floor(np.nan_to_num(pixels) / cell)]


def _spread(ids: Ids, pixels: F32, good: Mask, cell: float) -> Mask:
    """Keep the `_PER_CELL` oldest good features of every cell: converging tracks add cost and no information."""
    keep = np.zeros(len(ids), bool)
    count: dict[tuple[int, int], int] = {}
    for i, key in enumerate(_cells(pixels, cell)):  # ids grow with the row, so the oldest come first
        if good[i] and count.get(key, 0) < _PER_CELL:
            count[key] = count.get(key, 0) + 1
            keep[i] = True
    return keep


def corners(image: U8, taken: F32, cell: float, texture: float) -> F32:
    """Return the best Shi-Tomasi corner of every grid cell that holds no feature yet, (N, 2) pixels.

    Args:
        taken: (M, 2) pixels of the features that are there; new ones keep 0.7 of a cell away.
        cell: px, side of a cell.
        texture: least response.
    """
    response = cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (3, 3), 0), 5)
    b = _BORDER + 4
    response[:b], response[-b:], response[:, :b], response[:, -b:] = 0, 0, 0, 0
    for x, y in taken:
        cv2.circle(response, (round(float(x)), round(float(y))), max(2, int(0.7 * cell)), 0.0, -1)
    used, found = set(_cells(taken, cell)), []
    rows, cols = (int(np.ceil(n / cell)) for n in response.shape)
    for row, col in ((r, c) for r in range(rows) for c in range(cols) if (c, r) not in used):
        y, x = int(np.ceil(row * cell)), int(np.ceil(col * cell))
        part = response[y : int(np.ceil((row + 1) * cell)), x : int(np.ceil((col + 1) * cell))]
        r, c = divmod(int(part.argmax()), part.shape[1]) if part.size else (0, 0)
        if part.size and part[r, c] > texture:
            found.append((x + c, y + r))
    return np.array(found, np.float32).reshape(-1, 2)
