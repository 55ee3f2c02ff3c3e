"""Rounds of a bundle adjustment, loose to tight: triangulate, remove outliers, adjust; test for a rolling shutter.

Photos with a wrong initial pose are set aside during the first rounds, then located by resection from the points.
Otherwise a GPS jump of one photo would bend the whole survey, because matches tie the photo to the others.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Camera
from alight.photos.bundle.features import colmap, colmap_camera
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.priors import SIGMA_RATE, at_once, rolling_priors
from alight.photos.bundle.solver import (
    Adjustment,
    BundleState,
    Priors,
    intersection_angle,
    project_points,
    residuals,
    triangulate_bundle,
)

log = logging.getLogger(__name__)

ROUNDS = ((100.0, np.inf), (20.0, 100.0), (5.0, 25.0), (2.0, 8.0), (2.0, 4.0))  # px: Cauchy scale (sigma 1 px), cut
_LENS_ROUND = 2  # first round with a free lens; earlier it would absorb the errors of the initial poses
_GAIN = 25.0  # least reduction of the cost per photo that justifies its six rotation parameters
_LEAST_INLIERS = 12  # least inlier points of a resection


def coarse_rounds(
    state: BundleState,
    few: BundleObservations,
    priors: Priors,
    aside: I64,
    progress: Callable[[float], None],
    seconds: F64 | None,
) -> tuple[BundleState, Priors, I64]:
    """Do the coarse rounds of adjustment without the photos `aside`; return the new state, priors and `aside`.

    Photos that prove misplaced are added to `aside`. `few` are the observations to use. `seconds` (n,) are exposure
    times in s; None: no rolling shutter.
    """
    held = replace(priors, sigma_lens=np.zeros_like(priors.sigma_lens))
    few = few.without(aside)
    for k in range(_LENS_ROUND):
        state = do_rounds(state, few, held, ROUNDS[k])
        progress(0.15 * (k + 1))
    loss, cut = ROUNDS[_LENS_ROUND]
    more = misplaced(few, retriangulate(state, few, priors, cut, loss)[1], len(priors.centres))
    if len(more):
        aside, few = np.union1d(aside, more), few.without(more)
        state = do_rounds(state, few, held, ROUNDS[_LENS_ROUND - 1])
    if seconds is None or not (priors.sigma_lens.any() or any(r is not None for r in priors.lenses.by_maker)):
        state = do_rounds(state, few, priors, *ROUNDS[_LENS_ROUND:-1])
    else:
        seconds = seconds.copy()
        seconds[aside] = np.nan  # their positions are not known yet
        known, lens = [r is not None for r in priors.lenses.by_maker], state.lens.copy()
        lens[np.array(priors.lenses.readout_numbers)[known]] = np.array(priors.lenses.by_maker, np.float64)[known]
        state = replace(state, lens=lens)
        state, priors = _by_rows(state, few, rolling_priors(priors, state.centres, seconds))
    progress(0.6)
    return state, priors, aside


def _by_rows(first: BundleState, obs: BundleObservations, priors: Priors) -> tuple[BundleState, Priors]:
    """Do the rounds with a free lens from the state `first`, and choose the rolling shutter; return state and priors.

    The rolling shutter is none, with translation, or also with rotation. A readout that moves rows by less than a pixel
    is treated as none. Rotations are used only if they lower the cost much more than by chance, with a fixed readout
    time, because a rotation looks much like a translation over level ground.
    """
    state = do_rounds(first, obs, priors, *ROUNDS[_LENS_ROUND:-1])
    lenses, photos = priors.lenses.moved(state.lens), np.unique(obs.photo)
    points = triangulate_bundle(state, obs, priors)
    depth = np.linalg.norm(points[obs.point] - state.centres[obs.photo], axis=1)
    way = np.linalg.norm(priors.velocity, axis=1) * np.abs(lenses.readout(np.arange(len(state.centres))))
    moved = way[photos] * lenses.focal(photos)[:, 0] / np.median(depth) if len(depth) else np.zeros(1)
    at, lens, rolls = priors.lenses.readout_numbers, state.lens.copy(), float(np.median(moved))
    if rolls < 1.0:
        lens[at] = 0.0
        return replace(state, lens=lens), at_once(priors)
    log.info("readout %s s: rows move by %.1f px", lenses.readouts, rolls)
    lens[:] = first.lens
    lens[at] = state.lens[at]
    turning = at_once(priors, SIGMA_RATE * max(abs(r) for r in lenses.readouts))
    turned = do_rounds(replace(first, lens=lens), obs, turning, *ROUNDS[_LENS_ROUND:-1])
    gain = (_misfit(state, obs, priors) - _misfit(turned, obs, turning)) / len(photos)
    log.info("turning while read out: gain %.0f a photo", gain)
    return (turned, turning) if gain > _GAIN else (state, priors)


def _misfit(state: BundleState, obs: BundleObservations, priors: Priors) -> float:
    """Return the robust cost of all observations; observations without a point get the mean cost of the others."""
    state, used = retriangulate(state, obs, priors, np.inf, 2.0)
    cost = Adjustment(used, priors, np.ones(len(used.photo)), 2.0).cost(state)
    return cost * len(obs.photo) / max(len(used.photo), 1)


def do_rounds(state: BundleState, obs: BundleObservations, priors: Priors, *rounds: tuple[float, float]) -> BundleState:
    """Return the state after rounds of `ROUNDS`: each triangulates, removes outliers beyond its cut, and adjusts."""
    for loss, cut in rounds:
        state, used = retriangulate(state, obs, priors, cut, loss)
        if len(used.photo):
            state = Adjustment(used, priors, np.ones(len(used.photo)), loss).solve(state, 15, 1e-4)
            left = float(np.median(np.abs(residuals(state, used, priors))))
            log.info("cut %g px: %d observations, median %.2f px", cut, len(used.photo), left)
    return state


def retriangulate(
    state: BundleState, obs: BundleObservations, priors: Priors, cut: float, scale: float
) -> tuple[BundleState, BundleObservations]:
    """Triangulate all tracks (Cauchy, `scale` px); remove residuals over `cut` px, and points with small ray angles."""
    for _ in range(2):
        points = triangulate_bundle(state, obs, priors, scale)
        state = replace(state, points=points)
        pixels, depth = project_points(state, obs, priors)
        residual = np.nan_to_num(np.linalg.norm(pixels - obs.pixels, axis=1), nan=np.inf)
        wide = intersection_angle(points, state.centres, obs) > np.radians(1.0)
        good = (depth > 0) & wide[obs.point]
        obs, old = obs.keep(good & (residual < cut) if np.isfinite(cut) else good)
        state = replace(state, points=points[old])
    return state, obs


def misplaced(before: BundleObservations, after: BundleObservations, count: int) -> I64:
    """Return indices of those of `count` photos that lost a far larger share of observations than the median photo."""
    seen = np.bincount(before.photo, minlength=count)
    share = np.bincount(after.photo, minlength=count) / np.maximum(seen, 1)
    return np.flatnonzero((seen > 0) & (share < 0.5 * np.median(share[seen > 0])))


def resect(state: BundleState, obs: BundleObservations, photos: I64, priors: Priors) -> tuple[BundleState, Priors, I64]:
    """Locate `photos` from the points that other photos see; drop the GPS and attitude priors of located photos.

    `obs` are the observations of all photos. Returns the new state and priors, and the indices of the located photos.
    """
    others, old = obs.keep(~np.isin(obs.photo, photos))
    lenses = priors.lenses.moved(state.lens)
    points = np.full((obs.points, 3), np.nan)
    points[old] = triangulate_bundle(state, others, priors)
    centres, rotations, placed = state.centres.copy(), state.rotations.copy(), []
    for i in photos:
        rows = (obs.photo == i) & np.isfinite(points[obs.point]).all(axis=1)
        pose = _absolute_pose(lenses.of_photo(int(i)), obs.pixels[rows], points[obs.point[rows]])
        if pose is not None:
            rotations[i], centres[i] = pose
            placed.append(i)
    position, attitude = priors.centres.copy(), priors.world_from_body.copy()
    position[placed], attitude[placed] = np.nan, np.nan
    priors = replace(priors, centres=position, world_from_body=attitude)
    return replace(state, centres=centres, rotations=rotations), priors, np.array(placed, dtype=np.int64)


def _absolute_pose(camera: Camera, pixels: F64, points: F64) -> tuple[F64, F64] | None:
    """Return world_from_cam (3, 3) and centre (3,) by RANSAC from pixels (k, 2) of points (k, 3); None: not found."""
    if len(points) < _LEAST_INLIERS:
        return None
    pc = colmap()
    options = pc.AbsolutePoseEstimationOptions()
    options.ransac.max_error = 8.0  # px
    options.ransac.random_seed = 1
    found = pc.estimate_and_refine_absolute_pose(pixels + 0.5, points, colmap_camera(camera), options)
    if found is None or found["num_inliers"] < _LEAST_INLIERS:
        return None
    cam_from_world = found["cam_from_world"]
    R = np.asarray(cam_from_world.rotation.matrix()).T
    return R, -R @ np.asarray(cam_from_world.translation)
