"""Classes over time: what a cell was taken for at every look, with looks that say much the same (T6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from alight.geometry import Grid
from alight.records import F32, Terrain, TerrainMap
from alight.terrain.model import log_softmax

LEAST = 1e-3  # probability: no single look rules a class out for good


@dataclass(frozen=True, eq=False)
class Looks:
    """What all looks at a piece of ground said so far."""

    grid: Grid
    log_p: F32  # (R, C, 8) mean log probability of the classes
    landable: F32  # (R, C) mean log odds of ground that may be landed on; NaN = never seen
    count: NDArray[np.uint16]  # (R, C) looks remembered


def remember(before: Looks | None, look: TerrainMap, memory: int = 20) -> Looks:
    """Take one more look into account; looks older than `memory` fade.

    Args:
        before: on the same grid; None: this is the first.
        look: with probabilities.
        memory: looks after which an old one counts no more than the newest.

    Raises:
        ValueError: the look has no probabilities or lies on another grid.
    """
    if look.probability is None or (before is not None and before.grid != look.grid):
        raise ValueError("a look needs probabilities, on the grid of those before")
    seen = np.isfinite(look.landable)
    log_p = np.log(np.where(seen[..., None], look.probability, 1).astype(np.float32).clip(LEAST, 1))
    odds = logit(np.where(seen, look.landable, np.float32(0.5)).clip(LEAST, 1 - LEAST)).astype(np.float32)
    if before is None:
        return Looks(look.grid, log_p, np.where(seen, odds, np.float32(np.nan)), seen.astype(np.uint16))
    count = np.minimum(before.count + seen, memory).astype(np.uint16)
    share = np.where(seen, 1 / np.maximum(count, 1), 0).astype(np.float32)
    old = np.where(before.count > 0, before.landable, odds)
    known = np.where(count > 0, old + share * (odds - old), np.float32(np.nan))
    return Looks(look.grid, before.log_p + share[..., None] * (log_p - before.log_p), known, count)


def worth(count: NDArray[np.uint16], correlation: float) -> F32:
    """How many independent looks so many are worth whose errors are correlated: 1 for one, 1 / correlation at most."""
    n = np.maximum(count, 1).astype(np.float32)
    return np.asarray(n / (1 + (n - 1) * np.float32(correlation)), np.float32)


def fused(looks: Looks, correlation: float = 0.7) -> TerrainMap:
    """The classes that all looks together make likely.

    Args:
        looks: remembered.
        correlation: of the errors of two looks: the same plant fools them alike. 1: many are worth one.
    """
    seen = looks.count > 0
    gain = worth(looks.count, correlation)
    log_p = log_softmax(looks.log_p * gain[..., None])
    label = (np.argmax(log_p, axis=-1) + 1).astype(np.uint8)
    nothing = np.float32(np.nan)
    return TerrainMap(
        looks.grid,
        np.where(seen, label, np.uint8(Terrain.UNKNOWN)).astype(np.uint8),
        np.where(seen, expit(looks.landable * gain), nothing).astype(np.float32),
        np.where(seen[..., None], np.exp(log_p), nothing).astype(np.float16),
    )
