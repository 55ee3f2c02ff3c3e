"""Kernels of the SIFT detector: extrema of differences of Gaussians, their sub-pixel positions and orientations.

See Lowe 2004, sections 3 to 5. The kernels find the features of OpenCV's detector, except those in its doubled picture.
"""

import numpy as np

from alight.arrays import F32, F64
from alight.compiled import inline, kernel

EDGE = 5  # pixels at each edge of the picture that are left out
BINS = 36  # bins of an orientation histogram


@inline
def _is_extreme(dogs: F32, k: int, r: int, c: int) -> bool:
    """Whether the sample at layer `k`, row `r`, column `c` is the extremum of the 3 x 3 x 3 samples around it."""
    v = dogs[k, r, c]
    sign = np.float32(1) if v > 0 else np.float32(-1)
    for j in range(k - 1, k + 2):
        for y in range(r - 1, r + 2):
            for x in range(c - 1, c + 2):
                if sign * dogs[j, y, x] > sign * v:
                    return False
    return True


@kernel
def _newton(dogs: F32, k: int, r: int, c: int, out: F64) -> bool:
    """Write to `out` (5,) the offset to an extremum (columns, rows, layers), its value, and trace^2 / determinant.

    `k`, `r`, `c`: layer, row and column of the sample. Returns False if no offset can be computed.
    """
    v = 2.0 * dogs[k, r, c]
    dx = 0.5 * (dogs[k, r, c + 1] - dogs[k, r, c - 1])
    dy = 0.5 * (dogs[k, r + 1, c] - dogs[k, r - 1, c])
    ds = 0.5 * (dogs[k + 1, r, c] - dogs[k - 1, r, c])
    xx, yy = dogs[k, r, c + 1] + dogs[k, r, c - 1] - v, dogs[k, r + 1, c] + dogs[k, r - 1, c] - v
    ss = dogs[k + 1, r, c] + dogs[k - 1, r, c] - v
    xy = 0.25 * (dogs[k, r + 1, c + 1] - dogs[k, r + 1, c - 1] - dogs[k, r - 1, c + 1] + dogs[k, r - 1, c - 1])
    xs = 0.25 * (dogs[k + 1, r, c + 1] - dogs[k + 1, r, c - 1] - dogs[k - 1, r, c + 1] + dogs[k - 1, r, c - 1])
    ys = 0.25 * (dogs[k + 1, r + 1, c] - dogs[k + 1, r - 1, c] - dogs[k - 1, r + 1, c] + dogs[k - 1, r - 1, c])
    a, b, d = yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy
    det = xx * a + xy * b + xs * d
    if abs(det) < 1e-12:
        return False
    e, f, g = xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy
    out[0] = -(a * dx + b * dy + d * ds) / det
    out[1] = -(b * dx + e * dy + f * ds) / det
    out[2] = -(d * dx + f * dy + g * ds) / det
    out[3] = 0.5 * v + 0.5 * (dx * out[0] + dy * out[1] + ds * out[2])
    out[4] = (xx + yy) * (xx + yy) / g if g > 0.0 else np.inf
    return True


@kernel
def _placed(dogs: F32, k: int, r: int, c: int, least: float, way: F64, place: F64) -> bool:
    """Write to `place` (6,) column, row, layer of an extremum, then its nearest layer, column, row; False: unusable.

    `k`, `r`, `c`: layer, row, column to start from; `least`: least contrast; `way`: (5,) scratch.
    """
    layers, rows, cols = dogs.shape
    for _ in range(5):
        if not _newton(dogs, k, r, c, way):
            return False
        if max(abs(way[0]), abs(way[1]), abs(way[2])) < 0.5:
            place[0], place[1], place[2], place[3] = c + way[0], r + way[1], k + way[2], k
            place[4], place[5] = c, r
            strong: bool = abs(way[3]) >= least and way[4] < (10.0 + 1.0) ** 2 / 10.0  # more: it slides along an edge
            return strong
        if max(abs(way[0]), abs(way[1]), abs(way[2])) > 1e6:
            return False
        c, r, k = c + int(np.rint(way[0])), r + int(np.rint(way[1])), k + int(np.rint(way[2]))
        inside = EDGE <= c < cols - EDGE and EDGE <= r < rows - EDGE
        if not (1 <= k < layers - 1 and inside):
            return False
    return False


@kernel
def _histogram(picture: F32, row: int, col: int, scale: float, raw: F64, even: F64) -> None:
    """Write a smoothed histogram `even` (`BINS`,) of gradient directions around a pixel; `scale`: sigma in px."""
    rows, cols = picture.shape
    reach, fall = int(np.rint(4.5 * scale)), -0.5 / (1.5 * scale) ** 2
    raw[:] = 0.0
    for y in range(max(row - reach, 1), min(row + reach, rows - 2) + 1):
        for x in range(max(col - reach, 1), min(col + reach, cols - 2) + 1):
            dx, dy = picture[y, x + 1] - picture[y, x - 1], picture[y - 1, x] - picture[y + 1, x]
            k = int(np.rint(np.arctan2(dy, dx) * (BINS / (2.0 * np.pi)))) % BINS
            weight = np.exp(((y - row) ** 2 + (x - col) ** 2) * fall)
            raw[k + 2] += weight * np.sqrt(dx * dx + dy * dy)
    raw[0], raw[1], raw[BINS + 2], raw[BINS + 3] = raw[BINS], raw[BINS + 1], raw[2], raw[3]
    for k in range(BINS):
        even[k] = (raw[k] + raw[k + 4] + 4.0 * (raw[k + 1] + raw[k + 3]) + 6.0 * raw[k + 2]) / 16.0


@kernel
def _oriented(place: F64, even: F64, found: F64, count: int) -> int:
    """Add a feature at `place` to `found` per high peak of the orientation histogram `even`; return the new `count`."""
    most = even.max()
    for k in range(BINS):
        left, mid, right = even[k - 1], even[k], even[(k + 1) % BINS]
        if mid > left and mid > right and mid >= 0.8 * most and count < len(found):
            at = k + 0.5 * (left - right) / (left - 2.0 * mid + right)
            found[count, :4] = place[:4]
            found[count, 4] = -at * 360.0 / BINS % 360.0
            count += 1
    return count


@kernel
def features(dogs: F32, blurred: F32, first: float, least: float, found: F64) -> int:
    """Write the features of an octave into `found` and return their number; features beyond its length are dropped.

    Args:
        dogs: (L + 2, R, C) differences of the blurred pictures.
        blurred: (L + 3, R, C) blurred pictures.
        first: sigma of the first blurred picture, pixels; it doubles every L pictures.
        least: least contrast of a feature, in units of the picture.
        found: (M, 5) out: column, row, layer (fractional), nearest layer, orientation in degrees.
    """
    layers, rows, cols = dogs.shape
    way, place, raw, even = np.empty(5), np.empty(6), np.empty(BINS + 4), np.empty(BINS)
    count, some = 0, np.float32(0.5 * least)
    for k in range(1, layers - 1):
        for r in range(EDGE, rows - EDGE):
            for c in range(EDGE, cols - EDGE):
                v = dogs[k, r, c]
                if abs(v) <= some:
                    continue
                # the left and right neighbours exclude nearly all samples
                a, b = dogs[k, r, c - 1], dogs[k, r, c + 1]
                if (v > 0 and (a > v or b > v)) or (v < 0 and (a < v or b < v)):
                    continue
                if _is_extreme(dogs, k, r, c) and _placed(dogs, k, r, c, least, way, place):
                    scale = first * 2.0 ** (place[2] / (layers - 2))
                    layer = int(place[3])
                    _histogram(blurred[layer], int(place[5]), int(place[4]), scale, raw, even)
                    count = _oriented(place, even, found, count)
    return count
