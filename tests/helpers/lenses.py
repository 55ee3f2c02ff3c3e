"""A camera of every kind of lens."""

from __future__ import annotations

import pytest

from alight.geometry import Camera

LENSES = {
    "none": Camera(640, 480, 512.0, 508.0, 321.3, 236.8),
    "radial-tangential": Camera(
        640, 480, 470.0, 469.0, 318.2, 241.0, "radial-tangential", (-0.28, 0.08, 0.0006, -0.0004)
    ),
    "five numbers": Camera(640, 480, 470.0, 469.0, 318.2, 241.0, "radial-tangential", (0.05, -0.1, 1e-3, 5e-4, 0.02)),
    "equidistant": Camera(640, 480, 300.0, 301.0, 322.0, 239.0, "equidistant", (0.01, -0.004, 0.002, -0.0005)),
}
each_lens = pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES.keys())
