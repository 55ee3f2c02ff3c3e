"""Points like those of a structure-from-motion reference: features of three views whose rays agree to a pixel.

The photos' reference has heights only at such points, on textured things that hold still, so simulated ground is
judged at the same kind of places.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.records import View

FEATURES = 4000
RATIO = 0.8
MOST_ERROR = 0.7  # px, in each of the three
TRIPLES = 8


class _Features:
    def __init__(self, view: View) -> None:
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY) if view.image.ndim == 3 else view.image
        found, self.descriptors = cv2.SIFT_create(FEATURES).detectAndCompute(grey, None)  # type: ignore[attr-defined]
        self.pixels = np.array([k.pt for k in found], dtype=np.float64).reshape(-1, 2)
        self.view = view


def _matches(a: _Features, b: _Features) -> dict[int, int]:
    if len(a.pixels) < 2 or len(b.pixels) < 2:
        return {}
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.descriptors, b.descriptors, k=2)
    return {m.queryIdx: m.trainIdx for m, n in (p for p in pairs if len(p) == 2) if m.distance < RATIO * n.distance}


def _triples(views: Sequence[View], step: float) -> Iterator[tuple[View, View, View]]:
    """Views about `step` metres apart, spread over the recording."""
    centres = np.array([v.centre for v in views])
    for i in np.unique(np.linspace(0, len(views) - 1, TRIPLES + 4).astype(int)):
        away = np.linalg.norm(centres[i + 1 :] - centres[i], axis=1)
        if len(away) < 2 or away.max() < 1.7 * step:
            continue
        j, k = (i + 1 + int(np.argmin(np.abs(away - s * step))) for s in (1, 2))
        if j != k:
            yield views[i], views[j], views[k]


def _meet(a: _Features, c: _Features, i: NDArray[np.int64], k: NDArray[np.int64]) -> F64:
    """Triangulate points (N, 3): half way between the rays of two views where these are nearest."""
    p, q = a.view.centre, c.view.centre
    u, v = (f.view.camera.rays(f.pixels[n]) @ f.view.world_from_cam.rotation.T for f, n in ((a, i), (c, k)))
    u, v = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in (u, v))
    dot, pu, pv = (u * v).sum(1), u @ (q - p), v @ (q - p)
    det = np.maximum(1 - dot**2, 1e-12)
    s, t = (pu - dot * pv) / det, (dot * pu - pv) / det
    return np.asarray(0.5 * (p + s[:, None] * u + q + t[:, None] * v))


def common_points(views: Sequence[View], step: float) -> F64:
    """Points (N, 3) in the world from views about `step` metres apart."""
    out = [np.empty((0, 3))]
    for triple in _triples(views, step):
        a, b, c = (_Features(v) for v in triple)
        first, second = _matches(a, b), _matches(b, c)
        chains = np.array([(i, j, second[j]) for i, j in first.items() if j in second], dtype=int).reshape(-1, 3)
        if not len(chains):
            continue
        points = _meet(a, c, chains[:, 0], chains[:, 2])
        good = np.ones(len(points), bool)
        for f, n in zip((a, b, c), chains.T, strict=True):
            seen = f.view.camera.project(f.view.world_from_cam.inverse.apply(points))
            good &= np.linalg.norm(seen - f.pixels[n], axis=1) < MOST_ERROR  # NaN behind a camera is not
        out.append(points[good])
    return np.concatenate(out)
