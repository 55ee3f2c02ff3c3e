"""The common error of a batch map: offset and tilt by the poses' errors, and the rest that a plane leaves.

The joint covariance of the poses is propagated to the matched points, and a plane is fitted to their errors
(docs/method/uncertainty.md, eqs. 26 and 27).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from alight.arrays import F32, F64, I64
from alight.geometry import Grid
from alight.parallax.pose_error import Matched, sensitivity
from alight.raster import gradient, nearest_known
from alight.records import Datum, ElevationMap, KeyframePosterior

SAMPLES = 900  # cells of the map that are sampled, about
LEAST = 12  # of them, least for a plane
SLOPE_CELLS = 1.5  # 1-sigma of the Gaussian over which the slope of the map is taken: heights are no finer


@dataclass(frozen=True, eq=False)
class Shared:
    """Errors that neighbouring cells share, of the S sampled cells."""

    datum: Datum
    rows: I64  # (S,) of the map
    cols: I64  # (S,)
    bend: F64  # (S,) metres up, 1-sigma of the rest that the plane leaves
    shift: F64  # (S,) metres east or north, 1-sigma of the cell's place beside the shift of all cells


def with_datum(found: ElevationMap, matched: Sequence[Matched], joint: KeyframePosterior) -> ElevationMap:
    """The map with its datum: offset and tilt of the plane, and as `warp` the rest that a plane leaves."""
    shared = shared_error(found, matched, joint)
    if shared is None:
        return found
    bend, shift = (_on(found.grid, shared, v) for v in (shared.bend, shared.shift))
    return replace(found, datum=shared.datum, warp=np.hypot(bend, shift * steepness(found)))


def shared_error(found: ElevationMap, matched: Sequence[Matched], joint: KeyframePosterior) -> Shared | None:
    """Propagate the joint covariance of the views to the map; None where too little of the map is known.

    Args:
        found: the map.
        matched: the tiles it was matched from; a later one covers an earlier.
        joint: covariance of the poses of the recording.
    """
    rows, cols, points = _sampled(found)
    J = _through(points, matched, joint)
    known = np.isfinite(J[:, 0, 0])
    if known.sum() < LEAST:
        return None
    J, points, rows, cols = J[known], points[known], rows[known], cols[known]
    centre = points[:, :2].mean(axis=0)
    B = np.column_stack([np.ones(len(points)), points[:, :2] - centre])
    L = np.asarray(np.linalg.pinv(B) @ J[:, 2])
    covariance = L @ joint.covariance @ L.T
    datum = Datum(float(centre[0]), float(centre[1]), 0.5 * (covariance + covariance.T))
    bend = _sigma(J[:, 2:] - (B @ L)[:, None], joint.covariance)
    shift = _sigma(J[:, :2] - J[:, :2].mean(axis=0), joint.covariance) / np.sqrt(2.0)
    return Shared(datum, rows, cols, bend, shift)


def steepness(found: ElevationMap) -> F32:
    """(R, C) root mean square slope of the map about each cell, metres a metre: height error a metre of shift."""
    height, known = np.nan_to_num(found.height), np.isfinite(found.height).astype(np.float32)
    share = np.maximum(_blurred(known), np.float32(1e-3))
    level = _blurred(height * known) / share
    north, east = gradient(level, found.grid.cell)
    return np.sqrt(_blurred((north**2 + east**2).astype(np.float32) * known) / share)


def _blurred(values: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), SLOPE_CELLS), dtype=np.float32)


def _sampled(found: ElevationMap) -> tuple[I64, I64, F64]:
    """Rows, columns and places (S, 3) of trusted cells, evenly spaced."""
    trusted = found.trusted
    step = max(1, int(np.sqrt(trusted.sum() / SAMPLES)))
    lattice = np.zeros_like(trusted)
    lattice[step // 2 :: step, step // 2 :: step] = True
    rows, cols = np.nonzero(trusted & lattice)
    e, n = found.grid.xy()
    return rows, cols, np.column_stack([e[cols], n[rows], found.height[rows, cols].astype(np.float64)])


def _through(points: F64, matched: Sequence[Matched], joint: KeyframePosterior) -> F64:
    """(S, 3, M) sensitivities, each point with the views of the last tile that holds it; NaN where none does."""
    out = np.full((len(points), 3, len(joint.covariance)), np.nan)
    left = np.ones(len(points), dtype=bool)
    for tile in reversed(matched):
        mine = left & tile.holds(points[:, 0], points[:, 1])
        if mine.any():
            out[mine] = sensitivity(points[mine], tile.cameras, joint)
            left &= ~mine
    return out


def _sigma(J: F64, covariance: F64) -> F64:
    """(S,) root of the summed variances of the rows (S, r, M)."""
    flat = J.reshape(-1, J.shape[-1])
    variance = np.maximum(((flat @ covariance) * flat).sum(axis=1), 0.0)
    return np.asarray(np.sqrt(variance.reshape(J.shape[:2]).sum(axis=1)))


def _on(grid: Grid, shared: Shared, values: F64) -> F32:
    """The value of the nearest sampled cell on every cell, (R, C)."""
    out, known = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, dtype=bool)
    out[shared.rows, shared.cols], known[shared.rows, shared.cols] = values, True
    return np.asarray(nearest_known(out, known))
