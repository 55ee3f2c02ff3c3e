"""All sights of the features at the poses held: one array, its points, and what they say of the poses (M17, M23).

A feature is a row; a pose held (clone) is a column. Rows are used up in one piece: their points are eliminated, what is
left measures the poses. No sight is used twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.motion.state import Clone
from alight.motion.turns import skews
from alight.records import F64

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NEAR = 0.1  # m; points closer to a camera, or behind it, are not seen
_ITERATIONS = 3  # of Gauss-Newton on a point, from the place nearest to its rays
_REGULAR = 1e-9  # 1/m^2 added so that a point at infinity has a covariance


@dataclass(frozen=True, eq=False)
class Sights:
    """What was seen of N features from K poses by C cameras."""

    ids: Ints  # (N,)
    seen: F64  # (N, K, C, 2) normalised coordinates, NaN = not seen
    sigma: F64  # (N, K) of a normalised coordinate

    @classmethod
    def none(cls, cameras: int) -> Sights:
        """No feature, no pose."""
        return cls(np.empty(0, np.int64), np.empty((0, 0, cameras, 2)), np.empty((0, 0)))

    @property
    def where(self) -> Mask:
        """(N, K): seen by at least one camera."""
        return np.asarray(np.isfinite(self.seen[..., 0]).any(axis=2))

    def rows(self, which: Mask | Ints) -> Sights:
        """Some of the features."""
        return Sights(self.ids[which], self.seen[which], self.sigma[which])

    def without_poses(self, gone: Sequence[int]) -> Sights:
        """Forget poses by index."""
        if not len(gone):
            return self
        return replace(self, seen=np.delete(self.seen, gone, axis=1), sigma=np.delete(self.sigma, gone, axis=1))

    def at_next_pose(self, ids: Ints, seen: F64, sigma: F64) -> Sights:
        """Add a pose with what was seen there: features not seen now stay, new ones come at the end."""
        _, mine, theirs = np.intersect1d(self.ids, ids, assume_unique=True, return_indices=True)
        new = np.setdiff1d(np.arange(len(ids)), theirs)
        n, k = self.sigma.shape
        out = np.full((n + len(new), k + 1, *self.seen.shape[2:]), np.nan)
        spread = np.ones((n + len(new), k + 1))
        out[:n, :k], spread[:n, :k] = self.seen, self.sigma
        out[mine, k], spread[mine, k] = seen[theirs], sigma[theirs]
        out[n:, k], spread[n:, k] = seen[new], sigma[new]
        return Sights(np.concatenate([self.ids, ids[new]]), out, spread)


@dataclass(frozen=True, eq=False)
class Poses:
    """K rig poses: estimates, and the first estimates at which Jacobians are taken."""

    R: F64  # (K, 3, 3) world_from_rig
    p: F64  # (K, 3)
    first_R: F64  # noqa: N815
    first_p: F64

    @classmethod
    def of(cls, clones: Sequence[Clone]) -> Poses:
        """Those of the clones."""
        return cls(
            np.array([c.R for c in clones]),
            np.array([c.p for c in clones]),
            np.array([c.first_R for c in clones]),
            np.array([c.first_p for c in clones]),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Linearised sights in units of their sigma; zero where not seen."""

    residual: F64  # (N, K, C, 2)
    by_pose: F64  # (N, K, C, 2, 6)
    by_point: F64  # (N, K, C, 2, 3)


def _in_cameras(R: F64, p: F64, cams: Sequence[Pose], x: F64) -> F64:
    """(N, K, C, 3): points (N, 3) in each camera at each pose."""
    rig = np.einsum("kji,nkj->nki", R, x[:, None] - p)
    return np.stack([(rig - c.translation) @ c.rotation for c in cams], axis=2)


def linearise(sights: Sights, poses: Poses, cams: Sequence[Pose], x: F64) -> Rows:
    """Residuals at the estimates, Jacobians at the first ones (M11)."""
    now = _in_cameras(poses.R, poses.p, cams, x)
    first = _in_cameras(poses.first_R, poses.first_p, cams, x)
    ok = np.isfinite(sights.seen[..., 0]) & (now[..., 2] > _NEAR) & (first[..., 2] > _NEAR)
    weight = np.where(ok, 1.0 / sights.sigma[..., None], 0.0)
    now, first = np.where(ok[..., None], now, 1.0), np.where(ok[..., None], first, 1.0)
    residual = np.where(ok[..., None], sights.seen - now[..., :2] / now[..., 2:], 0.0) * weight[..., None]
    w = weight / first[..., 2]
    J = np.zeros((*ok.shape, 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = w
    J[..., 0, 2], J[..., 1, 2] = -w * first[..., 0] / first[..., 2], -w * first[..., 1] / first[..., 2]
    turn = np.stack([(R @ c.rotation).T for R in poses.first_R for c in cams]).reshape(*ok.shape[1:], 3, 3)
    by_point = J @ turn
    by_pose = np.concatenate([by_point @ skews(x[:, None] - poses.first_p)[:, :, None], -by_point], axis=-1)
    return Rows(residual, by_pose, by_point)


def meet(sights: Sights, poses: Poses, cams: Sequence[Pose]) -> F64:
    """(N, 3) points by least squares (M12): the place nearest to the rays, then Gauss-Newton."""
    rays = np.concatenate([sights.seen, np.ones((*sights.seen.shape[:-1], 1))], axis=-1)
    turn = np.stack([R @ c.rotation for R in poses.R for c in cams]).reshape(*rays.shape[1:3], 3, 3)
    origin = np.stack([poses.R @ c.translation + poses.p for c in cams], axis=1)  # (K, C, 3)
    u = np.nan_to_num(np.einsum("kcij,nkcj->nkci", turn, rays))
    u /= np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), 1e-12)
    seen = np.isfinite(sights.seen[..., 0])
    A = np.where(seen[..., None, None], np.eye(3) - u[..., :, None] * u[..., None, :], 0.0)
    N = A.sum(axis=(1, 2)) + _REGULAR * np.eye(3)
    x = np.linalg.solve(N, np.einsum("nkcij,kcj->ni", A, origin)[..., None])[..., 0]
    level = replace(poses, first_R=poses.R, first_p=poses.p)
    for _ in range(_ITERATIONS):
        x = x + _point_step(linearise(sights, level, cams, x))
    return np.asarray(x)


def _point_step(rows: Rows) -> F64:
    V = np.einsum("nkcdi,nkcdj->nij", rows.by_point, rows.by_point) + _REGULAR * np.eye(3)
    g = np.einsum("nkcdi,nkcd->ni", rows.by_point, rows.residual)
    return np.asarray(np.linalg.solve(V, g[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class Reduced:
    """What N features say of K poses, their points eliminated: cost = d'A d - 2 b'd + misfit, by feature."""

    A: F64  # (N, K, 6, 6): the block diagonal before elimination
    V: F64  # (N, K, 6, 3): A of a feature is its blocks less V V'
    b: F64  # (N, K, 6)
    misfit: F64  # (N,) squared residual that no place of the point takes away
    freedom: Ints  # (N,) rows less three
    point_covariance: F64  # (N, 3, 3) for exact poses, m^2

    def information(self, weight: F64) -> tuple[F64, F64]:
        """Sum over the features, each times its weight: (6K, 6K) and (6K,)."""
        n, k = self.b.shape[:2]
        A = np.zeros((k, 6, k, 6))
        blocks = np.einsum("n,nkij->kij", weight, self.A)
        for i in range(k):
            A[i, :, i] = blocks[i]
        V = (self.V * np.sqrt(weight)[:, None, None, None]).transpose(1, 2, 0, 3).reshape(6 * k, 3 * n)
        return np.asarray(A.reshape(6 * k, 6 * k) - V @ V.T), np.einsum("n,nki->ki", weight, self.b).ravel()

    def distances(self, P: F64) -> F64:
        """(N,) squared Mahalanobis distance of each feature, the (6K, 6K) covariance `P` of the poses allowed for."""
        n, k = self.b.shape[:2]
        A = np.zeros((n, k, 6, k, 6))
        for i in range(k):
            A[:, i, :, i] = self.A[:, i]
        V, b = self.V.reshape(n, 6 * k, 3), self.b.reshape(n, 6 * k)
        A = A.reshape(n, 6 * k, 6 * k) - V @ V.transpose(0, 2, 1)
        y = np.linalg.solve(np.eye(6 * k) + A @ P, b[..., None])[..., 0]
        return np.asarray(self.misfit - np.einsum("ni,ij,nj->n", b, P, y))


def eliminate(rows: Rows) -> Reduced:
    """Take the points out of the rows (M21)."""
    e, P, X = rows.residual, rows.by_pose, rows.by_point
    V = np.einsum("nkcdi,nkcdj->nij", X, X) + _REGULAR * np.eye(3)
    inverse = np.linalg.inv(V)
    inverse = 0.5 * (inverse + inverse.transpose(0, 2, 1))
    L = np.linalg.cholesky(inverse)
    g = np.einsum("nji,nj->ni", L, np.einsum("nkcdi,nkcd->ni", X, e))
    own = np.einsum("nkcdi,nkcdj->nkij", P, P)
    W = np.einsum("nkcdi,nkcdj->nkij", P, X) @ L[:, None]
    b = np.einsum("nkcdi,nkcd->nki", P, e) - np.einsum("nkij,nj->nki", W, g)
    freedom = 2 * (np.abs(X).sum(axis=(3, 4)) > 0).sum(axis=(1, 2)) - 3
    return Reduced(own, W, b, (e**2).sum(axis=(1, 2, 3)) - (g**2).sum(axis=1), freedom, inverse)


def as_rows(A: F64, b: F64) -> tuple[F64, F64]:
    """Residual and (m, 6K) rows of unit noise that say the same as the information `A`, `b`."""
    value, vector = np.linalg.eigh(A)
    keep = value > 1e-10 * max(float(value[-1]), 1e-300)
    root = np.sqrt(value[keep])
    return (vector[:, keep].T @ b) / root, root[:, None] * vector[:, keep].T
