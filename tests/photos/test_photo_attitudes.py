"""Attitude tags that cannot be attitudes are dropped for the whole set."""

from __future__ import annotations

from pathlib import Path

import pytest

from alight.photos.reading.photo_pose import photo_attitude, with_attitudes_settled
from alight.photos.reading.photo_tags import PhotoTags, Position

STRAIGHT = [(45.0 + 1e-4 * k, 7.6) for k in range(4)]
TURNING = [*STRAIGHT[:2], (45.0001, 7.6002), (45.0, 7.6002)]
GIMBAL, FLIGHT = "dji:Gimbal{}Degree", "dji:Flight{}Degree"


def photos(angles: list[tuple[float, float, float]], path: list[tuple[float, float]], pattern: str) -> list[PhotoTags]:
    out = []
    for k, (values, place) in enumerate(zip(angles, path, strict=False)):
        xmp = {pattern.format(n): f"{v:+.2f}" for n, v in zip(("Yaw", "Pitch", "Roll"), values, strict=True)}
        xmp |= {FLIGHT.format(n): v for n, v in (("Yaw", f"{80 + k}"), ("Pitch", "1"), ("Roll", "2"))}
        out.append(PhotoTags(Path(f"{k}.jpg"), (64, 48), {}, {}, xmp, settled=Position(place, 350.0, "")))
    return out


@pytest.mark.parametrize("pattern", [GIMBAL, "parrot:Camera{}Degree", "camera:{}"])
@pytest.mark.parametrize(
    ("angles", "path", "used"),
    [
        ([(0, 0, 0)] * 4, STRAIGHT, False),
        ([(0, 0, 0)] * 2, STRAIGHT, True),  # of two photos
        ([(0, -0.0, 0)] * 4, STRAIGHT, False),
        ([(90, -90, 0)] * 4, STRAIGHT, True),
        ([(90, -90, 0)] * 4, TURNING, False),
        ([(0, -90, 0)] * 3 + [(0, -89.9, 0)], TURNING, True),
        ([(0, 0, 0)] * 3 + [(10, 0, 0)], STRAIGHT, True),
    ],
)
def test_zero_and_constant_angles(
    pattern: str, angles: list[tuple[float, float, float]], path: list[tuple[float, float]], used: bool
) -> None:
    found, warnings = with_attitudes_settled(photos(angles, path, pattern))
    kinds = {photo_attitude(p)[1] for p in found}
    assert ("flight" in kinds) != used
    assert bool(warnings) != used


def test_the_warning_names_the_tags() -> None:
    zero = with_attitudes_settled(photos([(0, 0, 0)] * 4, STRAIGHT, GIMBAL))[1]
    same = with_attitudes_settled(photos([(5, 0, 0)] * 4, TURNING, GIMBAL))[1]
    assert zero == ["the angles dji:Gimbal are 0 in all photos: they are not used"]
    assert same == ["the angles dji:Gimbal are the same, although the flight turned, in all photos: they are not used"]
