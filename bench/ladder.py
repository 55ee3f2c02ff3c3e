"""The standard ladder: the flights that every benchmark flies, each with a name that it prints.

Scenes times heights times seeds. Every fit and tuning uses the rungs called `tuning`; every published number is
measured on those called `test`, and no seed is in both. Beside the level flights there are, by name, flights that
change their height: `gravel/40-8m/tuning-1` (a strip, then down over one place), `gravel/8-40m/tuning-1` (up from
there) and `gravel/15+45m/tuning-1` (a strip at one height, and back at the other).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from alight.records import Frame, InputError, View
from alight_sim.flight import SimulatedFlight, fly
from alight_sim.groups import GROUPS
from alight_sim.patterns import FlightPlan, Pattern
from alight_sim.scene import Scene, built_in, read_scene
from alight_sim.scene_world import SceneWorld, build
from alight_sim.vehicle import Limits

Kind = Literal["tuning", "test"]
KINDS: tuple[Kind, ...] = ("tuning", "test")
# metres above ground: exposures a second. The spacing is 2 % of the height: 8 exposures span 0.14 of it
RATES = {8: 8.0, 10: 8.0, 12: 8.0, 15: 8.0, 20: 8.0, 30: 7.0, 40: 6.0, 50: 6.0, 60: 6.0, 100: 5.0, 150: 4.0}
HEIGHTS = (20, 50, 100, 150)  # the standard; the others between are flown by name
SPACING = 0.02  # of the height between exposures
FRAMES, QUICK_FRAMES, LOW_FRAMES = 41, 11, 81
SCENES = (
    "meadow", "farmland", "village", "forest", "quarry", "lakes",
    "desert", "snow", "concrete", "car_park", "tall_grass", "yard",
)  # fmt: skip
# flown by name as well: families of scenes, whose colours, light, density and layout another seed changes
FAMILIES = tuple(name for names in GROUPS.values() for name in names if name not in SCENES)
FIRST_SEED = {"tuning": 1, "test": 1001}
MOST_SEEDS = 1000
GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))  # degrees: courses spread evenly however many seeds there are
LOWEST, HIGHEST = 6, 100  # metres, of flights that change their height
RISE, PUSH = 5.0, 3.5  # m/s up and down, m/s^2, in those
QUICKER = 6  # times fewer exposures of them when quick
TRIES, APART = 200, 1.5  # places tried for the end of a descent; metres between, times the root of the number
CLEAR = (4.0, 1.2)  # metres: within so far of that place nothing is higher than so much above the ground around
_NAME = re.compile(r"([a-z0-9_]+)/(\d+)(?:([-+])(\d+))?m/(tuning|test)-(\d+)(-quick)?")


@dataclass(frozen=True)
class Rung:
    """One flight of the ladder; nothing is made before `fly`."""

    scene: str
    height: int  # metres above the ground under its start
    kind: Kind
    number: int  # from 1
    quick: bool = False
    pattern: Pattern = "transect"
    end_height: int | None = None  # metres, of all patterns but the transect

    @property
    def name(self) -> str:
        """Name that the benchmarks print, such as `meadow/50m/test-3`."""
        to = "" if self.end_height is None else f"{'+' if self.pattern == 'two_heights' else '-'}{self.end_height}"
        return f"{self.scene}/{self.height}{to}m/{self.kind}-{self.number}{'-quick' if self.quick else ''}"

    @property
    def seed(self) -> int:
        """Seed of the world and of every source of noise."""
        return FIRST_SEED[self.kind] + self.number - 1

    @property
    def rate_hz(self) -> float:
        """Exposures a second."""
        if self.end_height is None:
            return RATES[self.height]
        nearest = min(RATES, key=lambda h: abs(h - max(self.height, self.end_height or 0)))
        return RATES[nearest] / (QUICKER if self.quick else 1)

    @property
    def speed(self) -> float:
        """Metres a second, over ground: 3 to 12."""
        if self.end_height is None:
            return SPACING * self.height * self.rate_hz
        usual = math.sqrt(self.height * self.end_height) if self.pattern == "two_heights" else self.height
        return SPACING * max(usual, 20.0) * self.rate_hz * (QUICKER if self.quick else 1)

    @property
    def duration(self) -> float:
        """Seconds from the first exposure to the last, of a transect."""
        usual = LOW_FRAMES if self.height < 16 else FRAMES  # low, pictures are small: the flight is longer
        return ((QUICK_FRAMES if self.quick else usual) - 1) / self.rate_hz

    @property
    def course_deg(self) -> float:
        """Course in degrees clockwise from north; another one for every seed."""
        return round((84.3 + GOLDEN * self.seed) % 360.0, 1)

    def fly(self) -> SimulatedFlight:
        """Make the flight; the same rung gives the same bits."""
        plan = self.plan()
        if self.end_height is None:
            return fly(plan, self.seed)
        world = build(plan, self.seed)
        centre = _open_place(world)
        return fly(world, self.seed, plan=plan.flight.model_copy(update={"centre": centre}))

    def plan(self) -> Scene:
        """The scene with a flight over its middle; its wind, light and sensors are its own."""
        scene = read_scene(built_in()[self.scene], self.seed)
        own = scene.flight
        limits = own.limits if self.end_height is None else Limits(climb=RISE, sink=RISE, acceleration=PUSH)
        flight = FlightPlan(
            pattern=self.pattern, height=self.height, speed=self.speed, duration=self.duration,
            course_deg=self.course_deg, vehicle=own.vehicle, limits=limits, air=own.air,
            **({} if self.end_height is None else {"end_height": self.end_height}),
        )  # fmt: skip
        imaging = scene.imaging.model_copy(update={"rate_hz": self.rate_hz})
        return scene.model_copy(update={"flight": flight, "imaging": imaging})


def _open_place(world: SceneWorld) -> tuple[float, float]:
    """East and north of the place nearest to the middle, along a spiral, above which a flight may come low.

    Raises:
        InputError: there is none.
    """
    reach, most = CLEAR
    for k in range(TRIES):
        turn, away = math.radians(GOLDEN * k), APART * math.sqrt(k)
        east, north = away * math.cos(turn), away * math.sin(turn)
        height = world.truth((east - reach, north - reach, east + reach, north + reach)).height
        if float(height.max() - np.median(height)) < most:
            return round(east, 2), round(north, 2)
    raise InputError(f"{world.name}: no place within {APART * math.sqrt(TRIES):.0f} m of its middle to come low over")


def ladder(
    kind: Kind,
    *,
    scenes: Sequence[str] = SCENES,
    heights: Sequence[int] = HEIGHTS,
    seeds: int | None = None,
    quick: bool = False,
) -> tuple[Rung, ...]:
    """The rungs, scene by scene, low to high, seed by seed.

    Args:
        kind: `tuning` to fit and to choose on, `test` to report.
        scenes: some instead of all.
        heights: some of 20, 40, 50, 60, 100, 150 metres.
        seeds: number of seeds of each, instead of 3 (1 when `quick`).
        quick: flights of 11 exposures instead of 41, for tests.

    Raises:
        InputError: a scene, a height or a kind that is not on the ladder.
    """
    count = seeds if seeds is not None else 1 if quick else 3
    out = tuple(Rung(s, h, kind, n, quick) for s in scenes for h in heights for n in range(1, count + 1))
    for r in out:
        _check(r)
    return out


def rung(name: str) -> Rung:
    """The rung of a printed name.

    Raises:
        InputError: no rung has this name.
    """
    m = _NAME.fullmatch(name)
    if m is None:
        raise InputError(f"no rung of the ladder is called {name!r}; write one like meadow/50m/test-3")
    begin, end = int(m[2]), int(m[4]) if m[4] else None
    pattern: Pattern = "transect"
    if end is not None:
        pattern = "two_heights" if m[3] == "+" else "approach" if end < begin else "climb"
    out = Rung(m[1], begin, "test" if m[5] == "test" else "tuning", int(m[6]), bool(m[7]), pattern, end)
    _check(out)
    return out


def _check(r: Rung) -> None:
    if r.scene not in SCENES + FAMILIES:
        raise InputError(f"{r.name}: the scene is not on the ladder; use one of: {', '.join(SCENES + FAMILIES)}")
    if r.end_height is None and r.height not in RATES:
        raise InputError(f"{r.name}: the height is not on the ladder; use one of: {', '.join(map(str, RATES))}")
    if r.end_height is not None and not (
        LOWEST <= min(r.height, r.end_height) < max(r.height, r.end_height) <= HIGHEST
    ):
        raise InputError(f"{r.name}: use two different heights from {LOWEST} to {HIGHEST} m")
    if r.kind not in KINDS or not 1 <= r.number <= MOST_SEEDS:
        raise InputError(f"{r.name}: use tuning-1 or test-1, up to {MOST_SEEDS}")


def exposures(flight: SimulatedFlight) -> Iterator[list[View]]:
    """The views of each exposure of a flight with their true poses."""
    for event in flight.events():
        if isinstance(event, Frame):
            body = flight.pose(event.t_ns)
            yield [
                View(event.t_ns, i, image, cam.camera, body @ cam.body_from_cam)
                for i, (cam, image) in enumerate(zip(flight.true_rig.cameras, event.images, strict=True))
                if image is not None
            ]
