"""Photos with a wrong first pose: set aside during the first rounds, then placed by resection from the points.

Otherwise a GPS jump of one photo would bend the whole survey, because its matches tie it to the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Camera
from alight.photos.bundle.matching import BundleObservations, colmap, colmap_camera
from alight.photos.bundle.solver import BundleState, Priors, triangulate_bundle

_MIN_SHARE = 0.5  # of the median share of remaining observations; below it a photo is misplaced
_MIN_INLIERS = 12  # points of a resection
_INLIER_PX = 8.0


def without_photos(obs: BundleObservations, photos: I64) -> tuple[BundleObservations, I64]:
    """Return the observations of all other photos, and the old numbers of their points."""
    return obs.keep(~np.isin(obs.photo, photos))


def misplaced(before: BundleObservations, after: BundleObservations, count: int) -> I64:
    """Return the photos that lost a far larger share of their observations than the median."""
    seen = np.bincount(before.photo, minlength=count)
    share = np.bincount(after.photo, minlength=count) / np.maximum(seen, 1)
    return np.flatnonzero((seen > 0) & (share < _MIN_SHARE * np.median(share[seen > 0])))


def resect(state: BundleState, obs: BundleObservations, photos: I64, priors: Priors) -> tuple[BundleState, Priors, I64]:
    """Place photos by the points that the others see; their GPS and attitude priors are dropped.

    Returns the new state and priors, and the photos that could be placed. `obs` are those of all photos.
    """
    others, old = without_photos(obs, photos)
    lenses = priors.lenses.moved(state.lens)
    points = np.full((obs.points, 3), np.nan)
    points[old] = triangulate_bundle(state, lenses, priors.velocity, others)
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
    """Return rotation world_from_cam and centre by RANSAC over (k, 2) pixels of (k, 3) points; None: too few."""
    if len(points) < _MIN_INLIERS:
        return None
    pc = colmap()
    options = pc.AbsolutePoseEstimationOptions()
    options.ransac.max_error = _INLIER_PX
    options.ransac.random_seed = 1
    found = pc.estimate_and_refine_absolute_pose(pixels + 0.5, points, colmap_camera(camera), options)
    if found is None or found["num_inliers"] < _MIN_INLIERS:
        return None
    cam_from_world = found["cam_from_world"]
    R = np.asarray(cam_from_world.rotation.matrix()).T
    return R, -R @ np.asarray(cam_from_world.translation)
