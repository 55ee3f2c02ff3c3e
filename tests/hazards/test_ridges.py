"""Straight ridges: kerbs, walls and pipes are structures, however low they are (docs/method/p-safe.md, G7i)."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from ground import covered, ground

from alight.hazards import assess
from alight.hazards.ridges import straight_ridges
from alight.learned import read_floors
from alight.learned.terms import FloorTerm
from alight.records import Flag, HazardMap, Terrain
from alight.settings import HazardsSettings, Lander

N, MID = 121, (60, 60)
FLOOR = read_floors()["straight_ridge"]
RIDGE = FLOOR.products[0][FloorTerm.RIDGE][0]  # metres of relief: no hazard, and all of it
KERB = 0.11  # metres high, 0.2 m wide


def kerb(angle: float, away: float = 0.0, cell: float = 0.05, length: float = math.inf) -> np.ndarray:
    """(121, 121) metres: level ground with a kerb whose middle line passes `away` metres beside the middle."""
    y, x = (np.mgrid[:N, :N] - N // 2) * cell
    across, along = x * math.sin(angle) - y * math.cos(angle), x * math.cos(angle) + y * math.sin(angle)
    return np.asarray(KERB * np.clip((0.1 - np.abs(across - away)) / cell + 0.5, 0, 1) * (np.abs(along) < length / 2))


def looked_at(height: np.ndarray, sample: float = 0.04, doubtful: np.ndarray | None = None) -> HazardMap:
    e = ground(height, cell=0.05, sigma=0.005)
    n = e.grid.shape
    e = replace(e, sampling=np.full(n, sample, np.float32), fine_sampling=np.full(n, sample / 2, np.float32))
    if doubtful is not None:
        flags = e.flags.copy()
        flags[doubtful] = Flag.UNSURE
        e = replace(e, flags=flags)
    return assess(e, covered(e, 0.9999, Terrain.BARE), Lander(radius=1.0), HazardsSettings())


@pytest.mark.parametrize("degrees", [0, 5.6, 20, 45, 71, 90, 140])
def test_a_kerb_has_a_relief_above_the_limit_at_any_angle(degrees: float) -> None:
    assert straight_ridges(kerb(math.radians(degrees)).astype(np.float32), 0.05)[MID] > RIDGE[1]


def test_the_relief_of_a_kerb_depends_little_on_the_cell() -> None:
    fine, coarse = (straight_ridges(kerb(0.3, cell=c).astype(np.float32), c)[MID] for c in (0.05, 0.1))
    assert coarse == pytest.approx(fine, rel=0.15)


def test_what_is_short_is_no_ridge() -> None:
    assert straight_ridges(kerb(0.3, length=0.5).astype(np.float32), 0.05).max() < RIDGE[0] / 3
    assert straight_ridges(kerb(0.3, length=1.2).astype(np.float32), 0.05).max() < RIDGE[0]


def test_rough_ground_is_no_ridge() -> None:
    bumps = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 1, (N, N)).astype(np.float32), (0, 0), 4.0)
    assert straight_ridges(bumps * np.float32(0.03 / bumps.std()), 0.05).max() < RIDGE[0]


def test_a_slope_and_a_single_height_are_no_ridges() -> None:
    slope = np.broadcast_to(np.float32(0.1) * np.arange(N, dtype=np.float32) * 0.05, (N, N)).copy()
    slope[MID] += 0.3
    inner = straight_ridges(slope, 0.05)[20:-20, 20:-20]
    assert inner.max() < 0.1 * RIDGE[0]


def test_nothing_known_has_no_ridge_and_gaps_in_a_kerb_are_bridged() -> None:
    assert (straight_ridges(np.full((N, N), np.nan, np.float32), 0.05) == 0).all()
    z = kerb(0.3).astype(np.float32)
    z[58:63, 58:61] = np.nan
    assert straight_ridges(z, 0.05)[MID] > RIDGE[1]


def test_a_kerb_lower_than_the_lander_stands_is_no_site_from_near_by() -> None:
    bare, across, beside = (looked_at(z).p_safe[MID] for z in (kerb(0.3) * 0, kerb(0.3), kerb(0.3, away=1.6)))
    assert bare > 0.95
    assert across < 0.6
    assert beside > 0.95


def test_a_kerb_whose_heights_are_in_doubt_counts_as_well() -> None:
    z = kerb(0.3)
    assert looked_at(z, doubtful=z > 0.05).p_safe[MID] < 0.6


def test_a_kerb_counts_the_less_the_coarser_its_heights_are() -> None:
    p = [looked_at(kerb(0.3), sample).p_ground[MID] / looked_at(kerb(0.3) * 0, sample).p_ground[MID]
         for sample in (0.04, 0.1, 0.2)]  # fmt: skip
    assert p[0] < p[1] < p[2] == pytest.approx(1.0, abs=0.02)


def test_the_hazards_of_a_ridge_rise_with_it() -> None:
    at = FLOOR.expected({FloorTerm.RIDGE: np.linspace(0, 0.1, 50, dtype=np.float32)})
    assert (np.diff(at) >= 0).all()
    assert at[0] == 0.0
    assert at[-1] == pytest.approx(0.7)
