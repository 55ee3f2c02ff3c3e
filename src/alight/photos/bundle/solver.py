"""Bundle adjustment: Levenberg-Marquardt over poses, lens, mounting and points, with points eliminated (Schur).

pycolmap's adjuster is not used, because it has priors on positions only: a straight strip could roll about its line of
flight. Equation numbers: docs/method/bundle.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from alight.arrays import F64, I64
from alight.geometry import skew, so3_exp, so3_log
from alight.motion.ekf.state_kernels import mirror_lower
from alight.motion.points import WEAK_PRIOR
from alight.motion.robust import cauchy, huber
from alight.photos.bundle.adjustment_kernels import FAR, linearise, meet_rays, predict_pixels, rays_of_pixels
from alight.photos.bundle.elimination_kernels import eliminate, move_points
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import BundleObservations

_PRIOR_LOSS = 3.0  # sigmas, Huber scale of GPS and gimbal; with a Cauchy loss, one GPS jump stretched the whole survey


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors from GPS, gimbal and the maker's calibration; NaN: no prior."""

    centres: F64  # (n, 3) metres
    sigma_centres: F64  # (n, 3) metres
    world_from_body: F64  # (n, 3, 3)
    sigma_rotation: F64  # (n, 3) rad, about the world's axes
    body_from_cam: F64  # (3, 3)
    sigma_mounting: float  # rad; 0: the mounting is fixed
    lenses: PhotoLenses
    sigma_lens: F64  # (k,) scale, aspect, cu, cv, distortion..., readout, camera by camera; 0: fixed
    velocity: F64  # (n, 3) m/s at the exposures; 0: unknown
    sigma_turn: float = 0.0  # rad, 1-sigma of a photo's rotation during the readout; 0: no rotation


@dataclass(frozen=True, eq=False)
class BundleState:
    """All parameters that a bundle adjustment estimates."""

    centres: F64  # (n, 3) metres
    rotations: F64  # (n, 3, 3) world_from_cam
    points: F64  # (m, 3) metres
    lens: F64  # (k,) offsets from the prior, camera by camera: scale, aspect, cu, cv (px), coefficients, readout (s)
    mounting: F64  # (3,) rotation vector m in the body: world_from_cam = world_from_body exp(m) body_from_cam
    turns: F64  # (n, 2, 3) rotation vectors in the camera during the readout, linear and quadratic in time

    def for_kernels(self, obs: BundleObservations, priors: Priors) -> tuple[F64 | I64, ...]:
        """Return observations, poses and lenses as the first arguments of the kernels (`adjustment_kernels`)."""
        lenses = priors.lenses.moved(self.lens)
        lens, model = lenses.table()
        poses = (self.rotations, self.centres, self.turns, priors.velocity)
        return obs.photo, obs.pixels, *map(np.ascontiguousarray, poses), lenses.of, lens, model


class Projection(NamedTuple):
    """Predicted observations: pixels and depths."""

    pixels: F64  # (N, 2), NaN behind the camera
    depth: F64  # (N,) metres


class NormalEquations(NamedTuple):
    """Blocks of the normal equations (eq. 7) for N observations of m points in n photos, with e unknowns per photo."""

    U: F64  # (p, p) lower triangle for photos, free lens parameters and mounting
    b: F64  # (p,) right-hand side for U
    coupling: F64  # (N, 3, e) blocks between points and photos
    lens_coupling: F64  # (m, 3, k) blocks between points and free lens parameters
    information: F64  # (m, 3, 3) blocks of the points
    gradient: F64  # (m, 3) right-hand side for the points


class Reduced(NamedTuple):
    """Normal equations after elimination of the points (eq. 8)."""

    S: F64  # (p, p)
    rhs: F64  # (p,)
    covariances: F64  # (m, 3, 3) covariances of the points if the poses were exact


def project_points(state: BundleState, obs: BundleObservations, priors: Priors) -> Projection:
    """Predict the pixels and depths of all observations (eqs. 1, 10)."""
    pixels, depth = np.empty((len(obs.photo), 2)), np.empty(len(obs.photo))
    predict_pixels(*state.for_kernels(obs, priors), obs.point, state.points, pixels, depth)
    return Projection(pixels, depth)


def residuals(state: BundleState, obs: BundleObservations, priors: Priors) -> F64:
    """Return the (N, 2) residuals in pixels, predicted minus observed; large (`FAR`) for a point behind the camera."""
    r = project_points(state, obs, priors).pixels - obs.pixels
    return np.nan_to_num(np.clip(r, -FAR, FAR), nan=FAR)


def _attitude(state: BundleState, priors: Priors) -> tuple[I64, F64, F64]:
    """Return the k photos with an attitude prior, residuals (k, 3) in rad, derivatives w.r.t. the mounting (eq. 5)."""
    who = np.flatnonzero(
        np.isfinite(priors.world_from_body).all(axis=(1, 2)) & np.isfinite(priors.sigma_rotation).all(axis=1)
    )
    body = priors.world_from_body[who]
    expected = body @ (so3_exp(state.mounting) @ priors.body_from_cam)
    r = so3_log(state.rotations[who] @ np.swapaxes(expected, 1, 2)) if len(who) else np.zeros((0, 3))
    return who, r, -body


def _prior_cost(state: BundleState, priors: Priors) -> float:
    """Return the cost of the priors: GPS, gimbal, mounting and lens (eqs. 4 to 6)."""
    g = np.nan_to_num((state.centres - priors.centres) / priors.sigma_centres)
    who, a, _ = _attitude(state, priors)
    cost = huber((g**2).sum(axis=1), _PRIOR_LOSS)[1]
    cost += huber(((a / priors.sigma_rotation[who]) ** 2).sum(axis=1), _PRIOR_LOSS)[1]
    free = priors.sigma_lens > 0
    cost += float(((state.lens[free] / priors.sigma_lens[free]) ** 2).sum())
    if priors.sigma_turn > 0:
        cost += float(((state.turns / priors.sigma_turn) ** 2).sum())
    return cost + (float((state.mounting**2).sum()) / priors.sigma_mounting**2 if priors.sigma_mounting > 0 else 0.0)


class Adjustment:
    """Gauss-Newton system of fixed observations and priors, solved by damped steps.

    Args:
        obs: the N observations.
        priors: priors of GPS, gimbal and lens.
        pixel_sigma: (N,) px, 1-sigma of each observation.
        loss: Cauchy scale in sigmas.
    """

    def __init__(self, obs: BundleObservations, priors: Priors, pixel_sigma: F64, loss: float) -> None:
        self.obs, self.priors, self.pixel_sigma, self.loss = obs, priors, pixel_sigma, loss
        self.free = np.flatnonzero(priors.sigma_lens > 0)
        self.each = 12 if priors.sigma_turn > 0 else 6  # unknowns per photo: position, rotation, turns
        self.poses = self.each * len(priors.centres)  # unknowns of all photos; the unknowns of the lenses follow
        self.size = self.poses + len(self.free) + 3 * (priors.sigma_mounting > 0)
        self._starts, n = np.append(obs.starts, len(obs.point)), len(priors.centres)
        graph = sparse.coo_array((np.ones(len(obs.photo)), (obs.photo, n + obs.point)), shape=(n + obs.points,) * 2)
        group = connected_components(graph, directed=False)[1]
        self._groups = [
            (np.flatnonzero(group[:n] == k), np.flatnonzero(group[n:] == k)) for k in np.unique(group[obs.photo])
        ]

    def cost(self, state: BundleState) -> float:
        """Return the robust cost of observations and priors."""
        r = residuals(state, self.obs, self.priors) / self.pixel_sigma[:, None]
        return cauchy((r**2).sum(axis=1), self.loss)[1] + _prior_cost(state, self.priors)

    def linearise(self, state: BundleState) -> NormalEquations:
        """Build the blocks of the normal equations (eq. 7)."""
        obs, lenses, m, k = self.obs, self.priors.lenses, self.obs.points, len(self.free)
        numbers, places = lenses.free_numbers(self.priors.sigma_lens > 0)
        scales = 1.0 + state.lens[np.array([[part.start, part.start + 1] for part in lenses.parts])]
        lens = places[lenses.of]
        # (n, e + f) indices of each photo's unknowns and its lens's free parameters; 0 where a lens has fewer
        at = np.concatenate([self._of_photos(self.each), np.where(lens >= 0, self.poses + lens, 0)], axis=1)
        own, right = np.zeros((*at.shape, at.shape[1])), np.zeros(at.shape)
        coupling, lens_coupling = np.empty((len(obs.photo), 3, self.each)), np.zeros((m, 3, k))
        information, gradient = np.zeros((m, 3, 3)), np.zeros((m, 3))
        linearise(
            *state.for_kernels(obs, self.priors), obs.point, state.points, scales, numbers, places, self.each,
            self.pixel_sigma, self.loss, own, right, coupling, lens_coupling, information, gradient,
        )  # fmt: skip
        U, b = self.prior_blocks(state)
        np.add.at(U, (at[:, :, None], at[:, None, :]), own)
        np.add.at(b, at, right)
        return NormalEquations(U, b, coupling, lens_coupling, information, gradient)

    def _of_photos(self, stop: int, start: int = 0) -> I64:
        """Return the indices (n, stop - start), among all unknowns, of each photo's unknowns `start` to `stop` - 1."""
        return np.arange(0, self.poses, self.each)[:, None] + np.arange(start, stop)

    def prior_blocks(self, state: BundleState) -> tuple[F64, F64]:
        """Return the matrix (p, p), lower triangle, and right-hand side (p,) of the priors (eqs. 4 to 6)."""
        pr = self.priors
        U, b = np.zeros((self.size, self.size)), np.zeros(self.size)
        g = np.nan_to_num((state.centres - pr.centres) / pr.sigma_centres)
        w = huber((g**2).sum(axis=1), _PRIOR_LOSS)[0][:, None] * np.isfinite(pr.centres) / pr.sigma_centres**2
        at = self._of_photos(3)
        U[at, at] += w
        b[at] -= w * np.nan_to_num(state.centres - pr.centres)
        who, r, by_mounting = _attitude(state, pr)
        s2 = pr.sigma_rotation[who] ** 2
        w = huber((r**2 / s2).sum(axis=1), _PRIOR_LOSS)[0][:, None] / s2
        rows = at[who] + 3
        U[rows, rows] += w
        b[rows] -= w * r
        if pr.sigma_turn > 0:
            turns = self._of_photos(12, 6)
            U[turns, turns] += pr.sigma_turn**-2
            b[turns] -= state.turns.reshape(-1, 6) / pr.sigma_turn**2
        k = np.arange(len(self.free)) + self.poses
        U[k, k] += 1.0 / pr.sigma_lens[self.free] ** 2
        b[k] -= state.lens[self.free] / pr.sigma_lens[self.free] ** 2
        if pr.sigma_mounting > 0:
            m = slice(self.size - 3, self.size)
            cross = w[:, :, None] * by_mounting
            U[rows, m] += cross
            U[m, rows.ravel()] += cross.reshape(-1, 3).T
            U[m, m] += np.einsum("nki,nkj->ij", by_mounting, cross) + np.eye(3) / pr.sigma_mounting**2
            b[m] -= np.einsum("nki,nk->i", cross, r) + state.mounting / pr.sigma_mounting**2
        return U, b

    def reduce(self, equations: NormalEquations, damping: float) -> Reduced:
        """Eliminate the points from the normal equations (eq. 8), their diagonal first multiplied by 1 + `damping`."""
        S, rhs, *blocks = (equations.U.copy(), equations.b.copy(), *equations[2:])
        S[np.diag_indices_from(S)] *= 1.0 + damping
        longest = int(np.diff(self._starts).max(initial=1))
        scratch, covariances = np.empty((longest, 3, self.each)), np.empty_like(equations.information)
        eliminate(
            self._starts, self.obs.photo, *blocks, damping, 1e-12, self.poses, scratch, S, rhs, covariances
        )  # fmt: skip
        mirror_lower(S)
        return Reduced(S, rhs, covariances)

    def step(self, state: BundleState, equations: NormalEquations, damping: float) -> BundleState:
        """Return the state after one step by the normal equations, their diagonal multiplied by 1 + `damping`."""
        S, rhs, covariances = self.reduce(equations, damping)
        S[np.diag_indices_from(S)] += 1e-12
        pose, lens, mount = np.split(solved_steps(S, rhs), [self.poses, self.poses + len(self.free)])
        pose, points, offsets = pose.reshape(-1, self.each), np.empty_like(state.points), state.lens.copy()
        move_points(
            self._starts, self.obs.photo, equations.coupling, equations.lens_coupling, equations.gradient, covariances,
            pose, lens, points,
        )  # fmt: skip
        offsets[self.free] += lens
        return BundleState(
            state.centres + pose[:, :3],
            so3_exp(pose[:, 3:6]) @ state.rotations,
            state.points + points,
            offsets,
            state.mounting + mount if len(mount) else state.mounting,
            state.turns + pose[:, 6:].reshape(-1, 2, 3) if self.each > 6 else state.turns,
        )

    def aligned(self, state: BundleState) -> BundleState:
        """Return the state with each group of connected photos moved as a whole so that it fits the priors best.

        No pixel changes. Damped steps of single poses hardly move the whole: a survey stayed tilted by 10 degrees.
        """
        for photos, points in self._groups:
            state = _moved_to_priors(state, self.priors, photos, points)
        return state

    def solve(self, state: BundleState, iterations: int, tolerance: float = 1e-7) -> BundleState:
        """Do up to `iterations` Levenberg-Marquardt steps, until the cost decreases by a share below `tolerance`.

        Steps that do not lower the cost do not count.
        """
        state = self.aligned(state)
        damping, cost, equations = 1e-5, self.cost(state), self.linearise(state)
        while iterations and damping < 1e6:
            try:
                trial = self.aligned(self.step(state, equations, damping))
                new = self.cost(trial)
            except (np.linalg.LinAlgError, ValueError):
                new = np.inf
            if new > cost:
                damping *= 10.0
                continue
            done = cost - new < tolerance * cost
            state, cost, damping, iterations = trial, new, max(damping / 10.0, 1e-12), iterations - 1
            if done:
                break
            equations = self.linearise(state)
        return state

    def covariance(self, state: BundleState) -> F64:
        """Return the covariance (6 n + k, 6 n + k) of all poses (position, rotation) and free lens parameters (eq. 9).

        Mounting, points, rotations during the readout and readout times are marginalised.
        """
        C = covariance_of(self.reduce(self.linearise(state), 0.0).S)
        lens = self.poses + np.flatnonzero(~np.isin(self.free, self.priors.lenses.readout_numbers))
        of = np.concatenate([self._of_photos(6).ravel(), lens])
        return np.asarray(C[np.ix_(of, of)])


def _moved_to_priors(state: BundleState, priors: Priors, photos: I64, points: I64) -> BundleState:
    """Return the state with `photos` and `points` moved by the scale, rotation and shift of least cost by the priors.

    Gauss-Newton on eqs. 4 and 5.
    """
    cost, sigma = _prior_cost(state, priors), priors.sigma_centres[photos]
    while True:
        middle = state.centres[photos].mean(axis=0)
        way, off = state.centres[photos] - middle, (state.centres - priors.centres)[photos] / sigma
        g = np.nan_to_num(off)
        w = np.sqrt(huber((g**2).sum(axis=1), _PRIOR_LOSS)[0])[:, None]
        moves = np.concatenate([way[:, :, None], -skew(way), np.tile(np.eye(3), (len(way), 1, 1))], axis=2)
        moves *= (w * np.isfinite(off) / sigma)[:, :, None]
        who, a, _ = _attitude(state, priors)
        own = np.isin(who, photos)
        a = a[own] / (spread := priors.sigma_rotation[who[own]])
        v = np.sqrt(huber((a**2).sum(axis=1), _PRIOR_LOSS)[0])[:, None]
        turns = (v / spread)[:, :, None] * np.eye(3, 7, 1)
        rows = np.concatenate([moves.reshape(-1, 7), turns.reshape(-1, 7)])
        x = np.linalg.lstsq(rows, -np.concatenate([(w * g).ravel(), (v * a).ravel()]), rcond=1e-6)[0]
        turn = so3_exp(x[1:4])
        similarity, shift = np.exp(np.clip(x[0], -1.0, 1.0)) * turn, middle + x[4:]
        trial = replace(state, **{k: getattr(state, k).copy() for k in ("centres", "rotations", "points")})
        trial.centres[photos] = way @ similarity.T + shift
        trial.rotations[photos] = turn @ trial.rotations[photos]
        trial.points[points] = (trial.points[points] - middle) @ similarity.T + shift
        new = _prior_cost(trial, priors)
        if not new < cost * (1 - 1e-6):
            return state
        state, cost = trial, new


def covariance_of(S: F64) -> F64:
    """Invert an information matrix (p, p); variances stay positive even if rounding made the matrix indefinite.

    Unknowns that no observation determines get a large variance.
    """
    C = np.linalg.inv(S + 1e-9 * np.eye(len(S)))
    if np.isfinite(C).all() and (np.diag(C) > 0).all():
        return np.asarray(C)
    size = np.sqrt(np.maximum(np.diag(S), 1e-12))
    values, vectors = np.linalg.eigh((S + S.T) / (2.0 * np.outer(size, size)))
    return np.asarray((vectors / np.maximum(values, 1e-12 * len(S))) @ vectors.T / np.outer(size, size))


def solved_steps(S: F64, rhs: F64) -> F64:
    """Solve the reduced normal equations (p, p) for the steps (p,); above 1200 unknowns with a sparse factor.

    For 1000 photos in strips, a sparse factor takes a fiftieth of the time of a dense one.

    Raises:
        LinAlgError: the matrix is singular.
    """
    if len(S) <= 1200:
        return np.asarray(np.linalg.solve(S, rhs))  # SciPy's Cholesky waits 0.5 s for threads on a busy machine
    try:
        symmetric = {"SymmetricMode": True}
        factor = splu(sparse.csc_array(S), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    except RuntimeError as e:
        raise np.linalg.LinAlgError(str(e)) from e
    return np.asarray(factor.solve(rhs))


def triangulate_bundle(state: BundleState, obs: BundleObservations, priors: Priors, scale_px: float = 3.0) -> F64:
    """Triangulate the points (m, 3) by the midpoint method, with Cauchy weights (scale `scale_px`) in four rounds."""
    ray, origin = np.empty((len(obs.photo), 3)), np.empty((len(obs.photo), 3))
    rays_of_pixels(*state.for_kernels(obs, priors), ray, origin)
    starts, weight = np.append(obs.starts, len(obs.point)), np.ones(len(ray))
    points, focal = np.empty((obs.points, 3)), priors.lenses.moved(state.lens).focal(obs.photo)[:, 0]
    meet_rays(starts, ray, origin, focal, 4, scale_px, WEAK_PRIOR, weight, points)
    return points


def intersection_angle(points: F64, centres: F64, obs: BundleObservations) -> F64:
    """Return (m,) angles in rad between the first ray of each point and the ray that is farthest from it."""
    way = points[obs.point] - centres[obs.photo]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-6)
    sine = np.linalg.norm(np.cross(way[obs.starts[obs.point]], way), axis=1)
    return np.asarray(np.arcsin(np.minimum(np.maximum.reduceat(sine, obs.starts), 1.0)))
