"""Pose refinement against the map, carried from keyframe to keyframe (docs/method/recursive.md)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import F32, F64, Mask
from alight.geometry import Grid, Pose, plane_on
from alight.parallax.pose_refinement.gaussian import PoseGaussian, regress_on
from alight.parallax.pose_refinement.kernels import PLANE, POSE
from alight.parallax.pose_refinement.solve import (
    RefinementCells,
    RefinementView,
    ViewPair,
    refine_poses,
    thinning,
)
from alight.parallax.views import Kept
from alight.records import REFUSED, Datum, ElevationMap, Flag, KeyframePosterior
from alight.settings.tuning.parallax import PoseRefinementTuning


@dataclass(eq=False)
class Alignment:
    """Joint Gaussian over the exposures of a keyframe window and the plane of the map below them."""

    keyframes: int  # exposures of the window
    tuning: PoseRefinementTuning
    about: F64 = field(default_factory=lambda: np.zeros(2))  # metres east and north, to which the plane's offset refers
    state: PoseGaussian | None = None
    plane: F64 = field(default_factory=lambda: np.zeros(PLANE))  # error of the map's plane found at the last step
    _mounts: dict[tuple[int, int], Pose] = field(default_factory=dict)  # body_from_cam by time and camera
    mapped: bool = False  # there are heights that hold the plane
    _offset2: float = 0.0  # m^2, variance of the map's place in the world, of its height; pictures do not show it

    def update_posterior(self, poses: KeyframePosterior, held: set[int], drop: float) -> None:
        """Adopt the posterior of the keyframes; exposures that are neither in it nor `held` are dropped."""
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
        self, exposures: list[list[Kept]], grid: Grid, known: ElevationMap, old: Mask, ground: float
    ) -> list[list[Kept]]:
        """Refine the poses with the map; `plane` is then the error of the map that was found.

        `old` (R, C): cells that belong to other poses, and count as unknown.
        """
        newest = exposures[-1][0].view
        self.plane = np.zeros(PLANE)
        drop = max(float(newest.centre[2]) - ground, 1e-2)
        if self.state is None or any(k[0].view.t_ns not in self.state.times for k in exposures):
            return exposures
        prior = self.prior(drop, newest.centre[:2])
        linearisations = self._linearisations(exposures, prior, self._ground(grid, known, old, ground, drop), drop)
        pixel = grid.cell / drop
        self.state, plane = refine_poses(prior, linearisations, pixel, drop, self.keyframes, self.tuning)
        if self.mapped:
            self.plane = plane
        poses = dict(zip(self.state.times, self.state.poses, strict=True))
        return [[k.posed(poses[k.view.t_ns] @ self._mounts[k.view.t_ns, k.view.cam]) for k in e] for e in exposures]

    def prior(self, drop: float, here: F64) -> PoseGaussian:
        """The state, with a plane that may have wandered about `here`, (2,) east and north; before a map, any plane."""
        assert self.state is not None
        scale = np.array([drop, 1.0, 1.0])
        if not self.mapped:
            return self.state.with_plane(np.array(self.tuning.plane_sigma) * scale)
        wander = self._transition(self.about - here) * (np.array(self.tuning.wander) * scale)
        P = self.state.covariance.copy()
        P[:PLANE, :PLANE] += wander @ wander.T
        return replace(self.state, covariance=P)

    @staticmethod
    def _transition(way: F64) -> F64:
        """Transition (3, 3) of a plane to the reference point that lies `way` (2,) metres east and north of its own."""
        out = np.eye(PLANE)
        out[0, 1:] = way
        return out

    def _linearisations(
        self, exposures: list[list[Kept]], prior: PoseGaussian, cells: RefinementCells, drop: float
    ) -> list[ViewPair]:
        """Pictures and cells of each linearisation, coarse to fine; more if the newest exposure is less certain."""
        all_of = [k for e in exposures for k in e]
        fine = [RefinementView(k.fine, self._mounts[k.view.t_ns, k.view.cam], k.view.t_ns) for k in all_of]
        uncertainty = ground_uncertainty(prior, drop) / cells.arm
        if uncertainty > self.tuning.far_cells:
            coarse = [replace(v, prepared=k.coarse) for v, k in zip(fine, all_of, strict=True)]
            return [(coarse, cells.coarser())] * 2 + [(fine, cells)] * 2
        return [(fine, cells)] * (2 if uncertainty > self.tuning.near_cells else 1)

    def _ground(self, grid: Grid, known: ElevationMap, old: Mask, ground: float, drop: float) -> RefinementCells:
        """A thinned set of cells: trusted ones held to the map, unseen ones free, no others."""
        some, (xs, ys) = thinning(grid, self.tuning.cells), grid.xy()
        height, sigma, flags, other = known.height[some], known.sigma[some], known.flags[some], old[some]
        seen = ((flags & np.uint16(Flag.UNSEEN)) == 0) & ~other
        ok = np.isfinite(height) & ((flags & np.uint16(REFUSED | Flag.STEP)) == 0) & seen
        self.mapped = self.mapped or int(ok.sum()) >= self.tuning.least_known
        free = (self.tuning.free if self.mapped else self.tuning.flat) * drop
        level = np.float32(np.median(height[ok]) if ok.any() else ground)
        kappa = np.where(ok, 1 / (self.tuning.hold * np.maximum(np.nan_to_num(sigma, nan=1.0), 1e-3)) ** 2, 1 / free**2)
        height = np.where(ok, height, np.where(seen, np.float32(np.nan), level))
        return RefinementCells(
            xs[some[1]], ys[some[0]], height.astype(np.float32), kappa.astype(np.float32), self.about, grid.cell
        )

    def plane_on(self, grid: Grid) -> F32:
        """Correction of the map's heights that the last step found, (R, C) metres."""
        return plane_on(*grid.xy(), self.plane, self.about)

    def datum(self, grid: Grid) -> Datum | None:
        """Offset and tilt that all heights of a window share, about its middle, with covariance."""
        if self.state is None or not self.mapped:
            return None
        east, north = (float(v.mean()) for v in grid.xy())
        move = self._transition(np.array([east, north]) - self.about)
        covariance = move @ self.state.covariance[:PLANE, :PLANE] @ move.T
        covariance[0, 0] += self._offset2
        return Datum(east, north, covariance)


def ground_uncertainty(state: PoseGaussian, drop: float) -> float:
    """1-sigma on the ground, metres, of the newest exposure given all others."""
    P, n = state.covariance, len(state.covariance) - POSE
    own = np.diag(P[n:, n:] - regress_on(P[:n, :n], P[:n, n:]) @ P[:n, n:])
    v = np.maximum(own, 0.0)
    return float(np.sqrt(0.5 * (v[0] + v[1]) + 0.5 * (v[3] + v[4]) * drop**2))
