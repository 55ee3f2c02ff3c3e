"""Motion detection by temporal consistency: synchronous cameras of a rig agree with each other, not with the template.

Light on waves, the edge of a drifting shadow, a car or a swaying blade of grass looks alike to two cameras at one time,
and different a moment later. Still ground looks alike at all times; noise is alike in no two views. So deviations that
synchronous views share separate the effect of time from that of the baseline, which the residual alone cannot do. A rig
of one camera has no such pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, I64, U8, U16, Mask
from alight.parallax import consistency_kernels as kernels
from alight.parallax.gauss_newton import Fit
from alight.parallax.views import BLOCK
from alight.raster import upsample
from alight.records import ElevationMap, Flag, View, is_trusted
from alight.settings.tuning.parallax import UncertaintyTuning

SIDE = 2  # instants that must show the ground before a change, and after it
AROUND = 3  # blocks across the window of the sums for a change or a contradiction


def instants(views: Sequence[View]) -> I64:
    """Return the index pairs (K, 2) of views of the same exposure by different cameras."""
    at: dict[int, list[int]] = {}
    for i, v in enumerate(views):
        at.setdefault(v.t_ns, []).append(i)
    found = [(i, j) for same in at.values() for i, j in combinations(same, 2) if views[i].cam != views[j].cam]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def shared(samples: F32, pairs: I64, mean: F32, seen: U8, tuning: UncertaintyTuning) -> F32:
    """Return the share of the variance that views of one instant have in common beyond the template (eq. 15a).

    Args:
        samples: (N, R, C) normalised grey, NaN outside a picture.
        pairs: (K, 2) indices of synchronous views.
        mean: (R, C) template of all views.
        seen: (R, C) number of views that see the cell.

    Returns:
        (R / BLOCK, C / BLOCK), rounded up; 0 where too few views see the block, negative where the deviations of paired
        views have opposite signs.
    """
    sums = np.empty((5, *(-(-n // BLOCK) for n in mean.shape)), np.float32)
    kernels.common(samples, pairs, mean, BLOCK, tuning.cut, sums)
    both, own, count, square, known = (cv2.blur(s, (tuning.near, tuning.near)) for s in sums)
    views = cv2.resize(seen, count.shape[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    enough = (count >= tuning.least_seen * BLOCK * BLOCK) & (views >= tuning.least_views)
    number, cells = np.where(enough, count, np.float32(1)), np.maximum(known, 1)
    both /= (1 - 2 / np.maximum(views, tuning.least_views)) * number  # because a pair attracts the template
    return np.where(enough, both / np.maximum(own / number + square / cells, np.float32(1e-3)), np.float32(0))


def moving(samples: F32, pairs: I64, fit: Fit, tuning: UncertaintyTuning) -> U16:
    """Return (R, C) MOVING flags where synchronous views share a deviation from the template of `fit`; see `shared`."""
    if not len(pairs):
        return np.zeros(fit.grid.shape, np.uint16)
    share = shared(samples, pairs, fit.mean, fit.seen, tuning)
    bits = np.where(share > tuning.most_shared, np.uint16(Flag.MOVING), np.uint16(0))
    return upsample(bits, BLOCK, fit.grid.shape)


def changed_since(samples: F32, pairs: I64, times: I64, tuning: UncertaintyTuning) -> Mask:
    """Return a mask (R, C) of ground that looks different since some instant: somebody stopped there or left (eq. 16d).

    The views before that instant agree with each other, and so do the views after it. The larger group would pass for
    the ground, at the height of the map. `times` (N,) are the times of the views, ns; the other arguments are as in
    `shared`. The mask is constant over blocks.
    """
    at, first = np.unique(times[pairs[:, 0]], return_index=True)
    if len(at) < 2 * SIDE:
        return np.zeros(samples.shape[1:], np.bool_)
    shape = tuple(-(-n // BLOCK) for n in samples.shape[1:])
    between = np.empty((len(at) - 1, *shape), np.float32)
    whole, count = np.empty(shape, np.float32), np.empty(shape, np.float32)
    kernels.before_and_after(samples, pairs[first], BLOCK, SIDE, between, whole, count)
    window = (AROUND, AROUND)
    whole, count = cv2.blur(whole, window), cv2.blur(count, window)
    most = np.max([cv2.blur(b, window) for b in between], axis=0)
    enough = count >= 2 * SIDE * tuning.least_seen * BLOCK * BLOCK
    found = enough & (most > tuning.changed * whole) & (whole > tuning.least_change * count)
    return upsample(found, BLOCK, samples.shape[1:])


class Contradicted(NamedTuple):
    """Masks (R, C) of ground on which the views disagree (eq. 16e), constant over blocks."""

    wrong: Mask  # cells where the height of the map is wrong
    came: Mask  # cells where the views agreed before, so that somebody has come since


def contradicted(samples: F32, known: ElevationMap, tuning: UncertaintyTuning) -> Contradicted:
    """Return masks of ground on which the views disagree, because somebody stands on it (eq. 16e).

    Still ground at the height of the map looks alike to all views. Swaying plants look different at all times, so a
    small disagreement counts only where the views agreed when the map got its height. `known` is the map before the
    step; the other arguments are as in `shared`.
    """
    least, cells = tuning.least_views, BLOCK * BLOCK
    trusted = is_trusted(known.flags) & np.isfinite(known.height)
    sums = np.empty((5, *(-(-n // BLOCK) for n in known.grid.shape)), np.float32)
    kernels.disagreement(samples, known.residual, trusted, BLOCK, least, sums)
    own, square, count, before, share = (cv2.blur(s, (AROUND, AROUND)) for s in sums)
    enough = (count >= least * tuning.least_seen * cells) & (square > tuning.least_change * count)
    alike = (share > tuning.least_seen * cells) & (before < tuning.alike_before * share)
    wrong, came = enough & (own > tuning.most_unlike * square), enough & alike & (own > tuning.came_unlike * square)
    return Contradicted(*(upsample(found, BLOCK, known.grid.shape) for found in (wrong, came)))
