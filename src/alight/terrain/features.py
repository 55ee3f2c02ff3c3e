"""Appearance features that do not depend on camera, season and light (docs/method/land-cover.md, T3).

Every number is a ratio: of brightness at two scales in metres, of a picture and the frame that it belongs to, or a
correlation. None is a colour, because colour depends on the camera and the season as much as on the ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8

PIXEL = 0.1  # metres, of the finest level; each further level doubles it
LEVELS = 3
BANDS = 4  # octaves of detail, from 0.1 - 0.2 m to 0.8 - 1.6 m; level n starts with the n-th
WINDOW = 0.8  # metres, Gaussian 1-sigma over which detail is averaged
BLOCK = 4  # pixels a side of a block, which has one set of numbers
STRETCH = 1.35  # largest factor by which a picture is enlarged to reach a level
DARK = 4.0  # grey levels added, so that noise in the dark is no contrast


class AppearanceFeatures(NamedTuple):
    """Features of every block of a picture."""

    level: int
    values: F32  # (r, c, F) as `names(level)`; NaN where less than half of the window was seen


def names(level: int) -> tuple[str, ...]:
    """Names of the features of a level."""
    octaves = range(level, BANDS)
    detail = [f"detail {n}" for n in octaves]
    return (
        *detail,
        *(f"{d} against the frame" for d in detail),
        *(f"blue shade {n}" for n in octaves),
        *(f"{k} tint {n}" for n in octaves[:2] for k in ("red", "blue")),
        *(f"evenness {n}" for n in octaves[:3]),
    )


def level_of(sampling: float) -> int | None:
    """The finest level that pixels of `sampling` metres can fill; None when they are too coarse for any."""
    level = max(0, math.ceil(math.log2(sampling / (PIXEL * STRETCH))))
    return level if level < LEVELS else None


def _blur(values: F32, sigma: float) -> F32:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)


def _resized(rgb: U8, seen: NDArray[np.bool_], factor: float) -> tuple[F32, F32]:
    """The picture at the level's pixels, unseen ones filled from their neighbours, and the share that was seen."""
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    weight = cv2.resize(seen.astype(np.float32), size, interpolation=how)
    colour = cv2.resize(np.where(seen[..., None], rgb, 0).astype(np.float32), size, interpolation=how)
    if weight.min() < 0.999:
        near = np.maximum(_blur(weight, 4.0), 1e-6)[..., None]
        fill = _blur(colour, 4.0) / near
        colour = np.where(weight[..., None] > 0.5, colour / np.maximum(weight[..., None], 1e-6), fill)
    return np.asarray(colour, np.float32), np.asarray(weight, np.float32)


class _Means:
    """Means of the seen pixels over the window at every block."""

    def __init__(self, seen: F32, level: int) -> None:
        self._seen = seen
        self._sigma = WINDOW / (PIXEL * 2**level * BLOCK)
        self._size = (max(1, round(seen.shape[1] / BLOCK)), max(1, round(seen.shape[0] / BLOCK)))
        self.share = self._coarse(seen)

    def _coarse(self, values: F32) -> F32:
        return _blur(cv2.resize(values, self._size, interpolation=cv2.INTER_AREA), self._sigma)

    def __call__(self, values: F32) -> F32:
        return np.asarray(self._coarse(values * self._seen) / np.maximum(self.share, 1e-3), np.float32)


def _octave(light: F32, red: F32, blue: F32, mean: _Means) -> dict[str, F32]:
    """Features of one octave of log brightness, log red over green and log blue over green."""
    power, tint = mean(light * light), mean(blue * blue)
    noise, shade = np.float32(1e-5), np.float32(1e-6)  # log ratios squared: below these there is no detail
    return {
        "detail": 0.5 * np.log(power + noise),
        "blue shade": mean(light * blue) / np.sqrt((power + noise) * (tint + shade)),
        "red tint": 0.5 * np.log(mean(red * red) + shade),
        "blue tint": 0.5 * np.log(tint + shade),
        "evenness": mean(np.abs(light)) / np.sqrt(power + noise),
    }


def _signals(rgb: U8, seen: NDArray[np.bool_], factor: float) -> tuple[list[F32], F32]:
    """Logs of brightness, of red over green and of blue over green at the level's pixels, and the share seen."""
    colour, share = _resized(rgb, seen, factor)
    r, g, b = (colour[..., k] + np.float32(DARK) for k in range(3))
    light = (r + g + b) / np.float32(3)
    r /= g
    b /= g
    for v in (light, r, b):
        np.log(v, out=v)
    return [light, r, b], share


def _octaves(signals: list[F32], level: int, mean: _Means) -> dict[str, F32]:
    """Features of all octaves by name; overwrites the signals."""
    found: dict[str, F32] = {}
    for n in range(level, BANDS):
        coarser = [_blur(s, 2.0 ** (n + 1 - level)) for s in signals]
        for s, c in zip(signals, coarser, strict=True):  # in place: arrays as fine as the picture are large
            s -= c
        light, red, blue = signals
        found |= {f"{k} {n}": v for k, v in _octave(light, red, blue, mean).items()}
        signals = coarser
    return found


def appearance_features(rgb: U8, sampling: float, seen: NDArray[np.bool_] | None = None) -> AppearanceFeatures | None:
    """Features of a picture.

    Args:
        rgb: (H, W, 3).
        sampling: metres a pixel.
        seen: (H, W) pixels with a picture; None: all.

    Returns:
        The features; those "against the frame" are absolute until `against` is applied. None where the pixels
        are too coarse.
    """
    level = level_of(sampling)
    if level is None:
        return None
    everywhere = np.ones(rgb.shape[:2], np.bool_) if seen is None else seen
    signals, share = _signals(rgb, everywhere, sampling / (PIXEL * 2**level))
    mean = _Means(share, level)
    found = _octaves(signals, level, mean)
    parts = [found[k.removesuffix(" against the frame")] for k in names(level)]
    values = np.stack(parts, axis=-1).astype(np.float32)
    values[mean.share < 0.5] = np.nan
    return AppearanceFeatures(level, values)


def frame_of(values: F32, level: int) -> F32:
    """The median detail of a frame, (octaves,), of its features (N, F); zeros if there are none."""
    octaves = BANDS - level
    known = values[np.isfinite(values[:, 0]), :octaves]
    return np.median(known, axis=0).astype(np.float32) if len(known) else np.zeros(octaves, np.float32)


def against(values: F32, frame: F32) -> F32:
    """Features (..., F) with the detail taken relative to that of the frame they belong to."""
    out = values.copy()
    octaves = len(frame)
    out[..., octaves : 2 * octaves] = out[..., :octaves] - frame
    return out
