"""Settle the positions of a set of photos: which source of location and altitude is used, and the vertical datum."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.arrays import F64, I64
from alight.photos.reading.photo_pose import GPS_SIGMA, position_sigma
from alight.photos.reading.photo_tags import PhotoTags, Position
from alight.photos.reading.places import Places, places_beside, read_places
from alight.records import InputError

METRES_A_DEGREE = 111_194.0
SAME_ALTITUDE = 1.0  # m; two altitudes of a photo that differ by less are treated as equal
STEADY = 5.0  # m; altitudes above sea level and above take-off may drift apart by this much, up or down, in a flight


class Positions(NamedTuple):
    """The photos of a set with settled positions, and how they were settled."""

    photos: list[PhotoTags]
    source: str  # where locations and altitudes come from, in words
    warnings: list[str]
    contradictions: list[str]
    counted_from: str = ""  # vertical datum of the altitudes, in words


def settle_positions(
    photos: Sequence[PhotoTags], root: Path, places: Path | None = None, geoid: Path | None = None
) -> Positions:
    """Settle the positions of a set, by a position file if one is given or lies next to the photos, else by the tags.

    Args:
        photos: all photos of the set.
        root: folder of the set.
        places: position file, or `tags` to use no file; None: search for a file next to the photos.
        geoid: grid of geoid heights, to convert altitudes that are known to be above sea level; None: do not convert.

    Raises:
        InputError: the position file, or the geoid, cannot be used.
    """
    path = places_beside(root) if places is None else places if str(places) != "tags" else None
    if path is not None:
        names = [p.path.relative_to(root).as_posix() for p in photos]
        found = positions_by_file(photos, names, read_places(path))
    else:
        timed = sorted(photos, key=lambda p: (p.time_ns or 0, p.path))
        found = positions_by_tags(timed, flights_of(timed))
    moved, counted_from, warnings = above_ellipsoid(found.photos, geoid)
    return found._replace(photos=moved, counted_from=counted_from, warnings=found.warnings + warnings)


def flights_of(photos: Sequence[PhotoTags]) -> list[int]:
    """Return the flight index of each photo, from 0; a new flight begins after five minutes without a photo."""
    out, flight, before = list[int](), 0, None
    for taken in (tags.time_ns for tags in photos):
        flight += before is not None and taken is not None and taken - before > 300_000_000_000
        before = before if taken is None else taken
        out.append(flight)
    return out


def positions_by_file(photos: Sequence[PhotoTags], names: Sequence[str], places: Places) -> Positions:
    """Replace the positions in the tags by the positions in a file.

    Photos without a row get no position, because their tags may use another datum.

    Raises:
        InputError: no row matches a photo, or x and y are exchanged.
    """
    found, file = places.of(names), places.file.name
    if not found:
        first = next(iter(places.rows))
        raise InputError(f"{places.file}: none of its {len(places.rows)} names is that of a photo (first: {first})")
    _check_order(photos, names, places)
    out, lack = list[PhotoTags](), [n for n in names if n not in found]
    for photo, name in zip(photos, names, strict=True):
        if name not in found:
            out.append(replace(photo, settled=Position(None, None, places.datum, file)))
            continue
        at = found[name]
        tagged = photo.position if math.isnan(at.height) else None
        altitude = at.height if tagged is None and not math.isnan(at.height) else tagged and tagged[2]
        kind = photo.altitude_kind if math.isnan(at.height) else places.datum
        out.append(replace(photo, settled=Position((at.latitude, at.longitude), altitude, kind, file, at.sigma)))
    warnings, others = [], len(places.rows) - len(found)
    if lack:
        warnings.append(f"{file}: {len(lack)} photo(s) have no row (first: {lack[0]}): the pictures alone place them")
    if others:
        warnings.append(f"{file}: {others} row(s) name no photo of the set")
    return Positions(out, f"{file} ({places.settled}): {len(found)} of {len(photos)} photos", warnings, [])


def _check_order(photos: Sequence[PhotoTags], names: Sequence[str], places: Places) -> None:
    """Refuse a file that agrees with the tags only if latitude and longitude are exchanged."""
    found = places.of(names)
    pairs = [(p.place, found[n]) for p, n in zip(photos, names, strict=True) if n in found and p.place is not None]
    if not pairs:
        return
    tags, rows = np.array([t for t, _ in pairs]), np.array([(r.latitude, r.longitude) for _, r in pairs])
    straight, exchanged = (np.median(np.abs(tags - r).max(axis=1)) for r in (rows, rows[:, ::-1]))
    if straight > 1.0 and exchanged < 0.1 * straight:
        raise InputError(
            f"{places.file}: its places lie {straight:.0f} degrees from those of the tags, and with latitude and "
            "longitude exchanged they do not: write x (longitude) before y (latitude)"
        )


def positions_by_tags(photos: Sequence[PhotoTags], flights: Sequence[int]) -> Positions:
    """Settle positions by the tags: the finer of the EXIF and XMP locations, and the altitude that other tags confirm.

    Args:
        photos: photos in order of time.
        flights: flight index of each photo, because heights above take-off of two flights differ.
    """
    warnings, contradictions = list[str](), list[str]()
    places = _finer_places(photos, warnings, contradictions)
    altitudes, source = _altitudes(photos, np.array(flights), warnings, contradictions)
    out = []
    for photo, place, altitude in zip(photos, places, altitudes, strict=True):
        known = None if math.isnan(altitude) else altitude
        out.append(replace(photo, settled=Position(place, known, photo.kind_of(known))))
    out = _by_coarse_places(out, warnings)
    placed = [p for p in out if p.place is not None]
    if placed and not any(p.position is not None for p in placed):
        relative = [p.relative_altitude for p in placed]
        by_takeoff = all(r is not None for r in relative)
        source = "the height above take-off is used" if by_takeoff else "the flight is taken as level"
        warnings.append(f"no photo says its altitude: {source}, heights above the sea are not known")
        out = [_with_altitude(p, (p.relative_altitude or 0.0) if by_takeoff else 0.0) for p in out]
    return Positions(out, source, warnings, contradictions)


def _with_altitude(photo: PhotoTags, altitude: float) -> PhotoTags:
    assert photo.settled is not None
    return replace(photo, settled=photo.settled._replace(altitude=altitude))


def _finer_places(
    photos: Sequence[PhotoTags], warnings: list[str], contradictions: list[str]
) -> list[tuple[float, float] | None]:
    """Return the EXIF locations, or the XMP locations if these are finer and agree within the rounding of EXIF."""
    own = [p.place for p in photos]
    both = [k for k, p in enumerate(photos) if p.exif_place is not None and p.xmp_place is not None]
    if not both:
        return own
    exif, xmp = (np.array([getattr(photos[k], f"{n}_place") for k in both]) for n in ("exif", "xmp"))
    step, off = _step_of_places(exif), METRES_A_DEGREE * float(np.abs(exif - xmp).max())
    if off > max(1.01 * step, GPS_SIGMA[0]):
        contradictions.append(f"places in EXIF and XMP lie up to {off:.1f} m apart: those in EXIF are used")
    elif off <= 1.01 * step and METRES_A_DEGREE * _step(xmp) < step and step > 0.05:
        for k, place in zip(both, xmp.tolist(), strict=True):
            own[k] = (place[0], place[1])
        warnings.append(f"places in EXIF have steps of {step:.2g} m: those in XMP are used, which are finer")
    return own


def _step_of_places(places: F64) -> float:
    """Return the rounding in metres of locations (n, 2), written in degrees; 0 if there are too few to know."""
    few = len(np.unique(places, axis=0)) < 3
    return 0.0 if few else METRES_A_DEGREE * _step(3600 * places) / 3600  # EXIF writes seconds of arc


def _by_coarse_places(photos: list[PhotoTags], warnings: list[str]) -> list[PhotoTags]:
    """Return the photos, with a larger position sigma if their locations are written with few digits."""
    step = _step_of_places(np.array([p.place for p in photos if p.place is not None]).reshape(-1, 2))
    if not step > GPS_SIGMA[0]:
        return photos
    across = step / math.sqrt(12.0)
    warnings.append(f"places have steps of {step:.0f} m: they count as known to {across:.0f} m")
    out = list[PhotoTags]()
    for photo in photos:
        east, north, up = np.maximum(position_sigma(photo), [across, across, 0.0]).tolist()
        assert photo.settled is not None
        out.append(replace(photo, settled=photo.settled._replace(sigma=(east, north, up))))
    return out


def _step(values: F64) -> float:
    """Return the largest power of ten, from 1e-9 to 1, of which all values are multiples."""
    for digits in range(9):
        scaled = values * 10.0**digits
        if np.abs(scaled - np.rint(scaled)).max() < 1e-3:
            return float(10.0**-digits)
    return 1e-9


def _altitudes(
    photos: Sequence[PhotoTags], flights: I64, warnings: list[str], contradictions: list[str]
) -> tuple[F64, str]:
    """Return the (n,) altitudes to use in metres, NaN where none is given, and their main source in words."""
    exif, absolute, relative = (
        np.array([math.nan if (v := getattr(p, name)) is None else v for p in photos])
        for name in ("exif_altitude", "absolute_altitude", "relative_altitude")
    )
    exif = np.where((exif == 0.0) & (np.abs(absolute) > SAME_ALTITUDE), math.nan, exif)  # the maker left it at zero
    both = np.isfinite(exif) & np.isfinite(absolute)
    use_exif = True
    if both.any():
        off = (exif - absolute)[both]
        steps = {"EXIF": _step(exif[both]), "XMP": _step(absolute[both])}
        coarser = max(steps.values())
        if float(np.ptp(off)) > max(SAME_ALTITUDE, 2 * coarser):
            drifts = [_drift(a[both] - relative[both], flights[both]) for a in (exif, absolute)]
            by_takeoff = np.isfinite(drifts).all() and abs(drifts[0] - drifts[1]) > SAME_ALTITUDE
            use_exif = drifts[0] < drifts[1] if by_takeoff else steps["EXIF"] < steps["XMP"]
            why = "agree with the heights above take-off" if by_takeoff else "are finer"
            contradictions.append(
                f"altitudes in EXIF and XMP differ by {off.min():+.1f} to {off.max():+.1f} m: one is wrong; those in "
                f"{'EXIF' if use_exif else 'XMP'} {why} and are used"
            )
        elif abs(float(np.median(off))) > max(SAME_ALTITUDE, coarser):
            use_exif = False
            warnings.append(
                f"altitudes in EXIF lie {abs(np.median(off)):.1f} m {'above' if np.median(off) > 0 else 'below'} those "
                "in XMP in all photos: they count from another surface; those in XMP are used"
            )
        else:
            use_exif = steps["EXIF"] <= steps["XMP"]
    first, second = (exif, absolute) if use_exif else (absolute, exif)
    used = np.where(np.isfinite(first), first, second)
    source = "tags, altitudes in EXIF" if use_exif and np.isfinite(exif).any() else "tags, altitudes in XMP"
    return _checked_by_takeoff(used, relative, flights, contradictions), source


def _checked_by_takeoff(used: F64, relative: F64, flights: I64, contradictions: list[str]) -> F64:
    """Return the altitudes `used` or, if only the heights above take-off change in a flight, altitudes from these."""
    known = np.isfinite(used) & np.isfinite(relative)
    if known.sum() < 3:
        return used
    drift = _drift((used - relative)[known], flights[known])
    if drift <= 2 * STEADY:
        return used
    stuck = bool(np.ptp(used[known]) <= SAME_ALTITUDE)
    what = "the altitudes stand still" if stuck else f"altitudes and heights above take-off drift {drift:.0f} m apart"
    chosen = "the heights above take-off decide" if stuck else "one is wrong; the altitudes are used"
    contradictions.append(f"{what} in a flight: {chosen}")
    return np.asarray(np.where(known, relative + np.median((used - relative)[known]), used)) if stuck else used


def _drift(difference: F64, flights: I64) -> float:
    """Return the largest range (m, 5th to 95th percentile) of `difference` (n,) within a flight; NaN if all is NaN."""
    parts = [difference[(flights == f) & np.isfinite(difference)] for f in np.unique(flights)]
    return max((float(np.ptp(np.percentile(p, [5, 95]))) for p in parts if len(p)), default=math.nan)


def above_ellipsoid(photos: Sequence[PhotoTags], geoid: Path | None) -> tuple[list[PhotoTags], str, list[str]]:
    """Convert altitudes that are known to be above sea level to heights above the ellipsoid.

    The geoid at the median location is used for the whole set; without a geoid, nothing is converted.

    Returns:
        The photos, the vertical datum of their altitudes in words, and warnings.

    Raises:
        InputError: the geoid cannot be used.
    """
    kinds = Counter(p.altitude_kind for p in photos if p.position is not None)
    counted = ", ".join(kind for kind, _ in kinds.most_common())
    if geoid is None:
        return list(photos), counted, []
    at_sea = {
        p.path: p.place for p in photos if p.position is not None and re.match(r"sea level($| \()", p.altitude_kind)
    }
    unknown = sum(n for kind, n in kinds.items() if kind.startswith("sea level or"))
    warnings = [
        f"--geoid: {unknown} height(s) are not known to count from the sea level and stay as they are; to declare it, "
        "give them by --places with a column altitude_msl, or with a system such as EPSG:4326+5773"
    ] * bool(unknown)
    if not at_sea:
        return list(photos), counted, warnings
    from alight.sources.geoid import separation_at

    latitude, longitude = np.median([place for place in at_sea.values() if place is not None], axis=0)
    separation = separation_at(geoid, float(latitude), float(longitude))
    moved = [_moved(p, separation) if p.path in at_sea else p for p in photos]
    return moved, f"ellipsoid, by {geoid.name}: {separation:+.2f} m from sea level", warnings


def _moved(photo: PhotoTags, up: float) -> PhotoTags:
    assert photo.settled is not None
    assert photo.settled.altitude is not None
    kind = "ellipsoid (by a geoid)"
    return replace(photo, settled=photo.settled._replace(altitude=photo.settled.altitude + up, altitude_kind=kind))
