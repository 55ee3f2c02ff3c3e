"""Settings: one frozen model a stage, every default here, none needed to run.

YAML in and out; `--set parallax.cell=0.1` on the command line; unknown keys and bad values are refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class SourcesSettings(_Model):
    """How the input is read."""

    calibration: str | None = Field(
        None, description="Kalibr camchain.yaml that replaces the rig calibration of the log"
    )
    skip: int = Field(0, ge=0, description="exposures left out at the start")
    every: int = Field(1, ge=1, description="use each n-th exposure")


class TracksSettings(_Model):
    """Feature tracks, stereo and in time."""

    count: int = Field(250, ge=8, description="features kept, spread over a grid of as many cells")
    window_px: int = Field(21, ge=5, description="side of the SSD window")
    levels: int = Field(4, ge=1, le=8, description="pyramid levels")
    search_px: Positive = Field(40.0, description="largest distance of a match from where the motion puts it")
    search_sigmas: Positive = Field(4.0, description="the same in sigmas of that place, where the motion knows them")
    search_sigma_px: Positive = Field(0.75, description="least sigma of that place")
    forward_backward_px: Positive = Field(0.5, description="largest forward-backward disagreement")
    epipolar_px: Positive = Field(1.5, description="largest distance from the epipolar line")
    texture: Positive = Field(2e-4, description="least Shi-Tomasi response, grey range 1 (smaller eigenvalue a pixel)")


class FilterSettings(_Model):
    """The structure-from-motion filter, and its smoother."""

    points: int = Field(40, ge=4, description="points held in the state")
    clones: int = Field(8, ge=3, description="keyframe poses held in the state")
    pixel_sigma: Positive = Field(0.35, description="px, 1-sigma of a track on ground of the reference texture")
    pixel_repeat: Positive = Field(
        40.0,
        description="sights that count as one in what is claimed of a ring: errors repeat, in time and side by side",
    )
    texture_reference: Positive = Field(1.3e-3, description="texture of short grass; sigma grows as 1 / sqrt(texture)")
    depth_share: Positive = Field(0.05, description="sigma of the depth over depth, at which a point enters the state")
    vague_share: Positive = Field(
        0.2, description="sigma of the depth over depth, above which a feature measures nothing"
    )
    keyframe_baseline: Positive = Field(0.02, description="baseline over depth between the poses held")
    nav_position_tau: Positive = Field(60.0, description="s, correlation time of the GPS/INS position error")
    nav_attitude_tau: Positive = Field(120.0, description="s, correlation time of the GPS/INS attitude error")
    nav_velocity_tau: Positive = Field(20.0, description="s, correlation time of the GPS/INS velocity error")
    nav_position_white: Positive = Field(0.05, description="m, white part of the GPS/INS position error")
    nav_attitude_white: Positive = Field(0.002, description="rad, white part of the GPS/INS attitude error")
    nav_velocity_white: Positive = Field(0.03, description="m/s, white part of the GPS/INS velocity error")
    nav_rate_white: Positive = Field(
        0.02, description="rad/s, error of the GPS/INS angular velocity (used without IMU)"
    )
    position_sigma: Positive = Field(5.0, description="m, 1-sigma of the GPS/INS position where the row does not say")
    attitude_sigma: Positive = Field(
        0.03, description="rad, 1-sigma of the GPS/INS attitude where the row does not say"
    )
    velocity_sigma: Positive = Field(0.3, description="m/s, 1-sigma of the GPS/INS velocity where the row does not say")
    acceleration_sigma: Positive = Field(2.0, description="m/s^2 per sqrt(Hz), constant-velocity model")
    angular_acceleration_sigma: Positive = Field(2.0, description="rad/s^2 per sqrt(Hz), constant-velocity model")
    gyro_noise: Positive = Field(5e-4, description="rad/s per sqrt(Hz)")
    gyro_walk: Positive = Field(3e-5, description="rad/s^2 per sqrt(Hz)")
    gyro_bias_sigma: Positive = Field(0.02, description="rad/s, 1-sigma of the gyro bias at the start")
    accelerometer_noise: Positive = Field(3e-3, description="m/s^2 per sqrt(Hz)")
    accelerometer_walk: Positive = Field(3e-4, description="m/s^3 per sqrt(Hz)")
    accelerometer_bias_sigma: Positive = Field(0.2, description="m/s^2, 1-sigma of the accelerometer bias at the start")
    mounting_sigma: NonNegative | None = Field(
        None, description="rad, camera mounting against the INS; 0 holds it; None: 0.03 for photos, held in flights"
    )
    time_offset: Finite = Field(
        0.0, description="s that the cameras' stamps are ahead of the clock of GPS/INS and IMU, as far as known"
    )
    time_offset_sigma: NonNegative = Field(0.0, description="s, 1-sigma of what is unknown of it; 0 holds it")
    lateness: NonNegative = Field(
        1.0, description="s by which exposures and GPS/INS rows may come late; later ones are left out"
    )
    gate: Fraction = Field(0.995, description="probability inside the Mahalanobis gate of a measurement")
    coast: Positive = Field(2.0, description="s without any support after which the motion is LOST")
    smooth: bool = Field(True, description="refine recorded flights by a batch over all exposures")
    track_span: int = Field(15, ge=4, description="longest piece of a track the batch uses as one, exposures")


IMU_MARGIN = 1.25  # of the sample flight's ring, 0.140 px with it and 0.135 without; village at 20 m 0.156 and 0.173
_IMU_KEYS = {  # of imu0/sensor.yaml: of the filter
    "gyroscope_noise_density": "gyro_noise",
    "gyroscope_random_walk": "gyro_walk",
    "accelerometer_noise_density": "accelerometer_noise",
    "accelerometer_random_walk": "accelerometer_walk",
}


class BundleSettings(_Model):
    """Bundle adjustment of photos far apart."""

    features: int = Field(4000, ge=200, description="SIFT features a photo")
    image_px: int = Field(1600, ge=400, description="longest side used for features")
    neighbours: int = Field(
        10, ge=2, description="nearest photos each photo is matched with, besides one in each direction"
    )
    matches: int = Field(20, ge=8, description="least matches of a pair after two-view geometry")
    observations: int = Field(4000, ge=50, description="observations a photo has in the adjustment")
    focal: Literal["held", "free"] = Field("held", description="the maker's focal length; height and focal trade off")
    lens: Literal["held", "free"] = Field(
        "free", description="the maker's principal point and distortion; free: a prior"
    )
    attitude_sigma: Positive = Field(0.05, description="rad, 1-sigma of the gimbal's roll and pitch")
    heading_sigma: Positive = Field(0.15, description="rad, 1-sigma of the gimbal's heading")
    mounting_sigma: NonNegative = Field(0.03, description="rad, camera mounting against the gimbal; 0 holds it")
    position_sigma: Positive = Field(3.0, description="m, 1-sigma of GPS where the photo does not say")


class MotionSettings(_Model):
    """Ego-motion."""

    method: Literal["auto", "filter", "bundle"] = Field(
        "auto", description="auto: filter for flights, bundle for photos"
    )
    filter: FilterSettings = FilterSettings()
    bundle: BundleSettings = BundleSettings()
    given_position_sigma: NonNegative = Field(
        0.0, description="m, 1-sigma of poses from outside; above 0 the ring refines them with the map"
    )
    given_attitude_sigma: NonNegative = Field(0.0, description="rad, the same of their attitude")


class ParallaxSettings(_Model):
    """Planar parallax on the world grid."""

    method: Literal["auto", "batch", "ring"] = Field("auto", description="auto: batch for recordings")
    cell: Positive | None = Field(None, description="m; None: from the ground sampling distance")
    views: int = Field(16, ge=2, le=32, description="most views a cell uses (batch)")
    ring: int = Field(7, ge=3, le=16, description="keyframes in the ring (recursive)")
    height_range: tuple[float, float] | None = Field(
        None, description="m above the origin, searched; None: from matches"
    )
    keyframe_baseline: Positive = Field(0.02, description="baseline over height between keyframes")
    store_mb: int = Field(1500, ge=64, description="memory for the pixels of keyframes")


class ElevationSettings(_Model):
    """The map."""

    tile: int = Field(128, ge=64, description="cells a side; each chooses its own views")
    max_sigma: Positive | None = Field(None, description="m; cells above are not given out; None: 0.65 % of the height")
    most_cells: int = Field(
        16_000_000, ge=10_000, description="of the rasters of a run; where finer ones were used they are averaged"
    )


class TerrainSettings(_Model):
    """What covers the ground."""

    enabled: bool = Field(True, description="refuse ground by its class")
    model: str | None = Field(
        "default", description="of appearance: default, a file of 'alight terrain train', or null"
    )
    appearance: Fraction = Field(0.5, description="weight of appearance: a picture's neighbours say much the same")
    block: Positive = Field(0.5, description="m, blocks on which the shape of the ground is judged")
    ground_window: Positive = Field(10.0, description="m; what is narrower and higher stands on the ground")
    bulge: NonNegative = Field(0.04, description="m of height per metre of width that a hilltop may have")
    raised: Positive = Field(0.5, description="m above the ground from which something counts as an object")
    overhang: NonNegative = Field(0.5, description="m kept to what is tall, per metre of its height (up to 6 m)")
    basin_depth: Positive = Field(
        0.2, description="m of standing water that a closed basin must hold to look like a pond"
    )


def _spread(feet: tuple[tuple[float, float], ...]) -> bool:
    """Whether any three of the points span a triangle."""
    return any(
        abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) > 1e-6 for a, b, c in combinations(feet, 3)
    )


class Lander(_Model):
    """The lander, and what it stands."""

    radius: Positive = Field(1.5, description="m, footprint radius")
    max_slope: Positive = Field(math.radians(10.0), description="rad, of the footprint's plane")
    max_roughness: Positive = Field(0.15, description="m, largest deviation from the footprint's plane")
    belly_clearance: Positive | None = Field(None, description="m between the feet and the belly")
    feet: tuple[tuple[float, float], ...] | None = Field(None, description="(forward, left) of each foot, m")
    foot_radius: NonNegative = Field(0.0, description="m")
    foot_contact: Literal["highest", "mean"] = Field(
        "highest", description="ground that carries a foot: the highest cell under it, or their mean where it sinks in"
    )
    support: Literal["resting", "any"] = Field(
        "resting", description="planes judged: those the lander can rest or rock on, or any three feet (stricter)"
    )
    skids: tuple[float, float] | None = Field(None, description="length and distance between two skids, m")
    max_step: Positive | None = Field(None, description="m, between neighbouring cells; None: roughness alone")
    rotor_radius: Positive | None = Field(None, description="m; None: the footprint radius")
    rotor_rise: NonNegative = Field(0.3, description="m that ground under the rotor, beside the footprint, may rise")
    headings: int = Field(8, ge=1, le=72, description="headings tried for feet and skids")

    @property
    def has_gear(self) -> bool:
        """Whether feet or skids are given; else the lander stands on its whole footprint."""
        return self.feet is not None or self.skids is not None

    @model_validator(mode="after")
    def _sound(self) -> Lander:
        if self.feet is not None and self.skids is not None:
            raise ValueError("give feet or skids, not both")
        if self.skids is not None and min(self.skids) <= 0:
            raise ValueError("skids: length and distance must be above 0")
        if self.feet is not None and not _spread(self.feet):
            raise ValueError("feet: needs three or more that are not in one line")
        return self


class HazardsSettings(_Model):
    """Judging the ground."""

    unknown_share: Fraction = Field(0.02, description="largest share of the footprint that nobody may have seen")
    doubtful_share: Fraction = Field(0.35, description="largest share of it without a height that can be trusted")
    bridge: NonNegative = Field(0.15, description="m; doubtful heights in gaps up to twice as wide count if they agree")
    bridge_plain: NonNegative = Field(0.75, description="m; the same where the picture is plain: little texture, glare")
    alpha: NonNegative = Field(1.0, description="weight of flatness F in Q (paper, eq. 5)")
    beta: NonNegative = Field(1.0, description="weight of terrain G in Q (paper, eq. 5)")
    p_safe: Fraction = Field(0.95, description="least probability of a safe touchdown")
    min_landable: Fraction = Field(0.2, description="terrain below this probability is refused; P weighs the rest")
    tilt_sigma: NonNegative = Field(
        0.008, description="rad, least 1-sigma of the map's common tilt, where the poses do not claim a larger one"
    )
    noise_length: NonNegative = Field(0.6, description="m over which neighbouring heights share their noise")
    smoothed: bool = Field(True, description="heights come from matched images, which flatten what is small: P pays")
    usual_sigma: NonNegative = Field(0.03, description="m, 1-sigma of heights of a raster that does not say (hazards)")
    hidden_hazard: Fraction = Field(0.25, description="probability that a footprint nobody saw would hide a hazard")


class SitesSettings(_Model):
    """Choosing."""

    count: int = Field(8, ge=1, description="most sites listed")
    margin: NonNegative = Field(0.5, description="m between the footprint and the nearest hazard")
    separation: Positive | None = Field(None, description="m between two sites; None: twice the footprint radius")
    roomy: Positive = Field(5.0, description="m of clearance beyond which more is worth nothing")
    room_weight: NonNegative = Field(1.0, description="what that clearance is worth against Q")
    distance_weight: NonNegative = Field(0.0, description="what each metre to the vehicle costs against Q")
    every: int = Field(32, ge=0, description="keyframes from one judgement in flight (ring) to the next; 0: at the end")


class RouteSettings(_Model):
    """Way-points to the best site."""

    approach_height: Positive = Field(10.0, description="m above the site where the final descent starts")
    clearance: Positive = Field(3.0, description="m above and beside everything on the way")
    look_share: Fraction = Field(0.5, description="share of the approach height at which the ground is judged again")
    cruise_speed: Positive = Field(5.0, description="m/s")
    descent_speed: Positive = Field(1.0, description="m/s")


class Settings(_Model):
    """All of them."""

    sources: SourcesSettings = SourcesSettings()
    tracks: TracksSettings = TracksSettings()
    motion: MotionSettings = MotionSettings()
    parallax: ParallaxSettings = ParallaxSettings()
    elevation: ElevationSettings = ElevationSettings()
    terrain: TerrainSettings = TerrainSettings()
    lander: Lander = Lander()
    hazards: HazardsSettings = HazardsSettings()
    sites: SitesSettings = SitesSettings()
    route: RouteSettings = RouteSettings()

    def to_yaml(self) -> str:
        """The settings as YAML text that `from_yaml` takes back."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)


def _explain(error: ValidationError) -> str:
    lines = []
    for e in error.errors():
        key = ".".join(str(k) for k in e["loc"])
        known = "unknown key" if e["type"] == "extra_forbidden" else f"{e['msg']} (got {e['input']!r})"
        lines.append(f"{key}: {known}")
    return "; ".join(lines) + "; 'alight settings' lists every key"


def _assign(tree: dict[str, Any], assignment: str) -> None:
    key, sep, value = assignment.partition("=")
    if not sep or not key.strip():
        raise ValueError(f"--set takes key=value, got {assignment!r}")
    *path, last = key.strip().split(".")
    for part in path:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise ValueError(f"{key}: {part} is not a group of settings")
    tree[last] = yaml.safe_load(value)


def with_imu(settings: Settings, noise: Mapping[str, float]) -> Settings:
    """The settings with the noise that a recording states for its IMU (keys of imu0/sensor.yaml).

    What the user has set stays; numbers that are not above zero say nothing. Makers state the noise of a unit at rest:
    an aircraft's is taken as `IMU_MARGIN` times as much.
    """
    given = settings.motion.filter.model_fields_set
    found = {ours: IMU_MARGIN * noise[theirs] for theirs, ours in _IMU_KEYS.items() if noise.get(theirs, 0.0) > 0.0}
    new = settings.motion.filter.model_copy(update={k: v for k, v in found.items() if k not in given})
    return settings.model_copy(update={"motion": settings.motion.model_copy(update={"filter": new})})


def load_settings(text: str = "", assignments: Iterable[str] = ()) -> Settings:
    """Make settings of YAML text and `key=value` assignments, the latter winning.

    Raises:
        ValueError: the text is no YAML, a key is unknown or a value out of range; the message names the key.
    """
    try:
        tree = yaml.safe_load(text) or {}
        if not isinstance(tree, dict):
            raise ValueError("settings: needs a mapping of keys at the top")
        for a in assignments:
            _assign(tree, a)
    except yaml.YAMLError as e:
        raise ValueError(f"settings: not valid YAML: {' '.join(str(e).split())}") from e
    try:
        return Settings.model_validate(tree)
    except ValidationError as e:
        raise ValueError(_explain(e)) from e
