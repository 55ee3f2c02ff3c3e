"""The evidence of a judgement: all that it uses besides the settings, so that another lander can be judged later."""

from __future__ import annotations

from dataclasses import dataclass

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Grid
from alight.records.landing import Observer
from alight.records.map_frame import MapFrame
from alight.records.surface import ElevationMap, MissingVeto, TerrainMap
from alight.records.wires import Wire


@dataclass(frozen=True, eq=False)
class MapEvidence:
    """Evidence of the last judgement of a run, in the map frame; arrays (R, C) are on `grid`, the judging cells."""

    elevation: ElevationMap  # on the cells of the map, which may be finer than the judging cells
    grid: Grid
    picture: U8  # (f * R, f * C, 3) orthophoto, f x f pixels per judging cell
    picture_sampling: F32  # (R, C) metres, ground width of a pixel in the views of the picture
    land_cover: TerrainMap | None  # None: the kind of ground was not judged
    wires: tuple[Wire, ...]
    passed: Mask  # (R, C) cells that a moving object crossed
    came: Mask  # (R, C) cells where a person or object recently came to stand
    missing: MissingVeto
    observer: Observer | None  # None: no camera looked down at the end
    vehicle: F64  # (3,) metres, position at the end
    height_above_ground: float  # metres, of the vehicle
    frame: MapFrame
    distrust: str = ""  # reason why no height is trusted; empty: they are
