"""Keyframes: which exposures the map is made of, and their pixels as long as the mapping lane may need them.

Of photos every one is kept (`PhotoMapper`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from alight.pipeline.map_frame import MapFrame
from alight.records import Frame, Motion, Rig, View
from alight.settings import StageSettings


def is_keyframe(
    motion: Motion, last: Motion | None, ground: float | None, first_step: float, settings: StageSettings
) -> bool:
    """Whether an exposure is a keyframe of the map: its camera moved far enough since the last one, or turned.

    Args:
        motion: of the exposure.
        last: motion of the last keyframe; None: there is none.
        ground: metres above the origin, height of the ground; None: not known, and `first_step` metres are far enough.
    """
    if last is None:
        return True
    step = first_step
    if ground is not None:
        above = motion.world_from_body.translation[2] - ground
        step = settings.parallax.keyframe_baseline * max(above, 1.0)
    a, b = last.world_from_cams[0], motion.world_from_cams[0]
    axis = float(np.clip(a.rotation[:, 2] @ b.rotation[:, 2], -1, 1))
    moved = np.linalg.norm(a.translation - b.translation) >= step
    return bool(moved or np.arccos(axis) >= settings.mapping.turn)


@dataclass(frozen=True, eq=False)
class Keyframe:
    """An exposure that is kept, and its motion as it was in flight."""

    frame: Frame
    motion: Motion | None  # None: it comes at the end of the recording

    @property
    def bytes(self) -> int:
        """Bytes of its pixels."""
        return sum(i.nbytes for i in self.frame.images if i is not None)


class FrameStore:
    """Frames that are kept, oldest first."""

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self.bytes = 0
        self.taken = 0  # frames that were ever kept
        self.last: Motion | None = None  # of the newest frame kept; None: there is none

    def __len__(self) -> int:
        return len(self.keyframes)

    def keep(self, frame: Frame, motion: Motion | None = None) -> None:
        """Keep a frame."""
        self.keyframes.append(Keyframe(frame, motion))
        self.bytes += self.keyframes[-1].bytes
        self.taken += 1
        self.last = motion or self.last

    def drop_oldest(self, count: int) -> None:
        """Forget the first `count` frames."""
        self._set(self.keyframes[count:])

    def clear(self) -> None:
        """Forget all frames."""
        self._set([])
        self.last = None

    def thin(self) -> None:
        """Forget every second frame, the newest not."""
        self._set(self.keyframes[::-2][::-1])

    def _set(self, keyframes: list[Keyframe]) -> None:
        self.keyframes = keyframes
        self.bytes = sum(k.bytes for k in keyframes)


def views_of(keyframes: Iterable[Keyframe], rig: Rig, newer: Mapping[int, Motion] | None = None) -> list[View]:
    """The images of keyframes as posed views, with a motion in `newer` in place of their own; none without a motion."""
    out = []
    for k in keyframes:
        motion = k.motion if newer is None else newer.get(k.frame.t_ns, k.motion)
        for i, image in enumerate(k.frame.images):
            if motion is not None and image is not None:
                at = motion.world_from_cams[i]
                out.append(View(k.frame.t_ns, i, image, rig.cameras[i].camera, at, motion.rolling, motion.gain))
    return out


def with_motions(keyframes: Iterable[Keyframe], motions: Mapping[int, Motion]) -> list[Keyframe]:
    """Keyframes at the times of these motions, with the motion."""
    return [Keyframe(k.frame, motions[k.frame.t_ns]) for k in keyframes if k.frame.t_ns in motions]


def in_world(keyframes: Sequence[Keyframe]) -> list[Keyframe]:
    """Keyframes with their motion in the world: each map frame is placed by the newest of its keyframes."""
    frames = {k.motion.frame_id: MapFrame.of(k.motion) for k in keyframes if k.motion is not None}
    return [Keyframe(k.frame, k.motion and frames[k.motion.frame_id].motion(k.motion)) for k in keyframes]
