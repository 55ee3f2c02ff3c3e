"""SIFT from the picture at full size on (Lowe 2004): OpenCV's detector doubles it first, for features not kept here.

In a photo of two megapixels OpenCV finds 29,000 features, 23,000 of them in the doubled picture. The largest 4,000
are kept, none of them from the doubled picture, which takes three quarters of the time and memory. The others are found
here as by OpenCV, from the same samples a quarter of a pixel beside the pixels. Samples on the pixels gave attitudes
with larger errors (docs/lab/photos.md).
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from alight.arrays import F32, F64, U8
from alight.photos.bundle import sift_kernels as kernels

BETWEEN = np.array([0.25, 0.75, 0.0])  # weights of pixels, to sample every other place of a doubled picture
OFFSET = -0.25  # pixels, place of these
LAYERS = 3  # of an octave
SIGMA = 1.6  # pixels, of the first picture of an octave
BLURRED = 0.5  # pixels, sigma of a photo's own blur
LEAST_SIDE = 16  # pixels of the smallest octave
MOST = 8  # pixels of an octave for each feature in the buffer


def blurred_octaves(grey: U8, blurred: float, octaves: int) -> Iterator[F32]:
    """The blurred pictures (`LAYERS` + 3, R, C) of one octave after the other, each of half the size."""
    step = 2.0 ** (1.0 / LAYERS)
    between = cv2.sepFilter2D(grey.astype(np.float32), -1, BETWEEN, BETWEEN)
    first = np.asarray(cv2.GaussianBlur(between, (0, 0), float(np.sqrt(SIGMA**2 - blurred**2))), np.float32)
    while min(first.shape) >= LEAST_SIDE and octaves > 0:
        out = np.empty((LAYERS + 3, *first.shape), np.float32)
        out[0] = first
        for k in range(1, len(out)):
            more = SIGMA * step ** (k - 1) * float(np.sqrt(step**2 - 1.0))
            cv2.GaussianBlur(out[k - 1], (0, 0), more, dst=out[k])
        yield out
        first, octaves = np.ascontiguousarray(out[LAYERS][::2, ::2]), octaves - 1


def detect(grey: U8, contrast: float, blurred: float = BLURRED, octaves: int = 16) -> F64:
    """Find features: (K, 5) column and row in the picture, size, octave as OpenCV packs it, orientation in degrees.

    Args:
        grey: (H, W).
        contrast: the least of a feature, shares of 255.
        blurred: sigma of the picture's own blur, pixels.
        octaves: most octaves.
    """
    out = []
    for octave, pictures in enumerate(blurred_octaves(grey, blurred, octaves)):
        found = np.empty((pictures[0].size // MOST, kernels.COLUMNS))
        n = kernels.features(np.diff(pictures, axis=0), pictures, SIGMA, 255.0 * contrast / LAYERS, found)
        between, layer, angle = found[:n, 2:].T
        size = 2.0 * SIGMA * 2.0 ** (between / LAYERS + octave)
        fraction = np.rint((between - layer + 0.5) * 255.0)
        packed = octave + 256 * layer + 65536 * fraction
        place = found[:n, :2] * 2.0**octave + OFFSET
        out.append(np.column_stack([place, size, packed, angle]))
    return np.concatenate(out) if out else np.empty((0, 5))


def keypoints(found: F64) -> list[cv2.KeyPoint]:
    """Features as keypoints of OpenCV, to describe them."""
    return [cv2.KeyPoint(x, y, size, angle, 0.0, int(octave)) for x, y, size, octave, angle in found.tolist()]
