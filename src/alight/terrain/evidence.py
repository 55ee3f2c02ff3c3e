"""Evidence for the land cover from the map itself: shape, matching and texture (docs/method/land-cover.md, T1).

No colour and no library: this evidence is left when the pictures look like nothing known, and the model of appearance
may only refuse what it permits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from alight.arrays import F32
from alight.learned.terms import RELATIVE, SurfaceTerm
from alight.raster import linear_ramp, log_offset, masked_gaussian
from alight.records import REFUSED, ElevationMap, Flag
from alight.terrain.appearance import Appearance, seen
from alight.terrain.detail import detail_terms
from alight.terrain.relief import Relief


def _relative(values: F32, weight: F32) -> F32:
    """Values less their median over the frame: a change of all cells alike, by camera or height, cancels."""
    known = values[weight > 0]
    return np.asarray(values - np.float32(np.median(known) if known.size else 0.0), np.float32)


def plants(colours: Appearance, shape: Relief, moving: F32) -> F32:
    """Joint score of tall plants (G16): textured, rough or raised in height, green, moving."""
    texture = linear_ramp(colours.texture, 0.055, 0.09)
    high = np.maximum(linear_ramp(shape.height_above, 0.15, 0.5), linear_ramp(shape.rough, 0.04, 0.10))
    tone = linear_ramp(colours.green, 0.06, 0.14) * np.float32(colours.coloured)
    return np.asarray(3.5 * texture + 3.0 * high + 2.0 * tone + 2.0 * moving - 5.0, np.float32)


def land_cover_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> Iterator[tuple[str, F32]]:
    """The evidence of every cell, (R, C) each, one after the other, with its identifier (T1)."""
    weight = seen(elevation).astype(np.float32)
    yield from surface_terms(elevation, colours, shape).items()
    for name, values in detail_terms(elevation):
        yield name, values
        if name.endswith(("_near", "_wide")):
            yield name + RELATIVE, _relative(values, weight)


def surface_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> dict[str, F32]:
    """Roughness, height, residual, flags and texture over some decimetres to metres."""
    cell, weight = elevation.grid.cell, seen(elevation).astype(np.float32)
    measured = np.isfinite(elevation.height).astype(np.float32) * weight
    height = np.nan_to_num(elevation.height)

    def near(values: F32, metres: float) -> F32:
        mean = masked_gaussian(np.nan_to_num(values).astype(np.float32), weight, metres / cell)
        return np.asarray(np.nan_to_num(mean), np.float32)

    def rough(metres: float) -> F32:
        off: F32 = height - np.nan_to_num(masked_gaussian(height, measured, metres / cell))
        return log_offset(np.sqrt(np.nan_to_num(masked_gaussian(off * off, measured, metres / cell))), 0.01)

    def flagged(flags: int) -> F32:
        return np.asarray((elevation.flags & np.uint16(flags)) != 0, np.float32)

    usable = flagged(Flag.UNSEEN | Flag.RANGE | Flag.SATURATED) == 0
    standing = np.where(usable, elevation.height - shape.ground, np.float32(0))
    moving, refused = flagged(Flag.MOVING | Flag.INCONSISTENT), flagged(REFUSED)
    residual, texture = log_offset(near(elevation.residual, 0.5), 0.02), log_offset(colours.texture, 0.01)
    return {
        SurfaceTerm.ROUGH_03: rough(0.3),
        SurfaceTerm.ROUGH_10: rough(1.0),
        SurfaceTerm.HEIGHT_ABOVE_GROUND: np.nan_to_num(shape.height_above).clip(-1, 6),
        SurfaceTerm.HEIGHT_ABOVE_BED: near(standing, 0.3).clip(-2, 8),
        SurfaceTerm.RESIDUAL: residual,
        SurfaceTerm.RESIDUAL_RELATIVE: _relative(residual, weight),
        SurfaceTerm.RESIDUAL_2M: log_offset(near(elevation.residual, 2.0), 0.02),
        SurfaceTerm.SIGMA: log_offset(near(elevation.sigma, 0.5) / np.float32(cell), 0.05),
        SurfaceTerm.MOVING_2M: near(moving, 2.0),
        SurfaceTerm.UNSURE: near(flagged(Flag.UNSURE), 0.5),
        SurfaceTerm.REFUSED_2M: near(refused, 2.0),
        SurfaceTerm.TEXTURE: texture,
        SurfaceTerm.TEXTURE_RELATIVE: _relative(texture, weight),
        SurfaceTerm.PLANTS: plants(colours, shape, moving),
    }
