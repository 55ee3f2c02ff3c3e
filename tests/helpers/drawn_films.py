"""Films of level ground from a camera that looks down, drawn by moving a texture, and their flights."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_photos import TEXTURE_CELL, texture
from numpy.typing import NDArray

F64 = NDArray[np.float64]
RATE = 5.0  # Hz
SIZE = 240, 180
HEIGHT, FOCAL = 30.0, 260.0  # m, px


def winding_flight(seed: int, seconds: float) -> tuple[F64, F64]:
    """(N,) complex metres east + 1j north, and (N,) courses in radians, with changes of speed and course."""
    rng = np.random.default_rng(seed)
    t, knots = np.arange(0.0, seconds, 1 / RATE), np.arange(0.0, seconds + 8.0, 4.0)
    speed = np.interp(t, knots, rng.uniform(0.0, 6.0, len(knots)))
    course = np.interp(t, knots, np.cumsum(rng.normal(0.0, 1.2, len(knots))))
    return np.cumsum(speed * np.exp(1j * course)) / RATE, course


def draw_film(path: Path, places: F64, courses: F64) -> None:
    """Write a film of (N,) places, the top of the picture along the (N,) courses."""
    ground = texture(4)
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE, SIZE)  # type: ignore[attr-defined]
    if not film.isOpened():
        pytest.skip("this OpenCV writes no mp4")
    for place, course in zip(places, courses, strict=True):
        right, down = np.exp(1j * (course - np.pi / 2)), -np.exp(1j * course)
        scale = HEIGHT / FOCAL  # m a pixel
        corner = place - scale * (right * SIZE[0] + down * SIZE[1]) / 2
        axes = np.array([[z.real, z.imag] for z in (scale * right, scale * down, corner + 60 * (1 + 1j))]).T
        picture = cv2.warpAffine(
            ground, axes / TEXTURE_CELL, SIZE, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        film.write(np.repeat(picture[:, :, None], 3, axis=2))
    film.release()


def rows_of(places: F64, start: float = 0.0, latitude: float = 45.0) -> list[tuple[float, float, float]]:
    """Seconds, latitude and longitude of places, (N,) complex metres."""
    degrees = 1 / 111_194.0
    return [
        (start + k / RATE, latitude + degrees * p.imag, 7.6 + degrees * p.real / np.cos(np.radians(latitude)))
        for k, p in enumerate(places)
    ]
