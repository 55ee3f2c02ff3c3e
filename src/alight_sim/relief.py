"""Fractal relief of the ground, evaluated at any position."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64
from alight_sim.kernels.layers import ReliefForm, add_fractal, add_fractal_here
from alight_sim.section import Section

FORMS = {"hills": ReliefForm.HILLS, "ridges": ReliefForm.RIDGES, "dunes": ReliefForm.DUNES}
FEW = 8192  # number of positions up to which one thread is faster than several


class FractalRelief(Section):
    """Fractal relief between two wavelengths."""

    height: float = Field(0.4, ge=0.0, le=200.0, description="metres, standard deviation")
    longest: float = Field(40.0, gt=0.0, le=5000.0, description="metres, longest wavelength")
    shortest: float = Field(4.0, ge=0.01, description="metres, shortest wavelength")
    fall: float = Field(1.5, ge=0.0, le=4.0, description="amplitude goes with wavelength to this power: 0 is jagged")
    form: Literal["hills", "ridges", "dunes"] = Field("hills", description="hills | ridges (creased) | dunes (long)")
    turn_deg: float = Field(0.0, description="of the pattern, counter-clockwise; the crests of dunes run north at 0")

    def octaves(self) -> tuple[F64, F64]:
        """Return the wavelength and the standard deviation of each octave, longest first, metres."""
        return octaves(self.height, self.longest, self.shortest, self.fall)

    def add(self, x: F64, y: F64, seed: int, out: F64) -> None:
        """Add this relief to the heights `out` at positions `x`, `y` (east, north); all (R, C), metres."""
        if self.turn_deg != 0.0:
            c, s = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
            x, y = c * x + s * y, c * y - s * x
        if self.height > 0.0:
            _add(x, y, self.octaves(), FORMS[self.form], seed, out)


def _add(x: F64, y: F64, waves: tuple[F64, F64], form: int, seed: int, out: F64) -> None:
    kernel = add_fractal if x.size > FEW else add_fractal_here
    kernel(np.ascontiguousarray(x), np.ascontiguousarray(y), *waves, int(form), seed, out)  # one type: compiled once


def octaves(deviation: float, longest: float, shortest: float, fall: float) -> tuple[F64, F64]:
    """Return the wavelength and the standard deviation of each octave, (N,) metres each, longest first.

    Wavelengths are halved from `longest` to `shortest`, metres. The deviation of an octave is proportional to
    wavelength**fall. `deviation`: standard deviation of the sum of all octaves, metres.
    """
    count = max(1, 1 + math.floor(math.log2(max(longest / shortest, 1.0)) + 1e-9))
    wavelengths = longest * 0.5 ** np.arange(count, dtype=np.float64)
    amplitudes = wavelengths**fall
    return wavelengths, deviation * amplitudes / math.sqrt(float((amplitudes**2).sum()))


def noise(x: F64, y: F64, seed: int, longest: float, shortest: float, fall: float = 1.0) -> F64:
    """Return noise of unit standard deviation at positions `x`, `y` (east, north), metres, of any shape.

    The wavelengths are `longest` to `shortest` metres. Amplitudes are proportional to wavelength**fall.
    """
    if x.size == 0:
        return np.zeros(x.shape)
    east, north = (np.ascontiguousarray(v).reshape(len(v), -1) for v in (x, y))
    out = np.zeros(east.shape)
    _add(east, north, octaves(1.0, longest, shortest, fall), ReliefForm.HILLS, seed, out)
    return out.reshape(x.shape)
