"""Choice of the keyframes: which exposures of a flight or a recording the map is made of.

Of photos every one is kept (`PhotoMapper`).
"""

from __future__ import annotations

import numpy as np

from alight.records import Motion
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
