"""Limits of a lens's parameters: beyond them lie only typing errors and damaged tags."""

from __future__ import annotations

from alight.geometry import Camera

FOCAL = (0.05, 100.0)  # image widths
CENTRE = (-1.0, 2.0)  # image widths
LARGEST_COEFFICIENT = 1e4


def why_no_lens(camera: Camera) -> str | None:
    """Reason why a lens is impossible; None: it is possible."""
    wide = max(camera.width, camera.height)
    for f in (camera.fu, camera.fv):
        if not FOCAL[0] * wide <= f <= FOCAL[1] * wide:
            return f"a focal length of {f:g} pixels for images {camera.width} pixels wide"
    for c in (camera.cu, camera.cv):
        if not CENTRE[0] * wide <= c <= CENTRE[1] * wide:
            return f"a principal point at {c:g} pixels in images {camera.width} pixels wide"
    worst = max(camera.distortion, key=abs, default=0.0)
    return f"a distortion of {worst:g}" if abs(worst) > LARGEST_COEFFICIENT else None
