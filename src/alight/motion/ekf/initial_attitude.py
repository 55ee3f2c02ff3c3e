"""Initial attitude without INS: the course over ground by GPS against the motion in the image (M26)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Pose
from alight.records import Tracks

COURSE_ATTITUDE_SIGMA = np.array([0.1, 0.1, 0.05])  # rad about east, north, up; the camera is assumed to look down
MIN_GPS_BASELINE = 0.5  # m between two GPS positions whose direction is used
_MIN_FEATURES = 12
_ROUNDS, _PAIRS = 6, 100
_INLIER = 0.01  # normalised coordinates; features with a larger residual are off the ground plane, or wrong


def attitude_from_course(before: Tracks, now: Tracks, baseline_world: F64, body_from_cam: Pose) -> F64 | None:
    """Return world_from_body (3, 3) at `now` for a camera that looks straight down; None: images do not determine it.

    The ground moves against the direction of flight. A similarity from one image to the other gives that direction in
    the image, GPS gives it in the world.

    Args:
        before, now: tracks of two exposures.
        baseline_world: (3,) m, GPS position of `now` less that of `before`.
        body_from_cam: of the camera.
    """
    _, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
    a, b = (_complex(t.normalised[k, 0]) for t, k in ((before, i), (now, j)))
    both = np.isfinite(a) & np.isfinite(b)
    shift = _robust_shift(a[both], b[both]) if both.sum() >= _MIN_FEATURES else None
    if shift is None or np.hypot(baseline_world[0], baseline_world[1]) < MIN_GPS_BASELINE:
        return None
    x_axis = np.arctan2(baseline_world[1], baseline_world[0]) + np.angle(-shift)  # of the image, from east
    c, s = np.cos(x_axis), np.sin(x_axis)
    world_from_cam = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    return np.asarray(world_from_cam @ body_from_cam.rotation.T)


def _complex(z: F64) -> NDArray[np.complex128]:
    """Return (N, 2) coordinates as (N,) complex numbers: a similarity is then linear."""
    return np.asarray(z[:, 0] + 1j * z[:, 1])


def _robust_shift(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> complex | None:
    """Return the shift t of the similarity b = c a + t, by least squares without outliers; None: no clear motion.

    It starts from the pair of features with the most inliers, since the images may be rotated by any angle.
    """
    i, j = np.random.default_rng(0).integers(0, len(a), (2, _PAIRS))
    c = (b[j] - b[i]) / np.where(i == j, 1.0, a[j] - a[i])
    residual = np.abs(c[:, None] * a + (b[i] - c * a[i])[:, None] - b)
    used = residual[int(np.argmax((residual < 3.0 * _INLIER).sum(axis=1)))] < 3.0 * _INLIER
    for _ in range(_ROUNDS):
        if used.sum() < _MIN_FEATURES:
            return None
        (c, t), *_ = np.linalg.lstsq(np.column_stack([a[used], np.ones(int(used.sum()))]), b[used], rcond=None)
        residual = np.abs(c * a + t - b)
        used = residual < max(_INLIER, 3.0 * float(np.median(residual[used])))
    return complex(t) if abs(t) > _INLIER else None
