"""Small things on the ground, smaller than a cell of the height layer: stones, leaves, tufts, each with its shadow."""

from __future__ import annotations

import math

import numpy as np

from alight.compiled import kernel
from alight_sim.kernels.block import (
    F0,
    F1,
    F2,
    F32,
    F64,
    B,
    Slot,
    copy,
    f32,
    fill,
    i32,
    largest,
    noise_lattice,
    smallest,
    smoothstep,
    u32,
)
from alight_sim.kernels.noise import column32, floor32, point32, seed32
from alight_sim.kernels.texture import Trait

SMALL_THINGS = (0.012, 0.03, 0.08, 0.22)  # metres, largest radius of each size class


@kernel
def _scatter(
    buf: F32, radius: np.float32, place: tuple[np.float32, np.float32, np.int32, np.int32], sun: F32,
    seed: np.uint32,
) -> None:  # fmt: skip
    u0, v0, i0, j0 = place
    cell = f32(5.5) * radius
    scale, unit = F1 / cell, f32(1 / 255)
    low = u32(0xFF)
    sx, sy, reach = sun[0], sun[1], sun[2]
    for i in range(B):
        u, v = u0 + buf[Slot.TX + i] * scale, v0 + buf[Slot.TY + i] * scale
        a, b = floor32(u), floor32(v)
        h = point32(column32(i32(a + i0), seed), i32(b + j0))
        h2 = u32(u32(h ^ u32(h >> u32(15))) * u32(0x2C1B3C6D))
        there = F1 if f32(u32(h & low)) < f32(256) * buf[Slot.N + i] else F0
        x = (u - f32(a) - f32(0.3) - f32(0.4) * unit * f32(u32(u32(h >> u32(8)) & low))) * cell
        y = (v - f32(b) - f32(0.3) - f32(0.4) * unit * f32(u32(u32(h >> u32(16)) & low))) * cell
        x += y * (unit * f32(u32(h2 >> u32(24))) - f32(0.5))  # no two have the same shape
        size = F1 / (radius * (f32(0.45) + f32(0.55) * unit * f32(u32(h >> u32(24)))))
        x, y = x * size, y * size
        soft = f32(0.35) + f32(0.5) * buf[Slot.FOOT + i] * size
        fade = there * smoothstep(f32(0.5), f32(1.2), f32(2) * radius / buf[Slot.FOOT + i])
        disc = fade * (F1 - smoothstep(F1 - soft, F1 + f32(0.3) * soft, np.sqrt(x * x + y * y)))
        tall = buf[Slot.PARAM + Trait.TALL * B + i]
        away = reach * tall
        ax, ay = x + sx * away, y + sy * away
        dark = fade * min(F1, tall * F2) * (F1 - smoothstep(F1 - soft, F1 + soft, np.sqrt(ax * ax + ay * ay)))
        tone = buf[Slot.PARAM + Trait.TONE * B + i] + buf[Slot.PARAM + Trait.SPREAD * B + i] * (
            f32(2) * unit * f32(u32(u32(h2 >> u32(8)) & low)) - F1
        )
        buf[Slot.WEIGHT + i] = buf[Slot.WEIGHT + i] * (F1 - disc) + disc * max(f32(0.1), F1 + tone)
        buf[Slot.BUMP_E + i] = buf[Slot.BUMP_E + i] * (F1 - disc) - disc * tall * x
        buf[Slot.BUMP_N + i] = buf[Slot.BUMP_N + i] * (F1 - disc) - disc * tall * y
        buf[Slot.SHADE + i] = max(buf[Slot.SHADE + i] * (F1 - disc), dark * (F1 - disc))


@kernel
def small_things(buf: F32, base: F64, sun: F64, seed: int) -> None:
    """Scatter stones, leaves and tufts; fill the slots WEIGHT (factor on the colour) and SHADE (shadow), and add bumps.

    There are four sizes. The shadow of a thing falls away from the sun, in proportion to the thing's height.
    """
    fill(buf, Slot.WEIGHT, 1.0)
    fill(buf, Slot.SHADE, 0.0)
    finest = smallest(buf, Slot.FOOT)
    flat = max(math.hypot(sun[0], sun[1]), 1e-6)
    towards = np.array([sun[0] / flat, sun[1] / flat, min(flat / max(sun[2], 0.05), 2.0)]).astype(np.float32)
    for k, radius in enumerate(SMALL_THINGS):
        slot = Slot.PARAM + (Trait.THINGS0 + k) * B
        if 2.0 * radius <= 0.5 * finest or largest(buf, slot) <= 0.0:
            continue
        u, v, i, j = noise_lattice(base, 5.5 * radius, 1.0, 0.0, 0.0, 0.0)
        copy(buf, slot, Slot.N)  # a fixed slot: LLVM must see that input and output are apart
        for m in range(B):  # many in some areas, none in others
            buf[Slot.N + m] *= min(max(F1 + f32(0.9) * buf[Slot.ASIDE + m], f32(0.05)), F2)
        _scatter(buf, f32(radius), (f32(u), f32(v), i32(i), i32(j)), towards, seed32(seed + k))
