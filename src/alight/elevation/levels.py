"""From one cell size to the next: what a cell says of the four in it, they of it (docs/method.md, eqs. 16b, 16c)."""

from __future__ import annotations

import cv2
import numpy as np

from alight.elevation.level_kernels import halve
from alight.elevation.tiles import FIELDS, Fields, is_seen, nothing
from alight.raster import upsample
from alight.records import REFUSED, Flag, is_trusted

WHOLE = 3  # of four cells seen: the coarse one is
ENOUGH = 2  # of four cells trusted: the coarse one is


def halve_fields(fine: Fields) -> Fields:
    """Means of 2 x 2 cells (eq. 16b); those of the trusted ones where there are two of them or more.

    Sigma is not divided: neighbours share their windows, and so their errors.
    """
    rows, cols = fine["flags"].shape
    out = nothing((rows // 2, cols // 2))
    whole = (np.ascontiguousarray(fine[k]) for k in FIELDS)
    halve(*whole, int(Flag.UNSEEN), int(REFUSED), WHOLE, ENOUGH, *(out[k] for k in FIELDS))
    return out


def double_fields(coarse: Fields, less_sure: np.float32) -> Fields:
    """The same at half the cell size (eq. 16c): bilinear between trusted cells, each cell's own value beside others.

    Sigma grows by a factor.
    """
    near = {k: upsample(v, 2) for k, v in coarse.items()}
    shape = near["flags"].shape[::-1]
    bad = ~is_trusted(coarse["flags"])
    near["sigma"] *= less_sure
    for k, scale in (("height", np.float32(1)), ("sigma", less_sure)):
        linear = cv2.resize(np.where(bad, np.float32(np.nan), coarse[k] * scale), shape, interpolation=cv2.INTER_LINEAR)
        np.copyto(near[k], linear, where=np.isfinite(linear))
    mixed = cv2.resize(coarse["rgb"], shape, interpolation=cv2.INTER_LINEAR)
    whole = cv2.resize(is_seen(coarse["flags"]).astype(np.float32), shape, interpolation=cv2.INTER_LINEAR) == 1
    np.copyto(near["rgb"], mixed, where=whole[..., None])
    return near
