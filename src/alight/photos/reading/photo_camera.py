"""Lens of a photo camera, from the best calibration in the tags of its photos."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from PIL import ExifTags

from alight.geometry import Camera
from alight.photos.reading.calibrated_picture import calibrated_picture
from alight.photos.reading.fitted_lens import fisheye_terms, radial_lens
from alight.photos.reading.photo_tags import PhotoTags, finite
from alight.records import InputError
from alight.sources.calibration import why_no_lens

Base = ExifTags.Base
Notes = dict[str, Any]

GUESSED = "a guess: no focal length in the tags"
WIDEST = 12.0  # mm, 35 mm equivalent of the widest lens of a drone; a smaller value is the focal length itself
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # EXIF FocalPlaneResolutionUnit


class Claim(NamedTuple):
    """Camera of a photo according to one source."""

    name: str
    camera: Camera
    tolerance: float = 0.03  # relative error that the focal length may have
    family: str = "pixels"  # sources of a family share their errors: resizing affects it, a digital zoom all but `film`
    notes: Mapping[str, Any] = MappingProxyType({})

    @property
    def words(self) -> str:
        """Name of the source and its focal length."""
        return f"{self.name} {self.camera.fu:.0f} px"

    def agrees(self, other: Claim) -> bool:
        """Whether two focal lengths differ by no more than the sum of their tolerances."""
        return abs(math.log(self.camera.fu / other.camera.fu)) <= self.tolerance + other.tolerance


def photo_camera(tags: PhotoTags, given: Claim | None = None) -> tuple[Camera, Notes]:
    """Return the camera of a photo, and notes on where its numbers come from.

    Sources are compared by family (see `Claim`). The source that agrees with most families is trusted; of the sources
    that agree with it, the most exact one is used. The note `focal_warning` names the sources that disagree, and
    `focal_doubt` names what the tags leave open.

    Args:
        tags: tags of the photo.
        given: camera given by the user, which is used whatever the tags contain; None: use the tags.

    Raises:
        InputError: the photo carries no focal length in any form.
    """
    claims = _claims(tags)
    if given is None and not claims:
        raise InputError(
            f"{tags.path.name}: no focal length in its tags; give one with --set sources.calibration=PIXELS"
        )
    picture = calibrated_picture(tags)
    used = given or _ranked(claims, tags.digital_zoom, picture.is_known)
    notes: Notes = {**used.notes, "focal_from": used.name, "focal_px": round(used.camera.fu, 2)}
    if len(claims) > 1:
        notes["focal_sources"] = [c.words for c in claims]
    if rivals := [c for c in claims if not c.agrees(used)]:
        others = ", ".join(c.words for c in rivals)
        notes["focal_warning"] = f"{used.words} is used, but {others}: heights above ground scale with the focal length"
    elif given is None and tags.digital_zoom > 1 and len({c.family for c in claims}) == 1:
        notes["focal_warning"] = (
            f"{used.words} is used, a digital zoom of {tags.digital_zoom:g} counted in: unconfirmed"
        )
    alone = {c.family for c in claims} == {"pixels"}
    if given is None and (doubt := picture.doubt(tags.size, used.camera.fu, alone)):
        notes["focal_doubt"] = doubt
    return used.camera, notes


def focal_given(tags: PhotoTags, focal_px: float) -> Claim:
    """Return the camera with a focal length in pixels, given by the user, and the distortion of the best source.

    Raises:
        InputError: the number is not a focal length.
    """
    claims = _claims(tags)
    camera = _with_focal(claims[0].camera, focal_px) if claims else _camera(tags, focal_px)
    if why := why_no_lens(camera):
        raise InputError(f"sources.calibration={focal_px:g}: {why}; give a focal length in pixels, or a camchain.yaml")
    return Claim("sources.calibration", camera, family="user")


def _claims(tags: PhotoTags) -> list[Claim]:
    """Return the camera of each source in the photo's tags, the most exact source first."""
    impossible, out = (ValueError, OverflowError, ZeroDivisionError), list[Claim | None]()
    for read in (_from_dewarp, _from_skydio, _from_pix4d, _from_fisheye):
        with suppress(*impossible):
            out.append(read(tags))
    for name, focal, unit, tolerance, family in _nominal(tags):
        with suppress(*impossible):
            out.append(Claim(name, _camera(tags, focal * unit), tolerance, family) if focal and unit else None)
    return [c for c in out if c is not None and why_no_lens(c.camera) is None]


def _ranked(claims: Sequence[Claim], zoom: float, sized: bool) -> Claim:
    """Return the claim to use: the most exact one that agrees with the best supported claim.

    The best supported claim agrees with most families. If `zoom` is 1, ties go to claims that agree with the 35 mm
    equivalent, since resizing does not affect it. A 35 mm equivalent above all other focal lengths is then chosen in
    any case, because it contains a zoom that the others lack.

    Args:
        claims: the claims of a photo, the most exact one first.
        zoom: digital zoom in the tags.
        sized: whether the size of the calibrated picture is known; if not, ties may go to the model's sensor as well.
    """

    def weight(c: Claim) -> tuple[bool, int, bool]:
        families = {other.family for other in claims if other.agrees(c)}
        is_film = "film" in families and zoom == 1
        zoomed = is_film and all(c.agrees(o) or c.camera.fu > o.camera.fu for o in claims)
        return zoomed, len(families), is_film or (not sized and "model" in families)

    chosen = max(claims, key=weight)
    exact = next(c for c in claims if c.agrees(chosen))
    lens = claims[0].camera
    if exact is claims[0] or lens.model == "none":
        return exact
    return exact._replace(camera=_with_focal(lens, exact.camera.fu))


def _with_focal(lens: Camera, focal: float) -> Camera:
    """Return a lens with another focal length; its principal point is scaled by the same factor about the centre."""
    u, v, k = 0.5 * (lens.width - 1), 0.5 * (lens.height - 1), focal / lens.fu
    return replace(lens, fu=focal, fv=k * lens.fv, cu=u + k * (lens.cu - u), cv=v + k * (lens.cv - v))


def guessed_camera(tags: PhotoTags) -> tuple[Camera, Notes]:
    """Return a camera with a typical field of view, and notes, for a photo without a focal length."""
    camera = _camera(tags, 0.85 * max(tags.size))  # 0.65 to 1.05 in most cameras
    return camera, {
        "focal_from": GUESSED,
        "focal_px": round(camera.fu, 2),
        "focal_note": "the focal length is a guess, wrong by up to a quarter; heights above ground scale with it",
    }


def photo_readout(tags: PhotoTags) -> float | None:
    """Return the seconds from the exposure of the first row to the last, by `LineReadoutTime`; None if not given."""
    line = tags.xmp_number("camera:LineReadoutTime")  # nanoseconds per row of the sensor
    if line is None:
        return None
    picture = calibrated_picture(tags)
    seconds = 1e-9 * line * tags.size[1] / picture.scale
    return seconds if 0 <= seconds <= 0.5 and not picture.turned else None


def dewarp_text(tags: PhotoTags) -> str:
    """Return DJI's factory calibration as written; empty if absent."""
    return tags.xmp.get("dji:DewarpData", "") or tags.xmp.get("dji:DewarpDataK6", "")


def _camera(
    tags: PhotoTags, f: float, offset: tuple[float, float] = (0, 0), lens: tuple[float, ...] = (), model: str = ""
) -> Camera:
    """Build a camera from its focal length `f` and its principal point `offset` from the image's centre, both in px.

    `lens` are the distortion coefficients of `model`; an empty `model` is radial-tangential, or none if all are 0.
    Makers define the centre as (w/2, h/2) from the image's corner; here, (0, 0) is the centre of the first pixel.
    """
    w, h = tags.size
    model = model or ("radial-tangential" if any(lens) else "none")
    return Camera(w, h, f, f, w / 2 + offset[0] - 0.5, h / 2 + offset[1] - 0.5, model, () if model == "none" else lens)


# -- scale


def _scale(tags: PhotoTags) -> float:
    """Return photo pixels per pixel of the factory calibration, due to resizing and digital zoom."""
    return calibrated_picture(tags).scale * tags.digital_zoom


def _pixels_a_millimetre(tags: PhotoTags) -> float | None:
    """Return photo pixels per millimetre of the sensor, digital zoom included; None without the tags."""
    resolution = tags.number(Base.FocalPlaneXResolution) or tags.number(Base.FocalPlaneYResolution)
    unit = MM_PER_UNIT.get(int(tags.number(Base.FocalPlaneResolutionUnit) or 2))
    return None if not resolution or unit is None else resolution / unit * _scale(tags)


def _comma_numbers(text: str) -> list[float]:
    values = [finite(v) for v in text.split(",")]
    numbers = [v for v in values if v is not None]
    return numbers if len(numbers) == len(values) else []


# -- factory calibrations


def _from_dewarp(tags: PhotoTags) -> Claim | None:
    """Read DJI's `date;fx,fy,cx,cy,k1,k2,p1,p2,k3`, with the principal point relative to the image's centre.

    `DewarpDataK6` of the Matrice 4 adds `k4,k5,k6`, the denominator of the radial term.
    """
    numbers = _comma_numbers(dewarp_text(tags).rpartition(";")[2])
    if len(numbers) not in (9, 12) or min(numbers[:2]) <= 0:
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers[:9]
    if len(numbers) == 12:
        radius = math.hypot(*tags.size) / 2 / calibrated_picture(tags).scale / fx
        k1, k2, k3 = radial_lens([k1, k2, k3], numbers[9:], radius)
    name = "DewarpData" if tags.xmp.get("dji:DewarpData") else "DewarpDataK6"
    focal, notes = _one_focal(tags, fx, fy)
    if p1 == p2 and abs(p1) > 1e-4:  # equal in every digit: a maker's error, not a lens
        notes["lens_note"] = f"p1 and p2 are both {p1:g}, which no lens is: left out"
        p1 = p2 = 0.0
    if calibrated_picture(tags).turned:
        notes["lens_note"], cx, cy, p1, p2 = "turned to an unknown side: without cx, cy, p1 and p2", 0.0, 0.0, 0.0, 0.0
    lens: tuple[float, ...] = (k1, k2, p1, p2, k3)
    if tags.xmp.get("dji:DewarpFlag") == "1":
        notes["lens_note"], lens = "the drone has already removed the distortion (DewarpFlag 1)", ()
    if (scale := _scale(tags)) != 1:
        notes["scale"] = round(scale, 6)
    camera = _camera(tags, focal * scale, (cx * scale, cy * scale), lens)
    return Claim(f"factory calibration ({name})", camera, notes=notes)


def _one_focal(tags: PhotoTags, fx: float, fy: float) -> tuple[float, Notes]:
    """Return one focal length (px) from fx and fy, and a note if these differ by more than 0.3 %.

    In that case, the one nearer to the lens's design is used, because errors rarely point towards the design. On an
    FC6360 (fx 1973.1, fy 1955.7, design 1913.3), the RMS difference over the image from an independent self-calibration
    is 0.96 px with fy, 2.8 with the mean, and 5.5 with fx.
    """
    if abs(fx / fy - 1) <= 0.003:
        return (fx + fy) / 2, {}
    nominal = tags.xmp_number("dji:CalibratedFocalLength")
    if not nominal and (film := _film_focal(tags)) is not None:
        nominal = film / calibrated_picture(tags).scale
    disagree = f"fx {fx:.1f} and fy {fy:.1f} disagree by {abs(fx / fy - 1):.1%} although pixels are square"
    if not nominal:
        return (fx + fy) / 2, {"focal_note": f"{disagree}; their mean is used"}
    chosen = min(fx, fy, key=lambda f: abs(f - nominal))
    return chosen, {"focal_note": f"{disagree}; {chosen:.1f}, nearer to the lens's design ({nominal:.1f}), is used"}


def _from_skydio(tags: PhotoTags) -> Claim | None:
    """Read the camera by Skydio's tags: fx, fy, centre in pixels from the centre of the first pixel, and k1, k2, k3."""
    keys = "FocalLengthX", "FocalLengthY", "OpticalCenterX", "OpticalCenterY"
    fx, fy, cx, cy = (tags.xmp_number(f"skydio:Calibrated{k}") for k in keys)
    if fx is None or fy is None or min(fx, fy) <= 0:
        return None
    scale, offset, picture = _scale(tags), (0.0, 0.0), calibrated_picture(tags)
    if cx is not None and cy is not None and not picture.turned:
        offset = cx + 0.5 - picture.width / 2, cy + 0.5 - picture.height / 2
    focal, notes = _one_focal(tags, fx, fy)
    k = _comma_numbers(tags.xmp.get("skydio:DewarpData", ""))
    lens = (k[0], k[1], 0.0, 0.0, k[2]) if len(k) == 3 else ()
    camera = _camera(tags, focal * scale, (offset[0] * scale, offset[1] * scale), lens)
    return Claim("factory calibration (Skydio)", camera, notes=notes)


def _from_pix4d(tags: PhotoTags) -> Claim | None:
    """Read Pix4D's perspective model: focal length, principal point, and k1, k2, k3, p1, p2.

    Parrot, senseFly, Sentera and MicaSense write these `Camera` tags. The focal length is in pixels or millimetres.
    Without a unit, it is in millimetres if the sensor's resolution is known, else in pixels if above 100.
    """
    focal, pixels = tags.xmp_number("camera:PerspectiveFocalLength"), _pixels_a_millimetre(tags)
    unit = tags.xmp.get("camera:PerspectiveFocalLengthUnits", "").lower()
    if not focal or tags.xmp.get("camera:ModelType", "").lower() not in ("", "perspective"):
        return None
    per_unit = _scale(tags) if unit.startswith("p") or (not unit and pixels is None and focal > 100.0) else pixels
    if per_unit is None:
        return None
    lens = _comma_numbers(tags.xmp.get("camera:PerspectiveDistortion", ""))
    distortion = (lens[0], lens[1], lens[3], lens[4], lens[2]) if len(lens) == 5 else ()
    return Claim("factory calibration (Camera tags)", _camera(tags, focal * per_unit, _pix4d_offset(tags), distortion))


def _pix4d_offset(tags: PhotoTags) -> tuple[float, float]:
    """Return the principal point relative to the image's centre, pixels; its tag is in millimetres from the corner."""
    centre, pixels = _comma_numbers(tags.xmp.get("camera:PrincipalPoint", "")), _pixels_a_millimetre(tags)
    (width, height, _, turned, _), scale = calibrated_picture(tags), _scale(tags)
    if len(centre) != 2 or pixels is None or turned:
        return 0.0, 0.0
    return centre[0] * pixels - 0.5 * scale * width, centre[1] * pixels - 0.5 * scale * height


def _from_fisheye(tags: PhotoTags) -> Claim | None:
    """Fit the equidistant model to Pix4D's fisheye model, which a Parrot Sequoia writes for its bands."""
    affine, polynomial = (
        _comma_numbers(tags.xmp.get(f"camera:Fisheye{k}", "")) for k in ("AffineMatrix", "Polynomial")
    )
    if tags.xmp.get("camera:ModelType", "").lower() != "fisheye" or len(affine) != 4 or len(polynomial) < 3:
        return None
    across, skew_x, skew_y, down = affine
    scale = (across + down) / 2
    if min(across, down) <= 0 or max(abs(skew_x), abs(skew_y), abs(across - down)) > 0.01 * scale:
        return None
    offset = _pix4d_offset(tags)
    radius = math.hypot(tags.size[0] / 2 + abs(offset[0]), tags.size[1] / 2 + abs(offset[1]))
    terms = fisheye_terms(scale * _scale(tags), polynomial, radius)
    if terms is None or terms[0] <= 0:
        return None
    distortion = tuple(float(k) for k in terms[1:] / terms[0])
    camera = _camera(tags, float(terms[0]), offset, distortion, "equidistant")
    return Claim("factory calibration (Camera tags, fisheye)", camera, 0.06)


# -- nominal focal lengths


def _nominal(tags: PhotoTags) -> Iterator[tuple[str, float | None, float | None, float, str]]:
    """Yield the sources without distortion: name, focal length and pixels per unit of it, tolerance, family."""
    focal, (width, shape) = tags.number(Base.FocalLength), _sensor(tags)
    yield "CalibratedFocalLength", tags.xmp_number("dji:CalibratedFocalLength"), _scale(tags), 0.03, "pixels"
    yield "FocalLength and FocalPlaneXResolution", focal, _pixels_a_millimetre(tags), 0.03, "pixels"
    yield "FocalLengthIn35mmFilm", _film_focal(tags), 1.0, 0.06, "film"
    if width is not None and shape is not None:
        name = f"FocalLength and the sensor's size of a {tags.text(Base.Model)}"
        yield name, focal, tags.digital_zoom * (_sensor_width(tags.size, shape) / width), 0.06, "model"


def _film_focal(tags: PhotoTags) -> float | None:
    film = tags.number(Base.FocalLengthIn35mmFilm)
    if not film or film < WIDEST:
        return None
    (width, height, *_), shape = calibrated_picture(tags), _sensor(tags)[1]
    own = max(width, height) / min(width, height)
    if shape is None:  # DJI crops wide pictures from a 4:3 sensor
        shape = 4 / 3 if tags.text(Base.Make).lower() == "dji" and own > 1.6 else own
    return film_focal_px(film, _sensor_width(tags.size, shape), shape)


def film_focal_px(film: float, width: float, shape: float) -> float:
    """Compute the focal length in pixels from the 35 mm equivalent, which relates the diagonals of film and sensor.

    Args:
        film: 35 mm equivalent focal length, mm.
        width: width of the whole sensor, pixels.
        shape: the sensor's width over its height.
    """
    return math.hypot(width, width / shape) * film / math.hypot(36, 24)


def _sensor(tags: PhotoTags) -> tuple[float, float] | tuple[None, None]:
    """Return the sensor's width in mm and its width over height, by makers' data sheets; None for other models."""
    make, model = tags.text(Base.Make).lower(), tags.text(Base.Model).lower()
    for maker, start, width, shape in _sensors():
        if maker in make and model.startswith(start):
            return width, 4 / 3 if shape == "4:3" else 3 / 2
    return None, None


@cache
def _sensors() -> Any:
    """Return rows (part of maker's name, start of model's name, width in mm, shape); the first match is used."""
    return json.loads(Path(__file__).with_name("sensor_sizes.json").read_text())


def _sensor_width(size: tuple[int, int], shape: float) -> float:
    """Return the width of the whole sensor in pixels of a photo with `size` (width, height).

    `shape` is the sensor's width over its height. A photo has the sensor's full width or its full height.
    """
    return max(max(size), min(size) * shape)
