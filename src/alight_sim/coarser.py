"""Layers of a tile averaged over blocks of 2^level cells, to avoid aliasing in pictures with pixels of that size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32
from alight_sim.kernels.illuminate import LIT, SHADED


def _quarters(layer: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return layer[::2, ::2], layer[::2, 1::2], layer[1::2, ::2], layer[1::2, 1::2]


def mean_of(layer: F32, level: int) -> F32:
    """Return the (R >> level, C >> level, ...) means of a layer (R, C, ...) over blocks of 2^level x 2^level cells."""
    for _ in range(level):
        a, b, c, d = _quarters(layer)
        layer = np.float32(0.25) * ((a + b) + (c + d))
    return layer


def most_of(codes: NDArray[np.uint16], level: int) -> NDArray[np.uint16]:
    """Return the (R >> level, C >> level) most frequent code of each block, found by halving `level` times."""
    for _ in range(level):
        a, b, c, d = _quarters(codes)
        codes = np.where((a == b) | (a == c) | (a == d), a, np.where((b == c) | (b == d), b, d))
    return codes


def mean_shadow(margin: F32, level: int) -> F32:
    """Return shadow margins, (R >> level, C >> level) metres, each of which gives the mean sunlight of its block."""
    if level == 0:
        return margin
    t = np.clip((margin - SHADED) / (LIT - SHADED), 0.0, 1.0)
    share = mean_of(np.asarray(t * t * (3.0 - 2.0 * t), np.float32), level)
    back = 0.5 - np.sin(np.arcsin(1.0 - 2.0 * share) / 3.0)  # inverse of smoothstep
    return np.asarray(SHADED + (LIT - SHADED) * back, np.float32)
