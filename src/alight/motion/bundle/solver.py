"""The adjustment itself: Levenberg-Marquardt over poses, lens, mounting and points, points eliminated (Schur).

Own code and not pycolmap's adjuster, whose priors know positions only: a straight strip would be free to roll about
its line of flight. Equation numbers: docs/method/bundle.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from alight.arrays import F64
from alight.geometry import Pose, so3_exp, so3_log
from alight.motion.bundle.lenses import PhotoLenses, lens_camera
from alight.motion.bundle.matching import BundleObservations
from alight.motion.bundle.rolling import turning
from alight.motion.elimination import EliminatedPoints, eliminate_points, sum_by_point
from alight.motion.projection import MIN_DEPTH, POSITION_FIRST, in_camera, jacobians
from alight.motion.robust import cauchy, huber
from alight.motion.triangulation import triangulate_rays

_PRIOR_LOSS = 3.0  # sigmas, Huber scale of GPS and gimbal; with Cauchy one GPS jump stretched the whole survey
_DENSE = 1200  # unknowns, up to which the normal equations are solved as a dense matrix
_LEAST_INFORMATION = 1e-12  # of a direction, over that of the numbers it is made of
_POINT_PRIOR = 1e-12  # 1/m^2 on the diagonal of a point's information
_CAMERA = Pose(np.eye(3))  # a photo's pose is that of its camera


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors from GPS, gimbal and the maker's calibration. NaN = none."""

    centres: F64  # (n, 3) metres
    sigma_centres: F64  # (n, 3) metres
    world_from_body: F64  # (n, 3, 3)
    sigma_rotation: F64  # (n, 3) rad, about the world's axes
    body_from_cam: F64  # (3, 3)
    sigma_mounting: float  # rad; 0 holds it
    lenses: PhotoLenses
    sigma_lens: F64  # (k,) of scale, aspect, cu, cv, distortion..., readout of each camera in turn; 0 holds one
    velocity: F64  # (n, 3) m/s when the photos were taken; 0: not known
    sigma_turn: float = 0.0  # rad, by which a photo may turn while it is read out; 0: rows are exposed at once


@dataclass(frozen=True, eq=False)
class BundleState:
    """Everything that is estimated."""

    centres: F64  # (n, 3) metres
    rotations: F64  # (n, 3, 3) world_from_cam
    points: F64  # (m, 3) metres
    lens: F64  # (k,) offsets from the prior cameras, one after the other: scale and aspect relative, px, coefficients
    mounting: F64  # (3,) rotation vector in the body: world_from_cam = world_from_body exp(m) body_from_cam
    turns: F64  # (n, 2, 3) rotation vectors in the camera while its rows are exposed: even, and bent in time

    def exposed(self, obs: BundleObservations, lenses: PhotoLenses, velocity: F64) -> tuple[F64, F64, F64]:
        """Rotation (N, 3, 3) and centre (N, 3) when each observed row was exposed, and when, in readouts (eq. 10)."""
        R, C = self.rotations[obs.photo], self.centres[obs.photo]
        t = lenses.row_time(obs.photo, obs.pixels)
        if any(lenses.readouts):
            C = C + velocity[obs.photo] * (lenses.readout(obs.photo) * t)[:, None]
        if self.turns.any():
            R = R @ so3_exp(np.einsum("nk,nki->ni", turning(t), self.turns[obs.photo]))
        return R, C, t


def project_points(state: BundleState, obs: BundleObservations, lenses: PhotoLenses, velocity: F64) -> tuple[F64, F64]:
    """Return (N, 2) predicted pixels and (N, 3) points in the cameras' frames (eq. 1)."""
    R, C, _ = state.exposed(obs, lenses, velocity)
    p = in_camera(R, C, _CAMERA, state.points[obs.point])
    return lenses.project(obs.photo, p), p


def residuals(state: BundleState, obs: BundleObservations, priors: Priors) -> F64:
    """Return (N, 2) pixels, predicted less observed; a point behind the camera has a large residual."""
    r = project_points(state, obs, priors.lenses.moved(state.lens), priors.velocity)[0] - obs.pixels
    return np.nan_to_num(np.clip(r, -1e4, 1e4), nan=1e4)


def _attitude(state: BundleState, priors: Priors) -> tuple[NDArray[np.int64], F64, F64]:
    """Return the photos with an attitude prior, (k, 3) residuals, (k, 3, 3) derivatives by the mounting (eq. 5)."""
    who = np.flatnonzero(
        np.isfinite(priors.world_from_body).all(axis=(1, 2)) & np.isfinite(priors.sigma_rotation).all(axis=1)
    )
    body = priors.world_from_body[who]
    expected = body @ (so3_exp(state.mounting) @ priors.body_from_cam)
    r = so3_log(state.rotations[who] @ np.swapaxes(expected, 1, 2)) if len(who) else np.zeros((0, 3))
    return who, r, -body


def prior_cost(state: BundleState, priors: Priors) -> float:
    """Return the cost of GPS, gimbal, mounting and lens (eqs. 4 to 6)."""
    g = np.nan_to_num((state.centres - priors.centres) / priors.sigma_centres)
    who, a, _ = _attitude(state, priors)
    cost = huber((g**2).sum(axis=1), _PRIOR_LOSS)[1]
    cost += huber(((a / priors.sigma_rotation[who]) ** 2).sum(axis=1), _PRIOR_LOSS)[1]
    free = priors.sigma_lens > 0
    cost += float(((state.lens[free] / priors.sigma_lens[free]) ** 2).sum())
    if priors.sigma_turn > 0:
        cost += float(((state.turns / priors.sigma_turn) ** 2).sum())
    return cost + (float((state.mounting**2).sum()) / priors.sigma_mounting**2 if priors.sigma_mounting > 0 else 0.0)


def total_cost(state: BundleState, obs: BundleObservations, priors: Priors, pixel_sigma: float, loss: float) -> float:
    """Return the whole robust cost; `loss` is the Cauchy scale of the pictures in sigmas."""
    r = residuals(state, obs, priors) / pixel_sigma
    return cauchy((r**2).sum(axis=1), loss)[1] + prior_cost(state, priors)


def _jacobians(state: BundleState, obs: BundleObservations, priors: Priors) -> tuple[F64, F64, F64, F64]:
    """Return residuals (N, 2), derivatives by pose (N, 2, 6), point (N, 2, 3), free lens numbers (N, 2, k) (eq. 2).

    A photo that may turn while it is read out has six unknowns more, (N, 2, 12) (eq. 11).
    """
    lenses = priors.lenses.moved(state.lens)
    x = state.points[obs.point]
    R, C, t = state.exposed(obs, lenses, priors.velocity)
    p = in_camera(R, C, _CAMERA, x)
    xy = p[:, :2] / np.maximum(p[:, 2:], MIN_DEPTH)
    by_pose, by_point = jacobians(R, C, _CAMERA, x)
    f = lenses.focal(obs.photo)
    h = 1e-6
    by_xy = np.stack(
        [
            (lenses.distort(obs.photo, xy + e) - lenses.distort(obs.photo, xy - e)) / (2 * h)
            for e in ([h, 0.0], [0.0, h])
        ],
        axis=2,
    )
    lens = by_xy * f[:, :, None]  # pixels by normalised coordinates
    pose, point = lens @ by_pose[:, :, POSITION_FIRST], lens @ by_point
    by_readout = np.einsum("nki,ni->nk", point, -priors.velocity[obs.photo] * t[:, None])
    if priors.sigma_turn > 0:
        by_turn = pose[:, :, 3:] @ state.rotations[obs.photo]
        pose = np.concatenate([pose, *(by_turn * of[:, None, None] for of in turning(t).T)], axis=2)
    return residuals(state, obs, priors), pose, point, _by_lens(state, xy, obs.photo, priors, by_readout)


def _by_lens(state: BundleState, xy: F64, photo: NDArray[np.int64], priors: Priors, by_readout: F64) -> F64:
    """Return the (N, 2, k) derivative of pixels at normalised coordinates by the free lens numbers."""
    columns = []
    for c, camera, rows in priors.lenses.by_camera(photo):
        part, at = priors.lenses.parts[c], xy[rows]
        for k in np.flatnonzero(priors.sigma_lens[part] > 0):
            step = np.zeros(part.stop - part.start)
            step[k] = 1e-5
            column = np.zeros((len(xy), 2))
            if k == len(step) - 1:
                column[rows] = by_readout[rows]
            else:
                ends = (lens_camera(camera, state.lens[part] + s * step) for s in (1, -1))
                plus, minus = (e.distort(at) * [e.fu, e.fv] + [e.cu, e.cv] for e in ends)
                column[rows] = (plus - minus) / 2e-5
            columns.append(column)
    return np.stack(columns, axis=2) if columns else np.zeros((len(xy), 2, 0))


class Adjustment:
    """One Gauss-Newton system over fixed observations: build it, step, accept or damp."""

    def __init__(self, obs: BundleObservations, priors: Priors, pixel_sigma: float, loss: float) -> None:
        self.obs, self.priors, self.pixel_sigma, self.loss = obs, priors, pixel_sigma, loss
        self.photos = len(priors.centres)
        self.free = np.flatnonzero(priors.sigma_lens > 0)
        self.mounted = priors.sigma_mounting > 0
        self.each = 12 if priors.sigma_turn > 0 else 6  # unknowns of a photo: position, rotation, and its turns
        self.size = self.each * self.photos + len(self.free) + 3 * self.mounted
        self._starts = np.append(obs.starts, len(obs.point))

    def cost(self, state: BundleState) -> float:
        """Return the whole robust cost."""
        return total_cost(state, self.obs, self.priors, self.pixel_sigma, self.loss)

    def linearise(self, state: BundleState) -> None:
        """Build the blocks of the normal equations (eq. 7)."""
        obs, each, n6 = self.obs, self.each, self.each * self.photos
        r, A, B, L = _jacobians(state, obs, self.priors)
        w = np.sqrt(cauchy((r**2).sum(axis=1) / self.pixel_sigma**2, self.loss)[0]) / self.pixel_sigma
        r, A, B, L = r * w[:, None], A * w[:, None, None], B * w[:, None, None], L * w[:, None, None]
        U, b = self._prior_blocks(state)
        AT = np.swapaxes(A, 1, 2)
        pose = _sum_by(obs.photo, AT @ A, self.photos)
        for i in range(self.photos):
            U[each * i : each * (i + 1), each * i : each * (i + 1)] += pose[i]
        b[:n6] -= _sum_by(obs.photo, np.einsum("nki,nk->ni", A, r), self.photos).ravel()
        lens = slice(n6, n6 + len(self.free))
        cross = _sum_by(obs.photo, AT @ L, self.photos).reshape(n6, -1)
        U[:n6, lens] += cross
        U[lens, :n6] += cross.T
        U[lens, lens] += np.einsum("nki,nkj->ij", L, L)
        b[lens] -= np.einsum("nki,nk->i", L, r)
        self.U, self.b = U, b
        self.rows = (-r, A, B)  # residual, Jacobians by pose and by point, in sigmas
        self.by_lens = L
        self.lens_coupling = sum_by_point(self._starts, np.swapaxes(L, 1, 2) @ B)  # (m, k, 3)

    def _prior_blocks(self, state: BundleState) -> tuple[F64, F64]:
        pr, n = self.priors, self.photos
        U, b = np.zeros((self.size, self.size)), np.zeros(self.size)
        g = np.nan_to_num((state.centres - pr.centres) / pr.sigma_centres)
        w = huber((g**2).sum(axis=1), _PRIOR_LOSS)[0][:, None] * np.isfinite(pr.centres) / pr.sigma_centres**2
        at = self.each * np.arange(n)[:, None] + np.arange(3)
        U[at, at] += w
        b[at] -= w * np.nan_to_num(state.centres - pr.centres)
        who, r, by_mounting = _attitude(state, pr)
        s2 = pr.sigma_rotation[who] ** 2
        w = huber((r**2 / s2).sum(axis=1), _PRIOR_LOSS)[0][:, None] / s2
        rows = at[who] + 3
        U[rows, rows] += w
        b[rows] -= w * r
        if pr.sigma_turn > 0:
            turns = self.each * np.arange(n)[:, None] + np.arange(6, 12)
            U[turns, turns] += pr.sigma_turn**-2
            b[turns] -= state.turns.reshape(n, 6) / pr.sigma_turn**2
        k = np.arange(len(self.free)) + self.each * n
        U[k, k] += 1.0 / pr.sigma_lens[self.free] ** 2
        b[k] -= state.lens[self.free] / pr.sigma_lens[self.free] ** 2
        if self.mounted:
            m = slice(self.size - 3, self.size)
            cross = w[:, :, None] * by_mounting
            U[rows, m] += cross
            U[m, rows.ravel()] += cross.reshape(-1, 3).T
            U[m, m] += np.einsum("nki,nkj->ij", by_mounting, cross) + np.eye(3) / pr.sigma_mounting**2
            b[m] -= np.einsum("nki,nk->i", cross, r) + state.mounting / pr.sigma_mounting**2
        return U, b

    def reduce(self, damping: float) -> tuple[F64, F64, EliminatedPoints]:
        """Eliminate the points (eq. 8): reduced matrix (p, p), right side (p,), and the eliminated points."""
        points = eliminate_points(self._starts, *self.rows, _POINT_PRIOR, damping)
        n6, k, m = self.each * self.photos, len(self.free), len(points.root)
        pose = np.ascontiguousarray(np.swapaxes(points.coupling, 1, 2))
        GT = sparse.bsr_array((pose, self.obs.photo, self._starts), shape=(3 * m, n6))
        lens = np.swapaxes(self.lens_coupling @ points.root, 1, 2).reshape(3 * m, k)
        S, rhs = self.U.copy(), self.b.copy()
        S[:n6, :n6] -= (GT.T @ GT).toarray()
        cross = np.asarray(GT.T @ lens)
        L = slice(n6, n6 + k)
        S[:n6, L] -= cross
        S[L, :n6] -= cross.T
        S[L, L] -= lens.T @ lens
        z = points.reduced_gradient.ravel()
        rhs[:n6] -= GT.T @ z
        rhs[L] -= lens.T @ z
        return S + damping * np.diag(np.diag(self.U)), rhs, points

    def step(self, state: BundleState, damping: float) -> BundleState:
        """Return the state after one damped step."""
        S, rhs, points = self.reduce(damping)
        x = solved_steps(S + 1e-12 * np.eye(len(S)), rhs)
        n6, k = self.each * self.photos, len(self.free)
        pose, lens, mount = x[:n6].reshape(-1, self.each), x[n6 : n6 + k], x[n6 + k :]
        predicted = np.einsum("nki,ni->nk", self.rows[1], pose[self.obs.photo]) + self.by_lens @ lens
        offsets = state.lens.copy()
        offsets[self.free] += lens
        return BundleState(
            state.centres + pose[:, :3],
            so3_exp(pose[:, 3:6]) @ state.rotations,
            state.points + points.point_step(predicted),
            offsets,
            state.mounting + mount if self.mounted else state.mounting,
            state.turns + pose[:, 6:].reshape(-1, 2, 3) if self.each > 6 else state.turns,
        )

    def solve(self, state: BundleState, iterations: int, tolerance: float = 1e-7) -> BundleState:
        """Iterate (Levenberg-Marquardt) until the cost falls by less than a share; a step that costs more is damped."""
        damping, cost = 1e-5, self.cost(state)
        self.linearise(state)
        for _ in range(iterations):
            try:
                trial = self.step(state, damping)
                new = self.cost(trial)
            except (np.linalg.LinAlgError, ValueError):
                new = np.inf
            if new > cost:
                damping *= 10.0
                if damping > 1e6:
                    break
                continue
            done = cost - new < tolerance * cost
            state, cost, damping = trial, new, max(damping / 10.0, 1e-12)
            if done:
                break
            self.linearise(state)
        return state

    def covariance(self, state: BundleState) -> F64:
        """Return (6 n + k, 6 n + k) of poses (position, rotation) and free lens numbers (eq. 9).

        Mounting, points, turns and readouts are marginalised.
        """
        self.linearise(state)
        S = self.reduce(0.0)[0]
        C = covariance_of(S)
        poses = (self.each * np.arange(self.photos)[:, None] + np.arange(6)).ravel()
        lens = self.each * self.photos + np.flatnonzero(~np.isin(self.free, self.priors.lenses.readout_numbers))
        of = np.concatenate([poses, lens])
        return np.asarray(C[np.ix_(of, of)])


def covariance_of(S: F64) -> F64:
    """The inverse of an information matrix (p, p), with positive variances also where rounding left it none.

    What nothing fixes, as among photos of which most are no photos of this ground, gets a large variance.
    """
    C = np.linalg.inv(S + 1e-9 * np.eye(len(S)))
    if np.isfinite(C).all() and (np.diag(C) > 0).all():
        return np.asarray(C)
    size = np.sqrt(np.maximum(np.diag(S), _LEAST_INFORMATION))
    values, vectors = np.linalg.eigh((S + S.T) / (2.0 * np.outer(size, size)))
    known = np.maximum(values, _LEAST_INFORMATION * len(S))
    return np.asarray((vectors / known) @ vectors.T / np.outer(size, size))


def solved_steps(S: F64, rhs: F64) -> F64:
    """Solve the reduced normal equations (p, p); of many photos as a sparse matrix, since each meets few others.

    Of 1000 photos in strips 3 % of the factor are filled, and it takes a fiftieth of the time.

    Raises:
        LinAlgError: the matrix is singular.
    """
    if len(S) <= _DENSE:
        return np.asarray(np.linalg.solve(S, rhs))  # SciPy's Cholesky waits 0.5 s for threads on a busy machine
    try:
        symmetric = {"SymmetricMode": True}
        factor = splu(sparse.csc_array(S), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    except RuntimeError as e:
        raise np.linalg.LinAlgError(str(e)) from e
    return np.asarray(factor.solve(rhs))


def _sum_by(group: NDArray[np.int64], values: F64, count: int) -> F64:
    """Sum rows of (N, ...) values into (count, ...) by group."""
    flat = values.reshape(len(values), -1)
    chosen = sparse.csr_array((np.ones(len(group)), (group, np.arange(len(group)))), shape=(count, len(group)))
    return np.asarray(chosen @ flat).reshape(count, *values.shape[1:])


def triangulate_bundle(
    state: BundleState,
    lenses: PhotoLenses,
    velocity: F64,
    obs: BundleObservations,
    rounds: int = 4,
    scale_px: float = 3.0,
) -> F64:
    """Return (m, 3) points nearest to their rays (midpoint method), with Cauchy weights."""
    ray = lenses.rays(obs.photo, obs.pixels)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    R, C, _ = state.exposed(obs, lenses, velocity)
    ray = np.einsum("nij,nj->ni", R, ray)
    starts, weight = np.append(obs.starts, len(obs.point)), np.ones(len(ray))
    points, focal = np.empty((obs.points, 3)), lenses.focal(obs.photo)[:, 0]
    for _ in range(rounds):
        points = triangulate_rays(starts, ray, C, weight)
        offset = points[obs.point] - C
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
        across = offset - ray * np.einsum("ni,ni->n", ray, offset)[:, None]
        angle_px = np.linalg.norm(across, axis=1) / distance * focal
        weight = cauchy(angle_px**2, scale_px)[0] / distance**2
        if len(weight):
            weight /= weight.max()
    return points


def intersection_angle(points: F64, centres: F64, obs: BundleObservations) -> F64:
    """Return (m,) the angle in rad between the first ray of each point and the one farthest from it."""
    d = points[obs.point] - centres[obs.photo]
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    first = d[obs.starts][obs.point]
    sine = np.linalg.norm(np.cross(first, d), axis=1)
    return np.asarray(np.maximum.reduceat(np.arcsin(np.minimum(sine, 1.0)), obs.starts))
