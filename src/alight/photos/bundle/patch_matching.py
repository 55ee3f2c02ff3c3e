"""Refine observations to a twentieth of a pixel by least squares matching of patches (Foerstner 1982; Gruen 1985).

The detector locates a feature in each photo separately, to a quarter of a pixel. Once rough poses are known, the patch
around a point's first observation is matched in all other photos of the point. Equation numbers:
docs/method/patches.md.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from alight.arrays import F16, F32, F64, I64, Mask
from alight.jobs import InTurn, Task
from alight.photos.bundle import patch_matching_kernels as kernels
from alight.photos.bundle.features import shrunk, taken_by
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.solver import BundleState, Priors, project_points
from alight.raster import grey_levels
from alight.records import Frame, Pixels

log = logging.getLogger(__name__)

LEAST_LIKENESS = 0.8  # least correlation coefficient of a patch that is found
MOST_PX = 3200  # longest side of the pictures in which patches are matched
_SIDE = 2 * kernels.HALF + 3  # pixels of a patch with its margin


def refine_observations(
    state: BundleState, obs: BundleObservations, priors: Priors, frames: Sequence[Frame]
) -> BundleObservations:
    """Move observations to the pixels where their patches are found (eqs. 13, 14); other observations stay unchanged.

    Args:
        state: state as adjusted so far, with the points of the observations.
        obs: observations, sorted by point.
        priors: priors of all photos.
        frames: the photos.
    """
    if not len(obs.photo):
        return obs
    warp = _warps(state, obs, priors)
    first = np.zeros(len(obs.photo), dtype=bool)
    first[obs.starts] = True
    patches = np.full((obs.points, _SIDE, _SIDE), np.nan, np.float16)
    owned, others = (_by_photo(obs, rows) for rows in (first, ~first))
    cuts = (Task(f"patches {i}", _cut, (_picture(frames[i]), obs.pixels[k])) for i, k in owned)
    for (_, k), some in zip(owned, InTurn().run(cuts, at_once=True), strict=True):
        patches[obs.point[k]] = some
    pixels, found = obs.pixels.copy(), np.zeros(len(obs.photo), dtype=bool)
    finds = (
        Task(f"matches {i}", _find, (patches[obs.point[k]], _picture(frames[i]), obs.pixels[k], warp[k]))
        for i, k in others
    )
    for (_, k), moved in zip(others, InTurn().run(finds, at_once=True), strict=True):
        good = np.isfinite(moved).all(axis=1)
        pixels[k[good]] += moved[good]
        found[k[good]] = True
    found[obs.starts] = np.logical_or.reduceat(found, obs.starts)
    log.info("patches: %.0f %% of %d observations found", 100 * found.mean(), len(found))
    return replace(obs, pixels=pixels, by_patch=found)


def _by_photo(obs: BundleObservations, rows: Mask) -> list[tuple[int, I64]]:
    """Group the observations where `rows` is True by photo; return (photo index, observation indices) pairs."""
    chosen = np.flatnonzero(rows)
    order = chosen[np.argsort(obs.photo[chosen], kind="stable")]
    photos, begin = np.unique(obs.photo[order], return_index=True)
    return list(zip(photos.tolist(), np.split(order, begin[1:]), strict=True))


def _picture(frame: Frame) -> Pixels:
    image = frame.images[taken_by(frame)]
    assert image is not None  # the photo has features
    return image


def _grey(image: Pixels) -> tuple[F32, F64]:
    """Return grey levels (H, W) of a picture, shrunk if large, and their scale (2,) in x, y relative to the photo."""
    picture = np.asarray(image)
    read = grey_levels(shrunk(picture, MOST_PX))
    return read.astype(np.float32), np.array(read.shape[1::-1]) / picture.shape[1::-1]


def _cut(image: Pixels, pixels: F64) -> F16:
    grey, scale = _grey(image)
    out = np.empty((len(pixels), _SIDE, _SIDE), np.float32)
    kernels.sample_patches(grey, (pixels + 0.5) * scale - 0.5, out)
    return out.astype(np.float16)


def _find(patches: F16, image: Pixels, pixels: F64, warp: F64) -> F64:
    """Return the shifts (K, 2) in photo pixels from `pixels` (K, 2) to where the patches are found; NaN: not found.

    `patches` (K, R, R) are cut from each point's first photo, and `warp` (K, 2, 2) are the derivatives by `_warps`.
    """
    grey, scale = _grey(image)
    moved, likeness = np.empty((len(pixels), 2)), np.empty(len(pixels))
    kernels.match_patches(
        patches.astype(np.float32), grey, (pixels + 0.5) * scale - 0.5, np.ascontiguousarray(warp), moved, likeness
    )
    moved[likeness < LEAST_LIKENESS] = np.nan
    return moved / scale


def _warps(state: BundleState, obs: BundleObservations, priors: Priors) -> F64:
    """Return derivatives (N, 2, 2) of a point's pixel in each picture with respect to its pixel in its first picture.

    Pixels are those of the pictures in which patches are matched. The ground is assumed level over five pixels around a
    point. NaN where a patch is stretched more than three times, since it cannot be found there.
    """
    lenses, first = priors.lenses.moved(state.lens), obs.starts[obs.point]
    away = np.linalg.norm(state.points[obs.point] - state.centres[obs.photo], axis=1)
    reach = 5.0 * np.median(away / lenses.focal(obs.photo)[:, 0])
    sides = np.empty((2, 2, len(obs.photo), 2))  # axis, side
    for axis in (0, 1):
        for side, sign in enumerate((-0.5, 0.5)):
            beside = state.points.copy()
            beside[:, axis] += sign * reach
            sides[axis, side] = project_points(replace(state, points=beside), obs, priors).pixels
    by_ground = np.moveaxis(sides[:, 1] - sides[:, 0], 0, 2)  # (N, 2 pixels, 2 axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        A = by_ground[first]
        det = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
        adjoint = np.array([[A[:, 1, 1], -A[:, 0, 1]], [-A[:, 1, 0], A[:, 0, 0]]])
        warp = by_ground @ np.moveaxis(adjoint / det, 2, 0)
    reduced = np.array([min(1.0, MOST_PX / max(c.width, c.height)) for c in lenses.cameras])[lenses.of[obs.photo]]
    warp *= (reduced / reduced[first])[:, None, None]
    warp[~(np.abs(warp).max(axis=(1, 2)) < 3.0)] = np.nan
    return np.asarray(warp)
