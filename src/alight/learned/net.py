"""Small nets over standardised terms: two evaluators over one record."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from alight.arrays import F32, F64

CLIP = np.float32(4.0)  # spreads; a term further from the training data counts no further
TERMS_AT_A_TIME = 8  # all 88 of the land cover together would be several times the map


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
    calibration: F64 | None = None  # (2, N) output, ascending, and the log odds that it was worth on flights left out

    def standardised(self, names: Iterable[str], values: Iterable[F32]) -> F32:
        """Terms of N cells, (N, terms), in spreads about their mean and clipped.

        Raises:
            KeyError: a term is not one of the net's.
        """
        row = {name: i for i, name in enumerate(self.terms)}
        columns = [
            ((v.ravel() - self.usual[row[n]]) / self.spread[row[n]]).clip(-CLIP, CLIP)
            for n, v in zip(names, values, strict=True)
        ]
        return np.stack(columns, axis=1)


def relu_net(net: Net, found: Iterable[tuple[str, F32]]) -> F32:
    """Outputs (R, C, outputs) of a net with rectified hidden units; the terms (R, C) are taken a few at a time.

    Raises:
        ValueError: not every term of the net was given, each once.
    """
    row = {name: i for i, name in enumerate(net.terms)}
    left, total, shape = iter(found), None, (0, 0)
    seen: list[str] = []
    while some := list(islice(left, TERMS_AT_A_TIME)):
        names, shape = [name for name, _ in some], some[0][1].shape
        _known(net, names)
        part = net.standardised(names, (v for _, v in some)) @ net.hidden.weights[[row[n] for n in names]]
        total = part + net.hidden.bias if total is None else total + part
        seen += names
    _complete(net, seen)
    assert total is not None
    out = np.maximum(total, 0, out=total) @ net.output.weights + net.output.bias
    return np.asarray(out, np.float32).reshape(*shape, -1)


def _known(net: Net, names: list[str]) -> None:
    strange = set(names) - set(net.terms)
    if strange:
        raise ValueError(f"terms that the net was not fitted on: {', '.join(sorted(strange))}")


def _complete(net: Net, names: list[str]) -> None:
    _known(net, names)
    if sorted(names) != sorted(net.terms):
        raise ValueError(f"terms of the net that are missing or doubled: {sorted(set(net.terms) ^ set(names))}")
