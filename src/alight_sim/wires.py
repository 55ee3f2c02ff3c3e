"""Spans in a picture: each pixel mixes the wire and what is behind it by the share of the pixel that the wire covers.

Spans are cut into short straight pieces, which are projected with the pose of the row where they appear. A piece is a
strip of exact area: the sum of the covered shares is its width times its length in pixels, however thin it is. The
shadow is the strip where the sun's rays past the piece meet the ground, blurred by the sun's disc and by the pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, Mask
from alight.geometry import Camera
from alight_sim.kernels.block import B, Slot
from alight_sim.kernels.illuminate import AIR, HAZE, LIT, sunshine
from alight_sim.kernels.raycast import cast_rays
from alight_sim.light import Sun
from alight_sim.patch import GroundPatch
from alight_sim.spans import TrueSpans

PIECE = 0.25  # metres, longest piece: straight to a tenth of a pixel through the lens's distortion from 4 m
SUN_WIDTH = math.radians(0.459)  # rad: width of the box whose variance is that of the sun's disc
NEAREST = 0.05  # metres: what is closer to the lens is not drawn
BEHIND = 0.05  # metres by which a wire may lie behind what hides it: the top of its own post
FLATTEST = 0.4  # cosine of the steepest piece that is gone through by columns, with the others of its line
THERE, FAR = 0.3, 0.02  # metres, and share of the depth, between a shadow's piece and ground that it falls on

Numbers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Hanging:
    """Straight pieces of the spans over a patch, and their shadows at one position of the sun. World axes, metres."""

    number: Numbers  # (M,) index of the span to which a piece belongs
    ends: F64  # (M, 2, 3) both ends of each piece
    colour: F64  # (M, 3) reflectance
    diameter: F64  # (M,) of the wire
    feet: F64  # (M, 2, 3) ends of the shadow on the ground, NaN where it falls beyond the patch or the longest shadow
    away: F64  # (M,) from the wire to its shadow

    @classmethod
    def of(cls, spans: TrueSpans, patch: GroundPatch, sun: Sun, reach: float) -> Hanging:
        """Cut spans into pieces and cast their shadows to a horizontal distance of at most `reach` metres."""
        number, ends = spans.pieces(PIECE)
        t = np.zeros(0) if not len(ends) else _fall(ends.reshape(-1, 3), patch, sun.direction)
        t[t * math.cos(sun.elevation) > reach] = np.nan
        feet = ends - t.reshape(-1, 2, 1) * sun.direction
        away = np.asarray(t.reshape(-1, 2).mean(axis=1))
        return cls(number, ends, spans.colour[number], spans.diameter[number], feet, away)

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return sum(a.nbytes for a in (self.number, self.ends, self.colour, self.diameter, self.feet, self.away))


def _fall(places: F64, patch: GroundPatch, sun: F64) -> F64:
    """Return the (N,) metres from positions (N, 3) along the rays of the sun to the patch's surface; NaN: they miss it.

    `sun`: (3,) unit vector towards the sun.
    """
    grid, cell = patch.grid, patch.grid.cell
    origins = np.column_stack([(places[:, 0] - grid.east) / cell, (grid.north - places[:, 1]) / cell, places[:, 2]])
    turns = np.repeat(np.diag([1.0 / cell, -1.0 / cell, 1.0])[None], len(places), axis=0)
    rays = np.repeat(-sun.astype(np.float32)[None, None], len(places), axis=0)
    out = np.empty((len(places), 1))
    cast_rays(patch.height, *patch.pyramid, np.ascontiguousarray(origins), rays, turns, patch.low, out)
    hit = origins[:, :2] - out * sun[:2] * (1.0 / cell, -1.0 / cell)
    # a ray that comes in below the surface of the patch's rim has fallen on ground outside
    inside = ((hit > 0.5) & (hit < np.array([grid.cols, grid.rows]) - 1.5)).all(axis=1)
    return np.where(inside & (out[:, 0] >= 0.0), out[:, 0], np.nan)


@dataclass(frozen=True, eq=False)
class CameraMoment:
    """Poses of a camera at one instant of an exposure, its rays, and the depth of the ground in its pixels."""

    camera: Camera
    rays: F32  # (H, W, 3) in the camera, z = 1
    turns: F64  # (N, 3, 3) rotations world_from_cam: one per row of the picture, or N = 1
    places: F64  # (N, 3) metres, positions world_from_cam
    depth: F64  # (H, W) along the optical axis, metres; below 0: sky

    def rows_of(self, points: F64) -> Numbers:
        """Return the (K,) index of the pose of the row in which each world point (K, 3) appears."""
        count = len(self.turns)
        row = np.full(len(points), count // 2)
        for _ in range(0 if count == 1 else 2):
            pixels, _ = self.project(points, row)
            row = np.clip(np.rint(np.nan_to_num(pixels[:, 1])), 0, count - 1).astype(np.intp)
        return row

    def project(self, points: F64, row: Numbers) -> tuple[F64, F64]:
        """Return (K, 2) pixels and (K,) depths of world points (K, 3), each seen with the pose of index `row` (K,)."""
        seen = np.einsum("kji,kj->ki", self.turns[row], points - self.places[row])
        seen[(np.abs(seen[:, :2]) > self._widest * seen[:, 2:]).any(axis=1), 2] = -1.0
        return self.camera.project(seen), seen[:, 2]

    @cached_property
    def _widest(self) -> F64:
        """(2,) largest |x / z|, |y / z| of usable points; the distortion would fold farther ones into the picture."""
        border = (self.rays[0], self.rays[-1], self.rays[:, 0], self.rays[:, -1])
        return np.asarray(1.15 * np.abs(np.concatenate(border)[:, :2]).max(axis=0) + 0.05)

    def ground(self, row: Numbers, col: Numbers) -> F64:
        """Return the (K, 3) world positions of the ground seen by the pixels at `row` (K,) and `col` (K,)."""
        n = row if len(self.turns) > 1 else np.zeros_like(row)
        ways = np.einsum("kij,kj->ki", self.turns[n], self.rays[row, col].astype(np.float64))
        return np.asarray(self.places[n] + self.depth[row, col, None] * ways)


@dataclass(frozen=True, eq=False)
class _Strips:
    """Pairs of a strip and a pixel that the strip touches."""

    number: Numbers  # (K,) index of the piece whose strip it is
    row: Numbers
    col: Numbers
    depth: F64  # (K,) metres, of the strip's middle line in the pixel
    share: F64  # (K,) share of the pixel that the strip covers


@dataclass(frozen=True, eq=False)
class Lit:
    """Sun, sky, haze and clouds at one instant."""

    numbers: F64  # (LIGHTS,) see `Light.numbers`
    time: float  # s
    seed: int  # of the clouds, as for `kernels.shade`

    @property
    def sun(self) -> tuple[F64, F64, F64]:
        """(3,) direction towards the sun, (3,) colour of the sun, (3,) colour of the sky."""
        return self.numbers[:3], self.numbers[3:6], self.numbers[6:9]

    def haze(self, away: F64) -> F64:
        """Return the (N,) share of the light that haze leaves over the distances `away` (N,), metres."""
        return np.asarray(np.exp(-self.numbers[HAZE] * away))

    def sunshine(self, places: F64, margin: F64) -> F64:
        """Return the (N,) share of the sunlight that terrain and clouds leave at positions (N, 3).

        `margin`: (N,) metres, shadow margins there; see `GroundPatch.light`.
        """
        buf, out = np.zeros(Slot.PARAM, np.float32), np.empty(len(places))
        for first in range(0, len(places), B):
            block, base = places[first : first + B], np.floor(places[first])
            buf[Slot.X : Slot.X + len(block)], buf[Slot.Y : Slot.Y + len(block)] = (block - base)[:, :2].T
            buf[Slot.MARGIN : Slot.MARGIN + len(block)] = margin[first : first + B]
            sunshine(buf, base, self.numbers, self.time, self.seed + 950)
            out[first : first + B] = buf[Slot.SUN : Slot.SUN + len(block)]
        return out


def draw(hanging: Hanging, view: CameraMoment, patch: GroundPatch, lit: Lit, out: F32) -> None:
    """Draw the shadows of spans and then the spans on a picture `out`, linear light (H, W, 3), in place."""
    _draw_shadows(hanging, view, patch, lit, out)
    _draw_wires(hanging, view, lit, out)


def _draw_wires(hanging: Hanging, view: CameraMoment, lit: Lit, out: F32) -> None:
    middle = hanging.ends.mean(axis=1)
    along = _unit(hanging.ends[:, 1] - hanging.ends[:, 0])
    towards = view.places[len(view.places) // 2] - middle
    rim = 0.5 * hanging.diameter[:, None] * _unit(np.cross(along, towards))
    strips = _strips(view, hanging.number, hanging.ends, rim)
    behind = view.depth[strips.row, strips.col]
    seen = (behind < 0.0) | (strips.depth < behind + BEHIND)
    k, share = strips.number[seen], strips.share[seen]
    drawn, k = np.unique(k, return_inverse=True)  # pieces in the picture
    light = _radiance(along[drawn], towards[drawn], hanging.colour[drawn], middle[drawn], lit)
    pixel = strips.row[seen] * out.shape[1] + strips.col[seen]
    flat = out.reshape(-1, 3)
    covered = np.bincount(pixel, share, len(flat))
    found = np.flatnonzero(covered > 0.0)
    part = np.minimum(covered[found], 1.0)
    for c in range(3):
        mean = np.bincount(pixel, share * light[k, c], len(flat))[found] / covered[found]
        flat[found, c] = (1.0 - part) * flat[found, c] + part * mean


def _radiance(along: F64, towards: F64, colour: F64, places: F64, lit: Lit) -> F64:
    """Return the (M, 3) light that cylinders send to the camera, through haze, by Lambert's law over the visible half.

    Args:
        along: (M, 3) unit vectors along the cylinders.
        towards: (M, 3) metres, vectors from the cylinders to the camera.
        colour: (M, 3) reflectances.
        places: (M, 3) positions of the cylinders.
        lit: the light.
    """
    sun, direct, sky = lit.sun
    s, v = (d - (d * along).sum(axis=1, keepdims=True) * along for d in (np.broadcast_to(sun, along.shape), towards))
    turn = np.arccos(np.clip((_unit(s) * _unit(v)).sum(axis=1), -1.0, 1.0))
    shine = 0.25 * np.linalg.norm(s, axis=1) * ((math.pi - turn) * np.cos(turn) + np.sin(turn))
    shine *= lit.sunshine(places, np.full(len(places), LIT))
    up = 0.25 * math.pi * _unit(v)[:, 2]
    own = colour * (direct * shine[:, None] + sky * (0.5 + 0.5 * up[:, None]))
    seen = lit.haze(np.linalg.norm(towards, axis=1))[:, None]
    return np.asarray(own * seen + lit.numbers[AIR : AIR + 3] * (1.0 - seen))


def _draw_shadows(hanging: Hanging, view: CameraMoment, patch: GroundPatch, lit: Lit, out: F32) -> None:
    sun, _, _ = lit.sun
    there = np.isfinite(hanging.feet).all(axis=(1, 2))
    feet, ends = hanging.feet[there], hanging.ends[there]
    # a step aside, square to wire and ray, seen along the ray on level ground
    step = _unit(np.cross(sun, ends[:, 1] - ends[:, 0]))
    step -= step[:, 2:] / sun[2] * sun
    blur = SUN_WIDTH * hanging.away[there]
    rim = 0.5 * hanging.diameter[there, None] * step
    strips = _strips(view, hanging.number[there], feet, rim, blur / hanging.diameter[there])
    near = np.abs(strips.depth - view.depth[strips.row, strips.col]) < THERE + FAR * strips.depth
    pixel = strips.row[near] * out.shape[1] + strips.col[near]
    dark = np.bincount(pixel, strips.share[near], out.shape[0] * out.shape[1])
    found = np.flatnonzero(dark > 0.0)
    row, col = np.divmod(found, out.shape[1])
    taken = np.minimum(dark[found], 1.0)[:, None] * _sun_share(view.ground(row, col), patch, lit)
    away = view.depth[row, col] * np.linalg.norm(view.rays[row, col], axis=1)
    out[row, col] *= (1.0 - taken * lit.haze(away)[:, None]).astype(np.float32)


def _sun_share(places: F64, patch: GroundPatch, lit: Lit) -> F64:
    """Return the (K, 3) share of direct sunlight in the light of ground at positions (K, 3); 0 in shadow and water."""
    sun, direct, sky = lit.sun
    east, north, size = patch.skin_place
    rows, cols = patch.skin.shape[:2]
    i = np.clip(np.rint((north - places[:, 1]) / size), 0, rows - 1).astype(np.intp)
    j = np.clip(np.rint((places[:, 0] - east) / size), 0, cols - 1).astype(np.intp)
    slope_e, slope_n, margin, opened, depth = patch.skin[i, j, :5].astype(np.float64).T
    normal = _unit(np.stack([-slope_e, -slope_n, np.ones_like(slope_e)], axis=1))
    shine = lit.sunshine(places, margin) * np.maximum(normal @ sun, 0.0)
    shine = np.where(depth > 0.0, 0.0, shine)[:, None]
    return np.asarray(direct * shine / (direct * shine + sky * (opened * (0.5 + 0.5 * normal[:, 2]))[:, None]))


def _strips(view: CameraMoment, line: Numbers, ends: F64, rim: F64, blur: F64 | None = None) -> _Strips:
    """Rasterise pieces as strips of some width.

    Args:
        view: the camera.
        line: (M,) index of the span to which each piece belongs.
        ends: (M, 2, 3) both ends of the strips' middle lines, world.
        rim: (M, 3) metres, vectors from the middle lines to the strips' edges.
        blur: (M,) width of the blur of a shadow over the width of its strip; None: no blur, i.e. a pixel's share is its
            exact overlap with the strip.
    """
    camera = view.camera
    flat = ends.reshape(-1, 3)
    pixels, depth = view.project(flat, view.rows_of(flat))
    pixels, depth = pixels.reshape(-1, 2, 2), depth.reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        seen = (depth > NEAREST).all(axis=1) & (high > -1.0).all(axis=1)
        seen &= (low < [camera.width, camera.height]).all(axis=1)
    kept = np.flatnonzero(seen)
    pixels, depth = pixels[kept], depth[kept]
    middle = ends[kept].mean(axis=1)
    row = view.rows_of(middle)
    beside = view.project(middle + rim[kept], row)[0] - view.project(middle, row)[0]
    way = pixels[:, 1] - pixels[:, 0]
    length = np.maximum(np.hypot(*way.T), 1e-9)
    half = np.abs(way[:, 0] * beside[:, 1] - way[:, 1] * beside[:, 0]) / length
    cosines = np.abs(way) / length[:, None]
    across, down = (np.bincount(line[kept], np.abs(way[:, k])) for k in (0, 1))
    steep = (down > across)[line[kept]]  # all pieces of a line, or wide ones would overlap at their joints
    steep = np.where(np.take_along_axis(cosines, steep[:, None].astype(np.intp), 1)[:, 0] < FLATTEST, ~steep, steep)
    # widths of two boxes whose convolution smears the strip's edge: the square pixel, seen askew; or pixel and blur
    soft = cosines if blur is None else np.column_stack([np.ones(len(kept)), 2.0 * half * blur[kept]])
    number, at, share, r, c = _pixels_of(pixels, half, cosines, steep, soft, (camera.height, camera.width))
    inverse = (1.0 - at) / depth[number, 0] + at / depth[number, 1]
    return _Strips(kept[number], r, c, 1.0 / inverse, share)


def _pixels_of(
    pixels: F64, half: F64, cosines: F64, steep: Mask, soft: F64, shape: tuple[int, int]
) -> tuple[Numbers, F64, F64, Numbers, Numbers]:
    """Return index of the strip, position along it (0 to 1), covered share, row and column for all pixels of strips.

    Each is (K,). A steep strip is drawn row by row, any other strip column by column. Its first and last line are
    weighted by the part of the line that the strip reaches into, so that successive pieces add up.

    Args:
        pixels: (M, 2, 2) pixels of both ends.
        half: (M,) half widths, pixels.
        cosines: (M, 2) absolute cosines of the strip's direction with the axes u and v.
        steep: (M,) whether a strip is drawn row by row.
        soft: (M, 2) widths of the two boxes whose convolution smears the strip's edges, pixels.
        shape: rows and columns of the picture.
    """
    major = np.where(steep[:, None], pixels[..., 1], pixels[..., 0])
    minor = np.where(steep[:, None], pixels[..., 0], pixels[..., 1])
    size = np.where(steep, shape[0], shape[1])
    a, b = major.min(axis=1), major.max(axis=1)
    first = np.clip(np.floor(a + 0.5), 0, size).astype(np.intp)
    count = np.clip(np.floor(b + 0.5), -1, size - 1).astype(np.intp) - first + 1
    number, k = _runs(count)
    x = first[number] + k
    part = np.minimum(x + 0.5, b[number]) - np.maximum(x - 0.5, a[number])
    rise = major[:, 1] - major[:, 0]
    at = (x - major[number, 0]) / np.where(rise == 0.0, 1e-9, rise)[number]
    y = minor[number, 0] + at * (minor[number, 1] - minor[number, 0])
    cosine = np.maximum(np.where(steep, cosines[:, 1], cosines[:, 0]), 0.5 * FLATTEST)
    reach = ((half + 0.5 * soft.sum(axis=1)) / cosine)[number]
    across = np.where(steep, shape[1], shape[0])[number]
    low = np.maximum(np.ceil(y - reach), 0).astype(np.intp)
    run, k = _runs(np.minimum(np.floor(y + reach), across - 1).astype(np.intp) - low + 1)
    number, part, at, x = number[run], part[run], at[run], x[run]
    z = low[run] + k
    aside = (z - y[run]) * cosine[number]
    share = part * (_below(aside + half[number], soft[number]) - _below(aside - half[number], soft[number]))
    good = share > 0.0
    row, col = np.where(steep[number], x, z), np.where(steep[number], z, x)
    return number[good], np.clip(at[good], 0.0, 1.0), share[good], row[good], col[good]


def _runs(count: Numbers) -> tuple[Numbers, Numbers]:
    """Return each item's run and its index in the run, both (K,); `count`: (M,) number of items in each run."""
    count = np.maximum(count, 0)
    number = np.repeat(np.arange(len(count)), count)
    return number, np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)


def _below(x: F64, soft: F64) -> F64:
    """Return the (K,) integral up to `x` (K,) of the convolution of two unit-area boxes of widths `soft` (K, 2)."""
    wide, thin = soft.max(axis=1), np.maximum(soft.min(axis=1), 1e-3)
    wide = np.maximum(wide, 2e-3)
    corners = ((1, wide + thin), (-1, wide - thin), (-1, thin - wide), (1, -wide - thin))
    total = sum(sign * np.maximum(x + 0.5 * shift, 0.0) ** 2 for sign, shift in corners)
    return np.asarray(0.5 * total / (wide * thin))


def _unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
