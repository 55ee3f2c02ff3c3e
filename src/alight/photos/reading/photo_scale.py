"""Scale of a photo by its tags: pixels a millimetre of the sensor, and pixels a pixel of the factory calibration."""

from __future__ import annotations

from typing import Any

from PIL import ExifTags

from alight.geometry import Camera
from alight.photos.reading.photo_tags import PhotoTags, finite

Base = ExifTags.Base
Notes = dict[str, Any]

MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # EXIF FocalPlaneResolutionUnit


def calibrated_width(tags: PhotoTags) -> float:
    """Width in pixels of the image that the factory calibration is for: photos may have been resized since."""
    width = tags.number(Base.ExifImageWidth) or tags.size[0]
    centre = tags.xmp_number("dji:CalibratedOpticalCenterX") or tags.xmp_number("skydio:CalibratedOpticalCenterX")
    if centre and abs(2 * centre / width - 1) > 0.1:  # a tool that resized and rewrote the EXIF size
        return 2 * centre
    return width


def camera_of(
    tags: PhotoTags, f: float, offset: tuple[float, float] = (0, 0), lens: tuple[float, ...] = (), model: str = ""
) -> Camera:
    """Make a camera from a focal length and an offset of the principal point from the image's centre, pixels.

    Makers put the image's centre at (w/2, h/2), counted from the corner; our (0, 0) is the centre of the first pixel.
    """
    w, h = tags.size
    model = model or ("radial-tangential" if any(lens) else "none")
    return Camera(w, h, f, f, w / 2 + offset[0] - 0.5, h / 2 + offset[1] - 0.5, model, () if model == "none" else lens)


def pixels_a_millimetre(tags: PhotoTags) -> float | None:
    """Pixels of the photo a millimetre of the sensor, a digital zoom included; None without the tags."""
    resolution = tags.number(Base.FocalPlaneXResolution)
    unit = MM_PER_UNIT.get(int(tags.number(Base.FocalPlaneResolutionUnit) or 2))
    return None if not resolution or unit is None else resolution / unit * photo_scale(tags)


def photo_scale(tags: PhotoTags) -> float:
    """Pixels of the photo a pixel of the factory calibration: it was resized since, or zoomed digitally."""
    return tags.size[0] / calibrated_width(tags) * tags.digital_zoom


def comma_numbers(text: str) -> list[float]:
    """Numbers with commas between them; none where one is malformed."""
    values = [finite(v) for v in text.split(",")]
    numbers = [v for v in values if v is not None]
    return numbers if len(numbers) == len(values) else []
