"""Maps painted as RGBA pictures of the whole grid, transparent where there is nothing to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8
from alight.raster import gradient, grey_levels, weighted_gaussian
from alight.records import ElevationMap, Flag, Hazard, Terrain

Colour = tuple[int, int, int]
Ramp = Sequence[str]

HEIGHT_RAMP: Ramp = ("#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725")  # viridis
SIGMA_RAMP: Ramp = ("#fff3dc", "#fdc58a", "#ee7b4c", "#b6272c", "#5c0a24")
SAFE_RAMP: Ramp = ("#7d3c05", "#c58a3d", "#f2e3bd", "#7cc4b4", "#02655c")


class Reason(NamedTuple):
    """Legend text and colour of a reason against a touchdown, or for a missing height."""

    text: str
    colour: str


SAFE_COLOUR = "#12a37a"
FIT = Reason("fit for a touchdown", SAFE_COLOUR)
FOUND = Reason("height found", "#00000000")  # such cells are not painted
HAZARDS: Mapping[Hazard, Reason] = {  # in order of precedence: the first reason that holds is shown
    Hazard.TERRAIN: Reason("wrong kind of ground", "#0078c7"),
    Hazard.STEP: Reason("a step", "#d44558"),
    Hazard.SLOPE: Reason("too steep", "#ed8b2f"),
    Hazard.ROUGHNESS: Reason("too rough", "#c77bb0"),
    Hazard.CLEARANCE: Reason("no room for rotor or belly", "#f0dc4e"),
    Hazard.TRAFFIC: Reason("something moved there", "#5f4790"),
    Hazard.WIRE: Reason("under a wire", "#2b2b2b"),
    Hazard.ZONE: Reason("refused by a zone", "#a80459"),
    Hazard.AVOID: Reason("in a zone to be avoided", "#ebacd5"),
    Hazard.DOUBT: Reason("fits, but not surely enough", "#a3e1ca"),
    Hazard.UNKNOWN: Reason("not seen or not trusted", "#a6a6a5"),
    Hazard.EDGE: Reason("edge of the map", "#545b63"),
}
FLAGS: Mapping[Flag, Reason] = {
    Flag.MOVING: Reason("moving: water, plants, traffic", "#0a82e7"),
    Flag.INCONSISTENT: Reason("views contradict each other", "#d1495b"),
    Flag.AMBIGUOUS: Reason("a second height fits as well", "#ed8b2f"),
    Flag.TEXTURE: Reason("too little texture", "#c77bb0"),
    Flag.SATURATED: Reason("too bright or too dark", "#f0dc4e"),
    Flag.RANGE: Reason("outside the searched heights", "#7b5a33"),
    Flag.UNSURE: Reason("probably a wrong match, or sigma too large, or isolated", "#6d4fa3"),
    Flag.FEW: Reason("seen by two views only (a note)", "#cad5e7"),
    Flag.WATER: Reason("water: the bed was seen, not the surface", "#1d4768"),
    Flag.STEP: Reason("beside a step (kept, doubtful)", "#93d2bc"),
    Flag.UNSEEN: Reason("seen by fewer than two views", "#979894"),
}
TERRAIN_COLOURS: Mapping[Terrain, str] = {
    Terrain.BARE: "#bba890",
    Terrain.SHORT_GRASS: "#9bcd62",
    Terrain.TALL_VEGETATION: "#6d8957",
    Terrain.TREE: "#144e2b",
    Terrain.WATER: "#2f78be",
    Terrain.ROCK: "#72635d",
    Terrain.PAVED: "#b0b2b8",
    Terrain.STRUCTURE: "#e53716",
}


def texts(bits: int, reasons: Mapping[Any, Reason], none: Reason) -> str:
    """Return the texts of all reasons whose bits are set in `bits`; that of `none` if no bit is set."""
    return "; ".join(reason.text for bit, reason in reasons.items() if bits & bit) or none.text


def rgb(colour: str) -> Colour:
    """Return `#rrggbb` as red, green, blue, 0 to 255."""
    r, g, b = bytes.fromhex(colour.lstrip("#"))
    return r, g, b


def colour_ramp(values: NDArray[Any], low: float, high: float, colours: Ramp) -> NDArray[np.float32]:
    """Return colours (..., 3), 0 to 255, of values between `low` and `high` on a ramp; NaN takes the lowest."""
    anchors = np.array([rgb(c) for c in colours], dtype=np.float32)
    t = np.nan_to_num((values - low) / max(high - low, 1e-9)).clip(0, 1) * (len(anchors) - 1)
    at, out = np.arange(len(anchors)), np.empty((*t.shape, 3), np.float32)
    for i in range(3):
        out[..., i] = np.interp(t, at, anchors[:, i])
    return out


def rgba(colours: NDArray[Any], shown: NDArray[np.bool_]) -> U8:
    """Return an RGBA picture of colours (R, C, 3), transparent where the mask `shown` (R, C) is false."""
    out = np.empty((*shown.shape, 4), np.uint8)  # one channel at a time: maps have millions of cells
    for k in range(3):
        out[..., k] = np.clip(colours[..., k], 0, 255)
    out[..., 3] = np.where(shown, np.uint8(255), np.uint8(0))
    return out


def span(values: NDArray[Any], low: float = 1.0, high: float = 99.0) -> tuple[float, float]:
    """Return the range of a colour scale: percentiles `low` and `high`, so that outliers do not flatten the picture."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    a, b = np.percentile(known, [low, high])
    return float(a), float(max(b, a + 1e-3))


def hillshade(height: F32, known: NDArray[np.bool_], cell: float) -> NDArray[np.float32]:
    """Return the light from the north-west at 45 degrees on the relief, (R, C), 0.45 to 1.17.

    It is 1 on level ground, in unknown cells and near them. `known`: (R, C) cells with a height; `cell`: metres.
    """
    smooth = weighted_gaussian(height, known.astype(np.float32), 1.2).mean  # noise of centimetres would hide the relief
    down, right = gradient(smooth, cell)
    nx, ny = -right, down  # east and north components of the upward normal
    light = (-nx + ny + np.sqrt(2.0)) / np.sqrt(2.0 * (1 + nx**2 + ny**2))
    edge = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    return np.where(edge, 1.0, 0.45 + 0.55 * np.clip(light, 0, 1.3)).astype(np.float32)


def paint_heights(elevation: ElevationMap, low: float, high: float) -> U8:
    """Return the heights as an RGBA picture, coloured between `low` and `high` (metres) and hill-shaded."""
    known = elevation.trusted
    shade = hillshade(elevation.height, known, elevation.grid.cell)
    return rgba(colour_ramp(elevation.height, low, high, HEIGHT_RAMP) * shade[..., None], known)


def paint_shade(elevation: ElevationMap) -> U8:
    """Return the hill shading as a grey RGBA picture, to be multiplied with others: level ground is light grey."""
    grey = 217 * hillshade(elevation.height, elevation.trusted, elevation.grid.cell)
    return rgba(np.broadcast_to(grey[..., None], (*grey.shape, 3)), elevation.trusted)


def over_ground(colours: NDArray[Any], elevation: ElevationMap, strength: float = 0.72) -> U8:
    """Return colours blended by `strength` over the grey ground."""
    grey = grey_levels(elevation.rgb).astype(np.float32)
    low, high = span(grey[elevation.views > 0], 2, 98)
    ground = np.clip((grey - low) / max(high - low, 1.0), 0, 1) * np.float32(255)
    return rgba(strength * colours + (1 - strength) * ground[..., None], elevation.views > 0)


def first_reason(bits: NDArray[Any], order: Sequence[int]) -> NDArray[np.int8]:
    """Return the index in `order` of the first bit that is set in each cell, (R, C); -1 if no bit is set."""
    first = np.full(bits.shape, -1, np.int8)
    for i, bit in reversed(list(enumerate(order))):
        first[(bits & bits.dtype.type(bit)) != 0] = i
    return first
