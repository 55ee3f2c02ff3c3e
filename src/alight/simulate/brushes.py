"""What stands on the ground: clearings, ponds, tall grass, paths, trees, boulders, houses."""

from __future__ import annotations

import math

import cv2
import numpy as np

from alight.records import F64, Terrain
from alight.simulate.canvas import Canvas

ROOF_TURN = -0.347  # rad: the ridge along the rows of tiles that the shader draws


def _ramp(low: float, high: float, x: F64) -> F64:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _lumps(canvas: Canvas, shape: tuple[int, ...], size: float) -> F64:
    noise = cv2.GaussianBlur(canvas.rng.standard_normal(shape), (0, 0), size / canvas.grid.cell)
    return np.asarray(noise / max(noise.std(), 1e-9))


def clearing(canvas: Canvas, east: float, north: float, radius: float, kind: Terrain = Terrain.SHORT_GRASS) -> None:
    """Level a disc (2 % left of its relief), blended into the ground over another half radius."""
    win, dx, dy = canvas.window(east, north, 1.6 * radius)
    r = np.hypot(dx, dy)
    ground = canvas.height[win]
    level = ground[r < radius].mean()
    keep = 0.02 + 0.98 * _ramp(radius, 1.5 * radius, r)
    canvas.height[win] = level + keep * (ground - level)
    canvas.label[win][r < radius * (0.95 + 0.04 * _lumps(canvas, r.shape, 0.8))] = kind
    canvas.keep_free(east, north, 1.1 * radius)


def pond(canvas: Canvas, east: float, north: float, radius: float, deepest: float = 1.3) -> None:
    """Dig a bowl with a wandering shore and fill it: the water's surface is level, half a metre below the ground."""
    win, dx, dy = canvas.window(east, north, 2.2 * radius)
    r = np.hypot(dx, dy * 1.25) * (1.0 + 0.12 * _lumps(canvas, canvas.height[win].shape, 0.3 * radius)) / radius
    level = float(canvas.height[win][r < 1.0].mean()) - 0.5
    bowl = level - deepest * (1.0 - r * r)
    bank = _ramp(1.0, 1.7, r)
    ground = np.where(r < 1.0, bowl, level + bank * (canvas.height[win] - level))
    wet = r < 1.0
    canvas.depth[win] = np.where(wet, level - bowl, 0.0)
    canvas.height[win] = np.where(wet, level, ground)
    canvas.label[win][(r < 1.12) & ~wet] = Terrain.BARE
    canvas.label[win][wet] = Terrain.WATER
    canvas.taken[win] |= r < 1.2


def tall_grass(canvas: Canvas, share: float, top: float = 0.55) -> None:
    """Cover a share of the free ground with patches of tufts, `top` metres at their highest."""
    field = canvas.fractal(14.0, 1.0, 1.2)
    mask = (field > np.quantile(field, 1.0 - share)) & ~canvas.taken & (canvas.label == Terrain.SHORT_GRASS)
    mask &= cv2.erode((~canvas.taken).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    inside = np.minimum(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) * canvas.grid.cell / 0.5, 1.0)
    canvas.height[mask] += (0.4 * top * inside)[mask]
    canvas.rough(mask, 0.2 * top, 0.12)
    canvas.label[mask] = Terrain.TALL_VEGETATION
    canvas.taken |= mask


def bare_patches(canvas: Canvas, share: float) -> None:
    """Lay open earth or gravel in patches of some metres."""
    field = canvas.fractal(10.0, 0.6, 1.0)
    mask = (field > np.quantile(field, 1.0 - share)) & (canvas.label == Terrain.SHORT_GRASS)
    canvas.label[mask] = Terrain.BARE


def path(canvas: Canvas, points: list[tuple[float, float]], width: float, kind: Terrain = Terrain.BARE) -> None:
    """Draw a way along a line of (east, north), smoothed to `width` metres; water and things in its way stay."""
    rows, cols = canvas.grid.index(*np.array(points).T)
    line = np.full(canvas.grid.shape, 255, np.uint8)
    cv2.polylines(line, [np.round(np.column_stack([cols, rows])).astype(np.int32)], False, 0, 1)
    away = cv2.distanceTransform(line, cv2.DIST_L2, 5) * canvas.grid.cell
    mask = (away < 0.5 * width * (1.0 + 0.15 * _lumps(canvas, line.shape, 0.6))) & (canvas.label != Terrain.WATER)
    canvas.label[mask] = kind
    canvas.taken |= mask


def tree(canvas: Canvas, east: float, north: float, radius: float, top: float) -> None:
    """A crown: a dome of leaf clumps with a ragged edge, from `top` metres down to a third of that, no view below."""
    win, dx, dy = canvas.window(east, north, 1.4 * radius)
    r = np.hypot(dx, dy) / radius
    clumps = 0.7 * _lumps(canvas, r.shape, 0.30) + 0.7 * _lumps(canvas, r.shape, 0.11)
    r = r * (1.0 + 0.09 * _lumps(canvas, r.shape, 0.35) + 0.05 * _lumps(canvas, r.shape, 0.12))
    ground = float(np.median(canvas.height[win]))
    dome = top * (0.35 + 0.65 * np.sqrt(np.maximum(1.0 - r * r, 0.0)))
    canvas.stamp(win, r < 1.0, ground + dome + 0.4 * clumps, Terrain.TREE)


def boulder(canvas: Canvas, east: float, north: float, radius: float) -> None:
    """A half-buried ellipsoid with a hewn surface."""
    win, dx, dy = canvas.window(east, north, 1.6 * radius)
    turn, flat = canvas.rng.uniform(0, math.pi), canvas.rng.uniform(0.6, 1.0)
    u, v = math.cos(turn) * dx + math.sin(turn) * dy, math.cos(turn) * dy - math.sin(turn) * dx
    r2 = (u / radius) ** 2 + (v / (flat * radius)) ** 2
    dome = 0.75 * radius * np.sqrt(np.maximum(1.0 - r2, 0.0)) + 0.06 * radius * _lumps(canvas, r2.shape, 0.15)
    canvas.stamp(win, r2 < 1.0, canvas.height[win] + np.maximum(dome, 0.02), Terrain.ROCK)


def house(canvas: Canvas, east: float, north: float, size: tuple[float, float], turn: float = ROOF_TURN) -> None:
    """Walls of 2.8 m and a gable roof of 40 degrees; a chimney; a paved border."""
    win, dx, dy = canvas.window(east, north, math.hypot(*size))
    u, v = math.cos(turn) * dx + math.sin(turn) * dy, math.cos(turn) * dy - math.sin(turn) * dx
    ground = float(canvas.height[win][(np.abs(u) < size[0] / 2) & (np.abs(v) < size[1] / 2)].mean())
    outside = np.maximum(np.abs(u) - size[0] / 2, np.abs(v) - size[1] / 2)
    near = outside < 1.0
    blend = _ramp(1.0, 3.0, outside)
    canvas.height[win] = np.where(near, ground, ground + blend * (canvas.height[win] - ground))
    canvas.label[win][near] = Terrain.PAVED
    roof = ground + 2.8 + math.tan(math.radians(40.0)) * (size[1] / 2 - np.abs(v))
    chimney = (np.abs(u - 0.25 * size[0]) < 0.4) & (np.abs(v - 0.12 * size[1]) < 0.4)
    canvas.stamp(win, outside < 0.0, np.where(chimney, roof.max() + 0.5, roof), Terrain.STRUCTURE)
    canvas.taken[win] |= outside < 2.0
