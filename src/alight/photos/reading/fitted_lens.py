"""Convert makers' lens models to the nearest supported model, by least squares over the picture."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64, Mask


def fisheye_terms(scale: float, polynomial: list[float], radius: float) -> F64 | None:
    """Fit the equidistant model to Pix4D's fisheye; return (5,) pixels: f, f k1, ..., f k4.

    None: fewer than 20 samples of the polynomial lie within `radius`.

    Args:
        scale: `C` in pixels of the model `r = C sum(p[i] t**i)`, with `t = 2 angle / pi`.
        polynomial: coefficients p0 (0), p1 (1), p2, ...
        radius: pixels from the centre to the image's farthest corner.
    """
    t = np.linspace(0.0, 1.0, 401)[1:]
    r = scale * (t[:, None] ** np.arange(len(polynomial)) @ np.array(polynomial))
    inside = _within(r, radius)
    return _odd_terms(0.5 * np.pi * t[inside], r[inside], 5) if inside.sum() >= 20 else None


def radial_lens(above: list[float], below: list[float], radius: float) -> tuple[float, float, float]:
    """Fit k1, k2, k3 to the radial factor `(1 + above[0] r**2 + ...) / (1 + below[0] r**2 + ...)`.

    `radius` is the r of the image's farthest corner, in focal lengths from the centre.
    """
    r = np.linspace(0.0, np.tan(np.radians(75.0)), 401)[1:]
    even = r[:, None] ** np.array([2, 4, 6])
    distorted = r * (1 + even @ np.array(above)) / (1 + even @ np.array(below))
    inside = _within(distorted, radius)
    k1, k2, k3 = _odd_terms(r[inside], distorted[inside] - r[inside], 4, start=3)[:3]
    return float(k1), float(k2), float(k3)


def _within(rising: F64, limit: float) -> Mask:
    """Return the mask (N,) of the samples `rising` before the first one that exceeds the limit or does not rise."""
    fine = np.diff(rising, prepend=0.0) > 0
    return np.asarray(np.logical_and.accumulate(fine & (rising <= limit)))


def _odd_terms(x: F64, y: F64, last: int, start: int = 1) -> F64:
    """Return least-squares coefficients of y (N,) for the powers `start`, `start` + 2, ..., 2 `last` - 1 of x (N,)."""
    powers = np.arange(start, 2 * last, 2)
    size = x.max()
    found = np.linalg.lstsq((x[:, None] / size) ** powers, y, rcond=None)[0]
    return np.asarray(found / size**powers, dtype=np.float64)
