"""Settle the positions of a set of photos: which source of location and altitude is used, and the vertical datum."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from alight.arrays import F64, I64
from alight.photos.reading.agreement import (
    FACTORS,
    METRES_A_DEGREE,
    SAME_ALTITUDE,
    STEADY,
    drift,
    factor_by,
    places_apart,
)
from alight.photos.reading.photo_pose import GPS_SIGMA, position_sigma
from alight.photos.reading.photo_tags import PhotoTags, Position
from alight.photos.reading.places import GivenPlace, Places, places_beside, read_places, unread_tables
from alight.records import InputError
from alight.records.telemetry import FARTHEST_FROM_SEA


@dataclass
class Positions:
    """Photos of a set in order of time, with settled positions, and what their sources contradict."""

    photos: list[PhotoTags]
    source: str = ""  # where locations and altitudes come from, in words
    counted_from: str = ""  # vertical datum of the altitudes, in words
    warnings: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)


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
    timed = sorted(photos, key=lambda p: (p.time_ns or 0, p.path))
    names, flights = [p.path.relative_to(root).as_posix() for p in timed], flights_of(timed)
    found = positions_by_tags(timed, flights) if path is None else (
        positions_by_file(timed, names, read_places(path), flights))  # fmt: skip
    if places is None:
        found.warnings += unread_tables(root, names, path)
    _drop_stuck(found)
    found.photos, found.counted_from, warnings = above_ellipsoid(found.photos, geoid)
    found.warnings += warnings
    return found


def _drop_stuck(found: Positions) -> None:
    """Remove a location that most photos share, as the receiver stood still, unless all do; report a contradiction."""
    placed = [p for p in found.photos if p.place is not None]
    if len({p.time_ns or p.path for p in placed}) < 3 or _step_of_places([p.place for p in placed]) > GPS_SIGMA[0]:
        return
    (place, count), *others = Counter(p.place for p in placed).most_common()
    if 2 * count <= len(placed):
        return
    still = "the receiver stood still, and the pictures alone place them"
    why = still if others else "nothing gives the scale; distances and heights are not to be trusted"
    found.contradictions.append(f"{count} of {len(found.photos)} photos have one and the same place: {why}")
    if others:
        found.photos = [p.positioned(place=None) if p.place == place else p for p in found.photos]


def flights_of(photos: Sequence[PhotoTags]) -> list[int]:
    """Return the flight index of each photo, from 0; a new flight begins after five minutes without a photo."""
    out, flight, before = list[int](), 0, None
    for taken in (tags.time_ns for tags in photos):
        flight += before is not None and taken is not None and taken - before > 300_000_000_000
        before = before if taken is None else taken
        out.append(flight)
    return out


def positions_by_file(
    photos: Sequence[PhotoTags], names: Sequence[str], places: Places, flights: Sequence[int]
) -> Positions:
    """Replace the positions in the tags by the positions in a file, after comparing both.

    Photos without a row get no position, because their tags may use another datum.

    Args:
        photos: photos in order of time.
        names: their names within the set.
        places: content of the file.
        flights: flight index of each photo.

    Raises:
        InputError: no row matches a photo, or the file's places are far from those of the tags.
    """
    rows, file = places.of(names), places.file.name
    if not rows:
        first = next(iter(places.rows))
        raise InputError(f"{places.file}: none of its {len(places.rows)} names is that of a photo (first: {first})")
    out = Positions([], f"{file} ({places.settled}): {len(rows)} of {len(photos)} photos")
    for photo, name in zip(photos, names, strict=True):
        at, settled = rows.get(name), Position(None, None, places.datum, file)
        if at is not None:
            by_tags = photo.position and photo.position[2], photo.altitude_kind
            height, datum = by_tags if math.isnan(at.height) else (at.height, places.datum)
            settled = Position((at.latitude, at.longitude), height, datum, file, at.sigma)
        out.photos.append(replace(photo, settled=settled))
    pairs = [(p, rows[n]) for p, n in zip(photos, names, strict=True) if n in rows]
    _compare_places(places.file, pairs, out)
    _compare_heights(file, pairs, np.array([f for f, n in zip(flights, names, strict=True) if n in rows]), out)
    if lack := [n for n in names if n not in rows]:
        left = f"{len(lack)} photo(s) have no row (first: {lack[0]}): the pictures alone place them"
        out.warnings.append(f"{file}: {left}")
    if others := len(places.rows) - len(rows):
        out.warnings.append(f"{file}: {others} row(s) name no photo of the set")
    return out


def _compare_places(file: Path, pairs: Sequence[tuple[PhotoTags, GivenPlace]], out: Positions) -> None:
    """Report locations of a file that contradict the tags; raise InputError if they are a degree apart."""
    both = [(p, row) for p, row in pairs if p.place is not None]
    if not both:
        return
    tags, rows = np.array([p.place for p, _ in both]), np.array([(r.latitude, r.longitude) for _, r in both])
    unsigned = np.array([p.hemisphere_missing for p, _ in both])
    apart, hint = places_apart(rows, np.where(unsigned[:, None], np.copysign(tags, rows), tags))
    if apart <= 20 * GPS_SIGMA[0]:
        return
    what = f"its places lie {apart / 1000:.1f} km from those of the tags" + (f"; {hint} they agree" if hint else "")
    if apart > METRES_A_DEGREE:
        raise InputError(
            f"{file}: {what}: mend the coordinate system, the signs, or the order (x, the longitude, before y, the "
            "latitude); if the tags are wrong, remove their GPSLatitude and GPSLongitude"
        )
    out.contradictions.append(f"{file.name}: {what}; those of the file are used")


def _compare_heights(file: str, pairs: Sequence[tuple[PhotoTags, GivenPlace]], flights: I64, out: Positions) -> None:
    """Compare a file's heights with altitudes and heights above take-off in the tags; report how they disagree.

    `pairs`: photos with their rows; `flights` (n,): flight index of each.
    """
    heights = np.array([row.height for _, row in pairs])
    tagged = np.array([p.position[2] if p.position and p.position[2] else math.nan for p, _ in pairs])
    above = np.array([p.relative_altitude for p, _ in pairs], np.float64)
    others, name = (above, "heights above take-off") if np.isfinite(above).any() else (tagged, "altitudes")
    apart = drift(heights - others, flights)
    factor = factor_by(heights, others, lambda off: drift(off, flights))
    if np.isfinite(heights - others).sum() >= 3 and (factor != 1.0 or apart > 2 * STEADY):
        how = f"ten times as well {FACTORS[factor]}" if factor != 1.0 else f"only to {apart:.0f} m in a flight"
        out.contradictions.append(f"{file}: its heights follow the {name} of the tags {how}; they are used as written")
    known = np.isfinite(heights) & np.isfinite(tagged)
    off = float(np.median((heights - tagged)[known])) if known.any() else 0.0
    if abs(off) <= STEADY:
        return
    factor = factor_by(heights[known], tagged[known], lambda off: float(np.median(np.abs(off))))
    is_above = float(np.median(np.abs(heights - above)[known])) < 0.1 * abs(off)
    datum = "they count from another surface" if abs(off) <= FARTHEST_FROM_SEA else "one is wrong"
    why = f"{FACTORS[factor]} they agree" if factor != 1.0 else "they count from take-off" if is_above else datum
    text = (
        f"{file}: its heights lie {abs(off):.1f} m {'above' if off > 0 else 'below'} those of the tags "
        f"({np.median(heights[known]):.0f} and {np.median(tagged[known]):.0f} m): {why}; they are used as written"
    )
    is_datum = factor == 1.0 and not is_above and abs(off) <= FARTHEST_FROM_SEA
    (out.warnings if is_datum else out.contradictions).append(text)


def positions_by_tags(photos: Sequence[PhotoTags], flights: Sequence[int]) -> Positions:
    """Settle positions by the tags: the finer of the EXIF and XMP locations, and the altitude that other tags confirm.

    Args:
        photos: photos in order of time.
        flights: flight index of each photo, because heights above take-off of two flights differ.
    """
    out = Positions([])
    if exchanged := sum(p.axes_exchanged for p in photos):
        out.warnings.append(f"{exchanged} photo(s) have a latitude east or west: it is read as the longitude")
    if half := sum(p.hemisphere_missing for p in photos):
        out.warnings.append(
            f"{half} photo(s) do not say whether their place is north or south, east or west: north and east are taken"
        )
    places, altitudes = _finer_places(photos, out), _altitudes(photos, np.array(flights), out)
    for photo, place, altitude in zip(photos, places, altitudes.tolist(), strict=True):
        known = None if math.isnan(altitude) else altitude
        out.photos.append(replace(photo, settled=Position(place, known, photo.kind_of(known))))
    placed = [p for p in out.photos if p.place is not None]
    if (step := _step_of_places([p.place for p in placed])) > GPS_SIGMA[0]:
        across = step / math.sqrt(12.0)
        out.warnings.append(f"places have steps of {step:.0f} m: they count as known to {across:.0f} m")
        sigmas = [np.maximum(position_sigma(p), [across, across, 0.0]).tolist() for p in out.photos]
        out.photos = [p.positioned(sigma=tuple(sigma)) for p, sigma in zip(out.photos, sigmas, strict=True)]
    if placed and not any(p.position for p in placed):
        by_takeoff = all(p.relative_altitude is not None for p in placed)
        source = "the height above take-off is used" if by_takeoff else "the flight is taken as level"
        out.warnings.append(f"no photo says its altitude: {source}, heights above the sea are not known")
        out.photos = [p.positioned(altitude=(p.relative_altitude or 0.0) if by_takeoff else 0.0) for p in out.photos]
    return out


def _finer_places(photos: Sequence[PhotoTags], out: Positions) -> list[tuple[float, float] | None]:
    """Return the EXIF locations, or the XMP locations if these are finer and agree within the rounding of EXIF."""
    own = [p.place for p in photos]
    both = [k for k, p in enumerate(photos) if p.exif_place is not None and p.xmp_place is not None]
    if not both:
        return own
    exif, xmp = (np.array([getattr(photos[k], f"{n}_place") for k in both]) for n in ("exif", "xmp"))
    step, off = _step_of_places(exif), METRES_A_DEGREE * float(np.abs(exif - xmp).max())
    if off > max(1.01 * step, GPS_SIGMA[0]):
        hint = places_apart(exif, xmp)[1]
        agree = f" ({hint} they agree)" if hint else ""
        out.contradictions.append(f"places in EXIF and XMP lie up to {off:.1f} m apart{agree}: those in EXIF are used")
    elif off <= 1.01 * step and METRES_A_DEGREE * _step(xmp) < step and step > 0.05:
        for k in both:
            own[k] = photos[k].xmp_place
        out.warnings.append(f"places in EXIF have steps of {step:.2g} m: those in XMP are used, which are finer")
    return own


def _step_of_places(places: F64 | Sequence[tuple[float, float] | None]) -> float:
    """Return the rounding in metres of locations (n, 2), written in degrees; 0 if there are too few to know."""
    few = len(np.unique(np.asarray(places), axis=0)) < 3
    return 0.0 if few else METRES_A_DEGREE * _step(3600 * np.array(places)) / 3600  # EXIF writes seconds of arc


def _step(values: F64) -> float:
    """Return the largest power of ten, from 1e-9 to 1, of which all values are multiples."""
    for digits in range(9):
        scaled = values * 10.0**digits
        if np.abs(scaled - np.rint(scaled)).max() < 1e-3:
            return float(10.0**-digits)
    return 1e-9


def _altitudes(photos: Sequence[PhotoTags], flights: I64, out: Positions) -> F64:
    """Return the (n,) altitudes to use in metres, NaN where none is given; write their main source into `out`.

    `flights` (n,): flight indices.
    """
    exif, absolute, relative = (
        np.array([getattr(p, name) for p in photos], np.float64)
        for name in ("exif_altitude", "absolute_altitude", "relative_altitude")
    )
    exif = np.where((exif == 0.0) & (np.abs(absolute) > SAME_ALTITUDE), math.nan, exif)  # the maker left it at zero
    both = np.isfinite(exif) & np.isfinite(absolute)
    use_exif = True
    if both.any():
        off, steps = (exif - absolute)[both], (_step(exif[both]), _step(absolute[both]))
        middle, use_exif = float(np.median(off)), steps[0] <= steps[1]
        if float(np.ptp(off)) > max(SAME_ALTITUDE, 2 * max(steps)):
            drifts = [drift(a[both] - relative[both], flights[both]) for a in (exif, absolute)]
            by_takeoff = np.isfinite(drifts).all() and abs(drifts[0] - drifts[1]) > SAME_ALTITUDE
            use_exif = drifts[0] < drifts[1] if by_takeoff else steps[0] < steps[1]
            why = "agree with the heights above take-off" if by_takeoff else "are finer"
            out.contradictions.append(
                f"altitudes in EXIF and XMP differ by {off.min():+.1f} to {off.max():+.1f} m: one is wrong; those in "
                f"{'EXIF' if use_exif else 'XMP'} {why} and are used"
            )
        elif abs(middle) > max(SAME_ALTITUDE, *steps):
            use_exif = False
            out.warnings.append(
                f"altitudes in EXIF lie {abs(middle):.1f} m {'above' if middle > 0 else 'below'} those "
                "in XMP in all photos: they count from another surface; those in XMP are used"
            )
    first, second = (exif, absolute) if use_exif else (absolute, exif)
    used = np.where(np.isfinite(first), first, second)
    out.source = f"tags, altitudes in {'EXIF' if use_exif and np.isfinite(exif).any() else 'XMP'}"
    used = _checked_by_takeoff(used, relative, flights, out)
    if np.isfinite(used).any() and (low := float(np.nanmedian(used))) < -FARTHEST_FROM_SEA:
        out.warnings.append(
            f"altitudes lie {-low:.0f} m below the sea: if the ground does not, GPSAltitudeRef is wrong"
        )
    return used


def _checked_by_takeoff(used: F64, relative: F64, flights: I64, out: Positions) -> F64:
    """Return the altitudes `used` (n,), corrected if the heights above take-off `relative` (n,) show an error.

    Altitudes in feet or with the opposite sign are converted. If the altitudes stand still in a flight that climbs,
    they are replaced by heights above take-off. Each error is reported; `flights` (n,) are flight indices.
    """
    known = np.isfinite(used) & np.isfinite(relative)
    if known.sum() < 3:
        return used
    if (factor := factor_by(used, relative, lambda off: drift(off, flights))) != 1.0:
        out.contradictions.append(
            f"altitudes change as the heights above take-off only {FACTORS[factor]}: they are read so; "
            f"{np.median(used[known]):.1f} becomes {factor * np.median(used[known]):.1f} m"
        )
        return factor * used
    off = np.where(known, used - relative, math.nan)
    apart = drift(off, flights)
    if apart <= 2 * STEADY:
        return used
    stuck = bool(np.ptp(used[known]) <= SAME_ALTITUDE)
    what = "the altitudes stand still" if stuck else f"altitudes and heights above take-off drift {apart:.0f} m apart"
    chosen = "the heights above take-off decide" if stuck else "one is wrong; the altitudes are used"
    out.contradictions.append(f"{what} in a flight: {chosen}")
    return np.where(known, relative + np.nanmedian(off), used) if stuck else used


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
    unknown = sum(n for kind, n in kinds.items() if kind.startswith("sea level or"))
    warnings = [
        f"--geoid: {unknown} height(s) are not known to count from the sea level and stay as they are; to declare it, "
        "give them by --places with a column altitude_msl, or with a system such as EPSG:4326+5773"
    ] * bool(unknown)
    at_sea = {p.path: at for p in photos if (at := p.position) is not None and p.is_above_sea}
    if not at_sea:
        return list(photos), counted, warnings
    from alight.sources.geoid import separation_at

    latitude, longitude, _ = np.median(list(at_sea.values()), axis=0)
    up, kind = separation_at(geoid, float(latitude), float(longitude)), "ellipsoid (by a geoid)"
    moved = [p if p.path not in at_sea else p.positioned(altitude=at_sea[p.path][2] + up, altitude_kind=kind)
             for p in photos]  # fmt: skip
    return moved, f"ellipsoid, by {geoid.name}: {up:+.2f} m from sea level", warnings
