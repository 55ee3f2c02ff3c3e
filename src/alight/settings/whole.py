"""All settings: the keys for users with the tuned constants, and both merged into one record per stage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, get_type_hints

import yaml
from pydantic import BaseModel, Field

from alight.settings import tuning as tuned
from alight.settings import user
from alight.settings.base import FrozenModel, Positive
from alight.settings.units import unit_of, with_degrees


@dataclass(frozen=True)
class ImuNoise:
    """Noise that a recording states for its IMU at rest (fields as in imu0/sensor.yaml); None: not stated."""

    gyroscope_noise_density: float | None = None  # rad/s per sqrt(Hz)
    gyroscope_random_walk: float | None = None  # rad/s^2 per sqrt(Hz)
    accelerometer_noise_density: float | None = None  # m/s^2 per sqrt(Hz)
    accelerometer_random_walk: float | None = None  # m/s^3 per sqrt(Hz)

    def stated(self) -> dict[str, float]:
        """Return the stated values, by the name of the field."""
        return {k: v for k, v in asdict(self).items() if v is not None}

    def in_flight(self, margin: float) -> dict[str, float]:
        """Return the noise in flight by key of the filter: `margin` times each stated value that is above zero."""
        stated = {
            "gyro_noise": self.gyroscope_noise_density,
            "gyro_walk": self.gyroscope_random_walk,
            "accelerometer_noise": self.accelerometer_noise_density,
            "accelerometer_walk": self.accelerometer_random_walk,
        }
        return {key: margin * value for key, value in stated.items() if value is not None and value > 0.0}


class TracksSettings(tuned.TracksTuning):
    """Settings of the feature tracks."""


class FilterSettings(tuned.FilterTuning, user.FilterKeys):
    """Settings of the filter and its smoother, with the noise of the IMU."""

    gyro_noise: Positive = Field(5e-4, description="rad/s per sqrt(Hz)")
    gyro_walk: Positive = Field(3e-5, description="rad/s^2 per sqrt(Hz)")
    accelerometer_noise: Positive = Field(3e-3, description="m/s^2 per sqrt(Hz)")
    accelerometer_walk: Positive = Field(3e-4, description="m/s^3 per sqrt(Hz)")


class BundleSettings(tuned.BundleTuning, user.BundleKeys):
    """Settings of the bundle adjustment."""


class MotionSettings(user.MotionKeys):
    """Settings for the estimation of the poses."""

    filter: FilterSettings = FilterSettings()
    bundle: BundleSettings = BundleSettings()


class ParallaxSettings(tuned.ParallaxTuning, user.ParallaxKeys):
    """Settings of planar parallax."""


class ElevationSettings(tuned.ElevationTuning, user.ElevationKeys):
    """Settings of the elevation map."""


class TerrainSettings(tuned.TerrainTuning, user.TerrainKeys):
    """Settings of the land cover."""


class HazardsSettings(tuned.HazardsTuning, user.HazardsKeys):
    """Settings of the hazard judgement."""


class SitesSettings(tuned.SitesTuning, user.SitesKeys):
    """Settings for the choice of sites."""


class RouteSettings(tuned.RouteTuning, user.RouteKeys):
    """Settings of the route."""


class ExecutiveSettings(tuned.ExecutiveTuning, user.ExecutiveKeys):
    """Settings of the executive."""


@dataclass(frozen=True)
class StageSettings:
    """The settings of every stage, made by `Settings.stages`."""

    tracks: TracksSettings
    motion: MotionSettings
    parallax: ParallaxSettings
    mapping: tuned.MappingTuning
    elevation: ElevationSettings
    terrain: TerrainSettings
    lander: user.Lander
    hazards: HazardsSettings
    sites: SitesSettings
    route: RouteSettings
    executive: ExecutiveSettings


class Settings(FrozenModel):
    """The keys for users by group, and the tuned constants by stage under `tuning`."""

    sources: user.SourcesKeys = user.SourcesKeys()
    motion: user.MotionKeys = user.MotionKeys()
    parallax: user.ParallaxKeys = user.ParallaxKeys()
    elevation: user.ElevationKeys = user.ElevationKeys()
    terrain: user.TerrainKeys = user.TerrainKeys()
    lander: user.Lander = user.Lander()
    hazards: user.HazardsKeys = user.HazardsKeys()
    sites: user.SitesKeys = user.SitesKeys()
    route: user.RouteKeys = user.RouteKeys()
    executive: user.ExecutiveKeys = user.ExecutiveKeys()
    tuning: tuned.Tuning = Field(tuned.Tuning(), description="Tuned constants by stage; not meant to be changed")

    @property
    def too_low(self) -> str:
        """Reason why no landing may be flown with these settings; empty: landings may be flown."""
        given, k = self.executive.commit_height, self.tuning.executive
        least = k.abort_height + k.unchecked
        if given >= least:
            return ""
        return (
            f"executive.commit_height: from {given:g} m a landing cannot be broken off in time; give {least:g} or more"
        )

    def stages(self, imu: ImuNoise | None = None) -> StageSettings:
        """Return the settings of every stage, each merged from its keys for users and its tuned constants.

        Args:
            imu: noise that the recording states for its IMU.
        """
        t, motion, stages = self.tuning, self.motion, get_type_hints(StageSettings)
        noise = (imu or ImuNoise()).in_flight(t.filter.imu_margin)
        parts = {name: dict(getattr(self, name, ())) | dict(getattr(t, name, ())) for name in stages}
        parts["motion"]["filter"] = FilterSettings.model_construct(**(dict(motion.filter) | noise | dict(t.filter)))
        parts["motion"]["bundle"] = BundleSettings.model_construct(**(dict(motion.bundle) | dict(t.bundle)))
        return StageSettings(**{name: kind.model_construct(**parts[name]) for name, kind in stages.items()})

    def to_yaml(self, tuning: bool = False) -> str:
        """Return YAML text for `load_settings`: the keys for users, and the changed constants of `tuning`.

        Angles are in degrees; the units of other values stand as remarks.

        Args:
            tuning: whether to write all constants of `tuning`.
        """
        tree: dict[str, Any] = self.model_dump(mode="json")
        if not tuning:
            tree.pop("tuning")
            changed = self.model_dump(mode="json", include={"tuning"}, exclude_defaults=True)
            tree |= changed if changed.get("tuning") else {}
        return "".join(f"{line}\n" for line in _yaml_lines(with_degrees(tree, Settings), Settings))


def _yaml_lines(tree: dict[str, Any], model: type[BaseModel], before: str = "") -> Iterator[str]:
    """Yield a line of YAML for each value, with its unit as a remark; `before`: indentation."""
    for name, value in tree.items():
        info = model.model_fields[name]
        if isinstance(value, dict) and isinstance(info.annotation, type):
            yield f"{before}{name}:"
            yield from _yaml_lines(value, info.annotation, f"{before}  ")
            continue
        text = yaml.safe_dump(value, default_flow_style=True, width=math.inf).removesuffix("...\n").strip()
        unit = unit_of(info)
        yield f"{before}{name}: {text}" + (f"  # {unit}" if unit not in ("", "rad") else "")
