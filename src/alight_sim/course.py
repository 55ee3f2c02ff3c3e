"""From a flight plan to a flight over a world, or the reason why it cannot be flown."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64
from alight.records import InputError, Terrain
from alight_sim.patterns import FlightPlan, line
from alight_sim.scene_world import SceneWorld
from alight_sim.vehicle import VEHICLES, TrueTrajectory, fly_through
from alight_sim.world import World

LEAD = 0.5  # s that the inertial sensors run before the first frame and after the last
CLEAR = 2.0  # metres, least height of the vehicle above the surface
AROUND, LOW = 5.0, 0.1  # metres and share: "the ground under the start" is the lowest tenth of the surrounding heights
LONGEST = 7200.0  # s

Extent = tuple[float, float, float, float]  # west, south, east, north, metres


def chart(world: SceneWorld, plan: FlightPlan, rng: np.random.Generator) -> TrueTrajectory:
    """Fly the plan over the world; return the true trajectory.

    Raises:
        InputError: a way-point is inside the ground or an object on it, or the flight leaves the world, comes within
            2 m of its surface, lasts too long, or needs a lean beyond the vehicle's limit.
    """
    points = line(plan)
    _inside(world, points)
    if plan.above == "ground":
        points = points + np.array([0.0, 0.0, ground_at(world, points[0])])
    _above_ground(world, points)
    try:
        trajectory = fly_through(
            points, plan.speed, rng, plan.limits, air=plan.air, vehicle=VEHICLES[plan.vehicle],
            heading=plan.heading, rolling=plan.rolling, hold=plan.duration,
        )  # fmt: skip
    except ValueError as e:
        raise InputError(f"flight: {e}") from e
    if trajectory.duration > LONGEST:
        hours = trajectory.duration / 3600.0
        raise InputError(f"the flight lasts {hours:.1f} hours, more than {LONGEST / 3600:g}; make it shorter or faster")
    _keeps_clear(world, trajectory)
    return trajectory


def ground_at(world: World, place: F64) -> float:
    """Return a low quantile of the heights around a position, metres, which mostly excludes trees and houses."""
    steps = np.arange(-AROUND, AROUND + 0.5, 1.0)
    heights = [world.height_at(place[0] + e, place[1] + n) for e in steps for n in steps]
    return float(np.nanquantile(heights, LOW))


def _inside(world: SceneWorld, points: F64) -> None:
    west, south, east, north = world.extent
    for k, p in enumerate(points):
        if not (west <= p[0] <= east and south <= p[1] <= north):
            raise InputError(
                f"the flight leaves the world: its way-point {k + 1} is at east {p[0]:.0f} m, north {p[1]:.0f} m; "
                f"keep it within east {west:.0f} to {east:.0f}, north {south:.0f} to {north:.0f}, or enlarge the ground"
            )


def _above_ground(world: SceneWorld, points: F64) -> None:
    for k, p in enumerate(points):
        ground = world.height_at(float(p[0]), float(p[1]))
        if p[2] < ground:
            raise InputError(
                f"way-point {k + 1} (east {p[0]:.1f}, north {p[1]:.1f}) is inside {_what(world, p)}: "
                f"{ground - p[2]:.1f} m below its surface; fly higher"
            )


def _what(world: SceneWorld, p: F64) -> str:
    reach = 0.6 * world.cell  # at least one cell's centre
    around = world.truth((p[0] - reach, p[1] - reach, p[0] + reach, p[1] + reach))
    kind = Terrain(int(around.label.flat[np.argmax(around.height)]))
    names = {
        Terrain.TREE: "a tree", Terrain.STRUCTURE: "a building or vehicle", Terrain.ROCK: "a rock",
        Terrain.TALL_VEGETATION: "tall vegetation", Terrain.WATER: "water",
    }  # fmt: skip
    return names.get(kind, "the ground")


def _keeps_clear(world: SceneWorld, trajectory: TrueTrajectory) -> None:
    west, south, east, north = world.extent
    fastest = float(np.linalg.norm(np.diff(trajectory.position.c, axis=0), axis=1).max() / 0.25)
    step = min(0.1, 1.0 / max(fastest, 1e-3))
    for x, y, up in trajectory.place_world(np.arange(-LEAD, trajectory.duration + LEAD + step, step)):
        if not (west <= x <= east and south <= y <= north):
            raise InputError(
                f"the flight leaves the world at east {x:.0f} m, north {y:.0f} m; make it shorter or the ground larger"
            )
        ground = world.height_at(float(x), float(y))
        if math.isnan(ground) or up < ground + CLEAR:
            raise InputError(
                f"the flight comes within {CLEAR:g} m of {_what(world, np.array([x, y, up]))} at east {x:.0f}, "
                f"north {y:.0f}; fly higher"
            )
