"""The report of a run as one HTML page: the answer without scripts, and with them a map to explore."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from alight import __version__
from alight.documents import printable
from alight.records import PHOTO_COLUMNS, ElevationMap, RunResult
from alight.report import canvas, facts, figures, maps, paint, survey, words
from alight.report.canvas import Canvas
from alight.report.facts import warnings
from alight.report.fields import trees
from alight.report.layers import layers_of
from alight.report.shapes import geodetic, shapes_of

if TYPE_CHECKING:
    import jinja2

__all__ = ["render", "templates", "warnings"]


@cache
def templates() -> jinja2.Environment:
    """Return the templates of the pages."""
    import jinja2  # here, as other modules use the colours of this package long before there is a report

    found = jinja2.Environment(
        loader=jinja2.PackageLoader("alight", "report"),
        autoescape=True,
        finalize=lambda value: value if isinstance(value, Markup) or not isinstance(value, str) else printable(value),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    found.filters["metres"] = words.metres
    return found


def _leaflet(name: str) -> Markup:
    """Return a file of Leaflet; its style sheet without comments and without links to its own pictures.

    Leaflet was chosen over OpenSeadragon, which shows pictures only, and MapLibre, which needs WebGL and a globe: it
    shows pictures and shapes in metres, is used with mouse, keys and fingers, and adds 150 kB to the page.
    """
    text = resources.files("alight.report").joinpath("vendor", "leaflet", name).read_text()
    return Markup(re.sub(r"/\*.*?\*/|url\([^)]*\)", "", text, flags=re.DOTALL) if name.endswith("css") else text)


def _map(result: RunResult, elevation: ElevationMap, window: Canvas) -> dict[str, Any]:
    """Return the data of the map, for explore.js."""
    layers = list(layers_of(result, elevation))
    return {
        "picture": vars(window.grid),
        "shade": window.uri(paint.paint_shade(elevation)),
        "fields": trees({layer.name: layer.field for layer in layers}),
        "layers": [{"name": layer.name, "colours": asdict(layer.colours)} for layer in layers if layer.colours],
        "shapes": [shape._asdict() for shape in shapes_of(result)],
        "geodetic": geodetic(result, window.grid),
        "origin": result.local.height if result.georeferenced else 0.0,
    }


def _pictures(result: RunResult) -> dict[str, Any]:
    """Return the pictures and the map of the page by their names in the template."""
    e = result.elevation
    window = canvas.whole(e, [(s.east, s.north) for s in result.sites.listed]) if e is not None else None
    if e is None or window is None:
        return {"overview": None, "map": None}
    hazards = None if result.sites.listed else result.hazards_as_mapped  # without a place, the reasons are the answer
    return {
        "overview": figures.overview(result, e, window),
        "beside": [] if hazards is None else [maps.reasons_figure(hazards, e, window)],
        "closeups": figures.closeups(result, e),
        "map": _map(result, e, window),
        "leaflet": {name: _leaflet(f"leaflet.{name}") for name in ("css", "js")} | {"licence": _leaflet("LICENSE")},
    }


def render(result: RunResult, files: Mapping[str, str] | None = None) -> str:
    """Return the report of a run as one HTML page that needs no network, and no script for the answer.

    `files`: names of the files beside the page, with the reasons of those that are not written, else empty.
    """
    return (
        templates()
        .get_template("page.html.j2")
        .render(
            **_pictures(result),
            version=__version__,
            result=result,
            answer=facts.answer(result),
            warnings=warnings(result),
            tables=facts.place_tables(result),
            diary=facts.diary_rows(result),
            film=maps.film(result),
            facts=facts.run_facts(result),
            details=facts.details(result),
            residuals=survey.gps_residuals(result),
            photos=[row.cells for row in result.photos],
            photo_columns=PHOTO_COLUMNS,
            times=facts.times(result.timings),
            files=facts.file_rows(result.not_written if files is None else files),
            settings=result.settings.to_yaml(),
        )
    )
