"""P(safe) as a product of three factors with separate evidence (docs/method/p-safe.md, G7 to G9).

The relief factor is computed from the margins of a touchdown to its limits, in sigmas, for normal errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.special import ndtr, ndtri

from alight.arrays import F32
from alight.hazards.detection import Detection, read_detection
from alight.hazards.evidence import Discs, Evidence, evidence_of, ground_terms, widths
from alight.hazards.touchdown import Inputs, Touchdowns
from alight.learned import read_floors, read_rate
from alight.learned.terms import GroundTerm
from alight.raster import log_at_least
from alight.records import MissingVeto, Terrain
from alight.settings import HazardsSettings, Lander

FOUND = 0.95  # probability that an obstacle of height `resolved` would have been found
SETTLED = 0.3  # share of the allowed doubt, 1 - least P(safe), that unseen obstacles may cause
FINEST = 1 / 40  # finest useful pixel over the height of an obstacle
PIXELS_A_SAMPLE = 2.0  # width of a match sample in pixels; cells are 1.8 pixels wide


@dataclass(frozen=True, eq=False)
class SafetyFactors:
    """Factors of P(safe) and the resolution behind them, (R, C) arrays."""

    relief: F32
    obstacle: F32
    ground: F32  # without a land cover: of the evidence that heights and pictures give
    resolved: F32  # metres, height of the smallest obstacle found with probability `FOUND`
    settles_at: F32  # metres, width of a pixel on the ground that would settle the doubt; NaN: no width would


def factors_of(t: Touchdowns, on: Inputs, missing: MissingVeto) -> SafetyFactors:
    """Compute the factors from all evidence if matching may have smoothed obstacles away, else from the margins."""
    margins = margins_over_sigma(t, on)
    if on.settings.smoothed:
        return _of_matched_heights(t, margins, on, missing)
    hidden = np.float32(on.settings.hidden_hazard) * t.footprint.unknown
    relief = kept(margins) * (1 - hidden)
    ground, never = np.ones_like(relief), np.full_like(relief, np.nan)
    if on.land_cover is not None:
        discs = Discs(on.elevation.grid, on.lander.ground_reach)
        terms = ground_terms(on.elevation, on.land_cover, discs)
        ground = discs.fine(_p_ground(_wet(terms), terms, discs, on, missing))
    return SafetyFactors(relief, _beyond_cells(on), ground, np.full_like(relief, on.cell), never)


def _of_matched_heights(t: Touchdowns, margins: list[F32], on: Inputs, missing: MissingVeto) -> SafetyFactors:
    obstacle, ground = _chances(evidence_of(t, on), on, missing)
    relief, least = kept(margins), np.minimum.reduce(margins)
    sampling, pixel = (widths(v, on.cell) for v in (on.elevation.sampling, on.elevation.picture_sampling))
    curves = read_detection()
    enough = pixel_that_settles(curves, on.lander, on.settings)
    settles_at = _settles_at((relief, obstacle, ground), least, pixel, enough, on)
    return SafetyFactors(relief, obstacle, ground, curves.smallest_found(FOUND, sampling, pixel), settles_at)


def _beyond_cells(on: Inputs) -> F32:
    """Compute the probability, (R, C), that wide cells of surveyed heights hide no obstacle in the footprint (G7j).

    The mean height of a wide cell flattens an obstacle. The share of half balls above the limit that cells hide is
    within 0.1 of the share computed here (docs/lab/p-safe.md).
    """
    fine, reach = on.lander.judging_cell, on.lander.ground_reach
    if on.cell <= fine:
        return np.ones(on.elevation.grid.shape, np.float32)
    discs, hidden = Discs(on.elevation.grid, reach), 1 - fine / on.cell
    return discs.fine(np.exp(np.float32(-hidden * math.pi * reach**2) * _density(on, discs)))


def _chances(found: Evidence, on: Inputs, missing: MissingVeto) -> tuple[F32, F32]:
    """Compute the probabilities, (R, C), of no unseen obstacle in the footprint, and of firm, dry ground."""
    usual = np.float32(math.pi * on.lander.ground_reach**2) * _density(on, found.discs)
    shown, about = (np.exp(read_rate(f"{k}_rate").log_rate(found.terms)) for k in ("relief", "density"))
    afar = shown + np.maximum(found.hidden * about, found.unseen * usual)
    expected = {
        "obstacle": _blended(afar, "near_obstacle_rate", found),
        "ground": _blended(_wet(found.terms), "near_ground_rate", found),
    }
    expected = with_floors(expected, found.terms, {"all": found.near, "heights": found.near_by_heights})
    hazards = expected["obstacle"] + found.near * found.unseen * usual
    ground = _p_ground(expected["ground"], found.terms, found.discs, on, missing)
    return found.discs.fine(np.exp(-hazards)), found.discs.fine(ground)


def _wet(terms: Mapping[str, F32]) -> F32:
    """Return the expected hazards of soft or wet ground seen from afar, on the grid of the features `terms` (G7e)."""
    return np.asarray(np.exp(read_rate("ground_rate").log_rate(terms)), np.float32)


def _p_ground(wet: F32, terms: Mapping[str, F32], discs: Discs, on: Inputs, missing: MissingVeto) -> F32:
    """Compute the probability of firm, dry ground from the hazards that are expected by its look, `wet`.

    Missing vetoes, a level surface below its banks and ground unlike the training data add to them.
    """
    settings, cover = on.settings, on.land_cover
    unseen = settings.one_camera_hazard if MissingVeto.SECOND_CAMERA in missing else 0.0
    unseen += settings.unchecked_hazard if MissingVeto.ATTITUDE in missing else 0.0
    if cover is not None:
        unseen += 0.0 if cover.coloured else settings.unchecked_hazard
        novel = np.nan_to_num(discs.mean(discs.coarse(np.maximum(cover.novelty - 1, 0))))
        enclosed = np.float32(settings.enclosed_hazard) * terms[GroundTerm.ENCLOSED]
        wet = wet + (enclosed + np.float32(settings.novel_hazard) * novel)
    return np.asarray(np.exp(-(wet + np.float32(unseen))), np.float32)


def _blended(afar: F32, name: str, found: Evidence) -> F32:
    """Blend the hazards `afar` with the rate `name` of near views; nearness weights their logarithms (G7f)."""
    log = (1 - found.near) * log_at_least(afar, 1e-9) + found.near * read_rate(name).log_rate(found.terms)
    return np.asarray(np.exp(log), np.float32)


def with_floors(
    expected: Mapping[str, F32], terms: Mapping[str, F32], nearness: Mapping[str, F32 | float]
) -> dict[str, F32]:
    """Return the expected hazards of each factor, raised to its floors where these are larger (G7g to G7i).

    Args:
        expected: expected hazards by factor, in any common shape.
        terms: features by identifier.
        nearness: nearness 0 to 1, by all evidence (`all`) and by the heights only (`heights`).
    """
    out = dict(expected)
    for floor in read_floors().values():
        out[floor.factor] = np.maximum(out[floor.factor], nearness[floor.nearness] * floor.expected(terms))
    return out


def _density(on: Inputs, discs: Discs) -> F32:
    """Return the prior density of obstacles by land-cover class, 1/m^2, before any observation."""
    settings, cover = on.settings, on.land_cover
    bare, paved = settings.unseen_bare, settings.unseen_paved
    usual = {Terrain.BARE: bare, Terrain.SHORT_GRASS: bare, Terrain.PAVED: paved}
    out = np.full(on.elevation.grid.shape, settings.unseen_unknown, np.float32)
    if cover is not None and cover.coloured:  # grey pictures do not distinguish classes of open ground
        for kind, density in usual.items():
            out = np.where(cover.label == kind, np.float32(density), out)
    return discs.mean(discs.coarse(out))


def pixel_that_settles(curves: Detection, lander: Lander, settings: HazardsSettings) -> float:
    """Return the largest pixel, metres, at which bare ground without visible obstacles is safe enough for a site."""
    pixels = np.geomspace(FINEST, 2.0, 60) * lander.tallest_obstacle
    at = [np.asarray(k * pixels, np.float32) for k in (PIXELS_A_SAMPLE, 1.0)]
    unseen = curves.unseen_share(lander.tallest_obstacle, *at)
    expected = math.pi * lander.ground_reach**2 * settings.unseen_bare * unseen
    good = np.flatnonzero(expected <= -SETTLED * math.log(max(settings.p_safe, 1e-9)))
    return float(pixels[good[-1]]) if good.size else float(pixels[0])


def _settles_at(factors: tuple[F32, F32, F32], least: F32, pixel: F32, shows: float, on: Inputs) -> F32:
    """Return the pixel width that would settle the doubt, metres; NaN where a closer look would not help.

    The smallest factor decides. For obstacles, the width is `shows`, or half the present width `pixel` if that is finer
    than `shows`. For ground, it is the smaller of `shows` and half the present width. For relief, it is in proportion
    to `least`, the least margin in sigmas, as sigma shrinks with the pixel; half the present width is its upper limit.
    """
    (relief, obstacle, ground), fine = factors, np.float32(shows)
    half = np.float32(0.5) * pixel
    closer = np.where(pixel > fine, fine, half)
    enough = np.float32(ndtri(1 - SETTLED * (1 - on.settings.p_safe)))
    flatter = pixel * (least / enough).clip(0, 1)
    out = np.where(relief < np.minimum(obstacle, ground), np.minimum(flatter, half), closer)
    out = np.where(ground < np.minimum(obstacle, relief), np.minimum(half, fine), out)
    return np.where(out >= np.float32(FINEST * on.lander.tallest_obstacle), out, np.float32(np.nan)).astype(np.float32)


def margins_over_sigma(t: Touchdowns, on: Inputs) -> list[F32]:
    """Compute the margins of every touchdown to its limits, (R, C) sigmas each (G7 to G9).

    The limits are those of the tilt, which comes first, of the rise or the deviation of the ground, and of the rotors
    if they reach beyond the footprint. The deviation of matched heights is left out, as it is among the evidence.
    """
    lander, settings, cell = on.lander, on.settings, on.cell
    local = np.fmin(t.sigma, t.footprint.scatter)  # noise that is not common to the whole footprint
    if lander.has_gear:
        variance = (np.float32(_gear_lever(lander, cell, settings)) * local) ** 2  # variance of the tilt (G8b)
    else:  # noise shared over `noise_length` (G8)
        independent = np.maximum(t.footprint.count / max(1.0, (settings.noise_length / cell) ** 2), 3.0)
        spread = t.footprint.count * np.float32(cell**2) / np.float32(4 * math.pi)  # mean x^2 of a disc: area / 4 pi
        variance = t.sigma**2 / (independent * spread)
    tilt_sigma = np.sqrt(variance + np.float32(on.common_tilt**2)).astype(np.float32)
    tilt = _over(lander.max_slope - t.slope, tilt_sigma)
    margins, last = [tilt], list[F32]()
    if t.rise is not None and lander.belly_clearance is not None:
        rise_sigma = np.float32(math.sqrt(1 + 1 / _independent_heights(lander, cell, settings))) * local
        margins.append(_over(lander.belly_clearance - t.rise, rise_sigma))
    elif not settings.smoothed:
        last.append(_over(lander.max_roughness - t.footprint.roughness, local))
    return [*margins, *([] if t.rotor is None else [t.rotor]), *last]


def _over(margin: F32, sigma: F32) -> F32:
    """Divide; without noise a limit is certainly kept or broken."""
    out = np.divide(margin, sigma, out=np.copysign(np.float32(np.inf), margin), where=sigma > 0)
    return np.where(np.isnan(margin), np.float32(np.nan), out)


def _gear_lever(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Return the worst tilt of a lander on feet or skids per 1 m of noise at each contact, 1/m (G8b)."""
    if lander.skids is not None:
        return math.sqrt(2.0) / min(lander.skids)
    from alight.hazards.gear import feet_of

    gradients = feet_of(lander, cell).solve[:, :, 1:] / cell  # (headings, t, 2, 3)
    worst = np.linalg.eigvalsh(gradients @ gradients.swapaxes(-1, -2)).max()
    return math.sqrt(worst / _independent_heights(lander, cell, settings))


def _independent_heights(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Return the number of independent heights that are averaged under one contact."""
    if lander.foot_contact == "highest":
        return 1.0
    return max(1.0, math.pi * lander.foot_radius**2 / max(settings.noise_length, cell) ** 2)


def kept(margins: Sequence[F32]) -> F32:
    """Compute the probability, (R, C), that all limits are kept, from their margins in sigmas."""
    return np.asarray(reduce(np.multiply, map(ndtr, margins)), np.float32)
