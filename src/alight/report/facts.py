"""Text and numbers of the report: the answer, the sites, the run, the times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from alight.records import Flag, Kind, PlaceSigma, RunResult, Site
from alight.report import survey, words


@dataclass(frozen=True)
class Answer:
    """The answer at the top of the page."""

    kind: Literal["site", "candidate", "none"]
    headline: str
    detail: str
    reason: str = ""  # why there is no site, if there are candidates
    link: str = ""
    chips: Sequence[tuple[str, str]] = ()  # label, value
    factors: str = ""  # factors of P(safe), as text
    cautions: Sequence[str] = ()


@dataclass(frozen=True)
class Row:
    """One site or candidate in a table: its cells, and a note below them."""

    cells: Sequence[str]
    note: str


@dataclass(frozen=True)
class PlaceTable:
    """Table of sites or of candidates."""

    title: str
    kind: Kind
    columns: Sequence[str]
    rows: Sequence[Row]
    hint: str  # what the order and the quality mean


def answer(result: RunResult) -> Answer:
    """Return the answer: the best site, else the candidates, else the reason why there are neither."""
    if result.sites.sites:
        return _land(result, result.sites.sites[0])
    if result.sites.candidates:
        return _look_closer(result, result.sites.candidates[0])
    return Answer("none", "No safe site", _reason(result))


def _reason(result: RunResult) -> str:
    reason = result.sites.reason.removeprefix("no safe site: ") or "no reason was given"
    return reason[:1].upper() + reason[1:].rstrip(".") + "."


def _land(result: RunResult, best: Site) -> Answer:
    flat, clear = words.metres(best.roughness), words.metres(best.clearance)
    detail = f"Flat to {flat}, {words.angle(best.slope)} slope, {clear} clear."
    more = len(result.sites.sites) - 1
    reserve = f" {words.counted(more, 'more site').capitalize()} in reserve." if more else ""
    if result.sites.candidates:
        reserve += f" {words.counted(len(result.sites.candidates), 'candidate').capitalize()} to look at again."
    kind: Literal["site", "candidate"] = "site" if result.sites.ground_judged else "candidate"
    headline = "Land here" if result.sites.ground_judged else "The shape fits, the ground was not judged"
    return Answer(
        kind, f"{headline}: {words.place(result, best)}", detail + reserve, link=words.geo_uri(result, best),
        chips=chips(result, best), factors=words.factors(best), cautions=cautions(result, best),
    )  # fmt: skip


def _look_closer(result: RunResult, first: Site) -> Answer:
    limit = f"{100 * result.settings.hazards.p_safe:g} %"
    found = words.counted(len(result.sites.candidates), "candidate")
    detail = (
        f"Do not land yet: no place reaches {limit}. Nothing refuses the first candidate, {words.place(result, first)}"
    )
    look = "; no nearer view would settle the doubt about it."
    if first.look is not None:
        settled = "" if first.look.settles else ", as near as is allowed"
        look = f": look at it from {first.look.height:.0f} m above the ground{settled}."
    return Answer(
        "candidate", f"Look closer: {found}", detail + look, _reason(result), words.geo_uri(result, first),
        chips(result, first), words.factors(first), cautions(result, first),
    )  # fmt: skip


NO_CLEARANCE = (
    "A program concluded this from pictures. It is not a clearance to land: look at the ground yourself first."
)


def _place_sigma(result: RunResult) -> PlaceSigma | None:
    if not result.georeferenced or result.elevation is None or result.elevation.place_covariance is None:
        return None
    return PlaceSigma.of(result.elevation.place_covariance)


def _place_text(result: RunResult) -> str:
    sigma = _place_sigma(result)
    return words.UNKNOWN if sigma is None else "± {} across, ± {} up".format(*map(words.metres, sigma))


def cautions(result: RunResult, site: Site) -> tuple[str, ...]:
    """Return the sentences to read before anyone flies to the site."""
    place = _place_sigma(result)
    avoided = (f"It lies in {site.avoid}: there is no other place.",) if site.avoid and site.kind == "site" else ()
    if place is None or 2.0 * place.horizontal <= site.clearance:
        return (*avoided, NO_CLEARANCE)
    beside = (
        f"Do not fly to the coordinates alone: they are known to ± {words.metres(place.horizontal)} (1-sigma), and the "
        f"nearest hazard is {words.metres(site.clearance)} away."
    )
    return *avoided, NO_CLEARANCE, beside


def chips(result: RunResult, site: Site) -> list[tuple[str, str]]:
    """Return facts about a site or candidate as (label, value): P(safe), doubt, shape and accuracy."""
    lander = result.settings.lander
    look = [("Doubt", words.doubt(site)), ("Look again from", words.look_from(site))] if site.doubt else []
    safe = "Chance of a safe touchdown" if result.sites.ground_judged else "Chance that the shape is safe"
    return [
        (safe, words.chance(site.p_safe)),
        *look,
        ("Slope", f"{words.angle(site.slope)} of {words.angle(lander.max_slope)}"),
        ("Largest bump", f"{words.metres(site.roughness)} of {words.metres(lander.max_roughness)}"),
        ("To the nearest hazard", words.metres(site.clearance)),
        ("Ground", words.ground(site.terrain.name)),
        ("Touch down heading", words.bearing(site.heading)),
        *([("Nearest zone", words.near(site.zone))] if site.zone else []),
        *([("Near by", words.near_by(site.near))] if site.near else []),
        ("Height within the map, 1-sigma", f"± {words.metres(site.height_sigma)}"),
        ("Place on Earth, 1-sigma" if result.georeferenced else "Place on Earth", _place_text(result)),
        ("Altitude, WGS84" if result.georeferenced else "Height above the origin", words.altitude(result, site)),
    ]


def warnings(result: RunResult) -> list[str]:
    """Return the warnings of the run and its route, each once."""
    return list(dict.fromkeys([*result.warnings, *(result.route.warnings if result.route else ())]))


COMMON_COLUMNS = ("Slope", "Largest bump", "Clear", "Ground", "Altitude", "Height ±", "Quality", "Place")
SITE_COLUMNS = ("Site", "Safe", *COMMON_COLUMNS, "Safe disc", "Heading")
CANDIDATE_COLUMNS = ("Candidate", "Safe", *COMMON_COLUMNS, "Doubt", "Look from")


def _row(result: RunResult, s: Site) -> Row:
    numbers = (
        str(s.rank),
        words.chance(s.p_safe),
        words.angle(s.slope),
        words.metres(s.roughness),
        words.metres(s.clearance),
        words.ground(s.terrain.name),
        words.altitude(result, s),
        words.metres(s.height_sigma),
        f"{s.quality:.2f}",
        words.place(result, s),
    )
    zone = f". Nearest zone: {words.near(s.zone)}" if s.zone else ""
    zone += f". Near by: {words.near_by(s.near)}" if s.near else ""
    if s.kind == "site":
        note = f"{words.factors(s)}; {_score(result, s)}{zone}"
        return Row((*numbers, words.metres(s.radius), words.bearing(s.heading)), note)
    look = ""
    if s.look is not None:
        enough = "" if s.look.settles else "; its pixels are still too coarse to settle the doubt"
        aside = math.hypot(s.look.east - s.east, s.look.north - s.north) > 0.05  # m
        look = f". View: {words.place(result, s.look) if aside else 'straight above'}{enough}"
    return Row((*numbers, words.doubt(s), words.look_from(s)), words.factors(s) + look + zone)


def _score(result: RunResult, s: Site) -> str:
    """Return the score by which sites are ranked, with its parts (G11)."""
    weights = result.settings.tuning.sites
    room = min(s.clearance / weights.roomy, 1.0)
    doubt = weights.doubt_weight * (1 - s.p_safe)
    if not math.isfinite(s.quality + room - doubt):
        return "score unknown"
    return f"score {s.quality + room - doubt:.2f}: quality {s.quality:.2f}, room {room:+.2f}, doubt {-doubt:.2f}"


def _quality(result: RunResult) -> str:
    return (
        "Quality is 0 for level, even, well-measured ground of one brightness, and more negative for less: a slope at "
        f"the lander's limit costs {result.settings.hazards.alpha:g}, a bump at its limit as much again."
    )


def _site_order(result: RunResult) -> str:
    weights = result.settings.tuning.sites
    away = " less the distance from the vehicle," if result.settings.sites.distance_weight else ""
    return (
        f"Sites are in order of score: quality,{away} plus up to 1 for room (at "
        f"{weights.roomy:g} m clear), less {weights.doubt_weight / 100:g} for each percent that the chance lacks. So a "
        "better place can stand before a slightly surer one."
    )


def place_tables(result: RunResult) -> list[PlaceTable]:
    """Return the tables of sites and candidates, in order of rank; empty tables are omitted."""
    step = result.settings.tuning.sites.chance_step
    sites, candidates = ([_row(result, s) for s in part] for part in (result.sites.sites, result.sites.candidates))
    found = (
        PlaceTable("The sites, best first", "site", SITE_COLUMNS, sites, f"{_site_order(result)} {_quality(result)}"),
        PlaceTable(
            "Candidates: to look at before a landing",
            "candidate",
            CANDIDATE_COLUMNS,
            candidates,
            f"Candidates are in order of the chance around them, in steps of {words.percent(step)}, and within a step "
            f"of quality. {_quality(result)}",
        ),
    )
    return [t for t in found if t.rows]


FILES: Mapping[str, str] = {
    "dem.tif": "heights and their 1-sigma", "flags.tif": "why a height is missing or doubtful",
    "ortho.tif": "the picture from above", "terrain.tif": "land cover", "safe.tif": "P(safe) and its factors",
    "reasons.tif": "why a touchdown is refused or doubtful", "hazards.tif": "slope, bumps, steps, clearance, quality",
    "heights.tif": "heights made finer by the image", "sites.geojson": "sites and candidates",
    "route.plan": "the route to site 1, for QGroundControl", "route.geojson": "the route with times and speeds",
    "wires.geojson": "wires over the ground", "trajectory.tum": "estimated poses, for evo",
    "trajectory.csv": "poses, velocities and their 1-sigma", "run.json": "everything in this report, for programs",
}  # fmt: skip


def file_rows(files: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return a row per file: its name, its name if it is a link, and what it holds or why it was not written."""
    return [(n, "" if why else n, f"not written: {why}" if why else FILES.get(n, "")) for n, why in files.items()]


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
    if e.position_covariance is not None and result.georeferenced:
        facts.append(("place of the whole map on Earth, 1-sigma", _place_text(result)))
    if e.datum is not None:
        facts.append(("tilt 1-sigma of the whole map", f"{1e3 * e.datum.tilt_sigma:.1f} mrad"))
    if (share := survey.overlap(survey.footprints(result))) is not None:
        facts.append(("overlap of a picture with the next, median", words.percent(share)))
    if seen.any():
        facts.append(("pictures that see a place, median", f"{np.median(e.views[seen]):.0f}"))
    return facts


def diary_rows(result: RunResult) -> list[tuple[str, str, str]]:
    """Return the diary of a flown landing as rows (time, event, reason); empty without a landing."""
    if result.diary is None:
        return []
    rows = []
    for e in result.diary.entries:
        time, _, words = e.line.strip().partition(" s  ")
        what, _, why = words.partition(": ")
        rows.append((f"{time} s", what.replace("->", "\N{RIGHTWARDS ARROW}"), why))
    return rows


def run_facts(result: RunResult) -> list[tuple[str, str]]:
    """Return facts about the input and the map as (name, value)."""
    facts = [("input", f"{result.source_name} ({result.source_kind})")]
    facts += [(name, f"{n:,}") for name, n in result.counts.items()]
    if result.height_above_ground is not None:
        facts.append(("height above ground", f"{result.height_above_ground:.1f} m"))
    lander = result.settings.lander
    facts += _map_facts(result)
    facts.append(("lander", f"{words.metres(lander.radius)} footprint radius"))
    return facts + [(words.name(k), v) for k, v in result.notes.items() if isinstance(v, str)]


def details(result: RunResult) -> list[tuple[str, str]]:
    """Return the notes that are not text, such as numbers, as (name, value) for the details of the page."""
    return [(words.name(k), words.value(v)) for k, v in result.notes.items() if not isinstance(v, str)]


def times(timings: Mapping[str, Sequence[float]]) -> list[tuple[str, int, str, str, str, float]]:
    """Return one row per stage: name, steps, median, 95th percentile, total, and share of the whole time in percent."""
    everything = sum(sum(steps) for steps in timings.values()) or 1.0
    found = []
    for stage, steps in timings.items():
        if len(steps):
            values = (float(np.median(steps)), float(np.percentile(steps, 95)), float(sum(steps)))
            median, p95, total = map(words.seconds, values)
            found.append((stage, len(steps), median, p95, total, round(100 * sum(steps) / everything, 1)))
    return found
