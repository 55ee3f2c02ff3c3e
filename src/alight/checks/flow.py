"""Motion of the picture between two exposures: feature flow without any prediction, and the homography that fits it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, U8
from alight.geometry import Camera

LONG_SIDE = 640  # px, of the pictures in which features are followed
FEATURES = 300
LEAST_FEATURES = 25
ROUND_TRIP = 0.7  # px, largest distance of a feature followed there and back from its start
RANSAC = 2.5  # px of the small picture
REACH = 1.0  # of the grid: largest x/z and y/z, so that a fisheye's border does not decide
_SPOTS = (0.15, 0.5, 0.85)  # of the picture's width and height


@dataclass(frozen=True, eq=False)
class PictureFlow:
    """Motion of one camera's picture from one exposure to a later one."""

    begin_ns: int
    end_ns: int
    homography: F64  # (3, 3) later from earlier, normalised coordinates x/z, y/z
    shift: F64  # (2,) median motion of the features, px
    share: float  # of the features that follow the homography


def downscaled(image: U8) -> tuple[U8, int]:
    """Return a grey version whose longer side is at most `LONG_SIDE`, and the factor by which it is smaller."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    k = -(-max(grey.shape) // LONG_SIDE)
    if k > 1:
        grey = cv2.resize(grey, (grey.shape[1] // k, grey.shape[0] // k), interpolation=cv2.INTER_AREA)
    return np.asarray(grey, dtype=np.uint8), k


def grid_of(lens: Camera) -> F64:
    """Return the (9, 2) normalised coordinates, x/z and y/z, at which the flow of a camera is compared."""
    u, v = np.meshgrid([s * lens.width for s in _SPOTS], [s * lens.height for s in _SPOTS])
    return np.clip(lens.rays(np.stack([u.ravel(), v.ravel()], -1))[:, :2], -REACH, REACH)


def followed(then: U8, now: U8) -> tuple[F32, F32]:
    """Return (N, 2) pixels of features in one picture and in another: Lucas and Kanade (1981), there and back."""
    found = cv2.goodFeaturesToTrack(then, FEATURES, 0.005, max(3.0, max(then.shape) / 50.0))
    nothing = np.empty((0, 2), np.float32)
    if found is None:
        return nothing, nothing
    there, seen, _ = cv2.calcOpticalFlowPyrLK(then, now, found, None, winSize=(15, 15), maxLevel=4)
    back, again, _ = cv2.calcOpticalFlowPyrLK(now, then, there, None, winSize=(15, 15), maxLevel=4)
    a, b, c = (x.reshape(-1, 2) for x in (found, there, back))
    good = (seen.ravel() > 0) & (again.ravel() > 0) & (np.linalg.norm(a - c, axis=1) < ROUND_TRIP)
    good &= ((b > 0) & (b < [now.shape[1] - 1, now.shape[0] - 1])).all(axis=1)
    return a[good], b[good]


def picture_flow(then: U8, now: U8, factor: int, lens: Camera, begin_ns: int, end_ns: int) -> PictureFlow | None:
    """Fit the homography of two small pictures of a camera; None where too few features agree.

    Args:
        factor: by which the pictures are smaller than those of `lens`.
    """
    a, b = followed(then, now)
    if len(a) < LEAST_FEATURES:
        return None
    full = [(p.astype(np.float64) + 0.5) * factor - 0.5 for p in (a, b)]
    x, y = (lens.rays(p)[:, :2] for p in full)
    H, inside = cv2.findHomography(x * lens.fu, y * lens.fu, cv2.RANSAC, RANSAC * factor)
    if H is None or inside.sum() < LEAST_FEATURES:
        return None
    scale = np.diag([lens.fu, lens.fu, 1.0])
    H = np.linalg.inv(scale) @ H @ scale
    return PictureFlow(begin_ns, end_ns, H / H[2, 2], np.median(full[1] - full[0], axis=0), float(inside.mean()))


def moved(homography: F64, points: F64) -> F64:
    """Take (N, 2) normalised coordinates, or (K, N, 2) by (K, 3, 3), through homographies."""
    p = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ np.swapaxes(homography, -1, -2)
    return np.asarray(p[..., :2] / p[..., 2:])
