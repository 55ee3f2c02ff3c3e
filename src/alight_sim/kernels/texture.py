"""The texture of the ground for a block of pixels: large patches, detail at every scale, cracks, laid patterns.

Noise of the world position, so that no position repeats. Each octave fades out below two pixel footprints, so the
picture is band-limited as by a lens. Columns of a look (P_...) are named in `alight_sim.materials`.
"""

from __future__ import annotations

import math

import numpy as np

from alight.compiled import kernel
from alight_sim.kernels.block import (  # fmt: skip
    ASIDE,
    BLUE,
    BUMP_E,
    BUMP_N,
    DU,
    DV,
    F0,
    F1,
    F32,
    F64,
    FOOT,
    GREEN,
    I32,
    LARGE,
    MIDDLE,
    PARAM,
    RED,
    SLOPE_E,
    SLOPE_N,
    VALUE,
    WEIGHT,
    B,
    N,
    X,
    Y,
    Z,
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

# parameters of a look
(
    P_RED1, P_GREEN1, P_BLUE1, P_RED2, P_GREEN2, P_BLUE2, P_RED3, P_GREEN3, P_BLUE3,
    P_MIX, P_PATCH, P_EDGE, P_CONTRAST, P_UNEVEN, P_VARY, P_HUE, P_FALL, P_RIDGE, P_BUMP, P_CRACK,
    P_THINGS0, P_THINGS1, P_THINGS2, P_THINGS3, P_TONE, P_SPREAD, P_TALL,
    P_DEEP, P_OPEN, P_COARSE, P_SWAY, P_HOT, P_GLOSS, P_PATTERN, P_LIFT, P_BED, P_WAVES, P_SCUM,
) = range(38)  # fmt: skip
PARAMS = 38  # the last three are read only for water
TILES, SLABS, SEAMS, JOINTS = 1, 2, 3, 4


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
        slot = PARAM + k * B
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
    if slot == LARGE:
        for i in range(B):
            buf[LARGE + i] += f32(w) * buf[N + i]
            buf[ASIDE + i] += g * buf[DU + i]
    else:
        for i in range(B):
            buf[MIDDLE + i] += f32(w) * buf[N + i]
            buf[ASIDE + i] += g * buf[DV + i]


@kernel
def patches(buf: F32, base: F64, seed: int) -> None:
    """Fill the slots LARGE, MIDDLE, ASIDE with noise of 130 m to 5 m wavelength, for the variation within a class."""
    for slot in (LARGE, MIDDLE, ASIDE):
        fill(buf, slot, 0.0)
    for k, (wavelength, w) in enumerate(((131.0, 0.6), (53.0, 0.6), (23.0, 0.55), (11.0, 0.7), (5.5, 0.7))):
        noise_at(buf, base, wavelength, math.cos(1.0 + k), math.sin(1.0 + k), seed + 7 * k)
        _spread_patches(buf, w, LARGE if k < 3 else MIDDLE)


@kernel
def _add_octave(buf: F32, wavelength: np.float32, c: np.float32, s: np.float32) -> None:
    """Add the octave in N, DU, DV, on a lattice turned by (c, s), to the detail; a share P_RIDGE becomes ridges."""
    relief = min(F1, f32(0.4) / wavelength)  # long waves of relief belong to the height layer
    for i in range(B):
        w = buf[WEIGHT + i] * smoothstep(f32(1.2), f32(2.4), wavelength / buf[FOOT + i])
        n, ridge = buf[N + i], buf[PARAM + P_RIDGE * B + i]
        sign = F1 if n > F0 else -F1
        fold = F1 - ridge - f32(1.6) * ridge * sign
        buf[VALUE + i] += w * ((F1 - ridge) * n + ridge * (f32(1.25) - f32(1.6) * sign * n))
        slope = w * relief * fold
        buf[BUMP_E + i] += slope * (c * buf[DU + i] + s * buf[DV + i])
        buf[BUMP_N + i] += slope * (c * buf[DV + i] - s * buf[DU + i])
        buf[WEIGHT + i] *= buf[PARAM + P_FALL * B + i]


@kernel
def texture_detail(buf: F32, base: F64, seed: int) -> None:
    """Fill VALUE (about unit deviation), BUMP_E, BUMP_N with the octaves of 3 m to 1.2 cm that a pixel resolves."""
    for slot in (VALUE, BUMP_E, BUMP_N):
        fill(buf, slot, 0.0)
    for i in range(B):  # octaves of unit sum of squares
        q = buf[PARAM + P_FALL * B + i]
        q2 = q * q
        total, power = F0, F1
        for _ in range(OCTAVES):
            total += power
            power *= q2
        buf[WEIGHT + i] = F1 / np.sqrt(total)
    finest = smallest(buf, FOOT)
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
    p = PARAM
    for i in range(B):
        value, large, middle = buf[VALUE + i], buf[LARGE + i], buf[MIDDLE + i]
        place = f32(0.55) * large + f32(0.5) * middle + f32(0.35) * value
        mix = smoothstep(f32(-0.9), f32(0.9), place + buf[p + P_MIX * B + i])
        edge = buf[p + P_EDGE * B + i]
        there = smoothstep(F0, edge, f32(0.8) * buf[ASIDE + i] + f32(0.45) * value + buf[p + P_PATCH * B + i])
        a, b = (F1 - mix) * (F1 - there), mix * (F1 - there)
        buf[RED + i] = a * buf[p + P_RED1 * B + i] + b * buf[p + P_RED2 * B + i] + there * buf[p + P_RED3 * B + i]
        buf[GREEN + i] = (
            a * buf[p + P_GREEN1 * B + i] + b * buf[p + P_GREEN2 * B + i] + there * buf[p + P_GREEN3 * B + i]
        )
        buf[BLUE + i] = a * buf[p + P_BLUE1 * B + i] + b * buf[p + P_BLUE2 * B + i] + there * buf[p + P_BLUE3 * B + i]


@kernel
def _grain(buf: F32) -> None:
    p = PARAM
    for i in range(B):
        large, middle, aside = buf[LARGE + i], buf[MIDDLE + i], buf[ASIDE + i]
        vary, hue = buf[p + P_VARY * B + i], buf[p + P_HUE * B + i]
        here = F1 + buf[p + P_UNEVEN * B + i] * (f32(0.7) * middle - f32(0.5) * aside)  # rough here, plain there
        contrast = buf[p + P_CONTRAST * B + i] * min(max(here, f32(0.15)), f32(1.9))
        gain = (
            (F1 + contrast * buf[VALUE + i]) * (F1 + vary * (f32(0.6) * middle + f32(0.55) * large)) * buf[WEIGHT + i]
        )
        gain = max(gain, f32(0.12))
        warm = F1 + hue * (f32(0.5) * aside + f32(0.1) * buf[BUMP_E + i])
        cold = F1 - hue * (f32(0.5) * aside + f32(0.1) * buf[BUMP_N + i])
        buf[RED + i] = max(buf[RED + i] * gain * max(warm, f32(0.3)), f32(0.004))
        buf[GREEN + i] = max(buf[GREEN + i] * gain, f32(0.004))
        buf[BLUE + i] = max(buf[BLUE + i] * gain * max(cold, f32(0.3)), f32(0.004))


@kernel
def _cracks(buf: F32, base: F64, seed: int) -> None:
    """Darken thin lines, 1 to 2 cm wide and metres long, along which a noise crosses zero."""
    slot = PARAM + P_CRACK * B
    if largest(buf, slot) <= 0.0 or smallest(buf, FOOT) > 0.2:
        return
    for wavelength in (2.3, 6.1):
        noise_at(buf, base, wavelength, 0.6, 0.8, seed + int(wavelength))
        for i in range(B):
            steep = np.sqrt(buf[DU + i] * buf[DU + i] + buf[DV + i] * buf[DV + i]) + f32(0.2)
            away = abs(buf[N + i] + f32(0.05) * buf[VALUE + i]) / steep * f32(wavelength)
            foot = buf[FOOT + i]
            wide = f32(0.008) + f32(0.5) * foot
            line = (F1 - smoothstep(f32(0.5) * wide, f32(1.4) * wide, away)) * f32(0.016) / (f32(0.016) + foot)
            many = buf[slot + i] * smoothstep(f32(-0.4), f32(0.6), buf[ASIDE + i])
            buf[WEIGHT + i] *= F1 - min(f32(0.85), many) * line


@kernel
def colours(buf: F32, base: F64, seed: int) -> None:
    """Fill the slots RED, GREEN, BLUE with the look's colour at each position, with cracks, detail and small things."""
    _cracks(buf, base, seed)
    _stain(buf)
    _grain(buf)


@kernel
def _pattern(kind: int, x: float, y: float, z: float, slope_e: float, slope_n: float, foot: float, seed: int) -> float:
    """Return the factor of a laid material `kind` on the colour at (x, y, z); `foot`: size of a pixel there, metres."""
    if kind in (SLABS, JOINTS):
        size = 0.5 if kind == SLABS else 4.0
        u, v, line = (0.921 * x - 0.389 * y) / size, (0.389 * x + 0.921 * y) / size, 0.012 / size
    else:
        steep = max(math.hypot(slope_e, slope_n), 1e-3)
        u = (slope_e * y - slope_n * x) / steep / (0.3 if kind == TILES else 0.55)
        v = z * math.sqrt(1.0 + 1.0 / (steep * steep)) / (0.36 if kind == TILES else 40.0)
        line, size = 0.1, 0.3 if kind == TILES else 0.55
    i, j = math.floor(u), math.floor(v)
    fade = float(smoothstep(f32(1.0), f32(2.5), f32(size / foot)))
    h = point32(column32(i32(i), seed32(seed)), i32(j))
    gap = (v - j < line) or (kind != TILES and u - i < line)
    spread = 0.35 if kind == TILES else 0.14
    own = int(u32(h & u32(0xFFFF))) / 65535.0 - 0.5
    return 1.0 + fade * (spread * own - (0.4 if gap else 0.0))


@kernel
def laid(buf: F32, base: F64, seed: int) -> None:
    """Multiply the colours by the pattern of tiles, slabs, seams or joints; blocks without such a look are skipped."""
    slot = PARAM + P_PATTERN * B
    if largest(buf, slot) <= 0.0:
        return
    for i in range(B):
        kind = int(buf[slot + i])
        if kind == 0:
            continue
        x, y, z = base[0] + buf[X + i], base[1] + buf[Y + i], base[2] + buf[Z + i]
        gain = f32(_pattern(kind, x, y, z, buf[SLOPE_E + i], buf[SLOPE_N + i], buf[FOOT + i], seed))
        buf[RED + i] *= gain
        buf[GREEN + i] *= gain
        buf[BLUE + i] *= gain
