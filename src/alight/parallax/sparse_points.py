"""Height of the ground before there is a map: points triangulated from pairs of posed views.

They give the height range that the sweep searches, and the ground sampling distance. Features are matched by
descriptors, not tracked, so video and photos far apart work alike, with poses from any source.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from alight.arrays import F32, F64
from alight.raster import grey_levels
from alight.records import View
from alight.settings.tuning.parallax import PointsTuning

NO_POINTS = np.empty((0, 3))


class ViewFeatures(NamedTuple):
    """SIFT features of one view."""

    centre: F64  # (3,) camera centre, metres
    rays: F64  # (N, 3) unit directions in the world
    descriptors: F32  # (N, 128)


class Features:
    """SIFT features of the 64 views that were used last, each view's detected once."""

    def __init__(self, tuning: PointsTuning) -> None:
        self._tuning, self._detected = tuning, OrderedDict[tuple[int, int], tuple[F64, F32]]()

    def of(self, view: View) -> ViewFeatures:
        """Return the features of a view with its present pose; time and camera identify its image."""
        key = view.t_ns, view.cam
        found = self._detected.pop(key) if key in self._detected else self._detect(view)
        self._detected[key] = pixels, descriptors = found
        if len(self._detected) > 64:
            self._detected.popitem(last=False)
        rays = view.camera.rays(pixels) @ view.world_from_cam.rotation.T
        return ViewFeatures(view.centre, rays / np.linalg.norm(rays, axis=1, keepdims=True), descriptors)

    def _detect(self, view: View) -> tuple[F64, F32]:
        """Return pixels (N, 2) and descriptors; weak features are included only if there are too few strong ones."""
        grey, tuning = grey_levels(view.image), self._tuning
        scale = min(1.0, tuning.longest_px / max(grey.shape))
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
        contrast, grey_level = tuning.contrast, 1 / 255
        while True:  # faint features spoil the matches of strong ones: small pictures would lose heights
            sift = cv2.SIFT_create(tuning.features, contrastThreshold=contrast)  # type: ignore[attr-defined]
            found, descriptors = sift.detectAndCompute(small, None)
            if len(found) >= tuning.enough_features or contrast / 2 < grey_level:
                break
            contrast /= 2
        return (np.array([k.pt for k in found], dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5, descriptors


def triangulate_pair(ca: F64, rays_a: F64, cb: F64, rays_b: F64) -> tuple[F64, F64, F64]:
    """Triangulate pairs of unit rays (N, 3) from the camera centres `ca` and `cb` (3,) by the midpoint method.

    Returns:
        The points (N, 3); the sine of the angle between the rays (N,); the distance between the two rays over the
        distance to the nearer camera (N,), infinite where the point lies behind a camera.
    """
    base = cb - ca
    dot = (rays_a * rays_b).sum(1)
    pa, pb = rays_a @ base, rays_b @ base
    det = np.maximum(1 - dot**2, 1e-12)
    ta, tb = (pa - dot * pb) / det, (dot * pa - pb) / det
    A, B = ca + ta[:, None] * rays_a, cb + tb[:, None] * rays_b
    miss = np.linalg.norm(A - B, axis=1) / np.maximum(np.minimum(ta, tb), 1e-6)
    miss[(ta <= 0) | (tb <= 0)] = np.inf
    return 0.5 * (A + B), np.sqrt(det), miss


def pair_points(a: ViewFeatures, b: ViewFeatures, tuning: PointsTuning) -> tuple[F64, float]:
    """Return the points (M, 3) of a pair of views, below both cameras, and the median angle of matched rays, rad.

    There are no points if that angle is too small, because most rays with a larger angle are then wrong matches. The
    angle is infinite if there are too few matches.
    """
    if len(a.rays) < 2 or len(b.rays) < 2:
        return NO_POINTS, np.inf
    best, ratio = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.descriptors, b.descriptors, k=2), tuning.descriptor_ratio
    m = np.array([(i.queryIdx, i.trainIdx) for i, second in best if i.distance < ratio * second.distance])
    if len(m) < 12:
        return NO_POINTS, np.inf
    points, angle, miss = triangulate_pair(a.centre, a.rays[m[:, 0]], b.centre, b.rays[m[:, 1]])
    good, median = (angle > tuning.least_angle) & (miss < 0.01), float(np.median(angle))
    good &= points[:, 2] < min(a.centre[2], b.centre[2])
    return (points[good] if good.sum() >= 8 and median > tuning.least_angle else NO_POINTS), median


def find_points(views: Sequence[View], tuning: PointsTuning, features: Features | None = None) -> F64:
    """Return points (N, 3) of the scene, metres in the world, triangulated from pairs of `views` in order of time.

    `features`: store of those of earlier searches; None: all are detected.
    """
    # the stride between the views of a pair doubles until their rays meet at three times `least_angle` or overlap ends
    views, features = [v for v in views if v.cam == views[0].cam], features or Features(tuning)

    def of(i: int) -> ViewFeatures:
        return features.of(views[i])

    found, stride, count = [], 1, len(views)
    starts = np.linspace(0, max(count - 2, 0), min(tuning.most_pairs, max(count - 1, 1))).astype(int)
    for i in np.unique(starts).tolist():
        while i + stride < len(views):
            points, angle = pair_points(of(i), of(i + stride), tuning)
            if angle < 3 * tuning.least_angle and i + 2 * stride < len(views):
                stride *= 2
                continue
            if not len(points) and stride > 1:
                stride //= 2
                points, angle = pair_points(of(i), of(i + stride), tuning)
            found.append(points)
            break
    points = np.concatenate(found) if found else NO_POINTS
    return supported(points, float(np.median([v.centre[2] for v in views])), tuning)


def is_within(views: Sequence[View], height: float, tuning: PointsTuning, features: Features) -> bool:
    """Whether the ground is at most `height` metres below the cameras by the first and last view, or they cannot tell.

    It takes two views, where `find_points` takes all.
    """
    first, last = views[0], [v for v in views if v.cam == views[0].cam][-1]
    points, angle = pair_points(features.of(first), features.of(last), tuning)
    if not len(points):
        return angle > tuning.least_angle  # they show different ground, or too little of the same
    return bool(last.centre[2] - np.median(points[:, 2]) <= height)


def supported(points: F64, height_of_camera: float, tuning: PointsTuning) -> F64:
    """Return the points (M, 3) whose heights agree with enough neighbours; all other points may be wrong matches.

    `height_of_camera`: metres, above the origin like the points.
    """
    if len(points) <= tuning.neighbours:
        return points
    like = tuning.like_height * max(height_of_camera - float(np.median(points[:, 2])), 1.0)
    _, near = cKDTree(points[:, :2]).query(points[:, :2], tuning.neighbours + 1)
    agree = np.abs(points[near[:, 1:], 2] - points[:, 2:]) < like
    return np.asarray(points[agree.sum(axis=1) >= tuning.supporters])


def height_range(
    points: F64, height_of_camera: float, near: tuple[float, float, float] | None = None
) -> tuple[float, float]:
    """Return the lowest and highest height to search, metres: the span of the points and a margin.

    The margin covers ground without points (tree tops, holes). The range ends below the camera by a fifth of the height
    above ground, unless points lie higher.

    Args:
        points: (N, 3) metres.
        height_of_camera: metres, to scale the margins.
        near: (east, north, radius), metres: only points within the radius are used, if there are enough of them.
    """
    z = points[:, 2]
    if near is not None:
        close = np.hypot(points[:, 0] - near[0], points[:, 1] - near[1]) < near[2]
        z = z[close] if close.sum() >= 40 else z
    low, middle, high = np.percentile(z, [0.5, 50, 99.5])
    drop = max(height_of_camera - middle, 1.0)
    above = max(min(high + 0.05 * drop + 0.5, height_of_camera - 0.2 * drop), high)
    return float(low - 0.02 * drop - 0.3), float(above)
