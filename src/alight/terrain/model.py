"""Model of appearance: likelihood of the classes given features; far from the training data it gives no evidence.

A linear classifier on few numbers (docs/method/land-cover.md, T4): 1,400 labelled patches of four places carry no more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8
from alight.terrain.features import against, appearance_features, frame_of

Real = TypeVar("Real", np.float32, np.float64)

CLIP = 4.0  # standard deviations beyond which a feature counts no further


@dataclass(frozen=True, eq=False)
class Head:
    """The classifier of one level; F features, K classes."""

    mean: F32  # (F,)
    spread: F32  # (F,)
    weights: F32  # (K, F)
    bias: F32  # (K,)
    centres: F32  # (K, F) of the classes, standardised
    metric: F32  # (F, F) inverse covariance within the classes
    reach: float  # usual squared distance to the nearest centre
    temperature: float  # factor by which the evidence is too sure on places left out


@dataclass(frozen=True, eq=False)
class Model:
    """A trained model of appearance: one head a level, None for levels that the library cannot fill."""

    classes: U8  # (K,) Terrain codes of its classes
    heads: tuple[Head | None, ...]
    provenance: str = ""  # its training data, and its accuracy on places left out


def standardised(head: Head, features: F32) -> F32:
    """Features (N, F) without unit."""
    return np.asarray(np.clip((features - head.mean) / head.spread, -CLIP, CLIP), np.float32)


def to_nearest(z: NDArray[Real], centres: NDArray[Any], metric: NDArray[Any]) -> NDArray[Any]:
    """Squared distance of features (N, F) to the nearest of some centres, (N,)."""
    each = [np.einsum("nf,fg,ng->n", z - c, metric, z - c, optimize=True) for c in centres]
    return np.asarray(np.min(each, axis=0))


def distance(head: Head, z: F32) -> F32:
    """Squared distance of features (N, F) to the nearest class, (N,), 1 at the usual distance."""
    return np.asarray(to_nearest(z, head.centres, head.metric) / head.reach, dtype=np.float32)


def scores(head: Head, features: F32) -> F32:
    """Evidence for each class before the temperature, (N, K): it fades with the distance from the classes (T4)."""
    z = standardised(head, features)
    fading = 1 / (1 + np.maximum(distance(head, z) - 1, 0))
    out: F32 = ((z @ head.weights.T + head.bias) * fading[:, None]).astype(np.float32)
    return out


def log_softmax(values: NDArray[Real], axis: int = -1) -> NDArray[Real]:
    """Logarithms of probabilities that are proportional to exp(values) along an axis."""
    shifted = values - values.max(axis=axis, keepdims=True)
    out: NDArray[Real] = shifted - np.log(np.exp(shifted).sum(axis=axis, keepdims=True))
    return out


def log_probability(head: Head, features: F32) -> F32:
    """Log probability of each class, all equally likely before; (N, K)."""
    return log_softmax(scores(head, features) / np.float32(head.temperature))


def appearance_evidence(model: Model, rgb: U8, sampling: float, seen: NDArray[np.bool_] | None = None) -> F32 | None:
    """Log probability of each class a block of a picture, (r, c, K), all classes equally likely before.

    The picture is its own frame (T3). NaN where too little was seen; None where the pixels are too coarse.
    """
    found = appearance_features(rgb, sampling, seen)
    head = model.heads[found.level] if found else None
    if found is None or head is None:
        return None
    flat = found.values.reshape(-1, found.values.shape[2])
    relative = against(flat, frame_of(flat, found.level))
    return log_probability(head, relative).reshape(*found.values.shape[:2], -1)
