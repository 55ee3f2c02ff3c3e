"""Identifiers of the features that the fitted tables weigh: the one list that stages and tables share.

A table stores the identifiers that it was fitted on; `tables.read_net` refuses a table whose list is another.
"""

from __future__ import annotations

from enum import StrEnum

BANDS = 4  # octaves of detail of a channel, fine to coarse
# log brightness, log red over green, log blue over green: bands whose strength is a term
POWER_BANDS = {"light": (0, 1, 2, 3), "red": (0, 2), "blue": (0, 2)}
RELATIVE = "_vs_frame"  # ends the identifier of a term less its median over the frame


class HazardTerm(StrEnum):
    """Evidence against a footprint (docs/method/hazards.md, G7b); each is larger where it is less likely safe."""

    COARSENESS = "coarseness"  # log of the finest pixel over the height that matters
    DEVIATION_SIGMAS = "deviation_sigmas"  # how far deviation or rise exceeds its limit, sigmas
    ROUGHNESS_SMOOTH = "roughness_smooth"  # log of the roughness of heights smoothed by 0.2 m, over its limit
    ROUGHNESS_TREND = "roughness_trend"  # the same of heights smoothed by 0.45 m
    EXCESS_SIGMAS = "excess_sigmas"  # smooth roughness over its limit, sigmas of the footprint
    UNKNOWN = "unknown"  # share of the footprint without a height
    RESIDUAL_MEAN = "residual_mean"  # of the matches in the footprint
    RESIDUAL_WORST = "residual_worst"
    COVER_WORST = "cover_worst"  # log odds against landable ground: the worst cell
    COVER_WORST_SMOOTH = "cover_worst_smooth"  # the worst mean over 0.2 m
    COVER_MEAN = "cover_mean"
    COVER_WORST_BEYOND = "cover_worst_beyond"  # the worst to 1 m beyond the rim
    COVER_MEAN_BEYOND = "cover_mean_beyond"  # the mean to 3 m beyond the rim
    BLOB_DARK = "blob_dark"  # log contrast of the darkest spot
    BLOB_BRIGHT = "blob_bright"
    BLOB_TINT = "blob_tint"


class SurfaceTerm(StrEnum):
    """Evidence for the land cover from shape and matching over decimetres to metres (docs/method/land-cover.md, T1)."""

    ROUGH_03 = "rough_0.3m"
    ROUGH_10 = "rough_1m"
    HEIGHT_ABOVE_GROUND = "height_above_ground"
    HEIGHT_ABOVE_BED = "height_above_bed"  # doubtful heights count
    RESIDUAL = "residual"
    RESIDUAL_RELATIVE = "residual" + RELATIVE
    RESIDUAL_2M = "residual_2m"
    SIGMA = "sigma"
    MOVING_2M = "moving_2m"
    UNSURE = "unsure"
    REFUSED_2M = "refused_2m"
    TEXTURE = "texture"
    TEXTURE_RELATIVE = "texture" + RELATIVE
    PLANTS = "plants"


class DetailTerm(StrEnum):
    """Evidence for the land cover from what is small and near (T1b), besides the bands of the channels."""

    DARKEST_NEAR = "darkest_near"
    BRIGHTEST_NEAR = "brightest_near"
    HEIGHT_LOCAL = "height_local"
    HEIGHT_BROAD = "height_broad"
    HIGHEST_NEAR = "highest_near"
    LOWEST_NEAR = "lowest_near"
    STEEP = "steep"
    RESIDUAL_SPOT = "residual_spot"
    AMBIGUOUS = "ambiguous"
    MOVING = "moving"
    STEP = "step"
    SATURATED = "saturated"
    TEXTURELESS = "textureless"


def band(channel: str, octave: int, what: str = "") -> str:
    """Identifier of a band of a channel: itself, its `max` or `min` in a cell, its strength `near` or `wide`."""
    return f"{channel}_{octave}" + (f"_{what}" if what else "")


def _channel(channel: str) -> list[str]:
    out = [band(channel, 0, "max"), band(channel, 0, "min")]
    for octave in range(BANDS):
        out += [band(channel, octave)] if octave else []
        if octave in POWER_BANDS[channel]:
            for width in ("near", "wide"):
                out += [band(channel, octave, width), band(channel, octave, width) + RELATIVE]
    return [*out, f"{channel}_local", f"{channel}_broad"]


def _with_relative(terms: tuple[DetailTerm, ...]) -> list[str]:
    return [name for t in terms for name in (t.value, t.value + RELATIVE)]


HAZARD_TERMS: tuple[str, ...] = tuple(t.value for t in HazardTerm)
LAND_COVER_TERMS: tuple[str, ...] = (
    *(t.value for t in SurfaceTerm),
    *_channel("light"),
    *_with_relative((DetailTerm.DARKEST_NEAR, DetailTerm.BRIGHTEST_NEAR)),
    *_channel("red"),
    *_channel("blue"),
    *(band("height", octave) for octave in range(BANDS)),
    DetailTerm.HEIGHT_LOCAL,
    DetailTerm.HEIGHT_BROAD,
    *_with_relative((DetailTerm.HIGHEST_NEAR, DetailTerm.LOWEST_NEAR)),
    DetailTerm.STEEP,
    DetailTerm.RESIDUAL_SPOT,
    DetailTerm.AMBIGUOUS,
    DetailTerm.MOVING,
    DetailTerm.STEP,
    DetailTerm.SATURATED,
    DetailTerm.TEXTURELESS,
)
