"""Small nets over standardised terms: one hidden layer of rectified units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from alight.arrays import F16, F32, F64

CLIP = np.float32(4.0)  # spreads; a term further from the training data is clipped
CELLS_AT_A_TIME = 8192  # whose hidden units stay in the cache


class AffineLayer(NamedTuple):
    """One affine layer."""

    weights: F32  # (inputs, outputs)
    bias: F32  # (outputs,)


@dataclass(frozen=True, eq=False)
class Net:
    """A fitted net of one hidden layer, and the scale of its terms."""

    terms: tuple[str, ...]  # identifiers (`terms`), in the order of the first layer's rows
    usual: F32  # (T,) mean of each term
    spread: F32  # (T,) standard deviation of each term
    hidden: AffineLayer
    output: AffineLayer
    calibration: F64 | None = None  # (2, N) output, ascending, and the log odds that held on flights left out

    def standardised(self, found: Iterable[tuple[str, F32]]) -> F16:
        """Terms (R, C) in spreads about their mean and clipped, (terms, R, C) in the order of the net.

        A term is freed before the next one is computed, and the terms are kept to a thousandth: tens of them, of
        millions of cells, are gigabytes.

        Raises:
            ValueError: not every term of the net was given, each once.
        """
        left = {name: i for i, name in enumerate(self.terms)}
        out = np.zeros((0, 0, 0), np.float16)
        for name, values in found:
            if name not in left:
                raise ValueError(f"terms that the net was not fitted on, or that are doubled: {name}")
            if len(left) == len(self.terms):
                out = np.empty((len(left), *values.shape), np.float16)
            i = left.pop(name)
            np.clip((values - self.usual[i]) / self.spread[i], -CLIP, CLIP, out=out[i])
        if left:
            raise ValueError(f"terms of the net that are missing: {', '.join(sorted(left))}")
        return out


def relu_net(net: Net, found: Iterable[tuple[str, F32]]) -> F32:
    """Outputs (outputs, R, C) of a net with rectified hidden units, of terms (R, C) each.

    Raises:
        ValueError: not every term of the net was given, each once.
    """
    terms = net.standardised(found)
    x, hidden, output = terms.reshape(len(terms), -1), net.hidden.weights.T, net.output.weights.T
    out = np.empty((len(output), x.shape[1]), np.float32)
    for begin in range(0, x.shape[1], CELLS_AT_A_TIME):
        some = slice(begin, begin + CELLS_AT_A_TIME)
        units = hidden @ x[:, some].astype(np.float32) + net.hidden.bias[:, None]
        out[:, some] = output @ np.maximum(units, 0, out=units) + net.output.bias[:, None]
    return out.reshape(-1, *terms.shape[1:])
