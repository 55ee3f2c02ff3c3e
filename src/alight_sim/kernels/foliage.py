"""Plants for a block of pixels: leaves at several depths below the surface, moved by the wind."""

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
    largest,
    noise_at,
    smallest,
    smoothstep,
    values_at,
)
from alight_sim.kernels.texture import Trait


@kernel
def sway(buf: F32, base: F64, wind: F64, time: float, seed: int) -> None:
    """Shift the texture of plants by the wind (2,), m/s east and north, with gusts that travel along it."""
    if largest(buf, Slot.PARAM + Trait.SWAY * B) <= 0.0:
        return
    speed = math.hypot(wind[0], wind[1])
    push = f32(min(speed / 4.0, 3.0))
    noise_at(buf, base, 1.9, 0.8, 0.6, seed, -0.7 * wind[0] * time, -0.7 * wind[1] * time)
    for i in range(B):
        reach = push * buf[Slot.PARAM + Trait.SWAY * B + i]
        buf[Slot.TX + i] += reach * (buf[Slot.N + i] + f32(0.3) * buf[Slot.DU + i])
        buf[Slot.TY + i] += reach * (f32(0.3) * buf[Slot.DV + i] - f32(0.5) * buf[Slot.N + i])


@kernel
def _sift(buf: F32, wavelength: np.float32, coarse: np.float32) -> None:
    for i in range(B):
        share = buf[Slot.PARAM + Trait.COARSE * B + i]
        w = coarse * share + (F1 - coarse) * (F1 - share)
        buf[Slot.WEIGHT + i] += w * smoothstep(f32(1.2), f32(2.4), wavelength / buf[Slot.FOOT + i]) * buf[Slot.N + i]


@kernel
def _choose(buf: F32, part: np.float32, gain: np.float32, opaque: np.float32) -> None:
    """Show a layer at depth `part` * P_DEEP, of light `gain` and density `opaque`, where it is the first opaque one."""
    for i in range(B):
        deep = part * buf[Slot.PARAM + Trait.DEEP * B + i]
        free = F1 if buf[Slot.SHADE + i] < F0 else F0
        take = free if buf[Slot.WEIGHT + i] > buf[Slot.PARAM + Trait.OPEN * B + i] - opaque else F0
        shown = F1 + (gain - F1) * min(
            f32(2.2) * buf[Slot.PARAM + Trait.DEEP * B + i], F1
        )  # little shade under short grass
        buf[Slot.SHADE + i] = shown if take > F0 else buf[Slot.SHADE + i]
        fall = min(deep / max(buf[Slot.VZ + i], f32(0.3)), f32(1.5))
        buf[Slot.ALONG + i] = fall if take > F0 else buf[Slot.ALONG + i]


@kernel
def foliage(buf: F32, base: F64, seed: int) -> None:
    """Draw crowns and grass as three layers of leaves; fill the slot LEAF with the light of the first opaque layer.

    Leaves lie at several depths below the surface, so views from two positions disagree, as with real plants.
    """
    fill(buf, Slot.SHADE, 1.0)
    if largest(buf, Slot.PARAM + Trait.DEEP * B) > 0.0:
        fill(buf, Slot.SHADE, -1.0)
        fill(buf, Slot.ALONG, 0.0)
        finest = smallest(buf, Slot.FOOT)
        copy(buf, Slot.TX, Slot.KEPT_X)
        copy(buf, Slot.TY, Slot.KEPT_Y)
        values_at(buf, base, 0.33, 0.28, 0.96, seed + 77)  # leaves of a layer have many heights
        _hang(buf)
        for k, (part, gain, opaque) in enumerate(((0.0, 1.2, 0.0), (0.4, 0.55, 0.35), (1.0, 0.2, 9.0))):
            fill(buf, Slot.WEIGHT, 0.0)
            _shift(buf, f32(part))
            for m, wavelength in enumerate((0.41, 0.17, 0.062)):
                if wavelength > 1.2 * finest and k < 2:
                    values_at(buf, base, wavelength, math.cos(k + 2.0 * m), math.sin(k + 2.0 * m), seed + 10 * k + m)
                    _sift(buf, f32(wavelength), f32(1.0 - 0.5 * m))
            _choose(buf, f32(part), f32(gain), f32(opaque))
        _settle(buf)
    copy(buf, Slot.SHADE, Slot.LEAF)
    for i in range(B):  # the flanks of a crown show the dark below it
        e, n = buf[Slot.SLOPE_E + i], buf[Slot.SLOPE_N + i]
        flank = (
            smoothstep(f32(1.5), f32(5.0), np.sqrt(e * e + n * n))
            if buf[Slot.PARAM + Trait.DEEP * B + i] > f32(0.2)
            else F0
        )
        buf[Slot.LEAF + i] *= F1 - f32(0.85) * flank


@kernel
def _hang(buf: F32) -> None:
    """Shift the texture position of each leaf by the parallax of its own depth; the clumps of a crown have two depths.

    P_LIFT is subtracted from this depth. It is the height of the tips of short plants above their true height, which is
    the mean of their visible heights.
    """
    for i in range(B):
        deep = buf[Slot.PARAM + Trait.DEEP * B + i]
        n = buf[Slot.N + i] * smoothstep(f32(1.2), f32(2.4), f32(0.33) / buf[Slot.FOOT + i])
        clump = smoothstep(f32(-0.35), f32(0.35), n)
        crown = smoothstep(f32(0.15), f32(0.5), deep)
        blades = f32(0.16) * min(max(F1 + f32(0.8) * n, F0), F2)
        own = deep * (blades + crown * (f32(0.5) * clump - blades)) - buf[Slot.PARAM + Trait.LIFT * B + i]
        fall = own / max(buf[Slot.VZ + i], f32(0.3))
        buf[Slot.KEPT_X + i] -= buf[Slot.VX + i] * fall
        buf[Slot.KEPT_Y + i] -= buf[Slot.VY + i] * fall


@kernel
def _shift(buf: F32, part: np.float32) -> None:
    for i in range(B):
        fall = min(part * buf[Slot.PARAM + Trait.DEEP * B + i] / max(buf[Slot.VZ + i], f32(0.3)), f32(1.5))
        buf[Slot.TX + i] = buf[Slot.KEPT_X + i] - buf[Slot.VX + i] * fall
        buf[Slot.TY + i] = buf[Slot.KEPT_Y + i] - buf[Slot.VY + i] * fall


@kernel
def _settle(buf: F32) -> None:
    for i in range(B):
        buf[Slot.TX + i] = buf[Slot.KEPT_X + i] - buf[Slot.VX + i] * buf[Slot.ALONG + i]
        buf[Slot.TY + i] = buf[Slot.KEPT_Y + i] - buf[Slot.VY + i] * buf[Slot.ALONG + i]
