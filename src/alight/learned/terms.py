"""Identifiers of the features in fitted tables: the one list that stages and tables share.

A table stores the identifiers that it was fitted on. `models.FittedTable.of` refuses a table with other identifiers.
"""

from __future__ import annotations

from enum import StrEnum

BANDS = 5  # octaves of picture detail, from 0.05 m
RELATIVE = "_vs_frame"  # suffix for a feature minus its median over the frame


class ReliefTerm(StrEnum):
    """Features of the heights that contradict an even footprint (docs/method/p-safe.md, G7b).

    Every feature increases as a touchdown becomes less likely safe. Lengths are divided by `Lander.tallest_obstacle`.
    """

    ROUGHNESS = "roughness"  # log of the largest deviation from the footprint's plane
    ROUGHNESS_SMOOTH = "roughness_smooth"  # ROUGHNESS of heights smoothed by 0.2 m
    ROUGHNESS_TREND = "roughness_trend"  # ROUGHNESS of heights smoothed by 0.45 m
    RELIEF_WORST = "relief_worst"  # log root mean square relief as wide as an obstacle, in the worst patch
    RELIEF_MEAN = "relief_mean"
    SAMPLING = "sampling"  # log of the width of a match sample on the ground
    SIGMA = "sigma"  # log of the sigma of the heights
    RESIDUAL_MEAN = "residual_mean"  # mean residual of the matches
    RESIDUAL_WORST = "residual_worst"
    UNKNOWN = "unknown"  # share of the footprint without a height


class DensityTerm(StrEnum):
    """Features of the picture that show nearby obstacles, which the heights may have smoothed away (G7c)."""

    SPOT_WORST = "spot_worst"  # log root mean square contrast of spots as wide as an obstacle, in the worst patch
    SPOT_MEAN = "spot_mean"
    SPOT_AROUND = "spot_around"
    DARK = "dark"  # contrast of the darkest spot
    BRIGHT = "bright"
    PIXEL = "pixel"  # log of the width of a picture's pixel on the ground


class GroundTerm(StrEnum):
    """Features that contradict firm, dry ground (G7e), mostly log odds over a footprint; rock is treated as firm."""

    WORST = "worst"
    WORST_SMOOTH = "worst_smooth"  # worst of means over 0.2 m
    MEAN = "mean"
    WORST_BEYOND = "worst_beyond"  # worst up to 1 m beyond the rim
    MEAN_BEYOND = "mean_beyond"  # mean up to 3 m beyond the rim
    AROUND = "around"
    NOVELTY = "novelty"  # mean log of the novelty (`KnownGround`)
    ENCLOSED = "enclosed"  # worst membership of a level surface below its banks


class NearTerm(StrEnum):
    """Features of views from nearby, in addition to the features of relief, density and ground (G7f)."""

    RISE = "rise"  # `ReliefTerm.ROUGHNESS` of all measured heights: doubtful heights show tufts
    RISE_UNKNOWN = "rise_unknown"  # share of the footprint without a well measured height
    NARROW = "narrow"  # RISE minus ROUGHNESS_SMOOTH: matching flattens stones, not ridges
    GREEN = "green"  # excess green of the greenest spot as wide as an obstacle, as of a tuft on bare ground


class FloorTerm(StrEnum):
    """Features for the floors only, the lower bounds of the expected number of hazards (`models.Floor`).

    The fitted rates (`models.Rate`) do not use them.
    """

    UNLIKE = "unlike"  # log odds of the softest patch minus log odds of its surroundings
    RIDGE = "ridge"  # metres, relief of the highest straight ridge


class SurfaceTerm(StrEnum):
    """Features for the land cover from shape and matching over decimetres to metres (docs/method/land-cover.md, T1)."""

    ROUGH_02 = "rough_0.2m"  # log root mean square height minus its 0.2 m mean
    ROUGH_05 = "rough_0.5m"
    ROUGH_15 = "rough_1.5m"
    HEIGHT_ABOVE_GROUND = "height_above_ground"
    HEIGHT_ABOVE_BED = "height_above_bed"  # doubtful heights included
    HEIGHT_LOCAL = "height_local"
    HEIGHT_BROAD = "height_broad"
    HIGHEST_NEAR = "highest_near"
    LOWEST_NEAR = "lowest_near"
    STEEP = "steep"
    RESIDUAL = "residual"
    RESIDUAL_2M = "residual_2m"
    SIGMA = "sigma"
    MOVING = "moving"
    MOVING_2M = "moving_2m"
    UNSURE = "unsure"
    REFUSED_2M = "refused_2m"
    TEXTURELESS = "textureless"
    SATURATED = "saturated"
    PLANTS = "plants"
    SAMPLING = "sampling"  # log of the width of a match sample on the ground
    PIXEL = "pixel"  # log of the width of a picture's pixel on the ground


class PictureTerm(StrEnum):
    """Features for the land cover from the picture's detail, in addition to `band` (T1b)."""

    BELOW = "light_below"
    DARK = "dark_near"
    BRIGHT = "bright_near"
    TINT = "tint"
    TINT_2M = "tint_2m"
    LOCAL = "light_local"
    BROAD = "light_broad"


def band(octave: int) -> str:
    """Return the identifier of the feature that holds the strength of detail in one octave of log brightness."""
    return f"light_{octave}"


def _values(*kinds: type[StrEnum]) -> tuple[str, ...]:
    return tuple(t.value for kind in kinds for t in kind)


RELIEF_TERMS, DENSITY_TERMS, GROUND_TERMS = (_values(kind) for kind in (ReliefTerm, DensityTerm, GroundTerm))
_FROM_AFAR = (ReliefTerm.ROUGHNESS_TREND, ReliefTerm.RESIDUAL_MEAN, DensityTerm.SPOT_AROUND, GroundTerm.AROUND)
NEAR_TERMS = tuple(t for t in _values(ReliefTerm, DensityTerm, GroundTerm, NearTerm) if t not in _FROM_AFAR)
_BANDS = tuple(band(octave) for octave in range(BANDS))
FRAME_TERMS = (  # features that are also used minus their median over the frame
    SurfaceTerm.ROUGH_02, SurfaceTerm.ROUGH_05, SurfaceTerm.RESIDUAL, *_BANDS, PictureTerm.DARK, PictureTerm.BRIGHT,
    PictureTerm.TINT,
)  # fmt: skip
LAND_COVER_TERMS = tuple(
    name
    for plain in (*_values(SurfaceTerm), *_BANDS, *_values(PictureTerm))
    for name in ((plain, plain + RELATIVE) if plain in FRAME_TERMS else (plain,))
)
