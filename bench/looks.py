"""Looks from near by, with truth: a vehicle comes down over places and flies look legs, as before a landing.

    PYTHONPATH=bench python bench/looks.py                     # P(safe) on worlds that nothing was fitted to
    PYTHONPATH=bench python bench/looks.py meadow/looks/test-3

Half of the places are truly safe, half are drawn anywhere. The map is the recursive one, with the poses of the filter.
A claim is false where no truly safe touchdown lies within 0.3 m.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ground_flights import cover_of
from ground_maps import Judgeable
from ground_truth import Bool, GroundTruth

from alight import hazards
from alight.arrays import F64
from alight.evaluation.flight import FlightTruth
from alight.geometry import Grid
from alight.pipeline import Pipeline
from alight.pipeline.judging import as_judged
from alight.records import Event, Frame, InputError
from alight.settings import Settings, load_settings
from alight_sim.campaign import CampaignWorld, campaign_worlds
from alight_sim.oracle import OracleLander, safe_places
from alight_sim.steered import SteeredFlight, Wanted
from alight_sim.world import World

FAMILIES = (
    "meadow", "village", "gravel", "concrete", "farmland", "quarry", "desert", "car_park", "depot", "pasture",
    "furrows", "marsh", "canal", "lakes", "yard", "forest", "rubble",
)  # fmt: skip
TEST = tuple(f"{family}/looks/test-1" for family in FAMILIES)
FIRST_SEED = {"tuning": 3000, "test": 7000}
PLACES = 6  # of a flight
TRIES, CLEAR, MOST_ABOVE = 50, 5.0, 2.0  # places tried; m about a place, within which nothing is higher than so much
AREA = 30.0  # m, half the side of the square in which they lie
HEIGHTS = ((6.5, 10.0), (3.7, 5.2))  # m above the place, of its two looks: drawn between
START = 25.0  # m above the ground
BASE, LEAST_BASE = 0.15, 1.5  # half the length of a leg: over the height; m
CRUISE, SLOW, SINK = 5.0, 2.0, 2.0  # m/s: to a leg, on it, down
NEAR_ENOUGH, PATIENCE = 1.0, 40.0  # m to a way-point; s
REACH = 4.0  # m about the place that count
BEYOND = 4.0  # m about these, of which the truth is wanted
STEP = 0.1  # s
MARGIN = 0.3  # m by which a safe place is safe
LEVELS = (0.8, 0.9, 0.95, 0.99)
BINS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
_NAME = re.compile(r"([a-z_]+)/looks/(tuning|test)-(\d+)")


@dataclass(frozen=True, eq=False)
class Look:
    """What was known after one look."""

    judgeable: Judgeable
    place: F64  # (2,) metres, in the map
    height: float  # metres above the ground

    def about(self, grid: Grid) -> Bool:
        """(R, C): cells that count."""
        east, north = np.meshgrid(*grid.xy())
        return np.asarray(np.hypot(east - self.place[0], north - self.place[1]) < REACH)


def world_of(name: str) -> tuple[World, int]:
    """The world of a name such as `meadow/looks/tuning-3`, and its seed.

    Raises:
        InputError: no such name.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise InputError(f"{name}: not looks; write for example meadow/looks/test-1")
    family, seed = found[1], FIRST_SEED[found[2]] + int(found[3])
    return campaign_worlds().get(family, CampaignWorld(family, family)).build(seed), seed


def _places(world: World, rng: np.random.Generator) -> F64:
    """(N, 2) metres."""
    anywhere = np.array([_open_place(world, rng) for _ in range(PLACES)])
    area = (-AREA, -AREA, AREA, AREA)
    truth = safe_places(world, area, OracleLander.of(Settings().lander.model_dump()))
    safe = np.argwhere(truth.with_margin(MARGIN))
    if len(safe):
        for k, (row, col) in enumerate(safe[rng.integers(len(safe), size=PLACES // 2)]):
            anywhere[2 * k] = truth.east[col], truth.north[row]
    return anywhere


def _open_place(world: World, rng: np.random.Generator) -> F64:
    """A place above which a vehicle can fly its look legs."""
    place = np.zeros(2)
    for _ in range(TRIES):
        place = rng.uniform(-AREA, AREA, 2)
        height = world.truth((*(place - CLEAR), *(place + CLEAR))).height
        if float(height.max() - np.median(height)) < MOST_ABOVE:
            break
    return place


class _Vehicle:
    def __init__(self, world: World, seed: int) -> None:
        self.settings = load_settings("", ["parallax.method=ring", "sites.every=0"])
        self.rng = np.random.default_rng(seed)
        self.places = _places(world, self.rng)
        start = (self.places[0, 0] - 12.0, self.places[0, 1] - 11.0, START)
        self.flight = SteeredFlight(world, seed, start=start, steered_by="truth")
        self.pipeline = Pipeline(
            self.flight.rig, "flight", self.settings, history=False, imu=self.flight.imu_noise
        )  # fmt: skip
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
    """Fly to all places of a world, and give what is known after every look."""
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


def judged(look: Look) -> tuple[F64, Bool, Bool]:
    """P(safe) of the cells about the place, and where a touchdown is truly safe, or within 0.3 m of where it is."""
    s, j = Settings().stages(), look.judgeable
    danger = hazards.assess(j.elevation, cover_of(j), s.lander, s.hazards)
    truth, here = GroundTruth(j.truth, s.lander), j.seen & look.about(danger.grid)
    safe, near = (truth.on(danger.grid, m)[here] for m in (truth.safe, truth.near(truth.safe)))
    return np.nan_to_num(danger.p_safe)[here].astype(np.float64), safe, near


def line(name: str, p: F64, safe: Bool, near: Bool) -> str:
    """What is false and found at some levels."""
    parts = [
        f"{level}: false {100 * float((~near[p >= level]).mean()) if (p >= level).any() else 0.0:5.2f} "
        f"found {100 * float((p[safe] >= level).mean()) if safe.any() else 0.0:5.1f}"
        for level in LEVELS
    ]
    return f"{name:34s} {len(p):7d} cells, safe {100 * float(safe.mean()):5.1f} %   " + "   ".join(parts)


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("flights", nargs="*", default=TEST)
    everything: list[tuple[F64, Bool, Bool]] = []
    for name in parser.parse_args().flights:
        found = [judged(look) for look in looks_of(name)]
        if found:
            p, safe, near = (np.concatenate(v) for v in zip(*found, strict=True))
            everything.append((p, safe, near))
            print(line(name, p, safe, near), flush=True)
    p, safe, near = (np.concatenate(v) for v in zip(*everything, strict=True))
    print(line("all of them", p, safe, near))
    for low, high in pairwise(BINS):
        here = (p >= low) & (p < high) & (p > 0)
        if here.any():
            print(f"   claimed {p[here].mean():.3f}  true {near[here].mean():.3f}  {here.sum():8d} cells")


if __name__ == "__main__":
    main()
