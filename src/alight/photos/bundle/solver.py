"""The adjustment itself: Levenberg-Marquardt over poses, lens, mounting and points, points eliminated (Schur).

Own code and not pycolmap's adjuster, which has priors of positions only: a straight strip would be free to roll about
its line of flight. Equation numbers: docs/method/bundle.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from alight.arrays import F64, I64
from alight.geometry import so3_exp, so3_log
from alight.motion.ekf.state_kernels import mirror_lower
from alight.motion.points import WEAK_PRIOR
from alight.motion.robust import cauchy, huber
from alight.photos.bundle.adjustment_kernels import FAR, linearise, predict_pixels
from alight.photos.bundle.elimination_kernels import eliminate, move_points
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.ray_kernels import meet_rays, rays_of_pixels, widest_angles

_PRIOR_LOSS = 3.0  # sigmas, Huber scale of GPS and gimbal; with Cauchy one GPS jump stretched the whole survey
_DENSE = 1200  # unknowns, up to which the normal equations are solved as a dense matrix
_LEAST_INFORMATION = 1e-12  # least information of a direction, over that of its components
_POINT_PRIOR = 1e-12  # 1/m^2 on the diagonal of a point's information


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
    sigma_turn: float = 0.0  # rad, 1-sigma of a photo's turn during the readout; 0: rows are exposed at once


@dataclass(frozen=True, eq=False)
class BundleState:
    """All estimated unknowns."""

    centres: F64  # (n, 3) metres
    rotations: F64  # (n, 3, 3) world_from_cam
    points: F64  # (m, 3) metres
    lens: F64  # (k,) offsets from the prior cameras, one after the other: scale and aspect relative, px, coefficients
    mounting: F64  # (3,) rotation vector in the body: world_from_cam = world_from_body exp(m) body_from_cam
    turns: F64  # (n, 2, 3) rotation vectors in the camera during the readout: linear, and quadratic in time

    def for_kernels(self, obs: BundleObservations, lenses: PhotoLenses, velocity: F64) -> tuple[F64 | I64, ...]:
        """Observations, poses and lenses as input of the kernels, in their order (`adjustment_kernels`)."""
        lens, model = lenses.table()
        poses = (self.rotations, self.centres, self.turns, velocity)
        return obs.photo, obs.pixels, *map(np.ascontiguousarray, poses), lenses.of, lens, model


def project_points(state: BundleState, obs: BundleObservations, lenses: PhotoLenses, velocity: F64) -> tuple[F64, F64]:
    """Return (N, 2) predicted pixels, NaN behind the camera, and (N,) depths in m (eqs. 1, 10)."""
    pixels, depth = np.empty((len(obs.photo), 2)), np.empty(len(obs.photo))
    predict_pixels(*state.for_kernels(obs, lenses, velocity), obs.point, state.points, pixels, depth)
    return pixels, depth


def residuals(state: BundleState, obs: BundleObservations, priors: Priors) -> F64:
    """Return (N, 2) pixels, predicted less observed; a point behind the camera has a large residual."""
    r = project_points(state, obs, priors.lenses.moved(state.lens), priors.velocity)[0] - obs.pixels
    return np.nan_to_num(np.clip(r, -FAR, FAR), nan=FAR)


def _attitude(state: BundleState, priors: Priors) -> tuple[I64, F64, F64]:
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


def total_cost(state: BundleState, obs: BundleObservations, priors: Priors, pixel_sigma: F64, loss: float) -> float:
    """Return the whole robust cost; `pixel_sigma` (N,) px, `loss` is the Cauchy scale of the pictures in sigmas."""
    r = residuals(state, obs, priors) / pixel_sigma[:, None]
    return cauchy((r**2).sum(axis=1), loss)[1] + prior_cost(state, priors)


class Adjustment:
    """One Gauss-Newton system over fixed observations: build it, step, accept or damp.

    Args:
        obs: N of them.
        priors: of GPS, gimbal and lens.
        pixel_sigma: (N,) px, 1-sigma of each observation.
        loss: Cauchy scale in sigmas.
    """

    def __init__(self, obs: BundleObservations, priors: Priors, pixel_sigma: F64, loss: float) -> None:
        self.obs, self.priors, self.pixel_sigma, self.loss = obs, priors, pixel_sigma, loss
        self.photos = len(priors.centres)
        self.free = np.flatnonzero(priors.sigma_lens > 0)
        self.mounted = priors.sigma_mounting > 0
        self.each = 12 if priors.sigma_turn > 0 else 6  # unknowns of a photo: position, rotation, and its turns
        self.size = self.each * self.photos + len(self.free) + 3 * self.mounted
        self._starts = np.append(obs.starts, len(obs.point))
        self._numbers, self._places = priors.lenses.free_numbers(priors.sigma_lens > 0)
        self._scales = np.array([[part.start, part.start + 1] for part in priors.lenses.parts])
        self._longest = int(np.diff(self._starts).max(initial=1))

    def cost(self, state: BundleState) -> float:
        """Return the whole robust cost."""
        return total_cost(state, self.obs, self.priors, self.pixel_sigma, self.loss)

    def linearise(self, state: BundleState) -> None:
        """Build the blocks of the normal equations (eq. 7)."""
        obs, pr, m, k = self.obs, self.priors, self.obs.points, len(self.free)
        at = self._unknowns()
        own, right = np.zeros((*at.shape, at.shape[1])), np.zeros(at.shape)
        self.coupling, self.lens_coupling = np.empty((len(obs.photo), 3, self.each)), np.zeros((m, 3, k))
        self.information, self.gradient = np.zeros((m, 3, 3)), np.zeros((m, 3))
        linearise(
            *state.for_kernels(obs, pr.lenses.moved(state.lens), pr.velocity), obs.point, state.points,
            1.0 + state.lens[self._scales], self._numbers, self._places, self.each, self.pixel_sigma, self.loss,
            own, right, self.coupling, self.lens_coupling, self.information, self.gradient,
        )  # fmt: skip
        self.U, self.b = self._prior_blocks(state)  # of U the lower triangle
        np.add.at(self.U, (at[:, :, None], at[:, None, :]), own)
        np.add.at(self.b, at, right)

    def _unknowns(self) -> I64:
        """(n, e + f) indices of each photo's unknowns, and of its lens's free numbers; 0 where a lens has fewer."""
        photos = self.each * np.arange(self.photos)[:, None] + np.arange(self.each)
        lens = self._places[self.priors.lenses.of]
        return np.concatenate([photos, np.where(lens >= 0, self.each * self.photos + lens, 0)], axis=1)

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

    def reduce(self, damping: float) -> tuple[F64, F64]:
        """Eliminate the points (eq. 8): reduced matrix (p, p), right side (p,)."""
        S, rhs = self.U.copy(), self.b.copy()
        S[np.diag_indices_from(S)] *= 1.0 + damping
        scratch, self.covariances = np.empty((self._longest, 3, self.each)), np.empty_like(self.information)
        eliminate(
            self._starts, self.obs.photo, self.coupling, self.lens_coupling, self.information, self.gradient,
            damping, _POINT_PRIOR, self.each * self.photos, scratch, S, rhs, self.covariances,
        )  # fmt: skip
        mirror_lower(S)
        return S, rhs

    def step(self, state: BundleState, damping: float) -> BundleState:
        """Return the state after one damped step."""
        S, rhs = self.reduce(damping)
        S[np.diag_indices_from(S)] += 1e-12
        x = solved_steps(S, rhs)
        n6, k = self.each * self.photos, len(self.free)
        pose, lens, mount = x[:n6].reshape(-1, self.each), x[n6 : n6 + k], x[n6 + k :]
        points = np.empty_like(state.points)
        move_points(
            self._starts, self.obs.photo, self.coupling, self.lens_coupling, self.gradient, self.covariances,
            pose, lens, points,
        )  # fmt: skip
        offsets = state.lens.copy()
        offsets[self.free] += lens
        return BundleState(
            state.centres + pose[:, :3],
            so3_exp(pose[:, 3:6]) @ state.rotations,
            state.points + points,
            offsets,
            state.mounting + mount if self.mounted else state.mounting,
            state.turns + pose[:, 6:].reshape(-1, 2, 3) if self.each > 6 else state.turns,
        )

    def solve(self, state: BundleState, iterations: int, tolerance: float = 1e-7) -> BundleState:
        """Iterate (Levenberg-Marquardt) until the cost falls by less than a share; a step that raises it is damped."""
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
        C = covariance_of(self.reduce(0.0)[0])
        poses = (self.each * np.arange(self.photos)[:, None] + np.arange(6)).ravel()
        lens = self.each * self.photos + np.flatnonzero(~np.isin(self.free, self.priors.lenses.readout_numbers))
        of = np.concatenate([poses, lens])
        return np.asarray(C[np.ix_(of, of)])


def covariance_of(S: F64) -> F64:
    """The inverse of an information matrix (p, p), with positive variances also where rounding left it none.

    Unknowns that no observation fixes, as of photos of other ground, get a large variance.
    """
    C = np.linalg.inv(S + 1e-9 * np.eye(len(S)))
    if np.isfinite(C).all() and (np.diag(C) > 0).all():
        return np.asarray(C)
    size = np.sqrt(np.maximum(np.diag(S), _LEAST_INFORMATION))
    values, vectors = np.linalg.eigh((S + S.T) / (2.0 * np.outer(size, size)))
    known = np.maximum(values, _LEAST_INFORMATION * len(S))
    return np.asarray((vectors / known) @ vectors.T / np.outer(size, size))


def solved_steps(S: F64, rhs: F64) -> F64:
    """Solve the reduced normal equations (p, p); of many photos as a sparse matrix, because each overlaps few others.

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


def triangulate_bundle(
    state: BundleState,
    lenses: PhotoLenses,
    velocity: F64,
    obs: BundleObservations,
    rounds: int = 4,
    scale_px: float = 3.0,
) -> F64:
    """Return (m, 3) points nearest to their rays (midpoint method), with Cauchy weights."""
    ray, origin = np.empty((len(obs.photo), 3)), np.empty((len(obs.photo), 3))
    rays_of_pixels(*state.for_kernels(obs, lenses, velocity), ray, origin)
    starts, weight = np.append(obs.starts, len(obs.point)), np.ones(len(ray))
    points, focal = np.empty((obs.points, 3)), lenses.focal(obs.photo)[:, 0]
    meet_rays(starts, ray, origin, focal, rounds, scale_px, WEAK_PRIOR, weight, points)
    return points


def intersection_angle(points: F64, centres: F64, obs: BundleObservations) -> F64:
    """Return (m,) the angle in rad between the first ray of each point and the one farthest from it."""
    out = np.empty(len(points))
    widest_angles(np.append(obs.starts, len(obs.point)), obs.photo, np.ascontiguousarray(centres), points, out)
    return out
