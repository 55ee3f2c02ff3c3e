"""Features of pictures, without any prediction: tracked in time to fit a homography, and matched across the rig."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Camera
from alight.raster import grey_levels

LEAST_FEATURES = 25  # least number of features to fit a homography
LEAST_MATCHES = 40


@dataclass(frozen=True, eq=False)
class PictureFlow:
    """Motion of one camera's picture from one exposure to a later one."""

    begin_ns: int
    end_ns: int
    homography: F64  # (3, 3) later from earlier, normalised coordinates x/z, y/z
    shift: F64  # (2,) median motion of the features, px
    share: float  # share of the features that follow the homography


def downscaled(image: U8, longest: int) -> tuple[U8, int]:
    """Return a grey picture reduced to at most `longest` pixels on its longer side, and the reduction factor."""
    grey = grey_levels(image)
    k = -(-max(grey.shape) // longest)
    if k > 1:
        grey = cv2.resize(grey, (grey.shape[1] // k, grey.shape[0] // k), interpolation=cv2.INTER_AREA)
    return np.asarray(grey, dtype=np.uint8), k


def full_size(pixels: F32 | F64, factor: int) -> F64:
    """Convert pixel coordinates in a picture reduced by `factor` to pixel coordinates in the full picture."""
    return np.asarray((pixels.astype(np.float64) + 0.5) * factor - 0.5)


def grid_of(lens: Camera) -> F64:
    """Return the (9, 2) normalised coordinates, x/z and y/z, at which the flow of a camera is compared."""
    spots = np.array([0.15, 0.5, 0.85])
    u, v = np.meshgrid(spots * lens.width, spots * lens.height)
    return np.clip(lens.rays(np.stack([u.ravel(), v.ravel()], -1))[:, :2], -1.0, 1.0)  # a fisheye's border is far out


def followed(then: U8, now: U8) -> tuple[F32, F32]:
    """Track features from grey picture `then` to `now` and back (Lucas and Kanade 1981); return both (N, 2) pixels."""
    found = cv2.goodFeaturesToTrack(then, 300, 0.005, max(3.0, max(then.shape) / 50.0))
    if found is None:
        return np.empty((0, 2), np.float32), np.empty((0, 2), np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(then, now, found, None, winSize=(15, 15), maxLevel=4)
    back, again, _ = cv2.calcOpticalFlowPyrLK(now, then, there, None, winSize=(15, 15), maxLevel=4)
    a, b, c = (x.reshape(-1, 2) for x in (found, there, back))
    good = (seen.ravel() > 0) & (again.ravel() > 0) & (np.linalg.norm(a - c, axis=1) < 0.7)  # px
    good &= ((b > 0) & (b < [now.shape[1] - 1, now.shape[0] - 1])).all(axis=1)
    return a[good], b[good]


def picture_flow(then: U8, now: U8, factor: int, lens: Camera, times_ns: tuple[int, int]) -> PictureFlow | None:
    """Fit the homography between two small pictures of a camera; None if too few features agree.

    Args:
        then, now: the earlier and the later picture, grey.
        factor: factor by which the pictures are smaller than full pictures of `lens`.
        times_ns: times of both pictures.
    """
    a, b = followed(then, now)
    if len(a) < LEAST_FEATURES:
        return None
    full = [full_size(p, factor) for p in (a, b)]
    x, y = (lens.rays(p)[:, :2] for p in full)
    H, inside = cv2.findHomography(x * lens.fu, y * lens.fu, cv2.RANSAC, 2.5 * factor)  # px of the small picture
    if H is None or inside.sum() < LEAST_FEATURES:
        return None
    scale = np.diag([lens.fu, lens.fu, 1.0])
    H = np.linalg.inv(scale) @ H @ scale
    return PictureFlow(*times_ns, H / H[2, 2], np.median(full[1] - full[0], axis=0), float(inside.mean()))


def moved(homography: F64, points: F64) -> F64:
    """Apply homographies (3, 3) or (K, 3, 3) to normalised coordinates (N, 2) or (K, N, 2)."""
    p = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ np.swapaxes(homography, -1, -2)
    return np.asarray(p[..., :2] / p[..., 2:])


def match_pictures(first: U8, other: U8) -> tuple[F64, F64]:
    """Match pictures by SIFT, with a ratio test both ways (Lowe 2004); return (N, 2) pixels of matches in both."""
    (a, da), (b, db) = _described(first), _described(other)
    if len(a) < 8 or len(b) < 8:
        return np.empty((0, 2)), np.empty((0, 2))
    there, back = _nearest(da, db), _nearest(db, da)
    at = np.flatnonzero((there >= 0) & (back[there] == np.arange(len(there))))
    return a[at], b[there[at]]


def _described(image: U8) -> tuple[F64, F64]:
    """Return pixels (N, 2) and root-normalised SIFT descriptors (N, 128) (Arandjelovic and Zisserman 2012)."""
    grey, k = downscaled(image, 1280)
    keypoints, words = cv2.SIFT.create(nfeatures=700).detectAndCompute(grey, None)
    if words is None:
        return np.empty((0, 2)), np.empty((0, 128))
    descriptors = np.sqrt(words / np.maximum(words.sum(axis=1, keepdims=True), 1e-9)).astype(np.float64)
    return full_size(np.array([p.pt for p in keypoints]), k), descriptors


def _nearest(a: F64, b: F64) -> I64:
    """Return the index of the nearest row of `b` for each row of `a`; -1 if the second nearest is nearly as near.

    `a`, `b`: (N, D) and (M, D), rows of length 1.
    """
    likeness = a @ b.T  # unit length: the nearer, the larger
    best = np.argmax(likeness, axis=1)
    rows = np.arange(len(a))
    first = likeness[rows, best]
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    return np.where(1.0 - first < 0.75**2 * (1.0 - second), best, -1)


def on_one_geometry(first: F64, other: F64, focal: float) -> Mask:
    """Mark the matches (N,) that one fundamental matrix explains, as they must in a rigid rig.

    Args:
        first, other: (N, 2) normalised coordinates in both cameras.
        focal: focal length in px, which scales the threshold.
    """
    none = np.zeros(len(first), bool)
    if len(first) < LEAST_MATCHES:
        return none
    _, inside = cv2.findFundamentalMat(first * focal, other * focal, cv2.USAC_MAGSAC, 2.0, 0.999, 5000)  # px
    return none if inside is None else np.asarray(inside.ravel() > 0)
