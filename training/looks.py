"""Looks from near by, with truth: a vehicle comes down over places and flies look legs, as before a landing.

    PYTHONPATH=bench python training/looks.py                     # P(safe) on worlds that had no part in a fit
    PYTHONPATH=bench python training/looks.py meadow/looks/test-3

Half of the places are truly safe, half are drawn anywhere. The map is the recursive one, with the poses of the filter.
A claim is false where no truly safe touchdown lies within 0.3 m.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from ground_domains import Claims, pooled
from ground_maps import Judgeable, cover_of, read_map, write_map
from ground_truth import Bool, GroundTruth

from alight import hazards
from alight.arrays import F64
from alight.evaluation.flight import FlightTruth
from alight.geometry import Grid
from alight.pipeline import Pipeline, PipelineOptions
from alight.pipeline.judging import as_judged
from alight.records import ElevationMap, Event, Frame, InputError
from alight.settings import Settings, load_settings
from alight.trials.campaign.flying import lit_world
from alight.trials.campaign.plan import drawn_light
from alight.trials.campaign.worlds import campaign_world
from alight_sim.oracle import OracleLander, safe_places
from alight_sim.scene_world import SceneWorld
from alight_sim.steered import SteeredFlight, Wanted

FAMILIES = (
    "meadow", "village", "gravel", "concrete", "farmland", "quarry", "desert", "car_park", "depot", "pasture",
    "furrows", "marsh", "canal", "lakes", "yard", "forest", "rubble",
)  # fmt: skip
TUNING = tuple(f"{family}/looks/tuning-{k}" for k in (1, 2) for family in FAMILIES)
TEST = tuple(f"{family}/looks/test-1" for family in FAMILIES)
FIRST_SEED = {"tuning": 3000, "test": 7000}
PLACES = 6  # of a flight
TRIES, CLEAR, MOST_ABOVE = 50, 5.0, 2.0  # places tried; m about a place; m above the median there, at most
AREA = 30.0  # m, half the side of the square in which they lie
HEIGHTS = ((6.5, 10.0), (3.7, 5.2))  # m above the place, of its two looks: drawn between
START = 25.0  # m above the ground
BASE, LEAST_BASE = 0.15, 1.5  # half the length of a leg: over the height; m
CRUISE, SLOW, SINK = 5.0, 2.0, 2.0  # m/s: to a leg, on it, down
NEAR_ENOUGH, PATIENCE = 1.0, 40.0  # m to a way-point; s
REACH = 4.0  # m about the place, radius of the cells that count
BEYOND = 4.0  # m about these, within which the truth is needed
KEPT = 15.0  # m, half the side of the map about the place that is kept
STEP = 0.1  # s
MARGIN = 0.3  # m of clearance of a safe place
_NAME = re.compile(r"([a-z_]+)/looks/(tuning|test)-(\d+)")


@dataclass(frozen=True, eq=False)
class Look:
    """Map and truth after one look."""

    judgeable: Judgeable
    place: F64  # (2,) metres, in the map
    height: float  # metres above the ground

    def about(self, grid: Grid) -> Bool:
        """(R, C): cells that count."""
        east, north = np.meshgrid(*grid.xy())
        return np.asarray(np.hypot(east - self.place[0], north - self.place[1]) < REACH)


def world_of(name: str) -> tuple[SceneWorld, int]:
    """The world of a name such as `meadow/looks/tuning-3` under a sun and a sky of its own, and its seed.

    Raises:
        InputError: no such name.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise InputError(f"{name}: not looks; write for example meadow/looks/test-1")
    family, seed = found[1], FIRST_SEED[found[2]] + int(found[3])
    world = campaign_world(family).build(seed)
    return lit_world(world, drawn_light(np.random.default_rng([seed, *family.encode()]))), seed


def _places(world: SceneWorld, rng: np.random.Generator) -> F64:
    """Places (N, 2) to look at, metres."""
    anywhere = np.array([_open_place(world, rng) for _ in range(PLACES)])
    area = (-AREA, -AREA, AREA, AREA)
    truth = safe_places(world, area, OracleLander.of(Settings().lander.model_dump()))
    safe = np.argwhere(truth.with_margin(MARGIN))
    if len(safe):
        for k, (row, col) in enumerate(safe[rng.integers(len(safe), size=PLACES // 2)]):
            anywhere[2 * k] = truth.east[col], truth.north[row]
    return anywhere


def _open_place(world: SceneWorld, rng: np.random.Generator) -> F64:
    """A place above which a vehicle can fly its look legs."""
    place = np.zeros(2)
    for _ in range(TRIES):
        place = rng.uniform(-AREA, AREA, 2)
        height = world.truth((*(place - CLEAR), *(place + CLEAR))).height
        if float(height.max() - np.median(height)) < MOST_ABOVE:
            break
    return place


class _Vehicle:
    def __init__(self, world: SceneWorld, seed: int) -> None:
        self.settings = load_settings("", ["parallax.method=recursive", "sites.every=0"])
        self.rng = np.random.default_rng(seed)
        self.places = _places(world, self.rng)
        start = (self.places[0, 0] - 12.0, self.places[0, 1] - 11.0, START)
        self.flight = SteeredFlight(world, seed, start=start)
        options = PipelineOptions(imu=self.flight.imu_noise, history=False)
        self.pipeline = Pipeline(self.flight.rig, "flight", self.settings, options)
        self.newest_ns = 0
        self.position: F64 | None = None  # (3,) metres, as the motion has it at `newest_ns`

    def _take(self, event: Event) -> None:
        motion = self.pipeline.feed(event)
        if motion is not None and isinstance(event, Frame):
            self.newest_ns, self.position = motion.t_ns, motion.world_from_body.translation

    def go(self, to: F64, speed: float) -> None:
        """Fly to a point, (3,) metres."""
        begin = self.flight.seconds
        while self.flight.seconds - begin < PATIENCE:
            if float(np.linalg.norm(self.flight.true_pose.translation - to)) < NEAR_ENOUGH:
                return
            for event in self.flight.step(STEP, Wanted(to, speed=speed, sink=SINK)):
                self._take(event)

    def look(self, place: F64, ground: float, height: float) -> None:
        """Fly a leg across a place."""
        turn = self.rng.uniform(0, 2 * np.pi)
        base = max(BASE * height, LEAST_BASE) * np.array([np.cos(turn), np.sin(turn)])
        for side, speed in ((-base, CRUISE), (base, SLOW)):
            self.go(np.array([*(place + side), ground + height]), speed)

    def seen(self, name: str, place: F64, height: float) -> Look | None:
        """The map as it is now, beside the truth about a place."""
        if self.position is None:
            return None
        off = self.position - self.flight.poses(np.array([self.newest_ns]))[0].translation
        snapshot = self.pipeline._mapping.snapshot(place + off[:2])
        if snapshot is None:
            return None
        reach = REACH + BEYOND
        true = self.flight.world.truth((place[0] - reach, place[1] - reach, place[0] + reach, place[1] + reach))
        g = true.grid
        moved = Grid(g.east + off[0], g.north + off[1], g.cell, g.rows, g.cols)
        truth = FlightTruth((true.height + off[2]).astype(np.float32), true.label, moved)
        elevation = as_judged(snapshot, self.settings.lander)
        return Look(Judgeable(name, elevation, truth), place + off[:2], height)


def looks_of(name: str) -> Iterator[Look]:
    """Fly to all places of a world, and yield map and truth after every look."""
    world, seed = world_of(name)
    vehicle = _Vehicle(world, seed)
    for place in vehicle.places:
        reach = (place[0] - 1, place[1] - 1, place[0] + 1, place[1] + 1)
        ground = float(np.median(world.truth(reach).height))
        for low, high in HEIGHTS:
            height = float(vehicle.rng.uniform(low, high))
            vehicle.look(place, ground, height)
            found = vehicle.seen(f"{name}, {height:.1f} m", place, height)
            if found is not None:
                yield found


def kept_looks(name: str, scratch: Path) -> list[Look]:
    """The looks of a world, their maps cut to `KEPT` metres about the place; flown once."""
    folder = scratch / name.replace("/", "_")
    if not folder.exists():
        making = folder.with_suffix(".part")
        making.mkdir(parents=True, exist_ok=True)
        for k, look in enumerate(looks_of(name)):
            about = cut(look.judgeable.elevation, look.place)
            write_map(making / f"{k:02d}.npz", about, look.judgeable.truth, place=look.place, above=look.height)
        making.rename(folder)
    return [_read_look(path, f"{name}, look {path.stem}") for path in sorted(folder.glob("*.npz"))]


def _read_look(path: Path, name: str) -> Look:
    with np.load(path) as z:
        return Look(read_map(path, name), z["place"], float(z["above"]))


def cut(e: ElevationMap, place: F64) -> ElevationMap:
    """The map within `KEPT` metres of a place, with its finest picture."""
    row, col = (round(float(k)) for k in e.grid.index(*place))
    half = round(KEPT / e.grid.cell)
    rows, cols = (slice(max(0, k - half), min(n, k + half)) for k, n in ((row, e.grid.rows), (col, e.grid.cols)))
    assert e.fine is not None
    assert e.fine_sampling is not None
    n = e.fine.shape[0] // e.grid.rows
    fine = e.fine[n * rows.start : n * rows.stop, n * cols.start : n * cols.stop]
    return replace(e.part((rows, cols)), fine=fine, fine_sampling=e.fine_sampling[rows, cols], datum=e.datum)


def claims_of(look: Look) -> Claims:
    """Claims and truth of the cells about the place of a look."""
    s, j = Settings().stages(), look.judgeable
    danger = hazards.assess(j.elevation, cover_of(j), s.lander, s.hazards)
    return Claims.of(j.name, danger, GroundTruth(j.truth, s.lander), j.seen & look.about(danger.grid))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("flights", nargs="*", default=TEST)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options, done = parser.parse_args(), list[Claims]()
    for name in options.flights:
        found = [claims_of(look) for look in kept_looks(name, options.scratch)]
        if found:
            done.append(pooled(found, name))
            print("\n".join(done[-1].lines()), flush=True)
    print("\n".join(pooled(done).lines()))


if __name__ == "__main__":
    main()
