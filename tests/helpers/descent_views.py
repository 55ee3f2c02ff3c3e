"""Views of smooth hilly ground with texture at every scale, from a height of 100 m down to that of a blade of grass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose, so3_exp
from alight.records import View

F64 = NDArray[np.float64]
LENS = Camera(240, 180, 225.0, 225.0, 119.5, 89.5)
DOWN = np.diag([1.0, -1.0, -1.0])
_RAYS = LENS.rays(np.stack(np.meshgrid(np.arange(240.0), np.arange(180.0)), axis=-1))
FINEST, OCTAVES = 0.02, 12  # metres of the finest blob, and how often it doubles


def surface(east: F64, north: F64) -> F64:
    """Height in metres: hills, and humps that are only visible from near."""
    hills = 0.8 * np.sin(east / 17.0) * np.cos(north / 13.0)
    return np.asarray(hills + 0.12 * np.sin(east / 1.9 + 0.3) * np.sin(north / 1.5))


@cache
def _noise(octave: int) -> NDArray[np.float32]:
    rough = np.random.default_rng([7, octave]).normal(0, 1, (128, 128)).astype(np.float32)
    smooth = cv2.GaussianBlur(np.tile(rough, (2, 2)), (0, 0), 0.8)[64:192, 64:192]
    return np.ascontiguousarray(np.tile(smooth / smooth.std(), (2, 2)))


def paint(east: F64, north: F64, pixel: float) -> F64:
    """Grey level of the texture; detail finer than `pixel` metres is left out."""
    out = np.full(east.shape, 128.0)
    for k in range(OCTAVES):
        size = FINEST * 2.0**k
        if size > pixel:
            x, y = (np.mod(v / size, 128.0).astype(np.float32) for v in (east, north))
            out += 12.0 * cv2.remap(_noise(k), x, y, cv2.INTER_LINEAR)
    return out


def look(place: Sequence[float], k: int, yaw: float = 0.0, sway: float = 0.02) -> View:
    """View of a camera from a place, swaying a little."""
    tilt = sway * np.array([np.sin(1.3 * k), np.cos(2.1 * k), np.sin(0.7 * k)])
    pose = Pose(so3_exp(tilt) @ so3_exp([0.0, 0.0, yaw]) @ DOWN, np.asarray(place, dtype=np.float64))
    rays = _RAYS @ pose.rotation.T
    height = np.zeros(rays.shape[:2])
    for _ in range(6):  # slopes are gentle: it contracts
        at = pose.translation + rays * ((height - pose.translation[2]) / rays[..., 2])[..., None]
        height = surface(at[..., 0], at[..., 1])
    grey = paint(at[..., 0], at[..., 1], float(pose.translation[2] / LENS.fu))
    grey += np.random.default_rng([3, k]).normal(0, 1.0, grey.shape)
    return View(k * 100_000_000, 0, np.clip(np.round(grey), 0, 255).astype(np.uint8), LENS, pose)


def descent(high: float, low: float, share: float = 0.05, slope: float = 1.0) -> Iterator[View]:
    """Keyframes on the way down, `share` of the height apart; it sinks by `slope` for each metre ahead."""
    k, place = 0, np.array([-0.5 * (high - low) / slope, 0.0, high])
    while place[2] > low:
        yield look(place, k)
        step = share * place[2] / np.hypot(1.0, slope)
        place, k = place + np.array([step, 0.02 * step, -slope * step]), k + 1


def level_flight(count: int, up: float, start: float = 0.0, first: int = 0, share: float = 0.04) -> list[View]:
    """Keyframes at one height."""
    return [look([start + share * up * k, 0.01 * up * np.sin(k), up], first + k) for k in range(count)]
