"""SIFT features of photos, without OpenCV's doubled first octave (Lowe 2004). Descriptors are OpenCV's.

OpenCV doubles the picture first. In a photo of two megapixels it finds 29,000 features, 23,000 of them in the doubled
picture, which takes three quarters of time and memory. None of the 4,000 largest, which are kept, comes from it. All
other octaves are computed as OpenCV does, from samples a quarter of a pixel off the pixel centres. Samples at the
centres gave larger attitude errors (docs/lab/photos.md).
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
from alight.photos.bundle.sift_kernels import features
from alight.raster import grey_levels, rgb_levels
from alight.records import Frame, MissingExtraError, Pixels
from alight.settings import BundleSettings

LAYERS, SIGMA = 3, 1.6  # layers per octave; sigma of an octave's first picture, pixels
BLURRED = 0.5  # pixels, sigma of the blur in a photo itself
_CONTRAST = 0.02  # least contrast of a feature, grey levels over 255; yields as many features as pycolmap
_ENOUGH = 1500  # with as many features, a photo's doubled picture is not used


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


def blurred_octaves(grey: U8, blurred: float, octaves: int) -> Iterator[F32]:
    """Yield the blurred pictures (`LAYERS` + 3, R, C) of at most `octaves` octaves; `blurred`: sigma (px) in `grey`."""
    step = 2.0 ** (1.0 / LAYERS)
    weights = np.array([0.25, 0.75, 0.0])  # of pixels, to sample every other pixel of a doubled picture
    between = cv2.sepFilter2D(grey.astype(np.float32), -1, weights, weights)
    first = np.asarray(cv2.GaussianBlur(between, (0, 0), float(np.sqrt(SIGMA**2 - blurred**2))), np.float32)
    while min(first.shape) >= 16 and octaves > 0:
        out = np.empty((LAYERS + 3, *first.shape), np.float32)
        out[0] = first
        for k in range(1, len(out)):
            more = SIGMA * step ** (k - 1) * float(np.sqrt(step**2 - 1.0))
            cv2.GaussianBlur(out[k - 1], (0, 0), more, dst=out[k])
        yield out
        first, octaves = np.ascontiguousarray(out[LAYERS][::2, ::2]), octaves - 1


def detect(grey: U8, contrast: float, blurred: float = BLURRED, octaves: int = 16) -> F64:
    """Detect features; return (K, 5) column, row, size (px), octave as OpenCV packs it, orientation in degrees.

    Args:
        grey: (H, W).
        contrast: least contrast of a feature, as a share of 255.
        blurred: sigma of the blur in the picture itself, pixels.
        octaves: greatest number of octaves.
    """
    out = []
    for octave, pictures in enumerate(blurred_octaves(grey, blurred, octaves)):
        found = np.empty((pictures[0].size // 8, 5))
        n = features(np.diff(pictures, axis=0), pictures, SIGMA, 255.0 * contrast / LAYERS, found)
        between, layer, angle = found[:n, 2:].T
        size = 2.0 * SIGMA * 2.0 ** (between / LAYERS + octave)
        fraction = np.rint((between - layer + 0.5) * 255.0)
        packed = octave + 256 * layer + 65536 * fraction
        place = found[:n, :2] * 2.0**octave - 0.25
        out.append(np.column_stack([place, size, packed, angle]))
    return np.concatenate(out) if out else np.empty((0, 5))


def keypoints(found: F64) -> list[cv2.KeyPoint]:
    """Convert features of `detect` to OpenCV keypoints."""
    return [cv2.KeyPoint(x, y, size, angle, 0.0, int(octave)) for x, y, size, octave, angle in found.tolist()]


def extract(image: Pixels | None, settings: BundleSettings) -> PhotoFeatures:
    """Extract the largest SIFT features of one photo; an image that is None has no features.

    The largest features match twice as often as the features of highest contrast. If a small or dull picture has too
    few, features of the doubled picture are added, at four times the cost.
    """
    picture = np.zeros((16, 16), np.uint8) if image is None else np.asarray(image)
    read = shrunk(picture, settings.image_px)
    grey = grey_levels(read)
    place, table = described(grey, detect(grey, _CONTRAST), settings.features)
    if len(place) < min(_ENOUGH, settings.features):
        twice = np.asarray(cv2.resize(grey, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR), np.uint8)
        found = detect(twice, _CONTRAST, 2 * BLURRED, octaves=1)
        finer, its_table = described(twice, found, settings.features - len(place))
        place, table = np.concatenate([place, (finer + 0.5) / 2 - 0.5]), np.concatenate([table, its_table])
    scale = np.array(picture.shape[1::-1]) / grey.shape[1::-1]
    return PhotoFeatures((place + 0.5) * scale - 0.5, table, colours_at(read, place))


def described(grey: U8, found: F64, count: int) -> tuple[F64, U8]:
    """Describe the `count` largest features `found` (see `detect`); return pixels (K, 2) and descriptors (K, 128)."""
    largest = np.argsort(-found[:, 2], kind="stable")[:count]
    kept, descriptors = cv2.SIFT.create().compute(grey, keypoints(found[largest]))
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
