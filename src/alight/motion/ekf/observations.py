"""All sights of the features at the poses held: one array, its points, and what they say of the poses (M17, M23).

A feature is a row; a pose held (clone) is a column. Rows are used up in one piece: their points are eliminated, what is
left measures the poses. No sight is used twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.motion.ekf.state import Clone
from alight.motion.point_kernels import marginalise_tracks, triangulate_tracks
from alight.records import F64

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NEAR = 0.1  # m; points closer to a camera, or behind it, are not seen
_ITERATIONS = 3  # of Gauss-Newton on a point, from the place nearest to its rays
_REGULAR = 1e-9  # 1/m^2 added so that a point at infinity has a covariance


@dataclass(frozen=True, eq=False)
class WindowObservations:
    """What was seen of N features from K poses by C cameras."""

    ids: Ints  # (N,)
    seen: F64  # (N, K, C, 2) normalised coordinates, NaN = not seen
    sigma: F64  # (N, K) of a normalised coordinate

    @classmethod
    def none(cls, cameras: int) -> WindowObservations:
        """No feature, no pose."""
        return cls(np.empty(0, np.int64), np.empty((0, 0, cameras, 2)), np.empty((0, 0)))

    @property
    def where(self) -> Mask:
        """(N, K): seen by at least one camera."""
        return np.asarray(np.isfinite(self.seen[..., 0]).any(axis=2))

    def rows(self, which: Mask | Ints) -> WindowObservations:
        """Some of the features."""
        return WindowObservations(self.ids[which], self.seen[which], self.sigma[which])

    def without_poses(self, gone: Sequence[int]) -> WindowObservations:
        """Forget poses by index."""
        if not len(gone):
            return self
        return replace(self, seen=np.delete(self.seen, gone, axis=1), sigma=np.delete(self.sigma, gone, axis=1))

    def at_next_pose(self, ids: Ints, seen: F64, sigma: F64) -> WindowObservations:
        """Add a pose with what was seen there: features not seen now stay, new ones come at the end."""
        _, mine, theirs = np.intersect1d(self.ids, ids, assume_unique=True, return_indices=True)
        new = np.setdiff1d(np.arange(len(ids)), theirs)
        n, k = self.sigma.shape
        out = np.full((n + len(new), k + 1, *self.seen.shape[2:]), np.nan)
        spread = np.ones((n + len(new), k + 1))
        out[:n, :k], spread[:n, :k] = self.seen, self.sigma
        out[mine, k], spread[mine, k] = seen[theirs], sigma[theirs]
        out[n:, k], spread[n:, k] = seen[new], sigma[new]
        return WindowObservations(np.concatenate([self.ids, ids[new]]), out, spread)


@dataclass(frozen=True, eq=False)
class WindowPoses:
    """K rig poses: estimates, and the first estimates at which Jacobians are taken."""

    R: F64  # (K, 3, 3) world_from_rig
    p: F64  # (K, 3)
    first_R: F64  # noqa: N815
    first_p: F64

    @classmethod
    def of(cls, clones: Sequence[Clone]) -> WindowPoses:
        """Those of the clones."""
        return cls(
            np.array([c.R for c in clones]),
            np.array([c.p for c in clones]),
            np.array([c.first_R for c in clones]),
            np.array([c.first_p for c in clones]),
        )


def _cameras(R: F64, p: F64, cams: Sequence[Pose]) -> tuple[F64, F64]:
    """(K, C, 3, 3), (K, C, 3): world_from_cam of every camera at every pose."""
    turns = np.array([c.rotation for c in cams])
    places = np.array([c.translation for c in cams])
    return R[:, None] @ turns, (R[:, None] @ places[..., None])[..., 0] + p[:, None]


def triangulate_window(sights: WindowObservations, poses: WindowPoses, cams: Sequence[Pose]) -> F64:
    """(N, 3) points by least squares (M12): the place nearest to the rays, then Gauss-Newton."""
    x = np.empty((len(sights.ids), 3))
    turn, origin = _cameras(poses.R, poses.p, cams)
    triangulate_tracks(sights.seen, sights.sigma, turn, origin, _ITERATIONS, _NEAR, _REGULAR, x)
    return x


@dataclass(frozen=True, eq=False)
class PoseConstraint:
    """What N features say of K poses, their points eliminated: cost = d'A d - 2 b'd + misfit, by feature."""

    A: F64  # (N, K, 6, 6): the block diagonal before elimination
    V: F64  # (N, K, 6, 3): A of a feature is its blocks less V V'
    b: F64  # (N, K, 6)
    misfit: F64  # (N,) squared residual that no place of the point takes away
    freedom: Ints  # (N,) rows less three
    root: F64  # (N, 3, 3), root root' is the covariance of the point
    point_covariance: F64  # (N, 3, 3) for exact poses, m^2
    step: F64  # (N, 3) m to the best place of the point for the poses as they are

    def rows(self, which: Mask | Ints) -> PoseConstraint:
        """Those of some of the features."""
        return PoseConstraint(*(getattr(self, f.name)[which] for f in fields(self)))

    def by_poses(self) -> F64:
        """(N, 3, 6K): the derivative of the point's best place by the errors of the poses, negated."""
        n = len(self.V)
        return np.asarray((self.V @ self.root[:, None].transpose(0, 1, 3, 2)).reshape(n, -1, 3).transpose(0, 2, 1))

    def information(self, weight: F64) -> tuple[F64, F64]:
        """Sum over the features, each times its weight: (6K, 6K) and (6K,)."""
        n, k = self.b.shape[:2]
        A = np.zeros((k, 6, k, 6))
        blocks = np.einsum("n,nkij->kij", weight, self.A)
        for i in range(k):
            A[i, :, i] = blocks[i]
        V = (self.V * np.sqrt(weight)[:, None, None, None]).transpose(1, 2, 0, 3).reshape(6 * k, 3 * n)
        return np.asarray(A.reshape(6 * k, 6 * k) - V @ V.T), np.einsum("n,nki->ki", weight, self.b).ravel()

    def misfits(self, error: F64) -> F64:
        """(N,) squared residual of each feature when the poses are moved by (6K,) errors and its point follows."""
        e = error.reshape(-1, 6)
        n, pull = len(self.b), (self.A @ e[..., None])[..., 0] - 2.0 * self.b
        along = error @ self.V.reshape(n, -1, 3)
        return np.asarray(self.misfit + pull.reshape(n, -1) @ error - (along**2).sum(axis=1))

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


def marginalise_points(sights: WindowObservations, poses: WindowPoses, cams: Sequence[Pose], x: F64) -> PoseConstraint:
    """Residuals at the estimates, Jacobians at the first ones (M11), the (N, 3) points taken out (M21)."""
    n, k = sights.sigma.shape
    out = PoseConstraint(
        A=np.empty((n, k, 6, 6)),
        V=np.empty((n, k, 6, 3)),
        b=np.empty((n, k, 6)),
        misfit=np.empty(n),
        freedom=np.empty(n, np.int64),
        root=np.empty((n, 3, 3)),
        point_covariance=np.empty((n, 3, 3)),
        step=np.empty((n, 3)),
    )
    now, first = _cameras(poses.R, poses.p, cams), _cameras(poses.first_R, poses.first_p, cams)
    marginalise_tracks(
        sights.seen, sights.sigma, x, *now, *first, poses.first_p, _NEAR, _REGULAR,
        out.A, out.V, out.b, out.misfit, out.freedom, out.root, out.point_covariance, out.step,
    )  # fmt: skip
    return out


def as_rows(A: F64, b: F64) -> tuple[F64, F64]:
    """Residual and (m, 6K) rows of unit noise that say the same as the information `A`, `b`."""
    value, vector = np.linalg.eigh(A)
    keep = value > 1e-10 * max(float(value[-1]), 1e-300)
    root = np.sqrt(value[keep])
    return (vector[:, keep].T @ b) / root, root[:, None] * vector[:, keep].T
