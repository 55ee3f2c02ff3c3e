"""Settings: the keys for users, the tuned constants of the stages, and the functions that read both."""

from alight.settings.loading import load_settings, settings_of_keys, settings_of_run
from alight.settings.tuning import Tuning
from alight.settings.user import Lander
from alight.settings.whole import (
    BundleSettings,
    ElevationSettings,
    ExecutiveSettings,
    FilterSettings,
    HazardsSettings,
    ImuNoise,
    MotionSettings,
    ParallaxSettings,
    RouteSettings,
    Settings,
    SitesSettings,
    StageSettings,
    TerrainSettings,
    TracksSettings,
)
