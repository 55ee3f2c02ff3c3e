"""The frame store: the pixels of keyframes, for as long as the terrain lane may want them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from alight.records import Frame, Motion, Rig, View


class FrameStore:
    """Frames that are far enough apart to be worth matching.

    Args:
        turn: rad of the optical axis that make a keyframe without a step.
    """

    def __init__(self, turn: float) -> None:
        self._turn = turn
        self.frames: list[Frame] = []
        self.bytes = 0
        self.taken = 0  # frames that were ever kept
        self._last: Motion | None = None

    def offer(self, frame: Frame, motion: Motion | None, step: float | None) -> bool:
        """Keep the frame if it moved `step` metres (None: keep it anyway) or turned since the last one kept."""
        if step is not None and motion is not None and self._last is not None and not self._moved(motion, step):
            return False
        self.frames.append(frame)
        self.taken += 1
        self.bytes += _bytes(frame)
        self._last = motion or self._last
        return True

    def _moved(self, motion: Motion, step: float) -> bool:
        a, b = self._last.world_from_cams[0] if self._last else motion.world_from_cams[0], motion.world_from_cams[0]
        axis = float(np.clip(a.rotation[:, 2] @ b.rotation[:, 2], -1, 1))
        return bool(np.linalg.norm(a.translation - b.translation) >= step or np.arccos(axis) >= self._turn)

    def drop_oldest(self, count: int) -> None:
        """Forget the first `count` frames."""
        self._keep(self.frames[count:])

    def thin(self) -> None:
        """Forget every second frame, the newest not."""
        self._keep(self.frames[::-2][::-1])

    def _keep(self, frames: list[Frame]) -> None:
        self.frames = frames
        self.bytes = sum(_bytes(f) for f in frames)


def _bytes(frame: Frame) -> int:
    return sum(i.nbytes for i in frame.images if i is not None)


def views_of(frames: Iterable[Frame], motions: dict[int, Motion], rig: Rig) -> list[View]:
    """The images of frames as posed views; frames without a motion are left out."""
    out = []
    for f in frames:
        m = motions.get(f.t_ns)
        for i, image in enumerate(f.images):
            if m is not None and image is not None:
                out.append(View(f.t_ns, i, image, rig.cameras[i].camera, m.world_from_cams[i]))
    return out
