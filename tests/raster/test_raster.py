"""Operators on rasters against closed forms and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from alight import raster
from alight.geometry import Grid


def noise(shape: tuple[int, int] = (40, 50), seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def test_a_narrow_gaussian_mean_is_scipys() -> None:
    want = ndimage.gaussian_filter(noise().astype(np.float64), 2.0, mode="mirror", truncate=4.0)
    assert_allclose(raster.gaussian_mean(noise(), 2.0), want, atol=2e-3)


@pytest.mark.parametrize("sigma", [1.0, 12.0])
def test_gaussian_means_of_a_constant_are_the_constant(sigma: float) -> None:
    flat = np.full((60, 64), 3.5, np.float32)
    weight = (noise((60, 64)) > 0).astype(np.float32)
    assert_allclose(raster.gaussian_mean(flat, sigma), flat, rtol=1e-5)
    assert_allclose(raster.masked_gaussian(flat, weight, sigma), flat, rtol=1e-5)


@pytest.mark.parametrize("sigma", [12.0, 20.0])
def test_a_wide_mean_taken_on_a_coarser_raster_is_near_the_full_one(sigma: float) -> None:
    smooth = ndimage.gaussian_filter(noise((160, 160)).astype(np.float64), 3.0).astype(np.float32)
    want = ndimage.gaussian_filter(smooth.astype(np.float64), sigma, mode="mirror")[40:-40, 40:-40]
    for found in (raster.gaussian_mean(smooth, sigma), raster.masked_gaussian(smooth, np.ones_like(smooth), sigma)):
        assert np.abs(found[40:-40, 40:-40] - want).max() < 0.25 * want.std()


def test_a_masked_mean_weighs_only_known_cells() -> None:
    values, known = noise(), noise(seed=1) > 0.5
    weight = known.astype(np.float32)
    total = ndimage.gaussian_filter(np.where(known, values, 0).astype(np.float64), 2.0, mode="mirror")
    share = ndimage.gaussian_filter(weight.astype(np.float64), 2.0, mode="mirror")
    found = raster.weighted_gaussian(np.where(known, values, np.float32(np.nan)), weight, 2.0)
    assert_allclose(found.share, share, atol=2e-3)
    assert_allclose(found.mean[share > 0.1], (total / share)[share > 0.1], atol=2e-2)


def test_a_masked_mean_is_unknown_far_from_every_known_cell() -> None:
    weight = np.zeros((40, 40), np.float32)
    weight[20, 5] = 1
    found = raster.masked_gaussian(np.full((40, 40), 2.0, np.float32), weight, 2.0)
    assert_allclose(found[20, 5], 2.0)
    assert np.isnan(found[:, 20:]).all()


def test_block_reductions_are_those_of_the_pixels() -> None:
    fine = noise((12, 20))
    for r in range(3):
        for c in range(5):
            block = fine[4 * r : 4 * r + 4, 4 * c : 4 * c + 4]
            assert_allclose(raster.block_mean(fine, 4)[r, c], block.mean(), rtol=1e-4, atol=1e-6)
            assert raster.block_max(fine, 4)[r, c] == block.max()


def test_block_quantile_is_of_the_known_cells_and_takes_odd_factors() -> None:
    values = np.arange(35, dtype=np.float32).reshape(5, 7)
    values[0, 0] = np.nan
    values[3:, 3:6] = np.nan
    found = raster.block_quantile(values, 3, 0.5)
    assert found.shape == (2, 3)
    assert found[0, 0] == np.sort([1, 2, 7, 8, 9, 14, 15, 16])[4]
    assert np.isnan(found[1, 1])
    assert raster.block_quantile(values, 3, 0.0)[0, 1] == 3
    assert raster.block_quantile(values, 3, 1.0)[0, 1] == 19


def test_upsample_undoes_a_block_reduction_of_constant_blocks() -> None:
    coarse = noise((3, 5))
    assert_array_equal(raster.block_max(raster.upsample(coarse, 4), 4), coarse)
    assert_array_equal(raster.upsample(coarse, 4, (10, 19)), raster.upsample(coarse, 4)[:10, :19])
    assert raster.upsample(np.zeros((3, 5, 3), np.uint8), 2).shape == (6, 10, 3)


def test_distance_is_scipys_and_infinite_without_a_target() -> None:
    mask = noise() > 2.0
    assert mask.any()
    assert_allclose(raster.distance_to(mask), ndimage.distance_transform_edt(~mask), rtol=1e-5)
    assert np.isinf(raster.distance_to(np.zeros((4, 5), np.bool_))).all()


def test_nearest_known_gives_every_cell_the_value_of_a_nearest_one() -> None:
    values, known = noise(), noise(seed=3) > 1.0
    found = raster.nearest_known(values, known)
    r, c = np.nonzero(known)
    for row, col in ((0, 0), (17, 33), (39, 49)):
        away = np.hypot(r - row, c - col)
        assert found[row, col] in values[r, c][away <= away.min() + 1e-9]
    assert_array_equal(found[known], values[known])
    assert_array_equal(raster.nearest_known(values, np.zeros_like(known)), values)


def test_morphology_is_scipys_with_the_same_element() -> None:
    mask, element = noise() > 0.8, raster.ellipse(2) > 0
    assert_array_equal(raster.grow(mask, 2), ndimage.binary_dilation(mask, element))
    padded = np.pad(mask, 4)
    closed = ndimage.binary_erosion(ndimage.binary_dilation(padded, element), element)[4:-4, 4:-4]
    inside = (slice(4, -4), slice(4, -4))
    assert_array_equal(raster.close_mask(mask, 2)[inside], closed[inside])
    values = noise(seed=4)
    assert_array_equal(raster.local_max(values, 2), ndimage.grey_dilation(values, footprint=element, mode="reflect"))
    closing = ndimage.grey_closing(values, footprint=element)
    assert_array_equal(raster.fill_pits(values, 5)[inside], closing[inside])


def test_specks_are_dropped_by_their_area() -> None:
    mask = np.zeros((20, 20), np.bool_)
    mask[2:5, 2:5] = True  # 9 cells of 0.01 m2
    mask[10:14, 10:14] = True  # 16 cells
    kept = raster.without_specks(mask, 0.1, 0.1)
    assert kept[10:14, 10:14].all()
    assert kept.sum() == 16


@pytest.mark.parametrize("radius", [1.0, 1.55])
def test_disc_statistics_are_those_of_the_cells_within_the_radius(radius: float) -> None:
    values, cell, reach = noise((31, 37)), 0.5, math.floor(radius / 0.5)
    values[10:14, 20] = np.nan
    mask = noise((31, 37), 5) > 1.2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.hypot(x, y) * cell <= radius + 1e-9
    for row, col in ((15, 18), (12, 21), (8, 9)):
        window = (slice(row - reach, row + reach + 1), slice(col - reach, col + reach + 1))
        here = values[window][disc]
        assert_allclose(raster.disc_mean(values, radius, cell)[row, col], np.nanmean(here), rtol=1e-4, atol=1e-5)
        assert raster.disc_max(np.nan_to_num(values), radius, cell)[row, col] == np.nan_to_num(here).max()
        assert_allclose(raster.disc_share(mask, radius, cell)[row, col], mask[window][disc].mean(), atol=1e-6)
        assert raster.disc_any(mask, radius, cell)[row, col] == mask[window][disc].any()


def test_a_disc_crosses_the_edge_nearer_than_its_radius() -> None:
    crossing = raster.disc_crosses_edge((9, 11), 1.0, 0.5)
    assert_array_equal(~crossing, np.pad(np.ones((5, 7), np.bool_), 2))


def test_ramp_and_logarithms() -> None:
    values = np.array([np.nan, -1.0, 0.0, 1.0, 2.0, 9.0], np.float32)
    assert_allclose(raster.linear_ramp(values, 0.0, 2.0), [0, 0, 0, 0.5, 1, 1])
    assert_allclose(raster.log_at_least(values, 0.5), np.log([1, 0.5, 0.5, 1, 2, 9]), rtol=1e-6)
    assert_allclose(raster.log_offset(values[2:], 0.5), np.log([0.5, 1.5, 2.5, 9.5]), rtol=1e-6)


def test_a_finer_grid_covers_the_same_ground() -> None:
    grid = Grid(10.0, 20.0, 0.5, 6, 8)
    fine = grid.finer(4)
    assert fine.shape == (24, 32)
    a, b = grid.transform, fine.transform
    assert_allclose((b[2], b[5], b[0] * 4), (a[2], a[5], a[0]))
    back = fine.coarser(4)
    assert_allclose((back.east, back.north, back.cell), (grid.east, grid.north, grid.cell))


@pytest.mark.parametrize(("row", "col"), [(5, 6), (0, 0), (8, 10)])
def test_a_disc_window_holds_the_cells_within_the_radius_and_ends_at_the_edge(row: int, col: int) -> None:
    found = raster.disc_window((9, 11), row, col, 2.0)
    want = np.hypot(*np.meshgrid(np.arange(9) - row, np.arange(11) - col, indexing="ij")) <= 2.0
    mask = np.zeros((9, 11), np.bool_)
    mask[found.rows, found.cols] = found.inside
    assert_array_equal(mask, want)
