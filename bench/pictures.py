"""Statistics of pictures that affect a matcher: texture by scale, gradients and their tails, contrast, noise."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8

PATCH = 256  # px, of the spectrum
OCTAVES = 6  # periods of 2 to 128 px
FLAT = 2.0  # grey levels: local deviation over 5 px of a pixel that counts as flat
WINDOW = 9  # px, of the local contrast


def _grey(image: U8) -> F32:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image, np.float32)


def _deviation(grey: F32, window: int) -> F32:
    mean = cv2.blur(grey, (window, window))
    return np.sqrt(np.maximum(cv2.blur(grey * grey, (window, window)) - mean * mean, 0))


def noise(grey: F32) -> float:
    """Sensor noise, grey levels: the second difference both ways (Immerkaer 1996) in the flattest twentieth."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    power = cv2.blur(cv2.filter2D(grey, -1, kernel) ** 2, (15, 15))
    inside = (grey > 10) & (grey < 245)
    return float(np.sqrt(np.percentile(power[inside], 5))) if inside.any() else 0.0


def octaves(grey: F32) -> NDArray[np.float64]:
    """Standard deviation by octave of period, grey levels: 2 to 4 px first, averaged over patches."""
    window = np.outer(np.hanning(PATCH), np.hanning(PATCH))
    window /= np.sqrt((window**2).mean())
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(PATCH), np.fft.fftfreq(PATCH)))
    band = np.floor(-np.log2(np.maximum(f, 1e-9))).astype(int) - 1
    total, n = np.zeros(OCTAVES), 0
    for r in range(0, grey.shape[0] - PATCH + 1, PATCH // 2):
        for c in range(0, grey.shape[1] - PATCH + 1, PATCH // 2):
            p = grey[r : r + PATCH, c : c + PATCH]
            power = np.abs(np.fft.fft2((p - p.mean()) * window)) ** 2 / PATCH**4
            total += [power[band == k].sum() for k in range(OCTAVES)]
            n += 1
    return np.sqrt(total / n)


def slope(by_octave: NDArray[np.float64]) -> float:
    """Exponent a of a power spectral density f^-a fitted to these octaves; periods of 4 to 64 px."""
    k = np.arange(1, 5)
    return float(2 * np.polyfit(k, np.log2(by_octave[1:5]), 1)[0] + 2)


def _kurtosis(values: NDArray[np.float32]) -> float:
    d = values - values.mean()
    return float((d**4).mean() / (d**2).mean() ** 2)


def statistics(images: Sequence[U8]) -> dict[str, float]:
    """One row of the table of pictures, mean over `images`."""
    rows = []
    for image in images:
        g = _grey(image)
        dx, dy = 0.5 * (g[1:-1, 2:] - g[1:-1, :-2]), 0.5 * (g[2:, 1:-1] - g[:-2, 1:-1])
        contrast = _deviation(g, WINDOW)
        by_octave = octaves(g)
        chroma = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)[..., 1:].astype(np.float32) if image.ndim == 3 else None
        row = {
            "mean": float(g.mean()),
            "sd": float(g.std()),
            "grad": float(np.hypot(dx, dy).mean()),
            "kurtosis": _kurtosis(np.concatenate([dx.ravel(), dy.ravel()])),
            "flat %": 100 * float((_deviation(g, 5) < FLAT).mean()),
            "contrast P5": float(np.percentile(contrast, 5)),
            "P50": float(np.percentile(contrast, 50)),
            "P95": float(np.percentile(contrast, 95)),
            "white %": 100 * float((g > 250).mean()),
            "black %": 100 * float((g < 6).mean()),
            "noise": noise(g),
            "chroma sd": float(np.sqrt(chroma.var(axis=(0, 1)).sum())) if chroma is not None else 0.0,
            "slope": slope(by_octave),
        }
        rows.append(row | {f"{2 << k}-{4 << k} px": float(v) for k, v in enumerate(by_octave)})
    out = {k: float(np.mean([r[k] for r in rows])) for k in rows[0]}
    out["mean varies by"] = float(np.std([r["mean"] for r in rows]))
    return out
