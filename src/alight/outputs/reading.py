"""A run read back: what `evaluate` compares with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from alight.arrays import F32, U8, U16
from alight.documents import LARGEST_JSON, parse_json, read_text
from alight.geometry import Grid, LocalFrame
from alight.outputs.folder import RUN_JSON, is_run
from alight.records import InputError
from alight.settings import Settings, settings_of_run


@dataclass(frozen=True, eq=False)
class Run:
    """The folder of one run. What was not written is None; `info["not_written"]` says why."""

    folder: Path
    info: dict[str, Any]  # run.json
    local: LocalFrame | None  # None: the run has no place on Earth
    grid: Grid | None
    height: F32 | None  # (R, C) metres above the WGS84 ellipsoid, NaN = not given out
    sigma: F32 | None  # (R, C) metres
    flags: U16 | None  # (R, C) bits of Flag
    terrain: U8 | None  # (R, C) Terrain codes
    safe: F32 | None  # (R, C) probability, NaN = not judged
    reasons: U16 | None  # (R, C) bits of Hazard; None also for runs of version 0.1.0
    ortho: U8 | None  # (R, C, 3) RGB

    @property
    def settings(self) -> Settings:
        """The settings of the run, also of an earlier version of Alight.

        Raises:
            KeyError: run.json holds none.
            ValueError: a value is not valid.
        """
        return settings_of_run(self.info["settings"])


def _bands(path: Path) -> tuple[NDArray[Any], Grid] | None:
    if not path.exists():
        return None
    try:
        with rasterio.open(path) as d:
            t = d.transform
            return d.read(), Grid(t.c + t.a / 2, t.f + t.e / 2, t.a, d.height, d.width)
    except RasterioError as e:
        raise InputError(f"{path}: not a readable raster; run again to write it anew") from e


def _local(info: dict[str, Any]) -> LocalFrame | None:
    origin = info.get("origin")
    try:
        return LocalFrame(*(float(origin[k]) for k in ("latitude", "longitude", "height"))) if origin else None
    except (KeyError, TypeError, ValueError) as e:
        raise InputError(f"{RUN_JSON}: its origin is damaged ({origin!r:.60}); run again to write it anew") from e


def read_run(folder: Path) -> Run:
    """Read the rasters and run.json of one run.

    Raises:
        InputError: the folder holds no finished run, or a raster of it cannot be read.
    """
    if not is_run(folder):
        raise InputError(f"{folder}: no finished run here (no run.json of Alight); name the folder given to --out")
    info = parse_json(read_text(folder / RUN_JSON, LARGEST_JSON))
    rasters = {name: _bands(folder / f"{name}.tif") for name in ("dem", "flags", "terrain", "safe", "reasons", "ortho")}
    grid = next((r[1] for r in rasters.values() if r), None)
    bands = {name: None if r is None else r[0] for name, r in rasters.items()}

    def only(name: str, band: int = 0) -> Any:
        found = bands[name]
        return None if found is None else found[band]

    rgb = bands["ortho"]
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
        ortho=None if rgb is None else np.moveaxis(rgb, 0, 2),
    )
