"""SIFT features of photos by OpenCV (Lowe 2004), the largest of them.

OpenCV doubles a picture first. In a photo of two megapixels it finds 29,000 features, 23,000 of them in the doubled
picture, which takes three quarters of time and memory. None of the 4,000 largest, which are kept, comes from it.
OpenCV is therefore given the picture at half its size, which it doubles. The blur of the first octave, sigma 1.6
pixels, leaves little of what halving takes away (docs/lab/photos.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType

import cv2
import numpy as np

from alight.arrays import F32, F64, U8
from alight.geometry import Camera
from alight.jobs import Jobs, Sent, Task
from alight.raster import grey_levels, rgb_levels
from alight.records import Frame, MissingExtraError, Pixels
from alight.settings import BundleSettings

_CONTRAST = 0.02  # least contrast of a feature, grey levels over 255; yields as many features as pycolmap
_ENOUGH = 1500  # with as many features, a photo is not read at its whole size


@dataclass(frozen=True, eq=False)
class PhotoFeatures:
    """SIFT features of one photo."""

    pixels: F64  # (K, 2) in pixels of the full-size photo
    descriptors: U8  # (K, 128)
    colours: F32  # (K, 3) mean RGB around each feature

    @property
    def unit(self) -> F32:
        """(K, 128) descriptors, normalised to unit length."""
        table = self.descriptors.astype(np.float32)
        return np.asarray(table / np.maximum(np.linalg.norm(table, axis=1, keepdims=True), 1e-9), dtype=np.float32)


def colmap() -> ModuleType:
    """Import and return pycolmap, with its log messages switched off.

    Raises:
        MissingExtraError: pycolmap is not installed.
    """
    try:
        import pycolmap
    except ImportError as e:
        raise MissingExtraError("pycolmap", "photos") from e
    pycolmap.logging.logtostderr = False
    pycolmap.logging.alsologtostderr = False
    pycolmap.logging.minloglevel = 3
    pycolmap.logging.stderrthreshold = 3
    module: ModuleType = pycolmap
    return module


def colmap_camera(camera: Camera) -> object:
    """Convert to a pycolmap camera, whose pixel (0, 0) is the corner, not the centre, of the first pixel."""
    k = [camera.fu, camera.fv, camera.cu + 0.5, camera.cv + 0.5]
    d = list(camera.distortion)
    model, params = {
        "none": ("PINHOLE", k),
        "radial-tangential": ("FULL_OPENCV", k + d + [0.0] * (8 - len(d))),
        "equidistant": ("OPENCV_FISHEYE", k + d),
    }[camera.model]
    out = colmap().Camera(model=model, width=camera.width, height=camera.height, params=params)
    out.has_prior_focal_length = True
    return out


def shrunk(image: Pixels, longest: float) -> U8:
    """Return a picture, (H, W) grey or (H, W, 3) RGB, downscaled if its longer side exceeds `longest` pixels."""
    picture = np.asarray(image)
    factor = longest / max(picture.shape[:2])
    if factor < 1.0:
        size = (round(picture.shape[1] * factor), round(picture.shape[0] * factor))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    return np.ascontiguousarray(picture, dtype=np.uint8)


def extract(image: Pixels | None, settings: BundleSettings) -> PhotoFeatures:
    """Extract the largest SIFT features of one photo; an image that is None has no features.

    The largest features match twice as often as the features of highest contrast. If a small or dull picture has too
    few, those of the doubled picture are taken too, at four times the cost.
    """
    picture = np.zeros((16, 16), np.uint8) if image is None else np.asarray(image)
    read = shrunk(picture, settings.image_px)
    grey = grey_levels(read)
    half = shrunk(grey, max(grey.shape) / 2)
    place, table = described(half, settings.features)
    if len(place) < min(_ENOUGH, settings.features):
        half = grey
        place, table = described(grey, settings.features)
    whole, colour = (
        (place + 0.5) * (np.array(size[1::-1]) / half.shape[::-1]) - 0.5 for size in (picture.shape, read.shape)
    )
    return PhotoFeatures(whole, table, colours_at(read, colour))


def described(grey: U8, count: int) -> tuple[F64, U8]:
    """Return pixels (K, 2) and descriptors (K, 128) of the `count` largest features of a picture and its double."""
    sift = cv2.SIFT.create(contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    largest = sorted(sift.detect(grey, None), key=lambda k: -k.size)[:count]
    kept, descriptors = sift.compute(grey, largest)
    place = np.array([k.pt for k in kept], dtype=np.float64).reshape(-1, 2)
    return place, rooted(np.zeros((0, 128), np.float32) if descriptors is None else descriptors)


def rooted(descriptors: F32) -> U8:
    """Return square roots of sum-normalised descriptors (K, 128), for Hellinger distances (Arandjelovic 2012)."""
    share = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(np.rint(np.minimum(512.0 * np.sqrt(share), 255.0)), dtype=np.uint8)


def colours_at(picture: U8, pixels: F64) -> F32:
    """Return the mean colours (K, 3) around pixels (K, 2) of a picture, RGB (H, W, 3) or grey (H, W)."""
    even = rgb_levels(np.asarray(cv2.blur(picture, (9, 9)), np.uint8))
    col, row = (np.rint(pixels[:, k]).astype(int).clip(0, even.shape[1 - k] - 1) for k in (0, 1))
    return np.asarray(even[row, col], dtype=np.float32)


def taken_by(frame: Frame) -> int:
    """Return the index of the first camera that has a picture in the frame; 0 if no camera has one."""
    return next((k for k, image in enumerate(frame.images) if image is not None), 0)


def extract_all(frames: Sequence[Frame], settings: BundleSettings, jobs: Jobs) -> Iterator[PhotoFeatures]:
    """Extract the features of every photo, in order; a photo without a picture has no features."""
    colmap()
    sent = (Sent(f"photo-{f.t_ns}-{taken_by(f)}", f.images[taken_by(f)]) for f in frames)
    tasks = (Task(f"features-{f.t_ns}", extract, (image, settings)) for f, image in zip(frames, sent, strict=True))
    return jobs.run(tasks, at_once=True)
