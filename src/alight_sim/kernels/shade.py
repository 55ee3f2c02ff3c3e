"""Radiance from a hit point to a pixel: look by world position, sun with shadow, clouds, haze, moving water.

Blocks of 64 pixels of a row go through passes that are vector loops (`alight_sim.kernels.block`). Linear radiance; a
white flat surface in the sun is about 1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange
from alight_sim.kernels.block import F0, F1, F32, F64, I32, B, Slot, f32, fill
from alight_sim.kernels.foliage import foliage, sway
from alight_sim.kernels.ground import look_up_layers, wander_borders
from alight_sim.kernels.illuminate import (
    WIND,
    car_shadows,
    dye,
    face_normals,
    haze,
    illuminate,
    slope_normals,
    sunshine,
)
from alight_sim.kernels.litter import small_things
from alight_sim.kernels.texture import TRAITS, Trait, colours, laid, load_looks, patches, texture_detail
from alight_sim.kernels.water import dive, refract, scum, water_light, waves

U8 = NDArray[np.uint8]
I16 = NDArray[np.int16]

PAINT, GLASS = 30, 34  # codes of alight_sim.looks.Look


@kernel
def _turn(buf: F64, directions: F32, depth: F64, r: int, first: int, turn: F64) -> None:
    """Fill four slots of `buf` for row `r` from column `first`: x, y, z of the rays in the world, ground depth."""
    count = min(B, depth.shape[1] - first)
    for i in range(count):
        d0, d1, d2 = directions[r, first + i, 0], directions[r, first + i, 1], directions[r, first + i, 2]
        for k in range(3):
            buf[k * B + i] = turn[k, 0] * d0 + turn[k, 1] * d1 + turn[k, 2] * d2
        buf[3 * B + i] = depth[r, first + i]
    for k in range(4):  # beyond the picture: its last pixel
        for i in range(count, B):
            buf[k * B + i] = buf[k * B + count - 1]


@kernel
def _settle_base(ways: F64, centre: F64, base: F64) -> bool:
    """Set `base` to the block's first ground point, floored to metres; return whether the block has one."""
    for i in range(B):
        t = ways[3 * B + i]
        if t > 0.0:
            for k in range(3):
                base[k] = math.floor(centre[k] + t * ways[k * B + i])
            return True
    return False


@kernel
def _aim(
    buf: F32, ways: F64, directions: F32, depth: F64, r: int, first: int, centre: F64, turn: F64, pixel: float,
    level: float, base: F64,
) -> bool:  # fmt: skip
    """Fill positions, directions to the camera, distances (-1: sky) and footprints; return whether ground is seen.

    `r`, `first`: row and first column of the block; `ways` (4 B,): scratch.
    """
    _turn(ways, directions, depth, r, first, turn)
    for i in range(B):  # where the patch ends, the plane continues
        t, z = ways[3 * B + i], ways[2 * B + i]
        ways[3 * B + i] = (level - centre[2]) / z if t < 0.0 and z < -1e-3 else t
    seen = _settle_base(ways, centre, base)
    for i in range(B):
        x, y, z, t = ways[i], ways[B + i], ways[2 * B + i], ways[3 * B + i]
        length, ground = np.sqrt(x * x + y * y + z * z), t > 0.0
        there = t if ground else 0.0
        buf[Slot.X + i] = f32(centre[0] + there * x - base[0]) if ground else F0  # sky: any position
        buf[Slot.Y + i] = f32(centre[1] + there * y - base[1]) if ground else F0
        buf[Slot.Z + i] = f32(centre[2] + there * z - base[2]) if ground else F0
        buf[Slot.VX + i], buf[Slot.VY + i], buf[Slot.VZ + i] = f32(-x / length), f32(-y / length), f32(-z / length)
        buf[Slot.DIST + i] = f32(t * length) if ground else f32(-1.0)
        buf[Slot.FOOT + i] = f32(max(there * pixel, 1e-4))
    return seen


@kernel
def _unfold(buf: F32, base: F64) -> None:
    """Fill the texture coordinates TX, TY with a map from above on ground and roofs, and from the side on walls."""
    x0, y0 = f32(base[0] - 512.0 * math.floor(base[0] / 512.0)), f32(base[1] - 512.0 * math.floor(base[1] / 512.0))
    z0 = f32(base[2])
    for i in range(B):
        e, n = abs(buf[Slot.SLOPE_E + i]), abs(buf[Slot.SLOPE_N + i])
        leafy = (
            F1 if buf[Slot.PARAM + Trait.DEEP * B + i] > F0 else F0
        )  # leaves have no face: askew through their volume
        wall = F1 - leafy if max(e, n) > f32(1.3) else F0
        east = wall if e > n else F0
        north = wall - east
        x, y, z = buf[Slot.X + i], buf[Slot.Y + i], buf[Slot.Z + i] + z0  # true height: blocks must agree
        side_x, side_y = y + y0 - x0 + f32(300), z - y0 + f32(0.3) * (x + x0)  # of a wall that faces east or west
        front_x, front_y = x - f32(300), z - y0 + f32(0.3) * (y + y0)
        buf[Slot.TX + i] = (F1 - wall) * (x + leafy * f32(0.8) * z) + east * side_x + north * front_x
        buf[Slot.TY + i] = (F1 - wall) * (y - leafy * f32(0.5) * z) + east * side_y + north * front_y
        buf[Slot.FOOT + i] *= F1 + wall


@kernel
def _board(buf: F32, faces: I16, r: int, first: int, boxes: F64, base: F64, look: I32) -> bool:
    """Set look, texture and paint of the block's pixels on cars; return whether there are any. See `cast_boxes`."""
    any_car, last = False, faces.shape[1] - 1
    for i in range(B):
        code = int(faces[r, min(first + i, last)])
        buf[Slot.FACE + i] = f32(code)
        if code == 0:
            continue
        any_car = True
        box = boxes[code >> 3]
        dx, dy, dz = (
            base[0] + buf[Slot.X + i] - box[0],
            base[1] + buf[Slot.Y + i] - box[1],
            base[2] + buf[Slot.Z + i] - box[2],
        )
        u, v = box[3] * dx + box[4] * dy, box[3] * dy - box[4] * dx
        look[i] = GLASS if box[11] > 0.5 and (code & 7) != 1 else PAINT
        buf[Slot.TX + i], buf[Slot.TY + i] = f32(u + 20.0 * (code >> 3) + v * 0.3), f32(v + dz)
        buf[Slot.SLOPE_E + i], buf[Slot.SLOPE_N + i], buf[Slot.MARGIN + i], buf[Slot.WATER + i] = F0, F0, F1, F0
        for k in range(3):
            buf[Slot.TINT_R + k * B + i] = f32(box[8 + k])
    return any_car


@kernel
def _put(buf: F32, weight: np.float32, r: int, first: int, out: F32) -> None:
    for i in range(min(B, out.shape[1] - first)):
        out[r, first + i, 0] += weight * buf[Slot.RED + i]
        out[r, first + i, 1] += weight * buf[Slot.GREEN + i]
        out[r, first + i, 2] += weight * buf[Slot.BLUE + i]


@kernel
def _texture(buf: F32, base: F64, lights: F64, time: float, seed: int, wet: bool) -> None:
    _unfold(buf, base)
    sway(buf, base, lights[WIND : WIND + 2], time, seed + 60)
    if wet:
        refract(buf)
    foliage(buf, base, seed + 400)
    patches(buf, base, seed + 500)
    texture_detail(buf, base, seed + 3)
    small_things(buf, base, lights, seed + 700)
    colours(buf, base, seed + 800)
    laid(buf, base, seed + 900)


@parallel_kernel
def shade(
    height: F32, label: U8, cells: U8, skin: F32, place: F64, looks: F32, wet: F32, centres: F64, directions: F32,
    turns: F64, depth: F64, faces: I16, boxes: F64, pixel: float, level: float, lights: F64, times: F64, seed: int,
    weight: float, out: F32,
) -> None:  # fmt: skip
    """Add `weight` times each pixel's linear radiance to `out` (H, W, 3).

    `height` (R, C), empty if the layers are coarser; `label` (R, C); `cells` (R, C, 2): look, and bits about its
    neighbours (`ground.STEP`, `ground.PLAIN`); `skin` (R, C, 8): slope east, slope north, shadow margin, open sky,
    water depth, tint. `place`: east and north of cell (0, 0), size of a cell. `looks` (L, TRAITS), `wet` (L,) 1 for
    water:
    see `alight_sim.materials`. `centres` (N, 3), `turns` (N, 3, 3), `times` (N,) seconds, `boxes` (N, M, 12): of the
    whole picture (N = 1) or of each row; `directions` (H, W, 3) with z = 1; `depth` (H, W) from `cast_rays`; `faces`
    (H, W) from `cast_boxes`; `pixel`: angle of a pixel, rad; `level`: height of the plane that continues beyond the
    patch; `lights` (LIGHTS,): see `illuminate`.
    """
    lights32 = lights.astype(np.float32)
    for r in prange(out.shape[0]):
        row = np.int64(r)
        n = row if centres.shape[0] > 1 else np.int64(0)
        buf, look, base = np.empty(Slot.PARAM + TRAITS * B, np.float32), np.empty(B, np.int32), np.zeros(3)
        ways = np.empty(4 * B)
        fill(buf, Slot.WATER, 0.0)
        loaded = -1
        for first in range(0, out.shape[1], B):
            if not _aim(buf, ways, directions, depth, row, first, centres[n], turns[n], pixel, level, base):
                fill(buf, Slot.DIST, -1.0)
                haze(buf, lights32)
                _put(buf, f32(weight), row, first, out)
                continue
            wander_borders(buf, base)
            look_up_layers(buf, height, label, cells, skin, place, base, wet, look)
            cars = boxes.shape[1] > 0 and _board(buf, faces, row, first, boxes[n], base, look)
            under = dive(buf, looks, look)
            if under:
                waves(buf, base, lights[WIND : WIND + 2], times[n], seed + 40)
            loaded = load_looks(buf, looks, look, Trait.BED, loaded)
            _texture(buf, base, lights, times[n], seed, under)
            dye(buf)
            sunshine(buf, base, lights, times[n], seed + 950)
            if boxes.shape[1] > 0:
                car_shadows(buf, boxes[n], base, lights)
            slope_normals(buf)
            if cars:
                face_normals(buf, boxes[n])
            if under:
                water_light(buf, lights)
                scum(buf, base, lights[WIND : WIND + 2], times[n], seed + 980)
            illuminate(buf, lights32)
            haze(buf, lights32)
            _put(buf, f32(weight), row, first, out)
