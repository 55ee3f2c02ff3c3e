"""Wires are found by their parallax against the ground (docs/method/wires.md); lines on the ground are not."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_wires import level_map, views

from alight.parallax.wires.find import find_wires
from alight.parallax.wires.line_kernels import BLOCK, REACH, pick_lines, raise_lines, sum_lines

WIRE = np.array([[-9.0, 3.0, 6.0], [8.0, -5.0, 6.4]])


@pytest.mark.parametrize("across", [0.5, 1.5])
def test_a_thin_wire_is_found_where_it_hangs(across: float) -> None:
    found = [w for w in find_wires(views(1, WIRE, across), level_map()) if w.is_found]
    assert len(found) == 1
    way = (WIRE[1] - WIRE[0]) / np.linalg.norm((WIRE[1] - WIRE[0])[:2])
    for place in (found[0].start, found[0].end, 0.5 * (found[0].start + found[0].end)):
        away = place - WIRE[0]
        along = away[:2] @ way[:2]
        assert abs(away[0] * way[1] - away[1] * way[0]) < 0.4
        assert abs(away[2] - along * way[2]) < 0.7
    assert found[0].length > 8.0


@pytest.mark.parametrize("wire", [None, WIRE * (1.0, 1.0, 0.0)], ids=["bare ground", "a painted line"])
def test_what_lies_on_the_ground_is_no_wire(wire: np.ndarray | None) -> None:
    assert find_wires(views(2, wire, 1.5), level_map()) == ()


def test_two_views_show_no_parallax_to_rely_on() -> None:
    assert find_wires(views(1, WIRE)[:2], level_map()) == ()


def sums_of(picture: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Twin of `sum_lines`: cell by cell, (D, B, R)."""
    rows, blocks = picture.shape[0], picture.shape[1] // BLOCK
    out = np.zeros((len(slopes), blocks, rows))
    for d, b, r in np.ndindex(*out.shape):
        for step in range(-REACH, REACH + 1):
            if not 0 <= b + step < blocks:
                continue
            lower = r + round(slopes[d] * BLOCK * step)
            for k in range(BLOCK):
                row = lower + round(slopes[d] * (k - 0.5 * (BLOCK - 1)))
                if 0 <= lower < rows and 0 <= row < rows:
                    out[d, b, r] += picture[row, (b + step) * BLOCK + k]
    return out


def test_sums_along_lines_are_those_of_their_cells() -> None:
    picture, slopes = (
        np.random.default_rng(0).normal(size=(30, 6 * BLOCK)).astype(np.float32),
        np.array([-0.8, 0.1, 0.6]),
    )
    columns = np.ascontiguousarray(picture.T.reshape(6, BLOCK, 30).swapaxes(0, 1))
    out = np.empty((3, 6, 30), np.float32)
    sum_lines(columns, slopes, out)
    np.testing.assert_allclose(out, sums_of(picture, slopes), atol=1e-4)


def test_the_strongest_line_of_each_patch_is_picked() -> None:
    sums = np.random.default_rng(1).normal(size=(4, 3, 20)).astype(np.float32)
    out = np.empty((20, 3), np.int64)
    count = pick_lines(sums, 20, 8, 2.0, out)
    best = set()
    for b in range(3):
        for first in (0, 8, 16):
            patch = np.abs(sums[:, b, first : first + 8])
            d, r = np.unravel_index(patch.argmax(), patch.shape)
            if patch.max() > 2.0:
                best.add((int(d), b, first + int(r)))
    assert {tuple(row) for row in out[:count].tolist()} == best


def test_a_line_rises_to_the_height_at_which_the_other_views_show_it() -> None:
    """Three cameras at 20 m, 2 m apart across a line 5 m up; each shows it on the plane where its ray ends."""
    rows, blocks, height, cell = 240, 8, 5.0, 0.1
    centres = np.array([[0.0, 2.0 * k, 20.0] for k in range(-1, 2)])
    grids = np.tile([-3.15, 12.0, cell, rows, 8 * blocks], (3, 1))
    sums, known = np.zeros((3, 2, 1, blocks, rows), np.float32), np.full((3, 2, blocks, rows), 255, np.uint8)
    norths = centres[:, 1] - centres[:, 1] * 20 / (20 - height)
    for v, north in enumerate(norths):
        sums[v, 0, 0, :, round((12.0 - north) / cell)] = 4.0
    out = np.empty((1, 4))
    heights = np.linspace(2.5, 9.0, 66)[None]
    line = np.array([[0.0, norths[1], 0.0, 0.0, 4.0]])
    raise_lines(line, 1, heights, centres, grids, known, sums, np.zeros(1), 2.0, 3.0, 2, out)
    assert out[0, 1] == pytest.approx(height, abs=0.3)
    assert out[0, [0, 2, 3]] == pytest.approx([6 / np.sqrt(2), 2, 8 / np.sqrt(2)])
