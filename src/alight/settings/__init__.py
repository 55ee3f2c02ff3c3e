"""Settings: the keys of a user, the tuned constants of the stages, and the reading of both."""

from alight.settings.imu import ImuNoise
from alight.settings.loading import load_settings, settings_of_keys, settings_of_run
from alight.settings.stages import (
    BundleSettings,
    ElevationSettings,
    ExecutiveSettings,
    FilterSettings,
    HazardsSettings,
    MotionSettings,
    ParallaxSettings,
    RouteSettings,
    SitesSettings,
    StageSettings,
    TerrainSettings,
    TracksSettings,
)
from alight.settings.tuning import Tuning
from alight.settings.user import Lander
from alight.settings.whole import Settings

__all__ = [
    "BundleSettings", "ElevationSettings", "ExecutiveSettings", "FilterSettings", "HazardsSettings", "ImuNoise",
    "Lander", "MotionSettings",
    "ParallaxSettings", "RouteSettings", "Settings", "SitesSettings", "StageSettings", "TerrainSettings",
    "TracksSettings", "Tuning", "load_settings", "settings_of_keys", "settings_of_run",
]  # fmt: skip
