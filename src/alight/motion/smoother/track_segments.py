"""All sights of a recorded flight at once: points by least squares, and their part of the batch (M19, M20)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.motion.projection import jacobians
from alight.records import F64, Tracks

Ints = NDArray[np.int64]
_LEAST = 3  # exposures that a piece of a track must have


class TrackSegments:
    """The sights of every track, cut into pieces of at most `span` exposures, one point a piece."""

    def __init__(self, tracks: Sequence[Tracks], sigma: F64, cams: tuple[Pose, ...], span: int) -> None:
        """Take all exposures; `sigma` of a normalised coordinate, one a row of the tracks one after the other."""
        exposure, ids, seen = _stack(tracks)
        piece = _pieces(exposure, ids, span)
        good = np.bincount(piece, minlength=1)[piece] >= _LEAST if len(piece) else np.zeros(0, bool)
        exposure, seen, sigma = exposure[good], seen[good], sigma[good]
        piece = np.unique(piece[good], return_inverse=True)[1]
        row, cam = np.nonzero(np.isfinite(seen[..., 0])) if len(seen) else (np.zeros(0, int), np.zeros(0, int))
        self.exposure, self.piece, self.cam = exposure[row], piece[row], cam
        self.normalised = seen[row, cam] if len(seen) else np.zeros((0, 2))
        self.sigma = sigma[row]  # (M,) of a normalised coordinate
        self.count = int(piece.max()) + 1 if len(piece) else 0
        self.first = np.full(self.count, len(tracks))
        np.minimum.at(self.first, self.piece, self.exposure)
        self.points = np.zeros((self.count, 3))
        self.weights = np.ones(len(row))  # of the robust cost, by sight
        self._cams = cams

    def _by_camera(self, R: F64, p: F64) -> list[tuple[NDArray[np.intp], F64, F64, Pose]]:
        out = []
        for i, pose in enumerate(self._cams):
            at = np.flatnonzero(self.cam == i)
            out.append((at, R[self.exposure[at]], p[self.exposure[at]], pose))
        return out

    def meet(self, R: F64, p: F64) -> None:
        """Set every point to the place nearest to its rays; (K, 3, 3), (K, 3) are the rig's poses."""
        N, y = np.zeros((self.count, 3, 3)), np.zeros((self.count, 3))
        for at, Ra, pa, pose in self._by_camera(R, p):
            u = np.column_stack([self.normalised[at], np.ones(len(at))]) @ pose.rotation.T
            u = np.einsum("nij,nj->ni", Ra, u / np.linalg.norm(u, axis=1, keepdims=True))
            A = np.eye(3) - u[:, :, None] * u[:, None, :]
            np.add.at(N, self.piece[at], A)
            np.add.at(y, self.piece[at], np.einsum("nij,nj->ni", A, pa + Ra @ pose.translation))
        self.points = np.asarray(np.linalg.solve(N + 1e-9 * np.eye(3), y[..., None])[..., 0])

    def residuals(self, R: F64, p: F64) -> F64:
        """(M, 2) seen minus expected; NaN where a point lies behind the camera."""
        out = np.full((len(self.piece), 2), np.nan)
        for at, Ra, pa, pose in self._by_camera(R, p):
            x = self.points[self.piece[at]]
            q = (np.einsum("nji,nj->ni", Ra, x - pa) - pose.translation) @ pose.rotation
            with np.errstate(divide="ignore", invalid="ignore"):
                out[at] = np.where(q[:, 2:] > 0.1, self.normalised[at] - q[:, :2] / q[:, 2:], np.nan)
        return out

    def reweigh(self, R: F64, p: F64) -> float:
        """Set the weights of the Cauchy cost, by sight and by piece (a point that moves is wrong as a whole).

        Its scale follows the residuals down to twice sigma, so that a poor start is not taken for bad sights.
        Returns the root-mean-square of the weighted residuals, in sigma.
        """
        e = self.residuals(R, p) / self.sigma[:, None]
        square = np.nan_to_num((e**2).sum(axis=1), nan=np.inf)
        typical = float(np.median(square[np.isfinite(square)])) if np.isfinite(square).any() else 0.0
        scale2 = max(4.0, 2.0 * typical)
        w = 1.0 / (1.0 + square / scale2)
        per_piece = np.bincount(self.piece, w, self.count) / np.maximum(
            np.bincount(self.piece, minlength=self.count), 1
        )
        self.weights = np.where(np.isfinite(square), w * per_piece[self.piece], 0.0)
        used = np.where(np.isfinite(square), square, 0.0)
        return float(np.sqrt((self.weights * used).sum() / max(2 * self.weights.sum(), 1e-12)))

    def linearise(self, R: F64, p: F64) -> LinearisedSegments:
        """The weighted rows of every sight at the present poses and points."""
        e = np.nan_to_num(self.residuals(R, p))
        by_pose, by_point = np.zeros((len(e), 2, 6)), np.zeros((len(e), 2, 3))
        for i, pose in enumerate(self._cams):
            for at in _runs(np.flatnonzero((self.cam == i) & (self.weights > 0)), self.exposure):
                k = self.exposure[at[0]]
                by_pose[at], by_point[at] = jacobians(R[k], p[k], pose, self.points[self.piece[at]])
        s = (np.sqrt(self.weights) / self.sigma)[:, None]
        return LinearisedSegments(self, e * s, by_pose * s[..., None], by_point * s[..., None])


class LinearisedSegments:
    """Linearised sights with the points eliminated (Schur complement)."""

    def __init__(self, sights: TrackSegments, residual: F64, by_pose: F64, by_point: F64) -> None:
        self._s, self._e, self._A, self._B = sights, residual, by_pose, by_point
        N = np.zeros((sights.count, 3, 3))
        np.add.at(N, sights.piece, np.einsum("nki,nkj->nij", by_point, by_point))
        N += 1e-4 * np.eye(3)  # 1/m^2: holds points that nothing else does
        y = np.zeros((sights.count, 3))
        np.add.at(y, sights.piece, np.einsum("nki,nk->ni", by_point, residual))
        self._inverse = np.linalg.inv(N)
        self._y = y

    def reduced(self, start: int, stop: int, span: int) -> tuple[F64, F64]:
        """Normal equations of the poses from `start` on, 2 span of them, from pieces that begin in [start, stop)."""
        s = self._s
        pieces = np.flatnonzero((s.first >= start) & (s.first < stop))
        n = 12 * span
        H, g = np.zeros((n, n)), np.zeros(n)
        slot = np.full(s.count, -1)
        slot[pieces] = np.arange(len(pieces))
        at = np.flatnonzero(slot[s.piece] >= 0)
        k, j, A = s.exposure[at] - start, slot[s.piece[at]], self._A[at]
        own = np.zeros((2 * span, 6, 6))
        np.add.at(own, k, np.einsum("nki,nkj->nij", A, A))
        for i in range(2 * span):
            H[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = own[i]
        np.add.at(g.reshape(-1, 6), k, np.einsum("nki,nk->ni", A, self._e[at]))
        W = np.zeros((2 * span, len(pieces), 6, 3))
        np.add.at(W, (k, j), np.einsum("nki,nkj->nij", A, self._B[at]))
        L = np.linalg.cholesky(self._inverse[pieces])
        V = (W @ L[None]).transpose(0, 2, 1, 3).reshape(n, -1)
        g -= V @ np.einsum("nji,nj->ni", L, self._y[pieces]).ravel()
        return H - V @ V.T, g

    def move_points(self, pose_step: F64) -> None:
        """Carry the points on by what the (K, 6) step of the poses leaves for them."""
        s = self._s
        rest = self._y.copy()
        np.subtract.at(
            rest, s.piece, np.einsum("nki,nk->ni", self._B, np.einsum("nki,ni->nk", self._A, pose_step[s.exposure]))
        )
        s.points = s.points + np.einsum("nij,nj->ni", self._inverse, rest)


def _stack(tracks: Sequence[Tracks]) -> tuple[Ints, Ints, F64]:
    exposure = np.repeat(np.arange(len(tracks)), [len(t.ids) for t in tracks])
    return exposure, np.concatenate([t.ids for t in tracks]), np.concatenate([t.normalised for t in tracks])


def _pieces(exposure: Ints, ids: Ints, span: int) -> Ints:
    """Number the pieces: the sights of one feature, cut every `span` exposures from its first."""
    if not len(ids):
        return np.zeros(0, np.int64)
    _, feature = np.unique(ids, return_inverse=True)
    first = np.full(int(feature.max()) + 1, exposure.max())
    np.minimum.at(first, feature, exposure)
    key = feature * (int(exposure.max()) + 1) + (exposure - first[feature]) // span
    return np.asarray(np.unique(key, return_inverse=True)[1])


def _runs(at: NDArray[np.intp], exposure: Ints) -> list[NDArray[np.intp]]:
    """Split indices into runs of one exposure each (sights are stored exposure by exposure)."""
    return [r for r in np.split(at, np.flatnonzero(np.diff(exposure[at])) + 1) if len(r)]
