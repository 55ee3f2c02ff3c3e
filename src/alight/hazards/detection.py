"""Probability that heights or pixels show an obstacle of a given size (G7d).

The curves are measured (`learned/detection.md`). They give the share of obstacles found over the obstacle's width,
divided by the width on the ground of a match sample or of a picture's pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.ndimage import map_coordinates

from alight.arrays import F32, F64
from alight.learned import arrays_of, table_path

WIDE = 2.0  # width over height of an obstacle: a half ball
STEEP = 3.0  # exponent of the decreasing density of obstacles over width: an eighth at twice the width
LARGEST = 4.0  # largest width that is considered, over the width of the smallest relevant obstacle
RATIOS = np.geomspace(0.02, 4.0, 60)  # width of a sample or pixel over the height of the smallest relevant obstacle


@dataclass(frozen=True, eq=False)
class Detection:
    """Curves of the share of obstacles found, over the width of the obstacle in match samples or in pixels."""

    sizes: F64  # (N,) ratios of widths, ascending
    heights: F64  # (N,) share found by heights, where `width / sampling` is `sizes`
    pixels: F64  # (N,) share found in pictures, where `width / pixel` is `sizes`

    def missed(self, width: F64, sampling: F64, pixel: F64) -> F64:
        """Return the share of obstacles of `width` that heights and pictures both miss.

        `sampling`, `pixel`: widths of a match sample and of a pixel on the ground. All lengths broadcast, metres.
        """
        seen = [
            np.interp(np.log(width / at), np.log(self.sizes), curve)
            for at, curve in ((sampling, self.heights), (pixel, self.pixels))
        ]
        return np.asarray((1 - seen[0]) * (1 - seen[1]))

    def unseen_share(self, limit: float, sampling: F32, pixel: F32) -> F32:
        """Return the share of obstacles higher than `limit` that heights and pictures both miss.

        `sampling`, `pixel`: widths of a match sample and of a pixel on the ground. All lengths are in metres.
        """
        wide = (np.nan_to_num(v / np.float32(limit), nan=np.inf) for v in (sampling, pixel))
        at = [np.log(v.clip(RATIOS[0], RATIOS[-1]) / RATIOS[0]) / np.log(RATIOS[1] / RATIOS[0]) for v in wide]
        return np.asarray(map_coordinates(self._unseen, at, order=1, mode="nearest"), np.float32)

    @cached_property
    def _unseen(self) -> F64:
        """Table of the share of obstacles higher than a limit that are not seen, (N, N).

        Rows: width of a match sample on the ground / limit. Columns: width of a pixel on the ground / limit. The ratios
        of rows and of columns are the N `RATIOS`.
        """
        width = WIDE * np.geomspace(1, LARGEST, 24)
        missed = self.missed(width[None, None], RATIOS[:, None, None], RATIOS[None, :, None])
        return np.asarray(np.average(missed, axis=-1, weights=width ** (1 - STEEP)))

    def smallest_found(self, share: float, sampling: F32, pixel: F32) -> F32:
        """Return the height of the smallest obstacle found with probability `share`.

        `sampling`, `pixel`: widths of a match sample and of a pixel on the ground. All lengths are in metres.
        """
        ratios = np.geomspace(0.25, 32.0, 43)  # width of a match sample over the width of a pixel
        widest = 60.0  # in pixels; wider obstacles are always found
        widths = np.geomspace(0.5, widest, 200)[:, None]
        missed = self.missed(widths, ratios, np.ones_like(ratios))
        first = np.argmax(missed <= 1 - share, axis=0)
        found = np.where((missed <= 1 - share).any(axis=0), widths[first, 0], widest)
        ratio = np.log((sampling / np.maximum(pixel, np.float32(1e-6))).clip(ratios[0], ratios[-1]))
        return np.asarray(pixel * np.interp(ratio, np.log(ratios), found) / WIDE, np.float32)


@cache
def read_detection() -> Detection:
    """Read the measured curves of the package."""
    arrays = arrays_of(table_path("detection").read_bytes())
    return Detection(*(arrays[k].astype(np.float64) for k in ("sizes", "heights", "pixels")))
