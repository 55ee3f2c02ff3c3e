"""What the map itself says of its cover: shape, matching and texture, weighed together (docs/method-ground.md, T1).

No colour and no library: this is what is left when the pictures look like nothing known, and what an appearance may
only take from.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from alight.learned.terms import RELATIVE, SurfaceTerm
from alight.raster import log_offset, masked_gaussian, ramp
from alight.records import F32, REFUSED, ElevationMap, Flag
from alight.terrain.appearance import Appearance, seen
from alight.terrain.detail import detail_terms
from alight.terrain.relief import Relief


def _against(values: F32, looked: F32) -> F32:
    """Relative to the median of the frame: what a camera and a height change for all cells alike cancels."""
    known = values[looked > 0]
    return np.asarray(values - np.float32(np.median(known) if known.size else 0.0), np.float32)


def plants(look: Appearance, shape: Relief, restless: F32) -> F32:
    """Signs of tall plants that go together (G16): rough to the eye, rough or raised in height, green, restless."""
    busy = ramp(look.texture, 0.055, 0.09)
    high = np.maximum(ramp(shape.above, 0.15, 0.5), ramp(shape.rough, 0.04, 0.10))
    tone = ramp(look.green, 0.06, 0.14) * np.float32(look.coloured)
    return np.asarray(3.5 * busy + 3.0 * high + 2.0 * tone + 2.0 * restless - 5.0, np.float32)


def cover_terms(elevation: ElevationMap, look: Appearance, shape: Relief) -> Iterator[tuple[str, F32]]:
    """The evidence of every cell, (R, C) each, one after the other, as the names of `weights` (T1)."""
    looked = seen(elevation).astype(np.float32)
    yield from surface(elevation, look, shape).items()
    for name, values in detail_terms(elevation):
        yield name, values
        if name.endswith(("_near", "_wide")):
            yield name + RELATIVE, _against(values, looked)


def surface(elevation: ElevationMap, look: Appearance, shape: Relief) -> dict[str, F32]:
    """Roughness, height, residual, doubt and texture over some decimetres to metres."""
    cell, looked = elevation.grid.cell, seen(elevation).astype(np.float32)
    measured = np.isfinite(elevation.height).astype(np.float32) * looked
    height = np.nan_to_num(elevation.height)

    def near(values: F32, metres: float) -> F32:
        mean = masked_gaussian(np.nan_to_num(values).astype(np.float32), looked, metres / cell)
        return np.asarray(np.nan_to_num(mean), np.float32)

    def rough(metres: float) -> F32:
        off: F32 = height - np.nan_to_num(masked_gaussian(height, measured, metres / cell))
        return log_offset(np.sqrt(np.nan_to_num(masked_gaussian(off * off, measured, metres / cell))), 0.01)

    def flagged(flags: int) -> F32:
        return np.asarray((elevation.flags & np.uint16(flags)) != 0, np.float32)

    usable = flagged(Flag.UNSEEN | Flag.RANGE | Flag.SATURATED) == 0
    standing = np.where(usable, elevation.height - shape.ground, np.float32(0))
    restless, refused = flagged(Flag.MOVING | Flag.INCONSISTENT), flagged(REFUSED)
    residual, busy = log_offset(near(elevation.residual, 0.5), 0.02), log_offset(look.texture, 0.01)
    return {
        SurfaceTerm.ROUGH_03: rough(0.3),
        SurfaceTerm.ROUGH_10: rough(1.0),
        SurfaceTerm.HEIGHT_ABOVE_GROUND: np.nan_to_num(shape.above).clip(-1, 6),
        SurfaceTerm.HEIGHT_ABOVE_BED: near(standing, 0.3).clip(-2, 8),
        SurfaceTerm.RESIDUAL: residual,
        SurfaceTerm.RESIDUAL_RELATIVE: _against(residual, looked),
        SurfaceTerm.RESIDUAL_2M: log_offset(near(elevation.residual, 2.0), 0.02),
        SurfaceTerm.SIGMA: log_offset(near(elevation.sigma, 0.5) / np.float32(cell), 0.05),
        SurfaceTerm.MOVING_2M: near(restless, 2.0),
        SurfaceTerm.UNSURE: near(flagged(Flag.UNSURE), 0.5),
        SurfaceTerm.REFUSED_2M: near(refused, 2.0),
        SurfaceTerm.TEXTURE: busy,
        SurfaceTerm.TEXTURE_RELATIVE: _against(busy, looked),
        SurfaceTerm.PLANTS: plants(look, shape, restless),
    }
