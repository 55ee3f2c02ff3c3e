"""Light on a block of pixels: sun past terrain, clouds and cars; Lambert's law, back-scatter and shine; haze."""

from __future__ import annotations

import math

import numpy as np

from alight.compiled import kernel
from alight_sim.kernels.block import F0, F1, F32, F64, B, Slot, copy, f32, fading, fill, smoothstep, values_at
from alight_sim.kernels.texture import Trait

# values of the light, after the sun's direction (3), its colour (3) and the sky's (3)
HAZE, AIR, CLOUDS, CLOUD_SIZE, CLOUD_DARK, WIND, DRIFT = 9, 10, 13, 14, 15, 16, 18
LIGHTS = 20
SHADED, LIT = -0.03, 0.05  # metres by which the sun's ray clears the ground: half shadow between


@kernel
def face_normals(buf: F32, boxes: F64) -> None:
    """Set the normals of pixels on a car to the normal of the visible face."""
    for i in range(B):
        code = int(buf[Slot.FACE + i])
        side = code & 7
        if code == 0:
            continue
        box = boxes[code >> 3]
        buf[Slot.NX + i], buf[Slot.NY + i], buf[Slot.NZ + i] = F0, F0, F1
        if side > 1:
            sign = 1.0 if side == 2 or side == 4 else -1.0
            e, n = (box[3], box[4]) if side < 4 else (-box[4], box[3])
            buf[Slot.NX + i], buf[Slot.NY + i], buf[Slot.NZ + i] = f32(sign * e), f32(sign * n), F0


@kernel
def car_shadows(buf: F32, boxes: F64, base: F64, sun: F64) -> None:
    """Set the slot SUN to 0 in the shadows of cars."""
    for m in range(boxes.shape[0]):
        box = boxes[m]
        reach = math.hypot(box[5], box[6]) + (box[7] + 1.0) * math.hypot(sun[0], sun[1]) / max(sun[2], 0.05)
        se, sn = box[3] * sun[0] + box[4] * sun[1], box[3] * sun[1] - box[4] * sun[0]
        for i in range(B):
            dx, dy = base[0] + buf[Slot.X + i] - box[0], base[1] + buf[Slot.Y + i] - box[1]
            if dx * dx + dy * dy > reach * reach or (
                int(buf[Slot.FACE + i]) != 0 and int(buf[Slot.FACE + i]) >> 3 == m
            ):
                continue
            u, v, w = box[3] * dx + box[4] * dy, box[3] * dy - box[4] * dx, base[2] + buf[Slot.Z + i] - box[2]
            near, far = 1e-3, 1e9
            for p, d, low, high in ((u, se, -box[5], box[5]), (v, sn, -box[6], box[6]), (w, sun[2], 0.0, box[7])):
                if abs(d) < 1e-9:
                    near = near if low <= p <= high else 2e9
                    continue
                a, b = (low - p) / d, (high - p) / d
                near, far = max(near, min(a, b)), min(far, max(a, b))
            if near <= far:
                buf[Slot.SUN + i] = F0


@kernel
def sunshine(buf: F32, base: F64, lights: F64, time: float, seed: int) -> None:
    """Fill the slots SUN (share of the sunlight that reaches the ground) and CLOUD (share that clouds take)."""
    for i in range(B):
        buf[Slot.SUN + i] = smoothstep(f32(SHADED), f32(LIT), buf[Slot.MARGIN + i]) * (F1 - buf[Slot.SHADE + i])
    fill(buf, Slot.CLOUD, 0.0)
    if lights[CLOUD_DARK] <= 0.0:
        return
    copy(buf, Slot.X, Slot.TX)
    copy(buf, Slot.Y, Slot.TY)
    size, de, dn = lights[CLOUD_SIZE], -lights[DRIFT] * time, -lights[DRIFT + 1] * time
    for k, w in enumerate((0.75, 0.5, 0.3)):
        values_at(buf, base, size * 0.45**k, 0.8, 0.6, seed + k, de, dn)
        for i in range(B):
            buf[Slot.CLOUD + i] += f32(w) * buf[Slot.N + i]
    edge, dark = f32(lights[CLOUDS]), f32(lights[CLOUD_DARK])
    for i in range(B):
        buf[Slot.CLOUD + i] = dark * smoothstep(edge - f32(0.25), edge + f32(0.25), buf[Slot.CLOUD + i])
        buf[Slot.SUN + i] *= F1 - buf[Slot.CLOUD + i]


@kernel
def slope_normals(buf: F32) -> None:
    """Fill the slots NX, NY, NZ with surface normals from the slopes of the ground and of its micro-relief."""
    for i in range(B):
        bump = buf[Slot.PARAM + Trait.BUMP * B + i]
        e, n = buf[Slot.SLOPE_E + i] + bump * buf[Slot.BUMP_E + i], buf[Slot.SLOPE_N + i] + bump * buf[Slot.BUMP_N + i]
        scale = F1 / np.sqrt(F1 + e * e + n * n)
        buf[Slot.NX + i], buf[Slot.NY + i], buf[Slot.NZ + i] = -e * scale, -n * scale, scale


@kernel
def illuminate(buf: F32, lights: F32) -> None:
    """Light dry pixels by sun and sky (Lambert), with back-scatter of rough ground and shine of smooth ground."""
    sx, sy, sz = lights[0], lights[1], lights[2]
    for i in range(B):
        nx, ny, nz = buf[Slot.NX + i], buf[Slot.NY + i], buf[Slot.NZ + i]
        cosine = max(F0, nx * sx + ny * sy + nz * sz) * buf[Slot.SUN + i]
        vx, vy, vz = buf[Slot.VX + i], buf[Slot.VY + i], buf[Slot.VZ + i]
        phase = vx * sx + vy * sy + vz * sz
        leaf = buf[Slot.LEAF + i]
        sun = cosine * leaf * (F1 + buf[Slot.PARAM + Trait.HOT * B + i] * (phase * phase * phase - f32(0.35)))
        sky = buf[Slot.SKY + i] * (f32(0.5) + f32(0.5) * nz) * (f32(0.2) + f32(0.8) * leaf)
        hx, hy, hz = vx + sx, vy + sy, vz + sz
        half = (nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz + f32(1e-6))
        c2 = max(half * half, f32(0.05))
        shine = buf[Slot.PARAM + Trait.GLOSS * B + i]
        spark = shine * buf[Slot.SUN + i] * fading((F1 - c2) / c2 * f32(25.0)) * (f32(0.5) + f32(2.0) * (F1 - vz))
        dry = F1 - buf[Slot.WATER + i]
        wet = buf[Slot.WATER + i]
        mirror = shine * f32(0.12)
        red = buf[Slot.RED + i] * (lights[3] * sun + lights[6] * sky) + lights[3] * spark + mirror * lights[6] * sky
        green = buf[Slot.GREEN + i] * (lights[4] * sun + lights[7] * sky) + lights[4] * spark + mirror * lights[7] * sky
        blue = buf[Slot.BLUE + i] * (lights[5] * sun + lights[8] * sky) + lights[5] * spark + mirror * lights[8] * sky
        buf[Slot.RED + i] = dry * red + wet * buf[Slot.RED + i]
        buf[Slot.GREEN + i] = dry * green + wet * buf[Slot.GREEN + i]
        buf[Slot.BLUE + i] = dry * blue + wet * buf[Slot.BLUE + i]


@kernel
def dye(buf: F32) -> None:
    """Multiply the reflectance by the tint."""
    for i in range(B):
        buf[Slot.RED + i] *= buf[Slot.TINT_R + i]
        buf[Slot.GREEN + i] *= buf[Slot.TINT_G + i]
        buf[Slot.BLUE + i] *= buf[Slot.TINT_B + i]


@kernel
def haze(buf: F32, lights: F32) -> None:
    """Dim far points and add the light that the air scatters (Koschmieder, 1924); draw the sky if no ground is hit."""
    for i in range(B):
        up = max(-buf[Slot.VZ + i], F0)
        low = (F1 - up) * (F1 - up)
        seen = fading(min(lights[HAZE] * max(buf[Slot.DIST + i], F0), f32(9.0)))
        hit = F1 if buf[Slot.DIST + i] > F0 else F0
        for colour, k in ((Slot.RED, 0), (Slot.GREEN, 1), (Slot.BLUE, 2)):
            ground = buf[colour + i] * seen + lights[AIR + k] * (F1 - seen)
            sky = lights[6 + k] * (F1 + low)
            buf[colour + i] = hit * ground + (F1 - hit) * sky
