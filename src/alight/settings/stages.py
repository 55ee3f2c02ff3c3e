"""Settings of each stage: the keys of a user and the tuned constants in one record."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from alight.settings.base import Positive
from alight.settings.tuning import (
    BundleTuning,
    ElevationTuning,
    ExecutiveTuning,
    FilterTuning,
    HazardsTuning,
    MappingTuning,
    ParallaxTuning,
    RouteTuning,
    SitesTuning,
    TerrainTuning,
    TracksTuning,
)
from alight.settings.user import (
    BundleKeys,
    ElevationKeys,
    ExecutiveKeys,
    FilterKeys,
    HazardsKeys,
    Lander,
    MotionKeys,
    ParallaxKeys,
    RouteKeys,
    SitesKeys,
    TerrainKeys,
)


class TracksSettings(TracksTuning):
    """Feature tracks."""


class FilterSettings(FilterTuning, FilterKeys):
    """The filter and its smoother, with the noise of the IMU."""

    gyro_noise: Positive = Field(5e-4, description="rad/s per sqrt(Hz)")
    gyro_walk: Positive = Field(3e-5, description="rad/s^2 per sqrt(Hz)")
    accelerometer_noise: Positive = Field(3e-3, description="m/s^2 per sqrt(Hz)")
    accelerometer_walk: Positive = Field(3e-4, description="m/s^3 per sqrt(Hz)")


class BundleSettings(BundleTuning, BundleKeys):
    """Bundle adjustment."""


class MotionSettings(MotionKeys):
    """Estimation of the poses."""

    filter: FilterSettings = FilterSettings()
    bundle: BundleSettings = BundleSettings()


class ParallaxSettings(ParallaxTuning, ParallaxKeys):
    """Planar parallax."""


class ElevationSettings(ElevationTuning, ElevationKeys):
    """The elevation map."""


class TerrainSettings(TerrainTuning, TerrainKeys):
    """Land cover."""


class HazardsSettings(HazardsTuning, HazardsKeys):
    """The hazard judgement."""


class SitesSettings(SitesTuning, SitesKeys):
    """The choice of sites."""


class RouteSettings(RouteTuning, RouteKeys):
    """The route."""


class ExecutiveSettings(ExecutiveTuning, ExecutiveKeys):
    """The executive."""


@dataclass(frozen=True)
class StageSettings:
    """The settings of every stage. `Settings.stages` makes it."""

    tracks: TracksSettings
    motion: MotionSettings
    parallax: ParallaxSettings
    mapping: MappingTuning
    elevation: ElevationSettings
    terrain: TerrainSettings
    lander: Lander
    hazards: HazardsSettings
    sites: SitesSettings
    route: RouteSettings
    executive: ExecutiveSettings
