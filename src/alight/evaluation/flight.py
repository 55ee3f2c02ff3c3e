"""Compare a run with a flight's truth: `truth/dem.tif`, `truth/class.tif`, `state_groundtruth_estimate0`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.arrays import F64
from alight.evaluation.report import Evaluation, rms
from alight.geometry import Grid, LocalFrame, so3_log
from alight.outputs.reading import Run, read_bands
from alight.raster import clearance_of, gradient
from alight.records import Flag, Hazard, InputError, Terrain, is_flagged, is_site
from alight.runner.opening import open_source
from alight.settings import Lander, Settings
from alight.sources.heights import words_of
from alight.sources.opened_raster import open_raster, read_on
from alight.sources.raster_band import band_of_heights
from alight.sources.raster_plane import plane_in_memory
from alight.sources.source import Trajectory
from alight.sources.tum import read_tum
from alight.spread import nmad
from alight_sim import TrueFootprint
from alight_sim.spans import COLUMNS, TrueSpans
from alight_sim.truth import safe_mask

GROUND = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)
NEVER = (Terrain.WATER, Terrain.TALL_VEGETATION, Terrain.TREE, Terrain.STRUCTURE)
BAD = 0.5  # metres; a height with a larger error must be flagged
ROOM = 1.0  # metres of clearance with which truly safe ground should not be refused
NEAR = 0.3  # metres; a cell this close to truly safe ground is an inexact edge, not a mistake


@dataclass(frozen=True, eq=False)
class FlightTruth:
    """True heights and classes of the ground, and the spans over it."""

    dem: NDArray[np.float32]  # (R, C) metres above the WGS84 ellipsoid, NaN = unknown
    label: NDArray[np.uint8]  # (R, C) Terrain codes
    grid: Grid
    settled: str = ""  # unit and vertical datum of the stored heights
    spans: TrueSpans = field(default_factory=TrueSpans)

    def safe(self, lander: Lander) -> NDArray[np.uint8]:
        """Compute the cells on which a touchdown is truly safe, by brute force; (R, C) of 0 and 1."""
        foot = TrueFootprint(lander.radius, lander.max_slope, lander.max_roughness)
        safe = safe_mask(self.dem, self.label, self.grid.cell, foot) & ~self.spans.over(self.grid, lander.radius)
        return safe.astype(np.uint8)


def read_flight_truth(folder: Path, local: LocalFrame | None = None) -> FlightTruth:
    """Read the rasters and spans in `truth/`; they must use the coordinates of the flight's world `local`, if given.

    Raises:
        InputError: a raster is missing, unreadable or in other coordinates, or the two grids differ.
    """
    paths = [folder / "truth" / f"{name}.tif" for name in ("dem", "class")]
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: missing; --truth takes a flight with truth/dem.tif and truth/class.tif")
    with open_raster(paths[0]) as raster:
        plane, band = plane_in_memory(raster), band_of_heights(raster)
        if local is not None and (plane.metres != 1.0 or not plane.lies_in(local)):
            raise InputError(
                f"{raster.label}: lies in {plane.settled}, not in the flight's own coordinates; mend it with: gdalwarp "
                f"-r bilinear -t_srs '{local.crs}' {raster.file} OUT.tif"
            )
        settled = words_of(raster, band)
        dem = band.heights(read_on(raster, [band.number], plane.crs, plane.grid)[0])
    bands, grid = read_bands(paths[1], 1, "u", "copy it again")
    if grid != plane.grid:
        raise InputError(f"{folder / 'truth'}: dem.tif and class.tif are not on one grid; make them anew")
    return FlightTruth(dem.astype(np.float32), bands[0], grid, settled, _read_spans(folder / "truth" / "spans.csv"))


def _read_spans(path: Path) -> TrueSpans:
    if not path.exists():
        return TrueSpans()
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as e:
        raise InputError(f"{path}: is not readable as rows of {COLUMNS} numbers ({e}); make it anew") from e
    if table.shape[1:] != (COLUMNS,) or not np.isfinite(table).all():
        raise InputError(f"{path}: must have rows of {COLUMNS} finite numbers; make it anew")
    return TrueSpans(table)


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Comparison of a run with the truth, after the run's map and sites are moved back by an offset."""

    run: Run
    truth: FlightTruth
    safe: NDArray[np.uint8]  # cells of the truth where a touchdown is safe
    out: Evaluation
    offset: F64  # (3,) metres, position in the run minus position in the truth
    suffix: str = ""  # suffix of the names of all numbers

    def put(self, name: str, value: float | str) -> None:
        self.out.put(name + self.suffix, value)

    def at(self, raster: NDArray[Any], grid: Grid) -> NDArray[Any]:
        """Return the values of a raster of the truth at the cells of `grid`, which is a grid of the run."""
        east, north = np.meshgrid(*grid.xy())
        return self.truth.grid.nearest_at(raster, east - self.offset[0], north - self.offset[1])

    def heights(self) -> None:
        """Compare heights, sigma and acceptance with the truth, by class."""
        run = self.run
        if run.height is None or run.grid is None or run.flags is None or run.sigma is None:
            self.put("heights", "the run has no dem.tif")
            return
        true, kind = self.at(self.truth.dem, run.grid), self.at(self.truth.label, run.grid)
        seen = ~is_flagged(run.flags, Flag.UNSEEN) & np.isfinite(true)
        given, ground = np.isfinite(run.height) & seen, np.isin(kind, GROUND)
        error = run.height - self.offset[2] - true
        g = error[given & ground]
        if not g.size:
            self.put("heights", "no ground cell of the truth was measured")
            return
        above, middle = float(run.info.get("height_above_ground_m") or np.nan), float(np.median(g))
        sigma, (east, north) = run.sigma[given & ground], np.meshgrid(*run.grid.xy())
        total = np.hypot(sigma, tilted(run, east[given & ground], north[given & ground]))
        wrong = given & (np.abs(error - middle) > BAD)
        rows = {
            "ground NMAD, m": nmad(g),
            "ground NMAD, % of height": 100 * nmad(g) / above,
            "ground offset (median), m": middle,
            "ground P95 of |error|, m": float(np.percentile(np.abs(g), 95)),
            "ground P95 of |error - offset|, m": float(np.percentile(np.abs(g - middle), 95)),
            "ground accepted of seen, %": share(given & ground, seen & ground),
            "ground within 1 sigma, %": 100 * float(np.mean(np.abs(g - middle) < sigma)),
            "ground within 1.96 sigma, %": 100 * float(np.mean(np.abs(g - middle) < 1.96 * sigma)),
            "ground within 1.96 sigma and common tilt, %": 100 * float(np.mean(np.abs(g - middle) < 1.96 * total)),
            f"given out and off by more than {BAD} m, % of given out": share(wrong, given),
        }
        for t in (Terrain.WATER, Terrain.TREE, Terrain.TALL_VEGETATION):
            name = f"  of these on {t.name.lower().replace('_', ' ')}, % of given out"
            rows[name] = share(wrong & (kind == t), given)
        for name, value in rows.items():
            self.put(name, value)

    def decision(self) -> None:
        """Compare the listed sites and the cells declared safe with the truly safe cells."""
        run, grid = self.run, self.truth.grid
        sites, candidates = (places_of(run, kind) - self.offset[:2] for kind in ("sites", "candidates"))
        good, maybe = (grid.nearest_at(self.safe, *p.T).astype(bool).tolist() for p in (sites, candidates))
        if good:
            self.put("best site truly safe", "yes" if good[0] else "NO")
        self.put("sites truly safe", f"{sum(good)} of {len(good)}")
        on = grid.nearest_at(self.truth.label, *sites.T)
        self.put("sites centred on water, plants or structures", float(np.isin(on, NEVER).sum()))
        self.put("candidates truly safe", f"{sum(maybe)} of {len(maybe)}")
        if maybe and not good:
            self.put("first candidate truly safe", "yes" if maybe[0] else "NO")
        if run.safe is None or run.grid is None:
            return
        good_cells = self.at(self.safe, run.grid) > 0
        known = np.isfinite(self.at(self.truth.dem, run.grid))
        claimed = is_site(run.safe, run.settings.hazards.p_safe) & known
        near = dilated(good_cells, NEAR / run.grid.cell)
        self.put(f"declared safe and not within {NEAR} m of truly safe, %", share(claimed & ~near, claimed))
        self.put("truly safe cells found, %", share(claimed & good_cells, good_cells))
        if run.reasons is None or run.flags is None:
            return
        roomy = (clearance_of(self.safe > 0, grid.cell) >= ROOM).astype(np.uint8)
        open_cells = (self.at(roomy, run.grid) > 0) & ~is_flagged(run.flags, Flag.UNSEEN)
        kept = (run.reasons & ~np.uint16(Hazard.DOUBT)) == 0
        name = f"seen and truly safe with {ROOM:g} m of clearance, and not refused, %"
        self.put(name, share(kept & open_cells, open_cells))


def tilted(run: Run, east: F64, north: F64) -> F64:
    """Compute the 1-sigma of the height at each position due to the map's common tilt, metres; 0 without covariance."""
    common = run.info.get("common_error")
    if common is None:
        return np.zeros(np.shape(east))
    arm = np.stack([east - common["centre_m"][0], north - common["centre_m"][1]], axis=-1)
    tilt = np.array(common["covariance"], dtype=np.float64)[1:, 1:]
    return np.asarray(np.sqrt(np.maximum(((arm @ tilt) * arm).sum(axis=-1), 0.0)))


def placed(run: Run, truth: FlightTruth, offset: F64) -> F64:
    """Estimate the constant offset of the map from its heights, (3,) metres east, north and up.

    The height error is fitted to the slope of the map and a constant by robust least squares (Nuth and Kaab 2011, eqs.
    1 to 3, solved directly). The fit starts from the path's `offset`, which a map made in flight need not share.
    """
    if run.height is None or run.grid is None or run.flags is None:
        return offset
    e, n = np.meshgrid(*run.grid.xy())
    south, east = (np.asarray(rise) for rise in gradient(run.height.astype(np.float64), run.grid.cell))
    known = ~is_flagged(run.flags, Flag.UNSEEN) & np.isfinite(east) & np.isfinite(south)
    for _ in range(6):
        error = run.height - offset[2] - truth.grid.nearest_at(truth.dem, e - offset[0], n - offset[1])
        kind = truth.grid.nearest_at(truth.label, e - offset[0], n - offset[1])
        use = known & np.isfinite(error) & np.isin(kind, GROUND)
        if use.sum() < 100:
            return offset
        offset = np.add(offset, robust(np.column_stack([-east[use], south[use], np.ones(use.sum())]), error[use]))
    return offset


def robust(A: F64, y: F64) -> F64:
    """Solve A x = y by least squares with Cauchy weights at twice the NMAD; return x."""
    x: F64 = np.zeros(A.shape[1])
    weight: F64 = np.ones(len(y))
    for _ in range(8):
        x = np.asarray(np.linalg.lstsq(A * weight[:, None], y * weight, rcond=None)[0])
        left = y - A @ x
        weight = 1.0 / np.sqrt(1.0 + (left / max(2.0 * nmad(left), 1e-6)) ** 2)
    return np.asarray(x)


def share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    """Return the number of True cells of `part` as a percentage of the number of True cells of `whole`."""
    return 100 * float(part.sum() / max(whole.sum(), 1))


def places_of(run: Run, kind: str) -> F64:
    """Return east and north of the run's sites or candidates (`kind`), (N, 2) metres."""
    places = run.info["answer"][kind]
    return np.array([[s["east_m"], s["north_m"]] for s in places], dtype=np.float64).reshape(-1, 2)


def dilated(mask: NDArray[np.bool_], cells: float) -> NDArray[np.bool_]:
    """Dilate a mask by a radius in cells."""
    return np.asarray(distance_transform_edt(~mask) <= cells) if mask.any() else mask


def position_errors(run: Run, truth: Trajectory) -> tuple[F64, F64]:
    """Compute estimated minus true poses at equal times: positions (N, 3), metres, rotation vectors (N, 3), rad."""
    path = run.folder / "trajectory.tum"
    if run.local is None or not path.exists():
        return np.empty((0, 3)), np.empty((0, 3))
    at_true = {int(t): p for t, p in zip(*truth, strict=True)}
    own = [(p, at_true[int(t)]) for t, p in zip(*read_tum(path, run.local), strict=True) if int(t) in at_true]
    d = [a.translation - b.translation for a, b in own]
    r = [so3_log(a.rotation @ b.rotation.T) for a, b in own]
    return np.array(d).reshape(-1, 3), np.array(r).reshape(-1, 3)


def trajectory(d: F64, r: F64, out: Evaluation) -> None:
    """Add the statistics of position errors `d` (N, 3), m, and rotation errors `r` (N, 3), rad, to the evaluation."""
    out.put("position RMSE, m", rms(np.linalg.norm(d, axis=1)))
    out.put("position mean error (east, north, up), m", " ".join(f"{v:.3f}" for v in d.mean(0)))
    out.put("position RMSE less a constant, m", rms(np.linalg.norm(d - d.mean(0), axis=1)))
    out.put("attitude RMSE, deg", float(np.degrees(rms(np.linalg.norm(r, axis=1)))))
    out.put("mean tilt (about east, north), mrad", f"{1e3 * r.mean(0)[0]:.2f} {1e3 * r.mean(0)[1]:.2f}")


def against_flight(run: Run, folder: Path) -> Evaluation:
    """Compare a run with a flight that has truth, for the map as it is and after registration.

    Estimated poses carry the drift of the GPS. If the path is off by a metre, so is the map, and its heights are
    compared at wrong positions. In rows that end in `, registered`, the constant offset of the path (mean position
    error) is subtracted from map and sites. In rows that end in `, registered by its heights`, the offset that is
    estimated from the heights is subtracted instead.

    Raises:
        InputError: the flight has no truth, or is not the flight of the run.
    """
    out = Evaluation(f"{run.folder} against the truth of {folder}")
    flight = open_source(folder, Settings())
    if run.local is None:
        raise InputError(f"{run.folder}: the run has no place on Earth, so nothing can be compared with the truth")
    if np.abs(run.local.to_enu(flight.local.latitude, flight.local.longitude, flight.local.height)).max() > 1e-3:
        raise InputError(f"{folder}: another origin than that of the run; name the flight that was run")
    truth = read_flight_truth(folder, flight.local)
    if run.grid is not None and not np.isfinite(truth.grid.nearest_on(run.grid, truth.dem)).any():
        raise InputError(
            f"{folder / 'truth' / 'dem.tif'}: has no height on the run's map; name the flight that was run"
        )
    safe = truth.safe(run.settings.lander)
    out.put("heights of the truth", truth.settled)
    out.put("height above ground, m", float(run.info.get("height_above_ground_m") or np.nan))
    compared = _Comparison(run, truth, safe, out, np.zeros(3))
    compared.heights()
    for kind in ("sites", "candidates"):
        out.put(kind, float(len(places_of(run, kind))))
    compared.decision()
    if flight.truth_trajectory is not None:
        d, r = position_errors(run, flight.truth_trajectory)
        if len(d):
            trajectory(d, r, out)
            registered = replace(compared, offset=d.mean(0), suffix=", registered")
            registered.heights()
            registered.decision()
            offset = placed(run, truth, d.mean(0))
            out.put("offset of the map (east, north, up), m", " ".join(f"{v:.3f}" for v in offset))
            replace(compared, offset=offset, suffix=", registered by its heights").heights()
    return out
