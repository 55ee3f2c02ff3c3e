"""Probability that a touchdown keeps every limit, for normal errors (docs/method/hazards.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from alight.arrays import F32
from alight.hazards.contact import Footprint
from alight.hazards.footprint import feet_of
from alight.settings import HazardsSettings, Lander

CERTAIN = 40.0  # sigmas; the limit is kept, or broken, for sure


def _over(margin: F32, sigma: F32) -> F32:
    """The margin in sigmas; +-`CERTAIN` without noise."""
    sure = np.where(margin >= 0, np.float32(CERTAIN), np.float32(-CERTAIN))
    out = np.where(sigma > 1e-9, margin / np.maximum(sigma, np.float32(1e-9)), sure)
    return np.asarray(np.where(np.isfinite(margin), out, np.float32(np.nan)), np.float32)


def slope_sigma(footprint: Footprint, sigma: F32, common_tilt: float, cell: float, settings: HazardsSettings) -> F32:
    """1-sigma of the footprint's slope, rad: cell noise shared over `noise_length`, and the map's common tilt (G8)."""
    shared = max(1.0, (settings.noise_length / cell) ** 2)
    independent = np.maximum(footprint.count / shared, 3.0)
    spread = footprint.count * np.float32(cell**2) / np.float32(4 * math.pi)  # mean x^2 of a disc: area / 4 pi
    from_cells = sigma**2 / (independent * spread)
    out: F32 = np.sqrt(from_cells + np.float32(common_tilt**2)).astype(np.float32)
    return out


def gear_lever(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Tilt of a lander on feet or skids from 1 m of noise at each contact, worst heading, 1/m (G8b).

    The noise of a foot that stands on the mean of its cells is shared by those that are independent.
    """
    if lander.skids is not None:
        return math.sqrt(2.0) / min(lander.skids)
    gradients = feet_of(lander, cell).solve[:, :, 1:] / cell  # (headings, t, 2, 3)
    worst = np.linalg.eigvalsh(gradients @ gradients.swapaxes(-1, -2)).max()
    return math.sqrt(worst / _independent_heights(lander, cell, settings))


def _independent_heights(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Independent heights that one contact is the mean of."""
    if lander.foot_contact == "highest":
        return 1.0
    return max(1.0, math.pi * lander.foot_radius**2 / max(settings.noise_length, cell) ** 2)


def gear_sigma(sigma: F32, common_tilt: float, lander: Lander, cell: float, settings: HazardsSettings) -> F32:
    """1-sigma of the tilt of feet or skids, rad (G8b)."""
    lever = np.float32(gear_lever(lander, cell, settings))
    out: F32 = np.sqrt((lever * sigma) ** 2 + np.float32(common_tilt**2)).astype(np.float32)
    return out


@dataclass(frozen=True, eq=False)
class TouchdownGeometry:
    """Slope, rise and their uncertainty at every cell, (R, C) each."""

    footprint: Footprint
    slope: F32  # rad, of the footprint or the worst tilt of feet or skids
    rise: F32 | None  # metres, of the ground above the worst contact plane; None: no belly to keep clear
    sigma: F32  # metres, root mean square height sigma in the footprint
    common_tilt: float  # rad, 1-sigma of the tilt that the whole map shares


def margins_over_sigma(m: TouchdownGeometry, lander: Lander, settings: HazardsSettings, cell: float) -> tuple[F32, F32]:
    """Margins to the limits of tilt, and of rise or deviation, in sigmas (G7 to G9)."""
    local = np.fmin(m.sigma, m.footprint.scatter)  # the part of the noise that the footprint does not share
    if lander.has_gear:
        tilt_sigma = gear_sigma(local, m.common_tilt, lander, cell, settings)
    else:
        tilt_sigma = slope_sigma(m.footprint, m.sigma, m.common_tilt, cell, settings)
    tilt = _over(lander.max_slope - m.slope, tilt_sigma)
    if m.rise is not None and lander.belly_clearance is not None:
        rise_sigma = np.float32(math.sqrt(1 + 1 / _independent_heights(lander, cell, settings))) * local
        return tilt, _over(lander.belly_clearance - m.rise, rise_sigma)
    return tilt, _over(lander.max_roughness - m.footprint.roughness, local)


def safe_probability(tilt: F32, rise: F32, unknown: F32, settings: HazardsSettings) -> F32:
    """P(a touchdown keeps every limit) for heights that show every obstacle: tilt, ground below, unseen share."""
    p: F32 = ndtr(tilt) * ndtr(rise) * (1 - np.float32(settings.hidden_hazard) * unknown)
    return np.asarray(p, np.float32)
