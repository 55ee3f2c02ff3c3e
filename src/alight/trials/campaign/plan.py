"""The conditions of each landing of a campaign. They depend on the scenes, the seed and the landing's number alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alight.records.campaign import Conditions, FaultRecord, LightRecord
from alight.records.executive import FlightState
from alight.records.telemetry import FirmwareName
from alight.trials.campaign.faults import FAULTS, GPS_FAULTS, LINK_FAULTS
from alight.trials.campaign.worlds import is_factory

MOST_WIND = 6.0  # m/s
LANDS = 15.0  # s that a landing takes: whoever comes meets it at any height
SUN = (12.0, 75.0)  # degrees above the horizon
AT_STATES = (FlightState.APPROACH, FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)


def conditions_of(
    scenes: Sequence[str], seed: int, landing: int, link_faults: float = 0.0, firmware: FirmwareName = "ardupilot",
    odometry: bool = False, people: float = 0.0,
) -> Conditions:  # fmt: skip
    """Draw the conditions of a landing: scenes take turns, everything else is random.

    Args:
        scenes: names, files, or factories of worlds; for a factory, no light is drawn.
        seed: seed of the campaign.
        landing: number of the landing, from 0.
        link_faults: share of the landings with a fault of the link or the autopilot; all other draws are independent
            of it.
        firmware: firmware of the simulated autopilot.
        odometry: whether odometry is sent, and GPS fails in each landing, instead of other faults of the vehicle.
        people: share of the landings in which a person or car comes to the site, instead of other faults.
    """
    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(landing, 2)))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(landing,)))
    world_seed, flight_seed = (int(s) for s in rng.integers(0, 2**31, 2))
    heading, blows, wind = rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi), rng.uniform(0, MOST_WIND)
    gps, scene = rng.uniform(0.3, 2.0), scenes[landing % len(scenes)]
    light = np.random.SeedSequence(seed, spawn_key=(landing, 1))
    return Conditions(
        landing=landing, seed=seed, scene=scene, world_seed=world_seed,
        flight_seed=flight_seed, heading=heading, wind=(wind * math.cos(blows), wind * math.sin(blows)),
        gusts=0.1 + 0.05 * wind, gps_sigma=(gps, gps, 1.5 * gps), gps_tau=rng.uniform(30.0, 120.0),
        light=None if is_factory(scene) else drawn_light(np.random.default_rng(light)),
        faults=_own_faults(rng, odometry, people) + _link_fault(stream, link_faults),
        firmware=firmware, odometry=odometry,
    )  # fmt: skip


def _own_faults(rng: np.random.Generator, odometry: bool, people: float) -> tuple[FaultRecord, ...]:
    """Draw a fault of the vehicle in a third of the landings or one of GPS in each (`odometry`), or a person or car."""
    if people > 0 and rng.random() < people:
        what = str(rng.choice([name for name, fault in FAULTS.items() if fault.is_body]))
        return (_coming(what, rng, rng.uniform(0.0, LANDS)),)
    if not odometry:
        return (_fault(rng),) if rng.random() < 1 / 3 else ()
    what, state = (
        str(rng.choice(list(GPS_FAULTS))),
        str(rng.choice([FlightState.SEARCH.value, *(s.value for s in AT_STATES)])),
    )
    after, numbers = rng.uniform(0.0, 8.0), GPS_FAULTS[what].draw(rng)
    return (FaultRecord(what=what, after=after, state=state, numbers=numbers),)


def drawn_light(rng: np.random.Generator) -> LightRecord:
    """Draw the light of a landing: any time of day; a quarter is overcast, a quarter has drifting clouds."""
    place = {"azimuth_deg": rng.uniform(0.0, 360.0), "elevation_deg": rng.uniform(*SUN)}
    kind = rng.random()
    if kind < 0.25:
        return LightRecord(**place, sun=rng.uniform(0.0, 0.3), sky=rng.uniform(1.0, 2.0))
    clouds = rng.uniform(0.1, 0.6) if kind < 0.5 else 0.0
    return LightRecord(**place, sun=rng.uniform(0.8, 1.1), sky=rng.uniform(0.4, 0.8), clouds=clouds)


def _fault(rng: np.random.Generator) -> FaultRecord:
    """Draw a fault or event, due at a time or after a state is entered; cars and persons come at a look or later."""
    what = str(rng.choice(list(FAULTS)))
    fault, at_state, state = FAULTS[what], bool(rng.random() < 0.5), str(rng.choice([s.value for s in AT_STATES]))
    early, late = rng.uniform(0, 2.0), rng.uniform(5.0, 60.0)  # s: after the state is entered; of the flight
    if fault.is_body:
        return _coming(what, rng, early)
    return FaultRecord(
        what=what, after=early if at_state else late, state=state if at_state else None, numbers=fault.draw(rng)
    )


def _coming(what: str, rng: np.random.Generator, after: float) -> FaultRecord:
    """Draw somebody who sets out to the place `after` s into a look, or a part of the way down."""
    state = str(rng.choice([s.value for s in AT_STATES[1:]]))
    return FaultRecord(what=what, after=after, state=state, numbers=FAULTS[what].draw(rng))


def _link_fault(rng: np.random.Generator, share: float) -> tuple[FaultRecord, ...]:
    """Draw no fault or one fault, seconds after a state is entered; `share` is the probability of a fault."""
    if not rng.random() < share:
        return ()
    what, state = (
        str(rng.choice(list(LINK_FAULTS))),
        str(rng.choice([s.value for s in (FlightState.SEARCH, *AT_STATES)])),
    )
    kind, after = LINK_FAULTS[what], float(rng.uniform(0.0, 4.0))
    numbers = kind.draw(rng)
    return (FaultRecord(what=what, after=after, state=state, numbers=numbers, takes_control=kind.takes_control),)
