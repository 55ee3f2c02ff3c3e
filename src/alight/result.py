"""The result of a run, for Python: sites, maps with their grid, and motions; `save` writes the folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alight.outputs import write_run
from alight.outputs.reading import read_evidence
from alight.records import ElevationMap, HazardMap, Motion, Route, RunResult, Site, TerrainMap
from alight.settings import Lander, Settings
from alight.settings.units import with_degrees

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Result:
    """Result of one run: landing sites, and the maps and motions from which they were computed.

    Each map has a `grid`: cell (row 0, column 0) is the north-west corner, and `grid.xy()` returns the east and north
    coordinates of the columns and rows, metres. Heights are metres above the recording's origin; NaN is unknown.
    """

    record: RunResult
    writer: Callable[[RunResult, Path, bool], list[Path]] = write_run  # writes the folder

    @property
    def sites(self) -> tuple[Site, ...]:
        """Landing sites, best first; empty if there are none (see `reason`)."""
        return self.record.sites.sites

    @property
    def candidates(self) -> tuple[Site, ...]:
        """Places that no limit refuses, but with a low P(safe); `doubt` is the cause, `look` the view to settle it."""
        return self.record.sites.candidates

    @property
    def best(self) -> Site | None:
        """The best site; None if there is none."""
        return self.sites[0] if self.sites else None

    @property
    def reason(self) -> str:
        """Reason why there is no site; empty if there are sites."""
        return self.record.sites.reason

    @property
    def elevation(self) -> ElevationMap | None:
        """Heights with sigma and flags, (R, C) arrays on `elevation.grid`; None: no heights were found."""
        return self.record.elevation

    @property
    def land_cover(self) -> TerrainMap | None:
        """Class of each cell, and the probability that ground of its class is landable; None: not judged."""
        return self.record.terrain

    @property
    def hazards(self) -> HazardMap | None:
        """Slope, roughness, clearance, P(safe) and reasons of a touchdown centred on each cell of `hazards.grid`.

        The cells may be larger than those of the heights: `hazards.on(elevation.grid)` resamples. None: not judged.
        """
        return self.record.hazards

    @property
    def route(self) -> Route | None:
        """Way-points to the best site; None: no route was planned."""
        return self.record.route

    @property
    def motions(self) -> Sequence[Motion]:
        """Estimated motion at every exposure with a known pose."""
        return self.record.motions

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings of the report, one sentence each."""
        from alight.report import warnings

        return warnings(self.record)

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of frames and rows that were read, and that were left out by reason."""
        return self.record.counts

    @property
    def settings(self) -> Settings:
        """All settings of the run."""
        return self.record.settings

    def latitude_longitude(self, site: Site) -> tuple[float, float] | None:
        """Return latitude and longitude of a site, degrees, WGS84; None if the recording is not georeferenced."""
        if not self.record.georeferenced:
            return None
        latitude, longitude, _ = self.record.local.to_geodetic([site.east, site.north, site.up])
        return float(latitude), float(longitude)

    def ellipsoid_height(self, site: Site) -> float | None:
        """Return a site's height above the WGS84 ellipsoid, metres; None if the recording is not georeferenced."""
        if not self.record.georeferenced:
            return None
        return float(self.record.local.to_geodetic([site.east, site.north, site.up])[2])

    def judge(self, lander: Lander | None = None, settings: Mapping[str, Any] | None = None) -> Result:
        """Judge the ground of this run for another lander or other limits: seconds, without motion and mapping.

        Args:
            lander: replaces the lander of the run; None: it is kept.
            settings: other keys of the judgement, such as `{"hazards.p_safe": 0.9}`; the groups are `lander`,
                `hazards`, `sites` and `route`.

        Raises:
            InputError: the run has no map.
            SettingsError: a value is not valid, or the judgement does not use a key.
        """
        from alight.pipeline.again import judge_again, settings_to_judge

        given = {} if lander is None else {"lander": with_degrees(lander.model_dump(mode="json"), Lander)}
        chosen = settings_to_judge(self.settings, {**given, **(settings or {})})
        return Result(judge_again(self.record, chosen, time.perf_counter))

    def to_xarray(self) -> xarray.Dataset:
        """Return the rasters as an xarray dataset: variables such as `height` and `p_safe` over `north` and `east`.

        Heights are metres above the recording's origin, NaN where unknown; the cells are those of the heights.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        from alight.notebook import dataset

        return dataset(self.record)

    def _repr_html_(self) -> str:
        """Return the map and the table of sites and candidates, for notebooks."""
        from alight.notebook import result_html

        return result_html(self.record)

    def save(self, out: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the folder of results (docs/formats/outputs.md) and return the paths of the files written.

        Raises:
            OutputError: the folder holds other files and `overwrite` is false, or it cannot be written.
        """
        return self.writer(self.record, Path(out), overwrite)


def read_result(folder: str | Path) -> Result:
    """Read the result of an earlier run from its folder; its maps and sites are computed again, which takes seconds.

    Raises:
        InputError: the folder holds no finished run that has judged a map, or `evidence.npz` is damaged.
    """
    kept = read_evidence(Path(folder))
    return Result(kept).judge()
