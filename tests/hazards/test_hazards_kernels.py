"""The kernels of hazards and terrain against plain NumPy, on random, planar and holed ground."""

from __future__ import annotations

import heapq
import math
from itertools import combinations

import numpy as np
import pytest
from length import first
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from alight.hazards.contact_kernels import resting_pitches
from alight.hazards.gear import block_starts, feet_of, gear_contact, skids_of, unlike_directions
from alight.hazards.touchdown import footprint_of, rotor_margin, step_of
from alight.raster import disc_any, disc_mask, disc_spans
from alight.settings import Lander
from alight.terrain.basin_kernels import fill_basins

CELL = 0.1
SHAPE = (23, 29)


def rough_ground(seed: int, holes: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    r, c = np.mgrid[: SHAPE[0], : SHAPE[1]]
    h = (0.02 * c - 0.01 * r + rng.normal(0, 0.05, SHAPE)).astype(np.float32)
    h[rng.random(SHAPE) < holes] = np.nan
    return h


def cells_in_disc(r: int, c: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    rr, cc = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.nonzero(np.hypot(rr - r, cc - c) * CELL <= radius + 1e-9)


def brute_plane(h: np.ndarray, r: int, c: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Plane coefficients (level, per column, per row) and deviations of the known cells, by lstsq."""
    rr, cc = cells_in_disc(r, c, radius)
    known = np.isfinite(h[rr, cc])
    rr, cc = rr[known], cc[known]
    A = np.column_stack([np.ones(len(rr)), cc - c, rr - r])
    p = np.linalg.lstsq(A, h[rr, cc].astype(np.float64), rcond=None)[0]
    return p, h[rr, cc] - A @ p


@pytest.mark.parametrize(("seed", "holes"), [(0, 0.0), (1, 0.1), (2, 0.5)])
def test_the_footprint_agrees_with_least_squares_cell_by_cell(seed: int, holes: float) -> None:
    h = rough_ground(seed, holes)
    got = footprint_of(h, 0.5, CELL)
    for r in range(SHAPE[0]):
        for c in range(SHAPE[1]):
            p, dev = brute_plane(h, r, c, 0.5)
            inside = disc_mask(disc_spans(5.0)).sum()
            assert got.count[r, c] == len(dev)
            assert_allclose(got.unknown[r, c], 1 - len(dev) / inside, atol=1e-6)
            assert_allclose([got.level[r, c], got.grad_c[r, c], got.grad_r[r, c]], p, atol=2e-5)
            assert_allclose(got.roughness[r, c], np.abs(dev).max(), atol=2e-5)
            assert_allclose(got.scatter[r, c], math.sqrt((dev**2).sum() / max(len(dev) - 3, 1)), atol=2e-5)


def test_too_few_cells_or_cells_in_a_line_make_no_plane() -> None:
    h = np.full(SHAPE, np.nan, np.float32)
    h[10, :] = 1.0
    got = footprint_of(h, 0.5, CELL)
    assert np.isnan(got.level).all()
    assert np.isnan(got.roughness).all()


@pytest.mark.parametrize("holes", [0.0, 0.3])
def test_steps_and_rotor_margin_agree_with_a_search(holes: float) -> None:
    h = rough_ground(3, holes)
    step = step_of(h, 0.4, CELL)
    lander = Lander(radius=0.3, rotor_radius=0.6)
    fp = footprint_of(h, 0.3, CELL)
    sigma = np.random.default_rng(9).uniform(0.01, 0.05, SHAPE).astype(np.float32)
    margin = rotor_margin(h, sigma, fp, lander, CELL)
    pad = np.pad(h, 1, constant_values=np.nan)
    around = np.stack([pad[:-2, 1:-1], pad[2:, 1:-1], pad[1:-1, :-2], pad[1:-1, 2:]])
    local = np.where(np.isnan(h), np.nan, np.fmax.reduce(np.abs(around - h), axis=0, initial=0.0))
    for r, c in [(0, 0), (11, 14), (22, 28), (5, 27), (17, 3)]:
        rr, cc = cells_in_disc(r, c, 0.4)
        assert_allclose(step[r, c], np.nanmax(local[rr, cc]), atol=1e-6)
        rr, cc = cells_in_disc(r, c, 0.6)
        ring = np.hypot(rr - r, cc - c) * CELL > 0.3 + 1e-9
        rr, cc = rr[ring], cc[ring]
        over = h[rr, cc] - (fp.level[r, c] + fp.grad_c[r, c] * (cc - c) + fp.grad_r[r, c] * (rr - r))
        assert_allclose(margin[r, c], np.nanmin((lander.rotor_rise - over) / sigma[rr, cc]), atol=2e-3)


def contacts(h: np.ndarray, r: int, c: int, lander: Lander, k: int) -> np.ndarray | None:
    """Offsets and contact height of every foot at one heading, (feet, 3); None if a height is unknown."""
    feet, points = feet_of(lander, CELL), []
    for f in range(feet.xy.shape[1]):
        under = np.array([r, c]) + feet.offsets[feet.starts[k, f] : feet.starts[k, f + 1]]
        if (under < 0).any() or (under >= SHAPE).any() or np.isnan(h[tuple(under.T)]).any():
            return None
        ground = h[tuple(under.T)].astype(np.float64)
        points.append([*feet.xy[k, f] * CELL, ground.mean() if lander.foot_contact == "mean" else ground.max()])
    return np.array(points)


def carrying(points: np.ndarray, support: str) -> list[np.ndarray]:
    """Planes (gx, gy, a) through three feet around the centre, above which no other foot's ground rises."""
    planes = []
    for three in combinations(points, 3):
        A = np.array(three)
        held = np.linalg.solve(np.vstack([A[:, :2].T, np.ones(3)]), [0, 0, 1])
        plane = np.linalg.solve(np.column_stack([A[:, :2], np.ones(3)]), A[:, 2])
        over = points[:, 2] - np.column_stack([points[:, :2], np.ones(len(points))]) @ plane
        if support == "any" or ((held > -1e-6).all() and (over < 1e-6).all()):
            planes.append(plane)
    return planes


def brute_feet(h: np.ndarray, r: int, c: int, lander: Lander) -> tuple[float, float]:
    """Worst tilt and worst rise over headings and planes by the definition; NaN if a foot is unknown."""
    tilts, rises = [], []
    rr, cc = cells_in_disc(r, c, lander.radius)
    for k in range(len(feet_of(lander, CELL).xy)):
        points = contacts(h, r, c, lander, k)
        if points is None:
            return math.nan, math.nan
        for gx, gy, a in carrying(points, lander.support):
            tilts.append(math.atan(math.hypot(gx, gy)))
            rises.append(np.nanmax(h[rr, cc] - a - gx * (cc - c) * CELL - gy * (rr - r) * CELL))
    return max(tilts), max(rises)


SQUARE = ((0.3, 0.3), (0.3, -0.3), (-0.3, 0.3), (-0.3, -0.3))
FIVE = ((0.35, 0.0), (0.1, 0.3), (0.1, -0.3), (-0.3, 0.2), (-0.3, -0.2))


@pytest.mark.parametrize("support", first(1, ["resting", "any"]))
@pytest.mark.parametrize(("feet", "contact"), [(SQUARE, "highest"), (SQUARE, "mean"), (FIVE, "highest")])
def test_feet_agree_with_the_definition_at_every_heading(feet: object, contact: str, support: str) -> None:
    h = rough_ground(4, 0.004)
    gear = {"feet": feet, "foot_radius": 0.11, "foot_contact": contact, "support": support}
    lander = Lander(radius=0.4, belly_clearance=0.12, headings=3, **gear)  # type: ignore[arg-type]
    fp = footprint_of(h, lander.radius, CELL)
    tilt, rise = gear_contact(h, fp, np.zeros(SHAPE, bool), lander, CELL, spare=0.05)
    judged = 0
    for r in range(0, SHAPE[0], 2):
        for c in range(r % 4 // 2, SHAPE[1], 2):
            want_tilt, want_rise = brute_feet(h, r, c, lander)
            assert_allclose(tilt[r, c], want_tilt, atol=1e-4)
            if math.isfinite(want_rise):
                judged += 1
                assert_allclose(np.clip(rise[r, c], 0.07, 0.17), np.clip(want_rise, 0.07, 0.17), atol=1e-4)
    assert judged > 12


def test_a_lander_that_looks_the_same_is_judged_once() -> None:
    assert len(unlike_directions(8, np.array(SQUARE))) == 2
    assert len(unlike_directions(20, np.array(SQUARE))) == 5
    assert len(unlike_directions(8, np.array(FIVE))) == 8
    assert len(unlike_directions(7, np.array(SQUARE))) == 7  # none of the seven is a quarter turn from another


@pytest.mark.parametrize("radius", [0.0, 1.0, 4.0, 7.07, 18.3])
def test_blocks_cover_the_disc(radius: float) -> None:
    spans = disc_spans(radius)
    n = spans.size // 2
    covered = np.zeros((2 * n + 9, 2 * n + 9), bool)
    for r, c in block_starts(spans, 4):
        covered[r + n : r + n + 4, c + n : c + n + 4] = True
    assert covered[: 2 * n + 1, : 2 * n + 1][disc_mask(spans) > 0].all()


def resting_skids(h: np.ndarray, r: int, c: int, lander: Lander) -> float:
    """Tilt of the lowest plane over the centre that lies above both rails, by a linear programme."""
    s = skids_of(lander, CELL)
    left = np.array([s.axes[0, 1], -s.axes[0, 0]])
    rows = []
    for side, sign in ((0, 1), (1, -1)):
        for i, (dr, dc) in enumerate(s.offsets[0, side]):
            xy = s.along[0, i] * s.axes[0] + sign * s.gauge[0] / 2 * left
            rows.append([*xy, h[r + dr, c + dc] / CELL])
    A = np.array(rows)
    got = linprog(
        [1, 0, 0], A_ub=-np.column_stack([np.ones(len(A)), A[:, :2]]), b_ub=-A[:, 2], bounds=[(None, None)] * 3
    )
    return math.atan(math.hypot(*got.x[1:]))


def test_the_tilt_of_skids_bounds_that_of_the_lander_at_rest() -> None:
    h = rough_ground(5, 0.0)
    lander = Lander(radius=0.5, skids=(0.8, 0.6), headings=1)
    tilt, _ = gear_contact(h, footprint_of(h, 0.5, CELL), np.zeros(SHAPE, bool), lander, CELL)
    rest = [(tilt[r, c], resting_skids(h, r, c, lander)) for r in range(5, 18, 3) for c in range(5, 24, 3)]
    assert all(t >= s - 1e-4 for t, s in rest)
    assert np.median([t - s for t, s in rest]) < math.radians(0.2)  # and is mostly equal to it
    assert np.isnan(tilt[0, 0])  # one rail is off the map


def resting_pitch(along: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[float, float]:
    """Range of the pitches at which the rest of one lander is lowest."""
    rails = (np.ascontiguousarray(a[:, None], dtype=np.float32) for a in (left, right))
    low, high = resting_pitches(*rails, along[1] - along[0])
    return float(low[0]), float(high[0])


def brute_skids(h: np.ndarray, r: int, c: int, lander: Lander) -> tuple[float, float]:
    """Worst tilt and worst rise over headings, from the lowest height over the middle by a linear programme."""
    s, tilts, rises = skids_of(lander, CELL), [], []
    rr, cc = cells_in_disc(r, c, lander.radius)
    for k, (ax, ay) in enumerate(s.axes):
        under = np.array([r, c]) + s.offsets[k]  # (2, n, 2)
        if (under < 0).any() or (under >= SHAPE).any() or np.isnan(h[under[..., 0], under[..., 1]]).any():
            return math.nan, math.nan
        rails = h[under[..., 0], under[..., 1]].astype(np.float64) / CELL
        sums, places = (rails[0][:, None] + rails[1]).ravel(), (s.along[k][:, None] + s.along[k]).ravel()
        A = -np.column_stack([np.ones(len(sums)), places])  # height over the middle + pitch * place >= sum
        rest = linprog([1, 0], A_ub=A, b_ub=-sums, bounds=[(None, None)] * 2).fun
        ends = [linprog([0, w], A_ub=A, b_ub=-sums, bounds=[(None, rest + 1e-7), (None, None)]).x[1] for w in (1, -1)]
        steep = []
        for pitch in ends:
            over = (rails - pitch * s.along[k]).max(axis=1)
            roll = (over[0] - over[1]) / s.gauge[k]
            steep.append((abs(pitch), abs(roll)))
            plane = over.mean() + (pitch * ax + roll * ay) * (cc - c) + (pitch * ay - roll * ax) * (rr - r)
            rises.append(np.nanmax(h[rr, cc] - plane * CELL))
        tilts.append(math.atan(math.hypot(*np.max(steep, axis=0))))
    return max(tilts), max(rises)


def test_skids_agree_with_the_definition_at_every_heading() -> None:
    h = rough_ground(6, 0.002)
    lander = Lander(radius=0.5, skids=(0.8, 0.6), belly_clearance=0.12, headings=3)
    tilt, rise = gear_contact(h, footprint_of(h, 0.5, CELL), np.zeros(SHAPE, bool), lander, CELL, spare=0.05)
    judged = 0
    for r in range(0, SHAPE[0], 2):
        for c in range(r % 4 // 2, SHAPE[1], 2):
            want_tilt, want_rise = brute_skids(h, r, c, lander)
            assert_allclose(tilt[r, c], want_tilt, atol=1e-4)
            if math.isfinite(want_rise):
                judged += 1
                assert_allclose(np.clip(rise[r, c], 0.07, 0.17), np.clip(want_rise, 0.07, 0.17), atol=1e-4)
    assert judged > 30


@pytest.mark.parametrize("seed", range(8))
def test_rails_settle_where_the_lander_lies_lowest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along, left, right = np.linspace(-4, 4, 9), rng.normal(0, 1, 9), rng.normal(0, 1, 9)
    low, high = resting_pitch(along, left, right)
    rails = np.concatenate([left, right])
    lever = -np.tile(along, 2)
    select = np.kron(np.eye(2), np.ones((9, 1)))
    A = -np.column_stack([select, -lever])
    got = linprog([1, 1, 0], A_ub=A, b_ub=-rails, bounds=[(None, None)] * 3)
    for pitch in (low, high):
        assert_allclose((left - pitch * along).max() + (right - pitch * along).max(), got.fun, atol=1e-4)
    assert low <= high
    assert low - 1e-4 <= got.x[2] <= high + 1e-4


def test_a_lander_rocks_over_mirrored_bumps() -> None:
    along = np.linspace(-4, 4, 9)
    left, right = np.where(along == 2, 1.0, 0.0), np.where(along == -2, 1.0, 0.0)
    low, high = resting_pitch(along, left, right)
    # f = max(1 - 2 b, 4 |b|) + max(1 + 2 b, 4 |b|) is level at 2 as far as 1 - 2 |b| >= 4 |b|
    assert_allclose([low, high], [-1 / 6, 1 / 6], atol=1e-4)


def flooded_by_queue(surface: np.ndarray, outlet: np.ndarray) -> np.ndarray:
    """Priority flood (Barnes 2014): another algorithm with the same result."""
    water = np.full(surface.shape, np.inf)
    queue = [(float(surface[p]), p) for p in map(tuple, np.argwhere(outlet))]
    for level, p in queue:
        water[p] = level
    heapq.heapify(queue)
    while queue:
        level, (r, c) = heapq.heappop(queue)
        for q in range(max(0, r - 1), min(surface.shape[0], r + 2)):
            for p in range(max(0, c - 1), min(surface.shape[1], c + 2)):
                new = max(level, float(surface[q, p]))
                if new < water[q, p]:
                    water[q, p] = new
                    heapq.heappush(queue, (new, (q, p)))
    return water


@pytest.mark.parametrize("seed", range(3))
def test_basins_fill_to_where_they_spill(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = rng.normal(0, 1, (17, 13)).astype(np.float32)
    surface[rng.random(surface.shape) < 0.05] = np.inf
    outlet = np.zeros(surface.shape, bool)
    outlet[0, 3:9] = outlet[-1, ::4] = True
    outlet &= np.isfinite(surface)
    water = np.empty_like(surface)
    fill_basins(surface, outlet, water)
    assert_allclose(water, flooded_by_queue(surface, outlet))


def test_the_disc_holds_every_cell_whose_centre_lies_within_the_radius() -> None:
    for radius in (0.0, 0.5, 1.0, 3.0, 7.07, 15.0):
        n = math.floor(radius + 1e-6)
        r, c = np.mgrid[-n : n + 1, -n : n + 1]
        assert (disc_mask(disc_spans(radius)) == (np.hypot(r, c) <= radius + 1e-6)).all()
    assert disc_mask(disc_spans(1.5 / 0.1)).sum() == 709  # the rim's own cells are in, for any rounding of 1.5 / 0.1


def test_a_mask_spreads_by_the_disc() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[10, 10] = True
    r, c = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert (disc_any(mask, 0.5, CELL) == (np.hypot(r - 10, c - 10) <= 5)).all()
