"""The words and numbers of the page: the answer, the sites, the run, the times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from alight.records import Flag, RunResult, Site
from alight.report import words


@dataclass(frozen=True)
class Answer:
    """The first thing on the page."""

    found: bool
    headline: str
    detail: str
    link: str = ""
    chips: Sequence[tuple[str, str]] = ()  # label, value


@dataclass(frozen=True)
class Time:
    """One stage's time."""

    stage: str
    steps: int
    median: str
    p95: str
    total: str
    share: float  # of all, percent


def answer(result: RunResult) -> Answer:
    """The answer in one sentence: the site, or why there is none."""
    if not result.sites.sites:
        reason = result.sites.reason or "no reason was given"
        return Answer(False, "No safe site", reason[:1].upper() + reason[1:].rstrip(".") + ".")
    best = min(result.sites.sites, key=lambda s: s.rank)
    flat, clear = words.metres(best.roughness), words.metres(best.clearance)
    detail = f"Flat to {flat}, {words.angle(best.slope)} slope, {clear} clear."
    more = len(result.sites.sites) - 1
    reserve = f" {more} more site{'s' * (more > 1)} in reserve." if more else ""
    return Answer(
        True,
        f"Land here: {words.place(result, best)}",
        detail + reserve,
        words.geo_uri(result, best),
        chips(result, best),
    )


def chips(result: RunResult, site: Site) -> list[tuple[str, str]]:
    """The best site's numbers with the limits they are held against."""
    lander = result.settings.lander
    return [
        ("Chance of a safe touchdown", words.chance(site.p_safe)),
        ("Slope", f"{words.angle(site.slope)} of {words.angle(lander.max_slope)}"),
        ("Largest bump", f"{words.metres(site.roughness)} of {words.metres(lander.max_roughness)}"),
        ("To the nearest hazard", words.metres(site.clearance)),
        ("Ground", words.ground(site.terrain.name)),
        ("Touch down heading", words.bearing(site.heading)),
    ]


def warnings(result: RunResult) -> list[str]:
    """Warnings of the run, each once."""
    return list(dict.fromkeys([*result.warnings, *(result.route.warnings if result.route else ())]))


SITE_COLUMNS = (
    "Site",
    "Safe",
    "Slope",
    "Largest bump",
    "Clear",
    "Safe disc",
    "Ground",
    "Heading",
    "Height ±",
    "Quality",
    "Place",
)


def site_rows(result: RunResult) -> list[tuple[str, ...]]:
    """The table of sites, as text, in order of rank."""
    return [
        (
            str(s.rank),
            words.chance(s.p_safe),
            words.angle(s.slope),
            words.metres(s.roughness),
            words.metres(s.clearance),
            words.metres(s.radius),
            words.ground(s.terrain.name),
            words.bearing(s.heading),
            words.metres(s.height_sigma),
            f"{s.quality:.2f}",
            words.place(result, s),
        )
        for s in sorted(result.sites.sites, key=lambda s: s.rank)
    ]


def _map_facts(result: RunResult) -> list[tuple[str, str]]:
    e = result.elevation
    if e is None:
        return []
    seen = (e.flags & np.uint16(Flag.UNSEEN)) == 0
    accepted = float((e.trusted & seen).sum()) / max(int(seen.sum()), 1)
    facts = [("cell size", words.metres(e.grid.cell)), ("ground seen", f"{seen.sum() * e.grid.cell**2:,.0f} m²")]
    facts.append(("of it with a trusted height", words.percent(accepted)))
    if e.trusted.any():
        sigma = float(np.median(e.relative_sigma[e.trusted]))
        facts.append(("height 1-sigma within the map, median", words.metres(sigma)))
    if e.gauge is not None:
        facts.append(("height 1-sigma of the whole map", words.metres(e.gauge.offset_sigma)))
        facts.append(("tilt 1-sigma of the whole map", f"{1e3 * e.gauge.tilt_sigma:.1f} mrad"))
    return facts


def run_facts(result: RunResult) -> list[tuple[str, str]]:
    """Facts about the input and its use."""
    facts = [("input", f"{result.source_name} ({result.source_kind})")]
    facts += [(name, f"{n:,}") for name, n in result.counts.items()]
    if result.height_above_ground is not None:
        facts.append(("height above ground", f"{result.height_above_ground:.1f} m"))
    lander = result.settings.lander
    facts += _map_facts(result)
    facts.append(("lander", f"{words.metres(lander.radius)} footprint radius"))
    return facts + [(words.name(k), v) for k, v in result.notes.items() if isinstance(v, str)]


def details(result: RunResult) -> list[tuple[str, str]]:
    """The notes that are numbers: for who wants to know."""
    return [(words.name(k), words.value(v)) for k, v in result.notes.items() if not isinstance(v, str)]


def times(timings: Mapping[str, Sequence[float]]) -> list[Time]:
    """Seconds a stage, in the order of the run."""
    everything = sum(sum(steps) for steps in timings.values()) or 1.0
    return [
        Time(
            stage,
            len(steps),
            words.seconds(float(np.median(steps))),
            words.seconds(float(np.percentile(steps, 95))),
            words.seconds(float(sum(steps))),
            round(100 * sum(steps) / everything, 1),
        )
        for stage, steps in timings.items()
        if len(steps)
    ]
