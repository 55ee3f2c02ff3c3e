"""Read image files strictly: a truncated picture is refused, not filled with grey."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import BITSPERSAMPLE, IMAGELENGTH, IMAGEWIDTH, TiffImageFile

from alight.arrays import F32, U8, Mask
from alight.sources.image_formats import Levels, bits_of, developed, extra_of, opened_raw

Base = ExifTags.Base
UNREADABLE = (OSError, UnidentifiedImageError, SyntaxError, ValueError, Image.DecompressionBombError)


def open_image(path: Path | BytesIO, formats: tuple[str, ...] | None = None) -> Image.Image:
    """Open an image without decoding it; pillow's warnings are silenced, its errors are raised.

    Pipes and devices are refused, because they may block or have no end. `formats`: pillow's names; None: all.

    Raises:
        One of `UNREADABLE`: the file cannot be opened as an image.
    """
    if isinstance(path, Path) and not path.is_file():
        raise OSError("it is no plain file, or a link to nothing")
    if isinstance(path, Path) and extra_of(path) == "heic":
        from pillow_heif import register_heif_opener

        register_heif_opener()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Image.open(path, formats=formats)


class Header(NamedTuple):
    """Facts about an image file, read without decoding its pixels."""

    size: tuple[int, int]  # width, height as stored
    bits: int  # most bits of a value
    exif: dict[int, Any]  # main and photo directory, by tag number
    gps: dict[int, Any]
    xmp: bytes | str  # packet; empty: none
    segments: tuple[bytes, ...]  # application segments of a JPEG


def read_header(path: Path) -> Header:
    """Read size, depth and tags of an image; of several images in a file, the first is read.

    Raises:
        One of `UNREADABLE`: the file is not a readable image.
    """
    try:
        with open_image(path) as image:
            xmp, segments = image.info.get("xmp") or b"", [data for _, data in getattr(image, "applist", ())]
            header = Header(stored_size(image), bits_of(image), *_tags(image.getexif()), xmp, tuple(segments))
    except UnidentifiedImageError:
        header = _header_of_tiff(path)
    if extra_of(path) == "raw":
        with opened_raw(path) as raw:
            return header._replace(size=(int(raw.sizes.width), int(raw.sizes.height)), bits=8)
    return header


def _tags(exif: Image.Exif) -> tuple[dict[int, Any], dict[int, Any]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pillow warns of damaged tags and leaves them out, as intended
        return dict(exif) | dict(exif.get_ifd(ExifTags.IFD.Exif)), dict(exif.get_ifd(ExifTags.IFD.GPSInfo))


def _header_of_tiff(path: Path) -> Header:
    """Read the header of a TIFF whose pixels pillow cannot decode, such as raw pictures or bands of 16 bits.

    Raises:
        UnidentifiedImageError: the file is not a TIFF.
    """
    with path.open("rb") as file:
        if file.read(4) not in (b"II*\0", b"MM\0*"):
            raise UnidentifiedImageError("it is no image")
        exif = Image.Exif()
        file.seek(0)
        exif.load_from_fp(file)
        main, gps = _tags(exif)
    size = int(main.get(IMAGEWIDTH, 0)), int(main.get(IMAGELENGTH, 0))
    return Header(size, int(np.max(main.get(BITSPERSAMPLE, 8))), main, gps, main.get(Base.XMLPacket, b""), ())


def image_size(path: Path) -> tuple[int, int]:
    """Return (width, height) from the file's header.

    Raises:
        One of `UNREADABLE`: the file is not a readable image.
    """
    with open_image(path) as image:
        return stored_size(image)


def stored_size(image: Image.Image) -> tuple[int, int]:
    """Return (width, height) as stored in the file, before the EXIF orientation that pillow applies to TIFF images."""
    if isinstance(image, TiffImageFile):
        return int(image.tag_v2[IMAGEWIDTH]), int(image.tag_v2[IMAGELENGTH])
    return image.size


def _not_turned(path: Path) -> Image.Image:
    """Open a TIFF without pillow's rotation, from a copy in memory, because pillow damages grey TIFFs that it maps."""
    with Image.open(BytesIO(path.read_bytes())) as image:
        image.getexif()[Base.Orientation] = 1
        return image.copy()  # has the stored size


def _pixels(image: Image.Image) -> U8:
    if image.mode.startswith("I"):  # 16 bits: keep the upper eight
        return (np.asarray(image).astype(np.uint32) >> 8).clip(0, 255).astype(np.uint8)
    return np.array(image.convert("L" if image.mode in ("L", "1", "LA") else "RGB"), dtype=np.uint8)


def hidden_pixels(path: Path) -> Mask | None:
    """Return the mask (H, W) of pixels hidden by transparency; None: no pixel or all pixels are hidden, or unknown.

    Raises:
        One of `UNREADABLE`: the picture is damaged.
    """
    try:
        with open_image(path) as image:
            if not image.has_transparency_data:
                return None
            stored = _not_turned(path) if isinstance(image, TiffImageFile) else image
            hidden = np.asarray(stored.convert("RGBA").getchannel("A")) < 128
    except UnidentifiedImageError:
        return None
    return hidden if hidden.any() and not hidden.all() else None


def _filled(values: F32, seen: Mask) -> F32:
    """Return `values` (H, W, C) with pixels not `seen` (H, W) filled from ever coarser means of the seen pixels."""
    import cv2

    if seen.all():
        return values
    size = (values.shape[1] + 1) // 2, (values.shape[0] + 1) // 2
    share = cv2.resize(seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(values * seen[..., None], size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], -1)
    coarse = _filled(np.asarray(total / np.maximum(share, 1e-6)[..., None], np.float32), share > 0)
    fine = cv2.resize(coarse, seen.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(values.shape)
    return np.where(seen[..., None], values, fine)


def has_end(jpeg: bytes) -> bool:
    """Whether a JPEG has its end marker; decoders do not notice if a file system replaced its end with zeros."""
    marker, at = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]"), 2  # excludes stuffed bytes and restarts in coded data
    while found := marker.search(jpeg, at):
        at = found.end()
        if found.group() == b"\xff\xd9":
            return True
        at += int.from_bytes(jpeg[at : at + 2], "big")  # skip the segment and any thumbnail in it
    return False


@contextmanager
def _as_value_error(no_image: str) -> Iterator[None]:
    """Raise errors of opening and decoding as ValueError; `no_image`: reason if the bytes are of no known format."""
    try:
        yield
    except UnidentifiedImageError as e:
        raise ValueError(no_image) from e
    except UNREADABLE as e:
        raise ValueError(str(e)) from e


def read_image(path: Path, size: tuple[int, int], levels: Levels | None = None) -> U8:
    """Decode a whole image as stored, (H, W) if the file is grey, else (H, W, 3) RGB.

    OpenCV decodes a truncated JPEG without an error and leaves its lower part grey; pillow refuses the file. Pixels
    that transparency hides (propellers, borders) are filled smoothly, because a mask's edges look like features.

    Args:
        path: image file; of several images in it, the first is read.
        size: (width, height) that the calibration is for.
        levels: range of a set of files with more than eight bits; None: use the upper eight bits.

    Raises:
        ValueError: the image is truncated, damaged, or of another size.
    """
    with _as_value_error("it is no image"):
        if extra_of(path) == "raw" or levels is not None:
            _check_size(read_header(path).size, size)
            pixels = developed(path) if levels is None else levels.eight_bits(path)
        else:
            pixels = _decoded(path, size)
        hidden = hidden_pixels(path)
    if hidden is None:
        return pixels
    values = pixels.astype(np.float32).reshape(*hidden.shape, -1)
    return np.asarray(np.rint(_filled(values, ~hidden)), np.uint8).reshape(pixels.shape)


def decode_image(data: bytes, size: tuple[int, int]) -> U8:
    """Decode a JPEG or PNG in memory as `read_image` does, (H, W) grey or (H, W, 3) RGB; `size`: width and height.

    Raises:
        ValueError: the image is truncated, damaged, or of another size.
    """
    with _as_value_error("it is no JPEG or PNG"):
        return _decoded(BytesIO(data), size, ("JPEG", "PNG"))


def _decoded(source: Path | BytesIO, size: tuple[int, int], formats: tuple[str, ...] | None = None) -> U8:
    """Decode an image as stored, without regard to transparency; see `open_image` and `read_image`."""
    with open_image(source, formats) as image:
        _check_size(stored_size(image), size)
        if isinstance(source, Path) and isinstance(image, TiffImageFile):
            return _pixels(_not_turned(source))
        pixels, jpeg = _pixels(image), image.format in ("JPEG", "MPO")
    if jpeg and not has_end(source.read_bytes() if isinstance(source, Path) else source.getvalue()):
        raise ValueError("it is truncated: its end is missing")
    return pixels


def _check_size(stored: tuple[int, int], size: tuple[int, int]) -> None:
    if stored != size:
        raise ValueError(f"it is {stored[0]}x{stored[1]}, the camera {size[0]}x{size[1]}")
