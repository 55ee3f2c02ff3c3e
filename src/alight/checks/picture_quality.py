"""Measures of one camera's pictures: brightness, sharpness, and parts that stand still while the ground moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.checks.features import LEAST_FEATURES, downscaled, followed
from alight.raster import grey_levels

STEP = 0.12  # share of the longer side by which the ground has moved between two compared pictures


class Brightness(NamedTuple):
    """Statistics of the grey values, 0 to 255, of one picture."""

    saturated: float  # share of the pixels
    black: float  # share of the pixels
    contrast: float  # 95th minus 5th percentile
    mean: float


def brightness_of(image: U8) -> Brightness:
    """Measure one picture, grey or colour, on a subset of its pixels."""
    k = max(1, max(image.shape[:2]) // 400)
    part = image[::k, ::k]
    grey = part.mean(axis=2) if part.ndim == 3 else part.astype(np.float64)
    low, high = np.percentile(grey, [5.0, 95.0])
    return Brightness(float((grey >= 250).mean()), float((grey <= 5).mean()), float(high - low), float(grey.mean()))


def edge_widths(image: U8) -> F64:
    """Return the (2,) widths of the sharpest edges across x and across y, px; NaN if there are none.

    The width of an edge is its height over its steepest slope: 1 for an ideal step, 2.5 sigma after a Gaussian blur. Of
    the edges with most contrast, the sharpest tenth shows the sharpness of the lens. The other edges depend on the
    ground (docs/lab/flight.md).
    """
    grey = cv2.GaussianBlur(grey_levels(image).astype(np.float32), (0, 0), 0.6)
    return np.array([_width(grey), _width(np.ascontiguousarray(grey.T))])


def _width(grey: F32, reach: int = 17) -> float:
    """Return the width of the sharpest edges across x, px; NaN if there are too few. `reach`: largest width, px."""
    slope = cv2.dilate(np.abs(grey[:, 1:] - grey[:, :-1]), np.ones((1, reach - 1), np.uint8))
    line = np.ones((1, reach), np.uint8)
    height = (cv2.dilate(grey, line) - cv2.erode(grey, line))[:, :-1]
    strong = height > max(20.0, float(np.percentile(height[::4, ::4], 99.0)))
    return float(np.percentile(height[strong] / slope[strong], 10.0)) if strong.sum() > 50 else float("nan")


@dataclass
class StaticMap:
    """Comparison of pictures between which the ground has moved, at the same pixels and at the same ground.

    An object on the lens, or in front of it, agrees at the same pixels but not at the same ground. A drop of water that
    only blurs shows less contrast than the same ground has elsewhere in the picture.
    """

    pairs: int = 0
    _way: F64 = field(default_factory=lambda: np.zeros(2))
    _then: U8 | None = None
    _sums: list[F64] = field(default_factory=list)  # at the pixel, at the ground, contrast here, elsewhere, weight

    def add(self, picture: U8, shift: F64) -> None:
        """Add the next grey picture and the (2,) motion of the ground since the last, as shares of the longer side."""
        self._way = self._way + shift
        now = downscaled(picture, 320)[0]
        then, self._then = self._then, self._then if self._then is not None else now
        if then is None:
            self._sums = [np.zeros(now.shape) for _ in range(5)]
            return
        if float(np.linalg.norm(self._way)) < STEP:
            return
        self._way, self._then = np.zeros(2), now
        a, b = followed(then, now)
        if len(a) < LEAST_FEATURES:
            return
        move = float(np.linalg.norm(np.median(b - a, axis=0))) / max(now.shape)
        H, inside = cv2.findHomography(a, b, cv2.RANSAC, 1.5)
        if H is not None and inside.mean() > 0.5 and 0.7 * STEP < move < 0.45:  # else the overlap is too small
            self._compare(then, now, H)

    def _compare(self, then: U8, now: U8, H: F64) -> None:
        size = (now.shape[1], now.shape[0])
        a, b = _fine(then), _fine(now)
        for first, other, M in ((a, b, H), (b, a, np.linalg.inv(H))):
            moved = cv2.warpPerspective(first, M, size, flags=cv2.INTER_LINEAR)
            valid = cv2.warpPerspective(np.ones_like(first), M, size, flags=cv2.INTER_NEAREST) > 0
            parts = np.abs(other - first), np.abs(other - moved), np.abs(other), np.abs(moved), np.ones_like(first)
            for total, part in zip(self._sums, parts, strict=True):
                total[valid] += part[valid]
        self.pairs += 1

    def spots(self, width: int, height: int) -> list[str]:
        """Return texts on the static, blurred or covered parts, in px of a picture of this width and height."""
        if not self.pairs:
            return []
        side = max(2, max(self._sums[0].shape) // 40)
        same, ground, here, elsewhere, weight = (cv2.boxFilter(s, -1, (side, side))[::side, ::side] for s in self._sums)
        seen = weight >= 3.0
        with np.errstate(divide="ignore", invalid="ignore"):
            same, ground, here, elsewhere = (x / weight for x in (same, ground, here, elsewhere))
            still = seen & (ground > 5.0) & (same < 0.55 * ground)
            dull = seen & (elsewhere > 4.0) & (here < 0.42 * elsewhere)
        rows, cols = self._sums[0].shape
        return [
            f"u {left * side / cols * width:.0f} to {min((left + wide) * side / cols, 1.0) * width:.0f}, "
            f"v {top * side / rows * height:.0f} to {min((top + high) * side / rows, 1.0) * height:.0f} px {what}"
            for mask, what in ((still, "stands still"), (dull & ~still, "is blurred or covered"))
            for left, top, wide, high, area in _connected(mask)
            if area >= 3
        ]


def _fine(image: U8) -> F32:
    """Return the picture without slow changes of brightness, because vignetting is as static as dirt."""
    x = image.astype(np.float32)
    return np.asarray(x - cv2.GaussianBlur(x, (0, 0), max(image.shape) / 40.0), dtype=np.float32)


def _connected(mask: Mask) -> list[list[int]]:
    """Return left, top, width, height and area of each connected part of a mask, px."""
    found: list[list[int]] = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)[2][1:].tolist()
    return found
