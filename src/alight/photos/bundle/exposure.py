"""Exposure gains of photos: factors of their colours with which all photos show the same ground alike.

With automatic exposure, the same ground may be twice as bright in the next photo. The factors follow from the points
that photos share: `log c_ip + g_i = a_p` for photo i, point p and each colour, by least squares (eq. 12 in
docs/method/bundle.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from alight.arrays import F64, I64, Mask
from alight.photos.bundle.features import PhotoFeatures
from alight.photos.bundle.matching import BundleObservations
from alight.spread import SIGMA_OF_MAD

TIE = 0.02  # weight of the prior that a photo's factor is 1, as a share of its observations


def exposure_gains(features: Sequence[PhotoFeatures], obs: BundleObservations) -> F64:
    """Compute factors of the colours of each photo that make the same ground look alike in all photos.

    Args:
        features: features of all photos, with colours.
        obs: observations of points seen in several photos.

    Returns:
        (n, 3) factors of red, green and blue, 1/4 to 4; 1 where no shared points determine them.
    """
    colour = np.full((len(obs.photo), 3), np.nan)
    for i in np.unique(obs.photo):
        rows, of = np.flatnonzero(obs.photo == i), features[i]
        if len(of.pixels):
            away, which = cKDTree(of.pixels).query(obs.pixels[rows])
            colour[rows] = np.where(away[:, None] < 1e-6, of.colours[which], np.nan)
    known = np.all((colour > 8.0) & (colour < 245.0), axis=1)  # exclude noise and overexposure
    obs, value = _of(obs, known, np.log(np.where(known[:, None], colour, 1.0)))
    out = np.zeros((len(features), 3))
    for _ in range(3 if len(value) else 0):
        out = _solved(obs, value, len(features))
        off = value + out[obs.photo]
        off -= _means(obs, off)[obs.point]
        sigma = np.maximum(SIGMA_OF_MAD * np.median(np.abs(off), axis=0), 1e-6)
        obs, value = _of(obs, np.all(np.abs(off) < 3.0 * sigma, axis=1), value)  # exclude cars and glints
    return np.asarray(np.exp(out).clip(1 / 4.0, 4.0))


def _of(obs: BundleObservations, rows: Mask, value: F64) -> tuple[BundleObservations, F64]:
    """Return observations and their rows of `value` (N, 3) where `rows` is True, without points left with one photo."""
    rows = rows & (np.bincount(obs.point[rows], minlength=obs.points)[obs.point] >= 2)
    return obs.keep(rows)[0], value[rows]


def _means(obs: BundleObservations, value: F64) -> F64:
    count: I64 = np.bincount(obs.point, minlength=obs.points)
    return np.stack([np.bincount(obs.point, v, obs.points) for v in value.T], axis=1) / np.maximum(count, 1)[:, None]


def _solved(obs: BundleObservations, value: F64, photos: int) -> F64:
    """Return the logarithms (n, 3) of factors for n = `photos` photos from the logarithms `value` (N, 3) of colours."""
    if not len(value):
        return np.zeros((photos, 3))
    count, each = np.bincount(obs.photo, minlength=photos), np.bincount(obs.point)
    shared = sparse.coo_array((1 / np.sqrt(each[obs.point]), (obs.photo, obs.point)), shape=(photos, obs.points))
    normal = np.diag((1.0 + TIE) * count + (count == 0)) - (shared @ shared.T).toarray()
    off = value - _means(obs, value)[obs.point]
    right = np.stack([np.bincount(obs.photo, v, photos) for v in off.T], axis=1)
    return np.asarray(np.linalg.solve(normal, -right))
