"""Zones: distances to their borders, and the room that a region leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from alight.geometry.zones import EVERYWHERE, Region, Zone, united

SQUARE = np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]])  # with level edges
HOLE = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])
CIRCLE = shapely.Point(3.0, 4.0)
ARROW = np.array([[0.0, 0.0], [8.0, 6.0], [0.0, 4.0], [-8.0, 6.0]])  # not convex


@pytest.mark.parametrize(
    ("zone", "point", "depth"),
    [
        (Zone("", CIRCLE, True, 2.0), (0.0, 0.0), -3.0),
        (Zone("", CIRCLE, True, 2.0), (3.0, 3.5), 1.5),
        (Zone("", shapely.Polygon(SQUARE), True), (9.0, 0.0), 1.0),
        (Zone("", shapely.Polygon(SQUARE), True), (0.0, 10.0), 0.0),
        (Zone("", shapely.Polygon(SQUARE), True), (13.0, 14.0), -5.0),
        (Zone("", shapely.Polygon(SQUARE, [HOLE]), True), (0.0, 0.5), -1.5),
        (Zone("", shapely.Polygon(SQUARE, [HOLE]), True), (0.0, 5.0), 3.0),
        (Zone("", shapely.Polygon(ARROW), True), (0.0, 5.0), -math.sqrt(16 / 17)),  # in the notch, 1 m above its corner
        (Zone("", shapely.Polygon(ARROW[::-1]), True), (0.0, 2.0), 1.6),
        (Zone("", shapely.LineString([(0.0, 0.0), (9.0, 0.0)]), True, 3.0), (5.0, 2.0), 1.0),  # a road
        (Zone("", shapely.Polygon(SQUARE), True, 2.0), (11.0, 0.0), 1.0),
        (
            united("", [Zone("", shapely.Polygon(HOLE), True), Zone("", shapely.box(-5, -5, 5, 5), True)]),
            (0.0, 1.0),
            4.0,
        ),
    ],
)
def test_the_depth_of_a_point(zone: Zone, point: tuple[float, float], depth: float) -> None:
    assert zone.depth(np.array([point]))[0] == pytest.approx(depth, abs=1e-9)


def test_a_polygon_agrees_with_points_along_its_border() -> None:
    rng = np.random.default_rng(0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    radii = rng.uniform(4.0, 12.0, 12)
    ring = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)  # every ray leaves it once
    border = np.concatenate([np.linspace(a, b, 400) for a, b in zip(ring, np.roll(ring, -1, 0), strict=True)])
    points = rng.uniform(-13.0, 13.0, (100, 2))
    found = Zone("", shapely.Polygon(ring), True).depth(points)
    away = np.linalg.norm(points[:, None] - border, axis=2)
    np.testing.assert_allclose(np.abs(found), away.min(axis=1), atol=0.02)
    turns = np.abs(np.angle(np.exp(1j * (np.arctan2(*border.T[::-1]) - np.arctan2(*points.T[::-1])[:, None]))))
    there = np.linalg.norm(border, axis=1)[turns.argmin(axis=1)]  # border in the direction of each point
    clear = np.abs(found) > 0.1
    np.testing.assert_array_equal((found > 0)[clear], (np.linalg.norm(points, axis=1) < there)[clear])


def test_a_region_has_the_room_of_its_tightest_zone() -> None:
    pond = Zone("pond", shapely.Point(4.0, 0.0), False, 1.0)
    region = Region((Zone("yard", shapely.Polygon(SQUARE), True), pond))
    points = np.array([[-8.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 12.0]])
    for point, room in zip(points[:2], (2.0, 1.0), strict=True):
        assert region.has_room(point, point, room)
        assert not region.has_room(point, point, room + 1e-9)
    assert not any(region.has_room(point, point, 0.01) for point in points[2:])
    np.testing.assert_array_equal(region.with_room(points, 0.999), [True, True, False, False])
    np.testing.assert_array_equal(region.with_room(points, 1.001), [True, False, False, False])
    assert [region.limit(point) for point in points] == ["yard", "pond", "pond", "yard"]
    assert region.has_room(points[0], points[1], 1.0)
    assert not region.has_room(points[1], np.array([6.0, 0.0]), 0.1)  # both ends have room, and the pond lies between
    assert EVERYWHERE.has_room(points[0], points[3], 99.0)
    assert EVERYWHERE.with_room(points, 99.0).all()
    assert EVERYWHERE.limit(points[0]) == ""
