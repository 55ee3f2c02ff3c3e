"""Image files, read strictly: a picture that is cut off is refused, not filled up with grey."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import IMAGELENGTH, IMAGEWIDTH, TiffImageFile

UNREADABLE = (OSError, UnidentifiedImageError, SyntaxError, ValueError, Image.DecompressionBombError)

# how the turn of each EXIF orientation is undone
_UNTURN = {
    2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_90, 7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}  # fmt: skip


def open_image(path: Path) -> Image.Image:
    """Open an image without decoding it; pillow's own warnings are silenced, what it cannot read raises.

    A pipe would be waited for, and a device has no end.

    Raises:
        One of `UNREADABLE`.
    """
    if not path.is_file():
        raise OSError("it is no plain file, or a link to nothing")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Image.open(path)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header.

    Raises:
        One of `UNREADABLE`.
    """
    with open_image(path) as image:
        return stored_size(image)


def stored_size(image: Image.Image) -> tuple[int, int]:
    """(width, height) as the pixels lie in the file: pillow turns a TIFF by its EXIF orientation, and nothing else."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2[IMAGEWIDTH]), int(image.tag_v2[IMAGELENGTH])
    return image.size


def _as_stored(image: Image.Image) -> Image.Image:
    if not isinstance(image, TiffImageFile):
        return image
    unturn = _UNTURN.get(image.tag_v2.get(ExifTags.Base.Orientation, 1))  # the tag is gone once the pixels are read
    image.load()
    return image if unturn is None else image.transpose(unturn)


def _pixels(image: Image.Image) -> NDArray[np.uint8]:
    if image.mode.startswith("I"):  # 16 bits: keep the upper eight
        return (np.asarray(image).astype(np.uint32) >> 8).clip(0, 255).astype(np.uint8)
    grey = image.mode in ("L", "1", "LA")
    return np.array(image.convert("L" if grey else "RGB"), dtype=np.uint8)


_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")  # in coded data: neither a stuffed byte nor a restart
_END = 0xD9


def has_end(jpeg: bytes) -> bool:
    """Tell whether a JPEG has its end marker: a file system that fills a cut with zeros fools every decoder."""
    at = 2
    while marker := _MARKER.search(jpeg, at):
        at = marker.end()
        kind = jpeg[at - 1]
        if kind == _END:
            return True
        at += int.from_bytes(jpeg[at : at + 2], "big")  # skip the segment, thumbnails in it included
    return False


def read_image(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Decode a whole image as it is stored, (H, W) when the file is grey, else (H, W, 3) RGB.

    OpenCV decodes a truncated JPEG without a word and leaves its lower part grey: hence pillow, which refuses it.

    Raises:
        ValueError: cut off, damaged, or not of the (width, height) that the calibration is for.
    """
    try:
        with open_image(path) as image:
            stored = stored_size(image)
            if stored != size:
                raise ValueError(f"it is {stored[0]}x{stored[1]}, the camera {size[0]}x{size[1]}")
            pixels, jpeg = _pixels(_as_stored(image)), image.format in ("JPEG", "MPO")
        if jpeg and not has_end(path.read_bytes()):
            raise ValueError("it is truncated: its end is missing")
        return pixels
    except UnidentifiedImageError as e:
        raise ValueError("it is no image") from e
    except UNREADABLE as e:
        raise ValueError(str(e)) from e
