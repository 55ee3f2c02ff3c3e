"""Reading the folder of a run, for `evaluate`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import rasterio
from numpy.typing import NDArray
from pydantic import BaseModel, Field, FiniteFloat

from alight.arrays import F32, U8, U16
from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_text, validated
from alight.geometry import Grid, LocalFrame
from alight.outputs.evidence import EVIDENCE, decode_evidence
from alight.outputs.folder import RUN_JSON, is_run
from alight.raster import unreadable
from alight.records import InputError, RunResult
from alight.settings import Settings, settings_of_run

AGAIN = "run again to write it anew"


@dataclass(frozen=True, eq=False)
class Run:
    """The files of one run. The field of a missing file is None; `info["not_written"]` holds the reason."""

    folder: Path
    info: dict[str, Any]  # content of run.json
    local: LocalFrame | None  # None: the run has no place on Earth
    grid: Grid | None = None
    height: F32 | None = None  # (R, C) metres above the WGS84 ellipsoid, NaN = unknown or refused
    sigma: F32 | None = None  # (R, C) metres
    flags: U16 | None = None  # (R, C) bits of Flag
    terrain: U8 | None = None  # (R, C) Terrain codes
    safe: F32 | None = None  # (R, C) probability, NaN = not judged
    reasons: U16 | None = None  # (R, C) bits of Hazard
    ortho: U8 | None = None  # (R, C, 3) RGB

    @property
    def settings(self) -> Settings:
        """All settings of the run, from run.json.

        Raises:
            InputError: run.json holds no settings, or a value that is not valid.
        """
        try:
            return settings_of_run(self.info["settings"])
        except (KeyError, ValueError) as e:
            raise InputError(f"{self.folder / RUN_JSON}: of another version of Alight; run again") from e


# rasters of a run: NumPy kind (float, unsigned), and their bands: fields of `Run`, or colours of its `ortho`
RASTERS = {
    "dem": ("f", ("height", "sigma")), "flags": ("u", ("flags",)), "terrain": ("u", ("terrain",)),
    "safe": ("f", ("safe",)), "reasons": ("u", ("reasons",)), "ortho": ("u", ("red", "green", "blue")),
}  # fmt: skip

_Metres = Annotated[float, Field(ge=-1e6, le=1e6)]  # from the origin: a local frame ends long before


class _Place(BaseModel):
    east_m: _Metres
    north_m: _Metres


class _Answer(BaseModel):
    sites: list[_Place]
    candidates: list[_Place]


_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class _CommonError(BaseModel):
    centre_m: tuple[FiniteFloat, FiniteFloat]
    covariance: tuple[_Row, _Row, _Row]


class _RunJson(BaseModel):
    """The keys of run.json that are read."""

    answer: _Answer
    origin: LocalFrame | None = None
    height_above_ground_m: FiniteFloat | None = None
    common_error: _CommonError | None = None
    settings: dict[str, Any] = {}


class EarlierSite(NamedTuple):
    """A site or candidate of an earlier run: its name, and its position in degrees."""

    name: str
    latitude: float
    longitude: float


class _Point(BaseModel):
    type: Literal["Point"]
    coordinates: tuple[
        Annotated[FiniteFloat, Field(ge=-180, le=180)], Annotated[FiniteFloat, Field(ge=-90, le=90)], Any
    ]


class _SiteProperties(BaseModel):
    kind: Literal["site", "candidate"]
    rank: int


class _SiteFeature(BaseModel):
    geometry: _Point
    properties: _SiteProperties


class _SitesJson(BaseModel):
    """The keys of sites.geojson that are read."""

    features: list[_SiteFeature]


def read_sites(folder: Path) -> tuple[EarlierSite, ...]:
    """Read the sites and candidates of a run, in order of rank.

    Raises:
        InputError: the folder has no sites.geojson of a finished run, or none is listed there.
    """
    path = folder / "sites.geojson"
    if not path.is_file():
        raise InputError(f"{path}: missing; name the folder of a run whose place on Earth is known")
    try:
        tree = parse_json(read_text(path, LARGEST_JSON))
        listed = sorted(validated(_SitesJson, tree).features, key=lambda f: f.properties.rank)
    except DocumentError as e:
        raise InputError(f"{path}: {e}; {AGAIN}") from e
    if not listed:
        raise InputError(f"{path}: that run found no site and no candidate; leave out --sites")
    places = ((f.properties, f.geometry.coordinates) for f in listed)
    return tuple(EarlierSite(f"{p.kind} {p.rank} of {folder}", at[1], at[0]) for p, at in places)


def read_bands(path: Path, least: int, kinds: str, mend: str) -> tuple[NDArray[Any], Grid]:
    """Read all bands of a raster written by Alight, (B, R, C), and its grid.

    Args:
        least: smallest number of bands.
        kinds: NumPy kind letters that are allowed for its numbers.
        mend: remedy for a damaged raster, added to the message.

    Raises:
        InputError: the file is not a plain file, cannot be read, is too large, or has too few bands, numbers of another
            kind, or cells that are not square with north up.
    """
    if not path.is_file():
        raise InputError(f"{path}: missing, or not a plain file; {mend}")
    try:
        with rasterio.open(path) as d:
            t = d.transform
            square = t.b == t.d == 0 and 1e-4 <= t.a <= 1e4 and abs(t.a + t.e) <= 1e-6 * t.a
            kind = np.dtype(d.dtypes[0]).kind
            plain = {*d.scales} == {1.0} and {*d.offsets} == {0.0} and {*d.units} <= {None, "", "m", "rad"}
            large = d.count * d.height * d.width > 500_000_000
            if d.count < least or large or kind not in kinds or not (square and plain):
                raise InputError(
                    f"{path}: {d.count} band(s) of {d.width} x {d.height} cells of {t.a:g} x {-t.e:g} m as "
                    f"{d.dtypes[0]}; it needs {least} of square cells with north up, in metres, of its own type; {mend}"
                )
            return d.read(), Grid(t.c + t.a / 2, t.f + t.e / 2, t.a, d.height, d.width)
    except unreadable() as e:
        raise InputError(f"{path}: not a readable raster; {mend}") from e


def _maps(folder: Path, names: Collection[str]) -> dict[str, Any]:
    """Read the named rasters of a run: the fields of `Run` that they fill, and the grid that they share."""
    found: dict[str, Any] = {}
    for name, (kind, fields) in ((k, v) for k, v in RASTERS.items() if k in names):
        path = folder / f"{name}.tif"
        if path.exists():
            bands, grid = read_bands(path, len(fields), kind, AGAIN)
            if grid != found.setdefault("grid", grid):
                raise InputError(f"{path}: not on the grid of the run's other rasters; {AGAIN}")
            read = dict(zip(fields, bands, strict=False))
            found |= {name: np.stack(list(read.values()), axis=-1)} if name == "ortho" else read
    return found


def read_run(folder: Path, rasters: Collection[str] = RASTERS.keys()) -> Run:
    """Read the named rasters and run.json of one run.

    Raises:
        InputError: the folder holds no finished run, or one of its rasters cannot be read.
    """
    if not is_run(folder):
        raise InputError(f"{folder}: no finished run here (no run.json of Alight); name the folder given to --out")
    info = parse_json(read_text(folder / RUN_JSON, LARGEST_JSON))
    try:
        local = validated(_RunJson, info).origin
    except DocumentError as e:
        raise InputError(f"{RUN_JSON}: {e}; {AGAIN}") from e
    return Run(folder, info, local, **_maps(folder, rasters))


def read_evidence(folder: Path) -> RunResult:
    """Read the result of a run without its answer (sites, rasters, route), to judge it again.

    Of a folder that `alight judge` wrote, it is that of the run, with the settings of the judgement.

    Raises:
        InputError: the folder holds no finished run, or its evidence is missing, damaged, or of another version.
    """
    path, run = folder / EVIDENCE, read_run(folder, ())
    if not path.is_file():
        raise InputError(f"{path}: missing; name the folder of a run that has judged a map, or {AGAIN}")
    try:
        return replace(decode_evidence(path.read_bytes()), settings=run.settings)
    except (OSError, ValueError) as e:
        raise InputError(f"{path}: damaged, or of another version of Alight; {AGAIN}") from e
