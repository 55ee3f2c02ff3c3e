"""Reading of a run's folder, for `evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pydantic import BaseModel, Field, FiniteFloat

from alight.arrays import F32, U8, U16
from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_text, validated
from alight.geometry import Grid, LocalFrame
from alight.outputs.folder import RUN_JSON, is_run
from alight.raster import unreadable
from alight.records import InputError
from alight.settings import Settings, settings_of_run

AGAIN = "run again to write it anew"


@dataclass(frozen=True, eq=False)
class Run:
    """The folder of one run. A file that was not written is None; `info["not_written"]` holds the reason."""

    folder: Path
    info: dict[str, Any]  # run.json
    local: LocalFrame | None  # None: the run has no place on Earth
    grid: Grid | None
    height: F32 | None  # (R, C) metres above the WGS84 ellipsoid, NaN = not given out
    sigma: F32 | None  # (R, C) metres
    flags: U16 | None  # (R, C) bits of Flag
    terrain: U8 | None  # (R, C) Terrain codes
    safe: F32 | None  # (R, C) probability, NaN = not judged
    reasons: U16 | None  # (R, C) bits of Hazard
    ortho: U8 | None  # (R, C, 3) RGB

    @property
    def settings(self) -> Settings:
        """The settings of the run.

        Raises:
            KeyError: run.json holds none.
            ValueError: a value is not valid.
        """
        return settings_of_run(self.info["settings"])


# bands of a run's rasters, and the kind of their numbers: floating, unsigned
RASTERS = {
    "dem": (2, "f"),
    "flags": (1, "u"),
    "terrain": (1, "u"),
    "safe": (1, "f"),
    "reasons": (1, "u"),
    "ortho": (3, "u"),
}

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
    height_above_ground_m: FiniteFloat | None = None
    common_error: _CommonError | None = None
    settings: dict[str, Any] = {}


def read_bands(path: Path, least: int, kinds: str, mend: str) -> tuple[NDArray[Any], Grid]:
    """Read all bands (B, R, C) of a raster of Alight's own, and its grid.

    Args:
        least: smallest number of bands.
        kinds: of numbers that it may hold, as NumPy's letters.
        mend: remedy for a damaged raster, for the message.

    Raises:
        InputError: it is no plain file, cannot be read, has too few bands, other numbers, or cells that are not square
            with north up.
    """
    if not path.is_file():
        raise InputError(f"{path}: not a plain file; {mend}")
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


def _bands(folder: Path) -> tuple[dict[str, NDArray[Any]], Grid | None]:
    """The bands of every raster of a run by its name, and their one grid."""
    found: dict[str, NDArray[Any]] = {}
    grid: Grid | None = None
    for name, (least, kind) in RASTERS.items():
        path = folder / f"{name}.tif"
        if path.exists():
            found[name], its = read_bands(path, least, kind, AGAIN)
            if its != (grid := grid or its):
                raise InputError(f"{path}: not on the grid of the run's other rasters; {AGAIN}")
    return found, grid


def _local(info: dict[str, Any]) -> LocalFrame | None:
    origin = info.get("origin")
    try:
        return LocalFrame(*(float(origin[k]) for k in ("latitude", "longitude", "height"))) if origin else None
    except (KeyError, TypeError, ValueError) as e:
        raise InputError(f"{RUN_JSON}: its origin is damaged ({origin!r:.60}); {AGAIN}") from e


def read_run(folder: Path) -> Run:
    """Read the rasters and run.json of one run.

    Raises:
        InputError: the folder holds no finished run, or a raster of it cannot be read.
    """
    if not is_run(folder):
        raise InputError(f"{folder}: no finished run here (no run.json of Alight); name the folder given to --out")
    info = parse_json(read_text(folder / RUN_JSON, LARGEST_JSON))
    try:
        validated(_RunJson, info)
    except DocumentError as e:
        raise InputError(f"{RUN_JSON}: {e}; {AGAIN}") from e
    bands, grid = _bands(folder)

    def only(name: str, band: int = 0) -> Any:
        found = bands.get(name)
        return None if found is None else found[band]

    rgb = bands.get("ortho")
    return Run(
        folder=folder,
        info=info,
        local=_local(info),
        grid=grid,
        height=only("dem"),
        sigma=only("dem", 1),
        flags=only("flags"),
        terrain=only("terrain"),
        safe=only("safe"),
        reasons=only("reasons"),
        ortho=None if rgb is None else np.moveaxis(rgb[:3], 0, 2),
    )
