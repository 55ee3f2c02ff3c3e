"""The data of the page's map: fields that can be unpacked, shapes in metres, footprints, GPS residuals."""

from __future__ import annotations

import base64
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from some_run import CELL, GRID, LOCAL, elevation, motions, some_run

from alight.geometry import Camera, Grid, Pose
from alight.records import Motion, PhotoFacts, PhotoRow
from alight.report import fields, shapes, survey

DOWN = np.diag([1.0, -1.0, -1.0])  # a camera that looks down, its columns to the east


def unpacked(tree: dict[str, Any]) -> np.ndarray:
    """The codes of a field, as explore.js reads them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(tree["data"])), np.uint8)
    changes = planes.reshape(tree["bytes"], -1).T.astype(np.int64) @ 256 ** np.arange(tree["bytes"])
    return np.cumsum(changes.reshape(tree["rows"], tree["cols"]), axis=1) % 256 ** tree["bytes"]


@given(seed=st.integers(0, 10**6), rows=st.integers(1, 12), cols=st.integers(1, 12), wide=st.booleans())
def test_a_field_is_read_as_it_was_written(seed: int, rows: int, cols: int, wide: bool) -> None:
    kind = np.uint16 if wide else np.uint8
    codes = np.random.default_rng(seed).integers(0, np.iinfo(kind).max, (rows, cols), kind, endpoint=True)
    field = fields.Field("some", "count", Grid(0.0, 0.0, 1.0, rows, cols), codes)
    np.testing.assert_array_equal(unpacked(fields.trees({"some": field})["some"]), codes)


@given(st.floats(1e-3, 100.0), st.floats(0.0, 0.9999))
def test_values_are_rounded_by_less_than_a_reader_sees(length: float, chance: float) -> None:
    for value, levels, worst in (
        (length, fields.lengths(), 0.03 * length),
        (chance, fields.chances(), max(0.03 * (1 - chance), 1e-5) if chance > 0.9 else 0.005),
    ):
        field = fields.measured("some", "length", Grid(0.0, 0.0, 1.0, 1, 2), np.array([[value, np.nan]]), levels)
        assert field.codes[0, 1] == 0
        assert field.values[field.codes[0, 0] - 1] == pytest.approx(value, abs=worst)


def test_heights_keep_a_centimetre_over_a_mountain() -> None:
    up = np.array([[1200.004, 1499.996, np.nan]])
    field = fields.heights("Height", Grid(0.0, 0.0, 1.0, 1, 3), up)
    np.testing.assert_allclose(field.low + (field.codes[0, :2] - 1.0) * field.step, up[0, :2], atol=0.006)
    assert field.codes[0, 2] == 0


def test_fields_that_are_too_large_get_coarser_and_keep_their_place() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (400, 600), np.uint8)
    plain = fields.Field("plain", "count", GRID, np.ones(GRID.shape, np.uint8))
    found = fields.trees(
        {"noise": replace(plain, grid=Grid(3.0, 9.0, 0.5, 400, 600), codes=noise), "plain": plain}, 20_000
    )
    assert sum(len(base64.b64decode(tree["data"])) for tree in found.values()) <= 20_000
    assert (found["plain"]["rows"], found["noise"]["rows"], found["noise"]["cell"]) == (GRID.rows, 100, 2.0)
    assert unpacked(found["noise"])[7, 11] == noise[28, 44]
    assert (found["noise"]["east"], found["noise"]["north"]) == (3.0, 9.0)


def test_coordinates_are_exact_to_a_centimetre() -> None:
    grid = Grid(-1000.0, 1500.0, 1.0, 2500, 2500)
    forms = shapes.geodetic(some_run(), grid)
    assert forms is not None
    e, n = 1.2, -0.7  # km
    terms = np.array([1, e, n, e * e, e * n, n * n])
    place = LOCAL.to_enu(terms @ forms["latitude"], terms @ forms["longitude"], LOCAL.height)
    np.testing.assert_allclose(place[:2], [1200.0, -700.0], atol=0.01)
    assert shapes.geodetic(some_run(georeferenced=False), grid) is None


def above(east: float, north: float, t_ns: int = 0) -> Motion:
    """A camera 30 m above the origin's height that looks down."""
    pose = Pose(DOWN, np.array([east, north, 30.0]))
    return Motion(t_ns, pose, (pose,), np.eye(6))


def test_footprints_lie_where_the_picture_looks() -> None:
    e = elevation()
    flat = replace(e, height=np.zeros_like(e.height), flags=np.zeros_like(e.flags))
    run = some_run(
        elevation=flat, motions=[above(4.0, -2.0), above(7.0, -2.0)],
        cameras=[Camera(101, 61, 100.0, 100.0, 50.0, 30.0)],
    )  # fmt: skip
    rings = survey.footprints(run)
    np.testing.assert_allclose(rings[0].min(axis=0), [4.0 - 15.0, -2.0 - 9.0], atol=1e-6)
    np.testing.assert_allclose(rings[0].max(axis=0), [4.0 + 15.0, -2.0 + 9.0], atol=1e-6)
    assert survey.overlap(rings) == pytest.approx(27.0 / 30.0)
    drawn = [s for s in shapes.shapes_of(run) if s.style == "footprint"]
    assert len(drawn) == 2
    assert all(s.hidden for s in drawn)


def test_pictures_of_the_sky_and_runs_without_cameras_have_no_footprint() -> None:
    sky = Pose(np.eye(3), np.array([0.0, 0.0, 30.0]))
    run = some_run(motions=[Motion(0, sky, (sky,), np.eye(6))], cameras=[Camera(101, 61, 100.0, 100.0, 50.0, 30.0)])
    assert survey.footprints(run) == []
    assert survey.footprints(some_run()) == []
    assert survey.overlap([]) is None


def test_gps_residuals_are_the_tags_against_the_pictures() -> None:
    def photo(motion: Motion, east: float, north: float) -> PhotoRow:
        tagged = motion.world_from_body.translation + np.array([east, north, 0.0])
        latitude, longitude, _ = LOCAL.to_geodetic(tagged)
        place = (float(latitude), float(longitude))
        return PhotoRow(PhotoFacts(f"{motion.t_ns}.jpg", (10, 10), "", place=place, t_ns=motion.t_ns), None)

    first, second, *_ = flown = motions()
    found = survey.gps_residuals(some_run(motions=flown, photos=[photo(first, 3.0, 0.0), photo(second, 0.0, -4.0)]))
    assert found is not None
    np.testing.assert_allclose([(p.east, p.north) for p in found.photos], [(3.0, 0.0), (0.0, -4.0)], atol=1e-3)
    assert found.rms == pytest.approx(np.sqrt(12.5), abs=1e-3)
    assert found.edge == pytest.approx(4.0, abs=1e-3)
    assert survey.gps_residuals(some_run()) is None


def test_cells_are_where_the_map_has_them() -> None:
    tree = fields.trees({"views": fields.Field("views", "count", GRID, elevation().views)})["views"]
    assert (tree["east"], tree["north"], tree["cell"]) == (GRID.east, GRID.north, CELL)
