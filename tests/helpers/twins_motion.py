"""Plain NumPy twins of the tracker's and the filter's kernels: written from docs/method/motion.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8
from alight.geometry import Camera, Pose, skew
from alight.motion.observations import Clones, WindowObservations

NEAR, REGULAR = 0.1, 1e-9  # m, 1/m^2


def picture(seed: int, height: int = 120, width: int = 160) -> U8:
    """Soft noise of good contrast."""
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.clip(128 + (soft - 128) * 4, 0, 255).astype(np.uint8)


def texture(image: U8, pixels: F32, window: int) -> F64:
    """The Shi-Tomasi response at pixels, from that of the whole picture."""
    response = cv2.cornerMinEigenVal(image, window)
    x, y = np.clip(np.round(pixels).astype(int), 0, np.array(image.shape[::-1]) - 1).T
    return np.asarray(response[y, x], dtype=np.float64)


def strongest(image: U8, box: tuple[int, int, int, int], taken: F32, away: float) -> tuple[int, int, float]:
    """Column, row and response of the strongest corner in one box (top, bottom, left, right)."""
    response = cv2.cornerMinEigenVal(image, 5)
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    for u, v in taken:
        response[(x - u) ** 2 + (y - v) ** 2 < away**2] = -1.0
    part = response[box[0] : box[1], box[2] : box[3]]
    row, col = divmod(int(part.argmax()), part.shape[1])
    return col + box[2], row + box[0], float(part[row, col])


def _bilinear(image: F64, x: F64, y: F64) -> F64:
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    b, a = y - i, x - j
    upper = (1 - a) * image[i, j] + a * image[i, j + 1]
    return np.asarray((1 - b) * upper + b * ((1 - a) * image[i + 1, j] + a * image[i + 1, j + 1]))


def settled(patch: U8, place: F64, turn: F64, image: U8, half: int, start: F64, rounds: int = 30) -> tuple[F64, float]:
    """Position of a patch in an image, and the correlation there: shift, gain and offset by least squares."""
    v, u = np.mgrid[-half - 1 : half + 2, -half - 1 : half + 2].astype(float)
    x, y = place[0] + turn[0, 0] * u + turn[0, 1] * v, place[1] + turn[1, 0] * u + turn[1, 1] * v
    lay, inner, at = _bilinear(patch.astype(float), x, y), np.s_[1:-1, 1:-1], start.astype(float)
    gy, gx = np.gradient(lay)
    for _ in range(rounds):
        seen = _bilinear(image.astype(float), at[0] + u[inner], at[1] + v[inner]).ravel()
        t = lay[inner].ravel()
        gain = np.linalg.lstsq(np.column_stack([t, np.ones(t.size)]), seen, rcond=None)[0][0]
        slopes = np.column_stack([gx[inner].ravel(), gy[inner].ravel(), np.ones(t.size)])
        at = at - np.linalg.lstsq(slopes, seen / gain - t, rcond=None)[0][:2]
    return at, float(np.corrcoef(seen, t)[0, 1])


def rays(camera: Camera, pixels: F64) -> F64:
    """Ideal coordinates of pixels."""
    return np.asarray(camera.rays(pixels)[:, :2])


def _in_cameras(R: F64, p: F64, cams: Sequence[Pose], x: F64) -> F64:
    rig = np.einsum("kji,nkj->nki", R, x[:, None] - p)
    return np.stack([(rig - c.translation) @ c.rotation for c in cams], axis=2)


def linearise(observations: WindowObservations, poses: Clones, cams: Sequence[Pose], x: F64) -> tuple[F64, F64, F64]:
    """Residuals (N, K, C, 2) at the estimates, Jacobians by pose and by point at the first ones (M11)."""
    now, first = _in_cameras(poses.R, poses.p, cams, x), _in_cameras(poses.first_R, poses.first_p, cams, x)
    ok = np.isfinite(observations.normalised[..., 0]) & (now[..., 2] > NEAR) & (first[..., 2] > NEAR)
    weight = np.where(ok, 1.0 / observations.sigma[..., None], 0.0)
    now, first = np.where(ok[..., None], now, 1.0), np.where(ok[..., None], first, 1.0)
    residual = np.where(ok[..., None], observations.normalised - now[..., :2] / now[..., 2:], 0.0) * weight[..., None]
    w = weight / first[..., 2]
    J = np.zeros((*ok.shape, 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = w
    J[..., 0, 2], J[..., 1, 2] = -w * first[..., 0] / first[..., 2], -w * first[..., 1] / first[..., 2]
    turn = np.stack([(R @ c.rotation).T for R in poses.first_R for c in cams]).reshape(*ok.shape[1:], 3, 3)
    by_point = J @ turn
    by_pose = np.concatenate([by_point @ skew(x[:, None] - poses.first_p)[:, :, None], -by_point], axis=-1)
    return residual, by_pose, by_point


def eliminate(observations: WindowObservations, poses: Clones, cams: Sequence[Pose], x: F64) -> dict[str, F64]:
    """The fields of `PoseConstraint` that do not depend on the choice of root, and A of every feature in full (M21)."""
    e, P, X = linearise(observations, poses, cams, x)
    n, k = observations.sigma.shape
    inverse = np.linalg.inv(np.einsum("nkcdi,nkcdj->nij", X, X) + REGULAR * np.eye(3))
    g = np.einsum("nkcdi,nkcd->ni", X, e)
    W = np.einsum("nkcdi,nkcdj->nkij", P, X).reshape(n, 6 * k, 3)
    A = np.zeros((n, k, 6, k, 6))
    for i, own in enumerate(np.einsum("nkcdi,nkcdj->knij", P, P)):
        A[:, i, :, i] = own
    step = np.einsum("nij,nj->ni", inverse, g)
    return {
        "A": A.reshape(n, 6 * k, 6 * k) - W @ inverse @ W.transpose(0, 2, 1),
        "b": np.einsum("nkcdi,nkcd->nki", P, e) - (W @ step[..., None]).reshape(n, k, 6),
        "misfit": (e**2).sum(axis=(1, 2, 3)) - (g * step).sum(axis=1),
        "freedom": 2.0 * (np.abs(X).sum(axis=(3, 4)) > 0).sum(axis=(1, 2)) - 3,
        "point_covariance": inverse,
        "step": step,
        "by_poses": (W @ inverse).transpose(0, 2, 1),
    }


def triangulate(observations: WindowObservations, poses: Clones, cams: Sequence[Pose]) -> F64:
    """(N, 3) points by least squares (M12): the place nearest to the rays, then three steps of Gauss-Newton."""
    rays = np.concatenate([observations.normalised, np.ones((*observations.normalised.shape[:-1], 1))], axis=-1)
    turn = np.stack([R @ c.rotation for R in poses.R for c in cams]).reshape(*rays.shape[1:3], 3, 3)
    origin = np.stack([poses.R @ c.translation + poses.p for c in cams], axis=1)
    u = np.nan_to_num(np.einsum("kcij,nkcj->nkci", turn, rays))
    u /= np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), 1e-12)
    seen = np.isfinite(observations.normalised[..., 0])
    A = np.where(seen[..., None, None], np.eye(3) - u[..., :, None] * u[..., None, :], 0.0)
    N = A.sum(axis=(1, 2)) + REGULAR * np.eye(3)
    x = np.linalg.solve(N, np.einsum("nkcij,kcj->ni", A, origin)[..., None])[..., 0]
    level = replace(poses, first_R=poses.R, first_p=poses.p)
    for _ in range(3):
        e, _, X = linearise(observations, level, cams, x)
        V = np.einsum("nkcdi,nkcdj->nij", X, X) + REGULAR * np.eye(3)
        x = x + np.linalg.solve(V, np.einsum("nkcdi,nkcd->ni", X, e)[..., None])[..., 0]
    return np.asarray(x)


def nearest_to_rays(starts: I64, rays: F64, origins: F64, weight: F64) -> F64:
    """(N, 3) points nearest to weighted rays, point by point."""
    out = []
    for a, b in pairwise(starts):
        u = rays[a:b] / np.linalg.norm(rays[a:b], axis=1, keepdims=True)
        across = (np.eye(3) - u[:, :, None] * u[:, None, :]) * weight[a:b, None, None]
        A = across.sum(axis=0) + REGULAR * np.eye(3)
        out.append(np.linalg.solve(A, np.einsum("nij,nj->i", across, origins[a:b])))
    return np.array(out).reshape(-1, 3)


def schur(
    starts: I64, residual: F64, by_pose: F64, by_point: F64, regular: float, pose: I64, poses: int
) -> tuple[F64, F64, F64]:
    """Reduced matrix, right side, and steps of the points with the poses fixed: by the full dense system."""
    m, n = len(residual), len(starts) - 1
    J = np.zeros((2 * m, 6 * poses + 3 * n))
    for k, point in enumerate(np.repeat(np.arange(n), np.diff(starts))):
        J[2 * k : 2 * k + 2, 6 * pose[k] : 6 * pose[k] + 6] = by_pose[k]
        J[2 * k : 2 * k + 2, 6 * poses + 3 * point : 6 * poses + 3 * point + 3] = by_point[k]
    H, g, s = J.T @ J, J.T @ residual.ravel(), 6 * poses
    H[s:, s:] += regular * np.eye(3 * n)
    gain = np.linalg.solve(H[s:, s:], H[s:, :s]).T
    return H[:s, :s] - gain @ H[s:, :s], g[:s] - gain @ g[s:], np.linalg.solve(H[s:, s:], g[s:]).reshape(n, 3)
