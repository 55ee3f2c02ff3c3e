"""Read the tags of a drone's photos: EXIF (by pillow) and XMP."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from PIL import ExifTags

from alight.photos.reading.photo_xmp import Xmp, parse_xmp
from alight.sources.images import read_header

Base, Gps = ExifTags.Base, ExifTags.GPS
COLOUR = ("rgb", "color", "colour", "visible")  # band names that mean a colour picture


class PhotoCamera(NamedTuple):
    """Identity of a camera: photos with equal values come from one camera."""

    make: str
    model: str
    size: tuple[int, int]  # width, height
    focal: float | None  # mm, digital zoom included
    band: str = ""  # spectral band of a multispectral camera; empty: colour
    film: float | None = None  # mm, 35 mm equivalent focal length

    @property
    def title(self) -> str:
        """Readable name of the camera."""
        width, height = self.size
        focal = f", {self.focal:g} mm" if self.focal else ""
        band = f", {self.band}" if self.band else ""
        return f"{self.make or 'unknown'} {self.model or 'camera'}, {width}x{height}{focal}{band}"


class Position(NamedTuple):
    """Position of a photo, as settled for the whole set."""

    place: tuple[float, float] | None  # latitude, longitude, degrees
    altitude: float | None  # metres above the vertical datum
    altitude_kind: str  # vertical datum, in words
    source: str = ""  # name of the position file; empty: the tags
    sigma: tuple[float, float, float] | None = None  # metres, east, north, up; None: by the tags


@dataclass(frozen=True)
class PhotoTags:
    """Tags of one photo as written, in degrees and metres, without derived values."""

    path: Path
    size: tuple[int, int]  # width, height of the file's pixels
    exif: Mapping[int, Any]  # main and photo directory, by tag number
    gps: Mapping[int, Any]
    xmp: Mapping[str, str]  # "dji:GimbalYawDegree", "camera:Yaw", ...
    bits: int = 8  # most bits of a value of the picture
    is_radiometric: bool = False  # whether a JPEG contains the temperatures of a FLIR camera
    distrusted: frozenset[str] = frozenset()  # names of angles that the whole set shows to be wrong
    settled: Position | None = None  # None: the position in the tags is used

    def text(self, tag: int) -> str:
        """Return an EXIF text without padding; empty if absent."""
        value = self.exif.get(tag, "")
        return (value.decode(errors="replace") if isinstance(value, bytes) else str(value)).strip("\0 ")

    def number(self, tag: int) -> float | None:
        """Return an EXIF number; None if absent or not finite."""
        return finite(self.exif.get(tag))

    def xmp_number(self, key: str) -> float | None:
        """Return an XMP number; None if absent, malformed or not finite."""
        return finite(self.xmp.get(key))

    @property
    def camera(self) -> PhotoCamera:
        """Identity of the photo's camera."""
        focal = self.number(Base.FocalLength)
        zoomed = None if focal is None else round(focal * self.digital_zoom, 2)
        film = self.number(Base.FocalLengthIn35mmFilm)
        return PhotoCamera(self.text(Base.Make), self.text(Base.Model), self.size, zoomed, self.band, film)

    @property
    def band(self) -> str:
        """Spectral band of the picture, named as by Pix4D; empty for a colour picture or if not given.

        Cameras that write all bands of a colour picture (Red, Green, Blue) are not multispectral.
        """
        name = self.xmp.get("camera:BandName", "")
        return "" if "," in name or name.lower() in COLOUR else name

    @property
    def digital_zoom(self) -> float:
        """Factor of the digital zoom; 1 if the tags give none or an impossible one."""
        zoom = self.number(Base.DigitalZoomRatio)
        return zoom if zoom is not None and 1 < zoom <= 100 else 1.0

    def positioned(self, **changes: Any) -> PhotoTags:
        """Return the photo with changed fields of its settled position."""
        assert self.settled is not None
        return replace(self, settled=self.settled._replace(**changes))

    @property
    def is_above_sea(self) -> bool:
        """Whether the altitude is known to count from sea level."""
        return self.altitude_kind == "sea level" or self.altitude_kind.startswith("sea level (")

    @property
    def altitude_kind(self) -> str:
        """Vertical datum of the altitude in words, as far as the photo gives it.

        In EXIF 3.0, `GPSAltitudeRef` 0 and 1 refer to the ellipsoid, 2 and 3 to sea level. Before 3.0, 0 and 1 are
        defined as sea level, but are written for either datum. DJI names a fused or an RTK altitude. Parrot documents
        EGM96 for the Anafi and the ellipsoid for the Anafi Ai. Pix4D and Skydio write the datum into `VertCS`.
        """
        if self.settled is not None:
            return self.settled.altitude_kind
        return self.kind_of(self._written_altitude())

    def kind_of(self, altitude: float | None) -> str:
        """Return the vertical datum, in words, of an altitude (m) from the photo's tags; see `altitude_kind`."""
        if altitude is None:
            return "not given"
        code = self._altitude_code if altitude == self.exif_altitude else None
        model = self.text(Base.Model).lower().replace(" ", "")
        datum = (self.xmp.get("camera:VertCS") or self.xmp.get("skydio:VertCS") or "").lower()
        rtk = self.xmp.get("dji:AltitudeType", "").lower() == "rtkalt"
        if code in (2, 3):
            return "sea level"
        if rtk or "anafiai" in model or datum == "ellipsoidal":
            return "ellipsoid"
        if self.xmp_number("dji:RtkFlag") == 50:
            return "ellipsoid (RTK fixed)"
        if code in (0, 1) and self.text(Base.ExifVersion) >= "0300":
            return "ellipsoid"
        if self.text(Base.Make).lower() == "parrot":
            return "sea level (EGM96)"
        return "sea level or ellipsoid: not declared"

    @property
    def turned(self) -> int:
        """EXIF orientation (2 to 8) of a picture that must be turned for display; 0: upright, or not given."""
        orientation = int(self.number(Base.Orientation) or 0)
        return orientation if 2 <= orientation <= 8 else 0

    @property
    def time_ns(self) -> int | None:
        """Capture time in ns since 1970, None if absent; treated as UTC, because it only serves to sort photos."""
        for tag, part in ((Base.DateTimeOriginal, Base.SubsecTimeOriginal), (Base.DateTime, Base.SubsecTime)):
            try:
                whole = datetime.strptime(self.text(tag), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
            except ValueError:
                continue
            digits = self.text(part)
            fraction = int(digits[:9].ljust(9, "0")) if digits.isascii() and digits.isdigit() else 0
            return int(whole.timestamp()) * 1_000_000_000 + fraction
        return None

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Latitude and longitude (degrees), altitude (metres above the maker's datum); None if one is missing."""
        altitude = self._written_altitude() if self.settled is None else self.settled.altitude
        return None if self.place is None or altitude is None else (*self.place, altitude)

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees; None without a fix."""
        return (self.exif_place or self.xmp_place) if self.settled is None else self.settled.place

    @property
    def exif_place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees from EXIF; None without a fix.

        Two angles whose letters belong to the other axis are exchanged. A sign that is not given is that of XMP if the
        values are equal otherwise.
        """
        return _on_earth(*(angle for angle, _ in self._exif_angles))

    @property
    def xmp_place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees from XMP; None without a fix."""
        return _on_earth(
            self.xmp_number("dji:GpsLatitude"),
            self._first_of("dji:GpsLongitude", "dji:GpsLongtitude"),  # DJI writes both
        )

    @property
    def relative_altitude(self) -> float | None:
        """Height above take-off in metres; None if the photo does not give it."""
        return self._first_of("dji:RelativeAltitude", "skydio:RelativeAltitude", "yuneec:AboveHomeAltitude")

    def _first_of(self, *keys: str) -> float | None:
        return next((v for k in keys if (v := self.xmp_number(k)) is not None), None)

    @property
    def hemisphere_missing(self) -> bool:
        """Whether a hemisphere of the EXIF position is neither given nor that of XMP; north or east is then assumed."""
        return self.exif_place is not None and any(is_assumed for _, is_assumed in self._exif_angles)

    @property
    def axes_exchanged(self) -> bool:
        """Whether the EXIF latitude is marked as east or west, and the longitude as north or south."""
        return _letter(self.gps.get(Gps.GPSLatitudeRef)) in "EW" and _letter(self.gps.get(Gps.GPSLongitudeRef)) in "NS"

    @property
    def _exif_angles(self) -> list[tuple[float | None, bool]]:
        """EXIF latitude and longitude in degrees, each with whether its sign is assumed."""
        tags = [(Gps.GPSLatitude, Gps.GPSLatitudeRef), (Gps.GPSLongitude, Gps.GPSLongitudeRef)]
        north, east = (
            (self.gps.get(a), _letter(self.gps.get(r))) for a, r in tags[:: -1 if self.axes_exchanged else 1]
        )
        xmp = self.xmp_place or (None, None)
        return [_angle(*north, "NS", xmp[0]), _angle(*east, "EW", xmp[1])]

    @property
    def _altitude_code(self) -> Any:
        """`GPSAltitudeRef`, 0 to 3, odd for altitudes below the reference surface; None if absent."""
        reference = self.gps.get(Gps.GPSAltitudeRef)
        return reference[0] if isinstance(reference, bytes) and reference else reference

    @property
    def exif_altitude(self) -> float | None:
        """EXIF altitude in metres, negative below its reference surface; None if absent."""
        exif = finite(self.gps.get(Gps.GPSAltitude))
        return -exif if exif is not None and self._altitude_code in (1, 3) else exif

    @property
    def absolute_altitude(self) -> float | None:
        """Absolute altitude in metres from DJI's XMP; None if absent."""
        return self.xmp_number("dji:AbsoluteAltitude")

    def _written_altitude(self) -> float | None:
        exif, absolute = self.exif_altitude, self.absolute_altitude
        if absolute is not None and (exif is None or abs(exif - absolute) > 1):
            return absolute  # some firmware leaves the EXIF altitude at zero
        return exif


def _on_earth(latitude: float | None, longitude: float | None) -> tuple[float, float] | None:
    if latitude is None or longitude is None or (latitude, longitude) == (0, 0):
        return None
    return (latitude, longitude) if abs(latitude) <= 90 and abs(longitude) <= 180 else None


def finite(value: Any) -> float | None:
    """Convert a tag to a number, also from a fraction ("527/100"); None if absent, malformed or not finite."""
    try:
        above, _, below = value.partition("/") if isinstance(value, str) else (value, "", "")
        number = float(above) / float(below or 1)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _letter(ref: Any) -> str:
    """Return the first letter of a hemisphere (`S`, `South`); `?` if absent."""
    text = ref.decode(errors="replace") if isinstance(ref, bytes) else str(ref or "")
    return text.strip("\0 ").upper()[:1] or "?"


def _angle(dms: Any, letter: str, letters: str, xmp: float | None) -> tuple[float | None, bool]:
    """Return degrees from (degrees, minutes, seconds), and whether the sign is assumed; parts of 0/0 are zero.

    Args:
        letter: hemisphere as written.
        letters: letters of the positive and the negative hemisphere.
        xmp: the same angle in XMP, degrees, for the sign if `letter` does not give it.
    """
    parts = [finite(v) for v in dms] if isinstance(dms, tuple) and len(dms) == 3 else [None]
    if parts[0] is None:
        return (None, False)
    d, m, s = (abs(v or 0.0) for v in parts)
    degrees, known = d + m / 60 + s / 3600, letter in letters
    if not known and xmp is not None and abs(abs(xmp) - degrees) < 1e-3:  # EXIF may be rounded to a second of arc
        return (math.copysign(degrees, xmp), False)
    negative = letter == letters[1] or any(v is not None and v < 0 for v in parts)
    return (-degrees if negative else degrees, not known and not negative)


def read_tags(path: Path) -> tuple[PhotoTags, str]:
    """Read the tags of one photo without decoding its pixels.

    Returns:
        The tags, and what is wrong with their XMP in words (empty: nothing).

    Raises:
        One of `images.UNREADABLE`: the file is not a readable image.
    """
    header = read_header(path)
    xmp = parse_xmp(header.xmp) if header.xmp else Xmp({}, "")
    is_radiometric = any(segment.startswith(b"FLIR\0") for segment in header.segments)
    tags = PhotoTags(path, header.size, header.exif, header.gps, xmp.values, header.bits, is_radiometric)
    return tags, xmp.fault
