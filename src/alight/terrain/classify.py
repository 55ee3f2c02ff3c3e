"""Land cover from the log odds of all evidence; the appearance model can only refuse (docs/method/land-cover.md)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask
from alight.learned import KnownGround, Net, read_known, read_net
from alight.raster import close_mask, fill_pits, grow, upsample, without_specks
from alight.records import LANDABLE, ElevationMap, Terrain, TerrainMap, is_measured
from alight.settings import TerrainSettings
from alight.terrain.appearance import Appearance, appearance, black_ground, seen
from alight.terrain.cars import standing_cars
from alight.terrain.enclosed import LevelSurfaces
from alight.terrain.evidence import land_cover_terms
from alight.terrain.model import PIXEL, Model, appearance_evidence, level_of, log_softmax
from alight.terrain.relief import Relief, relief
from alight.terrain.roads import roads
from alight.terrain.water import ALIKE, dryness, open_water, ponds, wetness

KINDS = tuple(k for k in Terrain if k != Terrain.UNKNOWN)  # classes along the first axis of log odds
ANYTHING = 0.5  # `landable` and `bears` of ground without a picture
UNLIKE = 20.0  # novelty of ground without a picture: 1 % of it refuses a footprint
WATER = KINDS.index(Terrain.WATER)
HARD = Terrain.PAVED, Terrain.ROCK, Terrain.STRUCTURE
PLANTS = Terrain.SHORT_GRASS, Terrain.TALL_VEGETATION, Terrain.TREE
OPEN = [i for i, k in enumerate(KINDS) if k in LANDABLE]
BEARS = [i for i, k in enumerate(KINDS) if k in (*LANDABLE, Terrain.ROCK)]


class Tables(NamedTuple):
    """Fitted tables for the evidence of maps."""

    net: Net
    known: KnownGround


def beside_tall(elevation: ElevationMap, shape: Relief, settings: TerrainSettings) -> Mask:
    """Return the mask of ground under and beside tree crowns (G18); oblique views show such ground as open.

    Doubtful heights are used too, as most heights of a crown are doubtful and a needless refusal does little harm.
    """
    cell = elevation.grid.cell
    height_above = np.where(is_measured(elevation.flags), elevation.height - shape.ground, np.float32(np.nan))
    out = np.zeros(height_above.shape, dtype=np.bool_)
    for tall in (1.5, 3.0, 4.5, 6.0):
        n = round(settings.overhang * tall / cell)
        if n < 1:
            continue
        standing = without_specks(np.nan_to_num(height_above) > tall, cell, 0.5)
        out |= grow(standing, n)
    return out


def without_pits(share: F32, cell: float) -> F32:
    """Raise P(landable), (R, C), in low patches up to 0.3 m wide to its value around them; `cell` in metres."""
    return fill_pits(share, int(0.3 / cell + 1e-6) + 1)


def appearance_odds(model: Model | None, elevation: ElevationMap, colours: Appearance) -> F32 | None:
    """Compute the log odds (8, R, C) that the appearance model adds; None for grey pictures or too coarse cells.

    The odds are 0 for classes that the model does not have, and on ground unlike all its training patches.
    """
    if model is None or not colours.coloured:
        return None
    picture, n = elevation.picture(PIXEL)
    log_p = appearance_evidence(model, picture, elevation.grid.cell / n, upsample(seen(elevation), n))
    if log_p is None:
        return None
    lift = np.nan_to_num(log_p + np.float32(np.log(len(model.classes)))).astype(np.float32)
    out = np.zeros((len(KINDS), *elevation.grid.shape), np.float32)
    size = elevation.grid.shape[::-1]
    for i, code in enumerate(model.classes):
        out[int(code) - 1] = cv2.resize(np.ascontiguousarray(lift[..., i]), size, interpolation=cv2.INTER_LINEAR)
    return out


def _open_kind(colours: Appearance, leafy: float) -> U8:
    green = np.nan_to_num(colours.green) > leafy
    grey = (np.abs(colours.cool) < 0.05) & (np.abs(colours.green) < 0.04) & (colours.texture < 0.05)
    return np.where(green, Terrain.SHORT_GRASS, np.where(grey, Terrain.PAVED, Terrain.BARE)).astype(np.uint8)


def _with_water_and_tufts(odds: F32, water: Mask, cell: float, settings: TerrainSettings) -> F32:
    """Raise the log odds (8, R, C) of WATER in `water` and of TALL_VEGETATION between tufts above all others, in place.

    Tufts below 0.1 m^2 are left to the hazard assessment. Gaps below 1 m are too narrow to land in.
    """
    best = odds.max(axis=0)
    wet, tall = WATER, Terrain.TALL_VEGETATION - 1
    np.copyto(odds[wet], best + np.float32(settings.basin_odds), where=water)
    plants = odds[tall] >= odds.max(axis=0)
    tufts = close_mask(without_specks(plants, cell, 0.1), max(1, round(0.5 / cell))) & ~water
    np.copyto(odds[tall], best + 1, where=tufts)
    return odds


class _Shares(NamedTuple):
    open: F32
    bears: F32
    water: F32


def _shares(odds: F32, strip: int = 64) -> _Shares:
    """Compute the probabilities of open ground, firm ground and water from log odds (8, R, C), by strips of rows."""
    out = _Shares(*(np.empty(odds.shape[1:], np.float32) for _ in _Shares._fields))
    for top in range(0, odds.shape[1], strip):
        rows = slice(top, top + strip)
        p = np.exp(log_softmax(odds[:, rows], axis=0))
        out.open[rows], out.bears[rows], out.water[rows] = p[OPEN].sum(axis=0), p[BEARS].sum(axis=0), p[WATER]
    return out


def _labels(odds: F32, landable: F32, colours: Appearance, shape: Relief, settings: TerrainSettings) -> U8:
    """Return the most likely class of each cell, (R, C). Overwrites `odds`.

    Colour separates the classes of open ground; height separates trees from lower plants.
    """
    odds[OPEN] = -np.inf
    kind = (np.argmax(odds, axis=0) + 1).astype(np.uint8)
    height_above, leafy = np.nan_to_num(shape.height_above), np.nan_to_num(colours.green) > settings.leafy
    raised = (height_above > settings.raised) & (kind != Terrain.WATER)
    plants = leafy & (raised | (kind == Terrain.ROCK))  # no rock is green
    kind = np.where(plants, np.where(height_above > settings.tall, Terrain.TREE, Terrain.TALL_VEGETATION), kind)
    return np.where(landable >= 0.5, _open_kind(colours, settings.leafy), kind).astype(np.uint8)


def _classified(
    elevation: ElevationMap, settings: TerrainSettings, model: Model | None, tables: Tables, with_roads: bool
) -> TerrainMap:
    cell = elevation.grid.cell
    colours = appearance(elevation)
    wet = wetness(elevation, colours)
    shape = relief(elevation, wet, settings)
    water = ponds(elevation, colours, shape, wet, settings)
    some: dict[str, F32] = {}
    terms = _kept(land_cover_terms(elevation, colours, shape), some)
    odds = _with_water_and_tufts(tables.net.outputs(terms), water, cell, settings)
    added = appearance_odds(model, elevation, colours)
    each = [_shares(odds)]
    if added is not None:
        odds += np.float32(settings.appearance) * added
        del added
        each.insert(0, _shares(odds))
    standing = (np.nan_to_num(shape.height_above) > settings.raised) | beside_tall(elevation, shape, settings)

    def surely(shares: list[F32]) -> F32:
        """Return the smallest of `shares`, lowered where objects stand; so an appearance model can only refuse (T5)."""
        share = without_pits(np.minimum.reduce(shares), cell)
        return np.where(standing, np.minimum(share, np.float32(settings.beside_tall)), share)

    landable = surely([p.open for p in each])
    label = _labels(odds, landable, colours, shape, settings)
    novelty = _novelty(tables.known, some, landable.shape)
    surfaces = LevelSurfaces.of(elevation, settings)
    cover = TerrainMap(
        elevation.grid, label, landable, each[0].water, surfaces.enclosed(), surfaces.raised(), novelty,
        surely([p.bears for p in each]), roads(elevation, landable, settings) if with_roads else None,
        standing_cars(_any_height_above(elevation, shape), colours.green, cell, settings), colours.coloured,
    )  # fmt: skip
    water = surfaces.pools(open_water(cover) | (wet > ALIKE) & ~np.isin(label, HARD))
    dry = np.where(np.isin(label, PLANTS), dryness(water, elevation.height), np.float32(1))
    return replace(cover, bears=cover.bears * dry)


def _any_height_above(elevation: ElevationMap, shape: Relief) -> F32:
    """Return the height above the ground, (R, C) metres, of doubtful heights too."""
    return np.where(np.isfinite(shape.height_above), shape.height_above, elevation.height - shape.ground)


def _kept(terms: Iterable[tuple[str, F32]], some: dict[str, F32], apart: int = 3) -> Iterator[tuple[str, F32]]:
    """Yield all features (name, values) unchanged, and store every `apart`-th row and column of each in `some`."""
    for name, values in terms:
        first = [min(apart // 2, n - 1) for n in values.shape]
        some[name] = values[first[0] :: apart, first[1] :: apart].copy()  # a view would keep the whole array in memory
        yield name, values


def _novelty(known: KnownGround, some: Mapping[str, F32], shape: tuple[int, int]) -> F32:
    """Compute the novelty (T6) of every cell of a raster of `shape` from features of a subset of its cells, `some`."""
    values = np.stack([some[name].ravel() for name in known.terms], axis=1)
    found = known.novelty(values).reshape(some[known.terms[0]].shape)
    return np.asarray(cv2.resize(found, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def describe(
    elevation: ElevationMap, settings: TerrainSettings, model: Model | None, coloured: bool | None = None
) -> str:
    """Describe the evidence behind the classes of a map in words; `coloured`: None if that is not known yet."""
    if not settings.enabled:
        return "not judged (terrain.enabled)"
    alone = "shape, matching and texture of the map alone: "
    if model is None:
        return alone + "no model of appearance"
    if not (appearance(elevation).coloured if coloured is None else coloured):
        return alone + "the pictures are grey"
    pixel = elevation.grid.cell / elevation.pixels_a_cell(PIXEL)
    level = level_of(pixel)
    if level is None or model.heads[level] is None:
        return alone + f"pixels of {pixel:g} m are too coarse for the model of appearance"
    return "shape, matching and texture of the map, and a model of appearance, which may only refuse"


def classify(
    elevation: ElevationMap,
    settings: TerrainSettings,
    model: Model | None = None,
    tables: Tables | None = None,
    with_roads: bool = True,
) -> TerrainMap:
    """Estimate the land cover of each cell, and the probability that a vehicle may land on it.

    Args:
        elevation: heights, flags and colours.
        settings: scales and weights.
        model: appearance model; None: only the evidence of the map itself.
        tables: fitted tables; None: those of the package (`learned/land_cover.md`, `known_ground.md`).
        with_roads: whether roads are looked for.

    Returns:
        Classes and probabilities; UNKNOWN and NaN where nothing was seen. `landable` can refuse ground but never permit
        it. Ground with heights but without a picture is UNKNOWN as well; its `bears` is `ANYTHING`, its novelty
        `UNLIKE`. Black ground, as in a pit, also has a `landable` of `ANYTHING`.
    """
    found = _classified(elevation, settings, model, tables or Tables(read_net(), read_known()), with_roads)
    known = seen(elevation)
    unpictured = (elevation.views > 0) & ~known

    def of_ground(values: F32, otherwise: float, where: Mask) -> F32:
        return np.where(known, values, np.where(where, np.float32(otherwise), np.float32(np.nan)))

    cover = replace(
        found,
        label=np.where(known, found.label, np.uint8(Terrain.UNKNOWN)).astype(np.uint8),
        landable=of_ground(found.landable, ANYTHING, black_ground(elevation) & unpictured),
        water=of_ground(found.water, np.nan, unpictured),
        novelty=of_ground(found.novelty, UNLIKE, unpictured),
        bears=of_ground(found.bears, ANYTHING, unpictured),
    )
    return cover.with_roofs(found.raised)
