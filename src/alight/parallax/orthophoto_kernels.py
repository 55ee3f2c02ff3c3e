"""Loops of the orthophoto: one view after the other is added to the mean of what earlier ones saw."""

import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.compiled import kernel


@kernel
def sees(mapx: F32, pixel: F32, wants: Mask, finest: F32, coarser: np.float32) -> Mask:
    """Where a view adds to the mean, (R, C).

    Args:
        mapx: (R, C), column in the view; below 0: out of its sight.
        pixel: (R, C), metres of ground that a pixel of the view covers.
        wants: (R, C), whether another view is wanted.
        finest: (R, C), metres, the finest pixel of earlier views.
        coarser: a view with pixels larger than the finest by this factor does not count.
    """
    use = np.empty(mapx.shape, np.bool_)
    for r in range(mapx.shape[0]):
        for c in range(mapx.shape[1]):
            use[r, c] = mapx[r, c] >= 0 and wants[r, c] and pixel[r, c] <= coarser * finest[r, c]
    return use


@kernel
def exposure_gains(seen: U8, use: Mask, total: F32, number: F32) -> tuple[int, F64]:
    """Exposure of earlier views over that of a view, by colour, and of how many pixels that is known.

    Args:
        seen: (R, C, 3), the view's picture on the grid.
        use: (R, C), where the view counts.
        total: (R, C, 3), sum of earlier views.
        number: (R, C), of earlier views.
    """
    before, now, both = np.zeros(3), np.zeros(3), 0
    for r in range(use.shape[0]):
        for c in range(use.shape[1]):
            if use[r, c] and number[r, c] > 0:
                both += 1
                for k in range(3):
                    before[k] += total[r, c, k] / number[r, c]
                    now[k] += seen[r, c, k]
    if both == 0:
        return 0, np.ones(3)
    return both, (before / both) / np.maximum(now / both, 1.0)


@kernel
def add_view(
    seen: U8, use: Mask, pixel: F32, gain: F64, count: int, total: F32, number: F32, finest: F32, wants: Mask
) -> None:
    """Add a view to the sums, in place; `wants` becomes false where `count` views are together.

    Args:
        seen: (R, C, 3), the view's picture on the grid.
        use: (R, C), where the view counts.
        pixel: (R, C), metres of ground that a pixel of the view covers.
        gain: (3,), factor of its colours.
        count: views that are wanted.
        total, number, finest: sums, (R, C, 3) and (R, C), and the finest pixel, metres.
    """
    for r in range(use.shape[0]):
        for c in range(use.shape[1]):
            if use[r, c]:
                for k in range(3):
                    total[r, c, k] += np.float32(seen[r, c, k] * gain[k])
                number[r, c] += np.float32(1)
                finest[r, c] = min(finest[r, c], pixel[r, c])
                wants[r, c] = number[r, c] < count
