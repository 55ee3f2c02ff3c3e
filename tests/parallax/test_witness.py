"""Temporal consistency: two cameras at one instant separate moving from still ground; twin, pairs, estimators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from ground_views import Scene, Texture
from numpy.testing import assert_allclose
from parts import nothing_known, with_parts

from alight.elevation import FIELDS
from alight.geometry import Grid, Pose
from alight.parallax import consistency_kernels as kernels
from alight.parallax import temporal_consistency as witness
from alight.parallax.batch import Images, match_tile
from alight.parallax.recursive import RecursiveParallax
from alight.pipeline.mapping.recursive_map import box_in
from alight.records import ElevationMap, Flag, Heights, View
from alight.settings import ParallaxSettings
from alight.settings.tuning.parallax import UncertaintyTuning

TUNING = UncertaintyTuning()
CELL = 0.2
GRID = Grid(-5.9, 4.5, CELL, 46, 60)
EAST, NORTH = np.meshgrid(*GRID.xy())
BLOCK, CUT = 8, 0.6
PAIRS = np.array([[0, 1], [2, 3], [4, 2]])
WAVES = [Texture(100 + k, contrast=14.0) for k in range(8)]


def stack(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Samples of five views and a template, both with holes; sizes that are no multiple of a block."""
    rng = np.random.default_rng(seed)
    samples, mean = (rng.normal(0, 0.5, s).astype(np.float32) for s in ((5, 21, 29), (21, 29)))
    samples[rng.random(samples.shape) < 0.1] = np.nan
    mean[rng.random(mean.shape) < 0.1] = np.nan
    return samples, mean


def sums() -> np.ndarray:
    out = np.full((5, 3, 4), -9, np.float32)
    kernels.common(*(stack()[0], PAIRS, stack()[1]), BLOCK, CUT, out)
    return out


def test_the_sums_over_blocks() -> None:
    samples, mean = (a.astype(np.float64) for a in stack())
    want = np.zeros((5, 3, 4))
    for r, c in np.ndindex(mean.shape):
        at = (slice(None), r // BLOCK, c // BLOCK)
        for i, j in PAIRS:
            a, b = samples[i, r, c] - mean[r, c], samples[j, r, c] - mean[r, c]
            if abs(a) < CUT and abs(b) < CUT:
                want[at] += [a * b, (a * a + b * b) / 2, 1, 0, 0]
        if np.isfinite(mean[r, c]):
            want[at] += [0, 0, 0, mean[r, c] ** 2, 1]
    assert_allclose(sums(), want, rtol=1e-4, atol=1e-4)


def test_the_number_of_threads_changes_no_bit(on_one_and_all: Callable[..., Any]) -> None:
    alone, together = on_one_and_all(sums)
    assert alone.tobytes() == together.tobytes()


def test_pairs_are_views_of_one_instant_by_two_cameras() -> None:
    view = Scene(noise=0).views(1)[0]
    views = [replace(view, t_ns=t, cam=c) for t, c in ((5, 0), (5, 1), (6, 0), (7, 1), (7, 0), (7, 0), (5, 2))]
    pairs = {frozenset(map(int, p)) for p in witness.instants(views)}
    assert pairs == {frozenset(p) for p in ((0, 1), (0, 6), (1, 6), (3, 4), (3, 5))}
    assert witness.instants(views[2:4]).shape == (0, 2)


@pytest.mark.parametrize("together", [True, False])
def test_only_what_is_common_to_one_instant_counts(together: bool) -> None:
    """The change is common to the two pictures of each instant, or of equal amount but different in every picture."""
    rng = np.random.default_rng(2)
    mean = rng.normal(size=(64, 64)).astype(np.float32)
    change = rng.normal(0, 0.3, (8, 64, 64)).astype(np.float32)
    if together:
        change[1::2] = change[::2]
    share = witness.shared(mean + change, np.arange(8).reshape(-1, 2), mean, np.full(mean.shape, 8, np.uint8), TUNING)
    assert (share > TUNING.most_shared).all() == together
    assert (share > 0.5 * TUNING.most_shared).any() == together


@cache
def rig(moving: bool, count: int = 7, since: int = 0, tall: bool = False) -> list[list[View]]:
    """Views of a rig over level ground; in the west, waves change it between exposures, from number `since` on.

    If it is `tall`, each camera sees another side.
    """
    still = Texture(1, contrast=30.0)

    def waves(e: np.ndarray, n: np.ndarray, k: int) -> np.ndarray:
        return 5.0 * (WAVES[k % len(WAVES)](e, n) - 128.0) if tall else WAVES[k // 2 % len(WAVES)](e, n)

    def paint(e: np.ndarray, n: np.ndarray, k: int) -> np.ndarray:
        return still(e, n) + (np.where(e < -1.0, waves(e, n, k), 0.0) if moving and k >= 2 * since else 0.0)

    scene = Scene(paint=paint, spacing=1.3)
    out = []
    for k in range(count):
        pose, shots = scene.pose(k, count), []
        for cam in (0, 1):
            there = Pose(pose.rotation, pose.translation + np.array([0.0, 0.4 * cam, 0.0]))
            shots.append(View(k * 100_000_000, cam, scene.picture(there, 2 * k + cam), scene.camera, there))
        out.append(shots)
    return out


@cache
def found(method: str, moving: bool, effort: int = 0) -> Heights:
    """Match the grid by the recursive estimator or in batch."""
    shots = rig(moving)
    if method == "batch":
        found = match_tile(Images([v for s in shots for v in s], CELL, 0.0), GRID, -1.5, 2.5, ParallaxSettings())
        heights = found.heights if found else None
    else:
        estimator = RecursiveParallax(ParallaxSettings(), CELL, 0.0)
        known = nothing_known(GRID)
        for shot in shots:
            estimator.push(shot)
            known = with_parts(known, estimator.step(GRID, known, -1.5, 2.5, effort))
        heights = Heights(known.grid, **{k: getattr(known, k) for k in FIELDS})
    assert heights is not None
    return heights


@pytest.mark.parametrize("method", ["batch", "recursive"])
def test_a_rig_separates_waves_from_ground(method: str) -> None:
    """Without temporal consistency the bed would pass: its texture is twice as strong as the waves."""
    moves = (found(method, moving=True).flags & np.uint16(Flag.MOVING)) != 0
    inner = (np.abs(NORTH) < 3.0) & (np.abs(EAST) < 5.0)
    assert moves[inner & (EAST < -2.5)].mean() > 0.95
    assert moves[inner & (EAST > 3.5)].mean() < 0.05
    still = (found(method, moving=False).flags & np.uint16(Flag.MOVING)) != 0
    assert still[inner].mean() < 0.01


@pytest.mark.parametrize("effort", [1, 3])
def test_with_less_effort_the_rig_separates_waves_all_the_same(effort: int) -> None:
    """Some exposures keep both cameras: once, with one of each, moving shadows were given out."""
    moves = (found("recursive", moving=True, effort=effort).flags & np.uint16(Flag.MOVING)) != 0
    inner = (np.abs(NORTH) < 3.0) & (np.abs(EAST) < 5.0)
    assert moves[inner & (EAST < -2.5)].mean() > 0.95
    assert moves[inner & (EAST > 3.5)].mean() < 0.05


@pytest.mark.parametrize("since", [0, 4])
def test_the_recursive_estimator_finds_that_somebody_has_come(since: int) -> None:
    """The ground was still before: a surface that always moves has not come."""
    estimator, known, came = (
        RecursiveParallax(ParallaxSettings(), CELL, 0.0),
        nothing_known(GRID),
        np.zeros(GRID.shape, bool),
    )
    for shot in rig(True, 9, since, tall=True):
        estimator.push(shot)
        known = with_parts(known, estimator.step(GRID, known, -1.5, 2.5))
        for part, where in estimator.came:
            came[box_in(GRID, part)] |= where
    inner = np.abs(NORTH) < 3.0
    assert came[inner & (EAST < -2.5) & (EAST > -5.0)].mean() == pytest.approx(float(since > 0), abs=0.1)
    assert not came[inner & (EAST > 1.5)].any()


def test_one_camera_has_no_pairs() -> None:
    found = match_tile(Images([s[0] for s in rig(moving=True)], CELL, 0.0), GRID, -1.5, 2.5, ParallaxSettings())
    assert found is not None
    heights = found.heights
    inner = (np.abs(NORTH) < 3.0) & (EAST < -2.5) & (EAST > -5.0)
    assert ((heights.flags[inner] & np.uint16(Flag.MOVING)) != 0).mean() < 0.5


def instants_of(kinds: list[int], noise: float = 0.1, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two views of each instant, of one of several grounds (48, 48); also pairs and times."""
    rng = np.random.default_rng(seed)
    grounds = rng.normal(0, 0.6, (max(kinds) + 1, 48, 48))
    samples = np.repeat(grounds[kinds], 2, axis=0) + rng.normal(0, noise, (2 * len(kinds), 48, 48))
    pairs = np.arange(2 * len(kinds)).reshape(-1, 2)
    return samples.astype(np.float32), pairs, np.repeat(np.arange(len(kinds)) * 200_000_000, 2)


@pytest.mark.parametrize(
    ("kinds", "found"),
    [
        ([0, 0, 0, 0, 0, 0], False),
        ([0, 0, 0, 0, 1, 1], True),
        ([0, 0, 1, 1, 1, 1], True),
        ([0, 0, 0, 0, 0, 1], False),  # the view of one instant may miss the map
        ([0, 1, 0, 1, 0, 1], False),  # waves
        ([0, 1, 2, 3, 4, 5], False),
        ([0, 0, 1], False),
    ],
)
def test_a_change_is_what_was_one_ground_before_and_another_after(kinds: list[int], found: bool) -> None:
    out = witness.changed_since(*instants_of(kinds), TUNING)
    assert out.all() == out.any() == found


def test_a_change_of_a_part_is_found_there_only() -> None:
    """Only the changed part is found, in any order of the pairs."""
    samples, pairs, times = instants_of([0, 0, 0, 1, 1, 1])
    samples[6:, :, :24] = samples[:6, :, :24]
    samples[:, 40:] = np.nan
    for order in (slice(None), [3, 0, 5, 1, 4, 2]):
        out = witness.changed_since(samples, pairs[order], times, TUNING)
        assert out[:32, 32:].all()
        assert not out[:, :16].any()


def known_before(residual: float, flags: int = 0) -> ElevationMap:
    """A map of the ground of `instants_of`, whose views had this residual."""
    grid, shape = Grid(0.0, 0.0, 0.1, 48, 48), (48, 48)
    out = nothing_known(grid)
    return replace(
        out, height=np.zeros(shape, np.float32), residual=np.full(shape, residual, np.float32),
        flags=np.full(shape, flags, np.uint16),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kinds", "found"), [([0, 0, 0, 0], False), ([0, 1, 2, 3], True), ([0, 0, 0, 1], False), ([0, 1], False)]
)
def test_views_that_agree_on_nothing_contradict_the_map(kinds: list[int], found: bool) -> None:
    """Of four instants one may miss the map; two instants are too few to decide."""
    samples, _, _ = instants_of(kinds, 0.3)
    out = witness.contradicted(samples, known_before(0.5), TUNING)
    assert out.wrong.all() == out.wrong.any() == found
    assert not out.came.any()


@pytest.mark.parametrize(
    ("kinds", "residual", "flags", "came"),
    [
        ([0, 0, 0, 0, 0, 0], 0.05, 0, False),
        ([0, 0, 0, 0, 1, 2], 0.05, 0, True),  # two instants of a walk
        ([0, 0, 0, 0, 0, 1], 0.05, 0, False),  # two instants of a person's walk
        ([0, 0, 0, 0, 1, 2], 0.3, 0, False),  # the ground swayed before
        ([0, 0, 0, 0, 1, 2], 0.05, int(Flag.UNSURE), False),  # no height was trusted before
    ],
)
def test_somebody_has_come_where_views_agreed_before(kinds: list[int], residual: float, flags: int, came: bool) -> None:
    """The arrival is found before the map's height is contradicted."""
    samples, _, _ = instants_of(kinds, 0.1)
    out = witness.contradicted(samples, known_before(residual, flags), TUNING)
    assert out.came.all() == out.came.any() == came
    assert not out.wrong.any()


def test_a_part_without_texture_or_views_contradicts_nothing() -> None:
    """Parts without texture or views are left out, and the others are separated to a block."""
    samples, _, _ = instants_of([0, 1, 2, 3, 4, 5])
    samples[:, :, :20] = np.random.default_rng(4).normal(0, 0.05, (len(samples), 48, 20))
    samples[4:, 24:] = np.nan
    for out in witness.contradicted(samples, known_before(0.05), TUNING):
        assert out[:16, 32:].all()
        assert not out[:, :8].any()
        assert not out[40:].any()


def test_the_sums_before_and_after_a_moment() -> None:
    samples, pairs, _ = instants_of([0, 0, 1, 1, 2], 0.3)
    samples[np.random.default_rng(3).random(samples.shape) < 0.1] = np.nan
    v = samples.astype(np.float64)[pairs].mean(axis=1)
    between, whole, count = np.empty((4, 6, 6), np.float32), np.empty((6, 6), np.float32), np.empty((6, 6), np.float32)
    kernels.before_and_after(samples, pairs, 8, 2, between, whole, count)
    want = np.zeros((6, 6, 6))
    for r, c in np.ndindex(48, 48):
        known, at = np.isfinite(v[:, r, c]), (r // 8, c // 8)
        if known.sum() < 4:
            continue
        values = v[known, r, c]
        want[4][at] += ((values - values.mean()) ** 2).sum()
        want[5][at] += len(values)
        for p in range(4):
            a, b = (v[s, r, c][known[s]] for s in (slice(p + 1), slice(p + 1, None)))
            if min(len(a), len(b)) >= 2:
                want[p][at] += len(a) * len(b) / len(values) * (a.mean() - b.mean()) ** 2
    assert_allclose(np.concatenate([between, whole[None], count[None]]), want, rtol=1e-3, atol=1e-3)
