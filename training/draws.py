"""Cells drawn for a fit: by weight, each flight's terms shifted anew each round.

The shift simulates another camera, light and ground: without it a net overfits to the flights.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from alight.arrays import F32, F64, I64

SHIFT = 0.35  # spreads of a term, 1-sigma of the shift of a flight


class Round(NamedTuple):
    """The cells of one round, whole batches of them."""

    cells: I64  # (N,) indices of cells
    shift: F32  # (flights, terms) spreads


def rounds_of(
    rng: np.random.Generator, weight: F64, flight: I64, terms: int, rounds: int, batch: int
) -> Iterator[Round]:
    """Draw the cells of each round.

    Args:
        rng: random numbers.
        weight: (N,) of the cells, sums to 1.
        flight: (N,) number of each cell's flight.
        terms: of a cell.
        rounds: number of rounds.
        batch: cells of a step; a round is a whole number of batches.
    """
    count = len(weight) // batch * batch
    for _ in range(rounds):
        cells = rng.choice(len(weight), count, p=weight)
        yield Round(cells, rng.normal(0, SHIFT, (int(flight.max()) + 1, terms)).astype(np.float32))
