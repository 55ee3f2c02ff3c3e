"""The results of a campaign as counts and statistics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import betaincinv

from alight.records.campaign import OUTCOMES, LandingRecord, Touched
from alight.records.executive import LookRecord

CPU_LIMIT = 60.0  # s of CPU that a landing may take
Counts = dict[str, dict[str, int]]  # row -> outcome -> landings


@dataclass(frozen=True)
class PBin:
    """Touchdowns whose P(safe) at commit lies in one range."""

    low: float
    high: float
    safe: int
    unsafe: int  # unsafe ground, or obstacles beside it: P(safe) does not include speeds
    mean_p: float


@dataclass(frozen=True)
class LookChange:
    """Locations with the verdict `first` at their first look and `last` at their last: number and mean P(safe)."""

    first: str
    last: str
    places: int
    first_p: float  # mean P(safe) at the first look
    last_p: float  # mean P(safe) at the last look


@dataclass(frozen=True)
class Spread:
    """Median and 95th percentile of some values; None without any value."""

    median: float | None
    p95: float | None

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Return the median and the 95th percentile of the values."""
        v = np.array(list(values), np.float64)
        return cls(float(np.median(v)), float(np.percentile(v, 95))) if v.size else cls(None, None)


@dataclass(frozen=True)
class CampaignNumbers:
    """All counts and statistics of a campaign."""

    landings: int
    outcomes: dict[str, int]
    right: float | None  # share that landed safely, was rightly refused, or handed over to the person in control
    touchdowns: int
    unsafe_ground: int  # touchdowns that the ground made unsafe; the rest came down too fast, or struck something
    touched: dict[str, int]  # landings that touched a person or car, by whether they could have been stopped
    struck: int  # landings that struck an obstacle beside them in flight
    nearest: float | None  # metres, least height of the feet above everything in the footprint before the landing
    bound: float  # upper bound, with 95 % confidence, of the unsafe share of landings that did not fail
    touchdown_bound: float  # the same bound for landings that touched anything
    ground_bound: float  # the same bound for unsafe ground, of landings that did not fail
    by_scene: Counts
    by_fault: Counts
    by_wind: Counts
    by_sun: Counts
    p_at_commit: tuple[PBin, ...]
    looks: tuple[LookChange, ...]
    looks_each: float | None  # mean number of looks per landing
    seconds: Spread  # length of landings that touched down
    distance: Spread  # metres flown, of landings that touched down
    cpu_s: Spread  # s of CPU time per landing, of all landings that did not fail
    cpu_of: dict[str, Spread]  # s of CPU time per landing, by part: simulator, navigation, mapping, judging, link
    cpu_most: float | None  # s, most of one landing
    cpu_within: float | None  # share of landings that took no more than `CPU_LIMIT`


def unsafe_bound(unsafe: int, landings: int) -> float:
    """Return the upper 95 % confidence bound of `unsafe` / `landings` (Clopper and Pearson 1934); 0 of N: about 3/N."""
    if unsafe >= landings:
        return 1.0
    return float(betaincinv(unsafe + 1, landings - unsafe, 0.95))


def campaign_numbers(records: Sequence[LandingRecord]) -> CampaignNumbers:
    """Return the counts and statistics of the landings of a campaign."""
    outcomes: dict[str, int] = {name: sum(r.outcome == name for r in records) for name in OUTCOMES}
    down = [r for r in records if r.touchdown is not None or r.strike is not None]
    ground = sum(r.touchdown is not None and r.touchdown.bad_ground for r in down)
    n, unsafe = len(records), outcomes["landed unsafely"]
    known = n - outcomes["failed"]  # the end of the others is unknown
    cpu = [r.cpu_s for r in records if r.outcome != "failed"]
    return CampaignNumbers(
        landings=n, outcomes=outcomes, right=sum(r.is_right for r in records) / n if n else None,
        touchdowns=len(down), unsafe_ground=ground,
        touched={name: sum(r.touched == name for r in records) for name in Touched.__args__},  # type: ignore[attr-defined]
        struck=sum(r.strike is not None for r in down),
        nearest=min((r.nearest for r in records if r.nearest is not None), default=None),
        bound=unsafe_bound(unsafe, known), touchdown_bound=unsafe_bound(unsafe, len(down)),
        ground_bound=unsafe_bound(ground, known), by_scene=_counts(records, lambda r: r.conditions.scene),
        by_fault=_counts(records, fault_of),
        by_wind=_counts(records, _wind_range), by_sun=_counts(records, _sun_range),
        p_at_commit=tuple(_bins(down)), looks=tuple(_changes(records)),
        looks_each=float(np.mean([len(r.looks) for r in records])) if n else None,
        seconds=Spread.of(r.seconds for r in down), distance=Spread.of(r.distance for r in down),
        cpu_s=Spread.of(cpu), cpu_of=_parts(records), cpu_most=max(cpu, default=None),
        cpu_within=sum(c <= CPU_LIMIT for c in cpu) / len(cpu) if cpu else None,
    )  # fmt: skip


def _parts(records: Sequence[LandingRecord]) -> dict[str, Spread]:
    names = dict.fromkeys(name for r in records for name in r.cpu_of)
    return {name: Spread.of(r.cpu_of[name] for r in records if name in r.cpu_of) for name in names}


def _counts(records: Sequence[LandingRecord], key: Callable[[LandingRecord], str]) -> Counts:
    found: dict[str, Counter[str]] = {}
    for r in records:
        found.setdefault(key(r), Counter())[r.outcome] += 1
    return {row: {name: found[row][name] for name in OUTCOMES} for row in sorted(found)}


def fault_of(r: LandingRecord) -> str:
    """Return the name of the first fault of a landing that happened, or a text that none did."""
    return next(("planned, and never happened" if f.happened is None else f.what for f in r.conditions.faults), "none")


def _range(value: float, edges: Sequence[float], unit: str) -> str:
    at = min(int(np.searchsorted(edges, value, "right")), len(edges) - 1)
    return f"{edges[at - 1]:.0f} to {edges[at]:.0f} {unit}"


def _wind_range(r: LandingRecord) -> str:
    if fault_of(r) == "strong wind":
        return "more than 6 m/s"
    return _range(r.conditions.wind_speed, (0.0, 2.0, 4.0, 6.0), "m/s")


def _sun_range(r: LandingRecord) -> str:
    light = r.conditions.light
    if light is None:
        return "the scene's own"
    if light.sun < 0.5:  # its position has no effect
        return "overcast"
    return _range(light.elevation_deg, (0.0, 25.0, 40.0, 55.0, 90.0), "degrees")


def _bins(down: Sequence[LandingRecord]) -> Iterator[PBin]:
    pairs = [(r.p_at_commit, not r.bad_place) for r in down if r.p_at_commit is not None]
    for low, high in pairwise((0.0, 0.9, 0.95, 0.98, 0.99, 1.0)):
        here = [(p, safe) for p, safe in pairs if low <= p < high or (p == high == 1.0)]
        if here:
            good = sum(safe for _, safe in here)
            yield PBin(low, high, good, len(here) - good, float(np.mean([p for p, _ in here])))


def _changes(records: Sequence[LandingRecord]) -> Iterator[LookChange]:
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for looks in (part for r in records for part in looks_by_place(r)):
        found.setdefault((looks[0].verdict, looks[-1].verdict), []).append((looks[0].p_safe, looks[-1].p_safe))
    for (first, last), ps in sorted(found.items()):
        one, two = np.mean(ps, axis=0)
        yield LookChange(first, last, len(ps), float(one), float(two))


def looks_by_place(record: LandingRecord) -> list[list[LookRecord]]:
    """Return the looks of a landing, in one list per visited location."""
    begun = [x.t for x in record.transitions if x.after == "approach"]
    parts: dict[int, list[LookRecord]] = {}
    for look in record.looks:
        parts.setdefault(int(np.searchsorted(begun, look.t, "right")), []).append(look)
    return list(parts.values())
