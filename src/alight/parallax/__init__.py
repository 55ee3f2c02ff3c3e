"""Planar parallax on the world grid: posed views -> heights with sigma and flags."""

from alight.parallax.batch import Images, match
from alight.parallax.ground import find_points, height_range
from alight.parallax.ortho import ortho
from alight.parallax.ring import Ring
from alight.parallax.views import ground_sampling

__all__ = ["Images", "Ring", "find_points", "ground_sampling", "height_range", "match", "ortho"]
