"""Subtitles (`.srt`) with telemetry, in the dialects of DJI."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

_TIME = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")
_STAMP = re.compile(r"(\d{4})[-.](\d\d)[-.](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,:](\d{1,3}))?")
_NUMBER = r"([-+]?\d+(?:\.\d+)?)"
_PAIR = re.compile(rf"\b([a-z_]+)\s*:\s*{_NUMBER}", re.IGNORECASE)
_GPS = re.compile(rf"\bGPS\s*\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*(?:,\s*{_NUMBER}\s*(M?)\s*)?\)", re.IGNORECASE)
_UP = re.compile(rf"\bBAROMETER\s*[:(]\s*{_NUMBER}|,\s*H\s+{_NUMBER}\s*m\b", re.IGNORECASE)


@dataclass(frozen=True)
class Subtitle:
    """Content of one subtitle."""

    seconds: float  # from the start of the video
    taken: datetime | None
    values: dict[str, float]  # latitude, longitude, abs_alt, rel_alt, focal_len, gb_yaw, ...
    coarse: bool = False  # latitude or longitude has few decimals

    @property
    def place(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (degrees), and the altitude, else the height above take-off (m); None without a fix."""
        latitude, longitude = self.values.get("latitude"), self.values.get("longitude")
        up = self.values.get("rel_alt") if self.altitude is None else self.altitude
        if latitude is None or longitude is None or up is None or (latitude, longitude) == (0, 0):
            return None
        return latitude, longitude, up

    @property
    def altitude(self) -> float | None:
        """Metres above the maker's datum; None where at most the height above take-off is given."""
        return next((self.values[k] for k in ("abs_alt", "altitude") if k in self.values), None)


def read_srt(text: str) -> list[Subtitle]:
    """The telemetry of subtitles.

    Either each number has its name, as in `[latitude: 45.1]`, or a line is `GPS(149.0251,-20.2533,16) BAROMETER:1.9`.
    """
    out = []
    for block in re.split(r"\n\s*\n", text.replace("\r", "")):
        if (at := _TIME.search(block)) is None:
            continue
        h, m, s, ms = (int(v) for v in at.groups())
        written = {k.lower().replace("longtitude", "longitude"): v for k, v in _PAIR.findall(block[at.end() :])}
        written |= _bracketed(block[at.end() :])
        seconds = 3600 * h + 60 * m + s + ms / 10 ** len(at.group(4))
        decimals = [len(written[k].partition(".")[2]) for k in ("latitude", "longitude") if k in written]
        coarse = bool(decimals) and max(decimals) <= 4  # of a degree: 11 m
        out.append(Subtitle(seconds, _stamp(block), {k: float(v) for k, v in written.items()}, coarse))
    return out


def _bracketed(block: str) -> dict[str, str]:
    """Place and height above take-off of the older dialects, as they are written; empty in the others.

    With a unit (`0.0M`, Matrice 300) latitude comes first, without one (Mavic Pro, Phantom 4) longitude, unless that is
    no place on Earth. The third number is a count of satellites or nothing, the height is the barometer's.
    """
    found = _GPS.search(block)
    if found is None:
        return {}
    first, second, _, unit = found.groups()
    latitude, longitude = (first, second) if unit else (second, first)
    if abs(float(latitude)) > 90:
        latitude, longitude = longitude, latitude
    if abs(float(latitude)) > 90 or abs(float(longitude)) > 180:
        return {}
    up = _UP.search(block)
    height = {} if up is None else {"rel_alt": up.group(1) or up.group(2)}
    return {"latitude": latitude, "longitude": longitude} | height


def _stamp(block: str) -> datetime | None:
    if (found := _STAMP.search(block)) is None:
        return None
    *whole, fraction = found.groups()
    try:
        at = datetime(*(int(v) for v in whole), tzinfo=UTC)  # type: ignore[arg-type, misc]
    except ValueError:
        return None
    return at + timedelta(milliseconds=int((fraction or "0").ljust(3, "0")))
