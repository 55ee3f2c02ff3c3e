"""P(safe) as a product of three factors, each with evidence of its own (docs/method/p-safe.md, G7, G7b to G7e)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from alight.arrays import F32
from alight.hazards.detection import Detection, read_detection
from alight.hazards.evidence import (
    Discs,
    FootprintShape,
    ground_terms,
    near_terms,
    nearness,
    obstacle_terms,
    pictured,
    ridges,
    sampled,
    sampled_finely,
)
from alight.hazards.probability import TouchdownGeometry, kept, margins_over_sigma, safe_probability
from alight.learned import read_rate
from alight.learned.terms import GroundTerm, NearTerm
from alight.raster import log_at_least
from alight.records import ElevationMap, MissingVeto, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander

FOUND = 0.95  # probability with which an obstacle of `resolved` height would have been found
SETTLED = 0.3  # share of the doubt allowed by the least P(safe) that unseen obstacles may take
NEARER = 0.5  # of the present pixel: that of a closer look where the size of the pixel is not the doubt
FINEST = 1 / 40  # of the height of an obstacle: finer pixels show no more of it
LEAST = 1e-9  # keeps the logarithm of a rate, or of a probability, finite
DEVIATIONS = 0.33, 0.53, 0.67, 0.8, 1.17  # largest deviations of all measured heights, over the limit
EXPECTED = 0.0, 0.004, 0.017, 0.39, 0.78  # expected hazards from these alone (docs/lab/p-safe.md)
RIDGES = 0.9, 1.0, 1.1  # broad deviations over the limit
RIDGES_EXPECTED = 0.0, 0.39, 0.78  # expected hazards from these alone: they are as high as measured
SOFT = 0.0, 1.1, 1.39  # log odds against ground that bears: probabilities of 0.5, 0.25 and 0.2
SOFT_EXPECTED = 0.0, 0.2, 0.7  # expected hazards from these alone, near by
PATCH = -1.6, -1.0, 0.0  # the same of a patch that bears less than the ground about it: 0.83, 0.73 and 0.5
PATCH_EXPECTED = 0.0, 0.1, 0.3  # expected hazards from these alone, near by
UNLIKE = 1.2, 2.0  # log odds of a patch over those of the ground about it: none, and all of the above counts
RIDGE = 0.032, 0.04  # metres, relief of a straight ridge: natural ground has little more, a kerb of 0.1 m has 0.045
RIDGE_EXPECTED = 0.0, 0.7  # expected hazards from these alone, near by
BROAD_TO_NARROW = 0.5, 1.0  # log of the deviation over that of smoothed heights
PIXELS_A_SAMPLE = 2.0  # pixels that a sample of the match covers: cells are 1.8 pixels wide


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of P(safe) where image matching may have smoothed obstacles away."""

    tilt: F32  # (R, C) margin of the tilt to its limit, sigmas
    discs: Discs  # the cells of the terms
    obstacle: dict[str, F32]  # terms of `relief_rate` and `density_rate`
    hidden: F32  # share of the obstacles above the limit that the heights would not show
    unseen: F32  # share of them that neither heights nor pictures would show
    ground: dict[str, F32]  # terms of `ground_rate`
    near: dict[str, F32]  # terms of `near_obstacle_rate` and `near_ground_rate`
    nearness: F32  # 0 to 1: weight of these two
    sampled: F32  # 0 to 1: nearness by the heights alone
    ridge: F32  # metres of relief, the highest straight ridge


@dataclass(frozen=True, eq=False)
class SafetyFactors:
    """Factors of P(safe), and the resolution behind them, (R, C) each."""

    relief: F32
    obstacle: F32
    ground: F32
    resolved: F32  # metres, height of the smallest obstacle that would have been found with `FOUND`
    settles_at: F32  # metres, pixel on the ground that would settle the doubt; NaN: none


def evidence_of(
    elevation: ElevationMap, terrain: TerrainMap | None, tilt: F32, shape: FootprintShape, lander: Lander
) -> Evidence:
    """Gather the evidence; `tilt`: margin of the tilt in sigmas, (R, C)."""
    discs = Discs(elevation, lander.ground_reach)
    sampling, pixel = (discs.mean(discs.coarse(v)) for v in (sampled(elevation), pictured(elevation)))
    obstacle = obstacle_terms(elevation, shape, lander, discs, sampling, pixel)
    ground = ground_terms(elevation, terrain, discs)
    curves, nothing = read_detection(), np.full_like(pixel, np.nan)
    hidden, unseen = (curves.unseen_share(lander.tallest_obstacle, sampling, p) for p in (nothing, pixel))
    by = nearness(sampling, pixel, lander.tallest_obstacle)
    near = obstacle | ground | near_terms(elevation, shape, lander, discs, by)
    heights = sampled_finely(sampling, lander.tallest_obstacle)
    ridge = ridges(elevation, shape, discs, heights)
    return Evidence(tilt, discs, obstacle, hidden, unseen, ground, near, by, heights, ridge)


def factors_of(
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    margins: TouchdownGeometry,
    shape: FootprintShape,
    lander: Lander,
    settings: HazardsSettings,
    missing: MissingVeto,
) -> SafetyFactors:
    """Factors from the margins alone, or from all evidence where image matching may have smoothed obstacles away."""
    cell = elevation.grid.cell
    found = margins_over_sigma(margins, lander, settings, cell)
    tilt, vehicle = found.tilt, found.of_the_vehicle
    if not settings.smoothed:
        p = safe_probability(found, margins.footprint.unknown, settings)
        obstacle, never = _beyond_cells(elevation, terrain, lander, settings), np.full_like(tilt, np.nan)
        return SafetyFactors(p, obstacle, np.ones_like(tilt), np.full_like(tilt, cell), never)
    del found  # the deviation is among the evidence
    obstacle, ground = _chances(elevation, terrain, tilt, shape, lander, settings, missing)
    relief, least = kept(vehicle), np.minimum.reduce(vehicle)
    sampling, pixel, curves = sampled(elevation), pictured(elevation), read_detection()
    enough = pixel_that_settles(curves, lander, settings)
    settles_at = _settles_at((relief, obstacle, ground), least, pixel, enough, lander, settings)
    return SafetyFactors(relief, obstacle, ground, curves.smallest_found(FOUND, sampling, pixel), settles_at)


def _beyond_cells(
    elevation: ElevationMap, terrain: TerrainMap | None, lander: Lander, settings: HazardsSettings
) -> F32:
    """(R, C) probability that the footprint has no obstacle that cells of surveyed heights are too wide to show (G7j).

    The mean height of a wide cell flattens what stands in it. The share of half balls above the limit that cells do not
    show as such is within 0.1 of that taken here (docs/lab/p-safe.md).
    """
    cell, fine = elevation.grid.cell, lander.judging_cell
    if cell <= fine:
        return np.ones(elevation.grid.shape, np.float32)
    discs, hidden = Discs(elevation, lander.ground_reach), 1 - fine / cell
    usual = _density(terrain, elevation.grid.shape, discs, settings)
    return discs.fine(np.exp(np.float32(-hidden * math.pi * lander.ground_reach**2) * usual))


def _chances(
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    tilt: F32,
    shape: FootprintShape,
    lander: Lander,
    settings: HazardsSettings,
    missing: MissingVeto,
) -> tuple[F32, F32]:
    """(R, C) probabilities that no unseen obstacle lies in the footprint, and that the ground bears and is dry."""
    found = evidence_of(elevation, terrain, tilt, shape, lander)
    area = np.float32(math.pi * lander.ground_reach**2)
    usual = area * _density(terrain, elevation.grid.shape, found.discs, settings)
    shown, about = (np.exp(read_rate(k).log_rate(found.obstacle)) for k in ("relief_rate", "density_rate"))
    afar = shown + np.maximum(found.hidden * about, found.unseen * usual)
    wet = np.exp(read_rate("ground_rate").log_rate(found.ground))
    expected, wet = (_blended(v, f"near_{k}_rate", found) for k, v in (("obstacle", afar), ("ground", wet)))
    expected, wet = with_floors(expected, wet, found.near, found.nearness, found.sampled)
    expected = expected + found.nearness * found.unseen * usual
    wet = np.maximum(wet, found.sampled * ridge_hazards(found.ridge))
    wet = wet + _unlike_dry_ground(terrain, found.discs, settings)
    wet = wet + np.float32(_unrefused(terrain, missing, settings))
    obstacle, ground = (found.discs.fine(np.exp(-number)) for number in (expected, wet))
    return obstacle, ground


def _blended(afar: F32, name: str, found: Evidence) -> F32:
    """Expected hazards from a rate from afar and one from near by, the logarithms weighted by the nearness (G7f)."""
    near = read_rate(name).log_rate(found.near)
    log = (1 - found.nearness) * log_at_least(afar, LEAST) + found.nearness * near
    return np.asarray(np.exp(log), np.float32)


def with_floors(
    obstacle: F32, ground: F32, near: Mapping[str, F32], by: F32 | float = 1.0, by_heights: F32 | float = 1.0
) -> tuple[F32, F32]:
    """Expected hazards of both factors, each at least what one kind of evidence alone lets expect (G7g, G7h).

    Args:
        obstacle, ground: expected hazards, of any one shape.
        near: terms of a near look.
        by, by_heights: nearness; and by the heights alone.
    """
    deviation, soft = by_heights * deviation_hazards(near), by * soft_ground_hazards(near)
    return np.maximum(obstacle, deviation), np.maximum(ground, soft)


def deviation_hazards(near: Mapping[str, F32]) -> F32:
    """Expected hazards from the largest deviation of all measured heights alone, by the terms of a near look (G7g).

    A narrow one may be a stone that matching has flattened, and counts from half of the limit. A broad ridge or rim is
    as high as measured, and counts at the limit.

    The fit also uses the shadow of an obstacle. Where the sky is grey, or the sun high, there is none.
    """
    stone = np.interp(near[NearTerm.RISE], np.log(DEVIATIONS), EXPECTED)
    ridge = np.interp(near[NearTerm.RISE], np.log(RIDGES), RIDGES_EXPECTED)
    narrow = np.interp(near[NearTerm.NARROW], BROAD_TO_NARROW, (0.0, 1.0))
    return np.asarray(narrow * stone + (1 - narrow) * ridge, np.float32)


def soft_ground_hazards(ground: Mapping[str, F32]) -> F32:
    """Expected hazards from the 0.2 m of a footprint that bear least probably, alone, by its terms (G7h).

    Near by, the fit relies on heights: where they are even, ground mostly bears. Tops of tall plants are even too, and
    so are puddles: a patch that bears less than the ground about it counts sooner than ground that is alike all over.
    """
    worst = ground[GroundTerm.WORST_SMOOTH]
    about = np.minimum(ground[GroundTerm.MEAN], ground[GroundTerm.MEAN_BEYOND])
    unlike = np.interp(worst - about, UNLIKE, (0.0, 1.0))
    patch = unlike * np.interp(worst, PATCH, PATCH_EXPECTED)
    return np.asarray(np.maximum(patch, np.interp(worst, SOFT, SOFT_EXPECTED)), np.float32)


def ridge_hazards(ridge: F32) -> F32:
    """Expected hazards from the highest straight ridge of a footprint alone, metres of relief (G7i).

    A kerb, a wall or a pipe is a structure, however low it is.
    """
    return np.asarray(np.interp(ridge, RIDGE, RIDGE_EXPECTED), np.float32)


def _unrefused(terrain: TerrainMap | None, missing: MissingVeto, settings: HazardsSettings) -> float:
    """Hazards expected of every footprint because a veto is missing."""
    grey = settings.grey_hazard if terrain is not None and not terrain.coloured else 0.0
    alone = settings.one_camera_hazard if MissingVeto.SECOND_CAMERA in missing else 0.0
    return grey + alone + (settings.no_attitude_hazard if MissingVeto.ATTITUDE in missing else 0.0)


def _density(terrain: TerrainMap | None, shape: tuple[int, int], discs: Discs, settings: HazardsSettings) -> F32:
    """Prior density of obstacles on the kind of ground, 1/m^2, before anything was seen of them."""
    usual = {
        Terrain.BARE: settings.unseen_bare, Terrain.SHORT_GRASS: settings.unseen_grass,
        Terrain.PAVED: settings.unseen_paved,
    }  # fmt: skip
    out = np.full(shape, settings.unseen_unknown, np.float32)
    if terrain is not None:
        for kind, density in usual.items():
            out = np.where(terrain.label == kind, np.float32(density), out)
    return discs.mean(discs.coarse(out))


def _unlike_dry_ground(terrain: TerrainMap | None, discs: Discs, settings: HazardsSettings) -> F32:
    """Expected hazards from level surfaces below their banks, and from ground unlike all known ground."""
    if terrain is None or terrain.enclosed is None or terrain.novelty is None:
        return np.zeros(discs.grid.shape, np.float32)
    shut = discs.worst(discs.largest(terrain.enclosed))
    strange = discs.mean(discs.coarse(np.maximum(terrain.novelty - 1, 0)))
    added = np.float32(settings.enclosed_hazard) * shut + np.float32(settings.novel_hazard) * np.nan_to_num(strange)
    return np.asarray(added, np.float32)


def pixel_that_settles(curves: Detection, lander: Lander, settings: HazardsSettings) -> float:
    """The largest pixel, metres, with which bare ground that shows no obstacle is sure enough for a site."""
    pixels = np.geomspace(FINEST, 2.0, 60) * lander.tallest_obstacle
    at = [np.asarray(k * pixels, np.float32) for k in (PIXELS_A_SAMPLE, 1.0)]
    unseen = curves.unseen_share(lander.tallest_obstacle, *at)
    expected = math.pi * lander.ground_reach**2 * settings.unseen_bare * unseen
    good = np.flatnonzero(expected <= -SETTLED * math.log(max(settings.p_safe, LEAST)))
    return float(pixels[good[-1]]) if good.size else float(pixels[0])


def _settles_at(
    factors: tuple[F32, F32, F32], least: F32, pixel: F32, shows: float, lander: Lander, settings: HazardsSettings
) -> F32:
    """Pixel that would settle the doubt of the smallest factor, metres; NaN where a closer look would not help.

    An obstacle: the pixel that `shows` it, or half of the present one where that is fine enough already. Relief, by its
    `least` margin, sigmas: sigma shrinks with the pixel. Ground: half of the present one.
    """
    (relief, obstacle, ground), fine = factors, np.float32(shows)
    half = np.float32(NEARER) * pixel
    closer = np.where(pixel > fine, np.minimum(fine, pixel), half)
    enough = np.float32(ndtri(1 - SETTLED * (1 - settings.p_safe)))
    flatter = pixel * (least / enough).clip(0, 1)
    out = np.where(relief < np.minimum(obstacle, ground), np.minimum(flatter, half), closer)
    out = np.where(ground < np.minimum(obstacle, relief), np.minimum(half, fine), out)
    return np.where(out >= np.float32(FINEST * lander.tallest_obstacle), out, np.float32(np.nan)).astype(np.float32)
