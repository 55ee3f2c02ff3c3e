"""People and cars that move, in pictures of textured ground with boxes on it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from alight.arrays import F64, U8
from alight.geometry import Camera, Pose
from alight.records import MovingBody, View
from alight.tracks import MovingWatch

CAMERA = Camera(320, 240, 240.0, 240.0, 159.5, 119.5, "none", ())
DOWN = np.diag([1.0, -1.0, -1.0])  # world_from_cam: columns of the picture to the east
CELL = 0.02  # metres
TEXTURE = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (2400, 2400)).astype(np.float32), (0, 0), 3.0)
TEXTURE = 128 + 4.0 * (TEXTURE - TEXTURE.mean())


def picture(centre: F64, boxes: list[tuple[float, float, float, float]], light: float = 1.0, seed: int = 0) -> U8:
    """A picture from `centre`, looking down; boxes: east, north, half the side, height of the top, metres."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = CAMERA.rays(np.stack([u, v], -1)) @ DOWN.T

    def at(up: float) -> F64:
        return np.asarray(centre[:2] + rays[..., :2] * ((centre[2] - up) / -rays[..., 2:]))

    ground = at(0.0) / CELL + 1200.0
    grey = cv2.remap(
        TEXTURE, *ground.transpose(2, 0, 1).astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    for east, north, half, top in boxes:
        for up in np.linspace(0.0, top, 20):
            inside = (np.abs(at(up) - [east, north]) < half).all(axis=-1)
            grey = np.where(inside, 40.0, grey)
    noise = np.random.default_rng(seed).normal(0, 2.0, grey.shape)
    return np.asarray(np.clip(light * grey + noise, 0, 255), np.uint8)


def flown(
    height: float, walks: tuple[float, float] | None, stands: bool = False, speed: float = 0.0, shake: float = 0.0
) -> list[tuple[MovingBody, ...]]:
    """What is found in ten exposures of a descent, with somebody who walks by, and with a box that stands."""
    watch, rng, out = MovingWatch(), np.random.default_rng(1), list[tuple[MovingBody, ...]]()
    for k in range(10):
        t = 0.2 * k
        centre = np.array([speed * t, 0.1 * np.sin(t), height - 0.5 * t])
        boxes = [(0.2 * height, 0.1 * height, 0.3, 0.3 * height)] if stands else []
        if walks is not None:
            boxes.append((-0.25 * height + walks[0] * t, walks[1] * t, 0.25, min(1.7, 0.6 * height)))
        image = picture(centre, boxes, 1.0 + 0.02 * k, k)
        pose = Pose(cv2.Rodrigues(rng.normal(0, shake, 3))[0] @ DOWN, centre + rng.normal(0, shake * height, 3))
        out.append(watch.feed(View(round(t * 1e9), 0, image, CAMERA, pose), 0.0))
    return out


@pytest.mark.parametrize("height", [15.0, 8.0, 4.0, 2.5])
def test_somebody_who_walks_is_found_within_half_a_second(height: float) -> None:
    found = flown(height, (1.4, 0.3), shake=0.001)
    assert any(found[2:5])
    where = [m for movers in found for m in movers]
    assert all(abs(m.place[1]) < 2.0 for m in where)
    steady = [m.velocity for movers in found[4:] for m in movers if np.linalg.norm(m.velocity) > 0]
    assert 1.2 < np.median([v[0] for v in steady]) < 3.0  # on the ground, a head moves faster than its feet


@pytest.mark.parametrize(
    ("height", "speed"), [(30.0, 0.4), (15.0, 0.4), (8.0, 0.4), (4.0, 0.4), (4.0, 0.0), (2.5, 0.0)]
)
def test_what_stands_is_explained_by_its_height(height: float, speed: float) -> None:
    """The light changes as well, and the poses are off by more than a walker's step in pixels."""
    assert not any(flown(height, None, stands=True, speed=speed, shake=0.001))


def test_pictures_too_far_apart_are_not_compared() -> None:
    assert not any(flown(4.0, (1.4, 0.0), speed=8.0))


def test_a_camera_on_the_ground_finds_nobody() -> None:
    watch, pose = MovingWatch(), Pose(DOWN, np.array([0.0, 0.0, 0.1]))
    assert watch.feed(View(0, 0, np.zeros((240, 320), np.uint8), CAMERA, pose), 0.2) == ()
