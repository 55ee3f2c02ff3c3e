"""Tags of a drone's photos: EXIF (pillow) and XMP."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from PIL import ExifTags

from alight.photos.reading.photo_xmp import Xmp, parse_xmp
from alight.sources.images import read_header

Base, Gps = ExifTags.Base, ExifTags.GPS
COLOUR = ("rgb", "color", "colour", "visible")  # names of bands that are none


class PhotoCamera(NamedTuple):
    """Identity of a camera: photos with equal values are of one camera."""

    make: str
    model: str
    size: tuple[int, int]  # width, height
    focal: float | None  # mm, a digital zoom counted in
    band: str = ""  # of a camera of several bands; empty: colour
    film: float | None = None  # mm, 35 mm equivalent

    @property
    def title(self) -> str:
        """Name of the camera for a reader."""
        width, height = self.size
        focal = f", {self.focal:g} mm" if self.focal else ""
        band = f", {self.band}" if self.band else ""
        return f"{self.make or 'unknown'} {self.model or 'camera'}, {width}x{height}{focal}{band}"


class Position(NamedTuple):
    """Where a photo was taken, as settled for the whole set."""

    place: tuple[float, float] | None  # latitude, longitude, degrees
    altitude: float | None  # metres
    altitude_kind: str  # what it counts from
    source: str = ""  # file; empty: tags
    sigma: tuple[float, float, float] | None = None  # metres, east, north, up; None: as by the tags


@dataclass(frozen=True)
class PhotoTags:
    """The tags of one photo, as written: degrees, metres, no derived values."""

    path: Path
    size: tuple[int, int]  # width, height of the file's pixels
    exif: Mapping[int, Any]  # main and photo directory, by tag number
    gps: Mapping[int, Any]
    xmp: Mapping[str, str]  # "dji:GimbalYawDegree", "camera:Yaw", ...
    bits: int = 8  # of the deepest value of the picture
    is_radiometric: bool = False  # a JPEG with the temperatures of a FLIR camera in it
    distrusted: frozenset[str] = frozenset()  # names of angles that the set shows to be no attitudes
    settled: Position | None = None  # position of the photo; None: that of its own tags

    def text(self, tag: int) -> str:
        """An EXIF text, padding removed; empty when absent."""
        value = self.exif.get(tag, "")
        return (value.decode(errors="replace") if isinstance(value, bytes) else str(value)).strip("\0 ")

    def number(self, tag: int) -> float | None:
        """An EXIF number; None when absent or not finite."""
        return finite(self.exif.get(tag))

    def xmp_number(self, key: str) -> float | None:
        """An XMP number; None when absent or malformed."""
        return finite(self.xmp.get(key))

    @property
    def camera(self) -> PhotoCamera:
        """The camera of the photo."""
        focal = self.number(Base.FocalLength)
        zoomed = None if focal is None else round(focal * self.digital_zoom, 2)
        film = self.number(Base.FocalLengthIn35mmFilm)
        return PhotoCamera(self.text(Base.Make), self.text(Base.Model), self.size, zoomed, self.band, film)

    @property
    def band(self) -> str:
        """The spectral band of the picture; empty: colour, or not given.

        Pix4D's names. Cameras that write all bands of a colour picture (Red, Green, Blue) are no multispectral ones.
        """
        name = self.xmp.get("camera:BandName", "")
        return "" if "," in name or name.lower() in COLOUR else name

    @property
    def digital_zoom(self) -> float:
        """Factor of the digital zoom; 1 where the tags do not give it, or give an impossible one."""
        zoom = self.number(Base.DigitalZoomRatio)
        return zoom if zoom is not None and 1 < zoom <= 100 else 1.0

    @property
    def altitude_kind(self) -> str:
        """Vertical datum of the altitude, as far as the photo gives it.

        EXIF 3.0 counts the values 0 and 1 of `GPSAltitudeRef` from the ellipsoid, 2 and 3 from the sea level; before,
        0 and 1 were about the sea level, and in practice about either. DJI names a fused or an RTK altitude. Parrot
        documents its own: EGM96 of the Anafi, the ellipsoid of the Anafi Ai. Pix4D and Skydio write it into `VertCS`.
        """
        if self.settled is not None:
            return self.settled.altitude_kind
        return self.kind_of(self._written_altitude())

    def kind_of(self, altitude: float | None) -> str:
        """As `altitude_kind`, for one of the altitudes of the photo."""
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
        """Capture time in ns since 1970, a time without zone taken as UTC: it only serves to sort photos."""
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
        """Latitude, longitude (degrees), altitude (metres above the maker's datum); None without a fix."""
        altitude = self._written_altitude() if self.settled is None else self.settled.altitude
        return None if self.place is None or altitude is None else (*self.place, altitude)

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees; None without a fix."""
        return (self.exif_place or self.xmp_place) if self.settled is None else self.settled.place

    @property
    def exif_place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees by EXIF; None without a fix."""
        return _on_earth(
            _angle(self.gps.get(Gps.GPSLatitude), self.gps.get(Gps.GPSLatitudeRef), "S"),
            _angle(self.gps.get(Gps.GPSLongitude), self.gps.get(Gps.GPSLongitudeRef), "W"),
        )

    @property
    def xmp_place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees by XMP; None without a fix."""
        return _on_earth(
            self.xmp_number("dji:GpsLatitude"),
            self._first_of("dji:GpsLongitude", "dji:GpsLongtitude"),  # both are DJI's spelling
        )

    @property
    def relative_altitude(self) -> float | None:
        """Metres above the place of take-off; None where the photo does not give them."""
        return self._first_of("dji:RelativeAltitude", "skydio:RelativeAltitude", "yuneec:AboveHomeAltitude")

    def _first_of(self, *keys: str) -> float | None:
        return next((v for k in keys if (v := self.xmp_number(k)) is not None), None)

    @property
    def hemisphere_missing(self) -> bool:
        """True if EXIF has a place without its hemisphere: north and east are assumed then."""
        references = self.gps.get(Gps.GPSLatitudeRef), self.gps.get(Gps.GPSLongitudeRef)
        return self.gps.get(Gps.GPSLatitude) is not None and not all(str(r or "").strip("\0 ") for r in references)

    @property
    def _altitude_code(self) -> Any:
        """`GPSAltitudeRef`: 0 to 3, odd below the surface that the altitude is counted from; None without it."""
        reference = self.gps.get(Gps.GPSAltitudeRef)
        return reference[0] if isinstance(reference, bytes) and reference else reference

    @property
    def exif_altitude(self) -> float | None:
        """Metres by EXIF, below the surface that they count from negative; None when absent."""
        exif = finite(self.gps.get(Gps.GPSAltitude))
        return -exif if exif is not None and self._altitude_code in (1, 3) else exif

    @property
    def absolute_altitude(self) -> float | None:
        """Metres by DJI's XMP; None when absent."""
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
    """A tag as a number, also one written as a fraction ("527/100"); None when absent, malformed or not finite."""
    try:
        above, _, below = value.partition("/") if isinstance(value, str) else (value, "", "")
        number = float(above) / float(below or 1)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _angle(dms: Any, ref: Any, negative: str) -> float | None:
    """Signed degrees from degrees, minutes, seconds; the latter two may be undefined (0/0) beside decimal degrees."""
    if not isinstance(dms, tuple) or len(dms) != 3:
        return None
    d, m, s = (finite(v) for v in dms)
    if d is None:
        return None
    return (d + (m or 0.0) / 60 + (s or 0.0) / 3600) * (-1 if str(ref).strip("\0 ").upper() == negative else 1)


def read_tags(path: Path) -> tuple[PhotoTags, str]:
    """Read one photo's tags, not its pixels.

    Returns:
        The tags, and their fault in words (empty: none).

    Raises:
        One of `images.UNREADABLE`.
    """
    header = read_header(path)
    xmp = parse_xmp(header.xmp) if header.xmp else Xmp({}, "")
    is_radiometric = any(segment.startswith(b"FLIR\0") for segment in header.segments)
    tags = PhotoTags(path, header.size, header.exif, header.gps, xmp.values, header.bits, is_radiometric)
    return tags, xmp.fault
