"""Kernel that halves the resolution of a map: means of 2 x 2 cells (docs/method/elevation.md, eq. 16b)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F32, U8, U16
from alight.compiled import kernel


@kernel
def halve(
    height: F32, sigma: F32, flags: U16, views: U8, rgb: U8, residual: F32, sampling: F32,
    unseen: int, refused: int,
    height2: F32, sigma2: F32, flags2: U16, views2: U8, rgb2: U8, residual2: F32, sampling2: F32,
) -> None:  # fmt: skip
    """Fill (R / 2, C / 2) arrays, initialised as `unseen`, with means over 2 x 2 cells of (R, C) arrays.

    Cells with the flag `unseen` are ignored. Cells with a bit of `refused` are used only if fewer than two of the four
    cells are free of these bits. A coarse cell with fewer than three seen cells stays unseen. Variances are averaged
    but not divided. The coarse cell gets the largest sampling and number of views, and the union of the flags.
    """
    for r in range(height2.shape[0]):
        for c in range(height2.shape[1]):
            seen, good = 0, 0
            for k in range(4):
                f = flags[2 * r + k // 2, 2 * c + k % 2]
                seen += (f & unseen) == 0
                good += (f & refused) == 0
            if seen < 3:
                continue
            without = refused if good >= 2 else unseen
            n, bits, most = 0, np.uint16(0), np.uint8(0)
            h, v, e, red, green, blue = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            coarsest = np.float32(0)
            for k in range(4):
                i, j = 2 * r + k // 2, 2 * c + k % 2
                if (flags[i, j] & without) == 0:
                    n += 1
                    h += height[i, j]
                    v += sigma[i, j] * sigma[i, j]
                    e += residual[i, j]
                    red += rgb[i, j, 0]
                    green += rgb[i, j, 1]
                    blue += rgb[i, j, 2]
                    bits |= flags[i, j]
                    most = max(most, views[i, j])
                    coarsest = max(coarsest, sampling[i, j])
            height2[r, c], sigma2[r, c], residual2[r, c] = h / n, np.sqrt(v / n), e / n
            rgb2[r, c, 0] = np.uint8(red / n + 0.5)
            rgb2[r, c, 1] = np.uint8(green / n + 0.5)
            rgb2[r, c, 2] = np.uint8(blue / n + 0.5)
            flags2[r, c], views2[r, c], sampling2[r, c] = bits, most, coarsest
