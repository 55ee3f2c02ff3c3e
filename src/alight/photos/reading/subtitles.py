"""Telemetry in subtitles (SubRip, WebVTT, Advanced SubStation), in the dialects of DJI and Autel.

A dialect names each number, as in `[latitude: 45.1]`, or writes a position in brackets, as in `GPS(7.6,45.1,16)`. The
order of latitude and longitude in brackets is inferred from the whole film (`_order`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow, apart
from alight.records import InputError

NAMES = {  # spellings of each name, the most specific one first
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "longtitude", "lon", "lng", "long"),
    "abs_alt": ("abs_alt", "absolute_altitude", "abs_altitude", "altitude", "alt"),
    "rel_alt": ("rel_alt", "relative_altitude", "rel_altitude", "barometer", "h", "hb", "reh"),  # m, above take-off
    "home_distance": ("d",),
    "gb_yaw": ("gb_yaw", "gimbal_yaw"), "gb_pitch": ("gb_pitch", "gimbal_pitch"), "gb_roll": ("gb_roll", "gimbal_roll"),
    "dzoom_ratio": ("dzoom_ratio", "dzoom", "digital_zoom_ratio", "digital_zoom", "digitalzoom"),
}  # fmt: skip
Subtitle = tuple[float, str]  # time in seconds, NaN: none; text
LENGTHS = "abs_alt", "rel_alt", "home_distance"
FEET, METRES = ("ft", "feet", "foot", "'"), ("m", "metre", "metres", "meter", "meters")
QUOTES = str.maketrans("’′”″", "''\"\"")  # marks of feet, minutes and seconds
_TIME = re.compile(r"((?:\d+:)?\d\d:\d\d[,.]\d{1,3})\s*-->")
_ASS = re.compile(r"^Dialogue:[^,]*,(\d+:\d\d:\d\d\.\d+),[^,]*,(?:[^,]*,){6}(.*)$", re.MULTILINE)
_STAMP = re.compile(r"(\d{4})[-./](\d\d?)[-./](\d\d?)[ T](\d\d?):(\d\d):(\d\d)(?:[.,:](\d{1,3}))?")
_UNIT = r"'|[NSEW]\b|(?:m|ft|feet|foot|met(?:re|er)s?)\b|[a-z]+(?![\w.]*[ \t]*[-+:=(\d])"  # no name of another number
_SIGNED = rf"([NSEW]?)\s*:?\s*([-+]?\d+(?:[.,]-?\d+)?)[ \t]*°?[ \t]*({_UNIT})?"
_PAIR = re.compile(rf"(?<![\w.])([a-z][a-z_.]*)\s*[:=(]?\s*{_SIGNED}", re.IGNORECASE)
_INSIDE = {dot: re.compile(_SIGNED.replace("[.,]", f"[{dot}]"), re.IGNORECASE) for dot in ".,"}
_PARTS = re.compile(  # degrees, minutes and perhaps seconds, with a hemisphere letter before or after
    r"(?<![\w.])([NSEW]?)[ :]*(\d{1,3})[ °d]+(\d{1,2}(?:\.\d+)?)[ 'm]*"
    r"(?:(?<=[ 'm])(\d{1,2}(?:\.\d+)?)[ \"s']*)?([NSEW]?)(?!\w)",
    re.IGNORECASE,
)
_BARE_PARTS = re.compile(r"\bl(?:at|on)[a-z]*\s*[:=(]?\s*[-+]?\d+[ °]+\d", re.IGNORECASE)
_BRACKET = re.compile(r"\b(GPS|HOME)\s*(?:\(([^)]*)\)|:(.*))", re.IGNORECASE)
_GIMBAL = re.compile(r"\bG\.PRY\s*\(\s*([-\d.]+)\W+?([-+]?[\d.]+)\W+?([-+]?[\d.]+)", re.IGNORECASE)


@dataclass(frozen=True)
class _Number:
    """A number with its unit and hemisphere; feet are converted to metres."""

    value: float  # NaN if its sign contradicts the letter
    letter: str  # hemisphere: N, S, E, W or empty
    decimals: int  # digits after the point
    unit: str  # as written, in lower case; empty: none

    @classmethod
    def of(cls, before: str, digits: str, after: str) -> _Number:
        text = digits.replace(",", ".").replace(".-", ".")  # Autel writes -117.-9605
        letter = (before or (after if after.upper() in ("N", "S", "E", "W") else "")).upper()
        unit = "" if after.upper() == letter else after.lower()
        value = float(text) * (0.3048 if unit in FEET else 1.0)
        value = -abs(value) if letter in ("S", "W") else value
        contradicted = letter in ("N", "E") and value < 0
        return cls(math.nan if contradicted else value, letter, len(text.partition(".")[2]), unit)


@dataclass(frozen=True)
class _Cue:
    """One subtitle; the numbers in its brackets `GPS(...)` and `HOME(...)` are in the order as written."""

    row: TelemetryRow
    gps: tuple[_Number, ...] = ()
    home: tuple[_Number, ...] = ()
    unread: frozenset[str] = frozenset()  # sentences on heights and zooms that are not used, or used with a doubt
    fault: str = ""  # why the place cannot be used, in words; empty: no fault

    def placed(self, latitude_first: bool) -> TelemetryRow:
        """Return the row with the position from the brackets; `latitude_first`: whether latitude is written first."""
        return replace(self.row, values=self.row.values | _place(self.gps, latitude_first))


def read_subtitles(text: str, source: str) -> FilmTelemetry:
    """Read the telemetry from a file of subtitles; see `telemetry_of`."""
    return telemetry_of(subtitles_in(text), source)


def telemetry_of(subtitles: Iterable[Subtitle], source: str) -> FilmTelemetry:
    """Read the telemetry from subtitles; it has no rows if no subtitle holds a position.

    Args:
        source: name of the file, for messages.

    Raises:
        InputError: the film does not show whether latitude or longitude comes first in `GPS(...)`, or a place is in
            degrees, minutes and seconds without hemisphere, or its letters are those of the other axis.
    """
    found = [_cue(at, body) for at, body in subtitles]
    cues = [c for c in found if math.isfinite(c.row.seconds)]
    if not cues:
        dated = [(c, taken) for c in found if (taken := c.row.taken) is not None]
        cues = [replace(c, row=replace(c.row, seconds=(t - dated[0][1]).total_seconds())) for c, t in dated]
    if fault := next((c.fault for c in cues if c.fault), ""):
        raise InputError(f"{source}: {fault}")
    unread = "; ".join(sorted(set[str]().union(*(c.unread for c in cues))))
    warning = f"{source}: {unread}" if unread else ""
    bracketed = [c for c in cues if len(c.gps) >= 2]
    if not bracketed:
        return replace(FilmTelemetry.of((c.row for c in cues), source), warning=warning)
    latitude_first, why = _order(bracketed)
    if latitude_first is None:
        raise InputError(
            f"{source}: {why} whether latitude or longitude comes first in GPS(...); write [latitude: ...] "
            "[longitude: ...] instead, or give the track as a .gpx file"
        )
    rows = [c.placed(latitude_first) for c in bracketed]
    if _third(bracketed)[1]:
        rows = [replace(r, values={"abs_alt": c.gps[2].value} | r.values) if len(c.gps) > 2 else r
                for c, r in zip(bracketed, rows, strict=True)]  # fmt: skip
    order = "latitude, longitude" if latitude_first else "longitude, latitude"
    return replace(FilmTelemetry.of(rows, source, f"GPS({order}): {why}"), warning=warning)


def subtitles_in(text: str) -> list[Subtitle]:
    """Split a file into subtitles."""
    text = text.lstrip("\ufeff").replace("\r", "")
    if "[Script Info]" in text or text.startswith("Dialogue:"):
        bodies = ((at, re.sub(r"{[^}]*}", "", body)) for at, body in _ASS.findall(text))
        return [(_seconds(at), re.sub(r"\\[Nn]", "\n", body)) for at, body in bodies]
    blocks = ((_TIME.search(block), block) for block in re.split(r"\n\s*\n", text))
    return [(_seconds(at[1]), block[at.end() :]) if at else (math.nan, block) for at, block in blocks]


def _seconds(clock: str) -> float:
    """Convert h:m:s or m:s to seconds."""
    return sum(60.0**k * float(part) for k, part in enumerate(reversed(clock.replace(",", ".").split(":"))))


def _cue(seconds: float, body: str) -> _Cue:
    body = _PARTS.sub(_as_degrees, re.sub(r"<[^>]*>", " ", body).translate(QUOTES))
    written = dict[str, _Number]()
    for name, *digits in _PAIR.findall(body):
        written.setdefault(name.lower(), _Number.of(*digits))
    found = {key: next((written[n] for n in names if n in written), None) for key, names in NAMES.items()}
    unread = _unread(written, found)
    found |= {k: None for k in LENGTHS if (v := found[k]) and v.unit not in ("", *FEET, *METRES)}
    values = {n: v.value for n, v in written.items() if n not in LENGTHS}
    values |= {k: v.value for k, v in found.items() if v is not None}
    if gimbal := _GIMBAL.search(body):
        values |= dict(zip(("gb_pitch", "gb_roll", "gb_yaw"), map(float, gimbal.groups()), strict=True))
    brackets = {"gps": tuple[_Number, ...](), "home": tuple[_Number, ...]()}
    for name, inside, line in _BRACKET.findall(body):
        numbers = inside or line
        brackets[name.lower()] = tuple(_Number.of(*d) for d in _INSIDE["." if "." in numbers else ","].findall(numbers))
    fault = ""
    if _BARE_PARTS.search(body) or any(_has_bare_parts(inside) for _, inside, _ in _BRACKET.findall(body)):
        fault = "a place in degrees and minutes has no hemisphere letters: write decimal degrees"
    named = found["latitude"], found["longitude"]
    if any(n and n.letter and n.letter in wrong for n, wrong in zip(named, ("EW", "NS"), strict=True)):
        fault = "latitude has the letter E or W, or longitude N or S: exchange their names"
    if all(named):
        brackets["gps"] = ()
    axes = [n.decimals for n in named if n] or [n.decimals for n in brackets["gps"][:2]]
    coarse = bool(axes) and max(axes) <= 4  # decimals of a degree: 11 m
    return _Cue(TelemetryRow(seconds, values, _date(body), coarse), **brackets, unread=unread, fault=fault)


def _as_degrees(parts: re.Match[str]) -> str:
    """Return decimal degrees for matched degrees, minutes and seconds; the matched text if it is no angle."""
    before, degrees, minutes, seconds, after = parts.groups()
    letter = before or after
    if not letter or not (seconds or after) or max(float(minutes), float(seconds or 0)) >= 60:
        return parts[0]
    decimals = (4 if seconds else 2) + len((seconds or minutes).partition(".")[2])
    return f"{int(degrees) + float(minutes) / 60 + float(seconds or 0) / 3600:.{decimals}f}{letter}"


def _has_bare_parts(inside: str) -> bool:
    """Whether the text in a bracket has several numbers between two separators; decimal commas are separators here."""
    parts = [re.findall(r"\d+(?:\.-?\d+)?", p) for p in re.split(r"[,;]", inside)]
    return len(parts) > 1 and max(map(len, parts)) > (1 if "." in inside else 2)


def _unread(written: dict[str, _Number], found: dict[str, _Number | None]) -> frozenset[str]:
    """Return sentences on heights and zooms that are not used, or whose meaning is not declared.

    `written`: numbers by written name; `found`: the number used for each of our names, None: there is none.
    """
    read, out = {n for names in NAMES.values() for n in names}, set[str]()
    for name, number in written.items():
        if name not in read and re.search(r"alt|height|zoom", name) and not ("zoom" in name and number.value == 1):
            out.add(f"{name} is not used")
    for key in LENGTHS:
        if (length := found[key]) and length.unit not in ("", *FEET, *METRES):
            out.add(f"the unit {length.unit!r} of {key} is not known, and {key} is not used")
    plain = written.get("altitude") or written.get("alt")
    if plain and found["abs_alt"] is plain and found["rel_alt"] is None:
        out.add("altitude is taken to count from sea level, which is not declared: if from take-off, name it rel_alt")
    return frozenset(out)


def _date(body: str) -> datetime | None:
    if (found := _STAMP.search(body)) is None:
        return None
    *whole, fraction = found.groups()
    try:
        at = datetime(*(int(v) for v in whole), tzinfo=UTC)  # type: ignore[arg-type, misc]
    except ValueError:
        return None
    return at + timedelta(milliseconds=int((fraction or "0").ljust(3, "0")))


def _place(numbers: tuple[_Number, ...], latitude_first: bool) -> dict[str, float]:
    pair = [n.value for n in numbers[:2]]
    return dict(zip(("latitude", "longitude"), pair if latitude_first else reversed(pair), strict=True))


def _order(cues: Sequence[_Cue]) -> tuple[bool | None, str]:
    """Infer whether latitude comes first in brackets (None: unclear), and how this is known.

    Hemisphere letters and an angle beyond 90 degrees are proof. Otherwise the distance from HOME (`D`) and the third
    number decide: a height follows latitude and longitude (Matrice 300, Avata 2), a count of satellites follows
    longitude and latitude (Mavic, Phantom).
    """
    letters = {(n.letter in ("N", "S")) == (k == 0) for c in cues for k, n in enumerate(c.gps[:2]) if n.letter}
    beyond = {k == 1 for c in cues for k, n in enumerate(c.gps[:2]) if abs(n.value) > 90}
    for proof, why in ((letters, "hemisphere letters"), (beyond, "an angle beyond 90 degrees")):
        if len(proof) == 1:
            return proof.pop(), why
        if proof:
            return None, f"{why} contradict each other"
    third, home = _third(cues)[0], _by_home(cues)
    votes = {} if home is None else {"the distance from HOME": home}
    votes |= {f"the third number is {third}": "height" in third} if third else {}
    if len(set(votes.values())) == 1:
        return next(iter(votes.values())), " and ".join(votes)
    return None, f"{' and '.join(votes)} contradict each other" if votes else "nothing shows"


def _by_home(cues: Sequence[_Cue]) -> bool | None:
    """Return whether latitude first reproduces the distances from HOME; None: unclear."""
    misfits = []
    for latitude_first in (True, False):
        off = [
            abs(abs(apart(replace(c.row, values=_place(c.home, latitude_first)), c.placed(latitude_first))) - d) / d
            for c in cues if len(c.home) >= 2 and (d := c.row.values.get("home_distance", 0.0)) > 0
            and max(abs(n.value) for n in (*c.home[:2], *c.gps[:2])) <= 90
        ]  # fmt: skip
        misfits.append(float(np.median(off)) if off else math.nan)
    best, other = sorted(misfits)
    return misfits[0] == best if other > 0.1 and best < other / 2 else None  # shares of the distance


def _third(cues: Sequence[_Cue]) -> tuple[str, bool]:
    """Return what the third number in brackets is, in words (empty: unclear), and whether it is an altitude.

    Decimals, unit or size show a height. It is no altitude if it is always zero, or the height above take-off.
    """
    numbers = [(c.gps[2], c.row.values.get("rel_alt", math.nan)) for c in cues if len(c.gps) > 2]
    third, up = np.array([(n.value, height) for n, height in numbers]).reshape(-1, 2).T
    is_same = bool((abs(third - up) <= 1).all())  # m; equal after rounding, or by chance
    if any(n.decimals or n.unit in (*FEET, *METRES) or not 0 <= n.value <= 60 for n, _ in numbers):
        return "a height", bool(third.any()) and not is_same
    if is_same:
        return "the height" if len(third) and np.ptp(third) > 3 else "", False
    return "a count of satellites", False
