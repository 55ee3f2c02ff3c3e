"""All settings: the keys of a user, and the tuned constants."""

from __future__ import annotations

from typing import Any, TypeVar, cast

import yaml
from pydantic import Field

from alight.settings.base import FrozenModel
from alight.settings.imu import ImuNoise
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
from alight.settings.tuning import FilterTuning, Tuning
from alight.settings.user import (
    ElevationKeys,
    ExecutiveKeys,
    FilterKeys,
    HazardsKeys,
    Lander,
    MotionKeys,
    ParallaxKeys,
    RouteKeys,
    SitesKeys,
    SourcesKeys,
    TerrainKeys,
)

Stage = TypeVar("Stage", bound=FrozenModel)


class Settings(FrozenModel):
    """The keys of a user, by group, and under `tuning` the tuned constants by stage."""

    sources: SourcesKeys = SourcesKeys()
    motion: MotionKeys = MotionKeys()
    parallax: ParallaxKeys = ParallaxKeys()
    elevation: ElevationKeys = ElevationKeys()
    terrain: TerrainKeys = TerrainKeys()
    lander: Lander = Lander()
    hazards: HazardsKeys = HazardsKeys()
    sites: SitesKeys = SitesKeys()
    route: RouteKeys = RouteKeys()
    executive: ExecutiveKeys = ExecutiveKeys()
    tuning: Tuning = Field(Tuning(), description="Tuned constants by stage; not meant to be changed")

    @property
    def too_low(self) -> str:
        """Reason why no landing may be flown with these settings; empty: none. Recordings of such flights are read."""
        given, k = self.executive.commit_height, self.tuning.executive
        least = k.abort_height + k.unchecked
        if given >= least:
            return ""
        return (
            f"executive.commit_height: from {given:g} m a landing cannot be broken off in time; give {least:g} or more"
        )

    def stages(self, imu: ImuNoise | None = None) -> StageSettings:
        """Return the settings of every stage.

        Args:
            imu: noise that the recording states for its IMU; constants that are set here win over it.
        """
        t = self.tuning
        motion = dict(self.motion) | {
            "filter": _filter_settings(self.motion.filter, t.filter, imu or ImuNoise()),
            "bundle": _joined(BundleSettings, self.motion.bundle, t.bundle),
        }
        return StageSettings(
            tracks=_joined(TracksSettings, t.tracks),
            motion=MotionSettings.model_construct(**motion),
            parallax=_joined(ParallaxSettings, self.parallax, t.parallax),
            mapping=t.mapping,
            elevation=_joined(ElevationSettings, self.elevation, t.elevation),
            terrain=_joined(TerrainSettings, self.terrain, t.terrain),
            lander=self.lander,
            hazards=_joined(HazardsSettings, self.hazards, t.hazards),
            sites=_joined(SitesSettings, self.sites, t.sites),
            route=_joined(RouteSettings, self.route, t.route),
            executive=_joined(ExecutiveSettings, self.executive, t.executive),
        )

    def to_yaml(self, tuning: bool = False) -> str:
        """YAML text that `load_settings` takes back: all keys of a user, and the tuned constants that were changed.

        Args:
            tuning: with all tuned constants.
        """
        tree: dict[str, Any] = self.model_dump(mode="json")
        if not tuning:
            tree.pop("tuning")
            changed = self.model_dump(mode="json", include={"tuning"}, exclude_defaults=True)
            tree |= changed if changed.get("tuning") else {}
        return yaml.safe_dump(tree, sort_keys=False)


def _filter_settings(keys: FilterKeys, tuning: FilterTuning, imu: ImuNoise) -> FilterSettings:
    set_here = {k: v for k, v in tuning if v is not None}
    return FilterSettings.model_construct(**(dict(keys) | imu.in_flight(tuning.imu_margin) | set_here))


def _joined(kind: type[Stage], *parts: FrozenModel) -> Stage:
    """Join parts that are valid already into one record."""
    return cast(Stage, kind.model_construct(**{key: value for part in parts for key, value in part}))
