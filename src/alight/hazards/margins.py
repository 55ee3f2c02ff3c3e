"""Margins of a touchdown to its limits, in sigmas, and the probability that it keeps them, for normal errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from alight.arrays import F32
from alight.hazards.touchdown import CERTAIN, NO_NOISE, Inputs, Touchdowns
from alight.settings import HazardsSettings, Lander


class Margins(NamedTuple):
    """Margins to the limits of every touchdown, (R, C) sigmas each."""

    tilt: F32
    belly: F32 | None  # None: not judged
    deviation: F32 | None  # of the ground from the plane; None: the margin of the belly replaces it
    rotor: F32 | None  # None: the rotors lie within the footprint

    @property
    def of_the_vehicle(self) -> list[F32]:
        """Margins of the vehicle's attitude and parts: all but the deviation."""
        return [m for m in (self.tilt, self.belly, self.rotor) if m is not None]


def margins_over_sigma(t: Touchdowns, on: Inputs) -> Margins:
    """Margins to the limits of tilt, of rise or deviation, and of the rotors, in sigmas (G7 to G9)."""
    lander, settings, cell = on.lander, on.settings, on.cell
    local = np.fmin(t.sigma, t.footprint.scatter)  # the part of the noise that the footprint does not share
    if lander.has_gear:
        variance = (np.float32(_gear_lever(lander, cell, settings)) * local) ** 2  # of the tilt (G8b)
    else:  # noise shared over `noise_length` (G8)
        independent = np.maximum(t.footprint.count / max(1.0, (settings.noise_length / cell) ** 2), 3.0)
        spread = t.footprint.count * np.float32(cell**2) / np.float32(4 * math.pi)  # mean x^2 of a disc: area / 4 pi
        variance = t.sigma**2 / (independent * spread)
    tilt_sigma = np.sqrt(variance + np.float32(on.common_tilt**2)).astype(np.float32)
    tilt = _over(lander.max_slope - t.slope, tilt_sigma)
    if t.rise is not None and lander.belly_clearance is not None:
        rise_sigma = np.float32(math.sqrt(1 + 1 / _independent_heights(lander, cell, settings))) * local
        return Margins(tilt, _over(lander.belly_clearance - t.rise, rise_sigma), None, t.rotor)
    return Margins(tilt, None, _over(lander.max_roughness - t.footprint.roughness, local), t.rotor)


def _over(margin: F32, sigma: F32) -> F32:
    """The margin in sigmas; +-`CERTAIN` without noise."""
    sure = np.where(margin >= 0, CERTAIN, -CERTAIN)
    out = np.where(sigma > NO_NOISE, margin / np.maximum(sigma, np.float32(NO_NOISE)), sure)
    return np.asarray(np.where(np.isfinite(margin), out, np.float32(np.nan)), np.float32)


def _gear_lever(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Tilt of a lander on feet or skids from 1 m of noise at each contact, worst heading, 1/m (G8b).

    The noise of a foot that stands on the mean of its cells is shared by those that are independent.
    """
    if lander.skids is not None:
        return math.sqrt(2.0) / min(lander.skids)
    from alight.hazards.gear import feet_of

    gradients = feet_of(lander, cell).solve[:, :, 1:] / cell  # (headings, t, 2, 3)
    worst = np.linalg.eigvalsh(gradients @ gradients.swapaxes(-1, -2)).max()
    return math.sqrt(worst / _independent_heights(lander, cell, settings))


def _independent_heights(lander: Lander, cell: float, settings: HazardsSettings) -> float:
    """Independent heights that one contact is the mean of."""
    if lander.foot_contact == "highest":
        return 1.0
    return max(1.0, math.pi * lander.foot_radius**2 / max(settings.noise_length, cell) ** 2)


def kept(margins: Sequence[F32]) -> F32:
    """(R, C) probability that all of some limits are kept; their margins in sigmas."""
    p = ndtr(margins[0])
    for margin in margins[1:]:
        p = p * ndtr(margin)
    return np.asarray(p, np.float32)
