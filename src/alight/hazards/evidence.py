"""Evidence against a footprint: features that increase where it is less likely safe (docs/method/p-safe.md, G7b).

Lengths are divided by the height of the tallest obstacle that the lander tolerates. A fit for one lander, one camera
and one height above ground is therefore valid for others: it depends on visibility, not on metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import logit

from alight.arrays import F32
from alight.geometry import Grid
from alight.hazards.detection import read_detection
from alight.hazards.ridges import straight_ridges
from alight.hazards.touchdown import Inputs, Touchdowns
from alight.learned.terms import DensityTerm, FloorTerm, GroundTerm, NearTerm, ReliefTerm
from alight.raster import (
    BlockGreen,
    BlockLight,
    block_green,
    block_light,
    block_max,
    block_mean,
    difference_of_gaussians,
    disc_max,
    disc_mean,
    filled_surface,
    gaussian_mean,
    log_at_least,
    whole_blocks,
)
from alight.records import ElevationMap, TerrainMap

BEYOND = 1.0  # metres beyond the rim that are included, as tufts come in groups
SPOTS = 0.45, 2.3  # 1-sigma of the two Gaussians for picture spots, in heights of an obstacle twice as wide as high
GREY = 0.02  # excess green assumed for the greenest spot of a grey picture: ground with a few plants
BAND = 0.4, 2.7  # 1-sigma of the two Gaussians for relief, in heights of the obstacle
NEAR_SAMPLES = 0.5, 0.9  # width of a match sample over the obstacle's height: for nearness 1 and 0
NEAR_PIXELS = 0.3, 0.5  # width of a pixel over the obstacle's height: for nearness 1 and 0
COARSER = 2  # side of a coarse cell, cells: the features vary only over a footprint


class Discs:
    """Means and maxima over the footprint and around it, on cells of twice the map's size; `radius` in metres."""

    def __init__(self, grid: Grid, radius: float) -> None:
        self._shape, self._cell, self._radius = grid.shape, grid.cell * COARSER, radius
        self._inner = radius - min(0.25, radius / 4)  # an object this close to the rim may lie outside
        self.grid = grid.coarser(COARSER)

    def coarse(self, values: F32) -> F32:
        """Average values (R, C) over the coarse cells."""
        return block_mean(whole_blocks(values, COARSER), COARSER)

    def largest(self, values: F32) -> F32:
        """Return the maxima of values (R, C) over the coarse cells."""
        return block_max(whole_blocks(values, COARSER), COARSER)

    def worst(self, coarse: F32, beyond: float | None = None) -> F32:
        """Return the largest value in the footprint without its rim, or, if given, up to `beyond` metres outside it."""
        return disc_max(coarse, self._inner if beyond is None else self._radius + beyond, self._cell)

    def mean(self, coarse: F32, beyond: float = 0.0) -> F32:
        """Return the mean over the footprint and `beyond` metres around it."""
        return disc_mean(coarse, self._radius + beyond, self._cell)

    def around(self, coarse: F32) -> F32:
        """Return the Gaussian mean with a 1-sigma of 4 m around every cell, as obstacles come in groups."""
        return gaussian_mean(coarse, 4.0 / self._cell)

    def fine(self, coarse: F32) -> F32:
        """Resample coarse cells to the cells of the map, (R, C)."""
        rows, cols = self._shape
        size = (coarse.shape[1] * COARSER, coarse.shape[0] * COARSER)
        return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)[:rows, :cols], np.float32)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of P(safe) if image matching may have smoothed obstacles away, on the grid of `discs`."""

    discs: Discs
    terms: dict[str, F32]  # features of the rates and floors, by identifier (`alight.learned.terms`)
    hidden: F32  # share of obstacles above the limit that heights would not show
    unseen: F32  # share of these obstacles that neither heights nor pictures would show
    near: F32  # nearness of the view, 0 (far) to 1 (near)
    near_by_heights: F32  # nearness by the heights only, 0 to 1


def evidence_of(t: Touchdowns, on: Inputs) -> Evidence:
    """Compute the evidence of P(safe) from the measured touchdowns."""
    e, limit, discs = on.elevation, on.lander.tallest_obstacle, Discs(on.elevation.grid, on.lander.ground_reach)
    sampling, pixel = (discs.mean(discs.coarse(widths(v, on.cell))) for v in (e.sampling, e.picture_sampling))
    curves, nothing = read_detection(), np.full_like(pixel, np.nan)
    hidden, unseen = (curves.unseen_share(limit, sampling, p) for p in (nothing, pixel))
    by_heights = _fineness(sampling, limit, NEAR_SAMPLES)
    near = nearness(sampling, pixel, limit)
    terms = _relief_terms(t, on, discs) | _picture_terms(e, limit, discs) | _near_terms(t, on, discs)
    terms |= {ReliefTerm.SAMPLING: np.log(sampling / np.float32(limit))}
    terms |= {DensityTerm.PIXEL: np.log(pixel / np.float32(limit))}
    terms |= ground_terms(e, on.land_cover, discs)
    green = ridge = np.zeros_like(near)
    if (near > 0).any():
        green = discs.worst(discs.largest(green_spots(e, limit)), beyond=0.0)
    if (by_heights > 0).any():
        ridge = discs.worst(discs.largest(straight_ridges(t.measured, on.cell)), beyond=0.0)
    terms |= {NearTerm.GREEN: green, FloorTerm.RIDGE: ridge, FloorTerm.UNLIKE: unlike_ground(terms)}
    return Evidence(discs, terms, hidden, unseen, near, by_heights)


def widths(metres: F32, cell: float) -> F32:
    """Replace unknown widths (NaN) of samples or pixels on the ground, (R, C) metres, by ten cells."""
    return np.asarray(np.nan_to_num(metres, nan=10.0 * cell), np.float32)


def nearness(sampling: F32, pixel: F32, limit: float) -> F32:
    """Compute nearness, 0 (far) to 1 (near), from widths of samples and pixels and obstacle height `limit`; metres."""
    return np.minimum(_fineness(sampling, limit, NEAR_SAMPLES), _fineness(pixel, limit, NEAR_PIXELS))


def _fineness(width: F32, limit: float, between: tuple[float, float]) -> F32:
    """Return 1 where width / limit is at most `between[0]`, 0 where at least `between[1]`, log-linear in between."""
    near, far = between
    return np.asarray((np.log(far * limit / width) / np.log(far / near)).clip(0, 1), np.float32)


def power_of_bumps(height: F32, cell: float, limit: float) -> F32:
    """Compute the mean square of relief as wide as an obstacle of height `limit`, (R, C), divided by limit^2.

    `height`: heights without NaN. All lengths are in metres.
    """
    bumps = difference_of_gaussians(height / np.float32(limit), *(s * limit / cell for s in BAND))
    return patch_mean(bumps * bumps, cell, limit)


def patch_mean(power: F32, cell: float, limit: float) -> F32:
    """Compute the Gaussian mean, (R, C), with a 1-sigma of 1.5 times the obstacle height `limit`; lengths in metres."""
    return gaussian_mean(power, 1.5 * limit / cell)


def _log_rms(power: F32, floor: float) -> F32:
    return log_at_least(np.sqrt(np.maximum(power, 0)), floor)


def _relief_terms(t: Touchdowns, on: Inputs, discs: Discs) -> dict[str, F32]:
    e, limit = on.elevation, on.lander.tallest_obstacle
    relief = discs.coarse(power_of_bumps(filled_surface(e.height), on.cell, limit))
    residual = np.nan_to_num(e.residual)
    deviations = {
        ReliefTerm.ROUGHNESS: t.footprint.roughness,
        ReliefTerm.ROUGHNESS_SMOOTH: t.smooth_roughness,
        ReliefTerm.ROUGHNESS_TREND: t.trend_roughness,
    }
    sigma = discs.coarse(np.nan_to_num(e.sigma, nan=1.0)) / np.float32(limit)
    return {k.value: discs.largest(log_at_least(v / np.float32(limit), 0.03)) for k, v in deviations.items()} | {
        ReliefTerm.RELIEF_WORST: _log_rms(discs.worst(relief), 0.02),
        ReliefTerm.RELIEF_MEAN: _log_rms(discs.mean(relief), 0.02),
        ReliefTerm.SIGMA: log_at_least(discs.mean(sigma), 0.02),
        ReliefTerm.RESIDUAL_MEAN: discs.mean(discs.coarse(residual)),
        ReliefTerm.RESIDUAL_WORST: discs.worst(discs.coarse(gaussian_mean(residual, 0.15 / on.cell))),
        ReliefTerm.UNKNOWN: discs.largest(t.footprint.unknown),
    }


def _picture_terms(elevation: ElevationMap, limit: float, discs: Discs) -> dict[str, F32]:
    spots = picture_spots(elevation, limit)
    spot = discs.coarse(patch_mean(spots.power, elevation.grid.cell, limit))
    return {
        DensityTerm.SPOT_WORST: _log_rms(discs.worst(spot), 0.005),
        DensityTerm.SPOT_MEAN: _log_rms(discs.mean(spot), 0.005),
        DensityTerm.SPOT_AROUND: _log_rms(discs.around(spot), 0.005),
        DensityTerm.DARK: discs.worst(discs.largest(spots.dark)),
        DensityTerm.BRIGHT: discs.worst(discs.largest(spots.bright)),
    }


def _near_terms(t: Touchdowns, on: Inputs, discs: Discs) -> dict[str, F32]:
    limit = on.lander.tallest_obstacle
    measured = np.nan_to_num(t.measured_roughness, nan=60.0 * limit)  # for a footprint without heights
    rise, smooth = (log_at_least(v / np.float32(limit), 0.03) for v in (measured, t.smooth_roughness))
    return {
        NearTerm.RISE: discs.largest(rise),
        NearTerm.RISE_UNKNOWN: discs.largest(t.unmeasured),
        NearTerm.NARROW: discs.largest(rise - np.nan_to_num(smooth)),
    }


def ground_odds(land_cover: TerrainMap | None, shape: tuple[int, int]) -> F32:
    """Compute the log odds, (R, C), that the ground is not firm and dry.

    Rock is treated as firm, as stones are judged as obstacles. Cells without a class are treated as firm and dry.
    """
    if land_cover is None:
        return np.full(shape, -9.2, np.float32)
    known = np.where(np.isfinite(land_cover.bears), land_cover.bears, np.float32(1))
    return np.asarray(-logit(known.clip(1e-4, 1 - 1e-4)), np.float32)


def ground_terms(elevation: ElevationMap, land_cover: TerrainMap | None, discs: Discs) -> dict[str, F32]:
    """Compute the features that contradict firm, dry ground, by identifier, on the grid of `discs`."""
    odds = ground_odds(land_cover, elevation.grid.shape)
    smooth = discs.coarse(gaussian_mean(odds, 0.2 / elevation.grid.cell))
    mean = discs.coarse(odds)
    novelty = enclosed = np.zeros_like(odds)
    if land_cover is not None:
        novelty, enclosed = (np.nan_to_num(sign) for sign in (land_cover.novelty, land_cover.enclosed))
    return {
        GroundTerm.WORST: discs.worst(discs.largest(odds)),
        GroundTerm.WORST_SMOOTH: discs.worst(smooth),
        GroundTerm.MEAN: discs.mean(mean),
        GroundTerm.WORST_BEYOND: discs.worst(smooth, BEYOND),
        GroundTerm.MEAN_BEYOND: discs.mean(mean, 3 * BEYOND),
        GroundTerm.AROUND: discs.around(mean),
        GroundTerm.NOVELTY: discs.mean(discs.coarse(log_at_least(novelty, 0.05))),
        GroundTerm.ENCLOSED: discs.worst(discs.largest(enclosed)),
    }


def unlike_ground(terms: Mapping[str, F32]) -> F32:
    """Return how much softer the softest patch of 0.2 m in a footprint is than its surroundings, in log odds."""
    about = np.minimum(terms[GroundTerm.MEAN], terms[GroundTerm.MEAN_BEYOND])
    return np.asarray(terms[GroundTerm.WORST_SMOOTH] - about)


class PictureSpots(NamedTuple):
    """Contrast of spots with their surroundings, in natural logarithms of brightness, (R, C) arrays."""

    power: F32  # mean square contrast in the cell
    dark: F32  # contrast of the darkest pixel, positive
    bright: F32  # contrast of the brightest pixel


def picture_spots(elevation: ElevationMap, height: float) -> PictureSpots:
    """Compute the contrast of picture spots as wide as an obstacle of `height` metres; 0 where unseen."""
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    spot = _seen_spots(block_light(rgb, factor // halves), height * halves / elevation.grid.cell)
    return PictureSpots(block_mean(spot * spot, halves), block_max(-spot, halves), block_max(spot, halves))


def green_spots(elevation: ElevationMap, height: float) -> F32:
    """Compute the excess green of each cell's greenest spot relative to its surroundings, (R, C); see `BlockGreen`.

    Spots are as wide as an obstacle of `height` metres. A green spot on bare ground is a plant, even if matching has
    flattened it.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    green = block_green(rgb, factor // halves)
    if not green.coloured:
        return np.full(elevation.grid.shape, GREY, np.float32)
    return block_max(_seen_spots(green, height * halves / elevation.grid.cell), halves)


def _seen_spots(found: BlockLight | BlockGreen, height: float) -> F32:
    """Compute the contrast of spots as wide as an obstacle of `height` pixels; 0 where unseen. Overwrites `found`."""
    measure, seen = found.mean, found.seen > 0.999
    del found  # pictures have tens of megapixels
    if not seen.all():  # unseen pixels are filled with the mean around them
        measure *= seen
        share = gaussian_mean(seen.astype(np.float32), SPOTS[1] * height)
        np.maximum(share, np.float32(1e-3), out=share)
        around = gaussian_mean(measure, SPOTS[1] * height)
        np.copyto(measure, np.divide(around, share, out=around), where=~seen)
        del share, around
    out = difference_of_gaussians(measure, *(s * height for s in SPOTS))
    out *= seen
    return out
