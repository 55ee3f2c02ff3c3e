"""The elevation map: heights of many grids and cell sizes fused into one, in tiles that roll with the vehicle."""

from alight.elevation.map import Elevation
from alight.elevation.tiles import FIELDS, Far, Forgotten, Name

__all__ = ["FIELDS", "Elevation", "Far", "Forgotten", "Name"]
