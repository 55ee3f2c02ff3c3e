"""Positions of photos from a file: `geo.txt` in OpenDroneMap's format, or a table with a header (CSV)."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
import pyproj
from pyproj.exceptions import CRSError, ProjError

from alight.documents import DocumentError, read_text
from alight.records import InputError
from alight.sources.raster_band import metres_of

COLUMNS = {  # names of the columns of a table, reduced to letters
    "name": "name file filename image imagename imagefile picture photo photoname label sourcefile",
    "latitude": "latitude lat gpslatitude y",
    "longitude": "longitude lon long lng gpslongitude x",
    "latitude ref": "latituderef latref gpslatituderef",
    "longitude ref": "longituderef lonref gpslongituderef",
    "height": "height altitude alt elevation z h gpsaltitude altitudemsl altmsl heightmsl msl orthometricheight "
    "ellipsoidalheight heightellipsoid ellipsoidheight heightaboveellipsoid hae altitudeellipsoid ellipsoidalaltitude",
    "height ref": "altituderef gpsaltituderef",
    "across": "sigmah sigmahorizontal horizontalsigma horizontalaccuracy accuracyhorz accuracyhorizontal hacc "
    "accuracyxy xyaccuracy gpsxyaccuracy sigmaxy accuracy",
    "up": "sigmav sigmavertical verticalsigma verticalaccuracy accuracyvert accuracyvertical vacc accuracyz zaccuracy "
    "gpszaccuracy sigmaz sigmau sigmaup sdheight",
    "east": "sigmae sigmaeast sdlon",
    "north": "sigman sigmanorth sdlat",
}  # fmt: skip
ROLES = {word: role for role, words in COLUMNS.items() for word in words.split()}
WGS84 = pyproj.CRS("WGS84")
UNDECLARED = "sea level or ellipsoid: not declared"
REFERENCES = {  # first letters in a column of hemispheres or `GPSAltitudeRef`: of positive and of negative values
    "latitude": ("N", "S"), "longitude": ("E", "W"), "height": ("A02", "B13"),
}  # fmt: skip
ORDER = ("longitude", "latitude", "height", "yaw", "pitch", "roll", "across", "up")  # of the numbers in geo.txt
FORM = "name x y [z] [yaw pitch roll] [sigma_h [sigma_v]]"  # of a line of geo.txt


Row = tuple[int, str, dict[str, float]]  # line, name of the photo, numbers by role


class GivenPlace(NamedTuple):
    """Position of a photo, as given in a file."""

    latitude: float  # degrees
    longitude: float
    height: float  # metres above the datum of the file; NaN: not given
    sigma: (
        tuple[float, float, float] | None
    )  # 1-sigma in metres, east, north, up, NaN: not given; None: none of them is


class Places(NamedTuple):
    """Positions by photo name, as given in a file."""

    file: Path
    rows: Mapping[str, GivenPlace]
    datum: str  # vertical datum of the heights, in words
    settled: str  # coordinate system and columns, in words

    def of(self, names: Sequence[str]) -> dict[str, GivenPlace]:
        """Return the positions of photos by their names within the set; folder, suffix and case need not match.

        Raises:
            InputError: one row matches several photos.
        """
        fitting = defaultdict[str, dict[str, GivenPlace]](dict)
        for written, place in self.rows.items():
            for key in _keys(written):
                fitting[key][written] = place
        found, taken = dict[str, GivenPlace](), dict[str, str]()
        for name in names:
            for key in _keys(name):
                if len(fitting.get(key, ())) == 1:
                    ((written, found[name]),) = fitting[key].items()
                    if (other := taken.setdefault(written, name)) != name:
                        raise InputError(f"{self.file}: {written} fits {other} and {name}: write the folder as well")
                    break
        return found


def _keys(name: str) -> list[str]:
    path = PurePosixPath(name.replace("\\", "/").casefold().removeprefix("./"))
    return [str(path), str(path.with_suffix("")), path.name, path.stem]


def places_beside(root: Path) -> Path | None:
    """Find the position file in a photo folder, or in the parent of a folder `images` or `photos`; None: not found.

    Raises:
        InputError: there are several position files.
    """
    for folder in [root, root.parent] if root.name.lower() in ("images", "photos") else [root]:
        files = _tables_in(folder)
        found = [p for p in files if p.name.lower() == "geo.txt"]
        found = found or [p for p in files if (header := _header_in(p)) and "name" in header.roles.values()]
        if len(found) > 1:
            raise InputError(f"{folder}: {found[0].name} and {found[1].name} both give places: name one with --places")
        if found:
            return found[0]
    return None


def unread_tables(root: Path, names: Sequence[str], used: Path | None) -> list[str]:
    """Return a warning for each table in a photo folder that names at least three of the photos and is not `used`."""
    files = {PurePosixPath(name.casefold()) for name in names}
    keys = {p.name for p in files} | {p.stem for p in files if not p.stem.isdigit()}
    warnings = []
    for path in _tables_in(root):
        with suppress(OSError, DocumentError):
            count = len(keys & set(re.split(r"[;,\s\"]+", read_text(path, 10_000_000).casefold())))
            if path != used and count >= min(3, len(files)):
                warnings.append(
                    f"{path.name} names {count} photos and is not read: if it gives their places, write the header "
                    "name,latitude,longitude,height into its first line"
                )
    return warnings


def _tables_in(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in (".txt", ".csv") and p.is_file())


def _header_in(path: Path) -> _Header | None:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return _header_of(file.read(10_000).splitlines())


def read_places(path: Path) -> Places:
    """Read a position file.

    Raises:
        InputError: the file is not a position file; the message names the line and what it must hold.
    """
    try:
        text = read_text(path, 100_000_000)
    except OSError as e:
        raise InputError(f"--places {path}: cannot be read ({e.strerror})") from e
    except DocumentError as e:
        raise InputError(f"--places {path}: {e}") from e
    if (header := _header_of(text.splitlines())) is not None:
        return _read_table(path, text.splitlines(), header)
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    crs = _crs_of(lines[0][1]) if lines else None
    if crs is None:
        raise InputError(
            f"{path}: its first line is neither a coordinate system (EPSG:4326, WGS84 UTM 32N, +proj=...) nor a header "
            "such as name,latitude,longitude,height"
        )
    return _read_geo(path, [(n, line) for n, line in lines[1:] if not line.lstrip().startswith("#")], crs)


# -- geo.txt


def _crs_of(line: str) -> pyproj.CRS | None:
    text = line.strip().lstrip("#").strip()
    if utm := re.fullmatch(r"WGS\s*84[ /]*UTM(?:\s+zone)?\s+(\d{1,2})\s*([NS])", text, re.IGNORECASE):
        text = f"EPSG:{32600 + int(utm[1]) + 100 * (utm[2].upper() == 'S')}"
    try:
        return pyproj.CRS.from_user_input(text)
    except CRSError:
        return None


def _read_geo(path: Path, lines: Sequence[tuple[int, str]], crs: pyproj.CRS) -> Places:
    up, datum = _vertical(path, crs)
    plane = crs.sub_crs_list[0] if crs.sub_crs_list else crs.to_2d()
    rows = list[Row]()
    for n, line in lines:
        words, parts = line.split(), [part.strip() for part in line.split(",")]
        if len(parts) > 2 and all(_number(part) is not None for part in parts[1:]) and "." in parts[1]:
            words = parts  # separated by commas
        first = len(words)
        while first > 1 and first > len(words) - 9 and _number(words[first - 1]) is not None:
            first -= 1
        numbers = [float(w) for w in words[first:]]
        if len(numbers) not in (2, 3, 6, 7, 8) or not np.isfinite(numbers[:2]).all():
            comma = ", with points for decimal commas and blanks between" * bool(re.search(r"\d,\d", line))
            raise InputError(f"{path}: line {n}: needs {FORM}{comma}; it has {len(numbers)} number(s) after the name")
        rows.append((n, " ".join(words[:first]), dict(zip(ORDER, numbers, strict=False))))
    if not rows:
        raise InputError(f"{path}: has no rows; needs {FORM}")
    try:
        transformer = pyproj.Transformer.from_crs(plane, WGS84, always_xy=True)
        x, y = transformer.transform(*np.array([[value[axis] for axis in ORDER[:2]] for *_, value in rows]).T)
    except ProjError as e:
        raise InputError(f"{path}: {crs.name} cannot be turned into latitude and longitude ({e})") from e
    for (*_, value), longitude, latitude in zip(rows, x.tolist(), y.tolist(), strict=True):
        value |= {"longitude": longitude, "latitude": latitude}
    most = Counter(len(value) for *_, value in rows).most_common(1)[0][0]
    angles = ", angles not used (their convention is not declared)" if most >= 6 else ""
    settled = f"{crs.name}, x y{' z' if most > 2 else ''}{', sigmas' if most >= 7 else ''}{angles}"
    return _places(path, rows, up, datum, settled)


def _vertical(path: Path, crs: pyproj.CRS) -> tuple[float, str]:
    """Return the metres per unit of height (negative: depth) and the vertical datum of the system `crs` in words."""
    axes = crs.axis_info
    if len(axes) == 3:
        parts = crs.sub_crs_list
        sign = -1.0 if axes[2].direction == "down" else 1.0
        return sign * axes[2].unit_conversion_factor, f"sea level ({parts[1].name})" if parts else "ellipsoid"
    if not crs.is_geographic and axes and axes[0].unit_conversion_factor != 1.0:
        raise InputError(
            f"{path}: {crs.name} is not in metres, and the unit of heights is not declared; give a system such "
            "as EPSG:2263+6360"
        )
    return 1.0, "sea level (by its geoid grid)" if "geoidgrids" in crs.to_wkt() else UNDECLARED


# -- tables


class _Header(NamedTuple):
    """Header of a table."""

    line: int  # number, from 1
    mark: str  # character between fields
    columns: list[str]
    roles: dict[int, str]  # role, such as "latitude", of each used column, by its index


def _header_of(lines: Sequence[str]) -> _Header | None:
    """Return the header of a table, which may follow comments or be a comment; None: the lines have no header."""
    for n, line in enumerate(lines, 1):
        mark = max(";\t,", key=line.count)
        columns = next(csv.reader([line.strip()], delimiter=mark), [])
        roles = _roles(columns)
        if {"latitude", "longitude"} <= set(roles.values()):
            return _Header(n, mark, columns, roles)
        if line.strip() and not line.lstrip().startswith("#"):
            break
    return None


def _roles(columns: Sequence[str]) -> dict[int, str]:
    """Return the role of each used column by its index; of several heights, one with a declared datum is used."""
    named = [ROLES.get(re.sub("[^a-z]", "", _split_unit(column)[0].lower())) for column in columns]
    order = sorted(range(len(named)), key=lambda k: named[k] == "height" and _datum(columns[k]) == UNDECLARED)
    first = {role: k for k in reversed(order) if (role := named[k]) is not None}
    return {k: role for role, k in sorted(first.items(), key=lambda item: item[1])}


def _split_unit(column: str) -> tuple[str, str]:
    """Split the name of a column into the name itself and its unit, in brackets or at its end; empty: no unit."""
    units = [w.strip() for w in re.findall(r"[\[(](.*?)[\])]", column)]
    name = re.sub(r"\[.*?\]|\(.*?\)|^#?\s*([XYZ]/|\w+:)", "", column).strip(" _")
    ending = re.fullmatch(r"(.+?)[\s_.-]+([a-z]+)", name, re.IGNORECASE)
    if not units and ending and (_is_angle(ending[2]) or metres_of(ending[2]) is not None):
        return ending[1], ending[2]
    return name, units[0] if units else ""


def _is_angle(unit: str) -> bool:
    return unit.lower().startswith(("deg", "°", "dd", "wgs"))


def _read_table(path: Path, lines: Sequence[str], header: _Header) -> Places:
    columns, roles = header.columns, header.roles
    if "name" not in roles.values():
        raise InputError(f"{path}: its header has no column of names; write name,latitude,longitude,height")
    unused = [column for k, column in enumerate(columns) if k not in roles and column.strip()]
    doubtful = [c for c in unused if re.match("(?i)alt|height|elev", c)]
    if doubtful and "height" not in roles.values():
        raise InputError(
            f"{path}: the column {doubtful[0]!r} is not known; name it height, altitude_msl or ellipsoidal_height, "
            "with its unit in brackets, or remove it"
        )
    up, datum = _declared(path, lines[: header.line - 1])
    rows, units = list[Row](), {role: _unit(path, columns[k]) for k, role in roles.items()}
    for n, fields in enumerate(csv.reader(lines, delimiter=header.mark), 1):
        if n <= header.line or not any(f.strip() for f in fields) or fields[0].startswith("#"):
            continue
        if len(fields) != len(columns):
            raise InputError(
                f"{path}: line {n} has {len(fields)} fields, the header {len(columns)}; write decimal points, not "
                "commas"
            )
        texts = {role: fields[k].strip() for k, role in roles.items()}
        name, signs = texts.pop("name"), {role: texts.pop(f"{role} ref", "") for role in REFERENCES}
        value = {"height": math.nan}
        for role, word in texts.items():
            number = math.nan if not word and role not in ("latitude", "longitude") else _number(word)
            if number is None:
                comma = "a decimal comma; write a point" if re.fullmatch(r"[-+]?\d+,\d+", word) else "no number"
                raise InputError(f"{path}: line {n}: {word!r} is {comma}")
            value[role] = number * units[role]
        for role, word in signs.items():
            value[role] = _signed(f"{path}: line {n}", value[role], word, REFERENCES[role])
        rows.append((n, name, value))
    if not rows:
        raise InputError(f"{path}: has a header and no rows")
    heights = [columns[k] for k, role in roles.items() if role == "height"]
    own = _datum(heights[0]) if heights else UNDECLARED
    used = ", ".join(columns[k] for k in roles) + (f"; not used: {', '.join(unused)}" if unused else "")
    return _places(path, rows, up, datum if own == UNDECLARED else own, f"columns {used}")


def _declared(path: Path, comments: Sequence[str]) -> tuple[float, str]:
    """Return the metres per unit of height and the vertical datum, by the comment `# CoordinateSystem: ...`."""
    text = next((t for c in comments if (t := c.partition("CoordinateSystem:")[2].strip())), "EPSG:4326")
    crs = _crs_of(text)
    if crs is None or not crs.is_geographic or crs.geodetic_crs is None or crs.geodetic_crs.name != WGS84.name:
        raise InputError(f"{path}: {text[:60]} is not WGS 84; write geo.txt, with this system in its first line")
    return _vertical(path, crs)


def _signed(where: str, value: float, word: str, letters: tuple[str, str]) -> float:
    """Return a value with the sign that `word`, a hemisphere (`N`, `South`) or `GPSAltitudeRef`, gives.

    `letters` are the first letters of positive and of negative words; error messages begin with `where`.
    """
    letter = word[:1].upper()
    if letter and letter in letters[1]:
        return -abs(value)
    if letter not in letters[0] or (letter and value < 0):
        raise InputError(f"{where}: {word!r} does not fit {value:g}")
    return value


def _unit(path: Path, name: str) -> float:
    """Return the metres per unit, from the unit in the column's `name`; 1 without a unit and for angles."""
    unit = _split_unit(name)[1] or "m"
    metres = 1.0 if _is_angle(unit) else metres_of(unit)
    if metres is None:
        raise InputError(f"{path}: the unit of the column {name!r} is not known; write m or ft")
    return metres


def _datum(column: str) -> str:
    word = re.sub("[^a-z]", "", _split_unit(column)[0].lower())
    if any(part in word for part in ("msl", "orthometric", "sea", "geoid")):
        return f"sea level ({column})"
    return f"ellipsoid ({column})" if "ellips" in word or word == "hae" else UNDECLARED


# -- both


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _places(path: Path, rows: Sequence[Row], up: float, datum: str, settled: str) -> Places:
    """Gather the rows of a file; `up`: metres per unit of height."""
    out = dict[str, GivenPlace]()
    for line, name, value in rows:
        latitude, longitude, across = value["latitude"], value["longitude"], value.get("across", math.nan)
        if not (abs(latitude) <= 90 and abs(longitude) <= 180):
            raise InputError(
                f"{path}: line {line}: latitude {latitude:g}, longitude {longitude:g} is no place on Earth; "
                "x is the longitude, y the latitude"
            )
        if name in out:
            raise InputError(f"{path}: line {line}: {name} stands twice")
        sigmas = value.get("east", across), value.get("north", across), value.get("up", math.nan)
        east, north, vertical = (s if 0 < s < math.inf else math.nan for s in sigmas)
        sigma = None if np.isnan([east, north, vertical]).all() else (east, north, vertical)
        out[name] = GivenPlace(latitude, longitude, up * value.get("height", math.nan), sigma)
    return Places(path, out, datum, settled)
