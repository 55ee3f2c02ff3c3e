"""The SIFT detector against OpenCV's, on whole pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from alight.arrays import F64, U8
from alight.photos.bundle.features import detect, extract, keypoints
from alight.settings import BundleSettings

CONTRAST = 0.02


def ground(seed: int, side: int = 400) -> U8:
    """Blobs of all sizes."""
    rng, out = np.random.default_rng(seed), np.zeros((side, side), np.float32)
    for sigma in (1.0, 2.0, 4.0, 8.0, 16.0):
        noise = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), sigma)
        out += 15 * noise / noise.std()
    return np.clip(128 + out, 0, 255).astype(np.uint8)


def of_opencv(picture: U8) -> F64:
    """Features of OpenCV that do not come from the doubled picture: column, row, size, angle."""
    found = cv2.SIFT.create(nfeatures=0, contrastThreshold=CONTRAST).detect(picture, None)
    return np.array([[k.pt[0] - 0.25, k.pt[1] - 0.25, k.size, k.angle] for k in found if k.octave & 255 < 128])


def compared(found: F64) -> F64:
    """Columns in comparable units, for features of two detectors: pixels, a tenth of an octave, a tenth of a radian."""
    angle = np.radians(found[:, -1])
    return np.c_[found[:, :2], 10 * np.log2(found[:, 2]), 10 * np.cos(angle), 10 * np.sin(angle)]


def test_features_are_those_of_opencv() -> None:
    """A few lie at a limit. OpenCV doubles centres, not corners, and its own lie a quarter of a pixel too far right."""
    picture = ground(1)
    own, other = compared(detect(picture, CONTRAST)[:, [0, 1, 2, 4]]), compared(of_opencv(picture))
    assert len(own) == pytest.approx(len(other), rel=0.02)
    near, which = cKDTree(own).query(other)
    assert (near < 0.2).mean() > 0.95
    np.testing.assert_allclose((own[which] - other)[near < 0.2].mean(axis=0), 0, atol=0.01)


def test_a_turned_picture_has_the_same_features_turned() -> None:
    picture = ground(2)
    own, turned = detect(picture, CONTRAST), detect(np.ascontiguousarray(np.rot90(picture)), CONTRAST)
    back = np.c_[399 - turned[:, 1], turned[:, 0], turned[:, 2], turned[:, 4] - 270]
    near = cKDTree(compared(back)).query(compared(own[:, [0, 1, 2, 4]]))[0]
    assert (near < 2.0).mean() > 0.65


def test_a_shift_of_a_part_of_a_pixel_is_found() -> None:
    """Features are placed between pixels: in a picture of half the size, a shift of one pixel is a half."""
    large = ground(3, 800)
    first, second = (cv2.resize(large[:, k : 798 + k], (399, 400), interpolation=cv2.INTER_AREA) for k in (0, 1))
    a, b = (compared(detect(np.ascontiguousarray(p), CONTRAST)[:, [0, 1, 2, 4]]) for p in (first, second))
    near, which = cKDTree(a).query(b + np.array([0.5, 0, 0, 0, 0]))
    assert (near < 1.0).mean() > 0.6
    shift = (a[which] - b)[near < 1.0]
    np.testing.assert_allclose(np.median(shift[:, :2], axis=0), [0.5, 0.0], atol=0.03)


@pytest.mark.parametrize("picture", [np.zeros((300, 200), np.uint8), np.full((10, 12), 7, np.uint8)])
def test_nothing_to_see_has_no_features(picture: U8) -> None:
    assert detect(picture, CONTRAST).shape == (0, 5)
    found = extract(picture, BundleSettings())
    assert found.pixels.shape == (0, 2)
    assert found.descriptors.shape == (0, 128)


def test_opencv_describes_them() -> None:
    """OpenCV's descriptors of its own features and of these are similar, so that the octave is packed as in OpenCV."""
    picture = ground(4)
    sift, found = cv2.SIFT.create(nfeatures=0, contrastThreshold=CONTRAST), detect(picture, CONTRAST)
    own, table = sift.compute(picture, keypoints(found))
    theirs = [k for k in sift.detect(picture, None) if k.octave & 255 < 128]
    other = sift.compute(picture, theirs)[1]
    assert len(own) == len(found)
    near, which = cKDTree(compared(found[:, [0, 1, 2, 4]])).query(compared(of_opencv(picture)))
    apart = np.linalg.norm(table[which] - other, axis=1)[near < 0.2]
    assert np.median(apart) < 0.1 * 512


def test_a_small_picture_has_those_of_the_doubled_one_too() -> None:
    """The features of the picture come first; the finer ones agree with OpenCV's of the doubled picture."""
    picture = ground(5)
    own = len(detect(picture, CONTRAST))
    few, many = (extract(picture, BundleSettings(features=n)) for n in (own, own + 500))
    assert len(few.pixels) == own
    assert len(many.pixels) == own + 500
    np.testing.assert_array_equal(few.pixels, many.pixels[:own])
    theirs = np.array([k.pt for k in cv2.SIFT.create(contrastThreshold=CONTRAST).detect(picture, None)]) - 0.25
    near = cKDTree(theirs).query(many.pixels[own:])[0]
    assert np.mean(near < 0.3) > 0.7
