"""Memory of wires: kept while they are not seen from below, forgotten when missed more often than found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from alight.geometry import Camera, Grid, Pose
from alight.pipeline.remembered import WIRES_KEPT, WireMemory
from alight.records import View, Wire

GRID = Grid(-10.0, 10.0, 0.1, 200, 200)
WIRE = Wire(np.array([-4.0, 0.0, 6.0]), np.array([4.0, 0.0, 6.0]), 0.9)
LENS = Camera(8, 8, 8.0, 8.0, 3.5, 3.5)


def views(second: float, height: float = 20.0) -> list[View]:
    pose = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, height]))
    return [View(round((second + 0.1 * k) * 1e9), 0, np.zeros((8, 8), np.uint8), LENS, pose) for k in range(5)]


def test_a_map_is_searched_again_once_enough_of_its_exposures_are_new() -> None:
    memory = WireMemory()
    assert memory.is_search_due(views(0))
    memory = memory.with_search((), views(0), GRID)
    assert not memory.is_search_due(views(0.2))
    assert memory.is_search_due(views(0.3))


def test_a_wire_that_is_missed_more_often_than_found_is_forgotten() -> None:
    memory = WireMemory().with_search((WIRE,), views(0), GRID)
    for second, left in ((1, 1), (2, 0)):
        memory = memory.with_search((), views(second), GRID)
        assert len(memory.wires) == left


def test_a_wire_is_kept_where_no_view_could_show_it() -> None:
    memory = WireMemory().with_search((WIRE,), views(0), GRID)
    for second in range(1, 9):
        memory = memory.with_search((), views(second, height=7.0), GRID)
    assert len(memory.wires) == 1
    assert not memory.with_search((), views(WIRES_KEPT + 1, height=7.0), GRID).wires


def test_the_longer_of_two_stretches_is_kept_and_counts_as_found_twice() -> None:
    part = replace(WIRE, end=np.array([1.0, 0.2, 6.0]), chance=0.6)
    for first, second in ((WIRE, part), (part, WIRE)):
        memory = WireMemory().with_search((first,), views(0), GRID).with_search((second,), views(1), GRID)
        (kept,) = memory.kept
        assert (kept.wire.length, kept.wire.chance, kept.found) == (8.0, 0.9, 2)


def test_wires_move_with_the_frame() -> None:
    memory = WireMemory().with_search((WIRE,), views(0), GRID).moved(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(memory.wires[0].start, [-3.0, 2.0, 9.0])
