"""Loops of the orthophoto: one view after the other is added to the mean of the earlier ones."""

import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.compiled import inline, kernel, parallel_kernel, prange
from alight.parallax.projection_kernels import project_row

EXPOSURES = 7  # values per row: number of shared pixels, their colours in earlier views and in this view


@inline
def _between(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8, fx: np.float32, fy: np.float32) -> int:
    above, below = a + fx * (np.float32(b) - a), c + fx * (np.float32(d) - c)
    return int(above + fy * (below - above) + np.float32(0.5))


@kernel
def _sample(image: U8, tone: U8, u: np.float32, v: np.float32, out: U8) -> None:
    """Write the 1 or 3 colours of a picture (H, W, 1 or 3) at column `u` and row `v`, converted by the table `tone`."""
    x, y = int(u), int(v)
    right, down = min(x + 1, image.shape[1] - 1), min(y + 1, image.shape[0] - 1)
    fx, fy, last = u - np.float32(x), v - np.float32(y), image.shape[2] - 1
    for k in range(out.size):
        c = min(k, last)
        out[k] = tone[_between(image[y, x, c], image[y, right, c], image[down, x, c], image[down, right, c], fx, fy), k]


@kernel
def _wanted(wants: Mask) -> tuple[int, int]:
    """Return the index of the first True in a row, and the index after the last True; equal if all are False."""
    first, end = 0, wants.size
    while first < end and not wants[first]:
        first += 1
    while end > first and not wants[end - 1]:
        end -= 1
    return first, end


@parallel_kernel
def sample_view(
    image: U8,
    tone: U8,
    H: F64,
    b: F64,
    intrinsics: F64,
    distortion: F64,
    model: int,
    r2_max: float,
    rolling: F64,
    centre: F64,
    xs: F64,
    ys: F64,
    height: F32,
    level: float,
    coarser: float,
    wants: Mask,
    finest: F32,
    total: F32,
    number: F32,
    seen: U8,
    use: Mask,
    pixel: F32,
    exposures: F64,
) -> None:
    """Write the colours of a view on a grid, where they are used, and sums to compare its exposure with earlier views.

    Views come in order, the finest first. Where this view is too coarse, all later ones are, so `wants` becomes False.

    Args:
        image: (H, W, 1 or 3).
        tone: (256, 3) table from levels of the image to colours.
        H, b, intrinsics, distortion, model, r2_max, rolling: as for `project_grid`.
        centre: (3,) camera centre, metres.
        xs, ys: metres, east of the columns and north of the rows.
        height: (R, C) metres.
        level: mean height of the ground, metres.
        coarser: largest pixel of a view that is used, in units of the finest pixel.
        wants: (R, C) True where another view is wanted; changed in place.
        finest: (R, C) finest pixel of earlier views, metres.
        total, number: (R, C, 1 or 3), (R, C) sum of the colours, and number, of earlier views.
        seen, use, pixel: (R, C, 1 or 3), (R, C), (R, C) out: colours, True where used, metres of ground per pixel.
        exposures: (R, `EXPOSURES`) out, sums of each row over the pixels shared with earlier views.
    """
    b32, k32, limit, roll = (
        b.astype(np.float32),
        distortion.astype(np.float32),
        np.float32(r2_max),
        rolling.astype(np.float32),
    )
    lens = np.array([*intrinsics, image.shape[1] - 1.0, image.shape[0] - 1.0], np.float32)
    over, up, step_x = (
        np.float32(1 / intrinsics[0]),
        np.float32(level - centre[2]),
        (xs[-1] - xs[0]) / max(len(xs) - 1, 1),
    )
    most = np.float32(coarser)
    for r in prange(len(ys)):
        use[r], exposures[r] = False, 0.0
        first, end = _wanted(wants[r])
        n = end - first
        if n == 0:
            continue
        p, step = np.empty(3, np.float32), np.empty(3, np.float32)
        for j in range(3):
            p[j] = H[j, 0] * xs[first] + H[j, 1] * ys[r] + H[j, 2]
            step[j] = H[j, 0] * step_x
        room = np.empty((7, n), np.float32)
        u, v = room[5], room[6]
        project_row(
            p,
            step,
            b32,
            lens,
            k32,
            model,
            limit,
            np.float32(image.shape[0]),
            roll,
            height[r, first:end],
            room[:5],
            u,
            v,
        )
        north = np.float32(ys[r] - centre[1])
        beyond = north * north + up * up
        for i in range(n):
            c = first + i
            if not wants[r, c] or u[i] < 0:
                continue
            east = np.float32(xs[c] - centre[0])
            pixel[r, c] = np.sqrt(east * east + beyond) * over
            if pixel[r, c] > most * finest[r, c]:
                wants[r, c] = False
                continue
            use[r, c] = True
            _sample(image, tone, u[i], v[i], seen[r, c])
            if number[r, c] > 0:
                exposures[r, 0] += 1
                for k in range(seen.shape[2]):
                    exposures[r, 1 + k] += total[r, c, k] / number[r, c]
                    exposures[r, 4 + k] += seen[r, c, k]


@kernel
def add_view(
    seen: U8, use: Mask, pixel: F32, gain: F64, count: int, total: F32, number: F32, finest: F32, wants: Mask
) -> None:
    """Add a view to the sums, in place; `wants` becomes False where `count` views are reached.

    Args:
        seen: (R, C, 1 or 3) colours of the view on the grid.
        use: (R, C) True where the view is used.
        pixel: (R, C) metres of ground per pixel of the view.
        gain: (3,) factor on the view's colours.
        count: number of views wanted.
        total, number, finest: (R, C, 1 or 3), (R, C), (R, C) sum of colours, number, and finest pixel (metres) of
            all views.
    """
    for r in range(use.shape[0]):
        for c in range(use.shape[1]):
            if use[r, c]:
                for k in range(seen.shape[2]):
                    total[r, c, k] += np.float32(seen[r, c, k] * gain[k])
                number[r, c] += np.float32(1)
                finest[r, c] = min(finest[r, c], pixel[r, c])
                wants[r, c] = number[r, c] < count
