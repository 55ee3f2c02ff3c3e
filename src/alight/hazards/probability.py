"""How likely a touchdown meets every limit: first version, normal errors (docs/method-ground.md, section 3)."""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.special import ndtr

from alight.hazards.contact import Footprint
from alight.hazards.footprint import disc_mask, disc_spans
from alight.records import F32
from alight.settings import Hazards, Lander


def mean_near(values: F32, radius: float, cell: float) -> F32:
    """Mean of the known values in the disc about every cell; NaN where none is known."""
    disc = disc_mask(disc_spans(radius / cell)).astype(np.float32)
    known = np.isfinite(values)
    total, weight = (
        cv2.filter2D(a.astype(np.float32), cv2.CV_32F, disc, borderType=cv2.BORDER_CONSTANT)
        for a in (np.where(known, values, 0), known)
    )
    out = np.full(values.shape, np.nan, dtype=np.float32)
    np.divide(total, weight, out=out, where=weight > 0.5)
    return out


def _below(limit: float, value: F32, sigma: F32) -> F32:
    """P(true value <= limit); without noise it is 0 or 1."""
    margin = np.float32(limit) - value
    p = ndtr(margin / np.maximum(sigma, 1e-9))
    out: F32 = np.where(sigma > 1e-9, p, margin >= 0).astype(np.float32)
    return out


def slope_sigma(footprint: Footprint, sigma: F32, cell: float, settings: Hazards) -> F32:
    """1-sigma of the footprint's slope, rad: cell noise shared over `noise_length`, and the map's common tilt (G8)."""
    shared = max(1.0, (settings.noise_length / cell) ** 2)
    independent = np.maximum(footprint.count / shared, 3.0)
    spread = footprint.count * np.float32(cell**2) / np.float32(4 * math.pi)  # mean x^2 of a disc: area / 4 pi
    from_cells = sigma**2 / (independent * spread)
    out: F32 = np.sqrt(from_cells + np.float32(settings.tilt_sigma**2)).astype(np.float32)
    return out


def safe_probability(
    footprint: Footprint, slope: F32, sigma: F32, lander: Lander, settings: Hazards, cell: float
) -> F32:
    """P(slope and roughness within the limits) at every cell (G7 to G9).

    Args:
        footprint: the planes.
        slope: (R, C) rad, the slope or the worst tilt of feet or skids.
        sigma: (R, C) metres, root mean square height sigma in the footprint.
        lander, settings: the limits.
        cell: metres.
    """
    local = np.fmin(sigma, footprint.scatter)  # the part of the noise that the footprint does not share
    p_slope = _below(lander.max_slope, slope, slope_sigma(footprint, sigma, cell, settings))
    if lander.belly_clearance is not None and lander.has_gear:
        return p_slope
    return p_slope * _below(lander.max_roughness, footprint.roughness, local)
