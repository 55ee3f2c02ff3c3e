"""Records of a campaign; each landing is a line of landings.jsonl. Metres, seconds, radians; east, north, up."""

from __future__ import annotations

import math
import sys
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from alight.records.executive import LookRecord
from alight.records.telemetry import FirmwareName

Outcome = Literal[
    "landed safely", "landed unsafely", "rightly refused", "wrongly refused", "handed over", "failed"
]  # fmt: skip
Touched = Literal["could have been stopped", "could not be stopped"]  # seen for a second above 1 m, or not
LOST = "WorkerLostError"  # prefix of errors of the machine, not of the landing
OUTCOMES: tuple[Outcome, ...] = Outcome.__args__  # type: ignore[attr-defined]
PLACES: tuple[Outcome, ...] = ("landed safely", "rightly refused")  # the right outcomes
MOST_LANDINGS = 100_000  # in a campaign; more would take years of CPU time
LARGEST_SEED = sys.maxsize
STRIKE = "strike"  # contact in flight with an obstacle beside the vehicle
GROUND = ("slope", "roughness", "step", "belly", "rotor", "ground", "wire")  # reasons due to the ground, not the flying


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, revalidate_instances="always")


class FaultRecord(_Line):
    """Planned fault or event."""

    what: str  # name of the fault or event, such as "GPS lost"
    after: float  # s since the start of the flight, or since `state` was first entered
    state: str | None = None  # state of the executive from which `after` counts; None: from the start
    numbers: dict[str, float] = {}  # drawn parameters of the fault by name, such as its duration in "seconds"
    takes_control: bool = False  # whether someone else then flies, so that handing over is right
    happened: float | None = None  # s of the flight; None: the landing ended earlier


class LightRecord(_Line):
    """Light of a scene: sun, sky and clouds."""

    azimuth_deg: float  # azimuth of the sun, clockwise from north
    elevation_deg: float  # elevation of the sun above the horizon
    sun: float  # strength of the sun; clear weather: 1
    sky: float  # strength of the sky; clear: 0.5, hazy: 2
    clouds: float = 0.0  # share of the ground in the shadow of clouds


class Conditions(_Line):
    """Conditions of a landing: everything that is drawn from the seed."""

    landing: int = Field(ge=0)  # number of the landing in the campaign
    seed: int  # seed of the campaign
    scene: str  # name, file, or package.module:factory
    world_seed: int  # seed of the simulated world
    flight_seed: int  # seed of noise, gusts and drift
    heading: float  # rad, clockwise from north, of the vehicle at the start
    wind: tuple[float, float]  # m/s east, north: velocity of the air
    gusts: float  # m/s^2, standard deviation of the acceleration by gusts
    gps_sigma: tuple[float, float, float]  # metres, 1-sigma of the drift: east, north, up
    gps_tau: float  # s, correlation time of the drift
    light: LightRecord | None = None  # None: the light of the world
    faults: tuple[FaultRecord, ...] = ()
    firmware: FirmwareName = "ardupilot"  # of the simulated autopilot
    odometry: bool = False  # whether odometry is sent

    @property
    def wind_speed(self) -> float:
        """Wind speed, m/s."""
        return math.hypot(*self.wind)


class TransitionLine(_Line):
    """One change of the executive's state."""

    t: float  # s of the flight
    before: str  # state before the event
    event: str
    after: str  # state after the event
    reason: str  # in words
    p_safe: float | None = None  # newest P(safe) of the site or candidate concerned; None: none is concerned


class TouchdownLine(_Line):
    """Contact of the vehicle with the true ground, judged by the oracle."""

    t: float  # s of the flight
    east: float  # metres
    north: float
    safe: bool
    reasons: tuple[str, ...]  # names of the broken limits
    tilt: float  # rad
    roughness: float  # metres, largest deviation of the ground from the footprint's plane
    sink: float  # m/s, speed downwards at the contact
    drift: float  # m/s, horizontal speed at the contact

    @property
    def bad_ground(self) -> bool:
        """Whether any reason is due to the ground, not only to the flying."""
        return any(r in GROUND for r in self.reasons)


class StrikeLine(_Line):
    """Obstacle beside the vehicle that was struck in flight, found by the oracle."""

    t: float  # s of the flight
    east: float  # metres, position of the vehicle
    north: float
    above: float  # metres, contact above the vehicle's feet


class LandingRecord(_Line):
    """Outcome and course of one landing, with its conditions."""

    conditions: Conditions
    outcome: Outcome
    why: str  # reason for the outcome, in words
    state: str | None = None  # state of the executive at the end
    p_found: float | None = None  # P(safe) of the last site when it was found
    p_at_commit: float | None = None  # P(safe) of the site when the landing was begun
    looks: tuple[LookRecord, ...] = ()
    transitions: tuple[TransitionLine, ...] = ()
    touchdown: TouchdownLine | None = None  # the worst contact from above
    strike: StrikeLine | None = None
    touched: Touched | None = None  # whether it touched a person or car that came; None: it did not
    safe_share: float | None = None  # safe share of the searched area, by the oracle with margin; only for a refusal
    seconds: float = 0.0  # duration of the flight
    found_after: float | None = None  # s until the first site was found
    distance: float = 0.0  # metres flown
    nearest: float | None = None  # metres, least height of the feet above everything in the footprint before the commit
    verdicts: int = 0  # number of verdicts on the map
    picture: str | None = Field(None, pattern=r"^[\w-]+\.webp$")  # file next to landings.jsonl
    film: str | None = Field(None, pattern=r"^[\w-]+\.webp$")  # file next to landings.jsonl: what the looks saw
    error: str | None = None  # exception that ended the landing, in one line; None: no exception
    cpu_s: float = 0.0  # CPU time; differs between runs
    cpu_of: dict[
        str, float
    ] = {}  # s of `cpu_s` by part: simulator, navigation, mapping, judging; the rest: world and oracle

    @property
    def number(self) -> int:
        """Number of the landing in the campaign."""
        return self.conditions.landing

    @property
    def commit_t(self) -> float | None:
        """Time of the last commit, s of the flight; None: no landing was begun."""
        return next((x.t for x in reversed(self.transitions) if x.after == "commit"), None)

    @property
    def bad_place(self) -> bool:
        """Whether the site was unsafe: a reason due to the ground, or a strike after the commit."""
        begun = self.commit_t
        struck = self.strike is not None and begun is not None and self.strike.t >= begun
        return struck or (self.touchdown is not None and self.touchdown.bad_ground)

    @property
    def is_right(self) -> bool:
        """Whether the outcome is right: landed safely, rightly refused, or handed over to someone who took control."""
        taken = any(f.takes_control and f.happened is not None for f in self.conditions.faults)
        return self.outcome in PLACES or (self.outcome == "handed over" and taken)

    @property
    def was_lost(self) -> bool:
        """Whether the process of the landing died, so that its outcome is unknown."""
        return self.error is not None and self.error.startswith(LOST)

    def repeatable(self) -> dict[str, Any]:
        """Return the fields whose values a repetition of the landing reproduces: all but the CPU times."""
        return self.model_dump(mode="json", exclude={"cpu_s", "cpu_of"})


class CampaignHead(_Line):
    """Head of a campaign: the same seed, scenes and settings give the same landings."""

    model_config = ConfigDict(extra="ignore")  # campaign.json also holds the results

    alight: str  # version of Alight
    seed: int = Field(ge=0)
    scenes: tuple[str, ...] = Field(min_length=1)
    landings: int = Field(ge=1, le=MOST_LANDINGS)  # number to fly; a larger number continues the same campaign
    settings: dict[str, Any]  # all settings of the landings
    link_faults: float = Field(0.0, ge=0, le=1)  # share of the landings with a fault of the link or the autopilot
    firmware: FirmwareName = "ardupilot"  # of the simulated autopilot
    odometry: bool = False  # whether odometry is sent, and GPS fails in each landing
    people: float = Field(0.0, ge=0, le=1)  # share of the landings with a person or car, instead of other faults
    sources: str = ""  # digest of the program; empty: unknown
    files: dict[str, str] = {}  # digests of scene files, their rasters, modules of worlds, the model of appearance

    @property
    def _link(self) -> tuple[float, str, bool, float]:
        return self.link_faults, self.firmware, self.odometry, self.people

    def differing(self, other: CampaignHead) -> str | None:
        """Return the first difference from another campaign in words; None if both are the same campaign."""
        changed = [name for name in self.files if other.files.get(name, self.files[name]) != self.files[name]]
        link = f"a {self.firmware} autopilot, {'' if self.odometry else 'no '}odometry and a share of "
        link += f"{self.link_faults:g} of link faults, {self.people:g} of people and cars"
        differences = {
            f"seed {self.seed}": self.seed != other.seed,
            f"the scenes {' '.join(self.scenes)}": self.scenes != other.scenes,
            link: self._link != other._link,
            f"version {self.alight} of Alight": self.alight != other.alight,
            "other settings": self.settings != other.settings,
            "another state of Alight's sources": bool(self.sources and other.sources) and self.sources != other.sources,
            f"another content of {', '.join(changed)}": bool(changed),
        }
        return next((words for words, differs in differences.items() if differs), None)
