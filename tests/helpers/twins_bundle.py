"""Plain NumPy twins of the bundle's kernels, an observation at a time: written from docs/method/bundle.md."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Camera, skew, so3_exp
from alight.photos.bundle.lenses import PhotoLenses, lens_camera
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.solver import BundleState, Priors

FAR = 1e4  # px, the residual of a point behind the camera


def exposed(state: BundleState, lenses: PhotoLenses, velocity: F64, photo: int, row: float) -> tuple[F64, F64, float]:
    """Rotation and centre at the exposure of a row, and its time, in readouts (eq. 10)."""
    t = (row + 0.5) / lenses.of_photo(photo).height - 0.5
    turn = so3_exp(state.turns[photo, 0] * t + state.turns[photo, 1] * (t * t - 1 / 12))
    way = velocity[photo] * lenses.readout(np.array([photo]))[0] * t
    return state.rotations[photo] @ turn, state.centres[photo] + way, t


def predicted(state: BundleState, obs: BundleObservations, lenses: PhotoLenses, velocity: F64) -> F64:
    """(N, 2) pixels (eq. 1)."""
    out = []
    for photo, point, pixel in zip(obs.photo, obs.point, obs.pixels, strict=True):
        R, C, _ = exposed(state, lenses, velocity, int(photo), pixel[1])
        out.append(lenses.of_photo(int(photo)).project(R.T @ (state.points[point] - C)))
    return np.array(out).reshape(-1, 2)


def by_camera_point(camera: Camera, p: F64, step: float = 1e-5) -> F64:
    """(2, 3) the derivative of a pixel by the point in the camera."""
    return np.stack([(camera.project(p + d) - camera.project(p - d)) / (2 * step) for d in step * np.eye(3)], axis=1)


def by_lens(camera: Camera, lens: F64, p: F64) -> F64:
    """(2, k) the derivative of a pixel by the numbers of its lens (eq. 3), that by the readout zero."""
    out = np.zeros((2, len(lens)))
    for k in range(len(lens) - 1):
        step = 1e-6 * np.eye(len(lens))[k]
        out[:, k] = (lens_camera(camera, lens + step).project(p) - lens_camera(camera, lens - step).project(p)) / 2e-6
    return out


def rows(state: BundleState, obs: BundleObservations, priors: Priors, each: int) -> tuple[F64, F64]:
    """(2N,) predicted less observed pixels, and (2N, p + 3m) derivatives by photos, free lens numbers and points.

    Eqs. 2, 3 and 11; the lens's own derivatives are differences.
    """
    lenses, n = priors.lenses.moved(state.lens), each * len(state.centres)
    free = np.flatnonzero(priors.sigma_lens > 0)
    J = np.zeros((len(obs.photo), 2, n + len(priors.sigma_lens) + 3 * obs.points))
    points = J.shape[2] - 3 * obs.points
    for k, (photo, point, pixel) in enumerate(zip(obs.photo, obs.point, obs.pixels, strict=True)):
        R, C, t = exposed(state, lenses, priors.velocity, int(photo), pixel[1])
        d = state.points[point] - C
        X = by_camera_point(lenses.of_photo(int(photo)), R.T @ d) @ R.T
        turn = X @ skew(d) @ state.rotations[photo]
        unknowns = [-X, X @ skew(d), turn * t, turn * (t * t - 1 / 12)]
        J[k, :, each * photo : each * (photo + 1)] = np.concatenate(unknowns[: each // 3], axis=1)
        J[k, :, points + 3 * point : points + 3 * point + 3] = X
        part = priors.lenses.parts[lenses.of[photo]]
        L = by_lens(priors.lenses.of_photo(int(photo)), state.lens[part], R.T @ d)
        L[:, -1] = -X @ priors.velocity[photo] * t
        J[k, :, n + part.start : n + part.stop] = L
    r = predicted(state, obs, lenses, priors.velocity) - obs.pixels
    keep = np.concatenate([np.arange(n), n + free, np.arange(points, J.shape[2])])
    return np.nan_to_num(r, nan=FAR).ravel(), J[:, :, keep].reshape(2 * len(obs.photo), -1)


def cauchy_weights(r: F64, sigma: F64, loss: float) -> F64:
    """(2N,) weights of rows, in units of 1 / px^2."""
    square = (r.reshape(-1, 2) ** 2).sum(axis=1) / sigma**2
    return np.repeat(1.0 / (1.0 + square / loss**2) / sigma**2, 2)


def meeting_points(starts: I64, ray: F64, origin: F64, focal: F64, rounds: int, scale: float) -> F64:
    """(m, 3) points nearest to their rays, reweighted by their angular residual."""
    weight, out = np.ones(len(ray)), np.empty((len(starts) - 1, 3))
    for _ in range(rounds):
        for k, (a, b) in enumerate(pairwise(starts)):
            across = (np.eye(3) - ray[a:b, :, None] * ray[a:b, None, :]) * weight[a:b, None, None]
            A = across.sum(axis=0) + 1e-9 * np.eye(3)
            out[k] = np.linalg.solve(A, np.einsum("nij,nj->i", across, origin[a:b]))
        offset = np.repeat(out, np.diff(starts), axis=0) - origin
        distance = np.linalg.norm(offset, axis=1)
        miss = np.linalg.norm(np.cross(ray, offset), axis=1) / distance * focal
        weight = 1.0 / (1.0 + (miss / scale) ** 2) / distance**2
        weight /= weight.max()
    return out
