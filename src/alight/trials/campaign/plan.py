"""The conditions of each landing of a campaign. Those of landing k depend on the scenes, the seed and k alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from alight.records import InputError
from alight.records.campaign import Conditions, FaultRecord, LightRecord
from alight.records.executive import FlightState
from alight.records.telemetry import FirmwareName
from alight.trials.campaign.factories import is_factory
from alight.trials.campaign.faults import FAULTS
from alight.trials.campaign.link_faults import drawn_link_fault
from alight_sim.campaign import CampaignWorld, campaign_worlds
from alight_sim.scene import built_in, read_scene

MOST_WIND = 6.0  # m/s
LIGHT, LINK = 1, 2  # of the spawn key: random numbers of their own
SUN = (12.0, 75.0)  # degrees above the horizon
OVERCAST, CLOUDY = 0.25, 0.25  # shares of the landings
FAULTY = 1.0 / 3.0  # share of the landings
EARLIEST, LATEST = 5.0, 60.0  # s of a flight, for events at a time
DELAY = 2.0  # s after a state is entered, at most
AT_STATES = (FlightState.APPROACH, FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)


def campaign_world(scene: str) -> CampaignWorld:
    """Return the world of a kind or a built-in scene by name, or of a scene file."""
    return campaign_worlds().get(scene) or CampaignWorld(scene, scene)


def scenes_of(names: Sequence[str]) -> tuple[str, ...]:
    """The scenes of a campaign, each once; `all` stands for all kinds of worlds of the simulator.

    Raises:
        InputError: no scene is named, no such scene, or its file cannot be used.
    """
    if not names:
        raise InputError("a campaign without scenes; name some, or 'all'")
    known = campaign_worlds()
    scenes = tuple(dict.fromkeys(s for name in names for s in (known if name == "all" else (name,))))
    for scene in scenes:
        if scene in known or scene in built_in() or is_factory(scene):
            continue
        if not Path(scene).suffix:
            have = ", ".join(sorted({*known, *built_in()}))
            raise InputError(f"no scene is called {scene!r}; use 'all', a YAML file, or some of: {have}")
        read_scene(Path(scene))
    return scenes


def conditions_of(
    scenes: Sequence[str], seed: int, landing: int, link_faults: float = 0.0, firmware: FirmwareName = "ardupilot"
) -> Conditions:
    """Draw the conditions of a landing: scenes take turns, all else is random.

    Args:
        scenes: names, files, or factories of worlds, which have a light of their own.
        seed: of the campaign.
        landing: its number, from 0.
        link_faults: share of the landings with a fault of the link or the autopilot; the rest of what is drawn does
            not depend on it.
        firmware: of the simulated autopilot.
    """
    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(landing, LINK)))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(landing,)))
    world_seed, flight_seed = (int(s) for s in rng.integers(0, 2**31, 2))
    heading, blows, wind = rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi), rng.uniform(0, MOST_WIND)
    gps, scene = rng.uniform(0.3, 2.0), scenes[landing % len(scenes)]
    light = np.random.SeedSequence(seed, spawn_key=(landing, LIGHT))
    return Conditions(
        landing=landing, seed=seed, scene=scene, world_seed=world_seed,
        flight_seed=flight_seed, heading=heading, wind=(wind * math.cos(blows), wind * math.sin(blows)),
        gusts=0.1 + 0.05 * wind, gps_sigma=(gps, gps, 1.5 * gps), gps_tau=rng.uniform(30.0, 120.0),
        light=None if is_factory(scene) else drawn_light(np.random.default_rng(light)),
        faults=((_fault(rng),) if rng.random() < FAULTY else ()) + drawn_link_fault(stream, link_faults),
        firmware=firmware,
    )  # fmt: skip


def drawn_light(rng: np.random.Generator) -> LightRecord:
    """Draw the light: any time of the day, a quarter overcast, a quarter with clouds that drift."""
    place = {"azimuth_deg": rng.uniform(0.0, 360.0), "elevation_deg": rng.uniform(*SUN)}
    kind = rng.random()
    if kind < OVERCAST:
        return LightRecord(**place, sun=rng.uniform(0.0, 0.3), sky=rng.uniform(1.0, 2.0))
    clouds = rng.uniform(0.1, 0.6) if kind < OVERCAST + CLOUDY else 0.0
    return LightRecord(**place, sun=rng.uniform(0.8, 1.1), sky=rng.uniform(0.4, 0.8), clouds=clouds)


def _fault(rng: np.random.Generator) -> FaultRecord:
    """Draw one fault or event, at a time or at a state; a body comes only in states where it is in the way."""
    what = str(rng.choice(list(FAULTS)))
    fault, by_state = FAULTS[what], bool(rng.random() < 0.5)
    state = str(rng.choice([s.value for s in (AT_STATES[1:] if fault.is_body else AT_STATES)]))
    early, late = rng.uniform(0, DELAY), rng.uniform(EARLIEST, LATEST)
    at_state = by_state or fault.is_body
    return FaultRecord(
        what=what, after=early if at_state else late, state=state if at_state else None, numbers=fault.draw(rng)
    )
