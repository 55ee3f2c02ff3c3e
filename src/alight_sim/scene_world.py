"""The world of a scene: heights, classes and looks made on demand, and the light on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F32, U8
from alight.geometry import Camera, Grid, LocalFrame
from alight.records import InputError, Rig, Terrain
from alight_sim import rasters
from alight_sim.cameras import Eye, Shutter
from alight_sim.coarser import mean_of, mean_shadow, most_of
from alight_sim.exposure import Imaging
from alight_sim.faults import Faults
from alight_sim.kernels.ground import SKIN
from alight_sim.kernels.layers import BLOCK, box_mean, ground_light, sun_margin, tile_block_tops
from alight_sim.light import Light, Sun
from alight_sim.movers import Mover, Moving
from alight_sim.patch import GroundPatch
from alight_sim.rasters import Arrays
from alight_sim.scene import Origin, Scene, built_in, read_scene
from alight_sim.sensors import Sensors
from alight_sim.spans import TrueSpans
from alight_sim.things.base import Box
from alight_sim.tiles import SIDE, Cache, Stack, Tile, TileSource
from alight_sim.truth import SceneTruth
from alight_sim.wires import Hanging
from alight_sim.world import START, Poses

SHADOW_LIMIT = 0.5  # metres: a ray that clears the ground by more is fully lit
SHADOW_REACH = 60.0  # metres: longer shadows end here
HOLLOWS = ((0.5, 2.0), (3.0, 0.5))  # width in metres, gain per metre: hollows of two sizes are darker
CACHE_BYTES = 640 << 20  # of the tiles, and of the patches
MARGIN = 30.0  # metres beyond the extent for which `low` and `high` hold


@dataclass(frozen=True, eq=False)
class _TileSkin:
    """Layers of a tile for the shading, each reduced to S x S blocks of cells."""

    skin: F32  # (S, S, SKIN)
    label: U8  # (S, S) Terrain codes
    look: U8  # (S, S) codes of Look
    tinted: bool

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return self.skin.nbytes + self.label.nbytes + self.look.nbytes


@dataclass(frozen=True, eq=False)
class SceneWorld:
    """Ground to fly over. Truth is available within `extent`; the ground continues beyond it, made on demand.

    All results are pure functions of the scene, the seed and the position, independent of earlier calls and of the
    thread.
    """

    name: str
    description: str
    seed: int
    local: LocalFrame
    source: TileSource
    extent: Box
    light: Light = field(default_factory=Light)
    scene: Scene | None = None
    warnings: tuple[str, ...] = ()  # assumptions about the world
    _tiles: Cache = field(default_factory=lambda: Cache(CACHE_BYTES), repr=False)
    _patches: Cache = field(default_factory=lambda: Cache(CACHE_BYTES), repr=False)
    _eyes: dict[tuple[Camera, int], Eye] = field(default_factory=dict, repr=False)
    start = START

    @cached_property
    def movers(self) -> tuple[Mover, ...]:
        """The cars of the scene: in the pictures, but not in the truth of the ground."""
        traffic = () if self.scene is None else self.scene.traffic
        return tuple(Mover(t, self.height_at, self.seed + 1000 * k) for k, t in enumerate(traffic))

    @property
    def sun(self) -> Sun:
        """The sun at time 0."""
        return self.light.sun_at(0.0)

    @property
    def cell(self) -> float:
        """Metres between cell centres."""
        return self.source.cell

    @cached_property
    def _bounds(self) -> tuple[float, float]:
        west, south, east, north = self.extent
        return self.range((west - MARGIN, south - MARGIN, east + MARGIN, north + MARGIN))

    @property
    def low(self) -> float:
        """Lower bound of the heights in the extent, metres."""
        return self._bounds[0]

    @property
    def high(self) -> float:
        """Upper bound of the heights in the extent, metres."""
        return self._bounds[1]

    def range(self, bounds: Box) -> tuple[float, float]:
        """Return a lower and an upper bound of all heights in a box, metres."""
        return self.source.range(bounds)

    def patch(self, bounds: Box, time: float = 0.0, level: int = 0) -> GroundPatch:
        """Return all layers over a box (west, south, east, north), which is enlarged to whole tiles.

        Args:
            time: time for the position of the sun, s.
            level: all layers but the heights are reduced to blocks of 2^level x 2^level cells, for coarse pictures.
        """
        box, sun = self._tile_box(bounds), self.light.sun_at(time)
        make = partial(self._make_patch, box, sun, level)
        return _patch(self._patches.get((box, sun, level), make, lambda p: p.nbytes))

    def hanging(self, patch: GroundPatch, time: float) -> Hanging | None:
        """Return the spans over a patch, and spans whose shadow may fall on it, at a time (s); None: there are none."""
        x, y = patch.grid.xy()
        box = x[0] - SHADOW_REACH, y[-1] - SHADOW_REACH, x[-1] + SHADOW_REACH, y[0] + SHADOW_REACH
        sun = self.light.sun_at(time)
        found = self._patches.get(
            ("hanging", box, sun),
            lambda: Hanging.of(self.source.spans(box), patch, sun, SHADOW_REACH),
            lambda h: h.nbytes,
        )
        assert isinstance(found, Hanging)
        return found if len(found.ends) else None

    def usual_height(self, bounds: Box) -> float:
        """Return the median of 25 heights in the tiles of a box, metres."""
        box = self._tile_box(bounds)
        e, n = (np.linspace(a * SIDE, (b + 1) * SIDE, 7)[1:-1].astype(int) for a, b in (box[::2], box[1::2]))
        heights = self._patches.get(
            ("usual", box), lambda: [self._height(int(i), int(j)) for i in e for j in n], lambda h: 8 * len(h)
        )
        return float(np.median(heights))

    def height_at(self, east: float, north: float) -> float:
        """Return the height of the surface at a position, metres above the origin."""
        x = (east - self.source.anchor[0]) / self.cell - 0.5
        y = (north - self.source.anchor[1]) / self.cell - 0.5
        i, j = math.floor(x), math.floor(y)
        u, v = x - i, y - j
        corners = [[self._height(i + a, j + b) for a in (0, 1)] for b in (0, 1)]
        return float(np.array([1 - v, v]) @ np.array(corners) @ np.array([1 - u, u]))

    def truth(self, bounds: Box | None = None) -> SceneTruth:
        """Return heights and classes of the cells whose centres lie in the bounds (default: the extent)."""
        west, south, east, north = bounds or self.extent
        e0, n0 = self.source.anchor
        first = math.ceil((west - e0) / self.cell - 0.5 - 1e-6), math.ceil((south - n0) / self.cell - 0.5 - 1e-6)
        last = math.floor((east - e0) / self.cell - 0.5 + 1e-6), math.floor((north - n0) / self.cell - 0.5 + 1e-6)
        layers = self._window(first[0], first[1], last[0], last[1], ("height", "label"))
        grid = self._grid(first[0], last[1], *layers["height"].shape)
        return SceneTruth(grid, layers["height"], layers["label"], self.source.spans(bounds or self.extent))

    def radiance(self, camera: Camera, world_from_cam: Poses, seconds: float, bodies: Sequence[Moving] = ()) -> F32:
        """Return the (H, W, 3) linear light of an exposure of the scene's imaging; black if the lens is underground."""
        key = camera, self.imaging.samples
        if key not in self._eyes:
            self._eyes[key] = Eye(*key)
        try:
            return self._eyes[key].radiance(self, world_from_cam, seconds, Shutter.of(self.imaging), bodies)
        except InputError:
            return np.zeros((camera.height, camera.width, 3), np.float32)

    # -- the vehicle's equipment

    @cached_property
    def _settings(self) -> Scene:
        return self.scene or Scene()

    @property
    def rig(self) -> Rig:
        """The cameras."""
        return self._settings.rig.rig

    @property
    def imaging(self) -> Imaging:
        """Settings of lens and sensor."""
        return self._settings.imaging

    @property
    def sensors(self) -> Sensors:
        """Errors of GPS/INS and IMU."""
        return self._settings.sensors

    @property
    def faults(self) -> Faults:
        """Faults between the shutter and the log."""
        return self._settings.faults

    # -- tiles

    def _tile(self, i: int, j: int) -> Tile:
        tile = self._tiles.get(("ground", i, j), lambda: self.source.tile(i, j), lambda t: t.nbytes)
        assert isinstance(tile, Tile)
        return tile

    def _height(self, i: int, j: int) -> float:
        tile = self._tile(i // SIDE, j // SIDE)
        return float(tile.height[SIDE - 1 - j % SIDE, i % SIDE])

    def _tile_box(self, bounds: Box) -> tuple[int, int, int, int]:
        side, (e0, n0) = SIDE * self.cell, self.source.anchor
        west, south, east, north = bounds
        if not (math.isfinite(sum(bounds)) and west <= east and south <= north):
            raise InputError(
                f"a patch of the world from {west}, {south} to {east}, {north} cannot be; give west, south, east, north"
            )
        near = self.cell  # the surface reaches from centre to centre
        return (
            math.floor((west - near - e0) / side), math.floor((south - near - n0) / side),
            math.floor((east + near - e0) / side), math.floor((north + near - n0) / side),
        )  # fmt: skip

    def _grid(self, i: int, j: int, rows: int, cols: int) -> Grid:
        e0, n0 = self.source.anchor
        return Grid(e0 + (i + 0.5) * self.cell, n0 + (j + 0.5) * self.cell, self.cell, rows, cols)

    def _window(self, i0: int, j0: int, i1: int, j1: int, names: tuple[str, ...]) -> dict[str, Any]:
        """Return layers of the tiles, by their field `names`, for cells i0..i1 to the east and j0..j1 to the north.

        Both ends are included; row 0 is the northernmost one.
        """
        rows, cols = j1 - j0 + 1, i1 - i0 + 1
        out: dict[str, Any] = {}
        for tj in range(j0 // SIDE, j1 // SIDE + 1):
            for ti in range(i0 // SIDE, i1 // SIDE + 1):
                tile = self._tile(ti, tj)
                a, b = max(i0, ti * SIDE), min(i1, ti * SIDE + SIDE - 1)
                c, d = max(j0, tj * SIDE), min(j1, tj * SIDE + SIDE - 1)
                to = slice(j1 - d, j1 - c + 1), slice(a - i0, b - i0 + 1)
                of = slice(SIDE - 1 - (d - tj * SIDE), SIDE - (c - tj * SIDE)), slice(a - ti * SIDE, b - ti * SIDE + 1)
                for name in names:
                    _copy(out, name, getattr(tile, name), to, of, (rows, cols))
        return out

    # -- light

    def _make_patch(self, box: tuple[int, int, int, int], sun: Sun, level: int) -> GroundPatch:
        i0, j0, i1, j1 = box[0] * SIDE, box[1] * SIDE, (box[2] + 1) * SIDE - 1, (box[3] + 1) * SIDE - 1
        height = self._window(i0, j0, i1, j1, ("height",))["height"]
        shape, side = (height.shape[0] >> level, height.shape[1] >> level), SIDE >> level
        layers: dict[str, Any] = {}
        tinted = False
        for tj in range(box[1], box[3] + 1):
            for ti in range(box[0], box[2] + 1):
                rows = slice((box[3] - tj) * side, (box[3] - tj + 1) * side)
                cols = slice((ti - box[0]) * side, (ti - box[0] + 1) * side)
                key = ("skin", ti, tj, sun, level)
                tile = self._tiles.get(key, partial(self._make_skin, ti, tj, sun, level), lambda t: t.nbytes)
                for name in ("skin", "label", "look"):
                    _copy(layers, name, getattr(tile, name), (rows, cols), slice(None), shape)
                tinted |= tile.tinted
        looks = layers["look"] if layers["look"].any() else None
        grid = self._grid(i0, j1, *height.shape)
        return GroundPatch(grid, height, layers["label"], layers["skin"], looks, tinted, level)

    def _make_skin(self, i: int, j: int, sun: Sun, level: int) -> _TileSkin:
        """Return light, class, look and tint of tile (i, j), reduced to blocks of 2^level x 2^level cells."""
        tile, side = self._tile(i, j), SIDE >> level
        codes = most_of(tile.label.astype(np.uint16) + 16 * tile.look.astype(np.uint16), level)
        sky = self._tiles.get(("sky", i, j, level), lambda: mean_of(self._make_sky(i, j), level), lambda a: a.nbytes)
        skin = np.ones((side, side, SKIN), np.float32)
        skin[..., :2], skin[..., 3] = sky[..., :2], sky[..., 2]
        skin[..., 2], skin[..., 4] = mean_shadow(self._make_shadow(i, j, sun), level), mean_of(tile.depth, level)
        if tile.tint is not None:
            skin[..., 5:] = mean_of(tile.tint, level)
        return _TileSkin(skin, (codes % 16).astype(np.uint8), (codes // 16).astype(np.uint8), tile.tint is not None)

    def _make_sky(self, i: int, j: int) -> F32:
        halves = [round(0.5 * width / self.cell) for width, _ in HOLLOWS]
        apron = max(halves) + 1
        a, b = i * SIDE - apron, j * SIDE - apron
        height = self._window(a, b, a + SIDE + 2 * apron - 1, b + SIDE + 2 * apron - 1, ("height",))["height"]
        means = np.empty((len(halves), *height.shape), np.float32)
        for mean, half in zip(means, halves, strict=True):
            box_mean(height, half, mean)
        out = np.empty((SIDE, SIDE, 3), np.float32)
        ground_light(height, means, apron, apron, self.cell, np.array([gain for _, gain in HOLLOWS]), out)
        return out

    def _make_shadow(self, i: int, j: int, sun: Sun) -> F32:
        """Return the (SIDE, SIDE) shadow margins of tile (i, j), metres; see `kernels.layers.sun_margin`."""
        direction, flat = sun.direction, math.hypot(*sun.direction[:2])
        out = np.full((SIDE, SIDE), SHADOW_LIMIT, np.float32)
        if flat < 1e-6:
            return out
        east, north = direction[0] / flat, direction[1] / flat
        steep = self.cell * math.tan(sun.elevation)
        reach = min(SHADOW_REACH, (self.high - self.low) / math.tan(sun.elevation)) / self.cell
        de, dn = math.ceil(abs(east) * reach) + 1, math.ceil(abs(north) * reach) + 1
        i0, i1 = i * SIDE - (de if east < 0 else 0), i * SIDE + SIDE - 1 + (de if east > 0 else 0)
        j0, j1 = j * SIDE - (dn if north < 0 else 0), j * SIDE + SIDE - 1 + (dn if north > 0 else 0)
        height = self._window(i0, j0, i1, j1, ("height",))["height"]
        step = np.array([east, -north, steep])
        row, col = j1 - (j * SIDE + SIDE - 1), i * SIDE - i0
        tops = np.empty([-(-n // BLOCK) for n in height.shape], np.float32)
        tile_block_tops(height, tops)
        sun_margin(height, tops, row, col, float(height.max()), step, SHADOW_LIMIT, out)
        return out


def _patch(value: Any) -> GroundPatch:
    assert isinstance(value, GroundPatch)
    return value


def _copy(out: dict[str, Any], name: str, layer: Any, to: Any, of: Any, shape: tuple[int, int]) -> None:
    if name not in out:
        out[name] = np.empty((*shape, *layer.shape[2:]), layer.dtype)
    out[name][to] = layer[of]


def build(scene: str | Path | Scene, seed: int = 0) -> SceneWorld:
    """Build the world of a scene, given by a built-in name, a file or a model; equal seeds give equal ground.

    Raises:
        InputError: the scene does not exist or has an error.
    """
    if not isinstance(scene, Scene):
        known = built_in()
        if str(scene) not in known and not Path(scene).suffix:
            raise InputError(f"no scene is called {str(scene)!r}; use one of: {', '.join(known)}, or a YAML file")
        scene = read_scene(known.get(str(scene), Path(scene)), seed)
    local, extent, raster = scene.origin.local, scene.ground.extent, scene.ground.raster
    if raster is None:
        return SceneWorld(
            scene.name, scene.description, seed, local, Stack(scene.ground, seed), extent, scene.light, scene
        )
    if "origin" not in scene.model_fields_set:
        local = rasters.raster_middle(raster)
    if "size" not in scene.ground.model_fields_set:
        extent = rasters.reach(raster, local, scene.ground.cell)
    under = rasters.load_rasters(raster, local, extent, scene.ground.cell)
    source = Stack(scene.ground, seed, under)
    return SceneWorld(scene.name, scene.description, seed, local, source, extent, scene.light, scene, under.warnings)


def world_of(
    grid: Grid,
    height: F32,
    label: U8 | None = None,
    depth: F32 | None = None,
    look: U8 | None = None,
    tint: F32 | None = None,
    light: Light | None = None,
    seed: int = 0,
    spans: TrueSpans | None = None,
) -> SceneWorld:
    """Build a world from arrays on a grid; beyond the grid its edge cells repeat.

    `height`, `label` (None: bare), `depth` of water and `look`: (R, C). `tint`: (R, C, 3). See `alight_sim.tiles.Tile`.
    """
    label = np.full(grid.shape, Terrain.BARE, np.uint8) if label is None else label
    source = Arrays(grid, np.asarray(height, np.float32), label, depth, look, tint, spans or TrueSpans())
    return SceneWorld("arrays", "", seed, Origin().local, source, source.extent, light or Light())
