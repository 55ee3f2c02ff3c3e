"""Sensor sizes of mapping cameras, and focal lengths from them."""

from __future__ import annotations

import math

FILM_DIAGONAL = math.hypot(36, 24)  # mm
WIDE = 1.6  # width over height from which a picture is cut out of a sensor of another shape
FOUR_THIRDS, THREE_HALVES = 4 / 3, 3 / 2
# Part of the maker's name, start of the model's name, width of the sensor in mm, and width over height; from the
# makers' data sheets. Of one maker the first start that fits counts.
SENSORS = (
    ("sony", "dsc-wx", 6.17, FOUR_THIRDS),
    ("sony", "dsc-rx100", 13.2, THREE_HALVES),
    ("sony", "dsc-rx10", 13.2, THREE_HALVES),
    ("sony", "dsc-rx1", 35.8, THREE_HALVES),
    ("sony", "dsc-rx0", 13.2, THREE_HALVES),
    ("sony", "ilce-5000", 23.2, THREE_HALVES),
    ("sony", "ilce-5100", 23.5, THREE_HALVES),
    ("sony", "ilce-6", 23.5, THREE_HALVES),
    ("sony", "ilce-qx1", 23.2, THREE_HALVES),
    ("sony", "ilce-7", 35.9, THREE_HALVES),
    ("sony", "nex-", 23.5, THREE_HALVES),
    ("sony", "umc-r10c", 23.2, THREE_HALVES),
    ("canon", "canon powershot s100", 7.44, FOUR_THIRDS),
    ("canon", "canon powershot s110", 7.44, FOUR_THIRDS),
    ("canon", "canon powershot s120", 7.44, FOUR_THIRDS),
    ("canon", "canon powershot sx", 6.17, FOUR_THIRDS),
    ("canon", "canon powershot elph", 6.17, FOUR_THIRDS),
    ("canon", "canon powershot g7 x", 13.2, THREE_HALVES),
    ("canon", "canon powershot g9 x", 13.2, THREE_HALVES),
    ("canon", "canon ixus", 6.17, FOUR_THIRDS),
    ("canon", "canon eos 5d", 36.0, THREE_HALVES),
    ("canon", "canon eos m", 22.3, THREE_HALVES),
    *(("gopro", f"hero{k}", 6.17, FOUR_THIRDS) for k in "345678"),
    ("ricoh", "gr digital", 7.44, FOUR_THIRDS),
    ("ricoh", "gr", 23.5, THREE_HALVES),
    ("dji", "fc220", 6.17, FOUR_THIRDS),
    ("dji", "fc2103", 6.3, FOUR_THIRDS),
    ("dji", "fc300", 6.17, FOUR_THIRDS),
    ("dji", "fc330", 6.17, FOUR_THIRDS),
    ("dji", "fc350", 6.17, FOUR_THIRDS),
    ("dji", "fc550", 17.3, FOUR_THIRDS),
    ("dji", "fc6310", 13.2, THREE_HALVES),
    ("dji", "fc6510", 13.2, THREE_HALVES),
    ("dji", "fc6520", 17.3, FOUR_THIRDS),
    ("dji", "fc6540", 23.5, THREE_HALVES),
    ("dji", "fc7203", 6.3, FOUR_THIRDS),
    ("dji", "fc3170", 6.4, FOUR_THIRDS),
    ("dji", "fc3411", 13.2, THREE_HALVES),
    ("dji", "fc3582", 9.7, FOUR_THIRDS),
    ("dji", "zenmusep1", 35.9, THREE_HALVES),
    ("hasselblad", "l1d-20c", 13.2, THREE_HALVES),
    ("hasselblad", "l2d-20c", 17.3, FOUR_THIRDS),
    ("parrot", "anafiai", 6.4, FOUR_THIRDS),
    ("parrot", "anafi ai", 6.4, FOUR_THIRDS),
    ("parrot", "anafi", 5.87, FOUR_THIRDS),
    ("sensefly", "s.o.d.a", 12.75, THREE_HALVES),
    ("yuneec", "cgo3", 6.17, FOUR_THIRDS),
    ("yuneec", "e90", 13.2, THREE_HALVES),
)


def sensor_pixels_a_millimetre(make: str, model: str, size: tuple[int, int]) -> float | None:
    """Pixels of a photo a millimetre of its sensor; None: the camera is not in the table."""
    found = _sensor(make, model)
    return None if found is None else sensor_width(size, found[1]) / found[0]


def sensor_shape(make: str, model: str, size: tuple[int, int]) -> float:
    """Width over height of the sensor: from the table, 4:3 for DJI's wide pictures, else that of the photo."""
    found = _sensor(make, model)
    own = max(size) / min(size)
    if found is not None:
        return found[1]
    return FOUR_THIRDS if make.lower() == "dji" and own > WIDE else own


def sensor_width(size: tuple[int, int], shape: float) -> float:
    """Width of the sensor in pixels of a photo, which is cut out of its middle: it keeps the width or the height."""
    return max(max(size), min(size) * shape)


def film_focal_px(film: float, width: float, shape: float) -> float:
    """Focal length in pixels from the 35 mm equivalent: makers compare the diagonals of film and whole sensor.

    Args:
        film: mm.
        width: of the sensor, pixels.
        shape: its width over its height.
    """
    return math.hypot(width, width / shape) * film / FILM_DIAGONAL


def _sensor(make: str, model: str) -> tuple[float, float] | None:
    """Width of the sensor in mm, and width over height; None: the camera is not in the table."""
    for maker, start, width, shape in SENSORS:
        if maker in make.lower() and model.lower().startswith(start):
            return width, shape
    return None
