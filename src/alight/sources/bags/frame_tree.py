"""Frames of a robot, as tf publishes them."""

from __future__ import annotations

import numpy as np

from alight.geometry import Pose
from alight.records import InputError

STILL = 0.01  # rad and m; a joint that changes by more is no mounting


class FrameTree:
    """Poses between named frames."""

    def __init__(self) -> None:
        self._above: dict[str, tuple[str, Pose]] = {}  # frame: its parent, parent_from_frame
        self._moving: set[str] = set()

    def add(self, parent: str, child: str, parent_from_child: Pose) -> None:
        """Add a transform; the first one of a frame is kept."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        _, first = self._above.setdefault(child, (parent, parent_from_child))
        if not np.allclose(first.matrix, parent_from_child.matrix, rtol=0.0, atol=STILL):
            self._moving.add(child)

    @property
    def base(self) -> str:
        """Name of the frame of the body, by REP 105; empty: there is none."""
        known = {*self._above, *(parent for parent, _ in self._above.values())}
        return min((name for name in known if name.endswith("base_link")), key=len, default="")

    def between(self, dst: str, src: str) -> Pose | None:
        """Return the pose dst_from_src; None: the two are not connected.

        Raises:
            InputError: a joint between the two moves.
        """
        ups, downs = self._chain(src), self._chain(dst)
        common = next((frame for frame in ups if frame in downs), None)
        if common is None:
            return None
        path = [*list(ups)[: list(ups).index(common)], *list(downs)[: list(downs).index(common)]]
        if moving := self._moving.intersection(path):
            raise InputError(f"tf: {min(moving)!r}, between {dst!r} and {src!r}, moves; a camera must be fixed")
        return downs[common].inverse @ ups[common]

    def _chain(self, frame: str) -> dict[str, Pose]:
        """Return the frame and those above it, up to the root, with the poses each_from_frame."""
        out, pose = {frame: Pose()}, Pose()
        while frame in self._above:
            frame, step = self._above[frame]
            if frame in out:  # a loop
                break
            pose = step @ pose
            out[frame] = pose
        return out
