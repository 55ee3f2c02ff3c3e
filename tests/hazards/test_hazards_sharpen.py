"""Heights sharpened by shading: compared with the rendered ground, and rejected where shading is not reliable."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from ground import ground
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.hazards.footprint_kernels import cast_shadows
from alight.hazards.sharpen import coarsen, find_light, gradients, in_shadow, shadow_level, sharpen
from alight.records import Flag
from alight.settings import HazardsSettings, Lander
from alight.settings.tuning.hazards import SharpenTuning

TUNING = SharpenTuning()
PIXEL = 0.1
SUN = np.array([0.70, 0.25, 0.67])  # along columns, rows and up


def domes(seed: int, shape: tuple[int, int] = (160, 160), rocks: int = 30) -> np.ndarray:
    """Rolling ground with half-round rocks of 0.2 to 0.5 m."""
    rng = np.random.default_rng(seed)
    base = (3 * cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), 20)).astype(np.float32)
    top = np.zeros(shape, np.float32)
    r, c = np.mgrid[: shape[0], : shape[1]]
    for _ in range(rocks):
        y, x, radius = rng.uniform(8, shape[0] - 8), rng.uniform(8, shape[1] - 8), rng.uniform(0.2, 0.5)
        dome = radius**2 - ((r - y) ** 2 + (c - x) ** 2) * PIXEL**2
        top = np.maximum(top, np.sqrt(np.maximum(dome, 0)).astype(np.float32))
    return base + top


def photograph(z: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Render a Lambert picture with cast shadows, 8 bit."""
    along, across = gradients(z, PIXEL)
    facing = (SUN[2] - SUN[0] * along - SUN[1] * across) / np.sqrt(1 + along**2 + across**2)
    level = float(np.hypot(SUN[0], SUN[1]))
    shadow = np.zeros(z.shape, bool)
    cast_shadows(z, SUN[1] / level, SUN[0] / level, SUN[2] / level * PIXEL, 100, shadow)
    lit = 20 + 220 * np.maximum(facing, 0)
    picture = np.where(shadow, 15.0, lit) + np.random.default_rng(seed).normal(0, noise, z.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("factor", [2, 4])
def test_cells_are_what_linear_resampling_makes_of_pixels(factor: int) -> None:
    r, c = np.mgrid[: 8 * factor, : 9 * factor].astype(np.float32)
    middle = (np.arange(9) + 0.5) * factor - 0.5
    inner = np.s_[1:-1, 1:-1]
    assert_allclose(
        coarsen(0.3 * c - 0.2 * r, factor)[inner], (0.3 * middle - 0.2 * middle[:8, None])[inner], rtol=1e-5
    )
    if factor == 2:
        spike = np.zeros((8, 8), np.float32)
        spike[3, 4] = 64.0
        assert_allclose(coarsen(spike, 2)[1, 1:4], [3.0, 9.0, 0.0])  # (1 3 3 1) / 8 both ways


def test_a_wall_casts_its_shadow_as_far_as_the_sun_says() -> None:
    z = np.zeros((9, 60), np.float32)
    z[:, 40] = 1.0
    out = np.zeros(z.shape, bool)
    cast_shadows(z, 0.0, 1.0, 0.1, 100, out)  # the sun stands beyond the wall and climbs 0.1 m a cell
    assert out[4, 31:40].all()
    assert not out[4, :29].any()
    assert not out[4, 40:].any()


def test_the_light_is_found() -> None:
    z = domes(1, rocks=90)
    picture = photograph(z).astype(np.float32) + 0.5
    shadow = in_shadow(z, find_light(z, picture, picture > 40, PIXEL), PIXEL)
    dark = shadow_level(picture, shadow)
    light = find_light(z, picture, picture > dark, PIXEL)
    assert_allclose(light.sun, 220 * SUN, rtol=0.03, atol=3.0)
    assert light.explained > 0.9  # the rest are the rims of rocks
    assert 15 < dark < 40


def test_rocks_that_the_cells_smear_get_their_height_back() -> None:
    z = domes(2)
    cells = coarsen(z, 2)
    finer = sharpen(ground(cells, 0.2, sigma=0.002), photograph(z), TUNING)
    assert finer is not None
    assert finer.grid.shape == z.shape
    assert_allclose(finer.grid.cell, PIXEL)
    assert_allclose([finer.grid.east, finer.grid.north], [-0.05, 79 * 0.2 + 0.05], atol=1e-9)
    smooth = cv2.resize(cells, z.shape[::-1], interpolation=cv2.INTER_CUBIC)
    peaks = (cv2.dilate(z, np.ones((9, 9))) == z) & (coarsen_relief(z) > 0.15)
    peaks[:10] = peaks[-10:] = peaks[:, :10] = peaks[:, -10:] = False
    before, after = (np.abs(a - z)[peaks] for a in (smooth, finer.height))
    assert peaks.sum() > 8
    assert np.quantile(after, 0.9) < 0.5 * np.quantile(before, 0.9)  # the small rocks; the cells show the large ones
    assert np.quantile(after, 0.9) < 0.02
    inner = np.s_[8:-8, 8:-8]
    assert np.sqrt(np.mean((finer.height - z)[inner] ** 2)) < 0.7 * np.sqrt(np.mean((smooth - z)[inner] ** 2))


def coarsen_relief(z: np.ndarray) -> np.ndarray:
    return np.asarray(z - cv2.GaussianBlur(z, (0, 0), 8))


def test_paint_is_not_shape() -> None:
    z = domes(3)
    paint = np.random.default_rng(0).integers(0, 255, (20, 20)).astype(np.uint8)
    picture = cv2.resize(paint, z.shape[::-1], interpolation=cv2.INTER_NEAREST)
    assert sharpen(ground(coarsen(z, 2), 0.2, sigma=0.002), picture, TUNING) is None


def test_what_is_unknown_stays_unknown_and_its_surroundings_whole() -> None:
    z = domes(4)
    e = ground(coarsen(z, 2), 0.2, sigma=0.002)
    e.flags[30:36, 40:50] = Flag.MOVING
    e.height[60:64, 20:24] = np.nan
    e.flags[60:64, 20:24] = Flag.UNSEEN
    finer = sharpen(e, photograph(z), TUNING)
    assert finer is not None
    assert not finer.trusted[60:72, 80:100].any()
    assert np.isnan(finer.height[120:128, 40:48]).all()
    near = finer.height[56:60, 80:100] - z[56:60, 80:100]
    assert np.abs(near).max() < 0.15


def test_an_image_of_another_size_is_refused() -> None:
    e = ground(np.zeros((20, 20)), 0.2)
    for shape in ((40, 41), (20, 20), (60, 60)):
        with pytest.raises(ValueError, match="same extent"):
            sharpen(e, np.zeros(shape, np.uint8), TUNING)


def test_finer_heights_that_count_as_smoothed_are_judged() -> None:
    z = domes(1)
    finer = sharpen(ground(coarsen(z, 2), 0.2, sigma=0.002), photograph(z), TUNING)
    assert finer is not None
    assert_allclose(finer.sampling, np.full(z.shape, 0.2))
    assert np.isfinite(assess(finer, None, Lander(radius=1.0), HazardsSettings()).p_safe[40:-40, 40:-40]).all()
