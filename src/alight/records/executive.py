"""Inputs, orders and diary of the executive. Places are in the map's frame, metres east, north, up."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from enum import StrEnum

from alight.arrays import F32, F64, U8
from alight.records.landing import HazardMap, Sites, p_safe_text
from alight.records.motion import MotionState
from alight.records.surface import ElevationMap


class FlightState(StrEnum):
    """State of a landing."""

    SEARCH = "search"
    APPROACH = "approach"
    LOOK = "look"
    DESCEND = "descend"
    COMMIT = "commit"
    LANDED = "landed"
    ABORT = "abort"
    HOLD = "hold"
    RETURN = "return"
    HANDED_OVER = "handed over"


class FlightEvent(StrEnum):
    """Event that takes a landing from one state to the next."""

    PILOT = "the pilot has taken over"
    LINK_LOST = "the autopilot is silent"
    NAVIGATION_LOST = "the motion is not known"
    CAMERA_LOST = "no pictures come"
    RECOVERED = "motion and pictures are there again"
    WAITED = "waited too long"
    WIND = "the wind is beyond the limit"
    BATTERY = "the battery is low"
    TIME = "the time is over"
    SEARCHED = "all was searched, and no place was found"
    FOUND = "a place was found"
    ARRIVED = "the way-point is reached"
    LOWER = "a look from lower down will tell more"
    CONFIRMED = "the place is a site from the lowest look"
    REFUSED = "the place is refused, or remains in doubt"
    NEW_FRAME = "the motion began anew, and the place is not known in the new frame"
    TOUCHED_DOWN = "the vehicle stands"
    UNFELT = "no touchdown is reported"
    CLEAR = "the climb is done"


@dataclass(frozen=True, eq=False)
class MapVerdict:
    """A verdict on a map, in the map's frame, as far as the executive decides by it."""

    number: int  # of the verdict, rising
    t: float  # s, of the newest exposure that the map holds
    frame_id: int
    sites: Sites
    hazards: HazardMap
    elevation: ElevationMap
    ground: float  # metres up, median of the map


@dataclass(frozen=True, eq=False)
class Situation:
    """Inputs of the executive at one moment."""

    t: float  # s
    position: F64 | None  # (3,) metres, of the vehicle; None: not known
    state: MotionState
    frame_id: int = 0  # of the position
    seen: MapVerdict | None = None  # the newest verdict
    picture_age: float = 0.0  # s, of the newest picture that is no repetition
    frozen: bool = False  # pictures come, each equal to the one before bit for bit
    height: float | None = None  # metres above the ground below; None: not known
    link: bool = True  # the autopilot reports
    pilot: bool = False  # somebody else flies
    standing: bool = False  # on the ground, motors off
    battery: float = 1.0  # share that is left; NaN: it was known, and is not reported any more
    wind: F64 | None = None  # (2,) or (3,) m/s, where the air goes; None: not known
    holds: bool = True  # the autopilot has a position of its own, and can hold it
    offset: F64 | None = None  # (3,) metres from the map's frame to the world

    @property
    def wind_speed(self) -> float:
        """Wind speed, m/s over the ground; 0 where it is not known."""
        return 0.0 if self.wind is None else math.hypot(float(self.wind[0]), float(self.wind[1]))


@dataclass(frozen=True, eq=False)
class Need:
    """Verdicts that the executive needs now."""

    seconds: float  # from one verdict to the next, counted between the newest exposures of their maps
    about: F64 | None = None  # (2,) metres in the map's frame, a place that the map must show as well; None: none


@dataclass(frozen=True, eq=False)
class Order:
    """Present order to the vehicle."""

    what: str  # fly | hold | land | return | nothing
    position: F64 | None = None  # (3,) metres, to fly to or to land on; None, to land: straight down where it is
    speed: float = 5.0  # m/s
    sink: float = 1.0  # m/s, downwards at most
    down: bool = True  # to land; False: to be over the place first
    height: float | None = None  # metres up, kept meanwhile; None: the present one


@dataclass(frozen=True)
class Transition:
    """One change of state, with its reason."""

    t: float  # s
    before: FlightState
    event: FlightEvent
    after: FlightState
    reason: str
    place: tuple[float, float, float] | None = None  # the place that it is about
    p_safe: float | None = None  # of it, as seen last

    @property
    def line(self) -> str:
        """The transition as one line of text."""
        reason = "" if self.reason == self.event.value else f" ({self.reason})"
        return f"{self.t:7.1f} s  {self.before.value} -> {self.after.value}: {self.event.value}{reason}"

    def as_tree(self) -> dict[str, object]:
        """The transition as a tree of JSON."""
        return {"kind": "transition", **asdict(self)}


@dataclass(frozen=True)
class LookRecord:
    """One look at a place: height, verdict and P(safe)."""

    t: float  # s
    place: tuple[float, float, float]
    height: float  # metres above it
    verdict: str  # site | candidate | refused | not seen
    p_safe: float
    doubt: str = ""

    @property
    def line(self) -> str:
        """The look as one line of text."""
        doubt = f", {self.doubt}" if self.doubt else ""
        p = p_safe_text(self.p_safe)
        return f"{self.t:7.1f} s  look from {self.height:.1f} m: {self.verdict}, P(safe) {p}{doubt}"

    def as_tree(self) -> dict[str, object]:
        """The look as a tree of JSON."""
        return {"kind": "look", **asdict(self)}


@dataclass(frozen=True, eq=False)
class LookPicture:
    """Picture and P(safe) of the ground about the place of one look, north up."""

    look: LookRecord
    photo: U8  # (S, S, 3) RGB; black where nothing was seen
    p_safe: F32  # (S, S); NaN where it cannot be judged
    reach: float  # metres from the place to the edge


@dataclass
class FlightDiary:
    """Diary of a landing: transitions and looks, in order."""

    transitions: list[Transition] = field(default_factory=list)
    looks: list[LookRecord] = field(default_factory=list)
    pictures: list[LookPicture] = field(default_factory=list)  # of the looks, where they were kept

    @property
    def end(self) -> tuple[FlightState, str] | None:
        """The last state and its reason in words; None: nothing has happened. A landing after RETURN is a RETURN."""
        if not self.transitions:
            return None
        last = self.transitions[-1]
        if last.before is not FlightState.RETURN or last.after is not FlightState.LANDED:
            return last.after, last.reason
        why = next((t.reason for t in reversed(self.transitions) if t.after is FlightState.RETURN), "")
        return FlightState.RETURN, f"{why}; landed where the autopilot returns to"

    @property
    def entries(self) -> list[Transition | LookRecord]:
        """Looks and transitions in order of time; at the same time, looks come first."""
        return sorted([*self.looks, *self.transitions], key=lambda e: e.t)
