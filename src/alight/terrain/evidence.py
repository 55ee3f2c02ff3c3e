"""What the map itself says of its cover: shape, matching and texture, weighed together (docs/method-ground.md, T1).

No colour and no library: this is what is left when the pictures look like nothing known, and what an appearance may
only take from.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np

from alight.learned.layers import standard, unpack_layer
from alight.raster import log_offset, masked_gaussian, ramp
from alight.records import F32, REFUSED, ElevationMap, Flag
from alight.terrain.appearance import Appearance, seen
from alight.terrain.detail import detail_terms
from alight.terrain.relief import Relief
from alight.terrain.weights import LAYERS, TERMS

AT_A_TIME = 8  # terms


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
        if name.endswith((" near", " wide")):
            yield f"{name} against the frame", _against(values, looked)


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
        "rough 0.3 m": rough(0.3),
        "rough 1 m": rough(1.0),
        "above": np.nan_to_num(shape.above).clip(-1, 6),
        "standing": near(standing, 0.3).clip(-2, 8),
        "residual": residual,
        "residual against the frame": _against(residual, looked),
        "residual 2 m": log_offset(near(elevation.residual, 2.0), 0.02),
        "sigma": log_offset(near(elevation.sigma, 0.5) / np.float32(cell), 0.05),
        "restless 2 m": near(restless, 2.0),
        "unsure": near(flagged(Flag.UNSURE), 0.5),
        "refused 2 m": near(refused, 2.0),
        "texture": busy,
        "texture against the frame": _against(busy, looked),
        "plants": plants(look, shape, restless),
    }


def weighed(found: Iterable[tuple[str, F32]]) -> F32:
    """Log odds of the classes but for a constant, (R, C, 8) for codes 1 to 8 (T2).

    Terms are taken a few at a time: all together they would be several times the map.
    """
    terms_of, (weights, bias) = iter(found), unpack_layer(LAYERS[0])
    row_of, total, shape = {name: i for i, name in enumerate(TERMS)}, None, (0, 0)
    while some := list(islice(terms_of, AT_A_TIME)):
        shape = some[0][1].shape
        z = np.stack([standard(values.ravel(), *TERMS[name]) for name, values in some], axis=1)
        part = z @ weights[[row_of[name] for name, _ in some]]
        total = part + bias if total is None else total + part
    assert total is not None
    for layer in LAYERS[1:]:
        weights, bias = unpack_layer(layer)
        total = np.maximum(total, 0, out=total) @ weights + bias
    return np.asarray(total, np.float32).reshape(*shape, -1)
