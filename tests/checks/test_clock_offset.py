"""The offset between the clocks of pictures and log, from drawn motions of pictures over level ground."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from alight.arrays import F64
from alight.checks.clock_offset import ClockOffset, find_offset
from alight.checks.evidence import CameraEvidence, ImuTable, NavTable
from alight.checks.features import PictureFlow
from alight.geometry import Camera, Pose

LENS = Camera(240, 180, 180.0, 180.0, 119.5, 89.5)
DOWN = Pose(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.zeros(3))
HEIGHT = 20.0  # m, of the aircraft above the ground
STEP = 0.05  # s


@cache
def motion(kind: str, seconds: float = 120.0) -> tuple[F64, F64, F64, Rotation]:
    """Times, positions, velocities and attitudes: gusts are random, and smoothed over 0.3 s."""
    t = np.arange(0.0, seconds, STEP)
    rng = np.random.default_rng(7)

    def wander(sigma: float) -> F64:
        width = round(0.3 / STEP)
        white = rng.standard_normal((len(t) + width - 1, 3))
        return np.stack([np.convolve(c, np.ones(width) / np.sqrt(width), "valid") for c in white.T], -1) * sigma

    if kind == "gusts":
        angles, v = wander(0.03) + np.outer(t, [0, 0, 0.05]), wander(0.3) + np.array([3.0, 0.0, 0.0])
    elif kind == "straight":
        angles, v = np.zeros((len(t), 3)), np.tile([3.0, 0.0, 0.0], (len(t), 1))
    elif kind == "sprints":  # no turn: only the speed changes
        angles, v = np.zeros((len(t), 3)), np.outer(3.0 + 0.7 * wander(1.0)[:, 0], [1.0, 0.0, 0.0])
    elif kind == "circles":  # every 20 s the same
        angles, v = np.outer(t, [0, 0, 2 * np.pi / 20.0]), np.tile([0.0, 0.0, 0.0], (len(t), 1))
        v[:, :2] = 3.0 * np.stack([np.cos(angles[:, 2]), np.sin(angles[:, 2])], axis=-1)
    else:  # hover
        angles, v = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    steps = 0.5 * (v[1:] + v[:-1]) * STEP
    return t, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), v, Rotation.from_euler("xyz", angles)


def drawn(kind: str, begin: float, length: float, offset_ns: int, gyroscope: bool = True) -> ClockOffset:
    """Draw the homographies of pictures from `begin`, stamped late by an offset, and find it from the whole log."""
    t, p, v, attitude = motion(kind)
    rng = np.random.default_rng(1)
    camera = CameraEvidence(LENS)
    for k in range(round(begin / STEP), round((begin + length) / STEP), 2):
        a, b = (attitude[i].as_matrix() @ DOWN.rotation for i in (k, k + 2))
        turn, way = b.T @ a, b.T @ (p[k] - p[k + 2])
        H = turn + np.outer(way, a.T @ [0.0, 0.0, -1.0]) / HEIGHT + 1e-4 * rng.standard_normal((3, 3))
        stamps = (int(t[i] * 1e9) + offset_ns for i in (k, k + 2))
        camera.flows.append(PictureFlow(*stamps, H / H[2, 2], np.zeros(2), 1.0))  # type: ignore[arg-type]
    blank, t_ns = np.full((len(t), 3), np.nan), (t * 1e9).astype(np.int64)
    nav = NavTable(t_ns, p, attitude.as_matrix(), v, blank, blank, blank, blank)
    rates = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / STEP
    # a rate at the middle of a step, as the trapezoids of the integration want it
    middle = t_ns[:-1] + round(STEP * 5e8)
    imu = ImuTable(middle, rates, np.zeros((len(rates), 3)))
    return find_offset(camera, DOWN, nav, imu if gyroscope else ImuTable.of([]))


@pytest.mark.parametrize("gyroscope", [True, False])
@pytest.mark.parametrize("offset_ns", [0, 37_123_456_789, -60_000_000_000, 1_700_000_000_123_000_000])
def test_clocks_that_are_far_apart_are_brought_together(offset_ns: int, gyroscope: bool) -> None:
    found = drawn("gusts", 50.0, 12.0, offset_ns, gyroscope)
    assert not found.unclear
    assert found.seconds == pytest.approx(1e-9 * offset_ns, abs=0.01)
    assert found.sigma < 0.01


def test_a_flight_without_turns_is_found_by_its_speed() -> None:
    found = drawn("sprints", 50.0, 20.0, 12_000_000_000)
    assert not found.unclear
    assert found.seconds == pytest.approx(12.0, abs=0.01)


@pytest.mark.parametrize("kind", ["straight", "circles", "hover"])
def test_an_offset_that_the_pictures_do_not_show_is_unclear(kind: str) -> None:
    assert drawn(kind, 50.0, 12.0, 5_000_000_000).unclear


def test_pictures_of_another_flight_are_unclear() -> None:
    t, p, v, attitude = motion("gusts")
    other = motion("sprints")
    assert len(other[0]) == len(t)
    log = NavTable(
        (t * 1e9).astype(np.int64), p, attitude[::-1].as_matrix(), v[::-1] * [-1.0, 1.0, 1.0],
        *(np.full((len(t), 3), np.nan) for _ in range(4)),
    )  # fmt: skip
    camera = CameraEvidence(LENS)
    for k in range(1000, 1250, 2):
        a, b = (attitude[i].as_matrix() @ DOWN.rotation for i in (k, k + 2))
        H = b.T @ a + np.outer(b.T @ (p[k] - p[k + 2]), a.T @ [0.0, 0.0, -1.0]) / HEIGHT
        camera.flows.append(PictureFlow(k * 50_000_000, (k + 2) * 50_000_000, H / H[2, 2], np.zeros(2), 1.0))
    assert find_offset(camera, DOWN, log, ImuTable.of([])).unclear
