"""Observations of a recorded flight: track segments, their points and normal equations (M19, M20)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, I64
from alight.geometry import Pose, skew
from alight.motion.point_kernels import MIN_DEPTH, eliminate_list
from alight.motion.points import MIN_POSES, NEAR, triangulate_rays
from alight.motion.robust import cauchy
from alight.records import Tracks

_POINT_PRIOR = 1e-4  # 1/m^2 on the diagonal of a point's information: fixes points with parallel rays


def in_camera(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> F64:
    """Return world points `x` (N, 3) in the frame of a camera; `R` (N, 3, 3), `p` (N, 3): rig pose for each point."""
    return np.asarray((((x - p)[:, None] @ R)[:, 0] - rig_from_cam.translation) @ rig_from_cam.rotation)


def jacobians(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> tuple[F64, F64]:
    """Return the Jacobians of normalised coordinates with respect to rig pose (N, 2, 6) and point (N, 2, 3).

    With C = cam_from_world and a rotation error theta in the world, dq = C (dx - dp + [x - p]x theta) (M11).
    """
    q = in_camera(R, p, rig_from_cam, x)
    w = 1.0 / np.maximum(q[:, 2], MIN_DEPTH)
    J = np.zeros((len(x), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = w
    J[:, 0, 2], J[:, 1, 2] = -q[:, 0] * w**2, -q[:, 1] * w**2
    by_point = J @ (rig_from_cam.rotation.T @ np.swapaxes(R, -1, -2))
    return np.concatenate([by_point @ skew(x - p), -by_point], axis=-1), by_point


class TrackSegments:
    """Observations of every track, cut into segments of at most `span` exposures with one point each.

    The M observations are sorted by segment, and within a segment by time.
    """

    def __init__(self, tracks: Sequence[Tracks], sigma: F64, cams: tuple[Pose, ...], span: int) -> None:
        """Cut the tracks of all exposures into segments.

        Args:
            tracks: tracks of each exposure.
            sigma: 1-sigma of a normalised coordinate, for each row of all `tracks` in turn.
            cams: rig_from_cam of the cameras.
            span: longest segment, exposures.
        """
        exposure = np.repeat(np.arange(len(tracks)), [len(t.ids) for t in tracks])
        ids, normalised = (np.concatenate(rows) for rows in zip(*((t.ids, t.normalised) for t in tracks), strict=True))
        segment = _segment_of(exposure, ids, span)
        long = np.bincount(segment, minlength=1)[segment] >= MIN_POSES if len(segment) else np.zeros(0, bool)
        row, cam = np.nonzero(np.isfinite(normalised[..., 0]) & long[:, None])
        order = np.argsort(segment[row], kind="stable")
        row, self.cam = row[order], cam[order]  # (M,)
        self.exposure = exposure[row]  # (M,)
        self.segment = np.unique(segment[row], return_inverse=True)[1]  # (M,)
        self.normalised = normalised[row, self.cam]  # (M, 2)
        self.sigma = sigma[row]  # (M,) 1-sigma of a normalised coordinate
        self.starts = np.flatnonzero(np.diff(self.segment, prepend=-1, append=self.segment.max(initial=-1) + 1))
        self.count = len(self.starts) - 1
        self.first = self.exposure[self.starts[:-1]]  # (count,) first exposure of each segment
        self.points = np.zeros((self.count, 3))
        self.weights = np.ones(len(row))  # (M,) weights of the robust cost
        self._cams = cams

    def _by_camera(self, R: F64, p: F64) -> list[tuple[NDArray[np.intp], F64, F64, Pose]]:
        """Return, for each camera, its observations' indices (N,), their rig poses (N, 3, 3), (N, 3), and rig_from_cam.

        `R`, `p`: (K, 3, 3), (K, 3) world_from_rig of all exposures.
        """
        out = []
        for i, cam in enumerate(self._cams):
            index = np.flatnonzero(self.cam == i)
            out.append((index, R[self.exposure[index]], p[self.exposure[index]], cam))
        return out

    def triangulate(self, R: F64, p: F64) -> None:
        """Set every point to the position nearest to its rays, for rig poses `R` (K, 3, 3), `p` (K, 3)."""
        rays, origins = np.empty((len(self.cam), 3)), np.empty((len(self.cam), 3))
        for index, R_rig, p_rig, cam in self._by_camera(R, p):
            in_rig = np.column_stack([self.normalised[index], np.ones(len(index))]) @ cam.rotation.T
            rays[index] = np.einsum("nij,nj->ni", R_rig, in_rig)
            origins[index] = p_rig + R_rig @ cam.translation
        self.points = triangulate_rays(self.starts, rays, origins, np.ones(len(self.cam)))

    def residuals(self, R: F64, p: F64) -> F64:
        """Return (M, 2) residuals, observed less predicted, at K rig poses `R`, `p`; NaN: a point behind the camera."""
        out = np.full((len(self.cam), 2), np.nan)
        for index, R_rig, p_rig, cam in self._by_camera(R, p):
            q = in_camera(R_rig, p_rig, cam, self.points[self.segment[index]])
            with np.errstate(divide="ignore", invalid="ignore"):
                out[index] = np.where(q[:, 2:] > NEAR, self.normalised[index] - q[:, :2] / q[:, 2:], np.nan)
        return out

    def reweigh(self, R: F64, p: F64) -> float:
        """Set the weights of the Cauchy cost at K rig poses `R`, `p`; return the weighted residuals' rms, in sigmas."""
        # weights are multiplied by the mean of their segment, because a point that moves is wrong as a whole. The scale
        # follows the median residual down to two sigmas, so that poor initial poses do not look like bad observations
        e = self.residuals(R, p) / self.sigma[:, None]
        square = (e**2).sum(axis=1)
        valid = np.isfinite(square)
        median = float(np.median(square[valid])) if valid.any() else 0.0
        weight, _ = cauchy(np.where(valid, square, np.inf), np.sqrt(max(2.0**2, 2.0 * median)))
        of_segment = np.bincount(self.segment, weight, self.count) / np.diff(self.starts)
        self.weights = np.where(valid, weight * of_segment[self.segment], 0.0)
        total = (self.weights[valid] * square[valid]).sum()
        return float(np.sqrt(total / max(2 * self.weights.sum(), 1e-12)))

    def median_misfit(self, R: F64, p: F64) -> float:
        """Return the median over segments of the squared residual (in sigmas) per degree of freedom; 0 if none exist.

        `R`, `p`: K rig poses. Segments with a point behind a camera rank last; if most are such, the
        largest value of the others is returned.
        """
        square = ((self.residuals(R, p) / self.sigma[:, None]) ** 2).sum(axis=1)
        freedom = np.maximum(2 * np.diff(self.starts) - 3, 1)
        misfit = np.bincount(self.segment, np.nan_to_num(square, nan=np.inf), self.count) / freedom
        median = float(np.median(misfit)) if self.count else 0.0
        return median if np.isfinite(median) else float(misfit[np.isfinite(misfit)].max(initial=0.0))

    def linearise(self, R: F64, p: F64) -> LinearisedSegments:
        """Linearise the weighted observations at rig poses `R` (K, 3, 3), `p` (K, 3) and the present points."""
        e = np.nan_to_num(self.residuals(R, p))
        by_pose, by_point = np.zeros((len(e), 2, 6)), np.zeros((len(e), 2, 3))
        for index, R_rig, p_rig, cam in self._by_camera(R, p):
            by_pose[index], by_point[index] = jacobians(R_rig, p_rig, cam, self.points[self.segment[index]])
        unit = (np.sqrt(self.weights) / self.sigma)[:, None]
        return LinearisedSegments(self, e * unit, by_pose * unit[..., None], by_point * unit[..., None])


class LinearisedSegments:
    """Linearised observations of track segments with the points eliminated (Schur complement, M21)."""

    def __init__(self, segments: TrackSegments, residual: F64, by_pose: F64, by_point: F64) -> None:
        self._segments, self._residual, self._by_pose, self._by_point = segments, residual, by_pose, by_point
        n, m = segments.count, len(residual)
        self._coupling, self._gradient = np.empty((m, 6, 3)), np.empty((n, 3))  # G, and the right side of the points
        root, self._covariance = np.empty((n, 3, 3)), np.empty((n, 3, 3))  # of the points, for exact poses
        given = segments.starts, residual, by_pose, by_point, _POINT_PRIOR
        eliminate_list(*given, self._coupling, self._gradient, root, self._covariance)
        self._reduced_gradient = np.einsum("nji,nj->ni", root, self._gradient)  # z

    def reduced(self, start: int, stop: int, span: int) -> tuple[F64, F64]:
        """Return the normal equations of 2 `span` poses from `start` on, by the segments that begin in [start, stop).

        Returns:
            Matrix (12 span, 12 span) and right side (12 span,).
        """
        s = self._segments
        chosen = np.flatnonzero((s.first >= start) & (s.first < stop))
        n = 12 * span
        H, g = np.zeros((n, n)), np.zeros(n)
        slot = np.full(s.count, -1)
        slot[chosen] = np.arange(len(chosen))
        rows = np.flatnonzero(slot[s.segment] >= 0)
        k, j, A = s.exposure[rows] - start, slot[s.segment[rows]], self._by_pose[rows]
        own = np.zeros((2 * span, 6, 6))
        np.add.at(own, k, np.einsum("nki,nkj->nij", A, A))
        for i in range(2 * span):
            H[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = own[i]
        np.add.at(g.reshape(-1, 6), k, np.einsum("nki,nk->ni", A, self._residual[rows]))
        coupling = np.zeros((2 * span, len(chosen), 6, 3))
        np.add.at(coupling, (k, j), self._coupling[rows])
        G = coupling.transpose(0, 2, 1, 3).reshape(n, -1)
        return H - G @ G.T, g - G @ self._reduced_gradient[chosen].ravel()

    def move_points(self, pose_step: F64) -> None:
        """Move the points by the steps that follow from a (K, 6) step of the poses."""
        s = self._segments
        predicted = np.einsum("nki,ni->nk", self._by_pose, pose_step[s.exposure])
        moved = np.add.reduceat(np.einsum("nki,nk->ni", self._by_point, predicted), s.starts[:-1])
        s.points = s.points + np.einsum("nij,nj->ni", self._covariance, self._gradient - moved)


def _segment_of(exposure: I64, ids: I64, span: int) -> I64:
    """Return the segment number of each observation (M,): tracks are cut every `span` exposures from their first one.

    `exposure`, `ids`: (M,) index of the exposure and id of the feature.
    """
    if not len(ids):
        return np.zeros(0, np.int64)
    _, feature = np.unique(ids, return_inverse=True)
    first = np.full(int(feature.max()) + 1, exposure.max())
    np.minimum.at(first, feature, exposure)
    key = feature * (int(exposure.max()) + 1) + (exposure - first[feature]) // span
    return np.asarray(np.unique(key, return_inverse=True)[1])
