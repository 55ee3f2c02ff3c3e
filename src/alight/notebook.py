"""A result in a notebook: a map with the listed places and their table as HTML, and the rasters as xarray."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from alight.records import MissingExtraError, RunResult
from alight.report import canvas, words
from alight.report.figures import photo

if TYPE_CHECKING:
    import xarray

COLUMNS = ("", "P(safe)", "slope", "largest bump", "clear", "ground", "place")
UNITS = {"height": "m", "sigma": "m", "resolved": "m", "slope": "rad", "roughness": "m", "step": "m", "clearance": "m"}


def result_html(result: RunResult) -> str:
    """Return the answer, the map with the listed places, and their table as a fragment of HTML without scripts."""
    found = result.sites
    answer = words.counted(len(found.sites), "site") if found.sites else found.reason or "no site"
    more = words.counted(len(found.candidates), "candidate") if found.candidates else ""
    head = ", ".join(escape(text) for text in (result.source_name, answer, more) if text)
    rows = [
        (
            f"{s.kind} {s.rank}", words.chance(s.p_safe), words.angle(s.slope), words.metres(s.roughness),
            words.metres(s.clearance), words.ground(s.terrain.name), words.place(result, s),
        )
        for s in found.listed
    ]  # fmt: skip
    table = "".join(_row("td", row) for row in rows)
    return f"<p>{head}</p>{_map(result)}" + (f"<table>{_row('th', COLUMNS)}{table}</table>" if rows else "")


def _row(tag: str, cells: tuple[str, ...]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _map(result: RunResult) -> str:
    """Return the orthophoto with a circle of the lander's size and a number at each listed place; empty: no map."""
    elevation, listed = result.elevation, result.sites.listed
    c = None if elevation is None else canvas.whole(elevation, [(s.east, s.north) for s in listed])
    if elevation is None or c is None:
        return ""
    marks = []
    for s in listed:
        x, y = c.xy(s.east, s.north)
        ring = f'<circle cx="{x}" cy="{y}" r="{result.settings.lander.radius * c.per_metre:.1f}"'
        dashes = ' stroke-dasharray="8 6"' if s.kind == "candidate" else ""
        marks.append(
            f'{ring} fill="none" stroke="#fff" stroke-width="4"{dashes}/><text x="{x}" y="{y}">{s.rank}</text>'
        )
    picture = photo(elevation, c, round(canvas.WIDTH))
    return (
        f'<svg viewBox="0 0 {canvas.WIDTH:g} {c.height:.1f}" style="max-width: 40em" role="img" '
        'font-size="30" font-family="sans-serif" text-anchor="middle" fill="#fff" stroke="#000" stroke-width="1">'
        f'<title>Map, north up</title><image href="{picture}" width="{canvas.WIDTH:g}"/>'
        f"{''.join(marks)}</svg>"
    )


def dataset(result: RunResult) -> xarray.Dataset:
    """Return all rasters of a result on the grid of its heights, with east and north in metres as coordinates.

    Raises:
        MissingExtraError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError as e:
        raise MissingExtraError("xarray", "notebooks") from e
    elevation, terrain, hazards = result.elevation, result.terrain_as_mapped, result.hazards_as_mapped
    arrays: dict[str, Any] = {}
    if elevation is not None:
        arrays |= {
            "height": np.where(elevation.trusted, elevation.height, np.float32(np.nan)),
            "sigma": elevation.relative_sigma, "flags": elevation.flags,
        }  # fmt: skip
    if terrain is not None:
        arrays |= {"terrain": terrain.label, "landable": terrain.landable}
    if hazards is not None:
        names = ("p_safe", "p_relief", "p_obstacle", "p_ground", "resolved", "slope", "roughness", "step", "clearance")
        arrays |= {name: getattr(hazards, name) for name in (*names, "quality", "reasons")}
    grid = elevation.grid if elevation is not None else hazards.grid if hazards is not None else None
    if grid is None:
        return xarray.Dataset()
    east, north = grid.xy()
    metres = {"units": "m"}
    return xarray.Dataset(
        {k: (("north", "east"), v, {"units": UNITS[k]} if k in UNITS else {}) for k, v in arrays.items()},
        {"east": ("east", east, metres), "north": ("north", north, metres)},
        {"crs": result.local.crs} if result.georeferenced else {},
    )
