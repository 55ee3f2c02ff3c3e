"""Grouping of a rig's images that were exposed together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Exposure:
    """One moment: the file of each camera, None where a camera has none."""

    t_ns: int
    names: tuple[str | None, ...]


def group_exposures(streams: Sequence[Sequence[tuple[int, str]]]) -> tuple[list[Exposure], int]:
    """Group the images of one time: equal times first, then the nearest within half a frame period.

    Args:
        streams: for each camera its (time ns, file name), in order of time.

    Returns:
        Exposures in order of time, exposures of one camera alone included, and the largest difference in ns
        between images that were paired although their times differ.
    """
    found: dict[int, list[str | None]] = {t: [name] + [None] * (len(streams) - 1) for t, name in streams[0]}
    apart = 0
    for k, stream in enumerate(streams[1:], 1):
        times = np.array(sorted(found), dtype=np.int64)
        tolerance = int(np.median(np.diff(times))) // 2 if len(times) > 1 else 0
        for t, name in sorted(stream, key=lambda row: row[0] not in found):  # exact ones take their place first
            partner = _nearest(times, t)
            if abs(partner - t) < max(tolerance, 1) and found[partner][k] is None:
                found[partner][k] = name
                apart = max(apart, abs(partner - t))
            else:
                found.setdefault(t, [None] * len(streams))[k] = name
    return [Exposure(t, tuple(found[t])) for t in sorted(found)], apart


def _nearest(times: np.ndarray[tuple[int], np.dtype[np.int64]], t: int) -> int:
    i = int(np.searchsorted(times, t))
    around = times[max(i - 1, 0) : i + 1]
    return int(around[np.argmin(np.abs(around - t))])
