"""StereoSGBM on two views with known poses, at points of the ground: what Alight's heights are compared with."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.records import View

# blocks of 3 to 9 and nine pairs of P1, P2 tried on tuning-1 of meadow and village at 40 m: the best ground but for
# P1 = 50, P2 = 400, which is a tenth better there and half as good again in wrong cells beside steps
SGBM = {"blockSize": 7, "P1": 200, "P2": 800}


class Rectified:
    """Two views turned so that rows match; `a` is the left one."""

    def __init__(self, a: View, b: View) -> None:
        base = b.centre - a.centre
        self.baseline = float(np.linalg.norm(base))
        x = base / self.baseline
        z = a.world_from_cam.rotation[:, 2] + b.world_from_cam.rotation[:, 2]
        z = z - (z @ x) * x
        z /= np.linalg.norm(z)
        self.world_from_rect = np.column_stack([x, np.cross(z, x), z])
        self.f = 0.5 * (a.camera.fu + a.camera.fv)
        self.centre = a.centre
        edge = np.concatenate([self._border(v) for v in (a, b)])
        low, high = np.floor(edge.min(0)), np.ceil(edge.max(0))
        self.c = -low
        w, h = (int(v) + 1 for v in high - low)
        self.left, self.right = self._turn(a, w, h), self._turn(b, w, h)

    def _border(self, v: View) -> F64:
        w, h = v.camera.width - 1.0, v.camera.height - 1.0
        rays = v.camera.rays(np.array([[0, 0], [w, 0], [w, h], [0, h], [w / 2, 0], [w / 2, h], [0, h / 2], [w, h / 2]]))
        rays = rays @ (v.world_from_cam.rotation.T @ self.world_from_rect)
        return np.asarray(self.f * rays[:, :2] / rays[:, 2:])

    def _turn(self, v: View, w: int, h: int) -> NDArray[np.uint8]:
        x, y = np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float))
        rays = np.stack([(x - self.c[0]) / self.f, (y - self.c[1]) / self.f, np.ones_like(x)], -1)
        uv = v.camera.project(rays @ (self.world_from_rect.T @ v.world_from_cam.rotation)).astype(np.float32)
        return np.asarray(cv2.remap(_grey(v.image), uv[..., 0], uv[..., 1], cv2.INTER_LINEAR))

    def project(self, xyz: F64) -> tuple[F64, F64]:
        """Pixels (N, 2) in the left picture, and depths (N,)."""
        p = (xyz - self.centre) @ self.world_from_rect
        return self.f * p[:, :2] / p[:, 2:] + self.c, p[:, 2]


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image)


def heights_at(a: View, b: View, xyz: F64) -> F64:
    """StereoSGBM on two views at points (N, 3): heights (N,), NaN without one.

    The height is that of the end of the ray to the point; only the disparities of the points' own depths are searched.
    """
    pair = Rectified(a, b)
    uv, z = pair.project(xyz)
    strength = pair.f * pair.baseline
    low = int(strength / (float(z.max()) + 1.0)) - 4
    count = -(-int(strength / (float(z.min()) - 1.0) + 4 - low) // 16) * 16
    found = np.asarray(cv2.StereoSGBM_create(low, count, disp12MaxDiff=-1, **SGBM).compute(pair.left, pair.right))
    (h, w), (col, row) = found.shape, np.rint(uv).astype(int).T
    disparity = found[row.clip(0, h - 1), col.clip(0, w - 1)] / 16
    known = (col >= 0) & (col < w) & (row >= 0) & (row < h) & (disparity > max(low, 0.0))
    depth = strength / np.where(known, disparity, 1.0)
    return np.where(known, pair.centre[2] + (xyz[:, 2] - pair.centre[2]) / z * depth, np.nan)
