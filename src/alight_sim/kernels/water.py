"""Water for a block of pixels: moving waves, the bed refracted and dimmed, the mirrored sky, glints, drifting scum.

The bed is textured by the same passes as dry ground, at the position where the refracted ray meets it. So stereo
matches the bed, below the true surface: a failure that must not mislead a lander.
"""

from __future__ import annotations

import math

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
    copy,
    f32,
    fading,
    fill,
    noise_at,
    smoothstep,
    values_at,
)
from alight_sim.kernels.texture import Trait

TRAINS = ((5.1, 0.020), (2.2, 0.030), (0.95, 0.036), (0.41, 0.040), (0.18, 0.045))  # wavelength, m; slope at 3 m/s


@kernel
def dive(buf: F32, looks: F32, look: I32) -> bool:
    """Store the water's parameters and change the look of wet pixels to the bed's; return whether any pixel is wet."""
    wet = False
    for i in range(B):
        wet |= buf[Slot.WATER + i] > 0.0
    if not wet:
        return False
    for i in range(B):
        k = look[i]
        buf[Slot.BODY_R + i], buf[Slot.BODY_G + i], buf[Slot.BODY_B + i] = (
            looks[k, Trait.RED1],
            looks[k, Trait.GREEN1],
            looks[k, Trait.BLUE1],
        )
        buf[Slot.DULL_R + i], buf[Slot.DULL_G + i], buf[Slot.DULL_B + i] = (
            looks[k, Trait.RED3],
            looks[k, Trait.GREEN3],
            looks[k, Trait.BLUE3],
        )
        buf[Slot.SCUM + i], buf[Slot.CALM + i] = looks[k, Trait.SCUM], looks[k, Trait.WAVES]
        if buf[Slot.WATER + i] > 0.0:
            look[i] = int(looks[k, Trait.BED])
    return True


@kernel
def _add_train(buf: F32, w: np.float32, wavelength: np.float32, c: np.float32, s: np.float32) -> None:
    for i in range(B):
        slope = w * buf[Slot.CALM + i]
        seen = smoothstep(f32(1.2), f32(2.4), wavelength / buf[Slot.FOOT + i])
        buf[Slot.WAVE_E + i] += seen * slope * (c * buf[Slot.DU + i] - s * buf[Slot.DV + i])
        buf[Slot.WAVE_N + i] += seen * slope * (s * buf[Slot.DU + i] + c * buf[Slot.DV + i])
        buf[Slot.WAVE_VAR + i] += (F1 - seen) * slope * slope * f32(2.0)


@kernel
def waves(buf: F32, base: F64, wind: F64, time: float, seed: int) -> None:
    """Fill the slots of the waves' slopes: five wavelengths L, each with two trains of speed sqrt(g L / 2 pi)."""
    copy(buf, Slot.X, Slot.TX)
    copy(buf, Slot.Y, Slot.TY)
    fill(buf, Slot.WAVE_E, 0.0)
    fill(buf, Slot.WAVE_N, 0.0)
    fill(buf, Slot.WAVE_VAR, 0.0004)
    speed = max(math.hypot(wind[0], wind[1]), 0.3)
    values_at(buf, base, 14.0, 0.6, 0.8, seed + 90, -wind[0] * time, -wind[1] * time)
    for i in range(B):  # gusts roughen the water in some areas and leave it smooth in others
        buf[Slot.CALM + i] *= f32(0.25) + f32(0.75) * smoothstep(f32(-1.0), f32(1.0), buf[Slot.N + i])
    for k, (wavelength, slope) in enumerate(TRAINS):
        run = 1.25 * math.sqrt(wavelength) * time
        w = 0.65 * slope * (0.25 + 0.25 * speed)
        for m in range(2):
            turn = math.atan2(wind[1], wind[0]) + (-0.5 + 0.35 * k if m == 0 else 0.8 - 0.3 * k)
            c, s = math.cos(turn), math.sin(turn)
            noise_at(buf, base, wavelength, c, -s, seed + 11 * k + m, -c * run, -s * run)
            _add_train(buf, f32(w), f32(wavelength), f32(c), f32(s))


@kernel
def refract(buf: F32) -> None:
    """Move the texture coordinates of wet pixels to the position where the refracted ray meets the bed."""
    for i in range(B):
        deep = max(buf[Slot.DEPTH + i], F0) * buf[Slot.WATER + i]
        down = max(buf[Slot.VZ + i], f32(0.2))
        buf[Slot.TX + i] += deep * (f32(0.25) * buf[Slot.WAVE_E + i] - buf[Slot.VX + i] / down * f32(0.75))
        buf[Slot.TY + i] += deep * (f32(0.25) * buf[Slot.WAVE_N + i] - buf[Slot.VY + i] / down * f32(0.75))


@kernel
def _through(buf: F32, sky: np.float32, sun: np.float32, towards: F32) -> None:
    """Replace the bed's reflectance in N by the radiance of water with colour V and attenuation U, and mirrored sky."""
    sx, sy, flat = towards[0], towards[1], towards[2]
    for i in range(B):
        v = buf[Slot.VX + i] * buf[Slot.WAVE_E + i] + buf[Slot.VY + i] * buf[Slot.WAVE_N + i]
        facing = buf[Slot.WAVE_E + i] * sx + buf[Slot.WAVE_N + i] * sy
        up = max(buf[Slot.VZ + i] - v, f32(0.02))
        mirror = f32(0.02) + f32(0.98) * (F1 - up) * (F1 - up) * (F1 - up) * (F1 - up) * (F1 - up)
        low = F1 - min(up, F1)
        above = sky * buf[Slot.SKY + i] * (F1 + f32(2.5) * low * low - f32(8.0) * facing)
        lit = sun * flat * (f32(0.25) + f32(0.75) * buf[Slot.SUN + i]) + sky * buf[Slot.SKY + i]
        through = fading(
            max(buf[Slot.DEPTH + i], F0) * buf[Slot.U + i] * (F1 + F1 / max(buf[Slot.VZ + i], f32(0.3))) * f32(0.5)
        )
        body = buf[Slot.V + i] * max(F1 - f32(2.5) * facing, f32(0.3))
        seen = (f32(0.7) * buf[Slot.N + i] * through + body * (F1 - through)) * lit
        wet = seen * (F1 - mirror) + mirror * max(above, F0)
        buf[Slot.N + i] = wet if buf[Slot.WATER + i] > F0 else buf[Slot.N + i]


@kernel
def water_light(buf: F32, sun: F64) -> None:
    """Replace the reflectance of wet pixels by their radiance; `sun`: direction, colour, sky colour."""
    towards = sun[:3].astype(np.float32)
    for k, (body, dull, colour) in enumerate(
        (
            (Slot.BODY_R, Slot.DULL_R, Slot.RED),
            (Slot.BODY_G, Slot.DULL_G, Slot.GREEN),
            (Slot.BODY_B, Slot.DULL_B, Slot.BLUE),
        )
    ):
        copy(buf, body, Slot.V)
        copy(buf, dull, Slot.U)
        copy(buf, colour, Slot.N)
        _through(buf, f32(sun[6 + k]), f32(sun[3 + k]), towards)
        copy(buf, Slot.N, colour)
    _glints(buf, f32(sun[0]), f32(sun[1]), f32(sun[2]))


@kernel
def _glints(buf: F32, sx: np.float32, sy: np.float32, sz: np.float32) -> None:
    """Add the sun's glints on the waves (Cox and Munk, 1954); `sx`, `sy`, `sz`: unit vector to the sun."""
    for i in range(B):
        hx, hy, hz = buf[Slot.VX + i] + sx, buf[Slot.VY + i] + sy, max(buf[Slot.VZ + i] + sz, f32(0.05))
        ex, ey = hx / hz + buf[Slot.WAVE_E + i], hy / hz + buf[Slot.WAVE_N + i]
        var = f32(2.0) * buf[Slot.WAVE_VAR + i]
        chance = fading((ex * ex + ey * ey) / var) / (f32(math.pi) * var)
        glint = f32(0.0157) * chance / max(buf[Slot.VZ + i], f32(0.1)) * buf[Slot.SUN + i]
        glint = min(glint, f32(30.0)) * buf[Slot.WATER + i]
        buf[Slot.RED + i] += glint
        buf[Slot.GREEN + i] += glint
        buf[Slot.BLUE + i] += glint


@kernel
def scum(buf: F32, base: F64, wind: F64, time: float, seed: int) -> None:
    """Cover part of the water with algae or foam that drifts slowly with the wind."""
    copy(buf, Slot.X, Slot.TX)
    copy(buf, Slot.Y, Slot.TY)
    fill(buf, Slot.CLOUD, 0.0)
    for k, wavelength in enumerate((4.0, 1.1, 0.3)):
        values_at(buf, base, wavelength, 0.8, 0.6, seed + k, -0.02 * wind[0] * time, -0.02 * wind[1] * time)
        for i in range(B):
            buf[Slot.CLOUD + i] += (f32(0.8) - f32(0.15) * f32(k)) * buf[Slot.N + i]
    for i in range(B):
        share = buf[Slot.SCUM + i] * buf[Slot.WATER + i]
        there = smoothstep(F0, f32(0.25), buf[Slot.CLOUD + i] + share - f32(2.5)) if share > F0 else F0
        light = (f32(0.35) + f32(0.6) * buf[Slot.SUN + i]) * (F1 + f32(0.2) * buf[Slot.N + i])
        buf[Slot.RED + i] += there * (f32(0.20) * light - buf[Slot.RED + i])
        buf[Slot.GREEN + i] += there * (f32(0.24) * light - buf[Slot.GREEN + i])
        buf[Slot.BLUE + i] += there * (f32(0.09) * light - buf[Slot.BLUE + i])
