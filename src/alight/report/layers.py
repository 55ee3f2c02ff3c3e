"""The layers of the page's map: fields to probe, with colours and a legend where they are painted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.geometry import ellipsoid_fall
from alight.records import ElevationMap, HazardMap, RunResult, Terrain, TerrainMap
from alight.report import paint, words
from alight.report.fields import Field, chances, heights, lengths, measured, named
from alight.report.figures import Key
from alight.report.maps import keys_of
from alight.report.paint import Ramp


@dataclass(frozen=True)
class Colours:
    """How a field is painted: by a ramp from `low` to `high`, or by one colour per code with the keys of a legend."""

    caption: str
    ramp: Ramp = ()
    low: float = 0.0
    high: float = 1.0
    codes: Sequence[str] = ()
    keys: Sequence[Key] = ()


class MapLayer(NamedTuple):
    """A field by its name; without colours it is only probed."""

    name: str
    field: Field
    colours: Colours | None = None


def layers_of(result: RunResult, elevation: ElevationMap) -> Iterator[MapLayer]:
    """Yield the layers of a run in the order of a reader's questions."""
    if result.hazards is not None:
        yield from _safety(result.hazards)
        yield _reasons(result.hazards, elevation)
    yield from _heights(result, elevation)
    if result.hazards is not None:
        yield from _shape(result.hazards)
    if result.terrain is not None:
        yield from _cover(result.terrain)
    yield from _sight(elevation)


def _safety(h: HazardMap) -> Iterator[MapLayer]:
    caption = "Probability of a safe touchdown over the worst heading; empty where it cannot be judged."
    yield MapLayer(
        "p_safe", measured("P(safe)", "chance", h.grid, h.p_safe, chances()), Colours(caption, paint.SAFE_RAMP)
    )
    for name, title, values in (
        ("p_relief", "relief", h.p_relief), ("p_obstacle", "unseen obstacles", h.p_obstacle),
        ("p_ground", "ground", h.p_ground), ("p_wires", "wires", h.p_wires),
    ):  # fmt: skip
        if values is not None and np.isfinite(values).any():
            yield MapLayer(name, measured(title, "chance", h.grid, values, chances()))
    yield MapLayer("resolved", measured("Smallest obstacle found", "length", h.grid, h.resolved, lengths()))


def _reasons(h: HazardMap, elevation: ElevationMap) -> MapLayer:
    order, (fit, *reasons) = list(paint.HAZARDS), (paint.FIT, *paint.HAZARDS.values())
    field, bits = named("Why refused", h.grid, h.reasons, lambda n: paint.texts(n, paint.HAZARDS, fit))
    first = paint.first_reason(np.array(bits, np.uint16), order)
    keys = keys_of(paint.first_reason(h.on(elevation.grid).reasons, order), reasons, fit, elevation)
    caption = "The first reason against a touchdown centred there; shares are of the ground seen."
    return MapLayer("reasons", field, Colours(caption, codes=[[*reasons, fit][i].colour for i in first], keys=keys))


def _heights(result: RunResult, e: ElevationMap) -> Iterator[MapLayer]:
    up, above = np.where(e.trusted, e.height, np.nan), "above the origin"
    if result.georeferenced:
        up, above = up + result.local.height + ellipsoid_fall(e.grid), "above the WGS84 ellipsoid"
    low, high = paint.span(up, 1, 96)  # objects on the ground may saturate
    caption = f"Metres {above}; empty where no height can be trusted."
    yield MapLayer("height", heights("Height", e.grid, up), Colours(caption, paint.HEIGHT_RAMP, low, high))
    sigma = np.where(e.trusted, e.relative_sigma, np.nan)
    field, high = measured("Height, 1-sigma", "length", e.grid, sigma, lengths()), paint.span(sigma, 0, 98)[1]
    caption = "Relative to the map: how well a surface fits, not whether it is the right one."
    yield MapLayer("sigma", field, Colours(caption, paint.SIGMA_RAMP, high=high))


def _shape(h: HazardMap) -> Iterator[MapLayer]:
    for name, title, form, values, caption in (
        ("slope", "Slope", "angle", h.slope, "Slope of the footprint's plane."),
        ("roughness", "Largest bump", "length", h.roughness, "Largest deviation from the footprint's plane."),
    ):
        field = measured(title, form, h.grid, values, lengths())  # type: ignore[arg-type]
        yield MapLayer(name, field, Colours(caption, paint.SIGMA_RAMP, high=paint.span(values, 0, 90)[1]))


def _doubtful(terrain: TerrainMap) -> NDArray[np.uint8]:
    """Return the class of each cell, (R, C), plus 128 if its probability is below two thirds."""
    doubtful = (terrain.confidence < 2 / 3) & (terrain.label > 0)
    return np.where(doubtful, terrain.label + np.uint8(128), terrain.label)


def _cover(terrain: TerrainMap) -> Iterator[MapLayer]:
    def text(number: int) -> str:
        return words.ground(Terrain(number % 128).name) + ", doubtful" * (number >= 128)

    def colour(number: int) -> str:  # unknown: not painted; doubtful: paler
        return paint.TERRAIN_COLOURS.get(Terrain(number % 128), paint.FOUND.colour) + "80" * (number >= 128)

    field, numbers = named("Land cover", terrain.grid, _doubtful(terrain), text)
    counts = dict(zip(numbers, np.bincount(field.codes.ravel(), minlength=len(numbers) + 1)[1:].tolist(), strict=True))
    seen, keys = max(sum(n for k, n in counts.items() if k), 1), []
    for kind in sorted({number % 128 for number in numbers if number}):
        doubtful, sure = counts.get(kind + 128, 0) / seen, counts.get(kind, 0) / seen
        note = f" ({words.percent(doubtful)} doubtful)" if doubtful else ""
        keys.append(Key(colour(kind), text(kind) + note, words.percent(sure + doubtful)))
    caption = "It can refuse a place, never permit it. Pale: the class is doubtful, less than two thirds sure."
    yield MapLayer("cover", field, Colours(caption, codes=[colour(n) for n in numbers], keys=keys))
    yield MapLayer("confidence", measured("sure", "chance", terrain.grid, terrain.confidence, chances()))


def _sight(e: ElevationMap) -> Iterator[MapLayer]:
    order, (found, *reasons) = list(paint.FLAGS), (paint.FOUND, *paint.FLAGS.values())
    field, bits = named("Missing heights", e.grid, e.flags, lambda n: paint.texts(n, paint.FLAGS, found))
    first = paint.first_reason(np.array(bits, np.uint16), order)
    keys = keys_of(paint.first_reason(e.flags, order), reasons, found, e)
    caption = "The first reason why a height is missing or doubtful; shares are of the ground seen."
    yield MapLayer("flags", field, Colours(caption, codes=[[*reasons, found][i].colour for i in first], keys=keys))
    caption, most = "Number of pictures that each height was found from.", float(e.views.max(initial=1))
    yield MapLayer(
        "views",
        Field("Number of pictures", "count", e.grid, e.views, low=1.0),
        Colours(caption, paint.HEIGHT_RAMP, 1.0, most),
    )
