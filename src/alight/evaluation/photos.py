"""Compare a run over photos with a structure-from-motion reference: `sfm_reference.npz`, optional `slab_plane.npz`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from alight.arrays import F64
from alight.documents import read_bytes
from alight.evaluation.report import Evaluation, rms
from alight.geometry import Grid, LocalFrame, world_up
from alight.learned import arrays_of
from alight.outputs.reading import Run
from alight.raster import ellipse
from alight.records import Flag, InputError, is_flagged
from alight.sources.tum import read_tum
from alight.spread import nmad

# shapes by name; -1: number of points, -2: number of photos
REFERENCE = {
    "origin_llh": (3,),
    "points_enu": (-1, 3),
    "points_track": (-1,),
    "points_err": (-1,),
    "centers_enu": (-2, 3),
}
SLAB = {"points": (-1, 3), "inlier": (-1,)}


def interpolated(height: NDArray[np.float32], grid: Grid, east: F64, north: F64) -> F64:
    """Interpolate heights (R, C) bilinearly at positions, metres; if a neighbour is missing, take the nearest cell."""
    r, c = (i.astype(np.float32) for i in grid.index(east, north))
    source = height.astype(np.float64)
    linear = cv2.remap(source, c, r, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan).ravel()
    nearest = cv2.remap(source, c, r, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan).ravel()
    return np.asarray(np.where(np.isnan(linear), nearest, linear))


def plane_of(points: F64, errors: F64) -> tuple[F64, F64]:
    """Fit a east + b north + c to errors (N,) at points (N, 3), without outliers; return (a, b, c) and residuals."""
    X = np.c_[points[:, :2], np.ones(len(points))]
    use = np.abs(errors - np.median(errors)) < max(5 * nmad(errors), 0.05)
    for _ in range(2):
        plane = np.linalg.lstsq(X[use], errors[use], rcond=None)[0]
        left = errors - X @ plane
        use = np.abs(left) <= max(5 * nmad(left[use]), 1e-6)
    return plane, left


def slab_of(points: F64, inlier: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Return the mask of a flat slab, (R, C): the cells of its points `inlier` (N,), with gaps up to 1 m closed."""
    r, c = (np.rint(i).astype(int) for i in grid.index(points[inlier, 0], points[inlier, 1]))
    inside = (r >= 0) & (r < grid.rows) & (c >= 0) & (c < grid.cols)
    mask = np.zeros(grid.shape, np.uint8)
    mask[r[inside], c[inside]] = 1
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, ellipse(round(0.5 / grid.cell)))
    return np.asarray(cv2.erode(closed, ellipse(2)) > 0)


def high_pass(height: F64, cell: float) -> F64:
    """Subtract from heights (R, C) their mean over 1 m; `cell`: metres."""
    known = np.isfinite(height)
    k = (round(1.0 / cell) | 1,) * 2
    weight = cv2.blur(known.astype(np.float64), k)
    return np.asarray(height - cv2.blur(np.where(known, height, 0.0), k) / np.maximum(weight, 1e-9))


def against_photos(run: Run, folder: Path) -> Evaluation:
    """Compare heights and camera centres with a structure-from-motion reference.

    Raises:
        InputError: the run has no absolute position, or the reference is unreadable or of another location.
    """
    if run.local is None:
        raise InputError(f"{run.folder}: the run has no place on Earth, so nothing can be compared with the reference")
    ref = read_arrays(folder / "sfm_reference.npz", REFERENCE)
    frame = LocalFrame(*ref["origin_llh"])
    if np.linalg.norm(run.local.to_enu(frame.latitude, frame.longitude, frame.height)) > 20_000.0:
        raise InputError(f"{folder}: the reference of another place; name the one of the photos that were run")
    out = Evaluation(f"{run.folder} against the reference of {folder}")
    used = (ref["points_track"] >= 3) & (ref["points_err"] < 1.0)  # seen in 3 photos; reprojection error, px
    points = run.local.to_enu(*frame.to_geodetic(ref["points_enu"][used]))
    _heights(run, points, out)
    if (folder / "slab_plane.npz").exists():
        slab = read_arrays(folder / "slab_plane.npz", SLAB)
        _slab(run, run.local.to_enu(*frame.to_geodetic(slab["points"])), slab["inlier"], out)
    _centres(run, run.local.to_enu(*frame.to_geodetic(ref["centers_enu"])), out)
    return out


def read_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray[Any]]:
    """Read named arrays of an .npz file, and check their shapes.

    Raises:
        InputError: the file is unreadable, an array is missing or not numeric, or its shape is wrong.
    """
    try:
        largest = 4_000_000_000  # bytes
        arrays = arrays_of(read_bytes(path, largest), largest)
        found, sizes = {name: arrays[name] for name in shapes}, dict[int, int]()
        for name, shape in shapes.items():
            values = found[name]
            lengths = tuple(
                sizes.setdefault(n, own) if n < 0 else n for n, own in zip(shape, values.shape, strict=True)
            )
            if values.shape != lengths or values.dtype.kind not in "fiub":
                raise ValueError(f"{name} is of another shape")
        return found
    except (OSError, ValueError, KeyError) as e:
        raise InputError(f"{path}: not a reference with the arrays {', '.join(shapes)}; copy it again") from e


def _heights(run: Run, points: F64, out: Evaluation) -> None:
    if run.height is None or run.grid is None or run.flags is None or run.local is None or run.sigma is None:
        out.put("heights", "the run has no dem.tif")
        return
    up = world_up(run.height, run.grid, run.local)
    above = float(run.info.get("height_above_ground_m") or np.nan)
    error = interpolated(up, run.grid, points[:, 0], points[:, 1]) - points[:, 2]
    given = np.isfinite(error)
    if given.sum() < 3:
        out.put("heights", f"{given.sum()} of {len(points)} reference points lie on the map: nothing to compare")
        return
    plane, left = plane_of(points[given], error[given])
    sigma = interpolated(run.sigma, run.grid, points[given, 0], points[given, 1])
    known = np.isfinite(sigma)
    total = np.sqrt(sigma[known] ** 2 + 0.028**2)
    off = float((np.abs(left) > 0.01 * above).sum() / len(points)) if np.isfinite(above) else np.nan
    seen = ~is_flagged(run.flags, Flag.UNSEEN | Flag.FEW)
    out.values |= {
        "height above ground, m": above,
        "points compared": f"{given.sum()} of {len(points)}",
        "NMAD less a plane, m": nmad(left),
        "P95 of |error| less a plane, m": float(np.percentile(np.abs(left), 95)),
        "bias (median), m": float(np.median(error[given])),
        "tilt, mrad": float(1e3 * np.hypot(*plane[:2])),
        "off by more than 1 % of height and given out, % of all points": 100 * off,
        "within 1.96 sigma (points' own 0.028 m added), %": 100 * float(np.mean(np.abs(left[known]) < 1.96 * total)),
        "accepted of cells seen by three photos or more, %": 100 * float(np.isfinite(run.height)[seen].mean()),
    }


def _slab(run: Run, points: F64, inlier: NDArray[np.bool_], out: Evaluation) -> None:
    if run.height is None or run.grid is None:
        return
    slab = slab_of(points, inlier, run.grid)
    if not slab.any():
        out.put("slab", "not on the map")
        return
    given, fine = np.isfinite(run.height), high_pass(run.height.astype(np.float64), run.grid.cell)
    out.put("accepted on the slab, %", 100 * float(given[slab].mean()))
    out.put("slab flatness (NMAD after 1 m high-pass), m", nmad(fine[slab & given]))


def _centres(run: Run, centres: F64, out: Evaluation) -> None:
    path = run.folder / "trajectory.tum"
    if not path.exists() or run.local is None:
        return
    own = np.array([p.translation for p in read_tum(path, run.local)[1]])  # the body of a photo is its camera
    distance, index = cKDTree(centres).query(own)
    if len(set(index.tolist())) < len(own):
        out.put("camera centres", "cannot be distinguished: two are nearest to the same reference")
        return
    out.put("camera centres compared", f"{len(own)} of {len(centres)}")
    out.put("camera centres RMS, m", rms(distance))
