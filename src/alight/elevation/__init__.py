"""The elevation map: heights from grids of many cell sizes, fused into one map whose tiles follow the vehicle."""

from alight.elevation.levels import doublings_up_to, on_cells_up_to
from alight.elevation.map import TiledElevation
from alight.elevation.tiles import FIELDS, Name, NullStore, TileStore

__all__ = ["FIELDS", "Name", "NullStore", "TileStore", "TiledElevation", "doublings_up_to", "on_cells_up_to"]
