"""The next view: a view that would settle the doubt about a candidate (G19)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.records import NextView
from alight.settings import SitesSettings


@dataclass(frozen=True, eq=False)
class Observer:
    """The vehicle with the cameras that look at the ground."""

    position: F64  # (3,) metres, in the frame of the map
    height_above_ground: float  # metres
    focal: float  # pixels, of the newest view that looks down
    stereo: bool  # two cameras look down at the same time


def next_view(place: F64, settles_at: float, observer: Observer, settings: SitesSettings) -> NextView | None:
    """Propose the highest view whose pixels are fine enough to settle the doubt about a place.

    A pixel on the ground is the height over the focal length in pixels. The view is not lower than `lowest_look` and
    not higher than the vehicle is now. One camera needs a base, so it looks from beside the place, on the side of the
    vehicle; two cameras have a base of their own and look from straight above.

    Args:
        place: (3,) metres, on the ground.
        settles_at: metres, size of the pixel on the ground that settles the doubt; NaN: none does.
        observer: the vehicle and its cameras.
        settings: the lowest height and the base.

    Returns:
        The view; None where no pixel settles the doubt.
    """
    if not math.isfinite(settles_at):
        return None
    wanted = settles_at * observer.focal
    height = max(min(wanted, observer.height_above_ground), settings.lowest_look)
    base = 0.0 if observer.stereo else settings.look_base * height
    east, north = (float(v) for v in place[:2] + base * _towards(place, observer.position))
    return NextView(east, north, float(place[2]) + height, height, settles=height <= wanted)


def _towards(place: F64, vehicle: F64) -> F64:
    """Unit vector on the ground, (2,), from a place to the vehicle; north if the vehicle is overhead."""
    way = np.asarray(vehicle[:2] - place[:2], dtype=np.float64)
    distance = float(np.hypot(*way))
    return way / distance if distance > 1e-3 else np.array([0.0, 1.0])
