"""The ground floor: rotations, poses, cameras, geodesy and the world grid, by properties and by outside tools."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lenses import LENSES, each_lens
from numpy.testing import assert_allclose
from pyproj import CRS, Transformer
from scipy.linalg import expm
from scipy.spatial.transform import Rotation, Slerp

from alight.geometry import (
    Camera,
    Grid,
    LocalFrame,
    Pose,
    enu_from_flu,
    ground_projection,
    matrix_from_quaternion,
    quaternion_from_matrix,
    skew,
    slerp,
    so3_exp,
    so3_log,
)

number = st.floats(-1.0, 1.0, allow_subnormal=False)
vector = st.tuples(number, number, number).map(np.array)
axis = vector.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
# from zero to half a turn, with both ends, at which formulas are singular
angle = st.one_of(
    st.floats(0.0, np.pi), st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 0.999e-6, 1.001e-6, 1e-3, 0.03, np.pi])
)
near_pi = st.floats(1e-12, 1e-3).map(lambda e: np.pi - e)
rotation = st.tuples(axis, angle).map(lambda p: so3_exp(p[0] * p[1]))
pose = st.tuples(rotation, vector).map(lambda p: Pose(p[0], 100 * p[1]))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of the rotation from a to b, exact near zero (the arc cosine of the trace is not)."""
    return float(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / np.sqrt(8))))


# -- rotations


@given(axis, angle)
def test_exp_is_a_rotation_and_the_matrix_exponential(a: np.ndarray, t: float) -> None:
    R = so3_exp(a * t)
    assert_allclose(R @ R.T, np.eye(3), atol=4e-15)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=4e-15)
    assert_allclose(R, expm(skew(a * t)), atol=2e-14)


@given(axis, angle)
@example(np.array([0.6, 0.0, 0.8]), 1e-6)
def test_log_undoes_exp(a: np.ndarray, t: float) -> None:
    w = so3_log(so3_exp(a * t))
    assert np.linalg.norm(w) <= np.pi + 1e-15
    if t < np.pi - 1e-6:
        assert_allclose(w, a * t, atol=2e-9 * max(t, 1e-6))
    else:  # half a turn about an axis is half a turn about its opposite
        assert min(np.linalg.norm(w - a * t), np.linalg.norm(w + a * t)) < 2e-6


@given(axis, near_pi)
def test_log_near_half_a_turn_keeps_axis_and_angle(a: np.ndarray, t: float) -> None:
    R = so3_exp(a * t)
    w = so3_log(R)
    assert angle_between(so3_exp(w), R) < 1e-12
    assert np.linalg.norm(w) == pytest.approx(t, abs=1e-9)
    assert abs(w @ a) == pytest.approx(t, abs=1e-9)


@given(axis, st.floats(1e-14, 1e-4))
def test_log_near_nothing_keeps_its_relative_precision(a: np.ndarray, t: float) -> None:
    assert_allclose(so3_log(so3_exp(a * t)), a * t, atol=1e-9 * t + 1e-30)


def test_no_rotation_has_no_vector() -> None:
    assert_allclose(so3_log(np.eye(3)), 0.0)
    assert_allclose(so3_exp([0.0, 0.0, 0.0]), np.eye(3))


def test_batches_of_rotations_are_those_of_one() -> None:
    """Exponential, logarithm and cross product agree, also for zero, tiny angles and nearly half a turn."""
    rng = np.random.default_rng(0)
    w = rng.normal(size=(40, 3))
    w *= (np.geomspace(1e-12, np.pi - 1e-6, 40) / np.linalg.norm(w, axis=1))[:, None]
    w[0] = 0.0
    assert_allclose(so3_exp(w), [so3_exp(v) for v in w], atol=2e-15)
    assert_allclose(so3_log(so3_exp(w)), [so3_log(so3_exp(v)) for v in w], atol=1e-9)
    assert_allclose(skew(w.reshape(8, 5, 3))[3, 2], skew(w[17]))
    assert so3_exp(np.zeros((0, 3))).shape == (0, 3, 3)


@given(vector, vector)
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)


@given(axis, angle)
def test_quaternion_round_trip_and_outside_opinion(a: np.ndarray, t: float) -> None:
    R = so3_exp(a * t)
    q = quaternion_from_matrix(R)
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1.0)
    assert_allclose(matrix_from_quaternion(q), R, atol=1e-14)
    assert_allclose(matrix_from_quaternion(-3.0 * q), R, atol=1e-14)  # sign and length have no effect
    assert abs(q @ Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [1e-12, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_what_is_no_quaternion_is_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        matrix_from_quaternion(bad)


@given(rotation, axis, st.floats(0.0, 3.1), st.floats(0.0, 1.0))
def test_slerp_turns_evenly_along_the_shortest_arc(a: np.ndarray, about: np.ndarray, t: float, s: float) -> None:
    b = a @ so3_exp(about * t)
    assert_allclose(slerp(a, b, 0.0), a, atol=1e-14)
    assert_allclose(slerp(a, b, 1.0), b, atol=1e-12)
    between = slerp(a, b, s)
    assert angle_between(a, between) == pytest.approx(s * t, abs=1e-9)
    assert_allclose(between, Slerp([0, 1], Rotation.from_matrix([a, b]))(s).as_matrix(), atol=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_yaw_pitch_roll_are_those_of_aviation(yaw: float, pitch: float, roll: float) -> None:
    R = enu_from_flu(yaw, pitch, roll)
    forward, left = R[:, 0], R[:, 1]
    assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert forward[2] == pytest.approx(np.sin(pitch))  # nose up
    assert_allclose(forward[:2], np.cos(pitch) * np.array([np.sin(yaw), np.cos(yaw)]), atol=1e-14)  # from north
    assert left[2] == pytest.approx(np.sin(roll) * np.cos(pitch))  # rolled right: the left side rises


# -- poses


@given(pose, pose, pose, vector)
def test_poses_are_a_group(a: Pose, b: Pose, c: Pose, x: np.ndarray) -> None:
    assert_allclose((a @ a.inverse).matrix, np.eye(4), atol=1e-12)
    assert_allclose((a.inverse @ a).matrix, np.eye(4), atol=1e-12)
    assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=1e-11)
    assert_allclose((a @ b).apply(x), a.apply(b.apply(x)), atol=1e-11)
    assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-11)


@given(pose, st.lists(vector, min_size=1, max_size=5))
def test_a_pose_keeps_distances(a: Pose, xs: list[np.ndarray]) -> None:
    X = np.array(xs)
    Y = a.apply(X)
    assert Y.shape == X.shape
    assert_allclose(np.linalg.norm(Y - Y[0], axis=1), np.linalg.norm(X - X[0], axis=1), atol=1e-11)
    assert_allclose(a.inverse.apply(Y), X, atol=1e-11)


@given(pose)
def test_a_pose_survives_matrix_and_quaternion(a: Pose) -> None:
    assert_allclose(Pose.from_matrix(a.matrix).matrix, a.matrix, atol=1e-14)
    assert_allclose(Pose.from_quaternion(a.quaternion, a.translation).matrix, a.matrix, atol=1e-14)


def test_a_rounded_matrix_is_made_orthonormal() -> None:
    rounded = np.round(Pose(so3_exp([0.3, -0.2, 2.0]), np.array([1.0, 2.0, 3.0])).matrix, 4)
    made = Pose.from_matrix(rounded)
    assert_allclose(made.rotation @ made.rotation.T, np.eye(3), atol=1e-14)
    assert_allclose(made.matrix, rounded, atol=1e-4)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda M: M[:3], "4x4"),
        (lambda M: np.where(M == 5, np.nan, M), "finite"),
        (lambda M: M @ np.diag([1.01, 1, 1, 1]), "not a rotation"),
        (lambda M: M @ np.diag([-1, 1, 1, 1]), "not a rotation"),  # a mirror has an orthonormal matrix too
        (lambda M: np.vstack([M[:3], [0, 0, 0.1, 1]]), "last row"),
        (lambda M: M.T, "last row"),  # written by columns
    ],
)
def test_what_is_no_rigid_motion_is_refused(spoil: object, why: str) -> None:
    M = Pose(so3_exp([0.1, 0.2, 0.3]), np.array([5.0, 1.0, 1.0])).matrix
    with pytest.raises(ValueError, match=why):
        Pose.from_matrix(spoil(M))  # type: ignore[operator]


def test_a_pose_cannot_be_changed_through_its_parts() -> None:
    t = np.zeros(3)
    a = Pose(np.eye(3), t)
    t[0] = 1.0
    assert a.translation[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        a.rotation[0, 0] = 2.0
    with pytest.raises(ValueError, match="shape"):
        Pose(np.eye(4), t)


@given(pose, pose, st.floats(0.0, 1.0))
def test_interpolation_goes_straight(a: Pose, b: Pose, t: float) -> None:
    between = a.interpolate(b, t)
    assert_allclose(between.translation, a.translation + t * (b.translation - a.translation), atol=1e-11)
    assert angle_between(a.rotation, between.rotation) <= angle_between(a.rotation, b.rotation) + 1e-9


# -- cameras


def all_over(camera: Camera, step: float = 20.0) -> np.ndarray:
    """Pixels up to and beyond the border, fractions included."""
    u, v = np.meshgrid(np.arange(-0.5, camera.width, step), np.arange(-0.5, camera.height, step))
    return np.stack([u, v], axis=-1)


@each_lens
def test_rays_and_projection_undo_each_other(camera: Camera) -> None:
    pixels = all_over(camera)
    rays = camera.rays(pixels)
    assert rays.shape == (*pixels.shape[:-1], 3)
    assert_allclose(rays[..., 2], 1.0)
    for depth in (0.1, 40.0):
        assert_allclose(camera.project(rays * depth), pixels, atol=1e-7)


@each_lens
def test_undistort_undoes_distort(camera: Camera) -> None:
    ideal = camera.rays(all_over(camera))[..., :2]
    assert_allclose(camera.undistort(camera.distort(ideal)), ideal, atol=1e-9)


@each_lens
def test_the_principal_ray_meets_the_principal_point(camera: Camera) -> None:
    assert_allclose(camera.project([0.0, 0.0, 3.0]), [camera.cu, camera.cv], atol=1e-9)


@each_lens
def test_nothing_behind_the_camera_is_seen(camera: Camera) -> None:
    assert np.isnan(camera.project([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]])).all()


@each_lens
@pytest.mark.parametrize("factor", [0.5, 0.25, 2.0])
def test_a_scaled_camera_keeps_its_rays(camera: Camera, factor: float) -> None:
    """Pixel centres are at integers: pixel u of the large image lies at (u + 0.5) f - 0.5 of the small one."""
    small = camera.scaled(factor)
    pixels = all_over(camera)
    assert (small.width, small.height) == (camera.width * factor, camera.height * factor)
    assert_allclose(small.rays((pixels + 0.5) * factor - 0.5), camera.rays(pixels), atol=1e-9)


def test_a_halved_camera_looks_through_the_middle_of_four_pixels() -> None:
    camera = LENSES["none"]
    assert_allclose(camera.scaled(0.5).rays([10.0, 7.0]), camera.rays([20.5, 14.5]), atol=1e-12)


def test_models_without_distortion_are_the_pinhole() -> None:
    plain = Camera(640, 480, 512.0, 508.0, 321.3, 236.8)
    zero = Camera(640, 480, 512.0, 508.0, 321.3, 236.8, "radial-tangential", (0.0, 0.0, 0.0, 0.0))
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 5], (50, 3))
    homogeneous = points @ plain.K.T
    assert_allclose(plain.project(points), homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-10)
    assert_allclose(zero.project(points), plain.project(points), atol=1e-10)


def test_lenses_agree_with_opencv() -> None:
    import cv2

    points = np.random.default_rng(1).uniform([-0.8, -0.6, 1], [0.8, 0.6, 1.5], (80, 3))
    for name in ("radial-tangential", "five numbers"):
        c = LENSES[name]
        theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), c.K, np.array(c.distortion))
        assert_allclose(c.project(points), theirs[:, 0], atol=1e-9)
    c = LENSES["equidistant"]
    theirs, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), c.K, np.array(c.distortion))
    assert_allclose(c.project(points), theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"fu": 0.0}, "positive"),
        ({"fv": -5.0}, "positive"),
        ({"width": 0}, "positive"),
        ({"cu": np.nan}, "finite"),
        ({"model": "fov"}, "unknown distortion model 'fov'"),
        ({"model": "radial-tangential", "distortion": (0.1,)}, "takes"),
        ({"model": "none", "distortion": (0.1,)}, "takes"),
        ({"model": "equidistant", "distortion": (0.1, 0, 0, np.inf)}, "finite"),
    ],
)
def test_what_is_no_camera_is_refused(change: dict[str, object], why: str) -> None:
    numbers = {"width": 640, "height": 480, "fu": 500.0, "fv": 500.0, "cu": 320.0, "cv": 240.0}
    with pytest.raises(ValueError, match=why):
        Camera(**(numbers | change))  # type: ignore[arg-type]


# -- geodesy

places = st.tuples(st.floats(-89.0, 89.0), st.floats(-179.9, 179.9), st.floats(-300.0, 5000.0))
offset = st.tuples(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-500.0, 500.0)).map(np.array)


@given(places, offset)
def test_geodetic_and_local_undo_each_other(origin: tuple[float, float, float], enu: np.ndarray) -> None:
    frame = LocalFrame(*origin)
    assert_allclose(frame.to_enu(*frame.to_geodetic(enu)), enu, atol=2e-6)
    assert_allclose(frame.to_enu(*origin), 0.0, atol=1e-9)


@given(places, offset)
@settings(max_examples=25)
def test_local_coordinates_are_those_of_proj(origin: tuple[float, float, float], enu: np.ndarray) -> None:
    """The conversion agrees with PROJ's pipeline from geodetic to topocentric to a tenth of a millimetre."""
    lat, lon, up = origin
    frame = LocalFrame(*origin)
    there = frame.to_geodetic(enu)
    proj = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat!r} +lon_0={lon!r} +h_0={up!r}"
    )
    theirs = np.array(proj.transform(float(there[1]), float(there[0]), float(there[2])))
    assert_allclose(theirs, enu, atol=1e-4)


def test_earth_centred_coordinates_are_those_of_proj() -> None:
    """The chord between two places has the same length in both frames."""
    rng = np.random.default_rng(3)
    lat, lon, up = rng.uniform([-80, -180, 0], [80, 180, 3000], (40, 3)).T
    frame = LocalFrame(47.6, 13.4, 512.0)
    ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    x0 = np.array(ecef.transform(13.4, 47.6, 512.0))
    x = np.array(ecef.transform(lon, lat, up)).T
    assert_allclose(np.linalg.norm(frame.to_enu(lat, lon, up), axis=1), np.linalg.norm(x - x0, axis=1), atol=1e-3)


@pytest.mark.parametrize("latitude", [-65.0, 0.0, 47.6, 80.0])
def test_the_crs_of_the_rasters_is_the_world_within_a_landing_zone(latitude: float) -> None:
    frame = LocalFrame(latitude, 13.4, 0.0)
    e, n = np.meshgrid(np.linspace(-200, 200, 9), np.linspace(-200, 200, 9))
    enu = np.stack([e, n, np.zeros_like(e)], axis=-1)
    lat, lon, _ = frame.to_geodetic(enu)
    to_crs = Transformer.from_crs("EPSG:4979", CRS.from_user_input(frame.crs), always_xy=True)
    x, y = to_crs.transform(lon, lat)
    assert_allclose(np.stack([x, y], axis=-1), enu[..., :2], atol=2e-3)


def test_the_crs_shrinks_with_altitude_as_the_conventions_say() -> None:
    """At 75 m from an origin at 1,600 m it is 2 cm: the projection lies on the ellipsoid, the world does not."""
    frame = LocalFrame(47.6, 13.4, 1600.0)
    lat, lon, _ = frame.to_geodetic([75.0, 0.0, 0.0])
    x, _ = Transformer.from_crs("EPSG:4979", CRS.from_user_input(frame.crs), always_xy=True).transform(lon, lat)
    assert 75.0 - x == pytest.approx(0.0188, abs=1e-3)


@pytest.mark.parametrize("bad", [(91.0, 0.0, 0.0), (0.0, 361.0, 0.0), (np.nan, 0.0, 0.0), (0.0, 0.0, np.inf)])
def test_what_is_no_place_is_refused(bad: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="no place on Earth"):
        LocalFrame(*bad)


# -- the world grid

grids = st.builds(
    Grid,
    east=st.floats(-500, 500),
    north=st.floats(-500, 500),
    cell=st.sampled_from([0.05, 0.1, 0.25, 1.0]),
    rows=st.integers(1, 40),
    cols=st.integers(1, 40),
)


@given(grids)
def test_index_is_where_xy_says(grid: Grid) -> None:
    xs, ys = grid.xy()
    assert (len(ys), len(xs)) == grid.shape
    assert (np.diff(xs) > 0).all()
    assert (np.diff(ys) < 0).all()  # row 0 is the northernmost
    rows, _ = grid.index(np.full(grid.rows, xs[0]), ys)
    _, cols = grid.index(xs, np.full(grid.cols, ys[0]))
    assert_allclose(rows, np.arange(grid.rows), atol=1e-8)
    assert_allclose(cols, np.arange(grid.cols), atol=1e-8)


@given(grids, st.data())
def test_a_window_is_a_part(grid: Grid, data: st.DataObject) -> None:
    r = data.draw(st.integers(0, grid.rows - 1))
    c = data.draw(st.integers(0, grid.cols - 1))
    part = grid.window(r, c, grid.rows - r, grid.cols - c)
    assert_allclose(part.xy()[0], grid.xy()[0][c:], atol=1e-9)
    assert_allclose(part.xy()[1], grid.xy()[1][r:], atol=1e-9)


@given(grids, number, number)
def test_the_nearest_value_is_that_of_the_cell_a_place_lies_in(grid: Grid, right: float, down: float) -> None:
    rows, cols = np.indices(grid.shape)
    number_of = (rows * grid.cols + cols).astype(np.float32)
    xs, ys = grid.xy()
    off_x, off_y = 0.49 * grid.cell * right, -0.49 * grid.cell * down
    east, north = np.meshgrid(xs + off_x, ys + off_y)
    assert (grid.nearest_at(number_of, east, north) == number_of).all()
    beyond = np.array([xs[0] - 0.51 * grid.cell, xs[-1] + 0.51 * grid.cell])
    assert np.isnan(grid.nearest_at(number_of, beyond, ys[:1])).all()
    assert (grid.nearest_at(np.ones(grid.shape, np.uint8), beyond, ys[:1]) == 0).all()
    assert (grid.nearest_at(np.ones((*grid.shape, 3), np.uint8), beyond, ys[:1], 7.0) == 7).all()
    assert (number_of == rows * grid.cols + cols).all()  # the input is unchanged


@given(grids, st.data())
def test_a_window_with_a_rim_takes_the_values_that_the_grid_has(grid: Grid, data: st.DataObject) -> None:
    r, c = data.draw(st.integers(0, grid.rows - 1)), data.draw(st.integers(0, grid.cols - 1))
    values = np.arange(grid.rows * grid.cols, dtype=np.uint16).reshape(grid.shape)
    wide = grid.nearest_on(grid.window(r - 1, c - 1, grid.rows - r + 2, grid.cols - c + 2), values, 9999)
    assert (wide == np.pad(values, 1, constant_values=9999)[r:, c:]).all()


@given(grids)
def test_the_transform_places_corners_half_a_cell_out(grid: Grid) -> None:
    from rasterio.transform import Affine, xy

    affine = Affine(*grid.transform)
    assert_allclose(np.ravel(xy(affine, 0, 0, offset="ul")), (grid.east - grid.cell / 2, grid.north + grid.cell / 2))
    r, c = grid.rows - 1, grid.cols - 1
    assert_allclose(np.ravel(xy(affine, r, c)), (grid.xy()[0][c], grid.xy()[1][r]), atol=1e-9)


@given(pose, st.lists(vector, min_size=4, max_size=4))
def test_ground_projection_is_the_projection_of_a_ground_point(world_from_cam: Pose, xs: list[np.ndarray]) -> None:
    """H (x, y, 1) + h b is the point in the optical frame (eqs. 1 to 3)."""
    H, b = ground_projection(world_from_cam)
    X = 30 * np.array(xs)
    p = np.column_stack([X[:, :2], np.ones(4)]) @ H.T + X[:, 2:] * b
    assert_allclose(p, world_from_cam.inverse.apply(X), atol=1e-10)


def test_a_pose_is_read_only_after_pickling_too() -> None:
    """Loops are compiled for read-only arrays, and poses go to other processes."""
    pose = pickle.loads(pickle.dumps(Pose(np.eye(3), np.array([1.0, 2.0, 3.0])), protocol=5))
    assert not pose.rotation.flags.writeable
    assert not pose.translation.flags.writeable
    assert pose.translation.tolist() == [1.0, 2.0, 3.0]
