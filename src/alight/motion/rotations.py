"""Many small rotations at once."""

from __future__ import annotations

import numpy as np

from alight.records import F64


def skews(v: F64) -> F64:
    """Return the (..., 3, 3) cross-product matrices of (..., 3) vectors."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def so3_exps(w: F64) -> F64:
    """Rotations (N, 3, 3) of (N, 3) rotation vectors, rad."""
    angle2 = (w * w).sum(axis=1)
    angle = np.sqrt(np.maximum(angle2, 1e-12))
    small = angle2 < 1e-12
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / angle**2)
    W = skews(w)
    return np.asarray(np.eye(3) + a[:, None, None] * W + b[:, None, None] * (W @ W))
