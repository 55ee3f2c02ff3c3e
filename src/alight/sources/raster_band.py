"""Bands of a raster: which band holds heights, and how its values convert to metres."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from rasterio.enums import ColorInterp

from alight.arrays import F64
from alight.records import InputError
from alight.sources.opened_raster import OpenedRaster

PREFIXES = {"": 1.0, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3}  # factors of the metre
HEIGHTS = re.compile(
    r"(?!.*(sigma|std|error|uncert|accura|rms|count|shade|slope|aspect|curv|rough|mask|\bsun))"
    r"(.*(height|elevation|altitude)|.*\b(dem|dsm|dtm|z)\b)", re.I
)  # fmt: skip
COLOURS = ("red", "green", "blue")
UNSEEN = re.compile(r"infra.?red|red.?edge|nir|swir|lwir|edge|thermal|temperature|ndvi", re.I)  # bands of no colour


@dataclass(frozen=True)
class Band:
    """A band of lengths: metres = (stored * scale + offset) * unit."""

    number: int  # from 1
    unit: float  # metres per unit
    scale: float
    offset: float
    is_depth: bool  # whether values count downwards
    settled: str  # unit, scale and band, in words

    def lengths(self, stored: F64) -> F64:
        """Convert stored values to metres; values that are not finite become NaN."""
        with np.errstate(over="ignore", invalid="ignore"):
            out = (stored * self.scale + self.offset) * self.unit
        return np.where(np.isfinite(out), out, np.nan)

    def heights(self, stored: F64) -> F64:
        """Convert stored values to metres upwards; depths are negated."""
        return -self.lengths(stored) if self.is_depth else self.lengths(stored)


def band_of_heights(raster: OpenedRaster) -> Band:
    """Find the first band whose name means heights, or else the first band, and determine its unit.

    Without a declared unit, metres are assumed; in a plane in feet, this is an error, since heights may be in either.

    Raises:
        InputError: see `band_in_metres`.
    """
    named = [n for n, name in enumerate(raster.dataset.descriptions, 1) if name and HEIGHTS.match(name)]
    return band_in_metres(raster, named[0] if named else 1, raster.reference.is_metric)


def band_in_metres(raster: OpenedRaster, number: int, assume_metres: bool) -> Band:
    """Determine unit, scale and offset of a band; the unit is its own, else the vertical axis's, else metres.

    Args:
        raster: open raster; if its vertical axis points down, the values are depths.
        number: band number, from 1.
        assume_metres: whether metres are assumed if no unit is declared; otherwise this is an error.

    Raises:
        InputError: the band has complex numbers, a scale or offset that gives no heights, or a unit that is unknown,
            missing or contradicts the vertical axis. The message has the command that fixes the raster.
    """
    dataset, at, axis = raster.dataset, number - 1, raster.reference.up
    if "complex" in dataset.dtypes[at]:
        raise InputError(f"{raster.label}: holds complex numbers; give heights in metres as float32")
    scale, offset = dataset.scales[at], dataset.offsets[at]
    if not (np.isfinite([scale, offset]).all() and scale):
        raise InputError(
            f"{raster.label}: scale {scale:g} and offset {offset:g} of band {number} give no heights; mend it with: "
            f"gdal_edit.py -scale 1 -offset 0 {raster.file}"
        )
    word = (dataset.units[at] or "").strip()
    word = "" if word.lower() in ("unspecified", "unknown") else word  # as drivers write for no unit
    unit = _unit(raster, number, word, assume_metres)
    words = word or ("m" if unit == 1.0 else f"units of {unit:g} m")
    words += "" if word or axis is not None else " (assumed)"
    words += f", x {scale:g} {offset:+g}" if (scale, offset) != (1.0, 0.0) else ""
    words += f", band {number} of {dataset.count}" if dataset.count > 1 else ""
    is_depth = axis is not None and axis < 0
    return Band(number, unit, scale, offset, is_depth, words + (", depths" if is_depth else ""))


def _unit(raster: OpenedRaster, number: int, word: str, assume_metres: bool) -> float:
    axis, datum = raster.reference.up, raster.reference.datum
    unit = metres_of(word) if word else abs(axis) if axis is not None else 1.0 if assume_metres else None
    if unit is None:
        why = f"the unit {word!r} of band {number} is not known" if word else f"band {number} declares no unit"
        why += "" if word else ", and another unit is not the metre"
        raise InputError(
            f"{raster.label}: {why}; mend it with: gdal_edit.py -units <m, ft, US survey foot, km, dm, cm or mm> "
            f"{raster.file}"
        )
    if axis is not None and abs(unit / abs(axis) - 1.0) > 1e-5:  # kinds of feet differ by less
        raise InputError(
            f"{raster.label}: band {number} is in {word}, but heights of its coordinate system ({datum}) are "
            f"in units of {abs(axis):g} m; mend what is wrong: gdal_edit.py -units <unit> {raster.file}, or "
            f"gdal_edit.py -a_srs EPSG:<plane>+<heights> {raster.file}"
        )
    return unit


def metres_of(unit: str) -> float | None:
    """Return metres per unit, for names that drivers and programs use (m, ft, ftUS, US survey foot); None: unknown.

    PROJ's table of units is not used, because its decimetre is 0.01 m in many versions.
    """
    letters = re.sub(r"[\s_().-]", "", unit.lower())
    if found := re.fullmatch("(kilo|deci|centi|milli|[kdcm]?)(m|met(?:re|er)s?)", letters):
        return PREFIXES[found[1][:1]]
    if re.fullmatch("(i|int|international)?(ft|foot|feet)(int|international)?", letters):
        return 0.3048
    return 1200 / 3937 if re.fullmatch("(us|survey|s)*(ft|foot|feet)(us|survey)*", letters) else None


def bands_of_picture(raster: OpenedRaster) -> list[int]:
    """Return the numbers of the bands of red, green and blue, or of one band to be read as grey.

    The names of the bands go before their colour interpretation, which drivers give to any first three bands. Three
    bands without either are red, green and blue. Of other bands, green or red, else the first one, is read as grey.
    """
    names = [name or "" for name in raster.dataset.descriptions]
    kinds = [kind.name for kind in raster.dataset.colorinterp]
    named = dict[str, int]()
    for number, name in enumerate(names, 1):
        for colour in COLOURS:
            if re.search(rf"(?<![a-z]){colour}(?![a-z])", UNSEEN.sub("", name), re.I):
                named.setdefault(colour, number)
    seen = [n for n, kind in enumerate(kinds, 1) if kind != ColorInterp.alpha.name]
    if not named and not any(map(UNSEEN.search, names)):
        if all(c in kinds for c in COLOURS):
            return [kinds.index(c) + 1 for c in COLOURS]
        if len(seen) == len(COLOURS):
            return seen
    if len(named) == len(COLOURS):
        return [named[c] for c in COLOURS]
    return [named.get("green") or named.get("red") or seen[0]]
