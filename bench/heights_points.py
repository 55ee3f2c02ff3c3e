"""Points at which heights are judged on simulated ground, and the errors of a matcher's heights there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from matchers import inside, stands_clear
from numpy.typing import NDArray

from alight.arrays import F64
from alight.records import Terrain, View
from alight.spread import nmad
from alight_sim import SimulatedFlight

POINTS = 20_000
LEAST = 50  # least number of points of a percentage
OPEN = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)
STEP, BESIDE = 0.5, 0.5  # metres: of a height step, and beside it
BAD = 0.5  # metres
Mask = NDArray[np.bool_]
Row = dict[str, float]


@dataclass(frozen=True, eq=False)
class Points:
    """Cells of the truth, drawn evenly, that the first and the last exposure see."""

    xyz: F64  # (N, 3) metres
    open: Mask  # ground without a step beside it
    edge: Mask  # within `BESIDE` of a step
    above: float  # metres, the first camera over the points


@dataclass(frozen=True, eq=False)
class Answer:
    """Heights of a matcher at the points."""

    height: F64  # (N,) metres, NaN = no height
    sigma: F64  # (N,) NaN = no claim
    given: Mask  # heights that it would give out


def points_of(flight: SimulatedFlight, shots: list[list[View]]) -> Points:
    """Draw the points, none of them on water."""
    truth = flight.truth
    size = 2 * round(BESIDE / truth.grid.cell) + 1
    near = np.ones((size, size), np.uint8)
    rise = cv2.dilate(truth.height, near) - cv2.erode(truth.height, near)
    drawn = np.random.default_rng(0).permutation(truth.height.size)[: 4 * POINTS]
    r, c = np.unravel_index(drawn, truth.height.shape)
    e, n = truth.grid.xy()
    xyz = np.c_[e[c], n[r], truth.height[r, c]].astype(np.float64)
    seen = truth.label[r, c] != Terrain.WATER
    for view in (shots[0][0], shots[-1][0]):
        seen &= inside(view, xyz)
        seen[seen] &= stands_clear(truth.height, truth.grid, xyz[seen], view)
    k = np.flatnonzero(seen)[:POINTS]
    step = rise[r[k], c[k]] > STEP
    above = float(shots[0][0].centre[2] - np.median(xyz[k, 2]))
    return Points(xyz[k], np.isin(truth.label[r[k], c[k]], OPEN) & ~step, step, above)


def percent(part: Mask) -> float:
    """Share of a mask in percent, NaN of too few."""
    return 100 * float(part.mean()) if part.size > LEAST else np.nan


def errors(answer: Answer, points: Points, both: Mask) -> Row:
    """One matcher's row; `both`: points where all matchers have a height.

    `open 68 %` and so on: of the points given out, those within 1 (and 1.96) of the claimed sigma.
    """
    e = answer.height - points.xyz[:, 2]
    ground, edge = e[both & points.open], e[both & points.edge]
    out = {
        "open NMAD %": 100 * nmad(ground) / points.above if ground.size > LEAST else np.nan,
        "edge bad %": percent(np.abs(edge) > BAD),
        "given %": 100 * float(answer.given.mean()),
        "bad given %": percent(np.abs(e[answer.given]) > BAD),
        "edge bad given %": percent(np.abs(e[answer.given & points.edge]) > BAD),
    }
    for name, where in (("open", points.open & answer.given), ("edge", points.edge & answer.given)):
        if where.sum() > LEAST and np.isfinite(answer.sigma[where]).all():
            off = np.abs(e[where]) / answer.sigma[where]
            out |= {f"{name} 68 %": percent(off < 1), f"{name} 95 %": percent(off < 1.96)}
    return out


def compare(answers: Mapping[str, Answer], points: Points) -> dict[str, Row]:
    """The row of every matcher, errors on the points where all have a height."""
    both = np.all([np.isfinite(a.height) for a in answers.values()], axis=0)
    return {name: errors(a, points, both) for name, a in answers.items()}
