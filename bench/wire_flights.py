"""Flights over the scenes of the ladder with wires of drawn thickness, height, length and colour, kept between runs.

A case is flown and mapped once; what is kept is what the judging lane gets: the map with its views.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from ground_maps import shifted
from ladder import FAMILIES, FIRST_SEED, RATES, SCENES, SPACING, Kind, Rung

import alight_sim
from alight.arrays import F64
from alight.evaluation.flight import FlightTruth
from alight.pipeline import Pipeline, PipelineOptions
from alight.pipeline.mapping import MapSnapshot
from alight.settings import load_settings
from alight_sim.flight import fly
from alight_sim.scene import Scene, parse_scene
from alight_sim.spans import TrueSpans

OPEN = tuple(s for s in SCENES + FAMILIES if s not in ("forest", "tall_grass", "lakes", "canal"))  # have good ground
HEIGHTS = (40, 25, 15, 10)  # metres, of the flights
BARE_EVERY = 3  # every third flight has no wire
SPANS = 3  # of a flight with wires
FRAMES = 31  # exposures: over 0.6 of the height
LOWEST, HIGHEST, BELOW = 4.0, 30.0, 3.0  # metres: of the wires above ground, and least depth below the cameras


@dataclass(frozen=True, eq=False)
class WireFlight:
    """A map with its views, and the truth in the frame of the map."""

    name: str
    seen: MapSnapshot
    truth: FlightTruth
    spans: TrueSpans
    height: float  # metres, of the flight above ground


@dataclass(frozen=True)
class Case:
    """One flight; nothing is made before `fly`."""

    scene: str
    height: int
    kind: Kind
    number: int  # from 1

    @property
    def name(self) -> str:
        """Name that the benchmark prints."""
        return f"{self.scene}/{self.height}m/{self.kind}-{self.number}{'' if self.wired else '-bare'}"

    @property
    def wired(self) -> bool:
        """Whether it has wires of its own."""
        return self.number % BARE_EVERY != 0

    @property
    def seed(self) -> int:
        """Seed of the world, of the noise and of the wires."""
        return FIRST_SEED[self.kind] + 5000 + self.number

    def layers(self, course_deg: float) -> list[dict[str, Any]]:
        """Draw the wires about the path: layers of a scene file."""
        rng, out = np.random.default_rng(self.seed), []
        ahead = np.array([np.sin(np.radians(course_deg)), np.cos(np.radians(course_deg))])
        for _ in range(SPANS if self.wired else 0):
            at = 0.35 * self.height * (rng.uniform(-1, 1) * ahead + rng.uniform(-1, 1) * ahead[::-1] * (1, -1))
            high = rng.uniform(LOWEST, min(HIGHEST, self.height - BELOW))
            long = rng.uniform(20.0, 60.0)
            out.append({
                "thing": "washing_line", "at": [[float(v) for v in at]], "length": [long, long],
                "height": [high, high], "turn_deg": float(rng.uniform(0, 180)), "wires": 1,
                "diameter": float(np.exp(rng.uniform(np.log(0.01), np.log(0.05)))),
                "colour": [float(np.exp(rng.uniform(np.log(0.03), np.log(0.6))))] * 3,
                "sag": float(rng.uniform(0.005, 0.03)), "post": float(rng.choice([0.0, 0.2])),
            })  # fmt: skip
        return out

    def plan(self) -> Scene:
        """The scene with the wires and a straight flight over its middle."""
        near = min(RATES, key=lambda h: abs(h - self.height))
        rung = Rung(self.scene, near, self.kind, self.seed - FIRST_SEED[self.kind] + 1)
        scene, rate = rung.plan(), RATES[near]
        extra = parse_scene({"ground": {"layers": self.layers(rung.course_deg)}}, self.name).ground.layers
        ground = scene.ground.model_copy(update={"layers": scene.ground.layers + extra})
        speed, seconds = SPACING * self.height * rate, (FRAMES - 1) / rate
        flight = scene.flight.model_copy(update={"height": self.height, "speed": speed, "duration": seconds})
        return scene.model_copy(update={"ground": ground, "flight": flight})

    def kept_in(self, scratch: Path) -> Path:
        """File of the flight."""
        return scratch / _made_by() / f"{self.name.replace('/', '_')}.pickle"

    def fly(self) -> WireFlight | None:
        """Fly and map; None: no map."""
        flight = fly(self.plan(), self.seed)
        settings = load_settings("", ["parallax.method=recursive"])
        lane = Pipeline(flight.rig, flight.kind, settings, PipelineOptions(imu=flight.imu_noise))
        for event in flight.events():
            lane.feed(event)
        trajectory = lane._navigation.finish(lambda _: None)
        seen = lane._mapping.finish(trajectory, lambda _: None).snapshot if trajectory.usable else None
        if seen is None:
            return None
        true = {int(t): p.translation for t, p in zip(*flight.truth_trajectory, strict=True)}
        off = np.mean([m.world_from_body.translation - true[m.t_ns] for m in trajectory.motions], axis=0)
        off = off - seen.frame.offset_world
        truth = shifted(FlightTruth(flight.truth.height, flight.truth.label, flight.truth.grid), off)
        return WireFlight(self.name, seen, truth, moved(flight.truth.spans, off), self.height)


def moved(spans: TrueSpans, off: F64) -> TrueSpans:
    """Spans moved by (3,) metres."""
    table = spans.table.copy()
    table[:, :3] += off
    table[:, 3:6] += off
    return TrueSpans(table)


def cases(kind: Kind, count: int) -> list[Case]:
    """The first flights of a kind: every height over other scenes, each scene in turn."""
    return [Case(OPEN[(5 * k) % len(OPEN)], HEIGHTS[k % len(HEIGHTS)], kind, k + 1) for k in range(count)]


@cache
def _made_by() -> str:
    files = sorted(Path(alight_sim.__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:12]


def flown(case: Case, scratch: Path) -> WireFlight | None:
    """The flight of a case, from `scratch` if it was flown before with the same simulator."""
    path = case.kept_in(scratch)
    if path.exists():
        return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]
    found = case.fly()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(found))
    return found


def drawn(kind: Kind, count: int, scratch: Path) -> Iterator[WireFlight | None]:
    """The first flights of a kind, flown if they were not before."""
    return (flown(case, scratch) for case in cases(kind, count))


def kept(kind: Kind, scratch: Path) -> Iterator[WireFlight | None]:
    """All flights of a kind that were flown before with the same simulator."""
    return (pickle.loads(p.read_bytes()) for p in sorted((scratch / _made_by()).glob(f"*_{kind}-*.pickle")))
