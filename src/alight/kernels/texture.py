"""The texture of the ground for a block of pixels: large patches, detail at every scale, small things with shadows.

Noise of the world position, so that no place repeats. Each octave fades out below two pixel footprints: the picture is
band-limited as a lens would make it. Columns of a look (P_...) are named in `alight.simulate.materials`.
"""

from __future__ import annotations

import math

import numpy as np

from alight.kernels.block import (
    ALONG,
    ASIDE,
    BLUE,
    BUMP_E,
    BUMP_N,
    DU,
    DV,
    F0,
    F1,
    F2,
    F32,
    F64,
    FOOT,
    GREEN,
    I32,
    KEPT_X,
    KEPT_Y,
    LARGE,
    LEAF,
    MIDDLE,
    PARAM,
    RED,
    SHADE,
    SLOPE_E,
    SLOPE_N,
    TX,
    TY,
    VALUE,
    VX,
    VY,
    VZ,
    WEIGHT,
    B,
    N,
    X,
    Y,
    Z,
    copy,
    f32,
    fill,
    i32,
    largest,
    lattice,
    noise_at,
    smallest,
    smooth,
    u32,
)  # fmt: skip
from alight.kernels.compiler import kernel
from alight.kernels.noise import column32, floor32, point32, seed32

FIRST_WAVELENGTH, OCTAVES = 3.0, 9  # metres, of octave 0; each next is half as long
SMALL_THINGS = (0.012, 0.03, 0.08, 0.22)  # metres, largest radius of each size class

# numbers of a look
(
    P_RED1, P_GREEN1, P_BLUE1, P_RED2, P_GREEN2, P_BLUE2, P_RED3, P_GREEN3, P_BLUE3,
    P_MIX, P_PATCH, P_EDGE, P_CONTRAST, P_UNEVEN, P_VARY, P_HUE, P_FALL, P_RIDGE, P_BUMP, P_CRACK,
    P_THINGS0, P_THINGS1, P_THINGS2, P_THINGS3, P_TONE, P_SPREAD, P_TALL,
    P_DEEP, P_OPEN, P_COARSE, P_SWAY, P_HOT, P_GLOSS, P_PATTERN, P_BED, P_WAVES, P_SCUM, P_DULL,
) = range(38)  # fmt: skip
PARAMS = 38  # the last four are read for water alone
TILES, SLABS, SEAMS, JOINTS = 1, 2, 3, 4


@kernel
def load_looks(buf: F32, looks: F32, look: I32, last: int, before: int = -1) -> int:
    """Fill the parameter slots, columns 0 to `last`; return the look of the block, -1 where it has several.

    `before`: the look that the slots hold already, -1 none: most blocks look like the one before.
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
    """Add the noise to LARGE or MIDDLE, and its slope (as good as another noise) to ASIDE."""
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
    """Fill LARGE, MIDDLE, ASIDE: what makes one place of a class differ from another, 130 m down to 6 m."""
    for slot in (LARGE, MIDDLE, ASIDE):
        fill(buf, slot, 0.0)
    for k, (wavelength, w) in enumerate(((131.0, 0.6), (53.0, 0.6), (23.0, 0.55), (11.0, 0.7), (5.5, 0.7))):
        noise_at(buf, base, wavelength, math.cos(1.0 + k), math.sin(1.0 + k), seed + 7 * k)
        _spread_patches(buf, w, LARGE if k < 3 else MIDDLE)


@kernel
def _add_octave(buf: F32, wavelength: np.float32, c: np.float32, s: np.float32) -> None:
    """Add an octave that N, DU, DV hold; half of it may be ridges, which real ground has and noise has not."""
    relief = min(F1, f32(0.4) / wavelength)  # long waves of relief are the height layer's
    for i in range(B):
        w = buf[WEIGHT + i] * smooth(f32(1.2), f32(2.4), wavelength / buf[FOOT + i])
        n, ridge = buf[N + i], buf[PARAM + P_RIDGE * B + i]
        sign = F1 if n > F0 else -F1
        fold = F1 - ridge - f32(1.6) * ridge * sign
        buf[VALUE + i] += w * ((F1 - ridge) * n + ridge * (f32(1.25) - f32(1.6) * sign * n))
        slope = w * relief * fold
        buf[BUMP_E + i] += slope * (c * buf[DU + i] + s * buf[DV + i])
        buf[BUMP_N + i] += slope * (c * buf[DV + i] - s * buf[DU + i])
        buf[WEIGHT + i] *= buf[PARAM + P_FALL * B + i]


@kernel
def detail(buf: F32, base: F64, seed: int) -> None:
    """Fill VALUE (about unit deviation) and BUMP_E, BUMP_N: the octaves that a pixel resolves, 3 m to 1.2 cm."""
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
        c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s  # 37 degrees an octave: lattices never line up


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
        u, v = u0 + buf[TX + i] * scale, v0 + buf[TY + i] * scale
        a, b = floor32(u), floor32(v)
        h = point32(column32(i32(a + i0), seed), i32(b + j0))
        h2 = u32(u32(h ^ u32(h >> u32(15))) * u32(0x2C1B3C6D))
        there = F1 if f32(u32(h & low)) < f32(256) * buf[N + i] else F0
        x = (u - f32(a) - f32(0.3) - f32(0.4) * unit * f32(u32(u32(h >> u32(8)) & low))) * cell
        y = (v - f32(b) - f32(0.3) - f32(0.4) * unit * f32(u32(u32(h >> u32(16)) & low))) * cell
        x += y * (unit * f32(u32(h2 >> u32(24))) - f32(0.5))  # no two of one shape
        size = F1 / (radius * (f32(0.45) + f32(0.55) * unit * f32(u32(h >> u32(24)))))
        x, y = x * size, y * size
        soft = f32(0.35) + f32(0.5) * buf[FOOT + i] * size
        fade = there * smooth(f32(0.5), f32(1.2), f32(2) * radius / buf[FOOT + i])
        disc = fade * (F1 - smooth(F1 - soft, F1 + f32(0.3) * soft, np.sqrt(x * x + y * y)))
        tall = buf[PARAM + P_TALL * B + i]
        away = reach * tall
        ax, ay = x + sx * away, y + sy * away
        dark = fade * min(F1, tall * F2) * (F1 - smooth(F1 - soft, F1 + soft, np.sqrt(ax * ax + ay * ay)))
        tone = buf[PARAM + P_TONE * B + i] + buf[PARAM + P_SPREAD * B + i] * (
            f32(2) * unit * f32(u32(u32(h2 >> u32(8)) & low)) - F1
        )
        buf[WEIGHT + i] = buf[WEIGHT + i] * (F1 - disc) + disc * max(f32(0.1), F1 + tone)
        buf[BUMP_E + i] = buf[BUMP_E + i] * (F1 - disc) - disc * tall * x
        buf[BUMP_N + i] = buf[BUMP_N + i] * (F1 - disc) - disc * tall * y
        buf[SHADE + i] = max(buf[SHADE + i] * (F1 - disc), dark * (F1 - disc))


@kernel
def small_things(buf: F32, base: F64, sun: F64, seed: int) -> None:
    """Scatter stones, leaves, tufts below the cell: WEIGHT = gain of the colour, bump of their domes, SHADE = shadow.

    One in some of the cells of a lattice, in four sizes; the shadow falls away from the sun, as its height says.
    """
    fill(buf, WEIGHT, 1.0)
    fill(buf, SHADE, 0.0)
    finest = smallest(buf, FOOT)
    flat = max(math.hypot(sun[0], sun[1]), 1e-6)
    towards = np.array([sun[0] / flat, sun[1] / flat, min(flat / max(sun[2], 0.05), 2.0)]).astype(np.float32)
    for k, radius in enumerate(SMALL_THINGS):
        slot = PARAM + (P_THINGS0 + k) * B
        if 2.0 * radius <= 0.5 * finest or largest(buf, slot) <= 0.0:
            continue
        u, v, i, j = lattice(base, 5.5 * radius, 1.0, 0.0, 0.0, 0.0)
        copy(buf, slot, N)  # a fixed slot: LLVM must see that what is read is not what is written
        for m in range(B):  # many here, none there
            buf[N + m] *= min(max(F1 + f32(0.9) * buf[ASIDE + m], f32(0.05)), F2)
        _scatter(buf, f32(radius), (f32(u), f32(v), i32(i), i32(j)), towards, seed32(seed + k))


@kernel
def sway(buf: F32, base: F64, wind: F64, time: float, seed: int) -> None:
    """Shift the texture of what the wind moves; gusts run over it with the wind. `wind` (2,): m/s east, north."""
    if largest(buf, PARAM + P_SWAY * B) <= 0.0:
        return
    speed = math.hypot(wind[0], wind[1])
    push = f32(min(speed / 4.0, 3.0))
    noise_at(buf, base, 1.9, 0.8, 0.6, seed, -0.7 * wind[0] * time, -0.7 * wind[1] * time)
    for i in range(B):
        reach = push * buf[PARAM + P_SWAY * B + i]
        buf[TX + i] += reach * (buf[N + i] + f32(0.3) * buf[DU + i])
        buf[TY + i] += reach * (f32(0.3) * buf[DV + i] - f32(0.5) * buf[N + i])


@kernel
def _sift(buf: F32, wavelength: np.float32, coarse: np.float32) -> None:
    for i in range(B):
        share = buf[PARAM + P_COARSE * B + i]
        w = coarse * share + (F1 - coarse) * (F1 - share)
        buf[WEIGHT + i] += w * smooth(f32(1.2), f32(2.4), wavelength / buf[FOOT + i]) * buf[N + i]


@kernel
def _choose(buf: F32, part: np.float32, gain: np.float32, opaque: np.float32) -> None:
    """Settle the pixels whose layer is opaque: where on the texture they look, and how little light comes there."""
    for i in range(B):
        deep = part * buf[PARAM + P_DEEP * B + i]
        free = F1 if buf[SHADE + i] < F0 else F0
        take = free if buf[WEIGHT + i] > buf[PARAM + P_OPEN * B + i] - opaque else F0
        shown = F1 + (gain - F1) * min(f32(2.2) * buf[PARAM + P_DEEP * B + i], F1)  # little dark under short grass
        buf[SHADE + i] = shown if take > F0 else buf[SHADE + i]
        fall = min(deep / max(buf[VZ + i], f32(0.3)), f32(1.5))
        buf[ALONG + i] = fall if take > F0 else buf[ALONG + i]


@kernel
def foliage(buf: F32, base: F64, seed: int) -> None:
    """Look into crowns and grass: three layers of leaves, the first opaque one is seen; fills LEAF with its light.

    Leaves hang at several depths below the surface, so views from two places disagree, as with real plants; the
    height that truth knows is the topmost layer.
    """
    fill(buf, SHADE, 1.0)
    if largest(buf, PARAM + P_DEEP * B) > 0.0:
        fill(buf, SHADE, -1.0)
        fill(buf, ALONG, 0.0)
        finest = smallest(buf, FOOT)
        copy(buf, TX, KEPT_X)
        copy(buf, TY, KEPT_Y)
        noise_at(buf, base, 0.33, 0.28, 0.96, seed + 77)  # leaves of a layer hang at many heights
        _hang(buf)
        for k, (part, gain, opaque) in enumerate(((0.0, 1.2, 0.0), (0.4, 0.5, 0.35), (1.0, 0.15, 9.0))):
            fill(buf, WEIGHT, 0.0)
            _shift(buf, f32(part))
            for m, wavelength in enumerate((0.41, 0.17, 0.062)):
                if wavelength > 1.2 * finest and k < 2:
                    noise_at(buf, base, wavelength, math.cos(k + 2.0 * m), math.sin(k + 2.0 * m), seed + 10 * k + m)
                    _sift(buf, f32(wavelength), f32(1.0 - 0.5 * m))
            _choose(buf, f32(part), f32(gain), f32(opaque))
        _settle(buf)
    copy(buf, SHADE, LEAF)
    for i in range(B):  # the flanks of a crown: the dark below it
        e, n = buf[SLOPE_E + i], buf[SLOPE_N + i]
        flank = smooth(f32(1.5), f32(5.0), np.sqrt(e * e + n * n)) if buf[PARAM + P_DEEP * B + i] > f32(0.2) else F0
        buf[LEAF + i] *= F1 - f32(0.85) * flank


@kernel
def _hang(buf: F32) -> None:
    """Shift the place of the leaves by the parallax of their own height, 0 to a third of the depth."""
    for i in range(B):
        own = f32(0.16) * buf[PARAM + P_DEEP * B + i] * min(max(F1 + f32(0.8) * buf[N + i], F0), F2)
        fall = own / max(buf[VZ + i], f32(0.3))
        buf[KEPT_X + i] -= buf[VX + i] * fall
        buf[KEPT_Y + i] -= buf[VY + i] * fall


@kernel
def _shift(buf: F32, part: np.float32) -> None:
    for i in range(B):
        fall = min(part * buf[PARAM + P_DEEP * B + i] / max(buf[VZ + i], f32(0.3)), f32(1.5))
        buf[TX + i] = buf[KEPT_X + i] - buf[VX + i] * fall
        buf[TY + i] = buf[KEPT_Y + i] - buf[VY + i] * fall


@kernel
def _settle(buf: F32) -> None:
    for i in range(B):
        buf[TX + i] = buf[KEPT_X + i] - buf[VX + i] * buf[ALONG + i]
        buf[TY + i] = buf[KEPT_Y + i] - buf[VY + i] * buf[ALONG + i]


@kernel
def _stain(buf: F32) -> None:
    """Mix the three colours by the place: RED, GREEN, BLUE without detail."""
    p = PARAM
    for i in range(B):
        value, large, middle = buf[VALUE + i], buf[LARGE + i], buf[MIDDLE + i]
        place = f32(0.55) * large + f32(0.5) * middle + f32(0.35) * value
        mix = smooth(f32(-0.9), f32(0.9), place + buf[p + P_MIX * B + i])
        edge = buf[p + P_EDGE * B + i]
        there = smooth(F0, edge, f32(0.8) * buf[ASIDE + i] + f32(0.45) * value + buf[p + P_PATCH * B + i])
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
    """Darken thin lines, 1 to 2 cm wide and metres long, where a noise crosses zero; fewer in some places."""
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
            line = (F1 - smooth(f32(0.5) * wide, f32(1.4) * wide, away)) * f32(0.016) / (f32(0.016) + foot)
            many = buf[slot + i] * smooth(f32(-0.4), f32(0.6), buf[ASIDE + i])
            buf[WEIGHT + i] *= F1 - min(f32(0.85), many) * line


@kernel
def colours(buf: F32, base: F64, seed: int) -> None:
    """Fill RED, GREEN, BLUE with the reflectance: three colours mixed by the place, times detail and small things."""
    _cracks(buf, base, seed)
    _stain(buf)
    _grain(buf)


@kernel
def _pattern(kind: int, x: float, y: float, z: float, slope_e: float, slope_n: float, foot: float, seed: int) -> float:
    """Gain of one place of laid material: tiles in rows of one height, slabs, seams down the slope, joints."""
    if kind in (SLABS, JOINTS):
        size = 0.5 if kind == SLABS else 4.0
        u, v, line = (0.921 * x - 0.389 * y) / size, (0.389 * x + 0.921 * y) / size, 0.012 / size
    else:
        steep = max(math.hypot(slope_e, slope_n), 1e-3)
        u = (slope_e * y - slope_n * x) / steep / (0.3 if kind == TILES else 0.55)
        v = z * math.sqrt(1.0 + 1.0 / (steep * steep)) / (0.36 if kind == TILES else 40.0)
        line, size = 0.1, 0.3 if kind == TILES else 0.55
    i, j = math.floor(u), math.floor(v)
    fade = float(smooth(f32(1.0), f32(2.5), f32(size / foot)))
    h = point32(column32(i32(i), seed32(seed)), i32(j))
    gap = (v - j < line) or (kind != TILES and u - i < line)
    spread = 0.35 if kind == TILES else 0.14
    own = int(u32(h & u32(0xFFFF))) / 65535.0 - 0.5
    return 1.0 + fade * (spread * own - (0.4 if gap else 0.0))


@kernel
def laid(buf: F32, base: F64, seed: int) -> None:
    """Multiply the colours by the pattern of what people lay; only blocks that have such a look pay."""
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
