"""Loops of the orthophoto: one view after the other is added to the mean of the earlier ones."""

import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.compiled import inline, kernel, parallel_kernel, prange
from alight.parallax.projection_kernels import project_row

EXPOSURES = 7  # numbers of a row: shared pixels, their colours in earlier views, their colours in this view


@inline
def _between(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8, fx: np.float32, fy: np.float32) -> int:
    """Bilinear grey level of four pixels, rounded."""
    above, below = a + fx * (np.float32(b) - a), c + fx * (np.float32(d) - c)
    return int(above + fy * (below - above) + np.float32(0.5))


@kernel
def _sample(image: U8, tone: U8, u: np.float32, v: np.float32, out: U8) -> None:
    """Fill the colours (3,) of a picture (H, W, 1 or 3) at a place in it, by the table `tone` (256, 3)."""
    x, y = int(u), int(v)
    right, down = min(x + 1, image.shape[1] - 1), min(y + 1, image.shape[0] - 1)
    fx, fy, last = u - np.float32(x), v - np.float32(y), image.shape[2] - 1
    for k in range(3):
        c = min(k, last)
        out[k] = tone[_between(image[y, x, c], image[y, right, c], image[down, x, c], image[down, right, c], fx, fy), k]


@kernel
def _wanted(wants: Mask) -> tuple[int, int]:
    """The first place of a row that wants a view, and the one behind the last."""
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
    """Sample a view on a window: its colours, where they count, and its exposure against earlier views.

    Views come in order, the finest first. `wants` becomes false, in place, where one is too coarse, as all later ones
    are. Only the stretches of rows that want a view are computed.

    Args:
        image: (H, W, 1 or 3).
        tone: (256, 3), table from its levels to colours.
        H, b, intrinsics, distortion, model, r2_max, rolling: as `project_grid` takes them.
        centre: (3,) metres, of the camera; a pixel covers the distance over the focal length.
        xs, ys: metres, east of the columns and north of the rows.
        height: (R, C) metres.
        level: metres, of the ground.
        coarser: a view with pixels larger than the finest by this factor does not count.
        wants: (R, C), True where another view is wanted.
        finest: (R, C), metres, the finest pixel of earlier views.
        total, number: (R, C, 3), (R, C), sum and number of earlier views.
        seen, use, pixel: (R, C, 3), (R, C), (R, C), out: colours, True where they count, metres that a pixel covers.
        exposures: (R, `EXPOSURES`), out.
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
                for k in range(3):
                    exposures[r, 1 + k] += total[r, c, k] / number[r, c]
                    exposures[r, 4 + k] += seen[r, c, k]


@kernel
def add_view(
    seen: U8, use: Mask, pixel: F32, gain: F64, count: int, total: F32, number: F32, finest: F32, wants: Mask
) -> None:
    """Add a view to the sums, in place; `wants` becomes false where `count` views are reached.

    Args:
        seen: (R, C, 3), the view's picture on the grid.
        use: (R, C), True where the view counts.
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
