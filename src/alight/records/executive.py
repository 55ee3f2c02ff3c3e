"""Inputs, orders and diary of the executive. Positions are east, north, up in the map frame, metres."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from enum import StrEnum

from alight.arrays import F32, F64, U8
from alight.records.landing import HazardMap, Sites, p_safe_text
from alight.records.motion import MotionState, MovingBody
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
    """Event that changes the state of a landing."""

    PILOT = "the pilot has taken over"
    FAILSAFE = "a failsafe of the autopilot has taken over"
    LINK_LOST = "the autopilot is silent"
    NAVIGATION_LOST = "the motion is not known"
    CAMERA_LOST = "no pictures come"
    GPS_LOST = "GPS is lost, and a place that was judged is near"
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
    """Verdict on a map, in the map frame: the parts that the executive uses."""

    number: int  # increases with every verdict
    t: float  # s, time of the map's newest exposure
    frame_id: int
    sites: Sites
    hazards: HazardMap
    elevation: ElevationMap
    ground: float  # metres up, median height of the map


@dataclass(frozen=True)
class SightQuality:
    """How well the motion is known in flight by sight, without GPS."""

    sigma: float  # metres, horizontal 1-sigma of the position in the map
    speed_sigma: float  # m/s, of the velocity: the position's grows by it at most
    sees: bool  # whether the pictures show the motion

    def sigma_after(self, seconds: float) -> float:
        """Return the 1-sigma of the position some seconds later, metres."""
        return math.hypot(self.sigma, self.speed_sigma * seconds)


@dataclass(frozen=True, eq=False)
class Situation:
    """Inputs of the executive at one time."""

    t: float  # s
    position: F64 | None  # (3,) metres, position of the vehicle; None: unknown
    state: MotionState
    frame_id: int = 0  # map number of the position
    seen: MapVerdict | None = None  # the newest verdict
    picture_age: float = 0.0  # s, age of the newest picture that is not a repetition
    frozen: bool = False  # whether new pictures are bit-identical repetitions
    height: float | None = None  # metres, height above ground; None: unknown
    link: bool = True  # whether the autopilot sends reports
    failsafe: str = ""  # failsafe of the autopilot that flies instead of a pilot, in words; empty: none
    pilot: bool = False  # whether someone else flies
    contact: bool = False  # whether the autopilot has reported the ground for half a second, motors on or off
    standing: bool = False  # whether the vehicle is on the ground with motors off
    battery: float = 1.0  # remaining share; NaN: no longer reported
    wind: F64 | None = None  # (2,) or (3,) m/s, velocity of the air; None: unknown
    holds: bool = True  # whether the autopilot can hold its position: by its receiver, or by sight of the ground
    sight: SightQuality | None = None  # of a flight by sight; None: it flies by GPS
    lands: bool = False  # whether the autopilot is in its landing mode
    steers: bool = True  # whether that mode leads to the place, else straight down
    offset: F64 | None = None  # (2,) metres, from the map frame to the plane of the autopilot's fence; None: unknown
    movers: tuple[MovingBody, ...] = ()  # people and cars that move in the newest picture

    @property
    def wind_speed(self) -> float:
        """Wind speed, m/s over the ground; 0 if the wind is unknown."""
        return 0.0 if self.wind is None else math.hypot(float(self.wind[0]), float(self.wind[1]))


@dataclass(frozen=True, eq=False)
class Need:
    """Verdicts that the executive needs now."""

    seconds: float  # s between verdicts, measured between the newest exposures of their maps
    about: F64 | None = None  # (2,) metres in the map frame, a position that the map must also show; None: no position


@dataclass(frozen=True, eq=False)
class Order:
    """Present order to the vehicle."""

    what: str  # fly, hold, land, return or nothing
    position: F64 | None = None  # (3,) metres, target of fly or land; None for land: straight down
    speed: float = 5.0  # m/s
    sink: float = 1.0  # m/s, largest speed downwards
    down: bool = True  # for land: whether to descend; False: fly to above the position first
    height: float | None = None  # metres up, height to keep until then; None: the present height


@dataclass(frozen=True)
class Transition:
    """One change of state, with its reason."""

    t: float  # s
    before: FlightState
    event: FlightEvent
    after: FlightState
    reason: str
    place: tuple[float, float, float] | None = None  # metres, east, north, up of the site or candidate concerned
    p_safe: float | None = None  # newest P(safe) of that site or candidate

    @property
    def line(self) -> str:
        """The transition as one line of text."""
        reason = "" if self.reason == self.event.value else f" ({self.reason})"
        return f"{self.t:7.1f} s  {self.before.value} -> {self.after.value}: {self.event.value}{reason}"

    def as_tree(self) -> dict[str, object]:
        """Return the transition as a JSON tree."""
        return {"kind": "transition", **asdict(self)}


@dataclass(frozen=True)
class LookRecord:
    """One look at a site or candidate: height, verdict and P(safe)."""

    t: float  # s
    place: tuple[float, float, float]  # metres, east, north, up of the site or candidate
    height: float  # metres above the site or candidate
    verdict: str  # site, candidate, refused or not seen
    p_safe: float  # P(safe) of the site or candidate after the look
    doubt: str = ""  # reason why it is not a site; empty: it is a site

    @property
    def line(self) -> str:
        """The look as one line of text."""
        doubt = f", {self.doubt}" if self.doubt else ""
        p = p_safe_text(self.p_safe)
        return f"{self.t:7.1f} s  look from {self.height:.1f} m: {self.verdict}, P(safe) {p}{doubt}"

    def as_tree(self) -> dict[str, object]:
        """Return the look as a JSON tree."""
        return {"kind": "look", **asdict(self)}


@dataclass(frozen=True, eq=False)
class LookPicture:
    """Picture and P(safe) of the ground around the target of one look, north up."""

    look: LookRecord
    photo: U8  # (S, S, 3) RGB; black where nothing was seen
    p_safe: F32  # (S, S); NaN where it cannot be judged
    reach: float  # metres from the centre to the edge


@dataclass
class FlightDiary:
    """Diary of a landing: transitions and looks, in order."""

    transitions: list[Transition] = field(default_factory=list)
    looks: list[LookRecord] = field(default_factory=list)
    pictures: list[LookPicture] = field(default_factory=list)  # pictures of the looks, if they were kept

    @property
    def end(self) -> tuple[FlightState, str] | None:
        """Last state and its reason in words; None without transitions. Landing after RETURN is reported as RETURN."""
        if not self.transitions:
            return None
        last = self.transitions[-1]
        if last.before is not FlightState.RETURN or last.after is not FlightState.LANDED:
            return last.after, last.reason
        why = next((t.reason for t in reversed(self.transitions) if t.after is FlightState.RETURN), "")
        return FlightState.RETURN, f"{why}; landed where the autopilot returns to"

    @property
    def entries(self) -> list[Transition | LookRecord]:
        """Looks and transitions in order of time; at equal times, looks come first."""
        return sorted([*self.looks, *self.transitions], key=lambda e: e.t)
