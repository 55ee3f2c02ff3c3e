"""The reasons of refusal as a figure with its legend, and the pictures of the looks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import U8
from alight.records import ElevationMap, HazardMap, RunResult, p_safe_text
from alight.report import canvas, paint, words
from alight.report.canvas import Canvas
from alight.report.figures import Figure, Key, scale_bar
from alight.report.paint import Reason

if TYPE_CHECKING:
    from alight.records.executive import LookPicture


def keys_of(index: NDArray[Any], reasons: Sequence[Reason], none: Reason, elevation: ElevationMap) -> list[Key]:
    """Return the legend of reasons, with the share of each in the seen ground; reasons that do not occur are left out.

    Args:
        index: (R, C) index of each cell's reason in `reasons`, -1: none.
        reasons: text and colour of each reason.
        none: text and colour of cells without a reason.
        elevation: the map, with the number of views of each cell.
    """
    seen = elevation.views > 0
    counts = np.bincount(index[seen].astype(np.int64) + 1, minlength=len(reasons) + 1)
    shares = [float(n) / max(int(seen.sum()), 1) for n in counts]
    return [
        Key(reason.colour, reason.text, words.percent(share))
        for reason, share in zip((none, *reasons), shares, strict=True)
        if share > 0 or reason is none
    ]


def reasons_figure(hazards: HazardMap, elevation: ElevationMap, c: Canvas) -> Figure:
    """Return the map of the reasons of refusal, one colour per reason."""
    index, reasons = paint.first_reason(hazards.reasons, list(paint.HAZARDS)), list(paint.HAZARDS.values())
    colours = np.array([paint.rgb(r.colour) for r in (*reasons, paint.FIT)], np.float32)  # index -1 takes the last
    return Figure(
        title="Where a landing is refused, and why",
        alt="Map of the ground in one colour per reason of refusal",
        uri=c.uri(paint.over_ground(colours[index], elevation)),
        height=round(c.height, 1),
        keys=keys_of(index, reasons, paint.FIT, elevation),
        bar=scale_bar(c),
        caption="The first reason against a touchdown centred there; shares are of the ground seen.",
        classes=("plain",),
    )


def film(result: RunResult) -> list[Figure]:
    """Return one picture per look, in order of time: photo above, P(safe) below, with the footprint at the site."""
    if result.diary is None:
        return []
    return [_frame(k, p, result) for k, p in enumerate(result.diary.pictures, 1)]


def _frame(number: int, p: LookPicture, result: RunResult) -> Figure:
    both = look_frame(p, result.settings.lander.radius)
    doubt = f"; the doubt: {p.look.doubt}" if p.look.doubt else ""
    return Figure(
        title=f"Look {number}, from {p.look.height:.1f} m",
        alt=f"Look {number}: photo and P(safe) of {2 * p.reach:.0f} m about the place",
        uri=canvas.embedded(canvas.webp(both)),
        height=round(canvas.WIDTH * both.shape[0] / both.shape[1], 1),
        caption=f"at {p.look.t:.0f} s: {p.look.verdict}, P(safe) {p_safe_text(p.look.p_safe)}{doubt}",
        classes=("film",),
    )


def look_frame(p: LookPicture, radius: float) -> U8:
    """Return the RGBA picture of a look: photo above, P(safe) below, with the footprint of `radius` metres."""
    photo = paint.rgba(p.photo, np.asarray(p.photo.any(axis=2)))
    safe = paint.rgba(paint.colour_ramp(p.p_safe, 0.0, 1.0, paint.SAFE_RAMP), np.isfinite(p.p_safe))
    side, gap = len(photo), np.zeros((6, len(photo), 4), np.uint8)
    pixels = radius / p.reach * side / 2
    return np.vstack([_with_footprint(photo, pixels), gap, _with_footprint(safe, pixels)])


def film_strip(pictures: Sequence[LookPicture], radius: float) -> bytes | None:
    """Return the frames of all looks side by side as a small WebP picture; None: there is no look."""
    frames = [canvas.shrink(look_frame(p, radius), 240) for p in pictures]
    return canvas.webp(np.hstack(frames)) if frames else None


def _with_footprint(picture: U8, radius: float) -> U8:
    """Return a picture with the circle of the footprint about its centre; `radius` is in pixels."""
    out, middle = picture.copy(), (picture.shape[1] // 2, picture.shape[0] // 2)
    cv2.circle(out, middle, round(radius), (16, 21, 27, 255), 3, cv2.LINE_AA)
    cv2.circle(out, middle, round(radius), (255, 255, 255, 255), 1, cv2.LINE_AA)
    return out
