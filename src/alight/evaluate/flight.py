"""A run against a flight with truth: `truth/dem.tif`, `truth/class.tif`, `state_groundtruth_estimate0`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray

from alight.evaluate.report import Evaluation, nmad, rms
from alight.geometry import Grid, so3_log
from alight.outputs import Run
from alight.records import F64, Flag, InputError, Terrain
from alight.settings import load
from alight.simulate import Footprint
from alight.simulate.truth import safe_mask
from alight.sources import open_source, read_tum

GROUND = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)
NEVER = (Terrain.WATER, Terrain.TALL_VEGETATION, Terrain.TREE, Terrain.STRUCTURE)
BAD = 0.5  # metres: a height that wrong must be flagged
RING = np.linspace(0, 2 * np.pi, 16, endpoint=False)


def read_truth(folder: Path, name: str) -> tuple[NDArray[Any], Grid]:
    """A raster of the truth and its grid (metres in the world)."""
    path = folder / "truth" / name
    if not path.exists():
        raise InputError(f"{path}: missing; --truth takes a flight with truth/ or a folder with sfm_reference.npz")
    with rasterio.open(path) as d:
        t = d.transform
        return d.read(1), Grid(t.c + t.a / 2, t.f + t.e / 2, t.a, d.height, d.width)


def at(values: NDArray[Any], grid: Grid, east: F64, north: F64) -> NDArray[Any]:
    """The nearest cell's value at each place; NaN (or 0 for classes) outside."""
    r, c = (np.rint(i).astype(int) for i in grid.index(east, north))
    inside = (r >= 0) & (r < grid.rows) & (c >= 0) & (c < grid.cols)
    outside = np.nan if np.issubdtype(values.dtype, np.floating) else 0
    return np.where(inside, values[r.clip(0, grid.rows - 1), c.clip(0, grid.cols - 1)], outside)


def heights(run: Run, folder: Path, out: Evaluation) -> None:
    """Heights, sigma and acceptance by class."""
    if run.height is None or run.grid is None or run.flags is None or run.sigma is None:
        out.put("heights", "the run has no dem.tif")
        return
    dem, grid = read_truth(folder, "dem.tif")
    label, _ = read_truth(folder, "class.tif")
    xs, ys = run.grid.xy()
    e, n = np.meshgrid(xs, ys)
    true, kind = at(dem, grid, e, n), at(label, grid, e, n)
    seen = ((run.flags & np.uint16(Flag.UNSEEN)) == 0) & np.isfinite(true)
    given = np.isfinite(run.height) & seen
    error = run.height - true
    ground = np.isin(kind, GROUND)
    g = error[given & ground]
    if not g.size:
        out.put("heights", "no ground cell of the truth was measured")
        return
    above = float(run.info.get("height_above_ground_m") or np.nan)
    offset = float(np.median(g))
    sigma = run.sigma[given & ground]
    out.put("height above ground, m", above)
    out.put("ground NMAD, m", nmad(g))
    out.put("ground NMAD, % of height", 100 * nmad(g) / above)
    out.put("ground offset (median), m", offset)
    out.put("ground P95 of |error|, m", float(np.percentile(np.abs(g), 95)))
    out.put("ground P95 of |error - offset|, m", float(np.percentile(np.abs(g - offset), 95)))
    out.put("ground accepted of seen, %", 100 * float((given & ground).sum() / max((seen & ground).sum(), 1)))
    out.put("ground within 1 sigma, %", 100 * float(np.mean(np.abs(g - offset) < sigma)))
    out.put("ground within 1.96 sigma, %", 100 * float(np.mean(np.abs(g - offset) < 1.96 * sigma)))
    wrong = given & (np.abs(error - offset) > BAD)
    out.put(f"given out and off by more than {BAD} m, % of given out", 100 * float(wrong.sum() / given.sum()))
    for t in (Terrain.WATER, Terrain.TREE, Terrain.TALL_VEGETATION):
        out.put(
            f"  of these on {t.name.lower().replace('_', ' ')}, % of given out",
            100 * float((wrong & (kind == t)).sum() / given.sum()),
        )


def decision(run: Run, folder: Path, out: Evaluation) -> None:
    """The sites and the safe cells against the truth by brute force."""
    dem, grid = read_truth(folder, "dem.tif")
    label, _ = read_truth(folder, "class.tif")
    lander = load("", ()).lander.model_validate(run.info["settings"]["lander"])
    foot = Footprint(lander.radius, lander.max_slope, lander.max_roughness)
    truly = safe_mask(dem.astype(np.float32), label, grid.cell, foot)
    sites = run.info["answer"]["sites"]
    out.put("sites", float(len(sites)))
    for k, s in enumerate(sites):
        east, north = np.array([s["east_m"]]), np.array([s["north_m"]])
        if k == 0:
            out.put("best site truly safe", "yes" if bool(at(truly.astype(np.uint8), grid, east, north)[0]) else "NO")
    on = [Terrain(int(at(label, grid, np.array([s["east_m"]]), np.array([s["north_m"]]))[0])) for s in sites]
    safe = [bool(at(truly.astype(np.uint8), grid, np.array([s["east_m"]]), np.array([s["north_m"]]))[0]) for s in sites]
    out.put("sites truly safe", f"{sum(safe)} of {len(sites)}")
    out.put("sites centred on water, plants or structures", float(sum(t in NEVER for t in on)))
    if run.safe is None or run.grid is None:
        return
    e, n = np.meshgrid(*run.grid.xy())
    good = at(truly.astype(np.uint8), grid, e, n) > 0
    known = np.isfinite(at(dem, grid, e, n))
    claimed = (run.safe >= run.info["settings"]["hazards"]["p_safe"]) & known
    near = dilated(good, 0.3 / run.grid.cell)
    out.put(
        "declared safe and not within 0.3 m of truly safe, %",
        100 * float((claimed & ~near).sum() / max(claimed.sum(), 1)),
    )
    out.put("truly safe cells found, %", 100 * float((claimed & good).sum() / max(good.sum(), 1)))


def dilated(mask: NDArray[np.bool_], cells: float) -> NDArray[np.bool_]:
    """The mask grown by a radius in cells."""
    from scipy.ndimage import distance_transform_edt

    return np.asarray(distance_transform_edt(~mask) <= cells) if mask.any() else mask


def trajectory(run: Run, folder: Path, out: Evaluation) -> None:
    """Estimated body poses against the true ones, at the same times."""
    truth = open_source(folder, load("", ())).truth_trajectory
    path = run.folder / "trajectory.tum"
    if truth is None or not path.exists() or run.local is None:
        return
    t, poses = read_tum(path, run.local)
    at_true = {int(k): p for k, p in zip(truth[0], truth[1], strict=True)}
    pairs = [(p, at_true[int(k)]) for k, p in zip(t, poses, strict=True) if int(k) in at_true]
    if not pairs:
        return
    d = np.array([a.translation - b.translation for a, b in pairs])
    r = np.array([so3_log(a.rotation @ b.rotation.T) for a, b in pairs])
    out.put("position RMSE, m", rms(np.linalg.norm(d, axis=1)))
    out.put("position RMSE less a constant, m", rms(np.linalg.norm(d - d.mean(0), axis=1)))
    out.put("attitude RMSE, deg", float(np.degrees(rms(np.linalg.norm(r, axis=1)))))
    out.put("mean tilt (about east, north), mrad", f"{1e3 * r.mean(0)[0]:.2f} {1e3 * r.mean(0)[1]:.2f}")


def against_flight(run: Run, folder: Path) -> Evaluation:
    """Compare a run with a flight that has truth.

    Raises:
        InputError: the flight has no truth.
    """
    out = Evaluation(f"{run.folder} against the truth of {folder}")
    heights(run, folder, out)
    decision(run, folder, out)
    trajectory(run, folder, out)
    return out
