"""Plain NumPy twins of the parallax kernels: slow, short, written from docs/method.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def sweep_cost(samples: F32, keep: float, truncation: float) -> tuple[F64, NDArray[np.int64]]:
    """Eq. 6: mean of the smallest deviations from the median, scaled so that any number of views compares."""
    count = np.isfinite(samples).sum(axis=0)
    cost = np.full(count.shape, float(truncation))
    for r, c in zip(*np.nonzero(count >= 2), strict=True):
        s = samples[:, r, c]
        s = s[np.isfinite(s)].astype(np.float64)
        deviation = np.sort(np.abs(s - np.median(s)))[: max(2, int(np.ceil(keep * len(s))))]
        cost[r, c] = np.minimum(deviation, truncation).mean() * np.sqrt(len(s) / (len(s) - 1))
    return cost, count


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


def template(samples: F32, tau: float) -> tuple[F64, F64, NDArray[np.int64]]:
    """Eq. 8: Huber weights about the median, nothing from 4 tau on; the weighted mean; how many views it holds."""
    n, rows, cols = samples.shape
    weights, mean = np.zeros((n, rows, cols)), np.full((rows, cols), np.nan)
    for r, c in np.ndindex(rows, cols):
        s = samples[:, r, c].astype(np.float64)
        seen = np.isfinite(s)
        if seen.sum() < 2:
            continue
        e = np.abs(s - np.median(s[seen]))
        w = np.where(seen & (e < 4 * tau), np.minimum(1.0, tau / np.maximum(e, 1e-30)), 0.0)
        weights[:, r, c] = w
        if w.sum() > 0:
            mean[r, c] = (w[seen] * s[seen]).sum() / w.sum()
    return weights, mean, (weights > 0).sum(axis=0)


def normal_equations(
    samples: F32, weights: F32, mean: F32, centres: F64, xs: F64, ys: F64, h: F32, cell: float
) -> tuple[F64, F64, F64]:
    """Eqs. 9 and 10, as the weighted covariance of slide and deviation over the views."""
    m = mean.astype(np.float64)
    gx, gy = np.full(m.shape, np.nan), np.full(m.shape, np.nan)
    gx[1:-1, 1:-1] = (m[1:-1, 2:] - m[1:-1, :-2]) / (2 * cell)
    gy[1:-1, 1:-1] = (m[:-2, 1:-1] - m[2:, 1:-1]) / (2 * cell)  # rows go south
    lam, eta, s2 = (np.zeros(m.shape) for _ in range(3))
    for r, c in np.ndindex(*m.shape):
        w = weights[:, r, c].astype(np.float64)
        used = w > 0
        if used.sum() < 2 or not np.isfinite([gx[r, c], gy[r, c], m[r, c]]).all():
            continue
        v = (np.array([xs[c], ys[r]]) - centres[used, :2]) / (centres[used, 2:] - h[r, c])
        q, e, w = v @ [gx[r, c], gy[r, c]], samples[used, r, c] - m[r, c], w[used]
        q_mean, e_mean = np.average(q, weights=w), np.average(e, weights=w)
        lam[r, c] = (w * (q - q_mean) ** 2).sum()
        eta[r, c] = -(w * (q - q_mean) * (e - e_mean)).sum()
        s2[r, c] = (w * e * e).sum() / w.sum() * used.sum() / (used.sum() - 1)
    return lam, eta, s2


def solve(lam: F32, eta: F32, s2: F32, h: F32, radius: int, spread: F32, limit: F32) -> tuple[F64, F64, F64]:
    """Eq. 11: sums over the window, neighbours of like height first; the damped, clipped step."""
    step, precision, noise = (np.zeros(h.shape) for _ in range(3))
    for r, c in zip(*np.nonzero(np.isfinite(h)), strict=True):
        window = np.s_[max(0, r - radius) : r + radius + 1, max(0, c - radius) : c + radius + 1]
        counts = lam[window] > 0
        if not counts.any():
            continue
        d = (h[window][counts].astype(np.float64) - h[r, c]) / spread[r, c]
        w = 1 / (1 + d * d)
        precision[r, c] = (w * lam[window][counts]).sum()
        total = (w * s2[window][counts]).sum()
        noise[r, c] = total / w.sum()
        damping = 0.02 * total / spread[r, c] ** 2 + 1e-9
        step[r, c] = np.clip((w * eta[window][counts]).sum() / (precision[r, c] + damping), -limit[r, c], limit[r, c])
    return step, precision, noise


def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float, pairs: NDArray[np.int64]) -> F64:
    """Eq. 12: weighted least squares of a plane through the neighbours; the pull to its value at the centre."""
    rows, cols = h.shape
    out = h.astype(np.float64)
    offsets = [(s * y, s * x) for x, y in pairs for s in (1, -1)]

    def at(r: int, c: int) -> float:
        return float(h[r, c]) if 0 <= r < rows and 0 <= c < cols else np.nan

    for r, c in zip(*np.nonzero(np.isfinite(h)), strict=True):
        hc, px = float(h[r, c]), float(spread[r, c])
        A, b, W = [], [], []
        for dy, dx in offsets:
            v = at(r + dy, c + dx) - hc
            if np.isnan(v):
                continue
            both = 0.5 * (v + at(r - dy, c - dx) - hc)
            d = (both if abs(both) < abs(v) else v) / px
            p, s2 = float(precision[r + dy, c + dx]), float(noise[r + dy, c + dx])
            A.append([1.0, dx, dy])
            b.append(v)
            own = float(spread[r + dy, c + dx])
            W.append((0.05 + p / (p + s2 / own**2 + 1e-12)) / (1 + d * d) ** 2)
        if sum(W) < 1e-3:
            continue
        w = np.array(W)
        M = (np.array(A).T * w) @ np.array(A) + np.diag([0.0, 0.1, 0.1]) * w.sum()
        if np.linalg.det(M) <= 1e-9 * w.sum() ** 3:
            continue
        a = np.linalg.solve(M, np.array(A).T @ (w * b))[0]
        pull = strength * (noise[r, c] + 1e-3) / px**2 * min(1.0, w.sum())
        out[r, c] = hc + a * pull / (pull + precision[r, c] + 1e-12)
    return out


def visibility(h: F32, centres: F64, xs: F64, ys: F64, cell: float, margin: float) -> NDArray[np.uint8]:
    """Eq. 13: the ray is followed to the camera, a cell a step along its longer axis, all the way."""
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
