"""Records of a campaign; a landing is a line of landings.jsonl. Metres, seconds, radians; places east, north, up."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from alight.records.executive import LookRecord
from alight.records.telemetry import FirmwareName

Outcome = Literal[
    "landed safely", "landed unsafely", "rightly refused", "wrongly refused", "handed over", "failed"
]  # fmt: skip
LOST = "WorkerLostError"  # an error of the machine, not of the landing
OUTCOMES: tuple[Outcome, ...] = Outcome.__args__  # type: ignore[attr-defined]
PLACES: tuple[Outcome, ...] = ("landed safely", "rightly refused")  # the wanted outcomes
MOST_LANDINGS = 100_000  # of a campaign: years of CPU time
LARGEST_SEED = 2**63 - 1
STRIKE = "strike"  # of an obstacle beside the vehicle, in flight
GROUND = ("slope", "roughness", "step", "belly", "rotor", "ground", "wire")  # of the place; others: of the flying


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, revalidate_instances="always")


class FaultRecord(_Line):
    """A planned fault or event."""

    what: str
    after: float  # s, of the flight, or since `state` was first entered
    state: str | None = None
    numbers: dict[str, float] = {}
    takes_control: bool = False  # another one flies from then on, so that the landing is rightly handed over
    happened: float | None = None  # s of the flight; None: the landing ended before


class LightRecord(_Line):
    """Light of a scene: sun, sky and clouds."""

    azimuth_deg: float  # of the sun, clockwise from north
    elevation_deg: float  # of it above the horizon
    sun: float  # its strength, 1 is clear
    sky: float  # strength of the sky: 0.5 clear, 2 hazy
    clouds: float = 0.0  # share of the ground in their shadow


class Conditions(_Line):
    """Conditions of a landing: everything that is drawn from the seed."""

    landing: int = Field(ge=0)  # its number in the campaign
    seed: int  # of the campaign
    scene: str  # name, file, or package.module:factory
    world_seed: int
    flight_seed: int  # of noise, gusts and drift
    heading: float  # rad, clockwise from north
    wind: tuple[float, float]  # m/s east, north: where the air goes
    gusts: float  # m/s^2, standard deviation
    gps_sigma: tuple[float, float, float]  # of the drift: east, north, up
    gps_tau: float  # s, its correlation time
    light: LightRecord | None = None  # None: the world's own
    faults: tuple[FaultRecord, ...] = ()
    firmware: FirmwareName = "ardupilot"  # of the simulated autopilot

    @property
    def wind_speed(self) -> float:
        """Wind speed, m/s."""
        return math.hypot(*self.wind)


class TransitionLine(_Line):
    """One change of the executive's state."""

    t: float
    before: str
    event: str
    after: str
    reason: str
    p_safe: float | None = None


class TouchdownLine(_Line):
    """Contact of the vehicle with the true ground, by the oracle."""

    t: float
    east: float
    north: float
    safe: bool
    reasons: tuple[str, ...]
    tilt: float  # rad
    roughness: float
    sink: float  # m/s
    drift: float  # m/s

    @property
    def bad_ground(self) -> bool:
        """True if a reason lies in the ground, and not in the speed alone."""
        return any(r in GROUND for r in self.reasons)


class StrikeLine(_Line):
    """Obstacle beside the vehicle that was struck in flight, by the oracle."""

    t: float
    east: float  # of the vehicle
    north: float
    above: float  # metres above its feet


class LandingRecord(_Line):
    """Outcome and course of one landing, with its conditions."""

    conditions: Conditions
    outcome: Outcome
    why: str
    state: str | None = None  # of the executive, at the end
    p_found: float | None = None  # P(safe) of the last place when it was found
    p_at_commit: float | None = None
    looks: tuple[LookRecord, ...] = ()
    transitions: tuple[TransitionLine, ...] = ()
    touchdown: TouchdownLine | None = None  # the worst contact from above
    strike: StrikeLine | None = None
    safe_share: float | None = None  # of the searched area, by the oracle with the margin; only of a refusal
    seconds: float = 0.0  # of the flight
    found_after: float | None = None  # s to the first place
    distance: float = 0.0  # metres flown
    nearest: float | None = None  # metres of the feet above all within the footprint, before the landing was begun
    verdicts: int = 0
    picture: str | None = Field(None, pattern=r"^[\w-]+\.webp$")  # file beside landings.jsonl
    error: str | None = None
    cpu_s: float = 0.0  # CPU time: another run does not repeat it
    cpu_of: dict[
        str, float
    ] = {}  # s of it: simulator, navigation, mapping, judging; the rest makes the world and judges

    @property
    def number(self) -> int:
        """Number of the landing in the campaign."""
        return self.conditions.landing

    @property
    def commit_t(self) -> float | None:
        """Time of the last commit, s of the flight; None: none was begun."""
        return next((x.t for x in reversed(self.transitions) if x.after == "commit"), None)

    @property
    def bad_place(self) -> bool:
        """True if the place was unsafe, and not the flying: its ground, or a strike after the landing was begun."""
        begun = self.commit_t
        struck = self.strike is not None and begun is not None and self.strike.t >= begun
        return struck or (self.touchdown is not None and self.touchdown.bad_ground)

    @property
    def is_right(self) -> bool:
        """True if it ended as it should: landed safely, rightly refused, or handed over to the one who took control."""
        taken = any(f.takes_control and f.happened is not None for f in self.conditions.faults)
        return self.outcome in PLACES or (self.outcome == "handed over" and taken)

    @property
    def was_lost(self) -> bool:
        """True if its process died, so that nothing is known of the landing."""
        return self.error is not None and self.error.startswith(LOST)

    def repeatable(self) -> dict[str, Any]:
        """Every field that a repeated landing reproduces."""
        return self.model_dump(mode="json", exclude={"cpu_s", "cpu_of"})


class CampaignHead(_Line):
    """Head of a campaign: the same seed, scenes and settings give the same landings."""

    model_config = ConfigDict(extra="ignore")  # campaign.json holds the results, too

    alight: str
    seed: int = Field(ge=0)
    scenes: tuple[str, ...] = Field(min_length=1)
    landings: int = Field(ge=1, le=MOST_LANDINGS)  # to be flown; with more of them it is still the same campaign
    settings: dict[str, Any]
    link_faults: float = Field(0.0, ge=0, le=1)  # share of the landings with a fault of the link or the autopilot
    firmware: FirmwareName = "ardupilot"  # of the simulated autopilot
    sources: str = ""  # digest of the program; empty: not known
    files: dict[str, str] = {}  # digests of scene files, their rasters, modules of worlds, the model of appearance

    def differing(self, other: CampaignHead) -> str | None:
        """The first difference from another campaign, in words; None: it is the same."""
        changed = [name for name in self.files if other.files.get(name, self.files[name]) != self.files[name]]
        link = f"a {self.firmware} autopilot and a share of {self.link_faults:g} of link faults"
        differences = {
            f"seed {self.seed}": self.seed != other.seed,
            f"the scenes {' '.join(self.scenes)}": self.scenes != other.scenes,
            link: (self.link_faults, self.firmware) != (other.link_faults, other.firmware),
            f"version {self.alight} of Alight": self.alight != other.alight,
            "other settings": self.settings != other.settings,
            "another state of Alight's sources": bool(self.sources and other.sources) and self.sources != other.sources,
            f"another content of {', '.join(changed)}": bool(changed),
        }
        return next((words for words, differs in differences.items() if differs), None)
