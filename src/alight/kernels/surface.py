"""Loops over the surface of a height map: plane prior and ray test of visibility (docs/method.md, eqs. 12 and 13)."""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
B = NDArray[np.bool_]


@parallel_kernel
def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float, radius: int, out: F32) -> None:
    """Pull each height towards the robust local plane of its neighbours (eq. 12); what is unseen stays NaN and unused.

    Neighbours are weighted by their own information and by how well they lie on the plane through the centre; the pull
    is `strength` in parallax pixels (through `spread`, metres a pixel), so that it means the same at any height.
    """
    rows, cols = h.shape
    for r in prange(rows):
        for c in range(cols):
            hc = h[r, c]
            out[r, c] = hc
            if np.isnan(hc):
                continue
            s0 = 0.0
            sx = 0.0
            sy = 0.0
            sxx = 0.0
            sxy = 0.0
            syy = 0.0
            sh = 0.0
            shx = 0.0
            shy = 0.0
            for dy in range(-radius, radius + 1):
                for dx in range(-radius, radius + 1):
                    y, x = r + dy, c + dx
                    if (dx != 0 or dy != 0) and 0 <= y < rows and 0 <= x < cols and not np.isnan(h[y, x]):
                        mirror_y, mirror_x = r - dy, c - dx
                        d = (h[y, x] - hc) / spread[r, c]
                        if 0 <= mirror_y < rows and 0 <= mirror_x < cols and not np.isnan(h[mirror_y, mirror_x]):
                            # on a plane the two opposite neighbours deviate by equal and opposite amounts
                            both = 0.5 * (h[y, x] + h[mirror_y, mirror_x] - 2.0 * hc) / spread[r, c]
                            if abs(both) < abs(d):
                                d = both
                        info = precision[y, x] / (precision[y, x] + noise[y, x] / (spread[r, c] * spread[r, c]) + 1e-12)
                        w = (0.05 + info) / (1.0 + d * d) ** 2
                        v = h[y, x] - hc
                        s0 += w
                        sx += w * dx
                        sy += w * dy
                        sxx += w * dx * dx
                        sxy += w * dx * dy
                        syy += w * dy * dy
                        sh += w * v
                        shx += w * v * dx
                        shy += w * v * dy
            if s0 < 1e-3:
                continue
            sxx += 0.1 * s0
            syy += 0.1 * s0
            # weighted least squares v = a + bx dx + by dy, value at the centre a
            det = s0 * (sxx * syy - sxy * sxy) - sx * (sx * syy - sxy * sy) + sy * (sx * sxy - sxx * sy)
            if det <= 1e-9 * s0 * s0 * s0:
                continue
            a = (sh * (sxx * syy - sxy * sxy) - sx * (shx * syy - sxy * shy) + sy * (shx * sxy - sxx * shy)) / det
            weight = strength * (noise[r, c] + 1e-3) / (spread[r, c] * spread[r, c]) * min(1.0, s0)
            out[r, c] = hc + a * weight / (weight + precision[r, c] + 1e-12)


@parallel_kernel
def visibility(h: F32, top: float, centres: F64, xs: F64, ys: F64, cell: float, margin: float, visible: U8) -> None:
    """Fill `visible` (N, R, C) with 1 where the ray from the cell to camera i stays above the map (eq. 13).

    `top` is the highest height of the map: the march ends once the ray is above it. `margin` (metres) is forgiven.
    """
    n, rows, cols = visible.shape
    for r in prange(rows):
        for c in range(cols):
            hc = h[r, c]
            for i in range(n):
                visible[i, r, c] = 1
                if np.isnan(hc):
                    continue
                dx = (centres[i, 0] - xs[c]) / cell
                dy = -(centres[i, 1] - ys[r]) / cell
                dz = centres[i, 2] - hc
                length = max(abs(dx), abs(dy))
                if length < 1e-6 or dz <= 0.0:
                    continue
                rise = dz / length  # metres a cell of march
                steps = int(min(length, (top - hc) / rise))
                for s in range(1, steps + 1):
                    y = int(np.floor(r + dy * s / length + 0.5))
                    x = int(np.floor(c + dx * s / length + 0.5))
                    if y < 0 or y >= rows or x < 0 or x >= cols:
                        break
                    over = h[y, x]
                    if not np.isnan(over) and over > hc + rise * s + margin:
                        visible[i, r, c] = 0
                        break
