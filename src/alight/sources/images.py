"""Image files, read strictly: a picture that is cut off is refused, not filled up with grey."""

from __future__ import annotations

import re
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import IMAGELENGTH, IMAGEWIDTH, TiffImageFile

from alight.arrays import U8

UNREADABLE = (OSError, UnidentifiedImageError, SyntaxError, ValueError, Image.DecompressionBombError)


def open_image(path: Path) -> Image.Image:
    """Open an image without decoding it; pillow's own warnings are silenced, but its errors are raised.

    Pipes and devices are refused: they may block, or have no end.

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
    """(width, height) as stored in the file: pillow turns only TIFF images by their EXIF orientation."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2[IMAGEWIDTH]), int(image.tag_v2[IMAGELENGTH])
    return image.size


def _not_turned(path: Path) -> Image.Image:
    """A TIFF as it is stored: pillow turns them, and damages grey ones that it maps into memory."""
    with Image.open(BytesIO(path.read_bytes())) as image:
        image.getexif()[ExifTags.Base.Orientation] = 1
        return image.copy()  # with the size of the pixels


def _pixels(image: Image.Image) -> U8:
    if image.mode.startswith("I"):  # 16 bits: keep the upper eight
        return (np.asarray(image).astype(np.uint32) >> 8).clip(0, 255).astype(np.uint8)
    return np.array(image.convert("L" if image.mode in ("L", "1", "LA") else "RGB"), dtype=np.uint8)


def has_end(jpeg: bytes) -> bool:
    """True if a JPEG has its end marker: no decoder notices a file system that fills a cut with zeros."""
    marker, at = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]"), 2  # in coded data: neither a stuffed byte nor a restart
    while found := marker.search(jpeg, at):
        at = found.end()
        if found.group() == b"\xff\xd9":
            return True
        at += int.from_bytes(jpeg[at : at + 2], "big")  # skip the segment, thumbnails in it included
    return False


def read_image(path: Path, size: tuple[int, int]) -> U8:
    """Decode a whole image as it is stored, (H, W) when the file is grey, else (H, W, 3) RGB.

    OpenCV decodes a truncated JPEG without an error and leaves its lower part grey; pillow refuses it.

    Raises:
        ValueError: cut off, damaged, or not of the (width, height) that the calibration is for.
    """
    try:
        with open_image(path) as image:
            stored = stored_size(image)
            if stored != size:
                raise ValueError(f"it is {stored[0]}x{stored[1]}, the camera {size[0]}x{size[1]}")
            if isinstance(image, TiffImageFile):
                return _pixels(_not_turned(path))
            pixels, jpeg = _pixels(image), image.format in ("JPEG", "MPO")
        if jpeg and not has_end(path.read_bytes()):
            raise ValueError("it is truncated: its end is missing")
        return pixels
    except UnidentifiedImageError as e:
        raise ValueError("it is no image") from e
    except UNREADABLE as e:
        raise ValueError(str(e)) from e
