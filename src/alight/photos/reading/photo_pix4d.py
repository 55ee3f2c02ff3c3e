"""The factory calibration in Pix4D's `Camera` tags, as Parrot, senseFly, Sentera and MicaSense write them."""

from __future__ import annotations

import math

from alight.geometry import Camera
from alight.photos.reading.lens_fits import fisheye_lens
from alight.photos.reading.photo_scale import Notes, camera_of, comma_numbers, photo_scale, pixels_a_millimetre
from alight.photos.reading.photo_tags import PhotoTags

LONGEST_FOCAL = 100.0  # mm; without unit and sensor, a larger number is in pixels
SKEW = 0.01  # largest relative skew of a fisheye's affine matrix that is neglected


def perspective_camera(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    """The perspective model: focal length, principal point, and k1, k2, k3, p1, p2; None without it."""
    focal = _factory_focal(tags)
    if focal is None or _model_type(tags) not in ("", "perspective"):
        return None
    lens = comma_numbers(tags.xmp.get("camera:PerspectiveDistortion", ""))
    distortion = (lens[0], lens[1], lens[3], lens[4], lens[2]) if len(lens) == 5 else ()
    notes: Notes = {"focal_from": "factory calibration (Camera tags)"}
    return camera_of(tags, focal, _factory_offset(tags), distortion), notes


def _model_type(tags: PhotoTags) -> str:
    """Kind of lens: perspective or fisheye; empty where the tags do not give it."""
    return tags.xmp.get("camera:ModelType", "").lower()


def _factory_focal(tags: PhotoTags) -> float | None:
    """Focal length in pixels, from pixels or millimetres; without a unit, the size of the number decides."""
    focal, pixels = tags.xmp_number("camera:PerspectiveFocalLength"), pixels_a_millimetre(tags)
    unit = tags.xmp.get("camera:PerspectiveFocalLengthUnits", "").lower()
    if not focal:
        return None
    if unit.startswith("p") or (not unit and pixels is None and focal > LONGEST_FOCAL):
        return focal * photo_scale(tags)
    return None if pixels is None else focal * pixels


def _factory_offset(tags: PhotoTags) -> tuple[float, float]:
    """The principal point from the image's centre, pixels; it is written in millimetres from the corner."""
    centre, pixels = comma_numbers(tags.xmp.get("camera:PrincipalPoint", "")), pixels_a_millimetre(tags)
    if len(centre) != 2 or pixels is None:
        return 0.0, 0.0
    return centre[0] * pixels - 0.5 * tags.size[0], centre[1] * pixels - 0.5 * tags.size[1]


def fisheye_camera(tags: PhotoTags) -> tuple[Camera, Notes] | None:
    """The fisheye model (as of the bands of a Parrot Sequoia), fitted by the equidistant model; None without it."""
    affine, polynomial = (comma_numbers(tags.xmp.get(f"camera:Fisheye{k}", "")) for k in ("AffineMatrix", "Polynomial"))
    if _model_type(tags) != "fisheye" or len(affine) != 4 or len(polynomial) < 3:
        return None
    across, skew_x, skew_y, down = affine
    scale = (across + down) / 2
    if min(across, down) <= 0 or max(abs(skew_x), abs(skew_y), abs(across - down)) > SKEW * scale:
        return None
    offset = _factory_offset(tags)
    radius = math.hypot(tags.size[0] / 2 + abs(offset[0]), tags.size[1] / 2 + abs(offset[1]))
    found = fisheye_lens(scale * photo_scale(tags), polynomial, radius)
    if found is None:
        return None
    camera = camera_of(tags, found.focal, offset, found.distortion, "equidistant")
    return camera, {"focal_from": "factory calibration (Camera tags, fisheye)"}
