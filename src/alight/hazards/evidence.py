"""Evidence against a footprint: terms that are larger where it is less likely safe (docs/method/p-safe.md, G7b).

Lengths are in units of the height that the lander just stands. So a fit with one lander, one camera and one height
above ground is valid for others: it depends on visibility, not on metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import logit

from alight.arrays import F32
from alight.hazards.contact import Footprint
from alight.hazards.picture_spots import green_spots, picture_spots
from alight.hazards.ridges import straight_ridges
from alight.learned.terms import DensityTerm, GroundTerm, NearTerm, ReliefTerm
from alight.raster import (
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
from alight.settings import Lander

RIM = 0.25  # metres; an object this near to the rim may as well lie outside
BEYOND = 1.0  # metres past the rim that count: where tufts begin, there are more
AROUND = 4.0  # metres, 1-sigma of the surroundings: ground with obstacles has more of them
NARROW, WIDE = 0.4, 2.7  # heights of the obstacle, 1-sigma of the Gaussians between which its relief lies
PATCH = 1.5  # heights of the obstacle, 1-sigma over which relief and spots are gathered
UNMEASURED = 60.0  # limits of roughness: roughness of a footprint without heights
NEAR_SAMPLING, FAR_SAMPLING = 0.5, 0.9  # limits, ground that a sample covers: fully near by, not near by at all
NEAR_PIXEL, FAR_PIXEL = 0.3, 0.5  # limits, ground that a pixel covers: likewise
UNMATCHED = 10.0  # cells: width of a sample where nothing was matched
COARSER = 2  # cells a side that are taken as one: the terms vary over a footprint
MIN_PROBABILITY = 1e-4  # keeps log odds finite
CERTAIN = np.float32(9.2)  # log odds of landable ground where no land cover was given


@dataclass(frozen=True, eq=False)
class FootprintShape:
    """Geometry of every footprint, (R, C) each."""

    footprint: Footprint
    roughness_smooth: F32  # metres, largest deviation of heights smoothed by 0.2 m
    roughness_trend: F32  # metres, of heights smoothed by 0.45 m
    measured_roughness: F32  # metres, of all heights that were measured well, doubtful ones as well
    measured: F32  # metres, all heights that were measured well, of the cells
    unmeasured: F32  # share of the footprint without any such height


class Discs:
    """Statistics over the footprint and beyond, on cells of twice the size."""

    def __init__(self, elevation: ElevationMap, radius: float) -> None:
        self._shape, self._cell, self._radius = elevation.grid.shape, elevation.grid.cell * COARSER, radius
        self._inner = radius - min(RIM, radius / 4)
        self.grid = elevation.grid.coarser(COARSER)

    def coarse(self, values: F32) -> F32:
        """Means of the coarse cells."""
        return block_mean(whole_blocks(values, COARSER), COARSER)

    def largest(self, values: F32) -> F32:
        """Maxima of the coarse cells."""
        return block_max(whole_blocks(values, COARSER), COARSER)

    def worst(self, coarse: F32, beyond: float | None = None) -> F32:
        """Largest value of the footprint less its rim, or of the footprint and `beyond` metres about it."""
        return disc_max(coarse, self._inner if beyond is None else self._radius + beyond, self._cell)

    def mean(self, coarse: F32, beyond: float = 0.0) -> F32:
        """Mean over the footprint and `beyond` metres about it."""
        return disc_mean(coarse, self._radius + beyond, self._cell)

    def around(self, coarse: F32) -> F32:
        """Mean of the surroundings."""
        return gaussian_mean(coarse, AROUND / self._cell)

    def fine(self, coarse: F32) -> F32:
        """Resample coarse cells to the cells of the map, (R, C)."""
        rows, cols = self._shape
        size = (coarse.shape[1] * COARSER, coarse.shape[0] * COARSER)
        return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)[:rows, :cols], np.float32)


def relief_power(elevation: ElevationMap, limit: float) -> F32:
    """Mean square relief as wide as an obstacle of height `limit` (metres), over that height, (R, C)."""
    return power_of_bumps(filled_surface(elevation.height), elevation.grid.cell, limit)


def power_of_bumps(height: F32, cell: float, limit: float) -> F32:
    """Mean square relief of any surface, (R, C) metres, all known, as wide as an obstacle of `limit` metres."""
    bumps = difference_of_gaussians(height / np.float32(limit), NARROW * limit / cell, WIDE * limit / cell)
    return patch_mean(bumps * bumps, cell, limit)


def patch_mean(power: F32, cell: float, limit: float) -> F32:
    """Mean over the area that an obstacle of height `limit` (metres) covers, (R, C)."""
    return gaussian_mean(power, PATCH * limit / cell)


def _log_rms(power: F32, floor: float) -> F32:
    return log_at_least(np.sqrt(np.maximum(power, 0)), floor)


def obstacle_terms(
    elevation: ElevationMap, shape: FootprintShape, lander: Lander, discs: Discs, sampling: F32, pixel: F32
) -> dict[str, F32]:
    """Evidence against an even footprint, and of obstacles nearby, on the cells of `discs`.

    `sampling` and `pixel`: metres, means over the footprint.
    """
    cell, limit = elevation.grid.cell, lander.tallest_obstacle
    relief = discs.coarse(relief_power(elevation, limit))
    spots = picture_spots(elevation, limit)
    spot = discs.coarse(patch_mean(spots.power, cell, limit))
    residual = np.nan_to_num(elevation.residual)
    deviations = {
        ReliefTerm.ROUGHNESS: shape.footprint.roughness,
        ReliefTerm.ROUGHNESS_SMOOTH: shape.roughness_smooth,
        ReliefTerm.ROUGHNESS_TREND: shape.roughness_trend,
    }
    sigma = discs.coarse(np.nan_to_num(elevation.sigma, nan=1.0)) / np.float32(limit)
    return {k.value: discs.largest(log_at_least(v / np.float32(limit), 0.03)) for k, v in deviations.items()} | {
        ReliefTerm.RELIEF_WORST: _log_rms(discs.worst(relief), 0.02),
        ReliefTerm.RELIEF_MEAN: _log_rms(discs.mean(relief), 0.02),
        ReliefTerm.SAMPLING: np.log(sampling / np.float32(limit)),
        ReliefTerm.SIGMA: log_at_least(discs.mean(sigma), 0.02),
        ReliefTerm.RESIDUAL_MEAN: discs.mean(discs.coarse(residual)),
        ReliefTerm.RESIDUAL_WORST: discs.worst(discs.coarse(gaussian_mean(residual, 0.15 / cell))),
        ReliefTerm.UNKNOWN: discs.largest(shape.footprint.unknown),
        DensityTerm.SPOT_WORST: _log_rms(discs.worst(spot), 0.005),
        DensityTerm.SPOT_MEAN: _log_rms(discs.mean(spot), 0.005),
        DensityTerm.SPOT_AROUND: _log_rms(discs.around(spot), 0.005),
        DensityTerm.DARK: discs.worst(discs.largest(spots.dark)),
        DensityTerm.BRIGHT: discs.worst(discs.largest(spots.bright)),
        DensityTerm.PIXEL: np.log(pixel / np.float32(limit)),
    }


def near_terms(elevation: ElevationMap, shape: FootprintShape, lander: Lander, discs: Discs, by: F32) -> dict[str, F32]:
    """Evidence against a footprint that was seen from near by, on the cells of `discs`: all heights, and green spots.

    `by`: the nearness; where it is 0 all over, green spots are not looked for.
    """
    limit = lander.tallest_obstacle
    measured = np.nan_to_num(shape.measured_roughness, nan=UNMEASURED * limit)
    rise, smooth = (log_at_least(v / np.float32(limit), 0.03) for v in (measured, shape.roughness_smooth))
    green = np.zeros_like(by)
    if (by > 0).any():
        green = discs.worst(discs.largest(green_spots(elevation, limit)), beyond=0.0)
    return {
        NearTerm.RISE: discs.largest(rise),
        NearTerm.RISE_UNKNOWN: discs.largest(shape.unmeasured),
        NearTerm.NARROW: discs.largest(rise - np.nan_to_num(smooth)),
        NearTerm.GREEN: green,
    }


def ridges(elevation: ElevationMap, shape: FootprintShape, discs: Discs, by: F32) -> F32:
    """The highest straight ridge in a footprint, metres of relief, on the cells of `discs`.

    `by`: nearness by the heights; where it is 0 all over, ridges are not looked for.
    """
    if not (by > 0).any():
        return np.zeros_like(by)
    return discs.worst(discs.largest(straight_ridges(shape.measured, elevation.grid.cell)), beyond=0.0)


def nearness(sampling: F32, pixel: F32, limit: float) -> F32:
    """Degree to which a footprint was seen from near by, 0 to 1: by its samples and its pixels, both over the limit."""
    return np.minimum(sampled_finely(sampling, limit), _fineness(pixel, limit, NEAR_PIXEL, FAR_PIXEL))


def sampled_finely(sampling: F32, limit: float) -> F32:
    """Degree to which heights show an obstacle as high as the limit (metres), 0 to 1, whatever the pictures show."""
    return _fineness(sampling, limit, NEAR_SAMPLING, FAR_SAMPLING)


def _fineness(width: F32, limit: float, near: float, far: float) -> F32:
    """From 1 at a width of `near` limits to 0 at `far` limits, by its logarithm."""
    return np.asarray((np.log(far * limit / width) / np.log(far / near)).clip(0, 1), np.float32)


def sampled(elevation: ElevationMap) -> F32:
    """Metres of ground that a sample of the match covers, (R, C); where nothing was matched, several cells."""
    return np.asarray(np.nan_to_num(elevation.sampling, nan=UNMATCHED * elevation.grid.cell), np.float32)


def pictured(elevation: ElevationMap) -> F32:
    """Metres of ground that a pixel of the picture covers, (R, C); where nothing was pictured, several cells."""
    return np.asarray(np.nan_to_num(elevation.picture_sampling, nan=UNMATCHED * elevation.grid.cell), np.float32)


def ground_odds(land_cover: TerrainMap | None, shape: tuple[int, int]) -> F32:
    """Log odds (R, C) against ground that bears and is dry, rock counted as such: stones are obstacles.

    A cell without a class counts as landable. Where nothing is known of rock, landable ground alone counts.
    """
    if land_cover is None:
        return np.full(shape, -CERTAIN, np.float32)
    bears = land_cover.landable if land_cover.bears is None else land_cover.bears
    known = np.where(np.isfinite(bears), bears, np.float32(1))
    return np.asarray(-logit(known.clip(MIN_PROBABILITY, 1 - MIN_PROBABILITY)), np.float32)


def ground_terms(elevation: ElevationMap, land_cover: TerrainMap | None, discs: Discs) -> dict[str, F32]:
    """Evidence against ground that bears and is dry, on the cells of `discs`."""
    odds = ground_odds(land_cover, elevation.grid.shape)
    smooth = discs.coarse(gaussian_mean(odds, 0.2 / elevation.grid.cell))
    mean = discs.coarse(odds)
    return {
        GroundTerm.WORST: discs.worst(discs.largest(odds)),
        GroundTerm.WORST_SMOOTH: discs.worst(smooth),
        GroundTerm.MEAN: discs.mean(mean),
        GroundTerm.WORST_BEYOND: discs.worst(smooth, BEYOND),
        GroundTerm.MEAN_BEYOND: discs.mean(mean, 3 * BEYOND),
        GroundTerm.AROUND: discs.around(mean),
        GroundTerm.NOVELTY: discs.mean(discs.coarse(log_at_least(_or_nothing(land_cover, "novelty", odds), 0.05))),
        GroundTerm.ENCLOSED: discs.worst(discs.largest(_or_nothing(land_cover, "enclosed", odds))),
    }


def _or_nothing(land_cover: TerrainMap | None, field: str, like: F32) -> F32:
    """A field of the land cover, 0 where there is none."""
    found = None if land_cover is None else getattr(land_cover, field)
    return np.zeros_like(like) if found is None else np.nan_to_num(found)
