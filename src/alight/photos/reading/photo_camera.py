"""The lens of a photo camera, from the best calibration that its photos carry."""

from __future__ import annotations

import math

from PIL import ExifTags

from alight.geometry import Camera
from alight.photos.reading.lens_fits import radial_lens
from alight.photos.reading.photo_pix4d import fisheye_camera, perspective_camera
from alight.photos.reading.photo_scale import (
    Notes,
    calibrated_width,
    camera_of,
    comma_numbers,
    photo_scale,
    pixels_a_millimetre,
)
from alight.photos.reading.photo_tags import PhotoTags
from alight.photos.reading.sensor_sizes import film_focal_px, sensor_pixels_a_millimetre, sensor_shape, sensor_width
from alight.records import InputError
from alight.sources.lens_bounds import why_no_lens

Base = ExifTags.Base

LONGEST_READOUT = 0.5  # s
SQUARE = 0.003  # largest relative difference of fx and fy that a real sensor has
TANGENTIAL = 1e-4  # two tangential terms above this that agree in every digit: a maker's error, not a lens
GUESSED = "a guess: no focal length in the tags"
GUESS = 0.85  # focal length over the longer side, where no tag gives it; most cameras have 0.65 to 1.05
_SKYDIO_FOCAL = "FocalLengthX", "FocalLengthY"
_SKYDIO_CENTRE = "OpticalCenterX", "OpticalCenterY"


def photo_camera(tags: PhotoTags) -> tuple[Camera, Notes]:
    """Return the camera of a photo, and notes on the source of its numbers.

    Raises:
        InputError: the photo carries no focal length in any form.
    """
    for known in KNOWN:
        try:
            found = known(tags)
        except (ValueError, OverflowError, ZeroDivisionError):  # numbers that are no camera's: the next source
            continue
        if found is not None and why_no_lens(found[0]) is None:
            camera, notes = found
            return camera, notes | {"focal_px": round(camera.fu, 2)}
    raise InputError(
        f"{tags.path.name}: no focal length in its tags; give one with --set sources.calibration=camchain.yaml"
    )


def guessed_camera(tags: PhotoTags) -> tuple[Camera, Notes]:
    """A camera of usual field of view, where the photo carries no focal length in any form."""
    camera = camera_of(tags, GUESS * max(tags.size))
    return camera, {
        "focal_from": GUESSED,
        "focal_px": round(camera.fu, 2),
        "focal_note": "the focal length is a guess, wrong by up to a quarter; heights above ground scale with it",
    }


def photo_readout(tags: PhotoTags) -> float | None:
    """Seconds from the exposure of the first row to that of the last, by `LineReadoutTime`; None without that tag."""
    line = tags.xmp_number("camera:LineReadoutTime")  # nanoseconds a row of the sensor
    if line is None:
        return None
    seconds = 1e-9 * line * tags.size[1] * calibrated_width(tags) / tags.size[0]
    return seconds if 0 <= seconds <= LONGEST_READOUT else None


def dewarp_text(tags: PhotoTags) -> str:
    """DJI's factory calibration as it is written; empty without one."""
    return tags.xmp.get("dji:DewarpData", "") or tags.xmp.get("dji:DewarpDataK6", "")


def _dewarp_numbers(tags: PhotoTags) -> list[float] | None:
    """Numbers of `date;fx,fy,cx,cy,k1,k2,p1,p2,k3`, centre counted from the image's centre.

    `DewarpDataK6` of the Matrice 4 adds `k4,k5,k6`, the denominator of the radial term.
    """
    numbers = comma_numbers(dewarp_text(tags).rpartition(";")[2])
    if len(numbers) == 12 and min(numbers[:2]) > 0:
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers[:9]
        radius = math.hypot(*tags.size) / 2 * calibrated_width(tags) / tags.size[0] / fx
        k1, k2, k3 = radial_lens([k1, k2, k3], numbers[9:], radius)
        return [fx, fy, cx, cy, k1, k2, p1, p2, k3]
    return numbers if len(numbers) == 9 and min(numbers[:2]) > 0 else None


def _nominal(tags: PhotoTags) -> float | None:
    """Nominal focal length of the lens, in pixels of the factory calibration; None without a tag for it."""
    if nominal := tags.xmp_number("dji:CalibratedFocalLength"):
        return nominal
    film = _film_focal(tags)
    return None if film is None else film * calibrated_width(tags) / tags.size[0]


def _one_focal(fx: float, fy: float, nominal: float | None) -> tuple[float, str]:
    """One focal length from the two of a calibration, which are equal for square pixels, and a note; empty: none.

    If they differ by more than those of a sensor can, the one nearer to the lens's design is chosen: a calibration that
    is wrong in one direction is not wrong towards the design. Height scales with the choice. On an FC6360 (fx 1973.1,
    fy 1955.7, design 1913.3), against an independent self-calibration and up to a rotation: fy 0.96 px RMS over the
    image, their mean 2.8, fx 5.5; with the tangential terms as written, 4.8.
    """
    if abs(fx / fy - 1) <= SQUARE:
        return (fx + fy) / 2, ""
    said = f"fx {fx:.1f} and fy {fy:.1f} disagree by {abs(fx / fy - 1):.1%} although pixels are square"
    if nominal is None:
        return (fx + fy) / 2, f"{said}; their mean is used"
    chosen = min(fx, fy, key=lambda f: abs(f - nominal))
    return chosen, f"{said}; {chosen:.1f}, nearer to the lens's design ({nominal:.1f}), is used"


def _from_dewarp(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    numbers = _dewarp_numbers(tags)
    if numbers is None:
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers
    scale = photo_scale(tags)
    name = "DewarpData" if tags.xmp.get("dji:DewarpData") else "DewarpDataK6"
    notes: Notes = {"focal_from": f"factory calibration ({name})"}
    focal, note = _one_focal(fx, fy, _nominal(tags))
    if note:
        notes["focal_note"] = note
    if p1 == p2 and abs(p1) > TANGENTIAL:
        notes["lens_note"] = f"p1 and p2 are both {p1:g}, which no lens is: left out"
        p1 = p2 = 0.0
    lens: tuple[float, ...] = (k1, k2, p1, p2, k3)
    if tags.xmp.get("dji:DewarpFlag") == "1":
        notes["lens_note"], lens = "the drone has already removed the distortion (DewarpFlag 1)", ()
    if scale != 1:
        notes["scale"] = round(scale, 6)
    return camera_of(tags, focal * scale, (cx * scale, cy * scale), lens), notes


def _from_skydio(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    """Camera by Skydio's tags: pixels, the centre counted from the centre of the first pixel, and k1, k2, k3."""
    fx, fy, cx, cy = (tags.xmp_number(f"skydio:Calibrated{k}") for k in (*_SKYDIO_FOCAL, *_SKYDIO_CENTRE))
    if fx is None or fy is None or min(fx, fy) <= 0:
        return None
    scale, offset = photo_scale(tags), (0.0, 0.0)
    if cx is not None and cy is not None:
        width = calibrated_width(tags)
        offset = cx + 0.5 - width / 2, cy + 0.5 - width * tags.size[1] / tags.size[0] / 2
    focal, note = _one_focal(fx, fy, _nominal(tags))
    k = comma_numbers(tags.xmp.get("skydio:DewarpData", ""))
    lens = (k[0], k[1], 0.0, 0.0, k[2]) if len(k) == 3 else ()
    notes: Notes = {"focal_from": "factory calibration (Skydio)"} | ({"focal_note": note} if note else {})
    return camera_of(tags, focal * scale, (offset[0] * scale, offset[1] * scale), lens), notes


def _from_calibrated(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    focal = tags.xmp_number("dji:CalibratedFocalLength")
    if not focal or focal <= 0:
        return None
    return camera_of(tags, focal * photo_scale(tags)), {"focal_from": "CalibratedFocalLength"}


def _from_sensor(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    focal, pixels = tags.number(Base.FocalLength), pixels_a_millimetre(tags)
    if not focal or pixels is None:
        return None
    return camera_of(tags, focal * pixels), {"focal_from": "FocalLength and FocalPlaneXResolution"}


def _from_film(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    pixels = _film_focal(tags)
    if pixels is None:
        return None
    return camera_of(tags, pixels), {"focal_from": "FocalLengthIn35mmFilm (rounded to a millimetre by the maker)"}


def _film_focal(tags: PhotoTags) -> float | None:
    film = tags.number(Base.FocalLengthIn35mmFilm)
    if not film or film <= 0:
        return None
    shape = sensor_shape(tags.text(Base.Make), tags.text(Base.Model), tags.size)
    return film_focal_px(film, sensor_width(tags.size, shape), shape)


def _from_model(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    focal, make, model = tags.number(Base.FocalLength), tags.text(Base.Make), tags.text(Base.Model)
    pixels = sensor_pixels_a_millimetre(make, model, tags.size)
    if not focal or pixels is None:
        return None
    camera = camera_of(tags, focal * pixels * tags.digital_zoom)
    return camera, {"focal_from": f"FocalLength and the sensor's size of a {model}"}


# best first
KNOWN = (
    _from_dewarp, _from_skydio, perspective_camera, fisheye_camera, _from_calibrated, _from_sensor, _from_film,
    _from_model,
)  # fmt: skip
