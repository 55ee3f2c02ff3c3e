"""A small made-up run with all parts of a result, for the tests of the output files."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from ground import land_cover

from alight.geometry import Grid, LocalFrame, Pose, so3_exp
from alight.records import (
    NOTHING_MISSING,
    ElevationMap,
    Flag,
    Hazard,
    HazardMap,
    MapEvidence,
    MapFrame,
    Motion,
    NextView,
    Route,
    RunResult,
    Site,
    Sites,
    Terrain,
    TerrainMap,
    Waypoint,
)
from alight.settings import Settings

ROWS, COLS, CELL = 120, 160, 0.25
GRID = Grid(east=-12.0, north=21.0, cell=CELL, rows=ROWS, cols=COLS)
LOCAL = LocalFrame(48.1023, 15.4412, 301.0)


def elevation() -> ElevationMap:
    """A gentle slope with a box on it, a pond that moves and an unseen corner."""
    rng = np.random.default_rng(3)
    east, north = np.meshgrid(*GRID.xy())
    height = (2.0 + 0.02 * east - 0.01 * north + rng.normal(0, 0.01, GRID.shape)).astype(np.float32)
    height[20:40, 30:60] += 1.5
    flags = np.zeros(GRID.shape, np.uint16)
    flags[80:110, 100:150] |= np.uint16(Flag.MOVING)
    flags[18:42, 28:62] |= np.uint16(Flag.STEP)
    flags[:10, :10] |= np.uint16(Flag.UNSEEN)
    views = np.full(GRID.shape, 7, np.uint8)
    views[:10, :10] = 0
    height[:10, :10] = np.nan
    rgb = rng.integers(90, 140, (*GRID.shape, 3), dtype=np.uint8)
    rgb[:10, :10] = 0
    sigma = np.full(GRID.shape, 0.03, np.float32)
    residual, sampling = (np.full(GRID.shape, v, np.float32) for v in (0.1, GRID.cell))
    return ElevationMap(GRID, height, sigma, flags, views, rgb, residual, sampling)


def terrain() -> TerrainMap:
    """Grass with the pond."""
    label = np.full(GRID.shape, Terrain.SHORT_GRASS, np.uint8)
    label[80:110, 100:150] = Terrain.WATER
    label[:10, :10] = Terrain.UNKNOWN
    return land_cover(GRID, label, np.where(label == Terrain.WATER, 0.0, 1.0).astype(np.float32))


def hazards() -> HazardMap:
    """Hazard map: box, pond and unseen corner are refused, the rest is safe."""
    reasons = np.zeros(GRID.shape, np.uint16)
    reasons[80:110, 100:150] |= np.uint16(Hazard.TERRAIN | Hazard.UNKNOWN)
    reasons[18:42, 28:62] |= np.uint16(Hazard.STEP)
    reasons[:16, :16] |= np.uint16(Hazard.UNKNOWN)
    bad = reasons != 0
    p_safe = np.where(bad, 0.0, 0.998).astype(np.float32)
    p_safe[:10, :10] = np.nan

    def field(value: float) -> Any:
        return np.full(GRID.shape, value, np.float32)

    clearance = np.where(bad, 0.0, 3.0).astype(np.float32)
    p = p_safe, field(0.99), field(0.99), field(0.99)
    seen = field(0.1), field(0.02)
    return HazardMap(GRID, field(0.02), field(0.03), field(0.02), clearance, *p, *seen, field(-0.2), reasons)


def site(rank: int = 1, east: float = 5.0, north: float = -2.0) -> Site:
    """One site."""
    return Site(
        rank=rank,
        east=east,
        north=north,
        up=2.12,
        p_safe=0.97,
        p_relief=0.99,
        p_obstacle=0.985,
        p_ground=0.995,
        resolved=0.11,
        quality=-0.2,
        slope=math.radians(2.1),
        roughness=0.04,
        clearance=6.3,
        radius=7.8,
        terrain=Terrain.SHORT_GRASS,
        heading=math.radians(-30.0),
        height_sigma=0.03,
    )


def candidate(rank: int = 1, east: float = 5.0, north: float = -2.0) -> Site:
    """A place like that of the site, where an obstacle may have been missed, and the view that would settle it."""
    look = NextView(east + 1.0, north + 1.0, 14.12, 12.0, settles=True)
    return replace(
        site(rank, east, north), p_safe=0.62, p_obstacle=0.63, resolved=0.22, doubt="obstacle", look=look,
    )  # fmt: skip


def route() -> Route:
    """Three way-points down to the first site."""
    points = [
        ("start", -8.0, 15.0, 32.0, 0.0),
        ("approach", 5.0, -2.0, 12.12, 7.5),
        ("touchdown", 5.0, -2.0, 2.12, 17.5),
    ]
    return Route(tuple(Waypoint(n, np.array([e, y, u]), math.radians(-30), 5.0, t) for n, e, y, u, t in points))


def motions() -> list[Motion]:
    """Ten poses along a line at 10 Hz, on the clock of a real flight."""
    covariance = np.diag([0.04, 0.04, 0.09, 1e-6, 4e-6, 9e-6])
    out = []
    for i in range(10):
        pose = Pose(so3_exp([0.01, -0.02, 1.2]), np.array([-8.0 + i, 15.0 - i, 32.0]))
        out.append(
            Motion(1_700_000_000_000_000_001 + i * 10**8, pose, (pose,), covariance, np.array([10.0, -10.0, 0.0]))
        )
    return out


def evidence() -> MapEvidence:
    """What the run was judged on."""
    e, nowhere = elevation(), np.zeros(GRID.shape, np.bool_)
    frame, vehicle = MapFrame(0, np.zeros(3), np.eye(3)), np.array([1.0, 6.0, 32.0])
    return MapEvidence(
        e, GRID, e.rgb, e.sampling, terrain(), (), nowhere, nowhere, NOTHING_MISSING, None, vehicle, 30.1, frame
    )


def some_run(**changes: Any) -> RunResult:
    """The whole run; `changes` replace fields."""
    fields: dict[str, Any] = {
        "source_name": "meadow <north> & pond",
        "source_kind": "flight log",
        "local": LOCAL,
        "georeferenced": True,
        "settings": Settings(),
        "sites": Sites((site(), site(2, 12.0, 6.0))),
        "elevation": elevation(),
        "terrain": terrain(),
        "hazards": hazards(),
        "route": route(),
        "evidence": evidence(),
        "motions": motions(),
        "height_above_ground": 30.1,
        "counts": {"frames read": 10, "frames dropped, file missing": 1},
        "notes": {"focal length": "held at the calibration's 620.0 px"},
        "warnings": ["nav0: 3 rows without attitude"],
        "timings": {"motion": [0.01, 0.02, 0.5], "parallax": [1.5], "sites": []},
    }
    return RunResult(**(fields | changes))
