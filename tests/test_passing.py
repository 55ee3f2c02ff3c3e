"""Traffic: paved ground that something moved across is refused for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from some_run import elevation

from alight.geometry import Grid
from alight.hazards import assess
from alight.pipeline.mapping.passing import traffic, what_moves, who_came
from alight.pipeline.remembered import NOWHERE
from alight.records import ElevationMap, Flag, Hazard, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander

SECOND = 1_000_000_000


def road(moving: tuple[float, float, float, float] | None = None, east: float = 0.0, cell: float = 0.1) -> ElevationMap:
    """20 m of level ground each way; something moves in a box of west, south, east, north."""
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
    """What moves on such a map."""
    e = road(box)
    return what_moves(e.grid, e.flags)


def test_what_moved_is_remembered_where_it_was() -> None:
    """A car of 4 x 2 m, found again on another grid of other cells; after two minutes it is forgotten."""
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


def test_specks_are_noise() -> None:
    assert not len(NOWHERE.with_seen(cells((4.0, 8.0, 5.0, 9.5)), 0).cells)
    assert not len(NOWHERE.with_seen(cells(), 0).cells)


@pytest.mark.parametrize(("side", "kept"), [(0.2, 0), (0.4, 4)])
def test_a_person_is_enough_to_be_remembered(side: float, kept: int) -> None:
    """With every cell that they reach into; less is noise."""
    e = road((5.0 - side / 2, 9.0 - side / 2, 5.0 + side / 2, 9.0 + side / 2))
    cells = who_came(e.grid, (e.flags & np.uint16(Flag.MOVING)) != 0)
    assert len(cells) == kept
    if kept:
        np.testing.assert_array_equal(np.sort(cells, axis=0), np.sort([[9, 17], [9, 18], [10, 17], [10, 18]], axis=0))


@pytest.mark.parametrize(("kind", "kept"), [(Terrain.PAVED, 1), (Terrain.BARE, 0), (Terrain.SHORT_GRASS, 0)])
def test_plants_that_sway_are_no_traffic(kind: Terrain, kept: int) -> None:
    e = road((4.0, 8.0, 8.0, 10.0))
    cover = TerrainMap(e.grid, np.full(e.grid.shape, kind, np.uint8), np.ones(e.grid.shape, np.float32))
    assert traffic(NOWHERE.with_seen(what_moves(e.grid, e.flags), 0), e.grid, cover).any() == bool(kept)


def test_ground_beside_traffic_is_refused() -> None:
    """The footprint and the margin about it; farther away nothing changes."""
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
    """Footprints that hold some of it are refused, whatever the margin for traffic."""
    e, lander, settings = road(), Lander(radius=1.0), HazardsSettings(smoothed=False, traffic_margin=1.0)
    came = NOWHERE.with_seen(cells((4.0, 8.0, 8.0, 10.0)), 0).on(e.grid)
    found = assess(e, None, lander, settings, came=came)
    x, y = (v.ravel() for v in e.grid.xy())
    refused = (found.reasons & np.uint16(Hazard.TRAFFIC)) != 0
    row = int(np.argmin(np.abs(y - 9.0)))
    np.testing.assert_allclose([x[refused[row]].min(), x[refused[row]].max()], [3.05, 8.95], atol=0.1)
    assert (found.p_safe[refused] == 0).all()
