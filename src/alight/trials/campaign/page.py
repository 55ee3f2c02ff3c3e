"""The page of a campaign: the answer first, then outcomes, unsafe touchdowns, P(safe), looks, times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import yaml

from alight.records import p_safe_text
from alight.records.campaign import OUTCOMES, CampaignHead, LandingRecord
from alight.report import templates, words
from alight.trials.campaign.numbers import CPU_LIMIT, CampaignNumbers, Spread, fault_of

BAD = ("landed unsafely", "wrongly refused", "handed over", "failed")  # listed one by one


@dataclass(frozen=True)
class CampaignTable:
    """A table of the page: title, columns, rows and a note."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    filters: str = ""  # what the rows are ("world" or "fault"), if a count is a link to its landings


@dataclass(frozen=True)
class LandingRow:
    """One landing in the table of all: what it is filtered by, its cells, and what the looks saw."""

    number: int
    world: str
    fault: str
    outcome: str
    cells: Sequence[str]
    note: str
    film: str | None  # name of the file; None: it has none
    uri: str | None  # the film as data URI; None: it is only linked


def render_campaign(
    name: str,
    head: CampaignHead,
    records: Sequence[LandingRecord],
    numbers: CampaignNumbers,
    pictures: Mapping[str, str],
    other: tuple[str, CampaignNumbers] | None = None,
) -> str:
    """Return the page of a campaign as HTML, with its pictures embedded.

    Args:
        name: name of the campaign.
        head: seed, scenes and settings.
        records: all landings.
        numbers: statistics of the landings.
        pictures: data URIs of pictures and films, by file name.
        other: name and statistics of a campaign to compare with; None: no comparison.
    """
    return (
        templates()
        .get_template("campaign.html.j2")
        .render(
            name=name,
            head=head,
            version=head.alight,
            good=numbers.landings > 0 and numbers.outcomes["landed unsafely"] + numbers.outcomes["failed"] == 0,
            headline=_headline(numbers),
            detail=_detail(numbers),
            chips=[(outcome, str(count)) for outcome, count in numbers.outcomes.items()],
            unsafe=[_unsafe(r, pictures.get(r.picture or "")) for r in records if r.outcome == "landed unsafely"],
            landings=[_row(r, pictures) for r in records],
            outcomes=OUTCOMES,
            tables=[t for t in _tables(name, head, records, numbers, other) if t.rows],
            settings=yaml.safe_dump(head.settings, sort_keys=False),
        )
    )


def _headline(n: CampaignNumbers) -> str:
    if not n.landings:
        return "No landing has ended"
    unsafe = words.counted(n.outcomes["landed unsafely"], "unsafe touchdown")
    failed = f", {n.outcomes['failed']} failed" if n.outcomes["failed"] else ""
    return f"{words.counted(n.landings, 'landing').capitalize()}, {unsafe}{failed}"


def _detail(n: CampaignNumbers) -> str:
    if n.right is None:
        return ""
    return (
        f"{100 * n.right:.1f} % landed safely or were rightly refused. With 95 % confidence no more than "
        f"{100 * n.bound:.2g} % of such landings end unsafely, no more than {100 * n.touchdown_bound:.2g} % of the "
        f"{n.touchdowns} that touched down, and no more than {100 * n.ground_bound:.2g} % of all on unsafe ground "
        "(Clopper-Pearson, one-sided; landings that failed are left aside)."
    )


def _row(r: LandingRecord, pictures: Mapping[str, str]) -> LandingRow:
    c, p = r.conditions, r.p_at_commit
    cells = (
        str(r.number), c.scene, fault_of(r), r.outcome, f"{c.wind_speed:.1f} m/s", str(len(r.looks)),
        "" if p is None else p_safe_text(p), f"{r.seconds:.0f} s",
    )  # fmt: skip
    note = "; ".join(filter(None, (r.error or r.why, _faults(r))))
    return LandingRow(r.number, c.scene, fault_of(r), r.outcome, cells, note, r.film, pictures.get(r.film or ""))


def _unsafe(r: LandingRecord, uri: str | None) -> dict[str, str | None]:
    d, s = r.touchdown, r.strike
    struck = "" if s is None else f" Struck at {s.t:.1f} s, {s.east:.1f} m east, {s.north:.1f} m north."
    measured = "" if d is None else (
        f" Tilt {math.degrees(d.tilt):.1f}°, roughness {words.metres(d.roughness)}, sink {d.sink:.2f} m/s, "
        f"drift {d.drift:.2f} m/s, at {d.east:.1f} m east, {d.north:.1f} m north."
    )  # fmt: skip
    p = "" if r.p_at_commit is None else f" P(safe) at commit {p_safe_text(r.p_at_commit)}."
    text = f"{r.why}.{struck}{measured}{p} {_faults(r)}".strip()
    return {"title": f"Landing {r.number}, {r.conditions.scene}", "text": text, "uri": uri}


def _faults(r: LandingRecord) -> str:
    return ", ".join(
        f"{f.what} " + ("(never happened)" if f.happened is None else f"at {f.happened:.1f} s")
        for f in r.conditions.faults
    )


def _tables(
    name: str,
    head: CampaignHead,
    records: Sequence[LandingRecord],
    n: CampaignNumbers,
    other: tuple[str, CampaignNumbers] | None,
) -> Iterator[CampaignTable]:
    came = sum(f.what in ("car", "person") and f.happened is not None for r in records for f in r.conditions.faults)
    if other is not None:
        yield CampaignTable("Beside another campaign", ("", name, other[0]), comparison(n, other[1]))
    yield CampaignTable(
        "People and cars",
        ("", "landings"),
        [(f"touched: {name}", str(count)) for name, count in n.touched.items()] if came else [],
        f"{came} landings in which somebody came. It could have been stopped for somebody who was in view for a "
        "second while the vehicle was above 1 m.",
    )
    for title, first, counts in (
        ("world", "world", n.by_scene), ("fault", "fault", n.by_fault), ("wind", "wind", n.by_wind),
        ("the height of the sun", "sun", n.by_sun),
    ):  # fmt: skip
        rows = [(row, *(str(c[o] or "") for o in OUTCOMES), str(sum(c.values()))) for row, c in counts.items()]
        filters = first if first in ("world", "fault") else ""
        yield CampaignTable(f"Outcomes by {title}", (first, *OUTCOMES, "all"), rows, filters=filters)
    yield CampaignTable(
        "P(safe) at commit against what happened",
        ("P(safe)", "touchdowns", "ground safe", "ground unsafe", "mean P(safe)", "share safe"),
        [
            (f"{b.low:.2f} to {b.high:.2f}", str(b.safe + b.unsafe), str(b.safe), str(b.unsafe), f"{b.mean_p:.3f}",
             f"{b.safe / (b.safe + b.unsafe):.3f}")
            for b in n.p_at_commit
        ],
    )  # fmt: skip
    yield CampaignTable(
        "What the looks changed",
        ("first look", "last look", "places", "mean P(safe), first", "mean P(safe), last"),
        [(c.first, c.last, str(c.places), p_safe_text(c.first_p), p_safe_text(c.last_p)) for c in n.looks],
        "Every place that was looked at, by the verdicts of the first look and of the last.",
    )
    yield CampaignTable(
        "Time and way",
        ("", "median", "95th percentile"),
        [
            ("time of a landing, s", *_spread(n.seconds)),
            ("distance flown, m", *_spread(n.distance)),
            ("CPU time of a landing, s", *_spread(n.cpu_s)),
            *((f"of it {name}, s", *_spread(s)) for name, s in n.cpu_of.items()),
        ],
        "Time and distance are of the landings that touched down; CPU time is of all, with the simulator."
        + _cpu(n)
        + _near(n),
    )
    yield CampaignTable(
        "Landings to look into",
        ("landing", "world", "outcome", "why", "faults"),
        [
            (str(r.number), r.conditions.scene, r.outcome, r.error or r.why, _faults(r))
            for r in records
            if r.outcome in BAD
        ],
        f"Fly one again with --only N, over the same scenes and with seed {head.seed}.",
    )


def _cpu(n: CampaignNumbers) -> str:
    if n.cpu_most is None or n.cpu_within is None:
        return ""
    return f" {100 * n.cpu_within:.0f} % took no more than {CPU_LIMIT:.0f} s of it, the dearest {n.cpu_most:.0f} s."


def _near(n: CampaignNumbers) -> str:
    if n.nearest is None:
        return ""
    struck = words.counted(n.struck, "landing") if n.struck else "no landing"
    least = f"the least height of the feet above all within the footprint was {words.metres(n.nearest)}"
    return f" Before a landing was begun {least}; {struck} struck what stood beside the way."


def _spread(s: Spread) -> tuple[str, str]:
    return tuple("" if v is None else f"{v:.0f}" for v in (s.median, s.p95))  # type: ignore[return-value]


def comparison(one: CampaignNumbers, two: CampaignNumbers) -> list[tuple[str, str, str]]:
    """Return the rows of a table of two campaigns: name, value of the first, value of the second."""

    def facts(n: CampaignNumbers) -> dict[str, str]:
        return {
            "landings": str(n.landings),
            **{name: str(count) for name, count in n.outcomes.items()},
            "landed safely or rightly refused": "" if n.right is None else f"{100 * n.right:.1f} %",
            "touchdowns on unsafe ground": str(n.unsafe_ground),
            "struck in flight": str(n.struck),
            **{f"touched somebody: {name}": str(count) for name, count in n.touched.items()},
            "unsafe landings, 95 % bound": f"{100 * n.bound:.2g} %",
            "unsafe ground, 95 % bound": f"{100 * n.ground_bound:.2g} %",
            "looks a landing": "" if n.looks_each is None else f"{n.looks_each:.1f}",
            "time of a landing, median s": _spread(n.seconds)[0],
            "distance, median m": _spread(n.distance)[0],
            "CPU time, median s": _spread(n.cpu_s)[0],
            "CPU time, most s": "" if n.cpu_most is None else f"{n.cpu_most:.0f}",
        }

    a, b = facts(one), facts(two)
    return [(name, a[name], b[name]) for name in a]
