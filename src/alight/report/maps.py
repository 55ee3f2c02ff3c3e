"""The maps of the report: reasons, P(safe), heights, sigma, land cover, missing heights; and pictures of the looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import U8
from alight.records import ElevationMap, HazardMap, RunResult, Terrain, TerrainMap, p_safe_text
from alight.report import canvas, paint, words
from alight.report.canvas import Canvas
from alight.report.figures import Figure, Key, Scale, marks, outlines, scale_bar

if TYPE_CHECKING:
    from alight.records.executive import LookPicture


def _coded_figure(
    texts: tuple[str, str, str], index: NDArray[Any], legend: Sequence[tuple[str, str]], none: Key,
    elevation: ElevationMap, c: Canvas,
) -> Figure:  # fmt: skip
    """Return a map with one colour per class, and the share of each class in the seen ground.

    Args:
        texts: title, alternative text, caption.
        index: (R, C) class of each cell as index into `legend`, -1: no class.
        legend: label and colour of each class.
        none: label and colour of cells without a class; with the colour "ground" these cells are not painted.
    """
    seen = elevation.views > 0
    counts = np.bincount(index[seen].astype(np.int64) + 1, minlength=len(legend) + 1)
    shares = [float(n) / max(int(seen.sum()), 1) for n in counts]
    keys = [
        Key(colour, label, words.percent(s)) for (label, colour), s in zip(legend, shares[1:], strict=True) if s > 0
    ]
    as_it_is = none.colour == "ground"
    table = [*(colour for _, colour in legend), "#000000" if as_it_is else none.colour]  # index -1 takes the last
    colours = np.array([paint.rgb(colour) for colour in table], np.float32)[index]
    uri = c.uri(paint.over_ground(colours, elevation, index >= 0 if as_it_is else None))
    title, alt, caption = texts
    keys = [replace(none, share=words.percent(shares[0])), *keys]
    return Figure(title, alt, uri, round(c.height, 1), caption=caption, keys=keys)


def reasons_figure(hazards: HazardMap, elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the map of the reasons of refusal, one colour per reason."""
    texts = (
        "Where a landing is refused, and why", "Map of the ground in one colour per reason of refusal",
        "The first reason against a touchdown centred there; shares are of the ground seen.",
    )  # fmt: skip
    index, legend = paint.first_reason(hazards.reasons, list(paint.HAZARDS)), list(paint.HAZARDS.values())
    return _coded_figure(texts, index, legend, Key(paint.SAFE_COLOUR, "fit for a touchdown"), elevation, c)


def p_safe_figure(hazards: HazardMap, c: Canvas) -> Figure:
    """Return the map of P(safe)."""
    return Figure(
        title="Probability of a safe touchdown",
        alt="Map of the probability that a touchdown is safe",
        uri=c.uri(
            paint.rgba(paint.colour_ramp(hazards.p_safe, 0.0, 1.0, paint.SAFE_RAMP), np.isfinite(hazards.p_safe))
        ),
        height=round(c.height, 1),
        scale=Scale(paint.SAFE_RAMP, "0 %", "50 %", "100 %"),
        caption="Over the worst heading; empty where it cannot be judged.",
    )


def heights_figure(result: RunResult, elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the map of the heights with hill shading."""
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
    """Return the map of the 1-sigma of the heights."""
    high = paint.span(elevation.sigma[elevation.trusted], 0, 98)[1]
    return Figure(
        title="How sure the heights are",
        alt=f"Map of the heights' standard deviation, 0 to {words.metres(high)}",
        uri=c.uri(paint.rgba(paint.colour_ramp(elevation.sigma, 0.0, high, paint.SIGMA_RAMP), elevation.trusted)),
        height=round(c.height, 1),
        scale=Scale(paint.SIGMA_RAMP, "0", words.metres(high / 2), words.metres(high)),
        caption="1-sigma relative to the map: how well a surface fits, not whether it is the right one.",
    )


def classes_figure(terrain: TerrainMap, elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the map of the land cover."""
    texts = "Kind of ground", "Map of what covers the ground", "A veto beside the heights, never a licence to land."
    index = np.full(256, -1, np.int8)
    index[[t.value for t in paint.TERRAIN_COLOURS]] = np.arange(len(paint.TERRAIN_COLOURS))
    legend = [(words.ground(t.name), colour) for t, colour in paint.TERRAIN_COLOURS.items()]
    none = Key("ground", words.ground(Terrain.UNKNOWN.name))
    figure = _coded_figure(texts, index[terrain.label], legend, none, elevation, c)
    unknown, *keys = figure.keys
    return replace(figure, keys=keys if unknown.share == words.percent(0.0) else [*keys, unknown])


def missing_figure(elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the map of the reasons why heights are missing."""
    texts = (
        "Where heights are missing, and why", "Map of the reasons why heights are missing or doubtful",
        "The first reason that holds; shares are of the ground seen.",
    )  # fmt: skip
    index, legend = paint.first_reason(elevation.flags, list(paint.FLAGS)), list(paint.FLAGS.values())
    return _coded_figure(texts, index, legend, Key("ground", "height found"), elevation, c)


def all_maps(result: RunResult, elevation: ElevationMap, c: Canvas) -> list[Figure]:
    """Return all maps below the answer, in the order of a reader's questions."""
    figures = []
    if (hazards := result.hazards_as_mapped) is not None:
        figures += [reasons_figure(hazards, elevation, c), p_safe_figure(hazards, c)]
    figures += [heights_figure(result, elevation, c), sigma_figure(elevation, c)]
    if (cover := result.terrain_as_mapped) is not None:
        figures.append(classes_figure(cover, elevation, c))
    figures.append(missing_figure(elevation, c))
    drawn, bar, zones = marks(result, c), scale_bar(c), outlines(result, c)
    return [replace(f, marks=drawn, bar=bar, zones=zones, classes=("plain", "small")) for f in figures]


def film(result: RunResult) -> list[Figure]:
    """Return one picture per look, in order of time: photo above, P(safe) below, with the footprint at the site."""
    if result.diary is None:
        return []
    return [_frame(k, p, result) for k, p in enumerate(result.diary.pictures, 1)]


def _frame(number: int, p: LookPicture, result: RunResult) -> Figure:
    photo = paint.rgba(p.photo, np.asarray(p.photo.any(axis=2)))
    safe = paint.rgba(paint.colour_ramp(p.p_safe, 0.0, 1.0, paint.SAFE_RAMP), np.isfinite(p.p_safe))
    side = len(photo)
    gap = np.zeros((6, side, 4), np.uint8)
    radius = result.settings.lander.radius / p.reach * side / 2
    both = np.vstack([_with_footprint(photo, radius), gap, _with_footprint(safe, radius)])
    doubt = f"; the doubt: {p.look.doubt}" if p.look.doubt else ""
    return Figure(
        title=f"Look {number}, from {p.look.height:.1f} m",
        alt=f"Look {number}: photo and P(safe) of {2 * p.reach:.0f} m about the place",
        uri=canvas.embedded(canvas.webp(both)),
        height=round(canvas.WIDTH * both.shape[0] / side, 1),
        caption=f"at {p.look.t:.0f} s: {p.look.verdict}, P(safe) {p_safe_text(p.look.p_safe)}{doubt}",
        classes=("film",),
    )


def _with_footprint(picture: U8, radius: float) -> U8:
    """Return a picture with the circle of the footprint about its centre; `radius` is in pixels."""
    out, middle = picture.copy(), (picture.shape[1] // 2, picture.shape[0] // 2)
    cv2.circle(out, middle, round(radius), (16, 21, 27, 255), 3, cv2.LINE_AA)
    cv2.circle(out, middle, round(radius), (255, 255, 255, 255), 1, cv2.LINE_AA)
    return out
