"""The parallax kernels against plain NumPy: random, planar, stepped and holed input; one thread and two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
import pytest
import twins
from lenses import LENSES, each_lens
from numpy.testing import assert_allclose, assert_array_equal

from alight.arrays import FAR
from alight.geometry import Camera, Grid, Pose, ground_projection, so3_exp
from alight.parallax import gauss_newton_kernels as parallax
from alight.parallax import orthophoto_kernels as ortho
from alight.parallax import projection_kernels as projection
from alight.parallax import sweep_kernels as sweep
from alight.parallax import view_kernels as sight
from alight.parallax import visibility_kernels as surface
from alight.parallax.sorting_kernels import fill_row, median_row, network, sort_rows
from alight.parallax.views import radius2_limit

N, ROWS, COLS, DEPTH = 6, 17, 19, 12
WIDE = 35, 131  # more than the share of one thread
CELL = 0.1
XS, YS = 3.0 + CELL * np.arange(COLS), -2.0 - CELL * np.arange(ROWS)
FOCAL = np.array([90.0, 110.0, 100.0, 130.0, 95.0, 120.0])  # px
CENTRES = np.array([[x, y, 20.0 + 0.1 * x] for x, y in [(0, 0), (2, 0.5), (4, -2), (6, -4), (3.5, -3), (9, 1)]], float)
KINDS = ("random", "planar", "step", "holes", "nothing")
kinds = pytest.mark.parametrize("kind", KINDS)


def heights(kind: str, shape: tuple[int, int] = (ROWS, COLS)) -> np.ndarray:
    """Return a map of each kind of input."""
    rng = np.random.default_rng(KINDS.index(kind))
    r, c = np.mgrid[: shape[0], : shape[1]]
    h = {"random": rng.normal(0, 0.3, shape), "planar": 0.05 * r - 0.03 * c}.get(kind, 0.01 * c + 0.0 * r)
    if kind == "step":
        h = h + 1.5 * (c > 9)
    h = h.astype(np.float32)
    if kind == "holes":
        h[rng.random(h.shape) < 0.3] = np.nan
    if kind == "nothing":
        h[:] = np.nan
    return h


def stack(kind: str, shape: tuple[int, int] = (ROWS, COLS)) -> np.ndarray:
    """Samples of N views: a common texture, noise, outliers and holes."""
    rng = np.random.default_rng(10 + KINDS.index(kind))
    common = 0.0 * rng.normal(size=shape) if kind == "planar" else rng.normal(size=shape)
    s = common + rng.normal(0, 0.2, (N, *shape))
    s[rng.random(s.shape) < 0.1] += 3.0
    if kind == "step":
        s[:3, :, 9:] = np.nan  # half of the views do not see one side
        s[:, :, -1] = s[:1, :, -1]  # all are the same
    if kind in ("holes", "nothing"):
        s[rng.random(s.shape) < (0.6 if kind == "holes" else 1.1)] = np.nan
    return s.astype(np.float32)


def positive(seed: int, scale: float, zeros: float = 0.0, shape: tuple[int, int] = WIDE) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = scale * rng.gamma(2.0, size=shape)
    out[rng.random(out.shape) < zeros] = 0.0
    return out.astype(np.float32)


def same_nan(got: np.ndarray, want: np.ndarray, **tolerance: float) -> None:
    """Assert equality within a tolerance, and NaN in the same cells."""
    assert_array_equal(np.isnan(got), np.isnan(want))
    assert_allclose(got, want, equal_nan=True, **tolerance)


# -- calls of the kernels that return new arrays


def run_sweep_cost(s: np.ndarray, keep: float) -> tuple[np.ndarray, ...]:
    """Cost of pictures whose pixels are the cells, except for a border that the neighbours need."""
    pictures = np.pad(s, ((0, 0), (1, 2), (1, 2)), constant_values=0.0)
    return run_shifted_cost(pictures, keep, np.ones(len(s)), np.ones((len(s), 2)), s.shape[1:])


def run_shifted_cost(
    pictures: np.ndarray, keep: float, scale: np.ndarray, shift: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, ...]:
    cost, count = np.full(shape, -9, np.float32), np.full(shape, -9, np.int32)
    spans = np.zeros(shape, np.int32), np.full(shape, 9, np.int32)
    sweep.sweep_cost(pictures, scale, shift, network(len(pictures)), keep, np.float32(1.5), *spans, 4, cost, count)
    return cost, count


TAU = np.float32(0.35)  # as the stage passes it: another type is compiled anew
PLACE = np.array([-0.31, 0.27, 4.0, -3.0, 20.0])


def run_splat(kind: str) -> tuple[np.ndarray, ...]:
    found = heights(kind)
    out = np.full((2, ROWS - 3, COLS - 2), np.nan, np.float32)
    sweep.splat(found, positive(6, 1.0, shape=found.shape), 0.1, CELL, PLACE, out[0], out[1])
    return out[0], out[1]


def run_normalise(reach: int) -> tuple[np.ndarray, ...]:
    out = np.full(WIDE, -9, np.float32)
    sight.normalise(grey_levels(), reach, 3.0, out)
    return (out,)


def grey_levels() -> np.ndarray:
    grey = np.random.default_rng(3).normal(120, 30, WIDE).astype(np.float32)
    grey[:, 40:60] = 200.0  # no contrast to stretch
    return grey


def run_template(s: np.ndarray) -> tuple[np.ndarray, ...]:
    weights, mean = np.full(s.shape, -9, np.float32), np.full(s.shape[1:], -9, np.float32)
    parallax.template(s, network(len(s)), TAU, weights, mean)
    return weights, mean


def run_normal_equations(s: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return template, number of views that agree, Lambda, eta, s2, and number of views that see."""
    mean, *out = (np.full(h.shape, -9, np.float32) for _ in range(4))
    used, seen = np.full(h.shape, 99, np.uint8), np.full(h.shape, 99, np.uint8)
    xs, ys = XS[0] + CELL * np.arange(h.shape[1]), YS[0] - CELL * np.arange(h.shape[0])
    parallax.normal_equations(s, network(len(s)), TAU, CENTRES[: len(s)], xs, ys, h, CELL, mean, used, seen, *out)
    return mean, used, *out, seen


def run_solve(h: np.ndarray) -> tuple[np.ndarray, ...]:
    out = tuple(np.full(h.shape, -9, np.float32) for _ in range(3))
    parallax.solve_window(*solve_input(h), h, positive(4, 0.1), 0.5, *out)
    return out


def solve_input(h: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return Lambda, eta and s2, without information where the height is unknown, as from `normal_equations`."""
    unknown = np.isnan(h)
    eta = np.random.default_rng(5).normal(0, 3, h.shape).astype(np.float32)
    lam = np.where(unknown, np.float32(0), positive(1, 30.0, zeros=0.2))
    nothing = lam == 0
    return lam, np.where(nothing, np.float32(0), eta), np.where(nothing, np.float32(0), positive(2, 0.05))


def run_prior(h: np.ndarray, args: tuple[np.ndarray, ...] | None = None) -> tuple[np.ndarray, ...]:
    out = np.full(h.shape, -9, np.float32)
    args = args or (positive(6, 200.0, zeros=0.3), positive(7, 0.05), positive(8, 0.05))
    surface.plane_prior(h, *args, 100.0, out)
    return (out,)


def run_block_tops(h: np.ndarray) -> tuple[np.ndarray, ...]:
    out = np.full((-(-h.shape[0] // 8), -(-h.shape[1] // 8)), -9, np.float32)
    surface.block_tops(h, 8, np.float32(-1e4), out)
    return (out,)


def run_visibility(h: np.ndarray, margin: float = 0.02, top_row: int = 0, left: int = 0) -> tuple[np.ndarray, ...]:
    low = CENTRES * [1, 1, 0.2]  # four metres up: walls hide something
    part = h.shape[0] - top_row, h.shape[1] - left
    out = np.full((N, *part), 9, np.uint8)
    top = np.float32(np.nanmax(h)) if np.isfinite(h).any() else np.float32(0)
    tops = np.full((-(-ROWS // 8), -(-COLS // 8)), top, np.float32)
    surface.visibility(h, tops, 8, low, XS, YS, CELL, np.full(part, margin, np.float32), top_row, left, out)
    return (out,)


def run_seen_from(columns: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, ...]:
    baseline, per_px, sampling = (np.full(level.shape, -9, np.float32) for _ in range(3))
    count, n = np.full(level.shape, 99, np.uint8), len(columns)
    sight.seen_from(columns, CENTRES[:n], FOCAL[:n], XS, YS, level, CELL, baseline, count, per_px, sampling)
    return baseline, count, per_px, sampling


def columns_of(kind: str) -> np.ndarray:
    """Return columns of the pictures, for some cells outside of each picture."""
    s = stack(kind)
    return np.where(np.isfinite(s), np.abs(s), np.float32(-1e4))


def volume(kind: str) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(20 + KINDS.index(kind))
    cost = rng.uniform(0.1, 1.0, (ROWS, COLS, DEPTH))
    if kind == "planar":
        cost = np.abs(np.arange(DEPTH) - (2 + 0.3 * np.arange(COLS)[:, None])) * np.ones((ROWS, 1, 1)) + 0.1
    if kind == "step":
        cost[:] = 0.5  # no minimum anywhere: ties
        cost[:, :9, 3] = 0.1
    return cost.astype(np.float32), rng.normal(size=(ROWS, COLS)).astype(np.float32)


Spans = tuple[np.ndarray, np.ndarray, np.ndarray]


def whole() -> Spans:
    """Spans that contain all planes in every cell."""
    shape = ROWS, COLS
    return np.zeros(shape, np.int32), np.full(shape, DEPTH - 1, np.int32), DEPTH * np.arange(ROWS * COLS).reshape(shape)


def ragged() -> Spans:
    """Spans that differ from cell to cell; some have no plane in common with their neighbours."""
    rng = np.random.default_rng(5)
    low = rng.integers(0, DEPTH, (ROWS, COLS)).astype(np.int32)
    high = np.minimum(low + rng.integers(0, DEPTH, low.shape), DEPTH - 1).astype(np.int32)
    sizes = (high - low + 1).astype(np.int64)
    return low, high, sizes.cumsum().reshape(low.shape) - sizes


def packed(values: np.ndarray, spans: Spans) -> np.ndarray:
    """Return the values (R, C, D) within the spans, one cell after the other."""
    planes = np.arange(values.shape[2])
    return np.ascontiguousarray(values[(spans[0][..., None] <= planes) & (planes <= spans[1][..., None])])


def run_aggregate(kind: str, spans: Spans | None = None) -> tuple[np.ndarray, ...]:
    cost, image = volume(kind)
    spans = spans or whole()
    own = packed(cost, spans)
    halves = np.full((2, own.size), -9, np.float32)
    sweep.aggregate(own, *spans, image, np.float32(0.05), np.float32(0.5), np.float32(0.5), halves)
    return (halves.sum(axis=0),)


def run_winner(kind: str) -> tuple[np.ndarray, ...]:
    cost, _ = volume(kind)
    count = np.full((ROWS, COLS), 4, np.int32)
    count[2:5, 3:7] = 1
    index, ratio = np.empty((ROWS, COLS), np.float32), np.empty((ROWS, COLS), np.float32)
    sweep.winner(run_aggregate(kind)[0], packed(cost, whole()), *whole(), count, index, ratio)
    return index, ratio


def run_store(spans: Spans) -> tuple[np.ndarray, ...]:
    cost, _ = volume("random")
    out = np.full(int((spans[1] - spans[0] + 1).sum()), -9, np.float32)
    for k in range(DEPTH):
        sweep.store(np.ascontiguousarray(cost[:, :, k]), k, *spans, out)
    return (out,)


# -- against the twins


@kinds
@pytest.mark.parametrize("keep", [0.5, 0.7, 1.0])
def test_sweep_cost(kind: str, keep: float) -> None:
    s = stack(kind)
    cost, count = run_sweep_cost(s, keep)
    known = np.array([twins.sampled(np.pad(v, (1, 2)), 1.0, 1.0, 1.0, v.shape) for v in s])  # NaN spoils its neighbours
    want, seen = twins.sweep_cost(known, keep, 1.5)
    assert_array_equal(count, seen)
    assert_allclose(cost, want, rtol=2e-5, atol=1e-6)


def test_sweep_cost_of_pictures_that_are_shifted_and_scaled() -> None:
    pictures = stack("random", (ROWS + 9, COLS + 11))
    scale, shift = 1.0 + 0.02 * np.arange(N), np.column_stack([np.linspace(-1.3, 6.4, N), np.linspace(7.9, 0.2, N)])
    cost, count = run_shifted_cost(pictures, 0.7, scale, shift, (ROWS, COLS))
    samples = np.array([twins.sampled(*a, (ROWS, COLS)) for a in zip(pictures, scale, *shift.T, strict=True)])
    want, seen = twins.sweep_cost(samples, 0.7, 1.5)
    assert_array_equal(count, seen)
    assert 0 < np.isnan(samples).mean() < 0.5
    assert_allclose(cost, want, rtol=1e-4, atol=1e-5)


@kinds
def test_splat(kind: str) -> None:
    got = run_splat(kind)
    found = heights(kind)
    want = twins.splat(found, positive(6, 1.0, shape=found.shape), 0.1, CELL, PLACE, got[0].shape)
    same_nan(got[0], want[0], rtol=1e-6)
    same_nan(got[1], want[1], rtol=1e-6)


def test_sweep_cost_does_not_mind_one_occluded_view_in_six() -> None:
    s = np.full((6, 9, 9), 0.4, np.float32)
    s[2] = 5.0
    assert run_sweep_cost(s, 0.7)[0][4, 4] == 0.0
    assert run_sweep_cost(s, 1.0)[0][4, 4] > 0.2


@pytest.mark.parametrize("n", range(1, 33))
def test_networks_sort_and_find_the_median(n: int) -> None:
    rng = np.random.default_rng(n)
    samples = rng.normal(size=(n, 40)).astype(np.float32)
    samples[rng.random(samples.shape) < 0.3] = np.nan
    samples[0, :5] = np.float32(0.5)  # never empty, and with ties
    rows, count, median = np.empty_like(samples), np.zeros(40, np.float32), np.empty(40, np.float32)
    for s, row in zip(samples, rows, strict=True):
        fill_row(s, row, count)
    sort_rows(rows, network(n))
    assert_array_equal(rows, np.sort(np.where(np.isnan(samples), FAR, samples), axis=0))
    median_row(rows, count, median)
    seen = count > 0
    assert_array_equal(count, np.isfinite(samples).sum(axis=0))
    assert_allclose(median[seen], np.nanmedian(samples[:, seen], axis=0), rtol=1e-6)


@kinds
def test_aggregate(kind: str) -> None:
    cost, image = volume(kind)
    want = twins.aggregate(cost.astype(np.float64), image.astype(np.float64), 0.05, 0.5, 0.5)
    assert_allclose(run_aggregate(kind)[0], packed(want, whole()), rtol=1e-5, atol=1e-5)


@kinds
def test_aggregate_of_cells_with_planes_of_their_own(kind: str) -> None:
    cost, image = volume(kind)
    spans = ragged()
    planes = np.arange(DEPTH)
    has = (spans[0][..., None] <= planes) & (planes <= spans[1][..., None])
    want = twins.aggregate(np.where(has, cost.astype(np.float64), np.inf), image.astype(np.float64), 0.05, 0.5, 0.5)
    assert_allclose(run_aggregate(kind, spans)[0], packed(want, spans), rtol=1e-5, atol=1e-5)


def test_sweep_cost_of_some_cells_is_that_of_all() -> None:
    s = stack("holes")
    want, seen = run_sweep_cost(s, 0.7)
    pictures, shape = np.pad(s, ((0, 0), (1, 2), (1, 2)), constant_values=0.0), s.shape[1:]
    low, high = np.zeros(shape, np.int32), np.full(shape, 3, np.int32)
    some = np.zeros(shape, bool)
    some[2, 1:3], some[5, ::2], some[-1, -1] = True, True, True
    high[some] = 4
    cost, count = np.full(shape, -9, np.float32), np.full(shape, -9, np.int32)
    scale, shift = np.ones(len(s)), np.ones((len(s), 2))
    sweep.sweep_cost(pictures, scale, shift, network(len(s)), 0.7, np.float32(1.5), low, high, 4, cost, count)
    assert_array_equal(cost[some], want[some])
    assert_array_equal(count[some], seen[some])
    assert (cost[0] == -9).all()


@pytest.mark.parametrize("spans", [whole(), ragged()], ids=["whole", "ragged"])
def test_store(spans: Spans) -> None:
    means = cv2.blur(volume("random")[0], (3, 3))
    assert_allclose(run_store(spans)[0], packed(means, spans), rtol=1e-5)


@kinds
def test_winner(kind: str) -> None:
    cost, _ = volume(kind)
    count = np.full((ROWS, COLS), 4)
    count[2:5, 3:7] = 1
    total = run_aggregate(kind)[0].reshape(cost.shape)
    index, ratio = twins.winner(total.astype(np.float64), cost.astype(np.float64), count)
    got = run_winner(kind)
    same_nan(got[0], index, atol=2e-3)
    same_nan(got[1], ratio, rtol=1e-5)
    assert np.isnan(got[0]).sum() == 12


def test_winner_finds_the_vertex_of_a_parabola_from_the_first_plane_of_the_cell() -> None:
    cost = (0.1 + (np.arange(DEPTH) - 4.3) ** 2).astype(np.float32)
    index, ratio = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    low = np.full((1, 1), 20, np.int32)
    spans = low, low + DEPTH - 1, np.zeros((1, 1), np.int64)
    sweep.winner(cost, cost, *spans, np.full((1, 1), 2, np.int32), index, ratio)
    assert index[0, 0] == pytest.approx(24.3, abs=1e-5)
    assert ratio[0, 0] == pytest.approx(cost[4] / cost.max(), rel=1e-5)  # no second valley: the worst cost counts


@pytest.mark.parametrize("reach", [2, 3, 5])
def test_normalise(reach: int) -> None:
    assert_allclose(run_normalise(reach)[0], twins.normalised(grey_levels(), reach, 3.0), atol=2e-3)


@kinds
def test_block_tops(kind: str) -> None:
    h = heights(kind, WIDE)
    filled = np.pad(np.where(np.isnan(h), -1e4, h), [(0, 5), (0, 5)], constant_values=-1e4)
    want = filled.reshape(5, 8, 17, 8).max(axis=(1, 3)).astype(np.float32)
    assert_array_equal(run_block_tops(h)[0], want)


@kinds
def test_template(kind: str) -> None:
    s = stack(kind)
    weights, mean = run_template(s)
    want = twins.template(s, 0.35)
    assert_allclose(weights, want[0], rtol=1e-4, atol=1e-5)
    same_nan(mean, want[1], rtol=1e-3, atol=1e-5)  # weights near zero


@kinds
@pytest.mark.parametrize("views", [1, N])
def test_seen_from(kind: str, views: int) -> None:
    columns, level = columns_of(kind)[:views], np.nan_to_num(heights(kind))
    baseline, count, per_px, sampling = run_seen_from(columns, level)
    seen = columns >= 0
    assert_array_equal(count, seen.sum(axis=0))
    for r, c in np.ndindex(ROWS, COLS):
        who, drop = CENTRES[:views][seen[:, r, c]], CENTRES[:views, 2].mean() - level[r, c]
        b = np.linalg.norm(np.ptp(who[:, :2], axis=0)) if len(who) else 0.0
        assert baseline[r, c] == pytest.approx(b, rel=1e-6)
        assert per_px[r, c] == pytest.approx(CELL * drop / max(b, 0.01 * drop), rel=1e-5)
        pixels = np.linalg.norm(who - [XS[c], YS[r], level[r, c]], axis=1) / FOCAL[:views][seen[:, r, c]]
        second = np.sort(pixels)[min(1, views - 1) :][:1]
        assert sampling[r, c] == pytest.approx(max(second[0], CELL) if len(second) else np.nan, rel=1e-5, nan_ok=True)


@kinds
@pytest.mark.parametrize("views", [2, 5, 6])
def test_normal_equations(kind: str, views: int) -> None:
    s, h = stack(kind, WIDE)[:views], np.nan_to_num(heights(kind if kind != "nothing" else "planar", WIDE))
    xs, ys = XS[0] + CELL * np.arange(h.shape[1]), YS[0] - CELL * np.arange(h.shape[0])
    mean, used, *sums, seen = run_normal_equations(s, h)
    want = twins.normal_equations(s, 0.35, CENTRES[:views], xs, ys, h, CELL)
    same_nan(mean, want[0], rtol=1e-3, atol=1e-5)  # weights near zero
    assert_array_equal(used, want[1])
    assert_array_equal(seen, np.isfinite(s).sum(axis=0))
    for got, w in zip(sums, want[2:], strict=True):
        assert_allclose(got, w, rtol=2e-3, atol=2e-5 * (1 + np.abs(w).max()))
    assert (want[2] > 0).any() == (kind != "nothing" and (views > 2 or kind != "holes"))


@kinds
def test_normal_equations_where_the_height_is_unknown(kind: str) -> None:
    """A cell without a height has no samples either, so that no NaN gets into the sums."""
    h = heights(kind)
    s = stack(kind)
    s[:, np.isnan(h)] = np.nan
    for a in run_normal_equations(s, h)[2:5]:
        assert np.isfinite(a).all()
        assert (a[np.isnan(h)] == 0).all()


@kinds
def test_solve(kind: str) -> None:
    h = heights(kind, WIDE)
    want = twins.solve(*solve_input(h), h, positive(4, 0.1), 0.5)
    for got, w in zip(run_solve(h), want, strict=True):
        assert_allclose(got, w, rtol=1e-4, atol=1e-5)


@kinds
def test_plane_prior(kind: str) -> None:
    h = heights(kind, WIDE)
    want = twins.plane_prior(h, positive(6, 200.0, zeros=0.3), positive(7, 0.05), positive(8, 0.05), 100.0)
    same_nan(run_prior(h)[0], want, atol=4e-5)


def test_plane_prior_leaves_a_plane_alone_and_pulls_a_spike() -> None:
    """With any certainty of the neighbours, the middle of a pair on a slope is the height."""
    h = heights("planar", WIDE)
    even = tuple(np.full(h.shape, v, np.float32) for v in (200.0, 0.05, 0.05))
    inner = np.s_[3:-3, 3:-3]
    assert_allclose(run_prior(h, even)[0][inner], h[inner], atol=1e-6)
    assert_allclose(run_prior(h)[0][inner], h[inner], atol=1e-6)
    spiked = h.copy()
    spiked[8, 9] += 0.02
    assert 0.0 < run_prior(spiked, even)[0][8, 9] - h[8, 9] < 0.016
    spiked[8, 9] += 0.03  # a whole parallax pixel: a step and no noise
    assert run_prior(spiked, even)[0][8, 9] == spiked[8, 9]


@kinds
def test_visibility(kind: str) -> None:
    h = heights(kind)
    got = run_visibility(h)[0]
    assert_array_equal(got, twins.visibility(h, CENTRES * [1, 1, 0.2], XS, YS, CELL, 0.02))
    assert (got == 0).any() == (kind in ("random", "step"))
    assert_array_equal(run_visibility(h, top_row=5, left=3)[0], got[:, 5:, 3:])


# -- projection

DOWN = so3_exp([0.2, -0.1, 0.7]) @ np.diag([1.0, -1.0, -1.0])  # a camera that looks down, slightly tilted


def run_project(
    camera: Camera, h: np.ndarray, grid: Grid, world_from_cam: Pose, rolling: Sequence[float] = ()
) -> tuple[np.ndarray, ...]:
    xs, ys = grid.xy()
    H, b = ground_projection(world_from_cam)
    intrinsics = np.array([camera.fu, camera.fv, camera.cu, camera.cv])
    maps = tuple(np.full(h.shape, -9, np.float32) for _ in range(2))
    size = float(camera.width), float(camera.height)
    rolls = np.array(rolling, dtype=np.float64)
    projection.project_grid(
        H, b, intrinsics, camera.coefficients, camera.code, radius2_limit(camera), *size, rolls, xs, ys, h, *maps
    )  # fmt: skip
    return maps


@each_lens
def test_project_is_the_camera(camera: Camera) -> None:
    """Pixels agree to a thousandth inside the picture, and there are none outside of it."""
    grid = Grid(-40.0, 41.0, 0.7, 120, 110)
    h = np.random.default_rng(0).uniform(-2, 3, grid.shape).astype(np.float32)
    at = Pose(DOWN, np.array([1.0, 2.0, 30.0]))
    mx, my = run_project(camera, h, grid, at)
    x, y = np.meshgrid(*grid.xy())
    seen_from = at.inverse.apply(np.stack([x, y, h], axis=-1))
    uv = camera.project(seen_from)
    inside = (uv >= 0).all(-1) & (uv[..., 0] <= camera.width - 1) & (uv[..., 1] <= camera.height - 1)
    ideal = seen_from[..., :2] / seen_from[..., 2:]
    inside &= (ideal**2).sum(-1) < radius2_limit(camera)  # beyond it the lens polynomial folds back
    assert inside.mean() > 0.15
    assert not inside.all()
    assert_allclose(np.stack([mx, my], -1)[inside], uv[inside], atol=1e-3)
    assert (mx[~inside] == projection.OUTSIDE).all()
    assert (my[~inside] == projection.OUTSIDE).all()


@each_lens
def test_project_sees_each_row_from_where_the_camera_was(camera: Camera) -> None:
    """The pixel agrees with the fixed point of: project from the pose at the exposure of the row of the projection."""
    grid, rolling = Grid(-12.0, 13.0, 0.9, 24, 26), np.array([0.5, -0.4, 0.1, 0.02, -0.015, 0.03, 0.02, 0.03, -0.04])
    h = np.random.default_rng(0).uniform(-2, 3, grid.shape).astype(np.float32)
    at = Pose(DOWN, np.array([1.0, 2.0, 30.0]))
    maps = np.stack(run_project(camera, h, grid, at, rolling), axis=-1)
    x, y = np.meshgrid(*grid.xy())
    points, t = np.stack([x, y, h], axis=-1), np.zeros(grid.shape)
    still = camera.project(at.inverse.apply(points))
    for _ in range(6):
        p = at.inverse.apply(points) - t[..., None] * rolling[:3]
        p = np.einsum(
            "...ij,...i->...j", so3_exp(t[..., None] * rolling[3:6] + (t**2 - 1 / 12)[..., None] * rolling[6:]), p
        )
        uv = camera.project(p)
        t = (uv[..., 1] + 0.5) / camera.height - 0.5
    inside = (np.minimum(uv, still) > 3).all(-1) & (np.maximum(uv, still) < [camera.width - 4, camera.height - 4]).all(
        -1
    )
    assert inside.sum() > 50
    size = np.linalg.norm((still - uv)[inside], axis=-1).max()
    assert size > 4
    assert np.abs(maps - uv)[inside].max() < 0.01 * size


@each_lens
def test_project_shows_nothing_behind_the_camera_and_nothing_unknown(camera: Camera) -> None:
    grid = Grid(-5.0, 5.0, 0.5, 20, 20)
    up = Pose(np.eye(3), np.array([0.0, 0.0, 30.0]))
    assert (run_project(camera, np.zeros(grid.shape, np.float32), grid, up)[0] == projection.OUTSIDE).all()
    h = np.zeros(grid.shape, np.float32)
    h[3, 4] = np.nan
    mx, my = run_project(camera, h, grid, Pose(DOWN, np.array([0.0, 0.0, 30.0])))
    assert mx[3, 4] == my[3, 4] == projection.OUTSIDE
    assert (mx != projection.OUTSIDE).sum() > 300


def test_project_takes_a_single_column() -> None:
    grid = Grid(0.5, 0.5, 1.0, 3, 1)
    mx, my = run_project(LENSES["none"], np.zeros((3, 1), np.float32), grid, Pose(DOWN, np.array([0.0, 0.0, 30.0])))
    want = LENSES["none"].project(
        (Pose(DOWN, np.array([0, 0, 30.0])).inverse).apply([[0.5, 0.5 - k, 0] for k in range(3)])
    )
    assert_allclose(np.c_[mx, my], want, atol=1e-3)


# -- threads

CALLS: dict[str, Callable[[], tuple[np.ndarray, ...]]] = {
    "sweep_cost": lambda: run_sweep_cost(stack("holes"), 0.7),
    "aggregate": lambda: run_aggregate("random", ragged()),
    "store": lambda: run_store(ragged()),
    "splat": lambda: run_splat("random"),
    "winner": lambda: run_winner("random"),
    "normalise": lambda: run_normalise(2),
    "template": lambda: run_template(stack("holes", WIDE)),
    "normal_equations": lambda: run_normal_equations(stack("random", WIDE), heights("step", WIDE)),
    "seen_from": lambda: run_seen_from(columns_of("holes"), heights("step")),
    "solve_window": lambda: run_solve(heights("holes", WIDE)),
    "plane_prior": lambda: run_prior(heights("holes", WIDE)),
    "block_tops": lambda: run_block_tops(heights("step", WIDE)),
    "visibility": lambda: run_visibility(heights("step")),
    "project_grid": lambda: run_project(
        LENSES["equidistant"], heights("random"), Grid(0.0, 0.0, CELL, ROWS, COLS), Pose(DOWN, np.array([1.0, 2, 9]))
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_the_number_of_threads_changes_no_bit(name: str, on_one_and_all: Callable[..., Any]) -> None:
    for a, b in zip(*on_one_and_all(CALLS[name]), strict=True):
        assert a.tobytes() == b.tobytes()


def test_every_kernel_is_tested_here() -> None:
    made = {**vars(parallax), **vars(projection), **vars(sight), **vars(surface), **vars(sweep)}
    public = {n for n, k in made.items() if hasattr(k, "py_func") and not n.startswith("_")}
    helpers = {"fill_row", "invert_row", "median_row", "project_row", "sort_rows"}  # tested separately
    assert public - {"prange"} - helpers == set(CALLS)


@kinds
@pytest.mark.parametrize("wanted", [1, 3])
def test_the_orthophoto_adds_the_views_that_count(kind: str, wanted: int) -> None:
    """The orthophoto agrees with NumPy: nearest views first, each at the exposure of those before, no coarse views."""
    rng = np.random.default_rng(KINDS.index(kind))
    camera, grid, coarser = Camera(40, 30, 90.0, 90.0, 19.5, 14.5), Grid(0.0, 0.0, 0.8, ROWS, COLS), 1.5
    shape, (xs, ys) = grid.shape, grid.xy()
    height = np.nan_to_num(heights("random" if kind == "nothing" else kind)) + np.float32(2.0)
    total, number, finest = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, "f4")
    wants = rng.random(shape) < (0.0 if kind == "nothing" else 0.8)
    still, sums, count, best = wants.copy(), total.astype(float), number.astype(float), finest.copy()
    x, y = np.meshgrid(xs, ys)
    for scale, channels in ((1.0, 3), (1.1, 1), (1.2, 3), (2.0, 3)):
        image = cv2.GaussianBlur(rng.integers(0, 256, (30, 40, 3), dtype=np.uint8), (5, 5), 0)
        image = np.ascontiguousarray(image[..., :channels])
        tone = np.sort(rng.integers(0, 256, (256, 3)), axis=0).astype(np.uint8)
        pose = Pose(DOWN, np.array([6.0 * scale, -7.0, 2.0 + 50.0 * scale]))
        seen, use = np.zeros((*shape, 3), np.uint8), np.zeros(shape, bool)
        pixel, exposures = np.zeros(shape, np.float32), np.zeros((ROWS, ortho.EXPOSURES))
        ortho.sample_view(
            image, tone, *ground_projection(pose), np.array([90.0, 90.0, 19.5, 14.5]), camera.coefficients,
            camera.code, radius2_limit(camera), np.zeros(0), pose.translation, xs, ys, height, 2.0, coarser, wants,
            finest, total, number, seen, use, pixel, exposures,
        )  # fmt: skip
        uv = camera.project(pose.inverse.apply(np.stack([x, y, height], axis=-1))).astype(np.float32)
        shown = ((uv >= 0) & (uv <= [39, 29])).all(axis=2)
        away = np.sqrt((x - pose.translation[0]) ** 2 + (y + 7.0) ** 2 + (50.0 * scale) ** 2) / 90.0
        expected = shown & still & (away <= coarser * best)
        still &= ~(shown & (away > coarser * best))
        assert_array_equal(use, expected)
        assert_allclose(pixel[use], away[use], rtol=1e-5)
        level = cv2.remap(image.astype(np.float32), *np.moveaxis(uv, 2, 0), cv2.INTER_LINEAR).reshape(*shape, channels)
        low, high = (
            np.clip(np.rint(level + d), 0, 255).astype(int) for d in (-5.0, 5.0)
        )  # OpenCV rounds places to 1/32
        for k in range(3):
            at = min(k, channels - 1)
            assert (seen[use][:, k] >= tone[low[use][:, at], k]).all()
            assert (seen[use][:, k] <= tone[high[use][:, at], k]).all()
        both, before, now = np.split(exposures.sum(axis=0), (1, 4))
        shared = expected & (count > 0)
        assert both[0] == shared.sum()
        assert_allclose(before, (sums[shared] / count[shared][:, None]).sum(axis=0), rtol=1e-5)
        assert_array_equal(now, seen[shared].sum(axis=0))
        gain = before / np.maximum(now, 1.0) if both[0] else np.ones(3)
        ortho.add_view(seen, use, pixel, gain, wanted, total, number, finest, wants)
        sums[expected] += seen[expected] * gain
        count += expected
        still &= count < wanted
        best[expected] = np.minimum(best, pixel)[expected]
    assert_allclose(total, sums, rtol=1e-4)
    assert_array_equal(number, count)
    assert_array_equal(finest, best)
    assert_array_equal(wants, still)
    assert (number.max() == min(wanted, 3)) == (kind != "nothing")  # the coarse view is never used
