"""Joint Gaussian over the poses of the exposures and the plane of the map (docs/method/recursive.md, eqs. 22 to 25).

The keyframe posterior of the navigation lane initialises it, the pictures update it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Pose, so3_exp, so3_log
from alight.parallax.pose_refinement.kernels import PLANE, POSE
from alight.records import KeyframePosterior


def corrected_pose(pose: Pose, error: F64) -> Pose:
    """Return `pose` with `error` (6,) added: position [m], then rotation vector [rad], in world axes."""
    return Pose(so3_exp(error[3:]) @ pose.rotation, pose.translation + error[:3])


def corrected_poses(poses: dict[int, Pose], error: F64) -> dict[int, Pose]:
    """Return the poses of E exposures with `error` (3 + 6E,) added; its first three elements are the plane's."""
    errors = error[PLANE:].reshape(-1, POSE)
    return {t: corrected_pose(p, e) for (t, p), e in zip(poses.items(), errors, strict=True)}


def between(a: Pose, b: Pose) -> F64:
    """Return the error (6,), position [m] and rotation vector [rad], that must be added to pose `a` to get pose `b`."""
    return np.concatenate([b.translation - a.translation, so3_log(b.rotation @ a.rotation.T)])


@dataclass(frozen=True, eq=False)
class PoseGaussian:
    """Joint Gaussian of errors that must be added to the map's plane and to E poses.

    The plane's error is its offset up [m] and its rise per metre towards east and north [rad]. The error of a pose is
    its position [m] and rotation vector [rad] in world axes.
    """

    poses: dict[int, Pose]  # world_from_body by t_ns of the exposures
    covariance: F64  # (3 + 6E, 3 + 6E)
    plane: F64  # (3,) mean error of the map's plane
    start: F64  # (3 + 6E,) initial error of the next solve: the result of the last solve

    @classmethod
    def none(cls, plane_sigma: F64) -> PoseGaussian:
        """Return a distribution without exposures, whose plane has the 1-sigma `plane_sigma` (3,)."""
        return cls({}, np.diag(plane_sigma**2), np.zeros(PLANE), np.zeros(PLANE))

    def rows(self, times: Collection[int]) -> NDArray[np.int64]:
        """Return the rows of the covariance that belong to the exposures at these times, ns."""
        return PLANE + _rows_of([k for k, t in enumerate(self.poses) if t in times])

    def with_posterior(self, posterior: KeyframePosterior) -> PoseGaussian:
        """Return the distribution in which `posterior` replaces the distribution of the keyframes (eq. 23).

        The distribution of all other unknowns given the keyframes stays, so that they follow the keyframes. New
        exposures are appended.
        """
        at = {m.t_ns: k for k, m in enumerate(posterior.motions)}
        shared = [t for t in self.poses if t in at]
        new = [t for t in at if t not in self.poses]
        mine, rest = self.rows(shared), np.setdiff1d(np.arange(len(self.covariance)), self.rows(shared))
        theirs, theirs_new = (_rows_of([at[t] for t in ts]) for ts in (shared, new))
        P, Q = self.covariance, posterior.covariance
        gain = regress_on(P[np.ix_(mine, mine)], P[np.ix_(mine, rest)])
        out = np.zeros((len(P) + len(theirs_new),) * 2)
        fresh = np.arange(len(P), len(out))
        S = Q[np.ix_(theirs, theirs)]
        out[np.ix_(mine, mine)] = S
        out[np.ix_(rest, rest)] = P[np.ix_(rest, rest)] + gain @ (S - P[np.ix_(mine, mine)]) @ gain.T
        out[np.ix_(mine, rest)] = S @ gain.T
        out[np.ix_(fresh, fresh)] = Q[np.ix_(theirs_new, theirs_new)]
        out[np.ix_(fresh, mine)] = Q[np.ix_(theirs_new, theirs)]
        out[np.ix_(fresh, rest)] = Q[np.ix_(theirs_new, theirs)] @ gain.T
        out[np.ix_(rest, mine)] = out[np.ix_(mine, rest)].T
        out[: len(P), len(P) :] = out[len(P) :, : len(P)].T
        shift = np.zeros(len(P))
        for t in shared:
            shift[self.rows([t])] = between(self.poses[t], posterior.motions[at[t]].world_from_body)
        shift[rest] = gain @ shift[mine]
        means = corrected_poses(self.poses, shift) | {t: posterior.motions[at[t]].world_from_body for t in new}
        lead = regress_on(S, Q[np.ix_(theirs, theirs_new)]) @ (self.start - shift)[mine]
        return PoseGaussian(means, out, self.plane + shift[:PLANE], np.concatenate([self.start - shift, lead]))

    def kept(self, times: Collection[int]) -> PoseGaussian:
        """Return the distribution of the plane and of the exposures at `times`, ns; others are marginalised."""
        keep = np.concatenate([np.arange(PLANE), self.rows(times)])
        poses = {t: p for t, p in self.poses.items() if t in times}
        return replace(self, poses=poses, covariance=self.covariance[np.ix_(keep, keep)], start=self.start[keep])

    def corrected(self, error: F64, covariance: F64) -> PoseGaussian:
        """Return the distribution with `error` (3 + 6E,) added to its poses, no plane error, and this `covariance`."""
        poses, start = corrected_poses(self.poses, error), np.zeros(len(error))
        return replace(self, poses=poses, covariance=covariance, plane=np.zeros(PLANE), start=start)


def regress_on(P: F64, across: F64) -> F64:
    """Return the regression coefficients (m, n) of m variables on n variables.

    Args:
        P: (n, n) covariance of the n variables.
        across: (n, m) cross-covariance of both groups.
    """
    # errors common to all n variables make `P` singular; 1e-9 of its variances is added, which changes nothing else
    if not len(P):
        return np.zeros((across.shape[1], 0))
    return np.asarray(np.linalg.solve(P + np.diag(1e-9 * np.diag(P) + 1e-18), across).T)


def _rows_of(at: list[int]) -> NDArray[np.int64]:
    return (POSE * np.array(at, np.int64)[:, None] + np.arange(POSE)).ravel()
