"""A simulated flight of 3.5 seconds with two small cameras, and quick settings for it."""

from __future__ import annotations

from functools import cache

from alight.geometry import Camera
from alight.records import Event, Rig, RigCamera
from alight_sim import SimulatedFlight, default_rig, fly

LENS = Camera(160, 120, 120.0, 120.0, 79.3, 59.8)
STEREO = Rig(tuple(RigCamera(c.name, LENS, c.body_from_cam) for c in default_rig().cameras))
SMALL = ("tuning.tracks.count=40", "tuning.filter.points=16", "parallax.cell=0.25", "tuning.elevation.tile=64",
         "hazards.p_safe=0.3", "sites.margin=0")  # fmt: skip


@cache
def flight() -> tuple[SimulatedFlight, tuple[Event, ...]]:
    """Fly 28 m over the demo's meadow, 15 m above it; the cameras expose 22 times."""
    f = fly("demo", 1, 3.5, rig=STEREO, rate_hz=6.0, height=15.0)
    return f, tuple(f.events())
