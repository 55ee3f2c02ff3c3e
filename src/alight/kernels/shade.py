"""The light that a hit point sends to a pixel: material by world position, sun with shadow, sky, moving water.

Every texture is noise of the world position, so that no place repeats, with each octave faded out below two pixel
footprints: the picture is band-limited as a lens would make it. Linear radiance; a white flat surface in the sun is
about 1. The columns of a material row are named in `alight.simulate.materials`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange
from alight.kernels.noise import gradient_noise, hash3

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]
Three = tuple[float, float, float]

BARE, TREE, WATER, ROCK, STRUCTURE = 1, 4, 5, 6, 8  # codes of records.Terrain
CONTRAST, BUMP, FLECKS, FLECK_SIZE, FLECK_GAIN, SWAY = 6, 7, 8, 9, 10, 11  # columns after the two colours
FIRST_WAVELENGTH = 3.0  # metres, of octave 0; each next is half as long
SLOPE_E, SLOPE_N, MARGIN, SKY, DEPTH = 0, 1, 2, 3, 4  # layers of `light`


@kernel
def _smooth(low: float, high: float, x: float) -> float:
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel
def _detail(x: float, y: float, footprint: float, amplitudes: F64, seed: int) -> Three:
    """Sum the octaves that the pixel resolves: value (about unit deviation) and its slopes, scaled by wavelength."""
    value, slope_x, slope_y, wavelength = 0.0, 0.0, 0.0, FIRST_WAVELENGTH
    c, s = 1.0, 0.0
    for k in range(amplitudes.size):
        w = amplitudes[k] * _smooth(1.6, 3.2, wavelength / footprint)
        if w <= 0.0:
            break
        relief = w * min(1.0, 0.4 / wavelength)  # long waves of relief are the height layer's
        u, v = (c * x - s * y) / wavelength, (s * x + c * y) / wavelength
        n, du, dv = gradient_noise(u, v, seed + 101 * k)
        value += w * n
        slope_x += relief * (c * du + s * dv)
        slope_y += relief * (c * dv - s * du)
        wavelength *= 0.5
        c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s  # 37 degrees an octave: lattices never line up
    return value, slope_x, slope_y


@kernel
def _flecks(x: float, y: float, footprint: float, size: float, density: float, seed: int) -> float:
    """Pebbles, leaves, flowers: one disc in some of the cells of a lattice; returns -1 (dark) to 1 (bright)."""
    total = 0.0
    for k in range(2):
        radius = size * (1.0 + 1.7 * k)
        fade = _smooth(0.5, 1.2, 2.0 * radius / footprint)
        if fade <= 0.0:
            continue
        cell = 5.0 * radius
        i, j = math.floor(x / cell), math.floor(y / cell)
        h = hash3(i, j, seed + 7 * k)
        if (h & 0xFF) >= 256.0 * density:
            continue
        cx, cy = 0.25 + 0.5 * ((h >> 8) & 0xFF) / 255.0, 0.25 + 0.5 * ((h >> 16) & 0xFF) / 255.0
        r = math.hypot(x / cell - i - cx, y / cell - j - cy) * cell
        disc = 1.0 - _smooth(0.7 * radius, 0.7 * radius + max(0.5 * radius, footprint), r)
        total += fade * disc * (((h >> 24) & 0xFF) / 127.5 - 1.0)
    return min(max(total, -1.0), 1.0)


@kernel
def _tiles(x: float, y: float, footprint: float, seed: int) -> float:
    """Roof tiles of 0.3 x 0.4 m, each with a brightness of its own, and the dark line between two rows."""
    fade: float = _smooth(1.0, 2.5, 0.3 / footprint)
    u, v = (0.94 * x - 0.34 * y) / 0.3, (0.34 * x + 0.94 * y) / 0.4
    h: int = hash3(math.floor(u), math.floor(v), seed)
    line = 1.0 if v - math.floor(v) < 0.12 else 0.0
    return 1.0 + fade * (0.35 * ((h & 0xFFFF) / 65535.0 - 0.5) - 0.45 * line)


@kernel
def _albedo(
    material: F64, amplitudes: F64, x: float, y: float, footprint: float, seed: int, out: F64
) -> tuple[float, float]:
    """Fill `out` (3,) with the colour at a place; return the slopes of its micro-relief."""
    large, _, _ = gradient_noise(x / 9.0, y / 9.0, seed + 1)
    value, slope_x, slope_y = _detail(x, y, footprint, amplitudes, seed + 3)
    mix = _smooth(0.0, 1.0, 0.5 + 0.28 * large + 0.16 * value)
    gain = 1.0 + material[CONTRAST] * value
    if material[FLECKS] > 0.0:
        spot = _flecks(x, y, footprint, material[FLECK_SIZE], material[FLECKS], seed + 5)
        gain *= 1.0 + material[FLECK_GAIN] * spot
    for k in range(3):
        out[k] = max(0.01, (material[k] * (1.0 - mix) + material[3 + k] * mix) * max(gain, 0.1))
    return material[BUMP] * slope_x, material[BUMP] * slope_y


@kernel
def _waves(x: float, y: float, time: float, footprint: float, seed: int) -> tuple[float, float]:
    """Slopes of small gravity waves: four trains, each at its own direction and phase speed sqrt(g L / 2 pi)."""
    slope_x, slope_y, wavelength, c, s = 0.0, 0.0, 1.3, 0.8, 0.6
    for k in range(4):
        w = 0.035 * _smooth(1.6, 3.2, wavelength / footprint)
        shift = 1.25 * math.sqrt(wavelength) * time
        n, du, dv = gradient_noise((x - c * shift) / wavelength, (y - s * shift) / wavelength, seed + 11 * k)
        _, ev, _ = gradient_noise((x + s * shift) / wavelength, (y - c * shift) / wavelength, seed + 5 + 11 * k)
        slope_x += w * (du + ev + 0.1 * n)
        slope_y += w * dv
        wavelength *= 0.43
        c, s = 0.87 * c - 0.49 * s, 0.49 * c + 0.87 * s
    return slope_x, slope_y


@kernel
def _label_near(label: U8, gx: float, gy: float) -> int:
    rows, cols = label.shape
    return int(label[min(max(int(gy + 0.5), 0), rows - 1), min(max(int(gx + 0.5), 0), cols - 1)])


@kernel
def _label_at(label: U8, gx: float, gy: float, x: float, y: float, footprint: float) -> int:
    """The class that colours a place: borders between two kinds of ground wander by a cell, as real ones do."""
    here: int = _label_near(label, gx, gy)
    if here in (TREE, ROCK, STRUCTURE):
        return here
    border = False
    for k in range(4):
        border |= _label_near(label, gx + (1.5 if k & 1 else -1.5), gy + (1.5 if k & 2 else -1.5)) != here
    if not border:
        return here
    _, wx, wy = gradient_noise(x / 0.4, y / 0.4, 77)
    _, vx, vy = gradient_noise(x / 0.1, y / 0.1, 78)
    fine = 0.15 * _smooth(1.6, 3.2, 0.1 / footprint)
    there: int = _label_near(label, gx + 0.25 * wx + fine * vx, gy + 0.25 * wy + fine * vy)
    return here if there in (TREE, ROCK, STRUCTURE) else there


@kernel
def _light_at(light: F32, gx: float, gy: float, out: F64) -> None:
    rows, cols = light.shape[:2]
    gx, gy = min(max(gx, 0.0), cols - 1.001), min(max(gy, 0.0), rows - 1.001)
    ix, iy = int(gx), int(gy)
    u, v = gx - ix, gy - iy
    for k in range(out.size):
        upper = light[iy, ix, k] * (1 - u) + light[iy, ix + 1, k] * u
        lower = light[iy + 1, ix, k] * (1 - u) + light[iy + 1, ix + 1, k] * u
        out[k] = upper * (1 - v) + lower * v


@kernel
def _illuminate(albedo: F64, slope_e: float, slope_n: float, here: F64, sun: F64, out: F64) -> None:
    """Lambert's law under sun and sky; `sun` (9,): direction to it, its colour, the sky's colour."""
    scale = 1.0 / math.sqrt(1.0 + slope_e * slope_e + slope_n * slope_n)
    cosine = max(0.0, (-slope_e * sun[0] - slope_n * sun[1] + sun[2]) * scale)
    lit = _smooth(-0.03, 0.05, here[MARGIN]) * cosine
    sky = here[SKY] * (0.5 + 0.5 * scale)
    for k in range(3):
        out[k] = albedo[k] * (sun[3 + k] * lit + sun[6 + k] * sky)


@kernel
def _water(
    materials: F64,
    amplitudes: F64,
    point: F64,
    ray: F64,
    here: F64,
    sun: F64,
    time: float,
    footprint: float,
    seed: int,
    out: F64,
) -> None:
    """Pond: the bed seen refracted and through the waves, dimmed with depth; body colour; the sky mirrored; glints."""
    slope_e, slope_n = _waves(point[0], point[1], time, footprint, seed + 40)
    depth = max(here[DEPTH], 0.0)
    down = max(-ray[2], 1e-3)
    bx = point[0] + depth * (ray[0] / down / 1.33 + 0.25 * slope_e)
    by = point[1] + depth * (ray[1] / down / 1.33 + 0.25 * slope_n)
    _albedo(materials[BARE], amplitudes[BARE], bx, by, footprint, seed + 50, out)
    length = math.sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2])
    lit = 0.25 + 0.75 * _smooth(-0.03, 0.05, here[MARGIN])
    mirror = 0.02 + 0.98 * (1.0 - down / length) ** 5
    # the mirrored ray against the sun: water glints where a wave tilts far enough
    ex, ey = ray[0] / length + 2 * slope_e * down / length, ray[1] / length + 2 * slope_n * down / length
    glint = math.exp(-((ex - sun[0]) ** 2 + (ey - sun[1]) ** 2) / 0.002) * _smooth(0.0, 0.1, here[MARGIN])
    for k in range(3):
        through = math.exp(-depth * (2.2 - 0.5 * k if k < 2 else 1.6))
        body = materials[WATER, k] * (1.0 + 0.5 * (slope_e * sun[0] + slope_n * sun[1]))
        ground = 0.7 * out[k] * through + body * (1.0 - through)
        sky = sun[6 + k] * (2.0 + 3.0 * (slope_e * sun[0] + slope_n * sun[1]))
        out[k] = ground * lit * (sun[3 + k] * sun[2] + sun[6 + k]) + mirror * (max(sky, 0.0) + 60.0 * glint)


@kernel
def _surface_place(point: F64, slope_e: float, slope_n: float) -> Three:
    """Where on its texture a point lies: seen from above on ground and roofs, from the side on walls and crowns.

    The third number says how much more of a wall than of the ground a pixel of a camera above it covers.
    """
    if max(abs(slope_e), abs(slope_n)) < 1.3:
        return point[0], point[1], 1.0
    if abs(slope_e) > abs(slope_n):
        return point[1] + 300.0, point[2] + 0.3 * point[0], 2.0
    return point[0] - 300.0, point[2] + 0.3 * point[1], 2.0


@kernel
def _radiance(
    label: U8, light: F32, place: F64, materials: F64, amplitudes: F64, point: F64, ray: F64, sun: F64, time: float,
    footprint: float, seed: int, here: F64, colour: F64, out: F64,
) -> None:  # fmt: skip
    """Fill `out` (3,) with the light from one world point along one ray. `place`: east, north of cell (0, 0), cell."""
    gx, gy = (point[0] - place[0]) / place[2], (place[1] - point[1]) / place[2]
    kind = _label_at(label, gx, gy, point[0], point[1], footprint)
    _light_at(light, gx, gy, here)
    if kind == WATER:
        _water(materials, amplitudes, point, ray, here, sun, time, footprint, seed, out)
        return
    x, y, stretch = _surface_place(point, here[SLOPE_E], here[SLOPE_N])
    footprint *= stretch
    if materials[kind, SWAY] > 0.0:
        phase, _, _ = gradient_noise(x / 2.0, y / 2.0, seed + 60)
        x += materials[kind, SWAY] * math.sin(5.0 * time + 4.0 * phase)
        y += materials[kind, SWAY] * math.sin(3.7 * time + 5.0 * phase)
    bump_e, bump_n = _albedo(materials[kind], amplitudes[kind], x, y, footprint, seed + 1000 * kind, colour)
    if kind == STRUCTURE:
        tile = _tiles(x, y, footprint, seed + 9)
        for k in range(3):
            colour[k] *= tile
    _illuminate(colour, here[SLOPE_E] + bump_e, here[SLOPE_N] + bump_n, here, sun, out)


@parallel_kernel
def shade(
    label: U8, light: F32, place: F64, materials: F64, amplitudes: F64, centre: F64, directions: F32, turn: F64,
    depth: F64, pixel: float, level: float, sun: F64, time: float, seed: int, weight: float, out: F32,
) -> None:  # fmt: skip
    """Add `weight` times each pixel's linear radiance to `out` (H, W, 3).

    `light` (R, C, 5): slope east, slope north, shadow margin, open sky, water depth. `centre` (3,), `turn` (3, 3):
    world from camera; `directions` (H, W, 3) with z = 1; `depth` (H, W) from `cast_rays`; `pixel`: angle of a pixel;
    `level`: height of the plane that goes on where the world ends; `time` in seconds moves water and plants.
    """
    for r in prange(out.shape[0]):
        point, ray, here, colour, result = np.empty(3), np.empty(3), np.empty(5), np.empty(3), np.empty(3)
        for c in range(out.shape[1]):
            for k in range(3):
                ray[k] = (
                    turn[k, 0] * directions[r, c, 0]
                    + turn[k, 1] * directions[r, c, 1]
                    + turn[k, 2] * directions[r, c, 2]
                )
            t = depth[r, c]
            if t < 0.0:
                t = (level - centre[2]) / ray[2] if ray[2] < 0.0 else -1.0
            if t <= 0.0:  # the sky
                for k in range(3):
                    out[r, c, k] += np.float32(weight * 2.0 * sun[6 + k])
                continue
            for k in range(3):
                point[k] = centre[k] + t * ray[k]
            _radiance(
                label, light, place, materials, amplitudes, point, ray, sun, time, max(t * pixel, 1e-4), seed,
                here, colour, result,
            )  # fmt: skip
            for k in range(3):
                out[r, c, k] += np.float32(weight * result[k])
