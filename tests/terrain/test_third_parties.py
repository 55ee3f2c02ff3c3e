"""Roads and standing cars on a map: what is found, and what is left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ground import BROWN, GREEN, GREY, ground, textured
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from alight.records import ElevationMap
from alight.settings import Settings
from alight.terrain.cars import standing_cars
from alight.terrain.roads import roads

CELL, TERRAIN = 0.2, Settings().stages().terrain


def scene(width: float, turn: float, size: float = 60.0, surface: tuple[int, int, int] = GREY) -> ElevationMap:
    """Level meadow with a straight strip through its middle, `width` metres wide."""
    n = round(size / CELL)
    rows, cols = (np.mgrid[:n, :n] - (n - 1) / 2) * CELL
    across = np.abs(rows * math.cos(turn) - cols * math.sin(turn))
    colour = textured(GREEN, (n, n), 0.1, 1)
    strip = across <= width / 2
    colour[strip] = textured(surface, (n, n), 0.03, 2)[strip]
    return ground(np.zeros((n, n)), CELL, 0.01, colour)


def strip_of(width: float, turn: float, e: ElevationMap) -> NDArray[np.bool_]:
    n = e.grid.rows
    rows, cols = (np.mgrid[:n, :n] - (n - 1) / 2) * CELL
    return np.abs(rows * math.cos(turn) - cols * math.sin(turn)) <= width / 2


@settings(max_examples=12, deadline=None)
@given(st.floats(2.5, 10.0), st.floats(0.0, math.pi), st.sampled_from([GREY, BROWN]))
def test_a_paved_or_gravelled_strip_is_a_road(width: float, turn: float, surface: tuple[int, int, int]) -> None:
    e = scene(width, turn, surface=surface)
    found = roads(e, np.ones(e.grid.shape, np.float32), TERRAIN)
    assert found[strip_of(0.5, turn, e)].mean() > 0.9
    assert found[~strip_of(width + 3.0, turn, e)].mean() < 0.02


@pytest.mark.parametrize("surface", [GREEN, GREY])
def test_ground_of_one_kind_has_no_road(surface: tuple[int, int, int]) -> None:
    e = ground(np.zeros((300, 300)), CELL, 0.01, textured(surface, (300, 300), 0.1, 3))
    assert not roads(e, np.ones(e.grid.shape, np.float32), TERRAIN).any()


def test_a_green_strip_a_short_one_and_a_wide_yard_are_no_roads() -> None:
    hedge = scene(4.0, 0.3, surface=(70, 160, 40))
    assert not roads(hedge, np.ones(hedge.grid.shape, np.float32), TERRAIN).any()
    small = scene(4.0, 0.3, size=18.0)
    assert not roads(small, np.ones(small.grid.shape, np.float32), TERRAIN).any()
    yard = scene(40.0, 0.3)
    assert roads(yard, np.ones(yard.grid.shape, np.float32), TERRAIN).mean() < 0.02


def test_black_pictures_hold_no_road() -> None:
    e = ground(np.zeros((300, 300)), CELL, 0.01, (0, 0, 0))
    assert not roads(e, np.ones(e.grid.shape, np.float32), TERRAIN).any()


def box(length: float, width: float, height: float, turn: float = 0.4) -> NDArray[np.float32]:
    """Heights above level ground, 20 m wide, with a box in the middle."""
    rows, cols = (np.mgrid[:100, :100] - 49.5) * CELL
    along, across = rows * math.cos(turn) + cols * math.sin(turn), cols * math.cos(turn) - rows * math.sin(turn)
    return np.where((np.abs(along) < length / 2) & (np.abs(across) < width / 2), height, 0.0).astype(np.float32)


PAVED = np.zeros((100, 100), np.float32)  # excess green


@given(st.floats(3.6, 6.0), st.floats(1.6, 2.1), st.floats(1.2, 2.2), st.floats(0.0, math.pi))
def test_a_box_of_a_cars_size_on_paved_ground_is_a_car(length: float, width: float, height: float, turn: float) -> None:
    heights = box(length, width, height, turn)
    found = standing_cars(heights, PAVED, CELL, TERRAIN)
    assert (found & (heights > 0)).sum() > 0.7 * (heights > 0).sum()
    assert not (found & (heights == 0)).any()


@pytest.mark.parametrize(
    ("length", "width", "height"), [(4.5, 1.8, 0.2), (4.5, 1.8, 4.0), (15.0, 8.0, 1.5), (1.0, 1.0, 1.5)]
)
def test_a_kerb_a_house_and_a_post_are_no_cars(length: float, width: float, height: float) -> None:
    assert not standing_cars(box(length, width, height), PAVED, CELL, TERRAIN).any()


def test_a_box_in_tall_plants_is_no_car() -> None:
    plants = np.full((100, 100), 0.2, np.float32)
    assert not standing_cars(box(4.5, 1.8, 1.5), plants, CELL, TERRAIN).any()


def test_a_car_is_found_where_few_of_its_heights_are_known() -> None:
    heights = box(4.5, 1.8, 1.5)
    heights[(heights > 0) & (np.random.default_rng(5).random(heights.shape) < 0.7)] = np.nan
    assert standing_cars(heights, PAVED, CELL, TERRAIN).any()


def test_a_row_of_cars_whose_gaps_are_lost_is_found() -> None:
    assert standing_cars(box(4.5, 12.0, 1.3), PAVED, CELL, TERRAIN).any()
