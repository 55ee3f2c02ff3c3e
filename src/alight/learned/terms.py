"""Identifiers of the terms of the fitted tables: the one list that stages and tables share.

A table stores the identifiers that it was fitted on; `models.FittedTable.of` refuses a table whose list is another.
"""

from __future__ import annotations

from enum import StrEnum

BANDS = 5  # octaves of detail of the picture, from 0.05 m
RELATIVE = "_vs_frame"  # ends the identifier of a term less its median over the frame


class ReliefTerm(StrEnum):
    """Evidence of the heights against an even footprint (docs/method/p-safe.md, G7b).

    Each is larger where a touchdown is less likely safe. Lengths are over `Lander.tallest_obstacle`.
    """

    ROUGHNESS = "roughness"  # log of the largest deviation from the footprint's plane, over its limit
    ROUGHNESS_SMOOTH = "roughness_smooth"  # the same of heights smoothed by 0.2 m
    ROUGHNESS_TREND = "roughness_trend"  # the same of heights smoothed by 0.45 m
    RELIEF_WORST = "relief_worst"  # log root mean square relief as wide as an obstacle: of the worst patch
    RELIEF_MEAN = "relief_mean"
    SAMPLING = "sampling"  # log of the ground that a sample of the match covers
    SIGMA = "sigma"  # log of the sigma of the heights
    RESIDUAL_MEAN = "residual_mean"  # of the matches
    RESIDUAL_WORST = "residual_worst"
    UNKNOWN = "unknown"  # share of the footprint without a height


class DensityTerm(StrEnum):
    """Evidence of the picture for obstacles near by, which the heights may have smoothed away (G7c)."""

    SPOT_WORST = "spot_worst"  # log root mean square contrast of spots as wide as an obstacle: of the worst patch
    SPOT_MEAN = "spot_mean"
    SPOT_AROUND = "spot_around"
    DARK = "dark"  # contrast of the darkest spot
    BRIGHT = "bright"
    PIXEL = "pixel"  # log of the ground that a pixel of the picture covers


class GroundTerm(StrEnum):
    """Evidence against ground that bears and is dry (G7e): log odds of a footprint against it, rock left aside."""

    WORST = "worst"
    WORST_SMOOTH = "worst_smooth"  # of means over 0.2 m
    MEAN = "mean"
    WORST_BEYOND = "worst_beyond"  # to 1 m beyond the rim
    MEAN_BEYOND = "mean_beyond"  # to 3 m beyond the rim
    AROUND = "around"
    NOVELTY = "novelty"  # log of the novelty (`KnownGround`): the mean
    ENCLOSED = "enclosed"  # degree to which it is part of a level surface below its banks: the worst


class NearTerm(StrEnum):
    """Evidence of looks from near by, besides that of relief, density and ground (G7f)."""

    RISE = "rise"  # as `ReliefTerm.ROUGHNESS`, of all measured heights: doubtful ones show tufts
    RISE_UNKNOWN = "rise_unknown"  # share of the footprint where no height was measured well
    NARROW = "narrow"  # log of that deviation over the one of smoothed heights: matching flattens stones, not ridges
    GREEN = "green"  # excess green of the greenest spot as wide as an obstacle: a tuft on bare ground, however flat


class FloorTerm(StrEnum):
    """Evidence of floors alone (`floors.yaml`), besides the terms above."""

    UNLIKE = "unlike"  # log odds of a patch that bears less over those of the ground about it
    RIDGE = "ridge"  # metres of relief, the highest straight ridge


class SurfaceTerm(StrEnum):
    """Evidence for the land cover from shape and matching over decimetres to metres (docs/method/land-cover.md, T1)."""

    ROUGH_02 = "rough_0.2m"  # log root mean square height against 0.2 m about it
    ROUGH_05 = "rough_0.5m"
    ROUGH_15 = "rough_1.5m"
    HEIGHT_ABOVE_GROUND = "height_above_ground"
    HEIGHT_ABOVE_BED = "height_above_bed"  # doubtful heights count
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
    SAMPLING = "sampling"  # log of the ground that a sample of the match covers
    PIXEL = "pixel"  # log of the ground that a pixel of the picture covers


class PictureTerm(StrEnum):
    """Evidence for the land cover from detail of the picture, besides its bands (T1b)."""

    BELOW = "light_below"
    DARK = "dark_near"
    BRIGHT = "bright_near"
    TINT = "tint"
    TINT_2M = "tint_2m"
    LOCAL = "light_local"
    BROAD = "light_broad"


def band(octave: int) -> str:
    """Identifier of the strength of a band of log brightness."""
    return f"light_{octave}"


def _values(*kinds: type[StrEnum]) -> tuple[str, ...]:
    return tuple(t.value for kind in kinds for t in kind)


RELIEF_TERMS, DENSITY_TERMS, GROUND_TERMS = (_values(kind) for kind in (ReliefTerm, DensityTerm, GroundTerm))
_FROM_AFAR = (ReliefTerm.ROUGHNESS_TREND, ReliefTerm.RESIDUAL_MEAN, DensityTerm.SPOT_AROUND, GroundTerm.AROUND)
NEAR_TERMS = tuple(t for t in _values(ReliefTerm, DensityTerm, GroundTerm, NearTerm) if t not in _FROM_AFAR)
_BANDS = tuple(band(octave) for octave in range(BANDS))
FRAME_TERMS = (  # their value less its median over the frame is a term as well
    SurfaceTerm.ROUGH_02, SurfaceTerm.ROUGH_05, SurfaceTerm.RESIDUAL, *_BANDS, PictureTerm.DARK, PictureTerm.BRIGHT,
    PictureTerm.TINT,
)  # fmt: skip
LAND_COVER_TERMS = tuple(
    name
    for plain in (*_values(SurfaceTerm), *_BANDS, *_values(PictureTerm))
    for name in ((plain, plain + RELATIVE) if plain in FRAME_TERMS else (plain,))
)
