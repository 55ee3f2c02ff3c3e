"""The report of a run as one HTML page without scripts: answer, pictures, numbers, warnings."""

from __future__ import annotations

import jinja2

from alight import __version__
from alight.documents import printable
from alight.records import PHOTO_COLUMNS, RunResult
from alight.report import canvas, facts, figures, maps
from alight.report.facts import warnings
from alight.report.figures import Figure

__all__ = ["TEMPLATES", "render", "warnings"]

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("alight", "report"),
    autoescape=True,
    finalize=lambda value: printable(value) if isinstance(value, str) else value,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)


def _pictures(result: RunResult) -> tuple[Figure | None, list[Figure], list[Figure]]:
    elevation = result.elevation
    places = [(s.east, s.north) for s in result.sites.listed]
    window = canvas.whole(elevation, places) if elevation is not None else None
    if elevation is None or window is None:
        return None, [], []
    overview, closeups = figures.overview(result, elevation, window), figures.closeups(result, elevation)
    below = maps.all_maps(result, elevation, window)
    if not closeups and result.hazards is not None:  # without a listed place, the reasons are the answer
        return overview, below[:1], below[1:]
    return overview, closeups, below


def render(result: RunResult) -> str:
    """Return the report of a run as one HTML page with embedded pictures; it needs neither network nor script."""
    overview, beside, below = _pictures(result)
    return TEMPLATES.get_template("page.html.j2").render(
        version=__version__,
        result=result,
        answer=facts.answer(result),
        overview=overview,
        beside=beside,
        below=below,
        warnings=warnings(result),
        tables=facts.place_tables(result),
        diary=facts.diary_rows(result),
        film=maps.film(result),
        facts=facts.run_facts(result),
        details=facts.details(result),
        photos=[row.cells for row in result.photos],
        photo_columns=PHOTO_COLUMNS,
        times=facts.times(result.timings),
        missing=dict(result.not_written),
        settings=result.settings.to_yaml(),
    )
