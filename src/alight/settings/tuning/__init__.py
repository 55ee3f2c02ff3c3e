"""Tuning: constants that were fitted or chosen on data, one frozen model per stage.

They are hidden from users, stored in `run.json`, and can be set as `tuning.<stage>.<name>`.
"""

from __future__ import annotations

from alight.settings.base import FrozenModel
from alight.settings.tuning.executive import ExecutiveTuning
from alight.settings.tuning.filter import BundleTuning, FilterTuning
from alight.settings.tuning.hazards import HazardsTuning
from alight.settings.tuning.mapping import ElevationTuning, MappingTuning
from alight.settings.tuning.parallax import ParallaxTuning
from alight.settings.tuning.sites import RouteTuning, SitesTuning
from alight.settings.tuning.terrain import TerrainTuning
from alight.settings.tuning.tracks import TracksTuning


class Tuning(FrozenModel):
    """Tuned constants by stage; not meant to be changed."""

    tracks: TracksTuning = TracksTuning()
    filter: FilterTuning = FilterTuning()
    bundle: BundleTuning = BundleTuning()
    parallax: ParallaxTuning = ParallaxTuning()
    mapping: MappingTuning = MappingTuning()
    elevation: ElevationTuning = ElevationTuning()
    terrain: TerrainTuning = TerrainTuning()
    hazards: HazardsTuning = HazardsTuning()
    sites: SitesTuning = SitesTuning()
    route: RouteTuning = RouteTuning()
    executive: ExecutiveTuning = ExecutiveTuning()
