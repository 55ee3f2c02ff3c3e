"""Gauss-Newton on the world grid: sub-pixel heights from the fused template's gradient (docs/method.md, eqs. 8-12)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.kernels import parallax as kernels
from alight.kernels import surface
from alight.kernels.sorting import network
from alight.parallax.views import Prepared, stack
from alight.records import F32, F64

TAU = np.float32(0.35)  # normalised grey, Huber's knee
RADIUS = 2  # cells: 5x5 windows
HIDE_PX = 3.0  # parallax pixels that the map must rise above a ray to stop it
STEP_PX = 0.5  # parallax pixels of the widest baseline a step may go
PRIOR = (
    1600.0  # of the plane prior: 1 over its variance in parallax pixels^2, for cells taken as independent, which they
)
# are not: neighbours share pixels, so 100 left three times the noise on a concrete slab
PRIOR_RADIUS = 3  # cells


@dataclass(eq=False)
class Fit:
    """Heights and what the last step knew about them; all (R, C)."""

    height: F32
    precision: F32  # Lambda of the window, normalised grey^2 / m^2
    noise: F32  # s2 of the window, normalised grey^2
    mean: F32  # template m
    used: NDArray[np.uint8]  # views that agreed
    seen: NDArray[np.uint8]  # views that saw the cell


def centres_of(prepared: list[Prepared]) -> F64:
    """Camera centres (N, 3)."""
    return np.array([p.centre for p in prepared])


def metres_per_pixel(prepared: list[Prepared], height: F32, grid: Grid) -> F32:
    """Height that moves the outermost pair of views by one cell, (R, C) metres."""
    centres = centres_of(prepared)
    spread = np.linalg.norm(centres[:, None, :2] - centres[None, :, :2], axis=2).max()
    drop = np.maximum(centres[:, 2].mean() - np.nan_to_num(height, nan=float(np.nanmedian(height))), 1e-2)
    return np.asarray(grid.cell * drop / max(spread, 1e-6), dtype=np.float32)


def hidden_from(prepared: list[Prepared], grid: Grid, height: F32, metres_per_px: F32) -> NDArray[np.bool_]:
    """(N, R, C): the map stands between the cell and the camera (eq. 13).

    Single spikes hide nothing. Where the map hides a cell from all cameras but one, the map is wrong, and no view is
    left out.
    """
    out = np.empty((len(prepared), *grid.shape), np.uint8)
    xs, ys = grid.xy()
    solid = cv2.medianBlur(np.nan_to_num(height, nan=-1e4).astype(np.float32), 5)
    solid[solid < -9e3] = np.nan
    margin = np.float32(HIDE_PX * np.nanmedian(metres_per_px))
    surface.visibility(solid, np.float32(np.nanmax(height)), centres_of(prepared), xs, ys, grid.cell, margin, out)
    return np.asarray((out == 0) & (out.sum(axis=0) >= 2))


def gauss_newton(
    prepared: list[Prepared],
    grid: Grid,
    height: F32,
    hidden: NDArray[np.bool_] | None,
    iterations: int,
    prior: float = PRIOR,
) -> Fit:
    """Refine `height` (R, C) so that all views of each window agree; NaN stays NaN.

    `hidden` (N, R, C) leaves views out where the map stands in their way.
    """
    shape, xs_ys = grid.shape, grid.xy()
    a, b, c = (np.zeros(shape, np.float32) for _ in range(3))
    fit = Fit(height.copy(), a, b, c, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))
    lam, eta, s2, step = (np.zeros(shape, np.float32) for _ in range(4))
    weights = np.empty((len(prepared), *shape), np.float32)
    centres = centres_of(prepared)
    for last in [False] * iterations + [True]:
        samples = stack(prepared, grid, fit.height)
        fit.seen = np.isfinite(samples).sum(axis=0).astype(np.uint8)
        if hidden is not None:
            samples[hidden] = np.nan
        kernels.template(samples, network(len(samples)), TAU, weights, fit.mean, fit.used)
        kernels.normal_equations(
            samples, weights, fit.mean, fit.used, centres, *xs_ys, fit.height, grid.cell, lam, eta, s2
        )  # fmt: skip
        spread = metres_per_pixel(prepared, fit.height, grid)
        limit = (STEP_PX * spread).astype(np.float32)
        kernels.solve(lam, eta, s2, fit.height, RADIUS, spread, limit, step, fit.precision, fit.noise)
        if last:
            break
        moved = fit.height + step
        surface.plane_prior(moved, fit.precision, fit.noise, spread, np.float32(prior), PRIOR_RADIUS, fit.height)
    return fit
