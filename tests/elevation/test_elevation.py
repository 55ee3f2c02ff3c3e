"""The elevation map: one raster for everything, the more trusted height wins, nothing is lost when tiles are packed."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from alight.elevation import FIELDS, NullStore, TiledElevation
from alight.geometry import Grid
from alight.outputs import FileStore
from alight.records import REFUSED, Flag, Heights

CELL, SIDE = 0.25, 16
SPAN = CELL * SIDE


def aligned(col: int, row: int, rows: int, cols: int) -> Grid:
    """Return the grid whose first cell is cell (row, col) of the world, rows counted north."""
    return Grid((col + 0.5) * CELL, (row + 0.5) * CELL, CELL, rows, cols)


def heights(grid: Grid, seed: int = 0, **changes: Any) -> Heights:
    """Return heights that are all different, seen and trusted; `changes` replace fields."""
    rng = np.random.default_rng(seed)
    shape = grid.shape
    fields: dict[str, Any] = {
        "height": rng.normal(0, 2, shape).astype(np.float32),
        "sigma": rng.uniform(0.02, 0.1, shape).astype(np.float32),
        "flags": np.zeros(shape, np.uint16),
        "views": rng.integers(2, 12, shape, dtype=np.uint8),
        "rgb": rng.integers(0, 255, (*shape, 3), dtype=np.uint8),
        "residual": rng.uniform(0, 1, shape).astype(np.float32),
        "sampling": rng.uniform(0.05, 0.2, shape).astype(np.float32),
    }
    for k, v in changes.items():
        fields[k] = np.broadcast_to(np.asarray(v, FIELDS[k][0]), fields[k].shape).copy()
    return Heights(grid, **fields)


def same(a: Any, b: Any) -> None:
    """Assert that all fields of two maps are equal, bit for bit."""
    for k in FIELDS:
        assert_array_equal(getattr(a, k), getattr(b, k), err_msg=k)


def one(height: float, sigma: float, flags: int = 0) -> Heights:
    return heights(aligned(3, 3, 1, 1), height=height, sigma=sigma, flags=flags)


def fused(*steps: Heights) -> float:
    e = TiledElevation(CELL, SIDE)
    for h in steps:
        e.add(h)
    return float(e.read(steps[0].grid).height[0, 0])


# -- the raster

index = st.integers(-70, 70)
size = st.integers(1, 40)


@given(index, index, size, size)
@settings(derandomize=True, database=None, deadline=None, max_examples=40)
def test_what_is_added_anywhere_is_read_back(col: int, row: int, rows: int, cols: int) -> None:
    """Heights are read back from any place, over tile borders and on both sides of the origin."""
    e = TiledElevation(CELL, SIDE)
    h = heights(aligned(col, row, rows, cols))
    e.add(h)
    same(e.read(h.grid), h)
    snapshot = e.snapshot()
    assert snapshot is not None
    top, bottom, left, right = (row + 1) % 2, (row - rows + 1) % 2, col % 2, (col + cols) % 2  # whole larger cells
    assert snapshot.grid == h.grid.window(-top, -left, top + rows + bottom, left + cols + right)
    inside = (slice(top, top + rows), slice(left, left + cols))
    for k in FIELDS:
        assert_array_equal(getattr(snapshot, k)[inside], getattr(h, k), err_msg=k)
    assert (snapshot.flags & np.uint16(Flag.UNSEEN) == 0).sum() == rows * cols


@given(index, index)
@settings(derandomize=True, database=None, deadline=None, max_examples=20)
def test_tiles_meet_without_gap_or_overlap(row: int, col: int) -> None:
    e = TiledElevation(CELL, SIDE)
    xs, ys = e.layer().tile_grid((row, col)).xy()
    assert_allclose(e.layer().tile_grid((row, col + 1)).xy()[0][0] - xs[-1], CELL)
    assert_allclose(ys[-1] - e.layer().tile_grid((row - 1, col)).xy()[1][0], CELL)
    assert_allclose([xs[0], ys[-1]], [col * SPAN + CELL / 2, row * SPAN + CELL / 2])
    wide = e.layer().tile_grid((row, col), margin=3)
    assert wide.shape == (SIDE + 6, SIDE + 6)
    assert_allclose(wide.xy()[0][3:-3], xs)
    assert_allclose(wide.xy()[1][3:-3], ys)


@pytest.mark.parametrize("at", [(0.0, 0.0), (-7.3, 2.2), (-0.1, -0.1), (12.9, -30.4)])
def test_a_window_covers_its_rectangle_with_whole_cells(at: tuple[float, float]) -> None:
    e = TiledElevation(CELL, SIDE)
    east, north = (at[0], at[0] + 3.1), (at[1], at[1] + 1.7)
    grid = e.layer().window(east, north)
    xs, ys = grid.xy()
    for centres in (xs, ys):
        assert_allclose(centres / CELL - 0.5, np.round(centres / CELL - 0.5), atol=1e-9)
    half = CELL / 2
    assert xs[0] - half <= east[0] < xs[0] + half
    assert xs[-1] - half <= east[1] < xs[-1] + half
    assert ys[-1] - half <= north[0] < ys[-1] + half
    assert ys[0] - half <= north[1] < ys[0] + half


def test_cover_names_every_tile_a_rectangle_touches() -> None:
    e = TiledElevation(CELL, SIDE)
    assert list(e.layer().cover((-0.1, 0.1), (-0.1, 0.1))) == [(-1, -1), (-1, 0), (0, -1), (0, 0)]
    assert list(e.layer().cover((0.1, SPAN - 0.1), (SPAN + 0.1, SPAN + 0.2))) == [(1, 0)]


def test_what_was_never_seen_reads_as_unknown() -> None:
    got = TiledElevation(CELL, SIDE).read(aligned(-5, 5, 9, 9))
    assert np.isnan(got.height).all()
    assert np.isnan(got.sigma).all()
    assert (got.flags == np.uint16(Flag.UNSEEN)).all()
    assert (got.views == 0).all()
    assert not got.trusted.any()


# -- choice of the height


@pytest.mark.parametrize("flag", [f for f in Flag if f & REFUSED and f != Flag.UNSEEN])
def test_trusted_comes_before_refused_in_any_order(flag: Flag) -> None:
    good, bad = one(1.0, 0.5), one(2.0, 0.01, int(flag))
    assert fused(good, bad) == fused(bad, good) == 1.0


@pytest.mark.parametrize("flags", [0, int(Flag.MOVING), int(Flag.STEP | Flag.FEW)])
def test_among_equals_the_smaller_sigma_stays(flags: int) -> None:
    fine, coarse = one(1.0, 0.02, flags), one(2.0, 0.03, flags)
    assert fused(fine, coarse) == fused(coarse, fine) == 1.0


def test_a_note_is_no_reason() -> None:
    """STEP and FEW do not refuse a height, so that the smaller sigma decides."""
    assert fused(one(1.0, 0.05), one(2.0, 0.02, int(Flag.STEP | Flag.FEW))) == 2.0


def test_unseen_takes_nothing_away_and_gives_nothing() -> None:
    nothing = one(np.nan, np.nan, int(Flag.UNSEEN))
    assert fused(one(1.0, 0.5, int(Flag.MOVING)), nothing) == 1.0
    assert fused(nothing, one(1.0, 0.5, int(Flag.MOVING))) == 1.0
    e = TiledElevation(CELL, SIDE)
    e.add(one(1.0, 0.5))
    e.add(nothing, replace_all=True)
    assert e.read(nothing.grid).height[0, 0] == 1.0


def test_the_first_stays_where_nothing_tells_them_apart() -> None:
    assert fused(one(1.0, 0.02), one(2.0, 0.02)) == 1.0


def test_all_fields_of_a_cell_come_from_one_step() -> None:
    grid = aligned(-9, 20, 30, 30)
    a, b = heights(grid, 1), heights(grid, 2)
    e = TiledElevation(CELL, SIDE)
    e.add(a)
    e.add(b)
    got, first = e.read(grid), a.sigma <= b.sigma
    for k in FIELDS:
        where = first[..., None] if k == "rgb" else first
        assert_array_equal(getattr(got, k), np.where(where, getattr(a, k), getattr(b, k)), err_msg=k)
    assert 0.3 < first.mean() < 0.7


def test_the_ring_writes_over_what_was_there() -> None:
    e = TiledElevation(CELL, SIDE)
    e.add(one(1.0, 0.01))
    e.add(one(2.0, 0.50, int(Flag.MOVING)), replace_all=True)
    assert e.read(aligned(3, 3, 1, 1)).height[0, 0] == 2.0


# -- rolling


def test_rolling_packs_and_unpacks_without_loss() -> None:
    grid = aligned(-50, 60, 100, 120)
    rough = heights(grid, flags=np.random.default_rng(1).integers(0, 1024, grid.shape))
    rolled, still = TiledElevation(CELL, SIDE), TiledElevation(CELL, SIDE)
    for e in (rolled, still):
        e.add(rough)
    rolled.roll((0.0, 0.0), 5.0)
    assert 0 < len(rolled.layer().near) < len(still.layer().near)  # some are packed, those near the vehicle are not
    same(rolled.read(grid), still.read(grid))
    rolled.roll((1e4, 1e4), 5.0)
    assert not rolled.layer().near
    assert len(rolled.layer().packed) == len(still.layer().near)
    same(rolled.read(grid), still.read(grid))
    a, b = rolled.snapshot(), still.snapshot()
    assert a is not None
    assert b is not None
    assert a.grid == b.grid
    same(a, b)


def test_a_packed_tile_takes_new_heights() -> None:
    grid = aligned(0, 10, 8, 8)
    old, new = heights(grid, 1, sigma=0.5), heights(grid, 2, sigma=0.1)
    e = TiledElevation(CELL, SIDE)
    e.add(old)
    e.roll((1e3, 0.0), 1.0)
    e.add(new)
    same(e.read(grid), new)
    assert not e.layer().packed  # one truth: a tile is near or packed, never both


def test_a_reading_is_a_copy() -> None:
    e = TiledElevation(CELL, SIDE)
    h = heights(aligned(0, 10, 4, 4))
    e.add(h)
    e.read(h.grid).height[:] = 99.0
    same(e.read(h.grid), h)


# -- snapshots


def test_a_snapshot_is_cropped_to_what_was_seen() -> None:
    e = TiledElevation(CELL, SIDE)
    grid = aligned(-20, 33, 40, 50)
    flags = np.full(grid.shape, np.uint16(Flag.UNSEEN))
    flags[7:19, 11:30] = 0
    flags[18, 11:29] = np.uint16(Flag.UNSEEN | Flag.STEP)
    e.add(heights(grid, flags=flags))
    got = e.snapshot()
    assert got is not None
    assert got.grid == grid.window(6, 10, 14, 20), "in whole cells of twice the size"
    assert got.height.flags.c_contiguous
    seen = flags[6:20, 10:30] == 0
    assert np.isfinite(got.height[seen]).all()
    assert np.isnan(got.height[~seen]).all()


def test_nothing_seen_is_no_snapshot() -> None:
    e = TiledElevation(CELL, SIDE)
    assert e.snapshot() is None
    e.add(heights(aligned(0, 0, 3, 3), flags=int(Flag.UNSEEN)))
    assert e.snapshot() is None


# -- cells of several sizes


def at_level(level: int, south: int, north: int, west: int, east: int) -> Grid:
    """Return the grid of the cells between these numbers, both ends included."""
    cell = CELL * 2.0**level
    return Grid((west + 0.5) * cell, (north + 0.5) * cell, cell, north - south + 1, east - west + 1)


def slanted(grid: Grid, **changes: Any) -> Heights:
    """Return heights on one plane for any grid; sigma is in proportion to the cell."""
    x, y = np.meshgrid(*grid.xy())
    return heights(grid, height=0.3 * x - 0.2 * y, **({"sigma": 0.1 * grid.cell, "flags": 0} | changes))


def off_plane(m: Any) -> np.ndarray:
    """Heights minus the plane, NaN where there is no height."""
    x, y = np.meshgrid(*m.grid.xy())
    return np.asarray(m.height - (0.3 * x - 0.2 * y).astype(np.float32))


def by_cell(fine: Any, level: int) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Group the cells of a grid by the number of the coarser cell around them, in plain integers."""
    out: dict[tuple[int, int], list[tuple[int, int]]] = {}
    x, y = fine.grid.xy()
    for r, c in np.ndindex(fine.grid.shape):
        key = (int(np.floor(y[r] / CELL / 2.0**level)), int(np.floor(x[c] / CELL / 2.0**level)))
        out.setdefault(key, []).append((r, c))
    return out


@given(index, index, size, size)
@settings(derandomize=True, database=None, deadline=None, max_examples=25)
def test_a_coarse_cell_is_the_mean_of_what_is_trusted_in_it(col: int, row: int, rows: int, cols: int) -> None:
    """The means agree with plain Python, cell by cell, anywhere on the raster and over tile borders."""
    grid = aligned(col, row, rows, cols)
    rng = np.random.default_rng([col + 100, row + 100])
    fine = heights(grid, flags=rng.choice([0, int(Flag.MOVING), int(Flag.UNSEEN), int(Flag.STEP)], grid.shape))
    e = TiledElevation(CELL, SIDE)
    e.layer(1)
    e.add(fine)
    for (north, east), cells in by_cell(fine, 1).items():
        got = e.read(at_level(1, north, north, east, east))
        seen = [k for k in cells if not fine.flags[k] & Flag.UNSEEN]
        if len(seen) < 3:
            assert got.flags[0, 0] == np.uint16(Flag.UNSEEN)
            assert np.isnan(got.height[0, 0])
            continue
        good = [k for k in seen if not fine.flags[k] & np.uint16(REFUSED)]
        used = good if len(good) >= 2 else seen
        assert got.height[0, 0] == pytest.approx(np.mean([fine.height[k] for k in used]), abs=1e-5)
        assert got.sigma[0, 0] == pytest.approx(np.sqrt(np.mean([fine.sigma[k] ** 2 for k in used])), abs=1e-6)
        assert got.trusted[0, 0] == (len(good) >= 2)
        assert got.views[0, 0] == max(fine.views[k] for k in used)
        assert got.flags[0, 0] == np.bitwise_or.reduce([fine.flags[k] for k in used])
        assert got.residual[0, 0] == pytest.approx(np.mean([fine.residual[k] for k in used]), abs=1e-6)
        assert got.sampling[0, 0] == max(fine.sampling[k] for k in used)
        assert_allclose(got.rgb[0, 0], np.mean([fine.rgb[k] for k in used], axis=0), atol=0.51)


@given(index, index, st.integers(-3, 3), st.integers(-4, 2))
@settings(derandomize=True, database=None, deadline=None, max_examples=40)
def test_a_plane_is_the_same_plane_at_every_cell_size(col: int, row: int, written: int, coarser: int) -> None:
    """Heights added at one level are the same plane at any other, without a shift by half a cell."""
    e = TiledElevation(CELL, SIDE)
    e.add(slanted(at_level(written, row, row + 23, col, col + 31)))
    asked, scale = written + coarser, 0.5**coarser
    south, west = (int(np.ceil(k * scale)) for k in (row + 2, col + 2))
    north, east = (int(np.floor(k * scale)) for k in (row + 22, col + 30))
    got = e.read(at_level(asked, south, north - 1, west, east - 1))
    assert got.trusted.all()
    assert_allclose(off_plane(got), 0.0, atol=2e-5)
    assert_allclose(got.sigma, 0.1 * CELL * 2.0**written, rtol=1e-5)
    start = e.start(got.grid)
    assert_array_equal(start.height, got.height)
    assert_allclose(start.sigma, got.sigma * np.float32(1.5 ** max(0, -coarser)), rtol=1e-5)


def test_the_finer_stands_and_the_coarser_shows_around_it() -> None:
    """A patch seen from near lies in ground seen from afar: one map, without a gap or a step between them."""
    e = TiledElevation(CELL, SIDE)
    e.add(slanted(at_level(2, -10, 10, -10, 10)))
    e.add(slanted(at_level(-1, -20, 20, -20, 20), sigma=0.01), replace_all=True)
    got = e.read(at_level(-1, -60, 60, -60, 60))
    assert got.trusted.all()
    assert_allclose(off_plane(got), 0.0, atol=2e-5)
    patch = np.zeros(got.grid.shape, bool)
    patch[40:81, 40:81] = True
    assert (got.sigma[patch] == np.float32(0.01)).all()
    assert (got.sigma[~patch] > 0.02).all()
    assert np.median(got.sigma[~patch]) > 0.09
    assert (e.read(at_level(2, -1, 0, -1, 0)).sigma == np.float32(0.01)).all()  # coarse cells get them too


def test_a_coarser_layer_that_comes_later_knows_what_is_there() -> None:
    """In a climb, a new coarser layer contains the finer tiles, packed ones included."""
    e = TiledElevation(CELL, SIDE)
    fine = slanted(at_level(0, -40, 39, -40, 39))
    e.add(fine)
    e.roll((1e3, 1e3), 1.0)
    got = e.read(at_level(3, -5, 4, -5, 4))
    assert got.trusted.all()
    assert_allclose(off_plane(got), 0.0, atol=1e-5)
    same(e.read(fine.grid), fine)


def test_refused_cells_do_not_leak_into_their_neighbours() -> None:
    """Interpolation is between trusted cells only; beside other cells a cell keeps its own value."""
    e = TiledElevation(CELL, SIDE)
    coarse = at_level(1, 0, 3, 0, 3)
    flags = np.zeros((4, 4), np.uint16)
    flags[1, 1] = int(Flag.AMBIGUOUS)
    height = np.where(flags > 0, 1e3, 1.0)
    e.add(heights(coarse, height=height, flags=flags))
    got = e.read(at_level(0, 0, 7, 0, 7))
    assert (got.height[got.trusted] == 1.0).all()
    assert got.trusted.sum() == 60


def test_batch_at_a_finer_cell_keeps_what_is_better_known_coarsely() -> None:
    e = TiledElevation(CELL, SIDE)
    e.add(heights(at_level(1, 0, 3, 0, 3), height=1.0, sigma=0.02, flags=0))
    e.add(heights(at_level(0, 0, 7, 0, 3), height=2.0, sigma=0.01, flags=int(Flag.MOVING)))
    e.add(heights(at_level(0, 0, 7, 4, 7), height=3.0, sigma=0.01, flags=0))
    got = e.read(at_level(0, 0, 7, 0, 7))
    assert got.trusted.all()
    assert (got.height[:, :3] == 1.0).all()
    assert (got.height[:, 3] <= 1.5).all()  # half-way between the coarse cells
    assert (got.height[:, 4:] == 3.0).all()


def test_a_snapshot_is_as_fine_as_a_twentieth_of_it_and_no_larger_than_asked() -> None:
    e = TiledElevation(CELL, SIDE)
    e.add(slanted(at_level(0, -30, 29, -40, 39)))
    e.add(slanted(at_level(-2, 0, 39, 0, 79)), replace_all=True)  # 3200 fine cells; the whole map would have 76800
    few = e.snapshot()
    assert few is not None
    assert few.grid == at_level(0, -30, 29, -40, 39)
    assert_allclose(off_plane(few), 0.0, atol=2e-5)
    e.add(slanted(at_level(-2, -40, -1, 0, 79)), replace_all=True)
    e.roll((1e3, 1e3), 1.0)  # packed tiles count as well
    whole = e.snapshot()
    assert whole is not None
    assert whole.grid == at_level(-2, -120, 119, -160, 159)
    small = e.snapshot(20_000)
    assert small is not None
    assert small.grid == at_level(-1, -60, 59, -80, 79)
    tiny = e.snapshot(1300)
    assert tiny is not None
    assert tiny.grid == at_level(1, -16, 15, -20, 19)
    assert tiny.trusted[1:-1].all()
    for m in (whole, small, tiny):
        assert m is tiny or m.trusted.all()
        inner = off_plane(m)[4:-4, 4:-4]
        assert_allclose(inner, 0.0, atol=2e-5)


def test_forgotten_tiles_are_gone_and_memory_is_bounded() -> None:
    """On a long way at two cell sizes, memory does not grow, and the coarse cells of forgotten tiles are gone."""
    e = TiledElevation(CELL, SIDE, NullStore())
    e.layer(2)
    most = []
    for k in range(60):
        e.add(slanted(aligned(8 * k, 8, 16, 16)))
        e.roll(((8 * k + 8) * CELL, 0.0), 2 * SPAN)
        most.append(sum(len(e.layer(k).near) for k in range(3)))
    assert max(most[30:]) <= max(most[:30])
    assert not any(e.layer(k).packed for k in range(3))
    assert not e.read(aligned(0, 8, 8, 8)).trusted.any()
    assert e.read(aligned(8 * 59, 8, 8, 8)).trusted.all()


def test_a_spilled_map_is_the_map(tmp_path: Path) -> None:
    grid = aligned(-50, 60, 100, 120)
    rough, more = heights(grid, 1), heights(grid, 2)
    with closing(FileStore(tmp_path)) as far:
        kept, spilled = TiledElevation(CELL, SIDE), TiledElevation(CELL, SIDE, far)
        for e in (kept, spilled):
            e.add(rough)
            e.roll((1e4, 0.0), 5.0)
            e.add(more)
            e.roll((1e4, 0.0), 5.0)
        assert len(far) == len({*kept.layer().near, *kept.layer().packed}) > 30
        assert not spilled.layer().near
        same(spilled.read(grid), kept.read(grid))
    assert not list(tmp_path.iterdir())  # nameless: nothing is left, however a run ends


def test_a_spill_is_a_mapping_and_takes_no_room_twice(tmp_path: Path) -> None:
    with closing(FileStore(tmp_path)) as far:
        for size in (100, 80, 100, 120, 90):
            far[0, 1, 2] = bytes(size)
            far[0, -1, 2] = bytes([7]) * 50
            assert far[0, 1, 2] == bytes(size)
            assert far.pop((0, -1, 2)) == bytes([7]) * 50
        assert list(far) == [(0, 1, 2)]
        assert (0, -1, 2) not in far
        assert far.size == 100 + 50 + 120
