"""Pictures of level ground with a thin wire over it, for the tests of wires: fast, one camera straight down."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, F64
from alight.geometry import Camera, Grid, Pose
from alight.records import ElevationMap, Flag, View

LENS = Camera(320, 240, 320.0, 320.0, 159.5, 119.5)
DOWN = np.diag([1.0, -1.0, -1.0])  # x right is east, the picture's top is north
UP, SPACING, COUNT = 20.0, 0.9, 12  # metres above the ground; between views; number of views
TEXEL, SIDE = 0.05, 800  # metres, and texels a side, of the painted ground


def painted(seed: int) -> F32:
    """Grey levels of the ground (800, 800), 40 x 40 m about the origin: grains of all sizes from 0.1 m on."""
    rng, out = np.random.default_rng(seed), np.full((SIDE, SIDE), 120.0, np.float32)
    for sigma in (2.0, 5.0, 14.0):
        grain = cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)).astype(np.float32), (0, 0), sigma)
        out += 12 * grain / grain.std()
    return out


def picture(centre: F64, ground: F32, wire: F64 | None, across: float, seed: int) -> View:
    """One view from `centre`, (3,) metres; `wire`: (2, 3) metres, both ends, dark and `across` pixels wide."""
    u, v = np.meshgrid(np.arange(LENS.width, dtype=np.float32), np.arange(LENS.height, dtype=np.float32))
    east, north = centre[0] + (u - LENS.cu) * centre[2] / LENS.fu, centre[1] - (v - LENS.cv) * centre[2] / LENS.fv
    at = (east / TEXEL + SIDE / 2).astype(np.float32), (SIDE / 2 - north / TEXEL).astype(np.float32)
    grey = cv2.remap(ground, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    if wire is not None:
        away = wire - centre
        ends = np.column_stack(
            [LENS.cu + LENS.fu * away[:, 0] / -away[:, 2], LENS.cv - LENS.fv * away[:, 1] / -away[:, 2]]
        )
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        along, beside = (
            (u - ends[0, 0]) * way[0] + (v - ends[0, 1]) * way[1],
            (u - ends[0, 0]) * way[1] - (v - ends[0, 1]) * way[0],
        )
        within = (along > 0) & (along < np.linalg.norm(ends[1] - ends[0]))
        cover = within * np.clip(0.5 + across / 2 - np.abs(beside), 0, min(across, 1.0))
        grey = grey * (1 - cover) + 20 * cover
    grey = grey + np.random.default_rng(seed).normal(0, 1.5, grey.shape)
    image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return View(seed * 100_000_000, 0, image, LENS, Pose(DOWN, centre))


def views(seed: int, wire: F64 | None = None, across: float = 0.7) -> list[View]:
    """Views from a flight to the north-east over painted ground."""
    ground, step = painted(seed), SPACING / np.sqrt(2)
    places = (np.arange(COUNT) - 0.5 * (COUNT - 1))[:, None] * (step, step)
    return [picture(np.array([e, n, UP]), ground, wire, across, k) for k, (e, n) in enumerate(places.tolist())]


def level_map(cell: float = 0.15, side: int = 160) -> ElevationMap:
    """The map of the level ground, 24 x 24 m about the origin."""
    zeros, shape = np.zeros((side, side), np.float32), (side, side)
    grid = Grid(-0.5 * cell * (side - 1), 0.5 * cell * (side - 1), cell, *shape)
    flags, seen, rgb = np.full(shape, Flag(0), np.uint16), np.full(shape, 9, np.uint8), np.zeros((*shape, 3), np.uint8)
    return ElevationMap(grid, zeros, zeros + np.float32(0.02), flags, seen, rgb, zeros, zeros + np.float32(cell))
