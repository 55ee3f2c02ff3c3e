"""Probability that a touchdown keeps every limit, for normal errors (docs/method/hazards.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from alight.arrays import F32
from alight.hazards.contact import CERTAIN, NO_NOISE, Footprint
from alight.hazards.footprint import feet_of
from alight.settings import HazardsSettings, Lander


def _over(margin: F32, sigma: F32) -> F32:
    """The margin in sigmas; +-`CERTAIN` without noise."""
    sure = np.where(margin >= 0, CERTAIN, -CERTAIN)
    out = np.where(sigma > NO_NOISE, margin / np.maximum(sigma, np.float32(NO_NOISE)), sure)
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
    rotor: F32 | None  # sigmas, least margin of the ground beside the footprint below the rotors; None: not judged
    sigma: F32  # metres, root mean square height sigma in the footprint
    common_tilt: float  # rad, 1-sigma of the tilt that the whole map shares


class Margins(NamedTuple):
    """Margins to the limits of every footprint, (R, C) sigmas each."""

    tilt: F32
    belly: F32 | None  # None: not judged
    deviation: F32 | None  # of the ground from the plane; None: the margin of the belly replaces it
    rotor: F32 | None  # None: the rotors lie within the footprint

    @property
    def of_the_vehicle(self) -> list[F32]:
        """Margins of the vehicle's attitude and parts: all but the deviation."""
        return [m for m in (self.tilt, self.belly, self.rotor) if m is not None]


def margins_over_sigma(m: TouchdownGeometry, lander: Lander, settings: HazardsSettings, cell: float) -> Margins:
    """Margins to the limits of tilt, of rise or deviation, and of the rotors, in sigmas (G7 to G9)."""
    local = np.fmin(m.sigma, m.footprint.scatter)  # the part of the noise that the footprint does not share
    if lander.has_gear:
        tilt_sigma = gear_sigma(local, m.common_tilt, lander, cell, settings)
    else:
        tilt_sigma = slope_sigma(m.footprint, m.sigma, m.common_tilt, cell, settings)
    tilt = _over(lander.max_slope - m.slope, tilt_sigma)
    if m.rise is not None and lander.belly_clearance is not None:
        rise_sigma = np.float32(math.sqrt(1 + 1 / _independent_heights(lander, cell, settings))) * local
        return Margins(tilt, _over(lander.belly_clearance - m.rise, rise_sigma), None, m.rotor)
    return Margins(tilt, None, _over(lander.max_roughness - m.footprint.roughness, local), m.rotor)


def kept(margins: Sequence[F32]) -> F32:
    """(R, C) probability that all of some limits are kept; their margins in sigmas."""
    p = ndtr(margins[0])
    for margin in margins[1:]:
        p = p * ndtr(margin)
    return np.asarray(p, np.float32)


def safe_probability(m: Margins, unknown: F32, settings: HazardsSettings) -> F32:
    """P(a touchdown keeps every limit) for heights that show every obstacle: the margins, and the unseen share."""
    deviation = [] if m.deviation is None else [m.deviation]
    p: F32 = kept([*m.of_the_vehicle, *deviation]) * (1 - np.float32(settings.hidden_hazard) * unknown)
    return np.asarray(p, np.float32)
