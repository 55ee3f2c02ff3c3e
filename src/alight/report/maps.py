"""The maps behind the answer: reasons, P(safe), heights, sigma, land cover, and missing heights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.records import ElevationMap, HazardMap, RunResult, Terrain, TerrainMap
from alight.report import paint, words
from alight.report.canvas import Canvas
from alight.report.figures import Figure, Key, Scale, marks, scale_bar


def _shares(index: NDArray[Any], seen: NDArray[np.bool_], count: int) -> list[float]:
    found = np.bincount(index[seen].astype(np.int64) + 1, minlength=count + 1)
    return [float(n) / max(int(seen.sum()), 1) for n in found]


def _keys(labels: Iterable[str], colours: Iterable[str], shares: Iterable[float]) -> list[Key]:
    """Legend of the kinds that occur in the map."""
    return [
        Key(colour, label, words.percent(share))
        for label, colour, share in zip(labels, colours, shares, strict=True)
        if share > 0
    ]


def reasons_figure(hazards: HazardMap, elevation: ElevationMap, c: Canvas) -> Figure:
    """Map of the reasons of refusal, one colour a reason."""
    order = list(paint.HAZARD_COLOURS)
    index = paint.first_reason(hazards.reasons, [int(h) for h in order])
    colours = list(paint.HAZARD_COLOURS.values())
    share = _shares(index, elevation.views > 0, len(order))
    keys = [Key(paint.SAFE_COLOUR, "fit for a touchdown", words.percent(share[0]))]
    keys += _keys((words.HAZARDS[h] for h in order), colours, share[1:])
    return Figure(
        title="Where a landing is refused, and why",
        alt="Map of the ground in one colour per reason of refusal",
        uri=c.uri(paint.over_ground(paint.by_index(index, colours, paint.SAFE_COLOUR), elevation)),
        height=round(c.height, 1),
        caption="The first reason against a touchdown centred there; shares are of the ground seen.",
        keys=keys,
    )


def p_safe_figure(hazards: HazardMap, c: Canvas) -> Figure:
    """Map of the probability of a safe touchdown."""
    return Figure(
        title="Probability of a safe touchdown",
        alt="Map of the probability that a touchdown is safe",
        uri=c.uri(paint.paint_safe(hazards)),
        height=round(c.height, 1),
        scale=Scale(paint.SAFE_RAMP, "0 %", "50 %", "100 %"),
        caption="Over the worst heading; empty where it cannot be judged.",
    )


def heights_figure(result: RunResult, elevation: ElevationMap, c: Canvas) -> Figure:
    """Map of the heights, hillshaded."""
    low, high = paint.span(elevation.height[elevation.trusted], 1, 96)  # objects on the ground may saturate
    up = result.local.height if result.georeferenced else 0.0
    reference = "above the WGS84 ellipsoid" if result.georeferenced else "above the origin"
    low_t, mid_t, high_t = (f"{up + h:.1f} m" for h in (low, (low + high) / 2, high))
    return Figure(
        title="Heights",
        alt=f"Shaded relief, {low_t} to {high_t}",
        uri=c.uri(paint.paint_heights(elevation, low, high)),
        height=round(c.height, 1),
        scale=Scale(paint.HEIGHT_RAMP, low_t, mid_t, f"≥ {high_t}"),
        caption=f"Metres {reference}, lit from the north-west; empty where no height can be trusted.",
    )


def sigma_figure(elevation: ElevationMap, c: Canvas) -> Figure:
    """Map of the 1-sigma of the heights."""
    high = paint.span(elevation.sigma[elevation.trusted], 0, 98)[1]
    return Figure(
        title="How sure the heights are",
        alt=f"Map of the heights' standard deviation, 0 to {words.metres(high)}",
        uri=c.uri(paint.paint_sigma(elevation, high)),
        height=round(c.height, 1),
        scale=Scale(paint.SIGMA_RAMP, "0", words.metres(high / 2), words.metres(high)),
        caption="1-sigma relative to the map: how well a surface fits, not whether it is the right one.",
    )


def classes_figure(terrain: TerrainMap, elevation: ElevationMap, c: Canvas) -> Figure:
    """Map of the land cover."""
    order = list(paint.TERRAIN_COLOURS)
    index = np.full(256, -1, np.int8)
    index[[t.value for t in order]] = np.arange(len(order))
    found = index[terrain.label]
    colours = list(paint.TERRAIN_COLOURS.values())
    share = _shares(found, elevation.views > 0, len(order))
    keys = _keys((words.ground(t.name) for t in order), colours, share[1:])
    if share[0] > 0:
        keys.append(Key("ground", words.ground(Terrain.UNKNOWN.name), words.percent(share[0])))
    return Figure(
        title="Kind of ground",
        alt="Map of what covers the ground",
        uri=c.uri(paint.over_ground(paint.by_index(found, colours, "#000000"), elevation, found >= 0)),
        height=round(c.height, 1),
        keys=keys,
        caption="A veto beside the heights, never a licence to land.",
    )


def missing_figure(elevation: ElevationMap, c: Canvas) -> Figure:
    """Map of the reasons why heights are missing."""
    order = list(paint.FLAG_COLOURS)
    index = paint.first_reason(elevation.flags, [int(f) for f in order])
    colours = list(paint.FLAG_COLOURS.values())
    share = _shares(index, elevation.views > 0, len(order))
    keys = [Key("ground", "height found", words.percent(share[0]))]
    keys += _keys((words.FLAGS[f] for f in order), colours, share[1:])
    return Figure(
        title="Where heights are missing, and why",
        alt="Map of the reasons why heights are missing or doubtful",
        uri=c.uri(paint.over_ground(paint.by_index(index, colours, "#000000"), elevation, index >= 0)),
        height=round(c.height, 1),
        keys=keys,
        caption="The first reason that holds; shares are of the ground seen.",
    )


def all_maps(result: RunResult, elevation: ElevationMap, c: Canvas) -> list[Figure]:
    """Every map below the answer, in the order of a reader's questions."""
    figures = []
    if (hazards := result.hazards_as_mapped) is not None:
        figures += [reasons_figure(hazards, elevation, c), p_safe_figure(hazards, c)]
    figures += [heights_figure(result, elevation, c), sigma_figure(elevation, c)]
    if (cover := result.terrain_as_mapped) is not None:
        figures.append(classes_figure(cover, elevation, c))
    figures.append(missing_figure(elevation, c))
    drawn, bar = marks(result, c), scale_bar(c)
    return [replace(f, marks=drawn, bar=bar, classes=("plain", "small")) for f in figures]
