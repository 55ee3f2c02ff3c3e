"""SIFT features of photos: their places, and what small and empty pictures give."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from alight.arrays import U8
from alight.photos.bundle.features import extract
from alight.settings import BundleSettings

SETTINGS = BundleSettings()


def ground(seed: int, side: int = 400) -> U8:
    """Blobs of all sizes."""
    rng, out = np.random.default_rng(seed), np.zeros((side, side), np.float32)
    for sigma in (1.0, 2.0, 4.0, 8.0, 16.0):
        noise = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), sigma)
        out += 15 * noise / noise.std()
    return np.clip(128 + out, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("reduced", [1.0, 0.6])
def test_features_lie_where_they_lie_in_the_whole_picture(reduced: float) -> None:
    """A few differ between sizes of the picture; the others have no common offset."""
    picture = ground(1, 1600)
    own = extract(picture, SETTINGS.model_copy(update={"image_px": round(1600 * reduced), "features": 1500})).pixels
    found = cv2.SIFT.create(contrastThreshold=0.02, enable_precise_upscale=True).detect(picture, None)
    near, which = cKDTree(np.array([k.pt for k in found])).query(own)
    assert (near < 0.5).mean() > 0.6
    off = (own - np.array([found[k].pt for k in which]))[near < 0.5]
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=0.03)


def test_a_shift_of_a_part_of_a_pixel_is_found() -> None:
    """Features are placed between pixels: in a picture of half the size, a shift of one pixel is a half."""
    large = ground(3, 800)
    first, second = (cv2.resize(large[:, k : 798 + k], (399, 400), interpolation=cv2.INTER_AREA) for k in (0, 1))
    a, b = (extract(np.ascontiguousarray(p), SETTINGS).pixels for p in (first, second))
    near, which = cKDTree(a).query(b + np.array([0.5, 0.0]))
    assert (near < 1.0).mean() > 0.6
    np.testing.assert_allclose(np.median((a[which] - b)[near < 1.0], axis=0), [0.5, 0.0], atol=0.03)


@pytest.mark.parametrize("picture", [np.zeros((300, 200), np.uint8), np.full((10, 12), 7, np.uint8)])
def test_nothing_to_see_has_no_features(picture: U8) -> None:
    found = extract(picture, SETTINGS)
    assert found.pixels.shape == (0, 2)
    assert found.descriptors.shape == (0, 128)


def test_a_small_picture_has_finer_features_too() -> None:
    """The largest come first, so that a smaller number is a part of a larger one."""
    few, many = (extract(ground(5), BundleSettings(features=n)).pixels for n in (1500, 3000))
    assert (len(few), len(many)) == (1500, 3000)
    np.testing.assert_array_equal(few, many[:1500])
