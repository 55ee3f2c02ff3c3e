"""Loops of the orthophoto: one view after the other is added to the mean of what earlier ones saw."""

import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.compiled import kernel


@kernel
def sees(
    mapx: F32, wants: Mask, finest: F32, coarser: np.float32, xs: F64, ys: F64, centre: F64, level: float, focal: float
) -> tuple[Mask, F32]:
    """Where a view adds to the mean, and the metres of ground that its pixels cover, both (R, C).

    Views come from the finest on: `wants` becomes false, in place, where one is too coarse, for so are those after it.

    Args:
        mapx: (R, C), column in the view; below 0: out of its sight.
        wants: (R, C), whether another view is wanted.
        finest: (R, C), metres, the finest pixel of earlier views.
        coarser: a view with pixels larger than the finest by this factor does not count.
        xs, ys: metres, east of the columns and north of the rows.
        centre: (3,) metres, of the camera.
        level: metres, of the ground.
        focal: pixels; a pixel covers the distance over it.
    """
    use, pixel = np.empty(mapx.shape, np.bool_), np.empty(mapx.shape, np.float32)
    east, over, up = (xs - centre[0]).astype(np.float32), np.float32(1 / focal), np.float32(level - centre[2])
    for r in range(mapx.shape[0]):
        north = np.float32(ys[r] - centre[1])
        beyond = north * north + up * up
        for c in range(mapx.shape[1]):
            pixel[r, c] = np.sqrt(east[c] * east[c] + beyond) * over
            shown, fine = (mapx[r, c] >= 0) & wants[r, c], pixel[r, c] <= coarser * finest[r, c]
            use[r, c], wants[r, c] = shown & fine, wants[r, c] & (fine | (mapx[r, c] < 0))
    return use, pixel


@kernel
def add_exposures(seen: U8, use: Mask, total: F32, number: F32, before: F64, now: F64) -> int:
    """Add up, in place, what earlier views and a view show of the pixels that both show; how many these are.

    Args:
        seen: (R, C, 3), the view's picture on the grid.
        use: (R, C), where the view counts.
        total: (R, C, 3), sum of earlier views.
        number: (R, C), of earlier views.
        before, now: (3,), sums of the colours in earlier views and in this one.
    """
    both = 0
    for r in range(use.shape[0]):
        for c in range(use.shape[1]):
            if use[r, c] and number[r, c] > 0:
                both += 1
                for k in range(3):
                    before[k] += total[r, c, k] / number[r, c]
                    now[k] += seen[r, c, k]
    return both


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
