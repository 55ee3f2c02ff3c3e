"""How fine the pattern of the ground is, on pixels finer than its heights (docs/method-ground.md, T1b).

Blades and leaves are below the cell: what tells a sward from tufts is how the detail falls off from octave to octave.
"""

from __future__ import annotations

import cv2
import numpy as np

from alight.records import F32, ElevationMap
from alight.terrain.appearance import seen, smooth

OCTAVES = (1.0, 2.0, 4.0)  # fine pixels, 1-sigma up to which the detail of each goes
NEAR, WIDE = 0.3, 1.5  # metres about a cell over which an octave, and all of the detail, are gathered
SURROUNDINGS = 0.6  # metres, that detail is counted against
FLOOR = np.float32(0.003)


def _cells(fine: F32, factor: int) -> F32:
    rows, cols = fine.shape[0] // factor, fine.shape[1] // factor
    return np.asarray(cv2.resize(fine, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def finest(elevation: ElevationMap) -> tuple[F32, int]:
    """The finest picture of the ground that there is, (f R, f C, 3) with 2 added, and f."""
    coarse = np.repeat(np.repeat(elevation.rgb, 2, axis=0), 2, axis=1)
    rgb = coarse if elevation.fine is None else elevation.fine
    return rgb.astype(np.float32) + 2, rgb.shape[0] // elevation.grid.rows


def grain(elevation: ElevationMap) -> dict[str, F32]:
    """Log rms of log brightness in three octaves, and of all detail of brightness and of both tints, (R, C) each."""
    picture, factor = finest(elevation)
    cell, weight = elevation.grid.cell, seen(elevation).astype(np.float32)

    def rms(off: F32, metres: float) -> F32:
        power = smooth(_cells(off * off, factor), weight, max(metres / cell, 1.0))
        return np.asarray(np.log(np.sqrt(np.nan_to_num(power)) + FLOOR), np.float32)

    light = np.log(picture.mean(axis=2))
    out: dict[str, F32] = {}
    before = light
    for k, sigma in enumerate(OCTAVES):
        after = np.asarray(cv2.GaussianBlur(light, (0, 0), sigma), np.float32)
        out[f"octave {k}"] = rms(before - after, NEAR)
        before = after
    green = np.log(picture[..., 1])
    for name, values in (
        ("light", light), ("red", np.log(picture[..., 0]) - green), ("blue", np.log(picture[..., 2]) - green),
    ):  # fmt: skip
        near = smooth(_cells(values, factor), weight, SURROUNDINGS / cell)
        wide = cv2.resize(np.nan_to_num(near), values.shape[::-1], interpolation=cv2.INTER_LINEAR)
        out[f"{name} detail"] = rms(cv2.GaussianBlur(values, (0, 0), 0.7) - wide, WIDE)
    return out
