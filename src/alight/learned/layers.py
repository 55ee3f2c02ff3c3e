"""Small nets stored as plain text in modules of weights."""

from __future__ import annotations

from base64 import b85decode, b85encode

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
Packed = tuple[int, int, str]  # inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats
CLIP = np.float32(4.0)  # spreads


def pack_layer(layer: F32) -> Packed:
    """A layer (in + 1, out), the bias last, as text."""
    return len(layer) - 1, layer.shape[1], b85encode(layer.astype("<f2").tobytes()).decode()


def unpack_layer(packed: Packed) -> tuple[F32, F32]:
    """Weights (in, out) and bias (out,) of one layer."""
    rows, cols, text = packed
    values = np.frombuffer(b85decode(text), "<f2").astype(np.float32).reshape(rows + 1, cols)
    return values[:-1], values[-1]


def standard(values: F32, usual: float, spread: float) -> F32:
    """A term in spreads about its usual value, clipped: what lies far outside of what was learned says no more."""
    return np.asarray(((values - np.float32(usual)) / np.float32(spread)).clip(-CLIP, CLIP), np.float32)
