"""Appearance model: likelihood of each class given features; no evidence far from the training data.

The features do not depend on camera, season and light (docs/method/land-cover.md, T3). They are ratios of brightness at
two scales, ratios of a picture to its frame, or correlations. No feature is a colour, because colour depends on camera
and season as much as on the ground.

The classifier is linear with few parameters (T4): 1,400 labelled patches of four locations support no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8

Real = TypeVar("Real", np.float32, np.float64)

PIXEL = 0.1  # metres, pixel of the finest level; it doubles with each further level
LEVELS = 3
BANDS = 4  # octaves of detail, from 0.1 - 0.2 m to 0.8 - 1.6 m; level n starts with octave n
WINDOW = 0.8  # metres, Gaussian 1-sigma over which detail is averaged
BLOCK = 4  # side of a block, pixels; each block has one feature vector
STRETCH = 1.35  # largest factor by which a picture is enlarged to reach a level
DARK = 4.0  # added to grey levels, so that noise in dark pixels gives no contrast
CLIP = 4.0  # standard deviations to which features are clipped


class AppearanceFeatures(NamedTuple):
    """Features of every block of a picture."""

    level: int
    values: F32  # (r, c, F), ordered as `names(level)`; NaN where less than half of the window was seen


def names(level: int) -> tuple[str, ...]:
    """Return the names of the features of a level."""
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
    """Return the finest level that pixels of `sampling` metres support; None if they are too coarse for all levels."""
    level = max(0, math.ceil(math.log2(sampling / (PIXEL * STRETCH))))
    return level if level < LEVELS else None


def _blur(values: F32, sigma: float) -> F32:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)


def _resized(rgb: U8, seen: NDArray[np.bool_], factor: float) -> tuple[F32, F32]:
    """Resize a picture by `factor` and fill pixels that are not `seen`; return picture and seen share per pixel."""
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
    """Means of the seen pixels over the Gaussian window of every block."""

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
    power, tint = mean(light * light), mean(blue * blue)
    noise, shade = np.float32(1e-5), np.float32(1e-6)  # squared log ratios: weaker detail is treated as noise
    return {
        "detail": 0.5 * np.log(power + noise),
        "blue shade": mean(light * blue) / np.sqrt((power + noise) * (tint + shade)),
        "red tint": 0.5 * np.log(mean(red * red) + shade),
        "blue tint": 0.5 * np.log(tint + shade),
        "evenness": mean(np.abs(light)) / np.sqrt(power + noise),
    }


def _signals(rgb: U8, seen: NDArray[np.bool_], factor: float) -> tuple[list[F32], F32]:
    """Return logs of brightness, red/green and blue/green of a picture, resized by `factor`, and the seen share."""
    colour, share = _resized(rgb, seen, factor)
    r, g, b = (colour[..., k] + np.float32(DARK) for k in range(3))
    light = (r + g + b) / np.float32(3)
    r /= g
    b /= g
    for v in (light, r, b):
        np.log(v, out=v)
    return [light, r, b], share


def _octaves(signals: list[F32], level: int, mean: _Means) -> dict[str, F32]:
    """Compute the features of all octaves, by name, from the `signals` of `_signals`, which are overwritten."""
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
    """Compute the features of a picture.

    Args:
        rgb: (H, W, 3) picture.
        sampling: width of a pixel on the ground, metres.
        seen: (H, W) mask of pixels with a picture; None: all pixels.

    Returns:
        The features, or None if the pixels are too coarse. Features "against the frame" are absolute until `against` is
        applied.
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
    """Return the median detail of a frame, (octaves,), from its features (N, F); zeros without finite features."""
    octaves = BANDS - level
    known = values[np.isfinite(values[:, 0]), :octaves]
    return np.median(known, axis=0).astype(np.float32) if len(known) else np.zeros(octaves, np.float32)


def against(values: F32, frame: F32) -> F32:
    """Return features (..., F) with the features "against the frame" made relative to the median detail `frame`."""
    out = values.copy()
    octaves = len(frame)
    out[..., octaves : 2 * octaves] = out[..., :octaves] - frame
    return out


@dataclass(frozen=True, eq=False)
class Head:
    """Classifier of one level, for F features and K classes."""

    mean: F32  # (F,)
    spread: F32  # (F,)
    weights: F32  # (K, F)
    bias: F32  # (K,)
    centres: F32  # (K, F) class means of standardised features
    metric: F32  # (F, F) inverse covariance within the classes
    reach: float  # median squared distance to the nearest centre
    temperature: float  # divisor of the scores, which are overconfident on held-out sites


@dataclass(frozen=True, eq=False)
class Model:
    """Trained appearance model: one head per level, None for levels without enough training data."""

    classes: U8  # (K,) Terrain codes
    heads: tuple[Head | None, ...]
    provenance: str = ""  # training data, and accuracy on held-out sites


def standardised(head: Head, features: F32) -> F32:
    """Return features (N, F), standardised by the head's mean and spread and clipped."""
    return np.asarray(np.clip((features - head.mean) / head.spread, -CLIP, CLIP), np.float32)


def to_nearest(z: NDArray[Real], centres: NDArray[Any], metric: NDArray[Any]) -> NDArray[Any]:
    """Compute the squared Mahalanobis distance of features `z` (N, F) to the nearest of `centres` (K, F), (N,).

    `metric`: (F, F) inverse covariance.
    """
    each = [np.einsum("nf,fg,ng->n", z - c, metric, z - c, optimize=True) for c in centres]
    return np.asarray(np.min(each, axis=0))


def distance(head: Head, z: F32) -> F32:
    """Compute the squared distance, (N,), of features `z` (N, F) to the nearest class, divided by `head.reach`."""
    return np.asarray(to_nearest(z, head.centres, head.metric) / head.reach, dtype=np.float32)


def scores(head: Head, features: F32) -> F32:
    """Compute class scores (N, K) of features (N, F), before the division by the temperature.

    The scores tend to 0 far from the training features of all classes (T4).
    """
    z = standardised(head, features)
    fading = 1 / (1 + np.maximum(distance(head, z) - 1, 0))
    return np.asarray((z @ head.weights.T + head.bias) * fading[:, None], np.float32)


def log_softmax(values: NDArray[Real], axis: int = -1) -> NDArray[Real]:
    """Compute log probabilities proportional to exp(values) along an axis."""
    shifted = values - values.max(axis=axis, keepdims=True)
    out: NDArray[Real] = shifted - np.log(np.exp(shifted).sum(axis=axis, keepdims=True))
    return out


def log_probability(head: Head, features: F32) -> F32:
    """Compute the log probability of each class, (N, K), from features (N, F), for a uniform prior."""
    return log_softmax(scores(head, features) / np.float32(head.temperature))


def appearance_evidence(model: Model, rgb: U8, sampling: float, seen: NDArray[np.bool_] | None = None) -> F32 | None:
    """Compute the log probability of each class per block of a picture, (r, c, K), for a uniform prior.

    A block has 4 x 4 pixels of the picture, after it is resized to a level. The features "against the frame" are
    detail minus the median detail of the picture (T3).

    Args:
        model: trained model.
        rgb: (H, W, 3) picture.
        sampling: width of a pixel on the ground, metres.
        seen: (H, W) mask of pixels with a picture; None: all pixels.

    Returns:
        Log probabilities, NaN where less than half of the window around a block was seen. None if the pixels are too
        coarse, or if the model has no head for their level.
    """
    found = appearance_features(rgb, sampling, seen)
    head = model.heads[found.level] if found else None
    if found is None or head is None:
        return None
    flat = found.values.reshape(-1, found.values.shape[2])
    relative = against(flat, frame_of(flat, found.level))
    return log_probability(head, relative).reshape(*found.values.shape[:2], -1)
