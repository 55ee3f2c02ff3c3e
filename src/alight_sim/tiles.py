"""The ground in tiles. Each tile is a pure function of the scene, the seed and the tile's indices."""

from __future__ import annotations

import math
import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, Mask
from alight_sim.kernels.stamps import Column
from alight_sim.relief import FractalRelief, noise
from alight_sim.spans import TrueSpans
from alight_sim.things.base import Box, Layer, Scattered, Sheet, blank_things, overlapping, terrain_named

if TYPE_CHECKING:
    from alight_sim.scene import SceneGround

SIDE = 256  # cells of a tile's side
BLOCK = 25.6  # metres: things are scattered block by block, whatever the cell size
RING = 8  # points around a thing's foot where the ground is sampled


@dataclass(frozen=True, eq=False)
class Tile:
    """Layers of SIDE x SIDE cells."""

    height: F32  # metres above the origin
    label: U8
    depth: F32  # metres of water
    look: U8  # codes of Look
    tint: F32 | None  # (SIDE, SIDE, 3) factor on the look's reflectance; None: 1 everywhere

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        parts = (self.height, self.label, self.depth, self.look, self.tint)
        return sum(p.nbytes for p in parts if p is not None)


class TileSource(Protocol):
    """Interface of a source of tiles."""

    @property
    def cell(self) -> float:
        """Size of a cell, metres."""

    @property
    def anchor(self) -> tuple[float, float]:
        """East and north of the south-west corner of tile (0, 0), metres."""

    def tile(self, i: int, j: int) -> Tile:
        """Return the tile whose south-west corner is SIDE * cell * (i east, j north) from the anchor."""

    def range(self, box: Box) -> tuple[float, float]:
        """Return a lower and an upper bound of all heights in the box, metres."""

    def spans(self, box: Box) -> TrueSpans:
        """Return the spans in the air that come into the box."""


class Under(Protocol):
    """Interface of rasters that lie under the layers instead of relief."""

    def heights(self, x: F64, y: F64) -> F64:
        """Return heights at positions of any shape, metres."""

    def lay(self, sheet: Sheet) -> None:
        """Set the classes and colours of the sheet."""

    def range(self, box: Box) -> tuple[float, float]:
        """Return the lowest and highest height in a box (west, south, east, north), metres."""


class Cache:
    """Cache of the most recently used values, limited by their size in bytes."""

    def __init__(self, limit: int) -> None:
        self.limit, self.used = limit, 0
        self._held: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = threading.RLock()

    def get(self, key: Hashable, make: Callable[[], Any], size: Callable[[Any], int]) -> Any:
        """Return the value of a key, made by `make` if the cache does not hold it; `size` returns a value's bytes."""
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
                return self._held[key][0]
            value = make()
            self._held[key] = (value, size(value))
            self.used += self._held[key][1]
            while self.used > self.limit and len(self._held) > 1:
                self.used -= self._held.popitem(last=False)[1][1]
            return value


def _mixed(*numbers: NDArray[np.int64] | int) -> NDArray[np.uint64]:
    """Return a hash of several integers, element by element, with well mixed bits (splitmix64)."""
    h = np.uint64(0x9E3779B97F4A7C15) * np.ones(np.broadcast_shapes(*(np.shape(n) for n in numbers)), np.uint64)
    for n in numbers:
        h = (h ^ np.asarray(n, np.int64).astype(np.uint64)) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(29))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(32)
    return np.asarray(h)


class Lay:
    """One layer in one world, with its random stream, its things, and access to the ground of the layers before it."""

    def __init__(self, stack: Stack, layer: Layer, index: int, seed: int) -> None:
        self.stack, self.layer, self.index, self.seed = stack, layer, index, seed
        self._kept: dict[str, Any] = {}
        self.candidates = lru_cache(4096)(self._candidates)
        self.block = lru_cache(4096)(self._block)

    def keep(self, key: str, make: Callable[[], F64]) -> F64:
        """Return the value of a key; `make` computes it at the first call."""
        if key not in self._kept:
            self._kept[key] = make()
        return np.asarray(self._kept[key])

    def choose(self, i: NDArray[np.int64], j: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Return a pseudo-random number below `count` for every cell (i, j) of a lattice."""
        return np.asarray((_mixed(i, j, self.seed) % np.uint64(count)).astype(np.int64))

    def before(self, x: F64, y: F64) -> Sheet:
        """Return the solid ground at positions (R, C) before this layer is applied."""
        return self.stack.ground(x, y, upto=self.index)

    @property
    def scattered(self) -> Scattered:
        """The layer, which must be a `Scattered` one."""
        assert isinstance(self.layer, Scattered)
        return self.layer

    def things(self, box: Box) -> F64:
        """Return the (N, COLUMNS) things that reach into a box, in an order that does not depend on the box."""
        found = [self.block(i, j) for i, j in _blocks(box, self.scattered.largest)]
        return overlapping(np.concatenate(found), box)

    def _candidates(self, i: int, j: int) -> tuple[F64, int]:
        """Return the things of block (i, j) before ground is sampled, and how many of them are at given positions."""
        layer = self.scattered
        named = np.array(layer.at, dtype=np.float64).reshape(-1, 2)
        named = named[(np.floor(named / BLOCK) == (i, j)).all(axis=1)]
        rng = np.random.default_rng([self.seed, i & 0xFFFFFFFF, j & 0xFFFFFFFF])
        count = int(rng.poisson(layer.density * BLOCK**2 * 1e-4))
        places = (np.array([i, j]) + rng.random((count, 2))) * BLOCK
        if layer.within is not None:
            west, south, east, north = layer.within
            inside = (places >= (west, south)).all(axis=1) & (places <= (east, north)).all(axis=1)
            places = places[inside]
        things = blank_things(np.concatenate([named, places]))
        layer.draw(rng, things)
        return things, len(named)

    def _block(self, i: int, j: int) -> F64:
        """Return the parts of the things of block (i, j) that found a site, with the ground level at their feet."""
        things, named = self.candidates(i, j)
        if not len(things):
            return things
        stays = np.ones(len(things), bool)
        level, allowed = self._feet(i, j)
        things = things.copy()
        things[:, Column.LEVEL] = level
        stays[named:] = allowed[named:] & self._has_room(things, i, j)[named:]
        stays[named:] &= self._in_clump(things[named:]) & self.scattered.kept(things[named:], self.seed)
        rng = np.random.default_rng([self.seed, i & 0xFFFFFFFF, j & 0xFFFFFFFF, 1])
        return self.scattered.parts(rng, np.asarray(things[stays]))

    def _in_clump(self, things: F64) -> Mask:
        layer = self.scattered
        if layer.clump == 1.0 or not len(things):
            return np.ones(len(things), bool)
        field = noise(
            things[:, Column.EAST], things[:, Column.NORTH], self.seed, layer.clump_size, 0.2 * layer.clump_size
        )
        return np.asarray(field > NormalDist().inv_cdf(1.0 - layer.clump))

    def ring(self, i: int, j: int) -> tuple[F64, F64]:
        """Return (N, 1 + RING) east, north of ground samples for things of block (i, j): the centre, then a ring."""
        things = self.candidates(i, j)[0]
        turn = 2.0 * math.pi * np.arange(RING) / RING
        reach = things[:, Column.REACH, None] * (1.0 if self.scattered.founded else 0.5)
        x = things[:, Column.EAST, None] + np.concatenate([0 * reach, reach * np.cos(turn)], axis=1)
        return x, things[:, Column.NORTH, None] + np.concatenate([0 * reach, reach * np.sin(turn)], axis=1)

    @property
    def shapes(self) -> bool:
        """Whether the layer changes the solid ground; if so, its things stand on the ground of the layers before it."""
        return type(self.layer).shape is not Layer.shape

    def _feet(self, i: int, j: int) -> tuple[F64, Mask]:
        """Return for each thing of block (i, j) the ground level, and whether the ground around is allowed; (N,)."""
        if self.shapes:
            sheet = self.before(*self.ring(i, j))
            ground, label, look = sheet.ground, sheet.label, sheet.look
        else:
            ground, label, look = self.stack.feet(i, j)[self.index]
        allowed: Mask = np.asarray(np.isin(label, [terrain_named(k) for k in self.scattered.upon]).all(axis=1))
        if self.scattered.not_on:
            allowed &= ~np.isin(look, self.scattered.not_on).any(axis=1)
        if self.scattered.founded:
            return np.asarray(ground.max(axis=1)), allowed
        return np.asarray(ground.mean(axis=1) if self.shapes else ground[:, 0]), allowed

    def _has_room(self, things: F64, i: int, j: int) -> Mask:
        """Return the (N,) mask of things of block (i, j) that overlap no thing of earlier layers or of higher rank."""
        room = np.ones(len(things), bool)
        if not self.scattered.apart:
            return room
        reach = float(things[:, Column.REACH].max())
        box = (i * BLOCK, j * BLOCK, (i + 1) * BLOCK, (j + 1) * BLOCK)
        for other in self.stack.lays[: self.index + (1 if self.scattered.founded else 0)]:
            if not (isinstance(other.layer, Scattered) and other.layer.apart):
                continue
            around = [other.candidates(*b)[0] for b in _blocks(box, reach + other.layer.largest)]
            theirs = np.concatenate(around)
            away = np.hypot(
                things[:, None, Column.EAST] - theirs[:, Column.EAST],
                things[:, None, Column.NORTH] - theirs[:, Column.NORTH],
            )
            close = away < things[:, None, Column.REACH] + theirs[:, Column.REACH]
            if other is self:
                close &= (away > 0.0) & (_first(theirs) > _first(things)[:, None])
            room &= ~close.any(axis=1)
        return room


def _first(things: F64) -> F64:
    """Return the (N,) pseudo-random ranks of things; of two that overlap, the thing of higher rank stays."""
    return np.asarray((things[:, Column.EAST] * 977.131 + things[:, Column.NORTH] * 331.717) % 1.0)


def _blocks(box: Box, reach: float) -> list[tuple[int, int]]:
    west, south, east, north = (
        math.floor(v / BLOCK) for v in (box[0] - reach, box[1] - reach, box[2] + reach, box[3] + reach)
    )
    return [(i, j) for j in range(south, north + 1) for i in range(west, east + 1)]


class Stack:
    """Source of tiles from a scene's ground section: relief, then every layer in order."""

    anchor: tuple[float, float] = (0.0, 0.0)

    def __init__(self, ground: SceneGround, seed: int, raster: Under | None = None) -> None:
        self.spec, self.seed, self.cell, self.raster = ground, seed, ground.cell, raster
        self.streams = [self._stream("relief", k) for k in range(len(ground.relief))]
        self.feet = lru_cache(1024)(self._feet)
        kinds: list[str] = []
        self.lays: list[Lay] = []
        for index, layer in enumerate(ground.layers):
            self.lays.append(Lay(self, layer, index, self._stream(layer.thing, kinds.count(layer.thing))))
            kinds.append(layer.thing)

    def _stream(self, name: str, count: int) -> int:
        """Return the seed of the layer of index `count` among those named `name`; other layers have no influence."""
        state = np.random.SeedSequence([self.seed, zlib.crc32(name.encode()), count]).generate_state(1)
        return int(state[0]) & 0x7FFFFFFF

    def base(self, x: F64, y: F64) -> F64:
        """Return the heights of slope, raster and relief alone at positions `x`, `y` of any shape, metres."""
        out = self.spec.fall(x, y)
        if self.raster is not None:
            out += self.raster.heights(x, y)
        for relief, seed in zip(self.reliefs, self.streams, strict=False):
            relief.add(x, y, seed, out)
        return out

    @property
    def reliefs(self) -> tuple[FractalRelief, ...]:
        """Relief of the ground; over a raster, only relief that the scene gives."""
        return () if self.raster is not None and "relief" not in self.spec.model_fields_set else self.spec.relief

    def ground(self, x: F64, y: F64, upto: int | None = None, cell: float = 0.0) -> Sheet:
        """Return the solid ground at positions (R, C), after the layers before index `upto` (None: all layers).

        `cell`: see `Sheet`.
        """
        sheet = Sheet.blank(x, y, terrain_named(self.spec.cover), cell)
        sheet.ground = self.base(x, y)
        sheet.look[:], sheet.tint[:] = self.spec.look, self.spec.tint
        if self.raster is not None:
            self.raster.lay(sheet)
        for lay in self.lays[:upto]:
            lay.layer.shape(sheet, lay)
        return sheet

    def _feet(self, i: int, j: int) -> dict[int, tuple[F64, U8, U8]]:
        """Return ground, classes and looks at the rings of block (i, j), by index of layers that change no ground."""
        standing = [lay for lay in self.lays if isinstance(lay.layer, Scattered) and not lay.shapes]
        rings = [lay.ring(i, j) for lay in standing]
        sheet = self.ground(np.concatenate([r[0] for r in rings]), np.concatenate([r[1] for r in rings]))
        cuts = np.cumsum([len(r[0]) for r in rings])[:-1]
        layers = (np.split(layer, cuts) for layer in (sheet.ground, sheet.label, sheet.look))
        parts = zip(*layers, strict=True)
        return {lay.index: part for lay, part in zip(standing, parts, strict=True)}

    def tile(self, i: int, j: int) -> Tile:
        """Return the tile that is `i` tiles east and `j` tiles north of the anchor."""
        k = np.arange(SIDE)
        x, y = np.meshgrid((i * SIDE + k + 0.5) * self.cell, ((j + 1) * SIDE - k - 0.5) * self.cell)
        sheet = self.ground(x, y, cell=self.cell)
        sheet.height = sheet.ground.copy()
        for lay in self.lays:
            lay.layer.cover(sheet, lay)
        for lay in self.lays:
            lay.layer.stand(sheet, lay)
        tint = sheet.tint if (sheet.tint != 1.0).any() else None
        height, depth = sheet.height.astype(np.float32), sheet.depth.astype(np.float32)
        return Tile(height, sheet.label, depth, sheet.look, tint)

    def spans(self, box: Box) -> TrueSpans:
        """Return the spans in the air that come into a box."""
        return TrueSpans.joined(lay.layer.hang(box, lay) for lay in self.lays).within(box)

    def range(self, box: Box) -> tuple[float, float]:
        """Return a lower and an upper bound of all heights in a box, metres, estimated from coarse samples."""
        west, south, east, north = box
        count = [min(200, 2 + math.ceil((b - a) / 4.0)) for a, b in ((west, east), (south, north))]
        base = self.base(*np.meshgrid(np.linspace(west, east, count[0]), np.linspace(south, north, count[1])))
        if self.raster is not None:  # between the coarse samples any height is possible
            low, high = self.raster.range(box)
            base = np.concatenate([base.ravel() - (high - low), base.ravel() + (high - low)])
        fine = 4.0 * sum(float(a[w < 32.0].sum()) for w, a in (r.octaves() for r in self.reliefs))
        shapers = [layer.rise for layer in self.spec.layers if type(layer).shape is not Layer.shape]
        tallest = max((layer.rise[1] for layer in self.spec.layers), default=0.0)
        lowest, highest = sum(r[0] for r in shapers), sum(r[1] for r in shapers) + tallest
        return float(base.min()) - 0.5 * fine - lowest, float(base.max()) + 0.5 * fine + highest
