"""Memory of the land cover: a puddle that was plain from 10 m stays one from 3 m (docs/method/p-safe.md, T8)."""

from __future__ import annotations

import numpy as np
import pytest
from ground import land_cover

from alight.geometry import Grid
from alight.pipeline.remembered import FADES, SURE, CoverMemory
from alight.records import Terrain, TerrainMap

GRID = Grid(0.0, 10.0, 0.25, 20, 24)
SECOND = 1_000_000_000


def look(bears: float, novelty: float, grid: Grid = GRID) -> TerrainMap:
    every = np.full(grid.shape, bears, np.float32)
    label = np.full(grid.shape, Terrain.PAVED, np.uint8)
    return land_cover(grid, label, every, bears=every.copy(), novelty=np.full(grid.shape, novelty, np.float32))


def after(*looks: tuple[TerrainMap, float]) -> TerrainMap:
    """Return the last look as it is judged; each with its time, s."""
    memory = CoverMemory()
    for cover, t in looks:
        memory = memory.with_seen(cover, round(t * SECOND))
    return memory.doubted(looks[-1][0])


def test_the_look_that_is_most_like_known_ground_counts() -> None:
    assert after((look(0.4, 0.2), 0), (look(0.97, 0.4), 2)).bears == pytest.approx(0.4)
    assert after((look(0.4, 0.4), 0), (look(0.97, 0.2), 2)).bears == pytest.approx(0.97)


def test_an_earlier_look_never_permits() -> None:
    assert after((look(0.97, 0.2), 0), (look(0.4, 0.4), 2)).bears == pytest.approx(0.4)


def test_nothing_but_the_probability_of_bearing_changes() -> None:
    last = look(0.97, 0.4)
    judged = after((look(0.4, 0.2), 0), (last, 2))
    assert judged.landable is last.landable
    assert judged.novelty is last.novelty
    assert last.bears == pytest.approx(0.97)


def test_an_earlier_look_fades() -> None:
    ages = {age: float(np.mean(after((look(0.4, 0.2), 0), (look(0.97, 0.4), age)).bears)) for age in (0.9, 1.1)}
    assert ages == pytest.approx({0.9: 0.4, 1.1: 0.4})
    soon, late = (after((look(0.4, 0.2), 0), (look(0.97, 0.4), k * FADES)).bears for k in (0.9, 1.1))
    assert soon == pytest.approx(0.4)
    assert late == pytest.approx(0.97)
    steps = [(look(0.4, 0.2), 0.0), *((look(0.97, 0.4), 0.1 * k * FADES) for k in range(1, 16))]
    assert after(*steps).bears == pytest.approx(0.97)


def test_what_is_not_seen_now_stays_unknown_and_is_not_forgotten() -> None:
    dark = look(np.nan, np.nan)
    assert np.isnan(after((look(0.4, 0.2), 0), (dark, 1)).bears).all()
    assert after((look(0.4, 0.2), 0), (dark, 1), (look(0.97, 0.4), 2)).bears == pytest.approx(0.4)
    assert after((dark, 0), (look(0.97, 0.4), 1)).bears == pytest.approx(0.97)


def test_another_grid_takes_the_nearest_cell_and_ground_outside_counts_as_new() -> None:
    pond = look(0.97, 0.2)
    assert pond.bears is not None
    pond.bears[:, :12] = 0.3  # 3 m from the west
    fine = Grid(2.0, 8.0, 0.1, 20, 60)
    judged = after((pond, 0), (look(0.97, 0.4, fine), 1)).bears
    east = fine.xy()[0]
    assert (np.abs(judged[:, east < 2.8] - 0.3) < 1e-6).all()
    assert (np.abs(judged[:, east > 2.95] - 0.97) < 1e-6).all()


def test_a_memory_moves_with_the_frame_and_one_that_is_not_sure_is_dropped() -> None:
    memory = CoverMemory().with_seen(look(0.4, 0.2), 0)
    shift = np.array([100.0, -50.0, 3.0])
    there = look(0.97, 0.4, Grid(100.0, -40.0, 0.25, 20, 24))
    assert memory.moved(shift, SURE).with_seen(there, SECOND).doubted(there).bears == pytest.approx(0.4)
    for sigma in (1.1 * SURE, float("nan")):
        assert memory.moved(shift, sigma).with_seen(there, SECOND).doubted(there).bears == pytest.approx(0.97)


def test_an_earlier_look_fades_alike_however_often_a_map_is_made() -> None:
    novelty = []
    for count in (1, 4, 60):
        memory = CoverMemory().with_seen(look(0.4, 0.2), 0)
        for k in range(1, count + 1):
            memory = memory.with_seen(look(np.nan, np.nan), round(k * FADES / count * SECOND))
        novelty.append(float(memory.novelty[0, 0]))
    assert novelty == pytest.approx([0.4, 0.4, 0.4])  # twice in 60 s
