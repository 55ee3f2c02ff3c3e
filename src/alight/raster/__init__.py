"""Operators on rasters that several stages share. Ground floor: imports nothing of ours but the array types."""

from alight.raster.blocks import block_max, block_mean, block_quantile, cells_as_blocks, upsample, whole_blocks
from alight.raster.brightness import BlockGreen, BlockLight, block_green, block_light, log_brightness, log_levels
from alight.raster.disc import (
    DiscWindow,
    disc_any,
    disc_crosses_edge,
    disc_mask,
    disc_max,
    disc_mean,
    disc_share,
    disc_spans,
    disc_window,
)
from alight.raster.distance import clearance_of, distance_to
from alight.raster.fill import filled_surface, nearest_known
from alight.raster.gradient import Rise, gradient
from alight.raster.morphology import close_mask, ellipse, fill_pits, grow, local_max, without_specks
from alight.raster.scalars import linear_ramp, log_at_least, log_offset
from alight.raster.smoothing import (
    WeightedMean,
    difference_of_gaussians,
    gaussian_mean,
    masked_gaussian,
    weighted_gaussian,
)

__all__ = [
    "BlockGreen",
    "BlockLight",
    "DiscWindow",
    "Rise",
    "WeightedMean",
    "block_green",
    "block_light",
    "block_max",
    "block_mean",
    "block_quantile",
    "cells_as_blocks",
    "clearance_of",
    "close_mask",
    "difference_of_gaussians",
    "disc_any",
    "disc_crosses_edge",
    "disc_mask",
    "disc_max",
    "disc_mean",
    "disc_share",
    "disc_spans",
    "disc_window",
    "distance_to",
    "ellipse",
    "fill_pits",
    "filled_surface",
    "gaussian_mean",
    "gradient",
    "grow",
    "linear_ramp",
    "local_max",
    "log_at_least",
    "log_brightness",
    "log_levels",
    "log_offset",
    "masked_gaussian",
    "nearest_known",
    "upsample",
    "weighted_gaussian",
    "whole_blocks",
    "without_specks",
]
