"""From evidence to classes: everything is weighed together, and appearance may only take (docs/method-ground.md, 3)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.learned import Net, read_net, relu_net
from alight.raster import close_gaps, fill_pits, grow, without_specks
from alight.records import F32, LANDABLE, U8, ElevationMap, Flag, Terrain, TerrainMap
from alight.settings import TerrainSettings
from alight.terrain.appearance import Appearance, appearance, seen
from alight.terrain.evidence import cover_terms
from alight.terrain.features import level_of
from alight.terrain.model import Model, appearance_evidence, log_softmax
from alight.terrain.relief import Relief, relief
from alight.terrain.water import ponds, wetness

Bool = NDArray[np.bool_]
KINDS = tuple(k for k in Terrain if k != Terrain.UNKNOWN)  # the last axis of log odds and probabilities
OPEN = [i for i, k in enumerate(KINDS) if k in LANDABLE]
SURE = np.float32(4.0)  # log odds given to what the shape alone settles: standing water
SPECK = 0.1  # square metres: a smaller patch is left to the geometry
TUFT_GAP = 0.5  # metres: a gap between two tufts of less than twice this gives no place to stand
PIT = 0.15  # metres: what is refused and narrower than twice this is left to the geometry
LEAFY = 0.09  # excess green of plants
TALL = 1.5  # metres above the ground: a tree
UNDER = np.float32(0.27)  # P(landable) at most, within reach of a crown


def beside_tall(elevation: ElevationMap, shape: Relief, settings: TerrainSettings) -> Bool:
    """Ground within reach of a crown (G18): seen from the side, what lies under it passes for open ground.

    Doubtful heights count here: most of a crown is doubtful, and a needless refusal costs little.
    """
    cell = elevation.grid.cell
    usable = (elevation.flags & np.uint16(Flag.UNSEEN | Flag.RANGE | Flag.SATURATED)) == 0
    above = np.where(usable, elevation.height - shape.ground, np.float32(np.nan))
    out = np.zeros(above.shape, dtype=np.bool_)
    for tall in (1.5, 3.0, 4.5, 6.0):
        n = round(settings.overhang * tall / cell)
        if n < 1:
            continue
        standing = without_specks(np.nan_to_num(above) > tall, cell, 0.5)
        out |= grow(standing, n)
    return out


def appearance_odds(model: Model | None, elevation: ElevationMap, look: Appearance) -> F32 | None:
    """What the model of appearance adds to the log odds, (R, C, 8); None when it can say nothing here.

    0 is no evidence: for classes that the model does not know, and wherever nothing known looks like that.
    """
    if model is None or not look.coloured:
        return None
    said = appearance_evidence(model, elevation.rgb, elevation.grid.cell, seen(elevation))
    if said is None:
        return None
    lift = np.nan_to_num(said + np.float32(np.log(len(model.classes)))).astype(np.float32)
    out = np.zeros((*elevation.grid.shape, len(KINDS)), np.float32)
    size = elevation.grid.shape[::-1]
    for i, code in enumerate(model.classes):
        out[..., int(code) - 1] = cv2.resize(np.ascontiguousarray(lift[..., i]), size, interpolation=cv2.INTER_LINEAR)
    return out


def landable_of(odds: F32) -> F32:
    """Probability of ground that may be landed on, (R, C), of log odds (R, C, 8)."""
    return np.asarray(np.exp(log_softmax(odds))[..., OPEN].sum(axis=-1), np.float32)


def _open_kind(look: Appearance) -> U8:
    """Which open ground it is, by its colour, cautiously."""
    green = np.nan_to_num(look.green) > LEAFY
    grey = (np.abs(look.cool) < 0.05) & (np.abs(look.green) < 0.04) & (look.texture < 0.05)
    return np.where(green, Terrain.SHORT_GRASS, np.where(grey, Terrain.PAVED, Terrain.BARE)).astype(np.uint8)


def _settled(odds: F32, water: Bool, cell: float) -> F32:
    """Log odds with standing water made sure, and gaps between tufts given to the tufts."""
    out = odds.copy()
    best = odds.max(axis=-1)
    wet = Terrain.WATER - 1
    out[..., wet] = np.where(water, best + SURE, odds[..., wet])
    plants = np.argmax(out, axis=-1) == Terrain.TALL_VEGETATION - 1
    tufts = close_gaps(without_specks(plants, cell, SPECK), max(1, round(TUFT_GAP / cell))) & ~water
    out[..., Terrain.TALL_VEGETATION - 1] = np.where(
        tufts, np.maximum(best, best + 1), out[..., Terrain.TALL_VEGETATION - 1]
    )
    return out


def _labels(odds: F32, landable: F32, look: Appearance, shape: Relief, settings: TerrainSettings) -> U8:
    """The likeliest class; its colour says which open ground it is, and whether what stands on it is a tree."""
    hazards = odds.copy()
    hazards[..., OPEN] = -np.inf
    kind = (np.argmax(hazards, axis=-1) + 1).astype(np.uint8)
    above, leafy = np.nan_to_num(shape.above), np.nan_to_num(look.green) > LEAFY
    raised = (above > settings.raised) & (kind != Terrain.WATER)
    plants = leafy & (raised | (kind == Terrain.ROCK))  # no rock is green
    kind = np.where(plants, np.where(above > TALL, Terrain.TREE, Terrain.TALL_VEGETATION), kind)
    return np.where(landable >= 0.5, _open_kind(look), kind).astype(np.uint8)


def _verdict(elevation: ElevationMap, settings: TerrainSettings, model: Model | None, net: Net) -> tuple[U8, F32, F32]:
    """Labels, P(landable) and log probabilities of one map."""
    cell = elevation.grid.cell
    look = appearance(elevation)
    wet = wetness(elevation, look)
    shape = relief(elevation, wet, settings)
    water = ponds(elevation, look, shape, wet, settings)
    plain = _settled(relu_net(net, cover_terms(elevation, look, shape)), water, cell)
    seen_as = appearance_odds(model, elevation, look)
    odds = plain if seen_as is None else plain + np.float32(settings.appearance) * seen_as
    landable = fill_pits(
        np.minimum(landable_of(plain), landable_of(odds)), round(PIT / cell)
    )  # appearance never gives (T5)
    standing = (np.nan_to_num(shape.above) > settings.raised) | beside_tall(elevation, shape, settings)
    landable = np.where(standing, np.minimum(landable, UNDER), landable)
    return _labels(odds, landable, look, shape, settings), landable, log_softmax(odds)


def says(elevation: ElevationMap, settings: TerrainSettings, model: Model | None) -> str:
    """In words, what the classes of a map are made of."""
    if not settings.enabled:
        return "not judged (terrain.enabled)"
    alone = "shape, matching and texture of the map alone: "
    if model is None:
        return alone + "no model of appearance"
    if not appearance(elevation).coloured:
        return alone + "the pictures are grey"
    level = level_of(elevation.grid.cell)
    if level is None or model.heads[level] is None:
        return alone + f"cells of {elevation.grid.cell:g} m are too coarse for the model of appearance"
    return "shape, matching and texture of the map, and a model of appearance, which may only refuse"


def classify(
    elevation: ElevationMap, settings: TerrainSettings, model: Model | None = None, net: Net | None = None
) -> TerrainMap:
    """Say what covers each cell, and how likely it may be landed on.

    Args:
        elevation: heights, flags and colours.
        settings: scales and weights; `enabled` False gives UNKNOWN everywhere, which refuses nothing.
        model: of appearance; None: the map's own evidence alone.
        net: over the map's own evidence; None: the package's (`learned/land_cover.md`).

    Returns:
        Classes and their probabilities, UNKNOWN and NaN where nothing was seen; `landable` is a reason to refuse and
        never one to permit.
    """
    shape, nothing = elevation.grid.shape, np.float32(np.nan)
    if not settings.enabled:
        return TerrainMap(elevation.grid, np.zeros(shape, dtype=np.uint8), np.full(shape, nothing))
    label, landable, log_p = _verdict(elevation, settings, model, net or read_net("land_cover"))
    looked = seen(elevation)
    return TerrainMap(
        elevation.grid,
        np.where(looked, label, np.uint8(Terrain.UNKNOWN)).astype(np.uint8),
        np.where(looked, landable, nothing),
        np.where(looked[..., None], np.exp(log_p), nothing).astype(np.float16),
    )
