"""The texture of the ground for a block of pixels: large patches, detail at every scale, cracks, laid patterns.

Noise of the world position, so that no position repeats. Each octave fades out below two pixel footprints, so the
picture is band-limited as by a lens. Columns of a look (P_...) are named in `alight_sim.materials`.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from alight.compiled import kernel
from alight_sim.kernels.block import (
    F0,
    F1,
    F32,
    F64,
    I32,
    B,
    Slot,
    f32,
    fill,
    i32,
    largest,
    noise_at,
    smallest,
    smoothstep,
    u32,
)
from alight_sim.kernels.noise import column32, point32, seed32

FIRST_WAVELENGTH, OCTAVES = 3.0, 9  # metres, of octave 0; each next one is half as long


class Trait(IntEnum):
    """Parameters of a look; the last three are read only for water."""

    RED1, GREEN1, BLUE1, RED2, GREEN2, BLUE2, RED3, GREEN3, BLUE3 = range(9)
    MIX, PATCH, EDGE, CONTRAST, UNEVEN, VARY, HUE, FALL, RIDGE, BUMP, CRACK = range(9, 20)
    THINGS0, THINGS1, THINGS2, THINGS3, TONE, SPREAD, TALL = range(20, 27)
    DEEP, OPEN, COARSE, SWAY, HOT, GLOSS, PATTERN, LIFT, BED, WAVES, SCUM = range(27, 38)


TRAITS = len(Trait)


class Pattern(IntEnum):
    """Patterns of laid ground."""

    TILES, SLABS, SEAMS, JOINTS = range(1, 5)


@kernel
def load_looks(buf: F32, looks: F32, look: I32, last: int, before: int = -1) -> int:
    """Fill the first `last` parameter slots from the pixels' looks; return the look of the block, -1 if it has several.

    `before`: look whose parameters the slots hold already, or -1; nothing is done if the whole block has this look.
    """
    same = True
    for i in range(1, B):
        same &= look[i] == look[0]
    if same and look[0] == before:
        return before
    for k in range(last):
        slot = Slot.PARAM + k * B
        if same:
            fill(buf, slot, looks[look[0], k])
        else:
            for i in range(B):
                buf[slot + i] = looks[look[i], k]
    return int(look[0]) if same else -1


@kernel
def _spread_patches(buf: F32, w: float, slot: int) -> None:
    """Add `w` times the noise in slot N to `slot` (LARGE or MIDDLE), and its slope to ASIDE as a second noise."""
    g = f32(0.45 * w)
    if slot == Slot.LARGE:
        for i in range(B):
            buf[Slot.LARGE + i] += f32(w) * buf[Slot.N + i]
            buf[Slot.ASIDE + i] += g * buf[Slot.DU + i]
    else:
        for i in range(B):
            buf[Slot.MIDDLE + i] += f32(w) * buf[Slot.N + i]
            buf[Slot.ASIDE + i] += g * buf[Slot.DV + i]


@kernel
def patches(buf: F32, base: F64, seed: int) -> None:
    """Fill the slots LARGE, MIDDLE, ASIDE with noise of 130 m to 5 m wavelength, for the variation within a class."""
    for slot in (Slot.LARGE, Slot.MIDDLE, Slot.ASIDE):
        fill(buf, slot, 0.0)
    for k, (wavelength, w) in enumerate(((131.0, 0.6), (53.0, 0.6), (23.0, 0.55), (11.0, 0.7), (5.5, 0.7))):
        noise_at(buf, base, wavelength, math.cos(1.0 + k), math.sin(1.0 + k), seed + 7 * k)
        _spread_patches(buf, w, Slot.LARGE if k < 3 else Slot.MIDDLE)


@kernel
def _add_octave(buf: F32, wavelength: np.float32, c: np.float32, s: np.float32) -> None:
    """Add the octave in N, DU, DV, on a lattice turned by (c, s), to the detail; a share P_RIDGE becomes ridges."""
    relief = min(F1, f32(0.4) / wavelength)  # long waves of relief belong to the height layer
    for i in range(B):
        w = buf[Slot.WEIGHT + i] * smoothstep(f32(1.2), f32(2.4), wavelength / buf[Slot.FOOT + i])
        n, ridge = buf[Slot.N + i], buf[Slot.PARAM + Trait.RIDGE * B + i]
        sign = F1 if n > F0 else -F1
        fold = F1 - ridge - f32(1.6) * ridge * sign
        buf[Slot.VALUE + i] += w * ((F1 - ridge) * n + ridge * (f32(1.25) - f32(1.6) * sign * n))
        slope = w * relief * fold
        buf[Slot.BUMP_E + i] += slope * (c * buf[Slot.DU + i] + s * buf[Slot.DV + i])
        buf[Slot.BUMP_N + i] += slope * (c * buf[Slot.DV + i] - s * buf[Slot.DU + i])
        buf[Slot.WEIGHT + i] *= buf[Slot.PARAM + Trait.FALL * B + i]


@kernel
def texture_detail(buf: F32, base: F64, seed: int) -> None:
    """Fill VALUE (about unit deviation), BUMP_E, BUMP_N with the octaves of 3 m to 1.2 cm that a pixel resolves."""
    for slot in (Slot.VALUE, Slot.BUMP_E, Slot.BUMP_N):
        fill(buf, slot, 0.0)
    for i in range(B):  # octaves of unit sum of squares
        q = buf[Slot.PARAM + Trait.FALL * B + i]
        q2 = q * q
        total, power = F0, F1
        for _ in range(OCTAVES):
            total += power
            power *= q2
        buf[Slot.WEIGHT + i] = F1 / np.sqrt(total)
    finest = smallest(buf, Slot.FOOT)
    wavelength, c, s = FIRST_WAVELENGTH, 1.0, 0.0
    for k in range(OCTAVES):
        if wavelength < 1.2 * finest:
            break
        noise_at(buf, base, wavelength, c, s, seed + 101 * k)
        _add_octave(buf, f32(wavelength), f32(c), f32(s))
        wavelength *= 0.5
        c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s  # 37 degrees per octave: lattices never line up


@kernel
def _stain(buf: F32) -> None:
    """Fill the slots RED, GREEN, BLUE with the three colours of a look, mixed by position, without detail."""
    p = Slot.PARAM
    for i in range(B):
        value, large, middle = buf[Slot.VALUE + i], buf[Slot.LARGE + i], buf[Slot.MIDDLE + i]
        place = f32(0.55) * large + f32(0.5) * middle + f32(0.35) * value
        mix = smoothstep(f32(-0.9), f32(0.9), place + buf[p + Trait.MIX * B + i])
        edge = buf[p + Trait.EDGE * B + i]
        there = smoothstep(F0, edge, f32(0.8) * buf[Slot.ASIDE + i] + f32(0.45) * value + buf[p + Trait.PATCH * B + i])
        a, b = (F1 - mix) * (F1 - there), mix * (F1 - there)
        buf[Slot.RED + i] = (
            a * buf[p + Trait.RED1 * B + i] + b * buf[p + Trait.RED2 * B + i] + there * buf[p + Trait.RED3 * B + i]
        )
        buf[Slot.GREEN + i] = (
            a * buf[p + Trait.GREEN1 * B + i]
            + b * buf[p + Trait.GREEN2 * B + i]
            + there * buf[p + Trait.GREEN3 * B + i]
        )
        buf[Slot.BLUE + i] = (
            a * buf[p + Trait.BLUE1 * B + i] + b * buf[p + Trait.BLUE2 * B + i] + there * buf[p + Trait.BLUE3 * B + i]
        )


@kernel
def _grain(buf: F32) -> None:
    p = Slot.PARAM
    for i in range(B):
        large, middle, aside = buf[Slot.LARGE + i], buf[Slot.MIDDLE + i], buf[Slot.ASIDE + i]
        vary, hue = buf[p + Trait.VARY * B + i], buf[p + Trait.HUE * B + i]
        here = F1 + buf[p + Trait.UNEVEN * B + i] * (f32(0.7) * middle - f32(0.5) * aside)  # rough here, plain there
        contrast = buf[p + Trait.CONTRAST * B + i] * min(max(here, f32(0.15)), f32(1.9))
        gain = (
            (F1 + contrast * buf[Slot.VALUE + i])
            * (F1 + vary * (f32(0.6) * middle + f32(0.55) * large))
            * buf[Slot.WEIGHT + i]
        )
        gain = max(gain, f32(0.12))
        warm = F1 + hue * (f32(0.5) * aside + f32(0.1) * buf[Slot.BUMP_E + i])
        cold = F1 - hue * (f32(0.5) * aside + f32(0.1) * buf[Slot.BUMP_N + i])
        buf[Slot.RED + i] = max(buf[Slot.RED + i] * gain * max(warm, f32(0.3)), f32(0.004))
        buf[Slot.GREEN + i] = max(buf[Slot.GREEN + i] * gain, f32(0.004))
        buf[Slot.BLUE + i] = max(buf[Slot.BLUE + i] * gain * max(cold, f32(0.3)), f32(0.004))


@kernel
def _cracks(buf: F32, base: F64, seed: int) -> None:
    """Darken thin lines, 1 to 2 cm wide and metres long, along which a noise crosses zero."""
    slot = Slot.PARAM + Trait.CRACK * B
    if largest(buf, slot) <= 0.0 or smallest(buf, Slot.FOOT) > 0.2:
        return
    for wavelength in (2.3, 6.1):
        noise_at(buf, base, wavelength, 0.6, 0.8, seed + int(wavelength))
        for i in range(B):
            steep = np.sqrt(buf[Slot.DU + i] * buf[Slot.DU + i] + buf[Slot.DV + i] * buf[Slot.DV + i]) + f32(0.2)
            away = abs(buf[Slot.N + i] + f32(0.05) * buf[Slot.VALUE + i]) / steep * f32(wavelength)
            foot = buf[Slot.FOOT + i]
            wide = f32(0.008) + f32(0.5) * foot
            line = (F1 - smoothstep(f32(0.5) * wide, f32(1.4) * wide, away)) * f32(0.016) / (f32(0.016) + foot)
            many = buf[slot + i] * smoothstep(f32(-0.4), f32(0.6), buf[Slot.ASIDE + i])
            buf[Slot.WEIGHT + i] *= F1 - min(f32(0.85), many) * line


@kernel
def colours(buf: F32, base: F64, seed: int) -> None:
    """Fill the slots RED, GREEN, BLUE with the look's colour at each position, with cracks, detail and small things."""
    _cracks(buf, base, seed)
    _stain(buf)
    _grain(buf)


@kernel
def _pattern(kind: int, x: float, y: float, z: float, slope_e: float, slope_n: float, foot: float, seed: int) -> float:
    """Return the factor of a laid material `kind` on the colour at (x, y, z); `foot`: size of a pixel there, metres."""
    if kind in (Pattern.SLABS, Pattern.JOINTS):
        size = 0.5 if kind == Pattern.SLABS else 4.0
        u, v, line = (0.921 * x - 0.389 * y) / size, (0.389 * x + 0.921 * y) / size, 0.012 / size
    else:
        steep = max(math.hypot(slope_e, slope_n), 1e-3)
        u = (slope_e * y - slope_n * x) / steep / (0.3 if kind == Pattern.TILES else 0.55)
        v = z * math.sqrt(1.0 + 1.0 / (steep * steep)) / (0.36 if kind == Pattern.TILES else 40.0)
        line, size = 0.1, 0.3 if kind == Pattern.TILES else 0.55
    i, j = math.floor(u), math.floor(v)
    fade = float(smoothstep(f32(1.0), f32(2.5), f32(size / foot)))
    h = point32(column32(i32(i), seed32(seed)), i32(j))
    gap = (v - j < line) or (kind != Pattern.TILES and u - i < line)
    spread = 0.35 if kind == Pattern.TILES else 0.14
    own = int(u32(h & u32(0xFFFF))) / 65535.0 - 0.5
    return 1.0 + fade * (spread * own - (0.4 if gap else 0.0))


@kernel
def laid(buf: F32, base: F64, seed: int) -> None:
    """Multiply the colours by the pattern of tiles, slabs, seams or joints; blocks without such a look are skipped."""
    slot = Slot.PARAM + Trait.PATTERN * B
    if largest(buf, slot) <= 0.0:
        return
    for i in range(B):
        kind = int(buf[slot + i])
        if kind == 0:
            continue
        x, y, z = base[0] + buf[Slot.X + i], base[1] + buf[Slot.Y + i], base[2] + buf[Slot.Z + i]
        gain = f32(_pattern(kind, x, y, z, buf[Slot.SLOPE_E + i], buf[Slot.SLOPE_N + i], buf[Slot.FOOT + i], seed))
        buf[Slot.RED + i] *= gain
        buf[Slot.GREEN + i] *= gain
        buf[Slot.BLUE + i] *= gain
