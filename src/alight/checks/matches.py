"""Matches between two cameras of a rig, made without their calibrated relative pose."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F64, U8

LONG_SIDE = 1280  # px, of the pictures that are matched
KEYPOINTS = 700
RATIO = 0.75  # Lowe (2004)
RANSAC = 2.0  # px from the epipolar line of the fundamental matrix that is fitted to all matches
LEAST = 40  # matches


def match_pictures(first: U8, other: U8) -> tuple[F64, F64]:
    """Return (N, 2) pixels of the same features in two pictures: SIFT, ratio test, both ways (Lowe 2004)."""
    sift = cv2.SIFT.create(nfeatures=KEYPOINTS)
    (a, da), (b, db) = (_described(sift, image) for image in (first, other))
    if len(a) < 8 or len(b) < 8:
        return np.empty((0, 2)), np.empty((0, 2))
    there, back = _nearest(da, db), _nearest(db, da)
    at = np.flatnonzero((there >= 0) & (back[there] == np.arange(len(there))))
    return a[at], b[there[at]]


def _described(sift: cv2.SIFT, image: U8) -> tuple[F64, F64]:
    """Pixels and root-normalised descriptors (Arandjelovic and Zisserman 2012)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    k = -(-max(grey.shape) // LONG_SIDE)
    if k > 1:
        grey = cv2.resize(grey, (grey.shape[1] // k, grey.shape[0] // k), interpolation=cv2.INTER_AREA)
    keypoints, words = sift.detectAndCompute(grey, None)
    if words is None:
        return np.empty((0, 2)), np.empty((0, 128))
    pixels = (np.array([p.pt for p in keypoints]) + 0.5) * k - 0.5
    return pixels, np.sqrt(words / np.maximum(words.sum(axis=1, keepdims=True), 1e-9)).astype(np.float64)


def _nearest(a: F64, b: F64) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Index of the nearest row of `b` for each row of `a`; -1 where the second nearest is nearly as near."""
    likeness = a @ b.T  # unit length: the nearer, the larger
    best = np.argmax(likeness, axis=1)
    rows = np.arange(len(a))
    first = likeness[rows, best]
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    return np.where(1.0 - first < RATIO**2 * (1.0 - second), best, -1)


def on_one_geometry(first: F64, other: F64, focal: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Mark the (N,) matches, in normalised coordinates, that one fundamental matrix explains: a rig is rigid.

    Args:
        focal: px, for the threshold.
    """
    if len(first) < LEAST:
        return np.zeros(len(first), bool)
    _, inside = cv2.findFundamentalMat(first * focal, other * focal, cv2.USAC_MAGSAC, RANSAC, 0.999, 5000)
    return np.zeros(len(first), bool) if inside is None else np.asarray(inside.ravel() > 0)
