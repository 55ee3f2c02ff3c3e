"""Faults and events of a landing: the ranges of their parameters, and their effect on vehicle, link and autopilot."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.executive.table import ENDS
from alight.records import RigCamera
from alight.records.campaign import FaultRecord, Touched
from alight.records.executive import FlightState
from alight.trials.landing import Trial
from alight_sim.autopilot.dialects import Doing
from alight_sim.movers import boxes_at
from alight_sim.steered import SteeredFlight
from alight_sim.steered.ground import tops
from alight_sim.steered.touchdown import contact_seconds

Range = tuple[float, float]
Numbers = Mapping[str, float]
STOPPABLE = 1.0  # metres above the ground, and seconds in view: else a landing cannot be stopped for somebody
TURN: Range = (0.0, 2.0 * math.pi)


@dataclass(frozen=True)
class CampaignFault:
    """A kind of fault or event: its effect, and the ranges of its parameters."""

    act: Callable[[Any, Numbers], object]  # called with a `SteeredFlight`; in `LINK_FAULTS`, with a `Trial`
    ranges: Mapping[str, Range] = field(default_factory=dict)  # ranges from which the parameters are drawn
    is_body: bool = False  # whether it is a car or person that moves to the vehicle
    takes_control: bool = False  # whether the landing should be handed over

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Return parameters drawn uniformly from their ranges, by name."""
        return {name: float(rng.uniform(*r)) for name, r in self.ranges.items()}


def _towards(n: Numbers, length: float) -> tuple[float, float]:
    return length * math.cos(n["direction"]), length * math.sin(n["direction"])


def _come(how: Callable[..., object], v: SteeredFlight, n: Numbers, speed: float) -> None:
    """Move a car or a person to the vehicle `v` at `speed` m/s, by `how`, the method of `v` for such a body."""
    east, north, _ = (float(c) for c in v.true_pose.translation)
    x, y = _towards(n, n["from"])
    how(east, north, start=(east + x, north + y), speed=speed)


FAULTS: Mapping[str, CampaignFault] = {
    "car": CampaignFault(
        lambda v, n: _come(v.park, v, n, n["speed"]),
        {"direction": TURN, "from": (20.0, 35.0), "speed": (4.0, 8.0)},
        is_body=True,
    ),
    "person": CampaignFault(
        lambda v, n: _come(v.walk_in, v, n, 1.4), {"direction": TURN, "from": (6.0, 12.0)}, is_body=True
    ),
    "gust": CampaignFault(
        lambda v, n: v.gust((*_towards(n, n["push"]), 0.0), n["seconds"]),
        {"direction": TURN, "push": (1.5, 3.0), "seconds": (1.5, 4.0)},
    ),
    "strong wind": CampaignFault(
        lambda v, n: v.wind(*_towards(n, n["speed"])), {"direction": TURN, "speed": (9.0, 12.0)}
    ),
    "cameras frozen": CampaignFault(lambda v, n: v.freeze_camera(n["seconds"]), {"seconds": (2.0, 10.0)}),
    "cameras lost": CampaignFault(lambda v, n: v.lose_camera(n["seconds"]), {"seconds": (2.0, 25.0)}),
    "one camera lost": CampaignFault(lambda v, n: v.lose_camera(n["seconds"], 1), {"seconds": (2.0, 60.0)}),
    "cameras covered": CampaignFault(lambda v, n: v.cover_camera(n["seconds"]), {"seconds": (3.0, 10.0)}),
    "pictures late": CampaignFault(
        lambda v, n: v.delay_frames(n["seconds"], n["by"]), {"seconds": (5.0, 20.0), "by": (0.3, 0.9)}
    ),
    "GPS lost": CampaignFault(lambda v, n: v.lose_gps(n["seconds"]), {"seconds": (5.0, 60.0)}),
    "GPS jump": CampaignFault(
        lambda v, n: v.jump_gps((*_towards(n, n["by"]), n["up"]), n["seconds"]),
        {"direction": TURN, "by": (3.0, 8.0), "up": (-2.0, 2.0), "seconds": (10.0, 30.0)},
    ),
    "IMU lost": CampaignFault(lambda v, n: v.lose_imu(n["seconds"]), {"seconds": (0.3, 2.0)}),
    "battery low": CampaignFault(lambda v, n: v.drain(n["share"]), {"share": (0.82, 0.9)}),
}
LINK_FAULTS: Mapping[str, CampaignFault] = {
    "pilot takes over": CampaignFault(lambda t, n: t.autopilot.pilot(Doing.PILOT), takes_control=True),
    "autopilot lands": CampaignFault(lambda t, n: t.autopilot.pilot(Doing.LAND), takes_control=True),
    "modes refused": CampaignFault(lambda t, n: t.autopilot.refuse_modes(n["seconds"]), {"seconds": (2.0, 10.0)}),
    "link interrupted": CampaignFault(lambda t, n: t.link.cut(n["seconds"]), {"seconds": (0.5, 2.5)}),
    "link lost": CampaignFault(lambda t, n: t.link.cut(n["seconds"]), {"seconds": (30.0, 60.0)}, takes_control=True),
}

GPS_FAULTS: Mapping[str, CampaignFault] = {  # of landings with odometry
    "GPS away": CampaignFault(lambda v, n: v.lose_gps(n["seconds"]), {"seconds": (5.0, 40.0)}),
    "GPS gone": CampaignFault(lambda v, n: v.lose_gps(1e4)),
    "GPS led away": CampaignFault(
        lambda v, n: v.lead_gps((*_towards(n, n["speed"]), 0.0)), {"direction": TURN, "speed": (1.0, 1.0)}
    ),
}


class Happenings:
    """Triggers the planned faults of a landing, and measures the flown distance. Called before every order.

    Args:
        vehicle: the vehicle of the landing.
        planned: the planned faults, in any order.
    """

    def __init__(self, vehicle: SteeredFlight, planned: tuple[FaultRecord, ...]) -> None:
        self._vehicle, self._planned = vehicle, planned
        self._entered: dict[str, float] = {}
        self._happened: dict[int, float] = {}
        self._at = vehicle.true_pose.translation.copy()
        self.distance = 0.0  # metres
        self.nearest: float | None = None  # metres, least height of the feet above everything within the radius
        self._t, self._in_view = 0.0, defaultdict[int, float](float)  # s; s in view of each body, `STOPPABLE` or higher

    def __call__(self, trial: Trial) -> None:
        """Trigger the faults that are due; update the flown distance, and the least gap below the feet."""
        t, state = trial.t, trial.state
        at = self._vehicle.true_pose.translation
        self.distance += float(np.linalg.norm(at - self._at))
        self._at = at.copy()
        self._watch_bodies(t)
        if state not in (FlightState.COMMIT, FlightState.ABORT, *ENDS):
            gap = self._vehicle.gap
            self.nearest = gap if self.nearest is None else min(self.nearest, gap)
        self._entered.setdefault(state.value, t)
        for k, fault in enumerate(self._planned):
            since = 0.0 if fault.state is None else self._entered.get(fault.state)
            if k in self._happened or since is None or t < since + fault.after:
                continue
            if fault.what in LINK_FAULTS:
                LINK_FAULTS[fault.what].act(trial, fault.numbers)
            else:
                {**FAULTS, **GPS_FAULTS}[fault.what].act(self._vehicle, fault.numbers)
            self._happened[k] = t

    @property
    def faults(self) -> tuple[FaultRecord, ...]:
        """The planned faults, each with the second of the landing at which it happened; None: it did not happen."""
        return tuple(f.model_copy(update={"happened": self._happened.get(k)}) for k, f in enumerate(self._planned))

    def _watch_bodies(self, t: float) -> None:
        """Add up how long each body is in view while the vehicle is high enough to stop."""
        v, seconds, self._t = self._vehicle, t - self._t, t
        east, north, up = (float(c) for c in v.true_pose.translation)
        if v.bodies and not v.contacts and up - v.standing - v.world.height_at(east, north) > STOPPABLE:
            for k, body in enumerate(v.bodies):
                middle = body.place_at(np.array([v.seconds])) + np.array([0.0, 0.0, 0.5 * body.size[2]])
                self._in_view[k] += seconds * any(_shows(cam, v, middle) for cam in v.true_rig.cameras)

    def touched(self, reach: float) -> Touched | None:
        """Return whether the vehicle, of radius `reach` in metres, touched a person or car; None: it did not."""
        v, found = self._vehicle, list[Touched]()
        for contact in v.contacts:
            (east, north, _), now = contact.pose.translation, np.array([contact_seconds(contact)])
            for k, body in enumerate(v.bodies):
                if tops(boxes_at([body], now)[0], float(east), float(north), reach) > -math.inf:
                    found.append("could have been stopped" if self._in_view[k] >= STOPPABLE else "could not be stopped")
        return min(found, default=None)  # the former, if there are both


def _shows(cam: RigCamera, v: SteeredFlight, point: F64) -> bool:
    """Whether a point, (1, 3) metres, is in the picture of a camera of the vehicle."""
    pixel = cam.camera.project((v.true_pose @ cam.body_from_cam).inverse.apply(point))[0]
    return bool((pixel >= 0).all() and pixel[0] < cam.camera.width and pixel[1] < cam.camera.height)
