"""Made-up ground with places, and a vehicle that obeys the executive's orders over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from some_run import elevation as some_elevation
from some_run import site as some_site

from alight.flight.executive.executive import Executive
from alight.geometry import Grid
from alight.records import ElevationMap, Flag, Hazard, HazardMap, MotionState, NextView, Sites
from alight.records.executive import FlightEvent, FlightState, MapVerdict, Order, Situation
from alight.settings import load_settings

S = FlightState
STEP = 0.2  # s
AWAY = np.array([0.0, 0.0, 30.0])  # where flights begin
GRID = Grid(-48.0, 48.0, 1.0, 97, 97)


def settings(*more: str):  # type: ignore[no-untyped-def]
    return load_settings("", ["executive.search_side=60", *more]).stages()


@cache
def blank_map() -> ElevationMap:
    """A map of level ground at height 0."""
    m = some_elevation()
    blank = {
        name: np.zeros((*GRID.shape, *v.shape[2:]), v.dtype)
        for name, v in vars(m).items()
        if isinstance(v, np.ndarray) and v.ndim >= 2 and v.shape[:2] == m.grid.shape
    }
    return replace(m, grid=GRID, **blank | {"sigma": np.full(GRID.shape, 0.02, np.float32)})


@dataclass
class Ground:
    """Made-up ground with places; P(safe) of each depends on the height of the look, 0 is refused."""

    places: dict[tuple[float, float], Callable[[float], float]]
    frame_id: int = 0
    sees: float = 20.0  # m about the vehicle
    tall: float = 0.0  # m, of a wall across east = 15
    unlisted: tuple[float, float] = (0.0, 0.0)  # heights between which places are not listed
    gap: bool = False  # of the map, about east = 0
    posts: tuple[tuple[float, float, float], ...] = ()  # east, north, height, metres; a cell each
    posts_show: float = 99.0  # m, the height below which the map shows them
    room: float = 9.0  # m to the nearest refused touchdown

    def map(self, height: float = 0.0) -> ElevationMap:
        blank = blank_map()
        flat, flags = blank.height.copy(), blank.flags.copy()
        east, _ = GRID.xy()
        flat[:, np.abs(east - 15.0) < 1.0] = self.tall
        for e, n, up in self.posts if height < self.posts_show else ():
            row, col = (round(float(v)) for v in GRID.index(np.array(e), np.array(n)))
            flat[row, col] = up
        flags[:, np.abs(east) < 2.0] = int(Flag.UNSEEN) if self.gap else 0
        return replace(blank, height=flat, flags=flags)

    def seen(self, number: int, t: float, at: np.ndarray) -> MapVerdict:
        p_map = np.full(GRID.shape, np.nan, np.float32)
        reasons = np.full(GRID.shape, int(Hazard.UNKNOWN), np.uint16)
        listed = []
        for (e, n), p_of in self.places.items():
            if np.hypot(e - at[0], n - at[1]) > self.sees:
                continue
            p, (row, col) = p_of(float(at[2])), (round(v) for v in GRID.index(np.array(e), np.array(n)))
            off_list = self.unlisted[0] < at[2] < self.unlisted[1]
            doubtful = p < 0.95
            p_map[row, col], reasons[row, col] = p, doubtful * Hazard.DOUBT if p > 0 else Hazard.ROUGHNESS
            if p > 0 and not off_list:
                look = NextView(e, n, 8.0, 8.0, True)
                doubt = "relief" if doubtful else None
                listed.append(replace(some_site(), east=e, north=n, up=0.0, p_safe=p, look=look, doubt=doubt))
        listed.sort(key=lambda s: -s.p_safe)
        sites = tuple(s for s in listed if s.kind == "site")
        found = Sites(sites, "", self.frame_id, tuple(s for s in listed if s.kind == "candidate"))
        blank = np.zeros(GRID.shape, np.float32)
        room = np.full(GRID.shape, self.room, np.float32)
        danger = HazardMap(GRID, blank, blank, blank, room, p_map, p_map, p_map, p_map, blank, blank, blank, reasons)
        return MapVerdict(number, t, self.frame_id, found, danger, self.map(float(at[2])), 0.0)


@dataclass
class Flight:
    """A vehicle that obeys its orders over made-up ground; `change` may change the situation."""

    ground: Ground
    executive: Executive
    change: Callable[[Situation, Executive], Situation] = lambda now, executive: now
    position: np.ndarray = field(default_factory=lambda: AWAY.copy())
    t: float = 0.0
    orders: list[tuple[FlightState, Order, np.ndarray]] = field(default_factory=list)

    def fly(self, seconds: float = 400.0, verdict_every: float = 1.0) -> FlightState:
        number, last, seen = 0, -9.0, None
        while self.t < seconds and self.executive.state not in (S.LANDED, S.RETURN, S.HANDED_OVER):
            if self.t - last >= verdict_every:
                number, last = number + 1, self.t
                seen = self.ground.seen(number, self.t, self.position)
            now = Situation(
                self.t, self.position.copy(), MotionState.GOOD, self.ground.frame_id, seen,
                standing=bool(self.position[2] <= 0.0),
            )  # fmt: skip
            order = self.executive.tick(self.change(now, self.executive))
            self.orders.append((self.executive.state, order, self.position.copy()))
            self.obey(order)
            self.t += STEP
        return self.executive.state

    def obey(self, order: Order) -> None:
        if order.what == "land" and order.position is None:
            self.position[2] -= order.sink * STEP
        if order.position is None or order.what not in ("fly", "land"):
            return
        left = order.position - self.position
        if order.what == "land":
            kept = 0.0 if order.height is None else order.height - self.position[2]
            left[2] = -self.position[2] - 0.1 if order.down else kept
        flat = np.linalg.norm(left[:2])
        self.position[:2] += left[:2] * min(1.0, order.speed * STEP / max(flat, 1e-9))
        self.position[2] += np.clip(left[2], -order.sink * STEP, 3.0 * STEP)

    @property
    def states(self) -> list[FlightState]:
        return [S.SEARCH, *(x.after for x in self.executive.diary.transitions)]

    @property
    def events(self) -> list[FlightEvent]:
        return [x.event for x in self.executive.diary.transitions]


def clearer_from_below(height: float) -> float:
    """P(safe) of a good place: in doubt from high up, a site from near by."""
    return 0.97 if height < 9.0 else 0.8 if height < 17.0 else 0.6


def bad_from_below(height: float) -> float:
    """P(safe) of a place with stones that only a near look shows."""
    return 0.0 if height < 9.0 else 0.7
