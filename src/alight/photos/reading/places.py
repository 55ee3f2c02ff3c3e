"""Positions of photos from a file: `geo.txt` in OpenDroneMap's format, or a table with a header (CSV)."""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
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
    "height": "height altitude alt elevation z h gpsaltitude altitudemsl heightmsl msl orthometricheight "
    "ellipsoidalheight heightellipsoid ellipsoidheight heightaboveellipsoid hae altitudeellipsoid",
    "across": "sigmah sigmahorizontal horizontalsigma horizontalaccuracy accuracyhorz accuracyhorizontal hacc "
    "accuracyxy xyaccuracy gpsxyaccuracy sigmaxy",
    "up": "sigmav sigmavertical verticalsigma verticalaccuracy accuracyvert accuracyvertical vacc accuracyz zaccuracy "
    "gpszaccuracy sigmaz sigmau sigmaup sdheight",
    "east": "sigmae sigmaeast sdlon",
    "north": "sigman sigmanorth sdlat",
}  # fmt: skip
ROLES = {word: role for role, words in COLUMNS.items() for word in words.split()}
WGS84 = pyproj.CRS.from_epsg(4326)
UNDECLARED = "sea level or ellipsoid: not declared"


class GivenPlace(NamedTuple):
    """Position of a photo, as given in a file."""

    latitude: float  # degrees
    longitude: float
    height: float  # metres above the datum of the file; NaN: not given
    sigma: tuple[float, float, float] | None  # 1-sigma in metres, east, north, up; None: not given


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
    folders = [root, root.parent] if root.name.lower() in ("images", "photos") else [root]
    for folder in folders:
        files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".txt", ".csv") and p.is_file())
        found = [p for p in files if p.name.lower() == "geo.txt"] or [p for p in files if _has_header(p)]
        if len(found) > 1:
            raise InputError(f"{folder}: {found[0].name} and {found[1].name} both give places: name one with --places")
        if found:
            return found[0]
    return None


def _has_header(path: Path) -> bool:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        roles = _roles(_split(file.readline(10_000)))
    return {"name", "latitude", "longitude"} <= set(roles.values())


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
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if lines and {"latitude", "longitude"} <= set(_roles(_split(lines[0][1])).values()):
        return _read_table(path, text)
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
    rows, counts = list[tuple[int, str, list[float]]](), Counter[int]()
    for n, line in lines:
        words = line.split()
        first = len(words)
        while first > 1 and first > len(words) - 9 and _number(words[first - 1]) is not None:
            first -= 1
        numbers = [float(w) for w in words[first:]]
        if len(numbers) < 2 or not np.isfinite(numbers[:2]).all():
            comma = "; decimal commas are no points" if re.search(r"\d,\d", line) else ""
            raise InputError(f"{path}: line {n}: needs name x y [z] [yaw pitch roll] [sigma_h sigma_v]{comma}")
        rows.append((n, " ".join(words[:first]), numbers))
        counts[len(numbers)] += 1
    if not rows:
        raise InputError(f"{path}: has no rows; needs name x y [z] [yaw pitch roll] [sigma_h sigma_v]")
    try:
        transformer = pyproj.Transformer.from_crs(plane, WGS84, always_xy=True)
        x, y = transformer.transform(*np.array([numbers[:2] for *_, numbers in rows]).T)
    except ProjError as e:
        raise InputError(f"{path}: {crs.name} cannot be turned into latitude and longitude ({e})") from e
    out = dict[str, GivenPlace]()
    for (n, name, numbers), longitude, latitude in zip(rows, x, y, strict=True):
        height = up * numbers[2] if len(numbers) > 2 else math.nan
        sigma = _sigma(*numbers[6:8]) if len(numbers) >= 8 else None
        _put(out, path, n, name, GivenPlace(float(latitude), float(longitude), height, sigma))
    most = counts.most_common(1)[0][0]
    angles = ", angles not used (their convention is not declared)" if most >= 6 else ""
    return Places(
        path, out, datum, f"{crs.name}, x y{' z' if most > 2 else ''}{', sigmas' if most >= 8 else ''}{angles}"
    )


def _vertical(path: Path, crs: pyproj.CRS) -> tuple[float, str]:
    """Return the metres per unit of height, and the vertical datum in words, of a coordinate system."""
    axes = crs.axis_info
    if len(axes) == 3:
        parts = crs.sub_crs_list
        return axes[2].unit_conversion_factor, f"sea level ({parts[1].name})" if parts else "ellipsoid"
    if not crs.is_geographic and axes and axes[0].unit_conversion_factor != 1.0:
        raise InputError(
            f"{path}: {crs.name} is not in metres, and the unit of heights is not declared; give a system such "
            "as EPSG:2263+6360"
        )
    return 1.0, "sea level (by its geoid grid)" if "geoidgrids" in crs.to_wkt() else UNDECLARED


# -- tables


def _split(line: str) -> list[str]:
    mark = max(";\t,", key=line.count)
    return next(csv.reader([line.strip()], delimiter=mark), [])


def _roles(header: Sequence[str]) -> dict[int, str]:
    bare = [re.sub(r"\[.*?\]|\(.*?\)", "", name).rpartition("/")[2] for name in header]
    named = [ROLES.get(re.sub("[^a-z]", "", name.lower())) for name in bare]
    return {k: role for k, role in enumerate(named) if role is not None and role not in named[:k]}


def _read_table(path: Path, text: str) -> Places:
    header = _split(text.lstrip("\n\r").splitlines()[0])
    roles, mark = _roles(header), max(";\t,", key=text.splitlines()[0].count)
    if "name" not in roles.values():
        raise InputError(f"{path}: its header has no column of names; write name,latitude,longitude,height")
    out, units = dict[str, GivenPlace](), {role: _unit(path, header[k]) for k, role in roles.items()}
    for n, fields in enumerate(csv.reader(io.StringIO(text), delimiter=mark), 1):
        if n == 1 or not any(f.strip() for f in fields) or fields[0].startswith("#"):
            continue
        if len(fields) != len(header):
            raise InputError(
                f"{path}: line {n} has {len(fields)} fields, the header {len(header)}; write decimal points, not commas"
            )
        texts = {role: fields[k].strip() for k, role in roles.items()}
        name, value = texts.pop("name"), dict[str, float]()
        for role, word in texts.items():
            number = math.nan if not word and role not in ("latitude", "longitude") else _number(word)
            if number is None:
                comma = "a decimal comma; write a point" if re.fullmatch(r"[-+]?\d+,\d+", word) else "no number"
                raise InputError(f"{path}: line {n}: {word!r} is {comma}")
            value[role] = number * units[role]
        across = value.get("across", math.nan)
        sigma = value.get("east", across), value.get("north", across), value.get("up", math.nan)
        known = sigma if all(math.isfinite(s) and s > 0 for s in sigma) else None
        _put(
            out, path, n, name, GivenPlace(value["latitude"], value["longitude"], value.get("height", math.nan), known)
        )
    if not out:
        raise InputError(f"{path}: has a header and no rows")
    heights = [header[k] for k, role in roles.items() if role == "height"]
    used = ", ".join(header[k] for k in roles)
    return Places(path, out, _datum(heights[0]) if heights else UNDECLARED, f"columns {used}")


def _unit(path: Path, name: str) -> float:
    """Return the metres per unit, from the unit in brackets in a column's name; 1 without a unit."""
    words = [w.strip() for w in re.findall(r"[\[(](.*?)[\])]", name)]
    unit = words[0] if words and words[0] and not words[0].lower().startswith(("deg", "°", "dd", "wgs")) else "m"
    metres = metres_of(unit)
    if metres is None:
        raise InputError(f"{path}: the unit of the column {name!r} is not known; write m or ft")
    return metres


def _datum(column: str) -> str:
    word = re.sub("[^a-z]", "", column.lower())
    if any(part in word for part in ("msl", "orthometric", "sea", "geoid")):
        return f"sea level ({column})"
    return f"ellipsoid ({column})" if "ellips" in word or word == "hae" else UNDECLARED


# -- both


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _sigma(across: float, up: float) -> tuple[float, float, float] | None:
    return (across, across, up) if 0 < across < math.inf and 0 < up < math.inf else None


def _put(rows: dict[str, GivenPlace], path: Path, line: int, name: str, place: GivenPlace) -> None:
    if not (abs(place.latitude) <= 90 and abs(place.longitude) <= 180):
        raise InputError(
            f"{path}: line {line}: latitude {place.latitude:g}, longitude {place.longitude:g} is no place on Earth; "
            "x is the longitude, y the latitude"
        )
    if name in rows:
        raise InputError(f"{path}: line {line}: {name} stands twice")
    rows[name] = place
