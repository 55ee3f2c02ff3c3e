"""Traffic: paved ground is refused for a while after something moved across it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ground import covered
from numpy.testing import assert_allclose
from some_run import elevation

from alight.geometry import Grid
from alight.hazards import assess
from alight.pipeline.remembered import CELL, NOWHERE, around, traffic, what_moves, who_came
from alight.records import ElevationMap, Flag, Hazard, MovingBody, Terrain
from alight.settings import HazardsSettings, Lander

SECOND = 1_000_000_000


def road(moving: tuple[float, float, float, float] | None = None, east: float = 0.0, cell: float = 0.1) -> ElevationMap:
    """Return 20 m of level ground each way; something moves in a box of west, south, east, north."""
    flat = elevation()
    rows = cols = round(20 / cell)
    grid = Grid(east, 20.0, cell, rows, cols)
    full = {
        name: np.full((rows, cols), np.asarray(getattr(flat, name)).flat[0], np.asarray(getattr(flat, name)).dtype)
        for name in ("sigma", "views", "residual", "sampling")
    }
    out = replace(
        flat, grid=grid, height=np.zeros((rows, cols), np.float32), flags=np.zeros((rows, cols), np.uint16),
        rgb=np.zeros((rows, cols, 3), np.uint8), fine=None, fine_sampling=None, **full,
    )  # fmt: skip
    if moving is not None:
        x, y = (v.ravel() for v in grid.xy())
        inside = ((y >= moving[1]) & (y < moving[3]))[:, None] & ((x >= moving[0]) & (x < moving[2]))[None]
        out.flags[inside] = np.uint16(Flag.MOVING)
    return out


def cells(box: tuple[float, float, float, float] | None = None) -> np.ndarray:
    """Return the moving cells of such a map."""
    e = road(box)
    return what_moves(e.grid, e.flags)


def test_what_moved_is_remembered_where_it_was() -> None:
    """A car of 4 x 2 m is found again on another grid of other cells, but not among cells seen since a later time."""
    seen = NOWHERE.with_seen(cells((4.0, 8.0, 8.0, 10.0)), 7 * SECOND)
    assert len(seen.cells) == 32
    other = Grid(3.3, 12.0, 0.25, 24, 24)
    x, y = (v.ravel() for v in other.xy())
    inside = ((y >= 8) & (y < 10))[:, None] & ((x >= 4) & (x < 8))[None]
    np.testing.assert_array_equal(seen.on(other), inside)
    assert seen.since(7 * SECOND).on(other).any()
    assert not seen.since(8 * SECOND).on(other).any()
    again = seen.with_seen(cells((6.0, 8.0, 10.0, 10.0)), 9 * SECOND)
    assert len(again.cells) == 48
    assert len(again.since(8 * SECOND).cells) == 32


def test_it_goes_with_the_frame() -> None:
    seen = NOWHERE.with_seen(cells((4.0, 8.0, 8.0, 10.0)), 0).moved(np.array([100.0, -50.0, 3.0]))
    assert seen.on(Grid(100.0, -30.0, 0.5, 40, 40)).sum() == 32
    assert not seen.on(road().grid).any()


@pytest.mark.parametrize(("sigma", "wide"), [(0.0, 4.0), (0.6, 7.0), (50.0, 14.0)])
def test_it_covers_what_is_not_known_of_the_way_between_two_frames(sigma: float, wide: float) -> None:
    """A car of 4 x 2 m grows by 2 sigma on each side, 5 m at most, with round corners; the latest time counts."""
    shift, car = np.array([100.0, -50.0, 3.0]), (4.0, 8.0, 8.0, 10.0)
    seen = NOWHERE.with_seen(cells(car), 0).with_seen(cells(car)[:1], SECOND).moved(shift, sigma)
    on = seen.on(Grid(90.25, -20.25, 0.1, 400, 400))
    assert_allclose([on.any(axis=0).sum() / 10, on.any(axis=1).sum() / 10], [wide, wide - 2.0], atol=0.11)
    beside = 0.5 * (wide - 4.0)
    assert (on.sum() < 100 * wide * (wide - 2.0)) == (beside > 0)
    assert on.sum() / 100 >= 8.0 + 12.0 * beside + np.pi * beside**2 - 0.1
    later = seen.since(SECOND).on(Grid(90.25, -20.25, 0.1, 400, 400))
    assert_allclose(later.any(axis=0).sum() / 10, 0.5 + 2 * beside, atol=0.11)


@pytest.mark.parametrize("cell", [0.25, 0.4, 0.55, 0.64, 0.8, 1.0, 1.28])
def test_on_wide_cells_it_is_remembered_as_well(cell: float) -> None:
    """A lorry of 6 x 10 m is as wide as on the cells of the map, and is found again on such cells."""
    e = road((4.0, 5.0, 10.0, 15.0), cell=cell)
    shown = (e.flags & np.uint16(Flag.MOVING)) != 0
    moves = what_moves(e.grid, e.flags)
    rim = 2 * (shown.any(axis=0).sum() + shown.any(axis=1).sum()) * cell
    assert abs(0.25 * len(moves) - shown.sum() * cell**2) <= 0.25 * rim + 0.25
    seen = NOWHERE.with_seen(moves, 0)
    assert (seen.on(e.grid) >= shown).all()
    assert (NOWHERE.with_seen(who_came(e.grid, shown), 0).on(e.grid) >= shown).all()


@pytest.mark.parametrize("cell", [0.3, 0.5, 0.56, 0.64, 0.7, 1.0])
def test_no_remembered_cell_falls_between_wide_ones(cell: float) -> None:
    rng, grid = np.random.default_rng(0), Grid(0.03, 30.03, cell, round(30 / cell), round(30 / cell))
    for place in rng.uniform(5, 25, (100, 2)):
        on = NOWHERE.with_seen(np.floor(place / CELL).astype(np.int64)[None], 0).on(grid)
        x, y = (v[i] for v, i in zip(grid.xy(), np.nonzero(on)[::-1], strict=True))
        assert len(x)
        middle = (np.floor(place / CELL) + 0.5) * CELL
        assert np.abs(np.r_[x - middle[0], y - middle[1]]).max() <= 0.5 * (cell + CELL)


def test_specks_are_noise() -> None:
    assert not len(NOWHERE.with_seen(cells((4.0, 8.0, 5.0, 9.5)), 0).cells)
    assert not len(NOWHERE.with_seen(cells(), 0).cells)


def test_only_what_is_seen_to_move_anew_is_remembered_anew() -> None:
    """A part of the map that a step leaves out keeps its flags: its traffic was seen before, not now."""
    e = road((4.0, 8.0, 8.0, 10.0))
    anew = np.broadcast_to(e.grid.xy()[0] < 6.0, e.grid.shape)
    whole, part = what_moves(e.grid, e.flags), what_moves(e.grid, e.flags, anew)
    np.testing.assert_array_equal(part, whole[whole[:, 0] < 12])
    assert 0 < len(part) < len(whole)


def test_places_far_away_cost_no_memory() -> None:
    """Roofs of a whole flight are remembered: a raster of it would not fit."""
    far = NOWHERE.with_seen(np.array([[8, 18], [10**9, 10**9], [-(10**9), 3]]), 0)
    e = road()
    np.testing.assert_array_equal(far.on(e.grid), NOWHERE.with_seen(np.array([[8, 18]]), 0).on(e.grid))
    assert far.on(e.grid).any()
    assert not NOWHERE.with_seen(np.array([[10**9, 10**9]]), 0).on(e.grid).any()


@pytest.mark.parametrize(("side", "kept"), [(0.2, 0), (0.4, 4)])
def test_a_person_is_enough_to_be_remembered(side: float, kept: int) -> None:
    """All cells that a person reaches into are remembered; less is noise."""
    e = road((5.0 - side / 2, 9.0 - side / 2, 5.0 + side / 2, 9.0 + side / 2))
    cells = who_came(e.grid, (e.flags & np.uint16(Flag.MOVING)) != 0)
    assert len(cells) == kept
    if kept:
        np.testing.assert_array_equal(np.sort(cells, axis=0), np.sort([[9, 17], [9, 18], [10, 17], [10, 18]], axis=0))


@pytest.mark.parametrize(("away", "kept"), [(0.0, 4), (0.8, 4), (4.0, 0)])
def test_whoever_came_to_stand_was_seen_to_move(away: float, kept: int) -> None:
    e = road((4.8, 8.8, 5.2, 9.2))
    mover = MovingBody(np.array([5.0 + away, 9.0]), np.array([-1.4, 0.0]), 0.3)
    moved = NOWHERE.with_seen(around([mover], 1.0), 0)
    came = who_came(e.grid, (e.flags & np.uint16(Flag.MOVING)) != 0)
    assert len(moved.among(came)) == kept
    assert not len(NOWHERE.among(came))
    assert not len(around([], 1.0))


@pytest.mark.parametrize(("kind", "kept"), [(Terrain.PAVED, 1), (Terrain.BARE, 0), (Terrain.SHORT_GRASS, 0)])
def test_plants_that_sway_are_no_traffic(kind: Terrain, kept: int) -> None:
    e = road((4.0, 8.0, 8.0, 10.0))
    cover = covered(e, 1.0, kind)
    assert traffic(NOWHERE.with_seen(what_moves(e.grid, e.flags), 0), e.grid, cover).any() == bool(kept)


def test_ground_beside_traffic_is_refused() -> None:
    """The footprint and the margin about it are refused; farther away nothing changes."""
    e, lander, settings = road(), Lander(radius=1.0), HazardsSettings(smoothed=False, traffic_margin=1.0)
    passed = NOWHERE.with_seen(cells((4.0, 8.0, 8.0, 10.0)), 0).on(e.grid)
    free, found = assess(e, None, lander, settings), assess(e, None, lander, settings, passed=passed)
    x, y = (v.ravel() for v in e.grid.xy())
    refused = (found.reasons & np.uint16(Hazard.TRAFFIC)) != 0
    row = int(np.argmin(np.abs(y - 9.0)))
    np.testing.assert_allclose([x[refused[row]].min(), x[refused[row]].max()], [2.05, 9.95], atol=0.1)
    assert (found.p_safe[refused] == 0).all()
    np.testing.assert_array_equal(found.reasons[~refused], free.reasons[~refused])
    assert (free.reasons[refused] == 0).all()


def test_ground_beside_somebody_who_came_is_free() -> None:
    """Footprints that contain a part of it are refused, independent of the margin for traffic."""
    e, lander, settings = road(), Lander(radius=1.0), HazardsSettings(smoothed=False, traffic_margin=1.0)
    came = NOWHERE.with_seen(cells((4.0, 8.0, 8.0, 10.0)), 0).on(e.grid)
    found = assess(e, None, lander, settings, came=came)
    x, y = (v.ravel() for v in e.grid.xy())
    refused = (found.reasons & np.uint16(Hazard.TRAFFIC)) != 0
    row = int(np.argmin(np.abs(y - 9.0)))
    np.testing.assert_allclose([x[refused[row]].min(), x[refused[row]].max()], [3.05, 8.95], atol=0.1)
    assert (found.p_safe[refused] == 0).all()
