"""Makers' distortion models that our cameras do not have, fitted by those that they have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64

SAMPLES = 400  # rays of a fit
MARGIN = 1.02  # over the radius of the image's corner
WIDEST = np.tan(np.radians(75.0))  # x/z of the outermost ray of a fitted rational model
FEWEST = 20  # samples within the image


class FisheyeLens(NamedTuple):
    """Focal length in pixels and k1, k2, k3, k4 of an equidistant model."""

    focal: float
    distortion: tuple[float, ...]


def fisheye_lens(scale: float, polynomial: list[float], radius: float) -> FisheyeLens | None:
    """The equidistant model nearest to Pix4D's fisheye model, `r = scale * sum(p[i] t**i)` with `t = 2 angle / pi`.

    Args:
        scale: pixels, `C` of the affine matrix. The focal length is `2 scale / pi` where the even terms vanish.
        polynomial: p0 (0), p1 (1), p2, ...
        radius: pixels from the centre to the image's farthest corner.
    """
    t = np.linspace(0.0, 1.0, SAMPLES + 1)[1:]
    r = scale * (t[:, None] ** np.arange(len(polynomial)) @ np.array(polynomial))
    inside = _within(r, radius * MARGIN)
    if inside.sum() < FEWEST:
        return None
    angle = 0.5 * np.pi * t[inside]
    terms = _odd_terms(angle, r[inside], 5)
    return None if terms[0] <= 0 else FisheyeLens(float(terms[0]), tuple(float(k) for k in terms[1:] / terms[0]))


def radial_lens(above: list[float], below: list[float], radius: float) -> tuple[float, float, float]:
    """k1, k2, k3 nearest to a rational model, `(1 + above[0] r**2 + ...) / (1 + below[0] r**2 + ...)`.

    Args:
        radius: of the image's farthest corner, in focal lengths.
    """
    r = np.linspace(0.0, WIDEST, SAMPLES + 1)[1:]
    even = r[:, None] ** np.array([2, 4, 6])
    distorted = r * (1 + even @ np.array(above)) / (1 + even @ np.array(below))
    inside = _within(distorted, radius * MARGIN)
    k1, k2, k3 = _odd_terms(r[inside], distorted[inside] - r[inside], 4, start=3)[:3]
    return float(k1), float(k2), float(k3)


def _within(rising: F64, limit: float) -> NDArray[np.bool_]:
    """Samples up to a limit, as long as they rise."""
    fine = np.diff(rising, prepend=0.0) > 0
    return np.asarray(np.logical_and.accumulate(fine & (rising <= limit)))


def _odd_terms(x: F64, y: F64, last: int, start: int = 1) -> F64:
    """Coefficients of x**start, x**(start + 2), ... by least squares."""
    powers = np.arange(start, 2 * last, 2)
    size = x.max()
    found = np.linalg.lstsq((x[:, None] / size) ** powers, y, rcond=None)[0]
    return np.asarray(found / size**powers, dtype=np.float64)
