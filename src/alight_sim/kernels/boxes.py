"""Upright boxes that move over the ground, such as cars, drawn at their exact positions at the time of each ray.

A box is 12 numbers: east, north and height of the centre of its base, cosine and sine of its direction (of the
length, from east to north), half length, half width, height, red, green, blue, and 1 if its sides are glass.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I16 = NDArray[np.int16]
Three = tuple[float, float, float]

NUMBERS = 12
MISS = -1.0


@kernel
def hit_box(box: F64, origin: Three, ray: Three) -> tuple[float, int]:
    """Return the parameter at which a ray enters a box, and the face that it enters; MISS and 0: no hit.

    Faces: 1 top, 2/3 front/back, 4/5 left/right, 0 bottom. `origin`, `ray`: world. Slab method (Kay and Kajiya, 1986).
    """
    dx, dy = origin[0] - box[0], origin[1] - box[1]
    start = (box[3] * dx + box[4] * dy, box[3] * dy - box[4] * dx, origin[2] - box[2])
    along = (box[3] * ray[0] + box[4] * ray[1], box[3] * ray[1] - box[4] * ray[0], ray[2])
    near, far, face = 0.0, math.inf, 0
    for axis, low, high, front in ((0, -box[5], box[5], 2), (1, -box[6], box[6], 4), (2, 0.0, box[7], 1)):
        p, d = start[axis], along[axis]
        if abs(d) < 1e-12:
            if not low <= p <= high:
                return MISS, 0
            continue
        a, b = (low - p) / d, (high - p) / d
        if min(a, b) > near:
            near = min(a, b)
            face = front if d < 0.0 else (0 if axis == 2 else front + 1)
        far = min(far, max(a, b))
    return (near, face) if near <= far else (MISS, 0)


@kernel
def _spheres(boxes: F64, origin: Three, out: F64) -> None:
    """Fill `out` (M, 4): vector v from `origin` to each box's centre, and |v|^2 less its bounding sphere's radius^2."""
    for m in range(boxes.shape[0]):
        box = boxes[m]
        half = 0.5 * box[7]
        out[m, 0], out[m, 1], out[m, 2] = box[0] - origin[0], box[1] - origin[1], box[2] + half - origin[2]
        away = out[m, 0] ** 2 + out[m, 1] ** 2 + out[m, 2] ** 2
        out[m, 3] = max(away - 1.001 * (box[5] ** 2 + box[6] ** 2 + half**2), 0.0)


@parallel_kernel
def cast_boxes(boxes: F64, origins: F64, directions: F32 | F64, turns: F64, depth: F64, faces: I16) -> None:
    """Replace `depth` (H, W) where a box is nearer; fill `faces` (H, W) with 8 * index of the box + face, 0: no box.

    `boxes` (N, M, 12), `origins` (N, 3), `turns` (N, 3, 3): world, N = 1 for all rows or one per row; `directions` (H,
    W, 3) with z = 1.
    """
    for r in prange(depth.shape[0]):
        n = np.int64(r) if origins.shape[0] > 1 else np.int64(0)
        turn = turns[n]
        origin = (origins[n, 0], origins[n, 1], origins[n, 2])
        near = np.empty((boxes.shape[1], 4))
        _spheres(boxes[n], origin, near)
        for c in range(depth.shape[1]):
            d0, d1, d2 = float(directions[r, c, 0]), float(directions[r, c, 1]), float(directions[r, c, 2])
            x = turn[0, 0] * d0 + turn[0, 1] * d1 + turn[0, 2] * d2
            y = turn[1, 0] * d0 + turn[1, 1] * d1 + turn[1, 2] * d2
            z = turn[2, 0] * d0 + turn[2, 1] * d1 + turn[2, 2] * d2
            faces[r, c], square = 0, x * x + y * y + z * z
            for m in range(boxes.shape[1]):
                towards = near[m, 0] * x + near[m, 1] * y + near[m, 2] * z
                if towards * towards < near[m, 3] * square:
                    continue
                t, face = hit_box(boxes[n, m], origin, (x, y, z))
                if t > 0.0 and face > 0 and (depth[r, c] < 0.0 or t < depth[r, c]):
                    depth[r, c] = t
                    faces[r, c] = 8 * m + face
