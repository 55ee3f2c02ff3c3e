"""The result of a run, for Python: sites, maps with their grid, motions; one call writes the folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from alight.outputs import write_run
from alight.records import ElevationMap, HazardMap, Motion, Route, RunResult, Site, TerrainMap
from alight.settings import Settings


@dataclass(frozen=True, eq=False)
class Result:
    """Result of one run: landing sites, and the maps and motions that they follow from.

    Maps carry their `grid`: cell (row 0, column 0) is the northernmost and westernmost, `grid.xy()` gives the metres
    east and north of the columns and rows. Heights are metres above the origin of the recording; NaN is unknown.
    """

    record: RunResult
    writer: Callable[[RunResult, Path, bool], list[Path]] = write_run  # of the folder

    @property
    def sites(self) -> tuple[Site, ...]:
        """Landing sites, best first; empty if there is none (see `reason`)."""
        return self.record.sites.sites

    @property
    def candidates(self) -> tuple[Site, ...]:
        """Places that nothing refuses, P(safe) below the limit: `doubt` is the cause, `look` the view to settle it."""
        return self.record.sites.candidates

    @property
    def best(self) -> Site | None:
        """The best site; None if there is none."""
        return self.sites[0] if self.sites else None

    @property
    def reason(self) -> str:
        """Reason why there is no site; empty if there is one."""
        return self.record.sites.reason

    @property
    def elevation(self) -> ElevationMap | None:
        """Heights with sigma and flags, (R, C) arrays on `elevation.grid`."""
        return self.record.elevation

    @property
    def land_cover(self) -> TerrainMap | None:
        """Class codes and the probability that this kind of ground may be landed on."""
        return self.record.terrain

    @property
    def hazards(self) -> HazardMap | None:
        """Slope, roughness, clearance, P(safe) and reasons of a touchdown centred on each cell of `hazards.grid`.

        Its cells may be larger than those of the heights; `hazards.on(elevation.grid)` gives it on theirs.
        """
        return self.record.hazards

    @property
    def route(self) -> Route | None:
        """Way-points to the best site."""
        return self.record.route

    @property
    def motions(self) -> Sequence[Motion]:
        """Estimated motion of every exposure that could be placed."""
        return self.record.motions

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings of the report, one sentence each."""
        from alight.report import warnings

        return warnings(self.record)

    @property
    def counts(self) -> Mapping[str, int]:
        """Frames and rows read, left out and why."""
        return self.record.counts

    @property
    def settings(self) -> Settings:
        """All settings of the run."""
        return self.record.settings

    def latitude_longitude(self, site: Site) -> tuple[float, float] | None:
        """Return degrees on WGS84; None if the recording has no place on Earth."""
        if not self.record.georeferenced:
            return None
        latitude, longitude, _ = self.record.local.to_geodetic([site.east, site.north, site.up])
        return float(latitude), float(longitude)

    def ellipsoid_height(self, site: Site) -> float | None:
        """Return metres above the WGS84 ellipsoid; None if the recording has no place on Earth."""
        if not self.record.georeferenced:
            return None
        return float(self.record.local.to_geodetic([site.east, site.north, site.up])[2])

    def save(self, out: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the folder of results (docs/formats/outputs.md) and return the files written.

        Raises:
            OutputError: the folder holds other files (and not `overwrite`), or cannot be written.
        """
        return self.writer(self.record, Path(out), overwrite)
