"""Detection of frozen cameras: a picture that repeats its camera's last one bit for bit is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from alight.arrays import U8
from alight.records import Frame, Pixels

SPARSE = 4  # pixels, step in which two pictures are compared


class PictureWatch:
    """Keeps the time of the newest picture, and leaves out pictures that only repeat the one before.

    The noise of a sensor makes every picture a little different, so one that is the same to the bit comes from a
    camera or a driver that hangs. A motion that is estimated from it stands still while the vehicle flies.
    """

    def __init__(self) -> None:
        self._last: dict[int, U8] = {}
        self.newest_ns: int | None = None  # arrival of the last picture that was new
        self.frozen = 0  # exposures in a row without a new picture
        self.stuck: tuple[int, ...] = ()  # cameras whose newest picture repeats the one before

    def fresh(self, frame: Frame, now_ns: int) -> Frame | None:
        """Take an exposure; return it with its new pictures only, or None if there is none."""
        repeated = {cam for cam, image in enumerate(frame.images) if image is not None and self._repeats(cam, image)}
        given = {cam for cam, image in enumerate(frame.images) if image is not None}
        self.stuck = tuple(sorted((set(self.stuck) - given) | repeated))
        if not given - repeated:
            self.frozen += bool(given)
            return None
        self.newest_ns, self.frozen = now_ns, 0
        if not repeated:
            return frame
        return replace(frame, images=tuple(None if cam in repeated else i for cam, i in enumerate(frame.images)))

    def age(self, now_ns: int) -> float:
        """Seconds since the last picture that was new."""
        return math.inf if self.newest_ns is None else (now_ns - self.newest_ns) * 1e-9

    def _repeats(self, cam: int, image: Pixels) -> bool:
        small, before = np.asarray(image)[::SPARSE, ::SPARSE].copy(), self._last.get(cam)
        self._last[cam] = small
        return before is not None and np.array_equal(small, before)
