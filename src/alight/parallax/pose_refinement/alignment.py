"""Poses refined with the map: exposures, plane, heights and template in one small solve (docs/method/recursive.md).

The pictures fix the exposures and the map relative to each other; the common position of both stays at the prior. The
height and the template value of each cell are marginalised; the prior of the height has the map's own sigma. The joint
Gaussian is carried from keyframe to keyframe.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, I64, Mask
from alight.geometry import Grid, Pose, plane_on
from alight.parallax.gauss_newton_kernels import template
from alight.parallax.plane_sweep import ENOUGH
from alight.parallax.pose_refinement import kernels
from alight.parallax.pose_refinement.gaussian import PoseGaussian, corrected_poses, regress_on
from alight.parallax.pose_refinement.kernels import PLANE, POSE
from alight.parallax.sorting_kernels import network
from alight.parallax.views import Buffers, Kept, Prepared, centres_of, maps, sample
from alight.records import REFUSED, Datum, ElevationMap, Flag, KeyframePosterior
from alight.settings import ParallaxSettings
from alight.settings.tuning.parallax import PoseRefinementTuning
from alight.spread import contradicts

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class RefinementCells:
    """Sample of the map's cells that takes part in the solve."""

    xs: F64  # (C,) metres east
    ys: F64  # (R,) metres north
    height: F32  # (R, C) metres; NaN: the cell is left out
    kappa: F32  # (R, C) inverse variance of a height relative to the map's plane, 1 / metres^2
    about: F64  # (2,) metres east and north of the point at which the plane's offset is defined
    arm: float  # metres from a cell to the samples for the template's gradient

    def coarser(self) -> RefinementCells:
        """Return the cells for pictures of half the resolution: every second row, with twice the `arm`."""
        half = slice(None, None, 2)
        return replace(self, ys=self.ys[half], height=self.height[half], kappa=self.kappa[half], arm=2 * self.arm)


@dataclass(eq=False)
class Alignment:
    """Joint Gaussian over the poses of a keyframe window and the error of the map's plane, kept from step to step."""

    settings: ParallaxSettings
    about: F64 = field(default_factory=lambda: np.zeros(2))  # metres east and north of the plane's reference point
    state: PoseGaussian | None = None
    plane: F64 = field(default_factory=lambda: np.zeros(PLANE))  # error of the map's plane, found in the last step
    _mounts: dict[tuple[int, int], Pose] = field(default_factory=dict)  # body_from_cam by time and camera
    mapped: bool = False  # whether the map has had trusted heights, which fix the plane
    _offset2: float = 0.0  # m^2, variance of the map's height in the world, which pictures do not show

    @property
    def tuning(self) -> PoseRefinementTuning:
        """Constants of the pose refinement."""
        return self.settings.poses

    def update_posterior(self, poses: KeyframePosterior, held: set[int], drop: float) -> None:
        """Adopt the joint posterior of the keyframes.

        Args:
            poses: the posterior.
            held: times of the exposures in the window, ns; exposures that are neither held nor in `poses` are dropped.
            drop: height of the camera above the ground, metres.
        """
        if self.state is None:
            self.state, self.about = (
                PoseGaussian.none(np.array(self.tuning.plane_sigma) * [drop, 1, 1]),
                poses.motions[-1].world_from_body.translation[:2],
            )
        times = held | {m.t_ns for m in poses.motions}
        self.state = self.state.with_posterior(poses).kept(times)
        self._mounts = {k: v for k, v in self._mounts.items() if k[0] in times}
        for m in poses.motions:
            self._mounts |= {(m.t_ns, k): m.world_from_body.inverse @ c for k, c in enumerate(m.world_from_cams)}
        last = poses.motions[-1]
        self._offset2 = max(0.0, float(last.covariance[2, 2] - poses.covariance[-4, -4]))

    def align(
        self, exposures: dict[int, list[Kept]], grid: Grid, known: ElevationMap, old: Mask, ground: float
    ) -> dict[int, list[Kept]]:
        """Return the exposures, by time in ns, with their poses refined against the map `known` on `grid`.

        Also set `plane` to the error of the map's plane that was found. Unless each exposure has a posterior, nothing
        is refined.

        Args:
            old: (R, C) cells whose heights were found with other poses; they are treated as unknown.
            ground: height of the ground, metres.
        """
        newest = exposures[max(exposures)][0].view
        self.plane = np.zeros(PLANE)
        drop = max(float(newest.centre[2]) - ground, 1e-2)
        if self.state is None or any(t not in self.state.poses for t in exposures):
            return exposures
        prior = self.prior(drop, newest.centre[:2])
        cells = self._cells(grid, known, old, ground, drop)
        self.state, plane = self._refined(prior, [k for e in exposures.values() for k in e], cells, drop)
        if self.mapped:
            self.plane = plane
        poses = self.state.poses
        return {t: [k.posed(self._camera_of(k, poses)) for k in e] for t, e in exposures.items()}

    def _camera_of(self, k: Kept, poses: dict[int, Pose]) -> Pose:
        return poses[k.view.t_ns] @ self._mounts[k.view.t_ns, k.view.cam]

    def prior(self, drop: float, here: F64) -> PoseGaussian:
        """Return the prior of the next solve: the state, with the variance by which the map's plane may have wandered.

        Before there is a map, the plane is free. `drop` is the height of the camera above the ground, metres; `here`
        (2,) is the point about which the plane tilts, metres east and north.
        """
        assert self.state is not None
        scale, P = np.array([drop, 1.0, 1.0]), self.state.covariance.copy()
        if self.mapped:
            wander = self._transition(self.about - here) * (np.array(self.tuning.wander) * scale)
            P[:PLANE, :PLANE] += wander @ wander.T
        else:
            P[:PLANE], P[:, :PLANE] = 0.0, 0.0
            P[:PLANE, :PLANE] = np.diag((np.array(self.tuning.plane_sigma) * scale) ** 2)
        return replace(self.state, covariance=P)

    @staticmethod
    def _transition(way: F64) -> F64:
        """Return the (3, 3) matrix that moves the reference point of a plane by `way` (2,), metres east and north."""
        out = np.eye(PLANE)
        out[0, 1:] = way
        return out

    def _refined(
        self, prior: PoseGaussian, kept: list[Kept], cells: RefinementCells, drop: float
    ) -> tuple[PoseGaussian, F64]:
        """Return the posterior given the pictures, and the error (3,) of the map's plane (eqs. 17 to 24).

        If the pictures contradict the prior, the prior is returned, with a plane error of zero. The prior contains the
        exposures of all views in `kept`. `drop` is the height of the cameras above the ground, metres.
        """
        tuning, pixel = self.tuning, cells.arm / drop  # rad, angle of a pixel
        used = {k.view.t_ns for k in kept}
        bodies = {t: p for t, p in prior.poses.items() if t in used}
        owner = np.array([list(bodies).index(k.view.t_ns) for k in kept], np.int64)
        rows = np.concatenate([np.arange(PLANE), prior.rows(bodies)])
        P, held, one = prior.covariance[np.ix_(rows, rows)], Buffers(), np.eye(len(rows))
        x = prior.start[rows]
        x[:PLANE] = -prior.plane
        apparent = np.tile(np.repeat([pixel * drop, pixel], 3), len(bodies)) * tuning.apparent_px
        F = np.concatenate([np.zeros(PLANE), apparent]) ** 2
        A, seen, whitened = np.zeros_like(P), np.zeros_like(P), np.zeros(len(rows))
        for halvings in _linearisations(prior, drop, cells.arm, self.settings.refinement.step_px):
            poses = corrected_poses(bodies, x)
            views = [k.halved(halvings).posed(self._camera_of(k, poses)) for k in kept]
            ground = cells.coarser() if halvings else cells
            seen, b = _information(
                views, owner, list(poses.values()), ground, prior.plane + x[:PLANE], held, self.settings
            )
            damping = np.linalg.inv(one + seen * F)
            A, b = damping @ seen, damping @ b
            whitened = np.asarray(np.linalg.solve(one + A @ P, b + A @ x))  # P^-1 x
            x = P @ whitened
        if contradicts(float(whitened @ x), len(x)):
            log.info("the pictures contradict the prior of the poses, which stay as they were")
            return prior, np.zeros(PLANE)
        across, shared = (
            prior.covariance[:, rows],
            A / self.settings.ring,
        )  # shared among the steps that a picture is in
        gain = np.linalg.solve(one + shared @ P, shared)
        after = prior.covariance - across @ (0.5 * (gain + gain.T)) @ across.T
        follow = _following(seen, rows, len(after), tuning.taken_share)
        return prior.corrected(across @ whitened, follow @ after @ follow.T), prior.plane + x[:PLANE]

    def _cells(self, grid: Grid, known: ElevationMap, old: Mask, ground: float, drop: float) -> RefinementCells:
        """Return sampled cells: trusted cells tied to the map's heights, unseen or `old` cells with free heights.

        `ground`: height of the ground. `drop`: height of the camera above the ground. Both in metres.
        """
        every, (xs, ys) = max(1, round((grid.rows * grid.cols / self.tuning.cells) ** 0.5)), grid.xy()
        some = slice(every // 2, None, every), slice(every // 2, None, every)
        height, sigma, flags, other = known.height[some], known.sigma[some], known.flags[some], old[some]
        seen = ((flags & np.uint16(Flag.UNSEEN)) == 0) & ~other
        ok = np.isfinite(height) & ((flags & np.uint16(REFUSED | Flag.STEP)) == 0) & seen
        self.mapped = self.mapped or bool(ok.any())
        free = (self.tuning.hold if self.mapped else self.settings.points.like_height) * drop
        level = np.float32(np.median(height[ok]) if ok.any() else ground)
        kappa = np.where(ok, 1 / (self.tuning.hold * np.maximum(np.nan_to_num(sigma, nan=1.0), 1e-3)) ** 2, 1 / free**2)
        height = np.where(ok, height, np.where(seen, np.float32(np.nan), level))
        return RefinementCells(
            xs[some[1]], ys[some[0]], height.astype(np.float32), kappa.astype(np.float32), self.about, grid.cell
        )

    def plane_on(self, grid: Grid) -> F32:
        """Return the correction (R, C) of the map's heights by `plane`, metres."""
        return plane_on(*grid.xy(), self.plane, self.about)

    def datum(self, grid: Grid) -> Datum | None:
        """Return the covariance of the offset and tilt that all heights of a window share; None without a map."""
        if self.state is None or not self.mapped:
            return None
        east, north = (float(v.mean()) for v in grid.xy())
        move = self._transition(np.array([east, north]) - self.about)
        covariance = move @ self.state.covariance[:PLANE, :PLANE] @ move.T
        covariance[0, 0] += self._offset2
        return Datum(east, north, covariance)


def _linearisations(state: PoseGaussian, drop: float, cell: float, most: float) -> tuple[int, ...]:
    """Return how often pictures are halved at each linearisation: (0,), or several if the newest pose is uncertain.

    `drop`: height of the camera above the ground, metres. `cell`: cell size, metres. `most`: largest 1-sigma of the
    newest view on the ground, cells, for which the full images suffice.
    """
    P, n = state.covariance, len(state.covariance) - POSE
    own = np.diag(P[n:, n:] - regress_on(P[:n, :n], P[:n, n:]) @ P[:n, n:])  # given all other exposures
    v = np.maximum(own, 0.0)
    sigma = float(np.sqrt(0.5 * (v[0] + v[1]) + 0.5 * (v[3] + v[4]) * drop**2)) / cell  # on the ground
    if sigma > most:
        return 1, 1, 0, 0
    return (0,)


def _following(seen: F64, rows: NDArray[np.int64], size: int, share: float) -> F64:
    """Return the transition of all errors if the next step takes `share` of its heights from these poses (eq. 24).

    `seen`: matrix of the normal equations of plane and poses. `rows`: their indices among all `size` errors.
    """
    out = np.eye(size)
    out[:PLANE, :PLANE] *= 1 - share
    out[:PLANE, rows[PLANE:]] = -share * np.linalg.lstsq(seen[:PLANE, :PLANE], seen[:PLANE, PLANE:], rcond=None)[0]
    return out


def _information(
    views: list[Prepared], owner: I64, poses: list[Pose], ground: RefinementCells, plane: F64, held: Buffers,
    settings: ParallaxSettings,
) -> tuple[F64, F64]:  # fmt: skip
    """Return the normal equations A (M, M) and b (M,) at one linearisation, M = 3 + 6E for E exposures.

    `owner`: (N,) index of each view's exposure. `poses`: world_from_body of the exposures. `plane`: (3,) error of the
    map's plane, added to the heights. `held`: arrays to reuse.
    """
    height = ground.height + plane_on(ground.xs, ground.ys, plane, ground.about)
    s = _crosses(views, ground, height, held)
    n, (rows, cols), M = len(views), height.shape, PLANE + POSE * len(poses)
    weights, mean = np.empty((n, 5 * rows, cols), np.float32), np.empty((5 * rows, cols), np.float32)
    template(s.reshape(n, 5 * rows, cols), network(n), np.float32(settings.refinement.residual_scale), weights, mean)
    w, m = np.ascontiguousarray(weights[:, :rows]), mean.reshape(5, rows, cols)
    samples = np.ascontiguousarray(s[:, 0])
    A, b = np.empty((rows, M, M)), np.empty((rows, M))
    kernels.joint_normal_equations(
        samples, w, m, owner, centres_of(views), np.array([p.translation for p in poses]),
        _precision(samples, w, m[0], settings.poses), ground.xs, ground.ys, height, ground.about, ground.arm,
        np.ascontiguousarray(ground.kappa), A, b,
    )  # fmt: skip
    upper = A.sum(axis=0)
    return upper + np.triu(upper, 1).T, b.sum(axis=0)


def _crosses(views: list[Prepared], ground: RefinementCells, height: F32, held: Buffers) -> F32:
    """Return samples (N, 5, R, C) at the cells and `ground.arm` metres east, west, north and south of them.

    `height`: (R, C) heights of the cells, metres. `held`: arrays to reuse.
    """
    n, (rows, cols), a = len(views), height.shape, ground.arm
    out = held.get("crosses", (n, 5, rows, cols))
    xs, ys, level = ground.xs, ground.ys, np.tile(height, (3, 1))
    for i, view in enumerate(views):  # cells, north and south at once: starting many small loops is slow
        straight = sample(view.norm, *maps(view, xs, np.concatenate([ys, ys + a, ys - a]), level, held))
        out[i, [0, 3, 4]] = straight.reshape(3, rows, cols)
        for k, east in ((1, a), (2, -a)):
            sample(view.norm, *maps(view, xs + east, ys, height, held), out=out[i, k])
    return out


def _precision(samples: F32, weights: F32, mean: F32, tuning: PoseRefinementTuning) -> F64:
    """Return the (N,) inverse variance of each view's samples (N, R, C) about the template `mean`; 0 if too few."""
    e = np.where(weights > 0, samples - mean, np.float32(0))
    total = weights.sum(axis=(1, 2), dtype=np.float64)
    enough = (weights > 0).sum(axis=(1, 2)) >= ENOUGH
    variance = (weights * e * e).sum(axis=(1, 2), dtype=np.float64) / np.maximum(total, 1e-9)
    return np.asarray(np.where(enough, 1.0 / (tuning.correlated * np.maximum(variance, 1e-4)), 0.0))
