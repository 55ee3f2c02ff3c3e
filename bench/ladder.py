"""The standard ladder: the flights that every benchmark flies, each with a name that it prints.

Scenes times heights times seeds. What is fitted or tuned is fitted on the rungs called `tuning`, what is claimed is
measured on those called `test`, and no seed is in both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from alight.records import InputError
from alight_sim.flight import SimulatedFlight, fly
from alight_sim.patterns import FlightPlan
from alight_sim.scene import Scene, built_in, read_scene

Kind = Literal["tuning", "test"]
KINDS: tuple[Kind, ...] = ("tuning", "test")
# metres above ground: exposures a second. The spacing is 2 % of the height: 8 exposures span 0.14 of it
RATES = {20: 8.0, 40: 6.0, 50: 6.0, 60: 6.0, 100: 5.0, 150: 4.0}
HEIGHTS = (20, 50, 100, 150)  # the standard; the others between are flown by name
SPACING = 0.02  # of the height between exposures
FRAMES, QUICK_FRAMES = 41, 11
SCENES = (
    "meadow", "farmland", "village", "forest", "quarry", "lakes",
    "desert", "snow", "concrete", "car_park", "tall_grass", "yard",
)  # fmt: skip
SEEDS, QUICK_SEEDS = 3, 1
FIRST_SEED = {"tuning": 1, "test": 1001}
MOST_SEEDS = 1000
GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))  # degrees: courses spread evenly however many seeds there are
_NAME = re.compile(r"([a-z0-9_]+)/(\d+)m/(tuning|test)-(\d+)(-quick)?")


@dataclass(frozen=True)
class Rung:
    """One flight of the ladder; nothing is made before `fly`."""

    scene: str
    height: int  # metres above the ground under its start
    kind: Kind
    number: int  # from 1
    quick: bool = False

    @property
    def name(self) -> str:
        """What the benchmarks print, such as `meadow/50m/test-3`."""
        return f"{self.scene}/{self.height}m/{self.kind}-{self.number}{'-quick' if self.quick else ''}"

    @property
    def seed(self) -> int:
        """Of the world and of every source of noise."""
        return FIRST_SEED[self.kind] + self.number - 1

    @property
    def rate_hz(self) -> float:
        """Exposures a second."""
        return RATES[self.height]

    @property
    def speed(self) -> float:
        """Metres a second: 3 to 12."""
        return SPACING * self.height * self.rate_hz

    @property
    def duration(self) -> float:
        """Seconds from the first exposure to the last."""
        return ((QUICK_FRAMES if self.quick else FRAMES) - 1) / self.rate_hz

    @property
    def course_deg(self) -> float:
        """Clockwise from north; another one for every seed."""
        return round((84.3 + GOLDEN * self.seed) % 360.0, 1)

    def fly(self) -> SimulatedFlight:
        """Make the flight: the same rung is the same bit for bit."""
        return fly(self.plan(), self.seed)

    def plan(self) -> Scene:
        """The scene with a straight transect over its middle; its wind, light and sensors are its own."""
        scene = read_scene(built_in()[self.scene])
        own = scene.flight
        transect = FlightPlan(
            height=self.height, speed=self.speed, duration=self.duration, course_deg=self.course_deg,
            vehicle=own.vehicle, limits=own.limits, air=own.air,
        )  # fmt: skip
        imaging = scene.imaging.model_copy(update={"rate_hz": self.rate_hz})
        return scene.model_copy(update={"flight": transect, "imaging": imaging})


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
        seeds: how many of each, instead of 3 (1 when `quick`).
        quick: flights of 11 exposures instead of 41, for tests.

    Raises:
        InputError: a scene, a height or a kind that is not on the ladder.
    """
    count = seeds if seeds is not None else QUICK_SEEDS if quick else SEEDS
    out = tuple(Rung(s, h, kind, n, quick) for s in scenes for h in heights for n in range(1, count + 1))
    for r in out:
        _check(r)
    return out


def rung(name: str) -> Rung:
    """The rung of a printed name.

    Raises:
        InputError: no rung is called so.
    """
    m = _NAME.fullmatch(name)
    if m is None:
        raise InputError(f"no rung of the ladder is called {name!r}; write one like meadow/50m/test-3")
    out = Rung(m[1], int(m[2]), "test" if m[3] == "test" else "tuning", int(m[4]), bool(m[5]))
    _check(out)
    return out


def _check(r: Rung) -> None:
    if r.scene not in SCENES:
        raise InputError(f"{r.name}: the scene is not on the ladder; use one of: {', '.join(SCENES)}")
    if r.height not in RATES:
        raise InputError(f"{r.name}: the height is not on the ladder; use one of: {', '.join(map(str, RATES))}")
    if r.kind not in KINDS or not 1 <= r.number <= MOST_SEEDS:
        raise InputError(f"{r.name}: use tuning-1 or test-1, up to {MOST_SEEDS}")
