"""Painting a world: fractal relief and the things that stand on it, from one random stream."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.records import F32, F64, U8, Terrain

Mask = NDArray[np.bool_]


@dataclass(eq=False)
class Canvas:
    """Layers under construction; the brushes change them in place."""

    grid: Grid
    rng: np.random.Generator
    height: F64  # (R, C) metres
    label: U8  # (R, C)
    depth: F64  # (R, C) metres
    taken: Mask  # (R, C) where something stands already

    @classmethod
    def blank(cls, side: float, cell: float, rng: np.random.Generator) -> Canvas:
        """Flat short grass, `side` metres square about the origin."""
        n = round(side / cell)
        edge = 0.5 * (n - 1) * cell
        zero = np.zeros((n, n))
        label = np.full((n, n), Terrain.SHORT_GRASS, np.uint8)
        return cls(Grid(-edge, edge, cell, n, n), rng, zero, label, zero.copy(), np.zeros((n, n), bool))

    def fractal(self, longest: float, shortest: float, slope: float = 1.0) -> F64:
        """(R, C) random field of unit deviation, amplitude of a wavelength proportional to its power `slope`."""
        fy = np.fft.fftfreq(self.grid.rows, self.grid.cell)[:, None]
        fx = np.fft.rfftfreq(self.grid.cols, self.grid.cell)[None]
        f = np.maximum(np.hypot(fx, fy), 1e-9)
        band = 1.0 / (1.0 + (f * longest) ** -8) / (1.0 + (f * shortest) ** 8)
        white = np.fft.rfft2(self.rng.standard_normal(self.grid.shape))
        field = np.fft.irfft2(white * band * f ** (-slope - 1.0), s=self.grid.shape)
        return np.asarray(field / field.std())

    def window(self, east: float, north: float, reach: float) -> tuple[tuple[slice, slice], F64, F64]:
        """Slices of the layers within `reach` of a place, and east and north of their cells from there, metres."""
        row, col = (float(v) for v in self.grid.index(np.array(east), np.array(north)))
        k = math.ceil(reach / self.grid.cell) + 1
        rows = slice(max(0, round(row) - k), max(0, min(self.grid.rows, round(row) + k + 1)))
        cols = slice(max(0, round(col) - k), max(0, min(self.grid.cols, round(col) + k + 1)))
        x, y = self.grid.xy()
        return (rows, cols), x[None, cols] - east, y[rows, None] - north

    def free_place(self, reach: float, tries: int = 200) -> tuple[float, float] | None:
        """Draw a place whose surroundings are not taken, or None where the world is full."""
        x, y = self.grid.xy()
        for _ in range(tries):
            east, north = self.rng.uniform(x[0] + reach, x[-1] - reach), self.rng.uniform(y[-1] + reach, y[0] - reach)
            win, dx, dy = self.window(east, north, reach)
            if not (self.taken[win] & (np.hypot(dx, dy) < reach)).any():
                return float(east), float(north)
        return None

    def keep_free(self, east: float, north: float, reach: float) -> None:
        """Let nothing that is placed at random stand here."""
        win, dx, dy = self.window(east, north, reach)
        self.taken[win] |= np.hypot(dx, dy) < reach

    def rough(self, mask: Mask, amplitude: float, smooth: float) -> None:
        """Raise the masked cells by random tufts: `amplitude` metres, `smooth` metres across."""
        tufts = cv2.GaussianBlur(self.rng.standard_normal(self.grid.shape), (0, 0), smooth / self.grid.cell)
        self.height[mask] += amplitude * np.abs(tufts / tufts.std())[mask]

    def stamp(self, win: tuple[slice, slice], mask: Mask, surface: F64, kind: Terrain) -> None:
        """Put a thing on the ground: its surface replaces what is lower."""
        here = mask & (surface > self.height[win])
        self.height[win][here] = surface[here]
        self.label[win][here] = kind
        self.taken[win] |= here


def finish(canvas: Canvas) -> tuple[F32, U8, F32]:
    """The layers as a world holds them."""
    return canvas.height.astype(np.float32), canvas.label, canvas.depth.astype(np.float32)
