"""The film strip of the page: one picture of the ground a look of the landing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from alight.arrays import U8
from alight.records import RunResult, p_safe_text
from alight.report import canvas, paint
from alight.report.figures import Figure

if TYPE_CHECKING:
    from alight.records.executive import LookPicture

GAP = 6  # pixels between the photo and P(safe) below it
INK = (255, 255, 255, 255)


def film(result: RunResult) -> list[Figure]:
    """One picture a look, in order of time: above the photo, below P(safe), with the footprint at the place."""
    if result.diary is None:
        return []
    return [_frame(k, p, result) for k, p in enumerate(result.diary.pictures, 1)]


def _frame(number: int, p: LookPicture, result: RunResult) -> Figure:
    photo = paint.rgba(p.photo, np.asarray(p.photo.any(axis=2)))
    safe = paint.rgba(paint.colour_ramp(p.p_safe, 0.0, 1.0, paint.SAFE_RAMP), np.isfinite(p.p_safe))
    side = len(photo)
    gap = np.zeros((GAP, side, 4), np.uint8)
    radius = result.settings.lander.radius / p.reach * side / 2
    both = np.vstack([_with_footprint(photo, radius), gap, _with_footprint(safe, radius)])
    doubt = f"; the doubt: {p.look.doubt}" if p.look.doubt else ""
    return Figure(
        title=f"Look {number}, from {p.look.height:.1f} m",
        alt=f"Look {number}: photo and P(safe) of {2 * p.reach:.0f} m about the place",
        uri=canvas.data_uri(both),
        height=round(canvas.WIDTH * both.shape[0] / side, 1),
        caption=f"at {p.look.t:.0f} s: {p.look.verdict}, P(safe) {p_safe_text(p.look.p_safe)}{doubt}",
        classes=("film",),
    )


def _with_footprint(picture: U8, radius: float) -> U8:
    """The circle of the footprint about the middle, radius in pixels."""
    out, middle = picture.copy(), (picture.shape[1] // 2, picture.shape[0] // 2)
    cv2.circle(out, middle, round(radius), (16, 21, 27, 255), 3, cv2.LINE_AA)
    cv2.circle(out, middle, round(radius), INK, 1, cv2.LINE_AA)
    return out
