"""Attitude out of pictures and GPS alone: where a camera that looks down flew to, in its own image (M26)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.records import F64, Tracks

SIGMA = np.array([0.1, 0.1, 0.05])  # rad about east, north, up: looking down is only assumed
_LEAST = 12  # features
_ROUNDS, _PAIRS = 6, 100
_CUT = 0.01  # of normalised coordinates: features off by more stand higher than the ground, or are wrong
WAY = 0.5  # m, least distance of two GPS positions whose direction is used


def attitude_from_course(then: Tracks, now: Tracks, way: F64, body_from_cam: Pose) -> F64 | None:
    """Return world_from_body (3, 3) at `now`, for a camera that looks straight down; None: the pictures do not tell.

    The ground moves against the flight: a similarity from the one picture to the other gives the direction of flight in
    the second, GPS gives it in the world.

    Args:
        way: (3,) m, GPS position now less that then.
    """
    _, i, j = np.intersect1d(then.ids, now.ids, return_indices=True)
    a, b = (_complex(t.normalised[k, 0]) for t, k in ((then, i), (now, j)))
    seen = np.isfinite(a) & np.isfinite(b)
    shift = _shift(a[seen], b[seen]) if seen.sum() >= _LEAST else None
    if shift is None or np.hypot(way[0], way[1]) < WAY:
        return None
    right = np.arctan2(way[1], way[0]) + np.angle(-shift)  # course of the image's x axis, from east
    c, s = np.cos(right), np.sin(right)
    world_from_cam = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    return np.asarray(world_from_cam @ body_from_cam.rotation.T)


def _complex(z: F64) -> NDArray[np.complex128]:
    return np.asarray(z[:, 0] + 1j * z[:, 1])


def _shift(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> complex | None:
    """The shift t of the similarity b = c a + t, by least squares with outliers left out; None: hardly any.

    It starts from the two features that most others agree with, for the pictures may be turned by anything.
    """
    i, j = np.random.default_rng(0).integers(0, len(a), (2, _PAIRS))
    c = (b[j] - b[i]) / np.where(i == j, 1.0, a[j] - a[i])
    off = np.abs(c[:, None] * a + (b[i] - c * a[i])[:, None] - b)
    use = off[int(np.argmax((off < 3.0 * _CUT).sum(axis=1)))] < 3.0 * _CUT
    for _ in range(_ROUNDS):
        if use.sum() < _LEAST:
            return None
        (c, t), *_ = np.linalg.lstsq(np.column_stack([a[use], np.ones(int(use.sum()))]), b[use], rcond=None)
        off = np.abs(c * a + t - b)
        use = off < max(_CUT, 3.0 * float(np.median(off[use])))
    return complex(t) if abs(t) > _CUT else None
