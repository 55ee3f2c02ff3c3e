"""Faults and events of the link and the autopilot, for some of the landings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from alight.records.campaign import FaultRecord
from alight.records.executive import FlightState
from alight.trials.landing import Trial
from alight_sim.autopilot.dialects import Doing

Numbers = Mapping[str, float]
STATES = (FlightState.SEARCH, FlightState.APPROACH, FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)
LATEST = 4.0  # s after the state is entered


@dataclass(frozen=True)
class LinkFault:
    """A kind of fault or event between pilot and autopilot: the ranges of its numbers, and its effect on a landing."""

    act: Callable[[Trial, Numbers], object]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # its numbers are uniform in them
    takes_control: bool = False  # the landing is to be handed over


LINK_FAULTS: Mapping[str, LinkFault] = {
    "pilot takes over": LinkFault(lambda t, n: t.autopilot.pilot(Doing.PILOT), takes_control=True),
    "autopilot lands": LinkFault(lambda t, n: t.autopilot.pilot(Doing.LAND), takes_control=True),
    "modes refused": LinkFault(lambda t, n: t.autopilot.refuse_modes(n["seconds"]), {"seconds": (2.0, 10.0)}),
    "link interrupted": LinkFault(lambda t, n: t.link.cut(n["seconds"]), {"seconds": (0.5, 2.5)}),
    "link lost": LinkFault(lambda t, n: t.link.cut(n["seconds"]), {"seconds": (30.0, 60.0)}, takes_control=True),
}


def drawn_link_fault(rng: np.random.Generator, share: float) -> tuple[FaultRecord, ...]:
    """Draw one fault or event for a share of the landings, some seconds after a state is entered."""
    if not rng.random() < share:
        return ()
    what, state = str(rng.choice(list(LINK_FAULTS))), str(rng.choice([s.value for s in STATES]))
    kind, after = LINK_FAULTS[what], float(rng.uniform(0.0, LATEST))
    numbers = {name: float(rng.uniform(*r)) for name, r in kind.ranges.items()}
    return (FaultRecord(what=what, after=after, state=state, numbers=numbers, takes_control=kind.takes_control),)
