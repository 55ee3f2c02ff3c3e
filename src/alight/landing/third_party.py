"""Third parties on a map, as zones: roads are avoided, standing cars, people and buildings are kept out of (G22)."""

from __future__ import annotations

import shapely
from rasterio import Affine
from rasterio.features import shapes

from alight.arrays import F64, Mask
from alight.geometry import Grid
from alight.records import GroundZone, TerrainMap
from alight.records.zones import Use, ZoneKind


def third_parties(
    land_cover: TerrainMap | None, grid: Grid, came: Mask, margin: float, offset: F64 | tuple[float, float] = (0.0, 0.0)
) -> tuple[GroundZone, ...]:
    """Return the roads, cars, people and buildings of a map, one zone of each kind that it shows.

    Args:
        land_cover: roads, cars and roofs; None: not judged.
        grid: cells of `came` and of the land cover.
        came: (R, C) cells where a person or object recently came to stand.
        margin: distance that the lander's disc keeps from cars and people, metres.
        offset: (2,) metres, added to the positions of the grid.
    """
    kinds: list[tuple[ZoneKind, Use, Mask | None, float]] = [("person", "keep-out", came, margin)]
    if land_cover is not None:
        kinds += [
            ("road", "avoid", land_cover.road, 0.0),
            ("car", "keep-out", land_cover.car, margin),
            ("building", "keep-out", land_cover.raised > 0.5, 0.0),
        ]
    return tuple(
        GroundZone("", use, _outline(where, grid, offset), margin=room, kind=kind)
        for kind, use, where, room in kinds
        if where is not None and where.any()
    )


def _outline(where: Mask, grid: Grid, offset: F64 | tuple[float, float]) -> shapely.Geometry:
    """Return the outline of the True cells of a mask (R, C), simplified by a cell."""
    cell, _, west, _, _, north = grid.transform
    transform = Affine(cell, 0.0, west + float(offset[0]), 0.0, -cell, north + float(offset[1]))
    found = shapes(where.astype("uint8"), where, transform=transform)
    return shapely.union_all([shapely.geometry.shape(tree).simplify(cell) for tree, _ in found])
