"""Built-in scenes, each from a seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from alight.geometry import LocalFrame
from alight.records import InputError, Terrain
from alight.simulate import brushes
from alight.simulate.canvas import Canvas, finish
from alight.simulate.world import Sun, World

LOCAL = LocalFrame(47.6213, 13.4127, 512.0)
SIDE, CELL = 72.0, 0.1  # metres


def demo(canvas: Canvas) -> None:
    """A meadow to land in: level clearing, tall grass, trees, boulders, a house, a pond and a path."""
    canvas.height += 0.45 * canvas.fractal(40.0, 4.0, 1.6) + 0.012 * canvas.fractal(3.0, 0.2, 0.8)
    brushes.clearing(canvas, *_about(canvas, 3.0, -3.0), 5.0)
    brushes.pond(canvas, *_about(canvas, 12.0, 10.0), 6.0)
    brushes.house(canvas, *_about(canvas, -15.0, 9.0), (9.0, 6.5))
    brushes.path(canvas, [(-38.0, 2.0), (-20.0, 3.0), (-9.0, 3.5), (-3.0, 5.0), (1.0, 14.0), (2.0, 38.0)], 1.1)
    _scatter_trees(canvas, 14, (1.6, 3.2))
    brushes.tall_grass(canvas, 0.28)
    brushes.bare_patches(canvas, 0.15)
    _scatter_boulders(canvas, 32, (0.2, 0.9))


def hopeless(canvas: Canvas) -> None:
    """Nowhere to land: steep boulder fields and forest, not one place that is level and clear."""
    canvas.height += 1.8 * canvas.fractal(16.0, 3.0, 1.2) + 0.10 * canvas.fractal(1.5, 0.2, 0.6)
    canvas.label[canvas.fractal(12.0, 0.6, 1.0) > -0.3] = Terrain.BARE
    _scatter_trees(canvas, 90, (1.4, 3.0))
    _scatter_boulders(canvas, 900, (0.25, 0.9))


SCENES: dict[str, Callable[[Canvas], None]] = {"demo": demo, "hopeless": hopeless}


def build(name: str, seed: int = 0, cell: float = CELL) -> World:
    """Make a built-in scene; the same seed makes the same ground.

    Raises:
        InputError: there is no scene of this name.
    """
    if name not in SCENES:
        raise InputError(f"no scene is called {name!r}; use one of: {', '.join(SCENES)}")
    rng = np.random.default_rng(np.random.SeedSequence([seed, *name.encode()]))
    canvas = Canvas.blank(SIDE, cell, rng)
    SCENES[name](canvas)
    height, label, depth = finish(canvas)
    text = (SCENES[name].__doc__ or "").strip()
    return World(name, text, seed, LOCAL, canvas.grid, height, label, depth, Sun())


def _about(canvas: Canvas, east: float, north: float) -> tuple[float, float]:
    de, dn = canvas.rng.uniform(-1.5, 1.5, 2)
    return float(east + de), float(north + dn)


def _scatter_trees(canvas: Canvas, count: int, radius: tuple[float, float]) -> None:
    for _ in range(count):
        r = float(canvas.rng.uniform(*radius))
        place = canvas.free_place(1.1 * r)
        if place is not None:
            brushes.tree(canvas, *place, r, r * float(canvas.rng.uniform(1.7, 2.6)))


def _scatter_boulders(canvas: Canvas, count: int, radius: tuple[float, float]) -> None:
    """Many small, few large: the number goes with the radius to the power -2."""
    low, high = radius
    for _ in range(count):
        r = 1.0 / float(canvas.rng.uniform(1.0 / high, 1.0 / low))
        place = canvas.free_place(r)
        if place is not None:
            brushes.boulder(canvas, *place, r)
