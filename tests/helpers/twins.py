"""Plain NumPy twins of the parallax kernels: slow, short, written from docs/method/parallax.md."""

from __future__ import annotations

import math
import warnings

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def sweep_cost(samples: F32, keep: float, truncation: float) -> tuple[F64, NDArray[np.int64]]:
    """Eq. 6: mean of the smallest deviations from the median, scaled to be comparable for any number of views."""
    count = np.isfinite(samples).sum(axis=0)
    cost = np.full(count.shape, float(truncation))
    for r, c in zip(*np.nonzero(count >= 2), strict=True):
        s = samples[:, r, c]
        s = s[np.isfinite(s)].astype(np.float64)
        deviation = np.sort(np.abs(s - np.median(s)))[: max(2, int(np.ceil(keep * len(s))))]
        cost[r, c] = np.minimum(deviation, truncation).mean() * np.sqrt(len(s) / (len(s) - 1))
    return cost, count


def sampled(picture: F32, scale: float, row: float, col: float, shape: tuple[int, int]) -> F64:
    """A picture at `scale` times row and column, plus a shift: Catmull-Rom; NaN where a neighbour lies outside."""
    out = np.full(shape, np.nan)
    for r, c in np.ndindex(*shape):
        y, x = scale * r + row, scale * c + col
        i, j = math.floor(y), math.floor(x)
        if 1 <= i < picture.shape[0] - 2 and 1 <= j < picture.shape[1] - 2:
            near = picture[i - 1 : i + 3, j - 1 : j + 3].astype(np.float64)
            out[r, c] = catmull_rom(y - i) @ near @ catmull_rom(x - j)
    return out


def catmull_rom(t: float) -> F64:
    """Weights of four neighbours at a share `t` of the way from the second to the third."""
    return 0.5 * np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2])


def splat(found: F32, ratio: F32, ground: float, cell: float, place: F64, shape: tuple[int, int]) -> tuple[F64, F64]:
    """Write every height into the cells about its place on its ray; the highest wins."""
    height, which = np.full(shape, np.nan), np.full(shape, np.nan)
    rows, cols = np.nonzero(np.isfinite(found))
    for k in np.argsort(found[rows, cols], kind="stable"):
        z = found[rows[k], cols[k]]
        share = (place[4] - z) / (place[4] - ground)
        east = place[2] + share * (place[0] + cell * cols[k] - place[2])
        north = place[3] + share * (place[1] - cell * rows[k] - place[3])
        for i in {round(-north / cell - 0.3), round(-north / cell + 0.3)}:
            for j in {round(east / cell - 0.3), round(east / cell + 0.3)}:
                if 0 <= i < shape[0] and 0 <= j < shape[1] and not height[i, j] >= z:
                    height[i, j], which[i, j] = z, ratio[rows[k], cols[k]]
    return height, which


def scanline(cost: F64, image: F64, p1: float, p2: float, edge: float, dr: int, dc: int) -> F64:
    """One direction of eq. 7, by recursion over the cells in the order of the path."""
    rows, cols, depth = cost.shape
    L = np.zeros_like(cost)
    for r in range(rows)[:: -1 if dr < 0 else 1]:
        for c in range(cols)[:: -1 if dc < 0 else 1]:
            L[r, c] = cost[r, c]
            if 0 <= r - dr < rows and 0 <= c - dc < cols:
                before = L[r - dr, c - dc]
                far = p2 / (1 + edge * abs(image[r, c] - image[r - dr, c - dc]))
                padded = np.pad(before, 1, constant_values=np.inf)
                options = [before, padded[:-2] + p1, padded[2:] + p1, np.full(depth, before.min() + far)]
                L[r, c] += np.min(options, axis=0) - before.min()
    return L


def aggregate(cost: F64, image: F64, p1: float, p2: float, edge: float) -> F64:
    """Eq. 7: eight directions."""
    paths = [(dr, dc) for dr in (-1, 0, 1) for dc in (-1, 0, 1) if (dr, dc) != (0, 0)]
    return np.sum([scanline(cost, image, p1, p2, edge, *p) for p in paths], axis=0)


def winner(total: F64, cost: F64, count: NDArray[np.int64]) -> tuple[F64, F64]:
    """The lowest plane with the vertex of its parabola; best over second-best local minimum of the own cost."""
    rows, cols, depth = total.shape
    index, ratio = np.full((rows, cols), np.nan), np.full((rows, cols), np.nan)
    for r, c in zip(*np.nonzero(count >= 2), strict=True):
        t, v = total[r, c], cost[r, c]
        k = int(np.argmin(t))
        index[r, c] = k
        if 0 < k < depth - 1 and t[k - 1] - 2 * t[k] + t[k + 1] > 1e-9:
            vertex = 0.5 * (t[k - 1] - t[k + 1]) / (t[k - 1] - 2 * t[k] + t[k + 1])
            index[r, c] += np.clip(vertex, -0.5, 0.5)
        walled = np.pad(v, 1, constant_values=np.inf)
        valley = (walled[:-2] >= v) & (walled[2:] >= v) & (np.abs(np.arange(depth) - k) > 2)
        second = v[valley].min() if valley.any() else v.max()
        ratio[r, c] = v[max(0, k - 1) : k + 2].min() / max(second, 1e-6)
    return index, ratio


def normalised(grey: F32, reach: int, floor: float) -> F64:
    """Eq. 5, with the border repeated beyond the picture."""
    g = np.pad(grey.astype(np.float64), reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(g, (2 * reach + 1,) * 2)
    return (grey - windows.mean(axis=(2, 3))) / np.maximum(windows.std(axis=(2, 3)), floor)


def template(samples: F32, tau: float) -> tuple[F64, F64, NDArray[np.int64]]:
    """Eq. 8: biweights about the median, 0 from 4 tau on; the weighted mean; the number of views in it."""
    s = samples.astype(np.float64)
    seen = np.isfinite(s)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        e = np.where(seen & (seen.sum(axis=0) >= 2), s - np.nanmedian(s, axis=0), np.inf)
        w = np.maximum(1 - (e / (4 * tau)) ** 2, 0) ** 2
        mean = (w * np.where(w > 0, s, 0)).sum(axis=0) / w.sum(axis=0)
    return w, mean, (w > 0).sum(axis=0)


def normal_equations(
    samples: F32, tau: float, centres: F64, xs: F64, ys: F64, h: F32, cell: float
) -> tuple[F64, NDArray[np.int64], F64, F64, F64]:
    """Eqs. 8 to 10, Lambda and eta as the weighted covariance of slide and deviation over the views."""
    weights, m, count = template(samples, tau)
    gx, gy = np.full(m.shape, np.nan), np.full(m.shape, np.nan)
    gx[1:-1, 1:-1] = (m[1:-1, 2:] - m[1:-1, :-2]) / (2 * cell)
    gy[1:-1, 1:-1] = (m[:-2, 1:-1] - m[2:, 1:-1]) / (2 * cell)  # rows go south
    lam, eta, s2 = (np.zeros(m.shape) for _ in range(3))
    for r, c in np.ndindex(*m.shape):
        w = weights[:, r, c]
        used = w > 0
        if used.sum() < 2 or not np.isfinite([gx[r, c], gy[r, c], m[r, c]]).all():
            continue
        v = (np.array([xs[c], ys[r]]) - centres[used, :2]) / (centres[used, 2:] - h[r, c])
        q, e, w = v @ [gx[r, c], gy[r, c]], samples[used, r, c] - m[r, c], w[used]
        q_mean, e_mean = np.average(q, weights=w), np.average(e, weights=w)
        lam[r, c] = (w * (q - q_mean) ** 2).sum()
        eta[r, c] = -(w * (q - q_mean) * (e - e_mean)).sum()
        s2[r, c] = (w * e * e).sum() / w.sum() * used.sum() / (used.sum() - 1)
    return m, count, lam, eta, s2


def shifted(values: F64, dy: int, dx: int) -> F64:
    """The value `dy` rows down and `dx` columns right of each cell, NaN beyond the border."""
    k = max(abs(dy), abs(dx))
    rows, cols = values.shape
    return np.pad(values.astype(np.float64), k, constant_values=np.nan)[k + dy : k + dy + rows, k + dx : k + dx + cols]


def solve(lam: F32, eta: F32, s2: F32, h: F32, spread: F32, limit: float) -> tuple[F64, F64, F64]:
    """Eq. 11: sums over 5 x 5 cells, neighbours of like height first; the damped, clipped step."""
    sums = np.zeros((4, *h.shape))
    for dy, dx in np.ndindex(5, 5):
        near = shifted(lam, dy - 2, dx - 2)
        d = (shifted(h, dy - 2, dx - 2) - h) / spread
        w = np.where(near > 0, np.maximum(1 - d**2, 0) ** 2, 0)
        w = np.nan_to_num(w)
        for k, v in enumerate((near, shifted(eta, dy - 2, dx - 2), shifted(s2, dy - 2, dx - 2), np.ones(h.shape))):
            sums[k] += w * np.nan_to_num(v)
    good = np.isfinite(h) & (sums[3] > 0)
    damping = 0.02 * sums[2] / spread.astype(np.float64) ** 2 + 1e-9
    with np.errstate(all="ignore"):
        step = np.clip(sums[1] / (sums[0] + damping), -limit * spread, limit * spread)
        return np.where(good, step, 0), np.where(good, sums[0], 0), np.where(good, sums[2] / sums[3], 0)


PRIOR_PAIRS = (
    (1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (1, 2), (-2, 1), (-1, 2),
    (3, 0), (0, 3), (3, 1), (1, 3), (-3, 1), (-1, 3), (3, 3), (-3, 3),
)  # fmt: skip


def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float) -> F64:
    """Eq. 12: the weighted mean of the middles between opposite neighbours, and the pull to it."""
    px = spread.astype(np.float64)
    trust = np.where(np.isfinite(h), 0.05 + precision / (precision + noise / px**2 + 1e-12), np.nan)
    sw, sh = np.zeros(h.shape), np.zeros(h.shape)
    for dx, dy in PRIOR_PAIRS:
        above = 0.5 * (shifted(h, dy, dx) + shifted(h, -dy, -dx)) - h
        w = shifted(trust, dy, dx) * shifted(trust, -dy, -dx) * np.maximum(1 - 2 * (above / px) ** 2, 0) ** 2
        sw += np.nan_to_num(w)
        sh += np.nan_to_num(w * above)
    pull = strength * (noise + 1e-3) / px**2 * np.minimum(1.0, sw)
    return np.asarray(h + sh / (sw + 1e-6) * pull / (pull + precision + 1e-12))


def visibility(h: F32, centres: F64, xs: F64, ys: F64, cell: float, margin: float) -> NDArray[np.uint8]:
    """Eq. 13: follow the ray up to the camera, one cell a step along its longer axis."""
    rows, cols = h.shape
    visible = np.ones((len(centres), rows, cols), np.uint8)
    for i, r, c in np.ndindex(*visible.shape):
        away = np.array([-(centres[i, 1] - ys[r]), centres[i, 0] - xs[c]]) / cell
        length = np.abs(away).max()
        if np.isnan(h[r, c]) or length < 1e-6 or centres[i, 2] <= h[r, c]:
            continue
        s = np.arange(1, int(length) + 1)
        y = np.floor(r + away[0] * s / length + 0.5).astype(int)
        x = np.floor(c + away[1] * s / length + 0.5).astype(int)
        outside = (y < 0) | (y >= rows) | (x < 0) | (x >= cols)
        s = s[: np.argmax(outside)] if outside.any() else s
        ray = h[r, c] + (centres[i, 2] - h[r, c]) * s / length + margin
        if (h[y[: len(s)], x[: len(s)]] > ray).any():  # NaN hides nothing
            visible[i, r, c] = 0
    return visible
