"""Planar parallax on the world grid: posed views -> heights with sigma and flags."""

from alight.parallax.batch import Images, match_tile
from alight.parallax.datum import with_datum
from alight.parallax.orthophoto import orthophoto
from alight.parallax.pose_error import Matched
from alight.parallax.recursive import RecursiveParallax
from alight.parallax.sparse_points import NO_POINTS, find_points, height_range, supported
from alight.parallax.views import choose_views, ground_sampling, may_see

__all__ = [
    "NO_POINTS", "Images", "Matched", "RecursiveParallax", "choose_views", "find_points", "ground_sampling",
    "height_range", "match_tile", "may_see", "orthophoto", "supported", "with_datum",
]  # fmt: skip
