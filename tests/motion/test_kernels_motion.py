"""Kernels of the tracker and of the filter against their NumPy twins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
import twins_motion as twins
from pose_window import CAMS, scene
from twins_motion import picture

from alight.geometry import Camera, Pose
from alight.motion.observations import WindowObservations
from alight.motion.points import marginalise_points, triangulate_rays, triangulate_window
from alight.motion.smoother.track_segments import LinearisedSegments, TrackSegments
from alight.settings import TracksSettings
from alight.tracks.corners import corner_response, detect_corners
from alight.tracks.patches import FeaturePatches
from alight.tracks.view_transfer import Lens

SETTINGS = TracksSettings(window_px=15)


@pytest.mark.parametrize("window", [5, 8, 21])
def test_texture_is_that_of_the_whole_picture(window: int) -> None:
    """Responses agree inside, over the edge (mirrored), and outside (that of the edge)."""
    image, rng = picture(0), np.random.default_rng(1)
    pixels = np.vstack([rng.uniform(0, 1, (200, 2)) * [159, 119], [[-5, 3], [400, 119], [159, 0]]]).astype(np.float32)
    np.testing.assert_allclose(corner_response(image, pixels, window), twins.texture(image, pixels, window), rtol=1e-4)


def test_corners_are_the_strongest_of_their_boxes() -> None:
    image, cell = cv2.GaussianBlur(picture(2), (3, 3), 0), 30.0
    taken = np.array([[45.0, 50.0], [100.5, 20.0]], np.float32)
    found = detect_corners(image, taken, cell, 1e-6)
    wanted = []
    for top in range(0, 120, 30):
        for left in range(0, 160, 30):
            box = (max(top, 8), min(top + 30, 112), max(left, 8), min(left + 30, 152))
            empty = not any(left <= x < left + 30 and top <= y < top + 30 for x, y in taken)
            if empty and box[3] > box[2]:
                wanted.append(twins.strongest(image, box, taken, 0.7 * cell)[:2])
    assert len(wanted) == 22
    assert {tuple(c) for c in found.astype(int).tolist()} == set(wanted)


def test_an_empty_box_has_no_corner() -> None:
    assert detect_corners(np.full((60, 80), 9, np.uint8), np.zeros((0, 2), np.float32), 20.0, 1e-6).shape == (0, 2)


def test_patches_settle_where_least_squares_says() -> None:
    """From a pixel away, turned by 0.1 rad, half as bright and 20 levels up, place and correlation are the twin's."""
    image, rng = picture(4), np.random.default_rng(5)
    pixels = rng.uniform(30, 90, (20, 2))
    patches = FeaturePatches.none(15).with_new(image, np.arange(20), pixels, Pose())
    c, s = np.cos(0.1), np.sin(0.1)
    map_ = np.array([[c, -s, 8.3], [s, c, -5.6]])
    turned = cv2.warpAffine(image, map_, (160, 120), flags=cv2.INTER_LINEAR)
    there, turn = pixels @ map_[:, :2].T + map_[:, 2], np.tile(np.array([[c, s], [-s, c]]), (20, 1, 1))
    other = np.round(0.5 * turned + 20.0).astype(np.uint8)
    found, good = patches.locate(other, there + 0.6, turn, SETTINGS)
    assert good.sum() >= 15
    np.testing.assert_allclose(found[good], there[good], atol=0.05)
    for k in np.flatnonzero(good)[:6]:
        place, correlation = twins.settled(patches.grey[k], patches.places[k], turn[k], other, 7, there[k] + 0.6)
        np.testing.assert_allclose(found[k], place, atol=0.01)
        assert correlation > 0.95
    np.testing.assert_array_equal(found[~good], there[~good] + 0.6)


def test_what_is_not_there_is_not_found() -> None:
    """No match is found on other ground, for a flat patch, at the edge, or for a view larger than the patch."""
    image, elsewhere, ahead = picture(6), picture(7), np.eye(2)[None]
    pixels = np.array([[80.0, 60.0]])
    patch = FeaturePatches.none(15).with_new(image, np.arange(1), pixels, Pose())
    assert patch.locate(image, pixels, ahead, SETTINGS)[1].all()
    assert not patch.locate(elsewhere, pixels, ahead, SETTINGS)[1].any()
    assert not patch.locate(image, np.array([[3.0, 60.0]]), ahead, SETTINGS)[1].any()
    assert not patch.locate(image, pixels, 4.0 * ahead, SETTINGS)[1].any()
    flat = FeaturePatches.none(15).with_new(np.full_like(image, 9), np.arange(1), pixels, Pose())
    assert not flat.locate(image, pixels, ahead, SETTINGS)[1].any()
    assert len(FeaturePatches.none(15).with_new(image, np.arange(1), np.array([[10.0, 60.0]]), Pose()).ids) == 0


def test_the_table_takes_the_lens_out() -> None:
    camera = Camera(160, 120, 130.0, 131.0, 79.0, 61.0, "radial-tangential", (-0.1, 0.02, 1e-3, -5e-4))
    pixels = np.random.default_rng(3).uniform(0, 1, (50, 2)) * [159, 119]
    pixels[7] = np.nan
    found = Lens(camera).normalise(pixels)
    assert np.isnan(found[7]).all()
    keep = np.arange(50) != 7
    np.testing.assert_allclose(found[keep], twins.rays(camera, pixels[keep]), atol=1e-5)
    outside = Lens(camera).normalise(np.array([[-50.0, 60.0], [1e6, 60.0]]))
    np.testing.assert_allclose(outside[0], twins.rays(camera, np.array([[-1.0, 60.0]]))[0], atol=1e-6)
    assert np.isfinite(outside).all()


@pytest.mark.parametrize("seed", range(3))
def test_points_and_pose_constraints_are_those_of_numpy(seed: int) -> None:
    observations, poses = scene(seed)
    x = triangulate_window(observations, poses, CAMS)
    np.testing.assert_allclose(x[1:], twins.triangulate(observations, poses, CAMS)[1:], rtol=1e-6, atol=1e-6)
    found, wanted = marginalise_points(observations, poses, CAMS, x), twins.eliminate(observations, poses, CAMS, x)
    for name in ("b", "misfit", "freedom", "point_covariance", "step"):
        np.testing.assert_allclose(getattr(found, name), wanted[name], rtol=1e-6, atol=1e-6, err_msg=name)
    np.testing.assert_allclose(found.point_by_poses(), wanted["by_poses"], rtol=1e-6, atol=1e-6)
    one = np.zeros(30)
    one[4] = 1.0
    np.testing.assert_allclose(found.information(one)[0], wanted["A"][4], rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(found.root @ found.root.transpose(0, 2, 1), wanted["point_covariance"], rtol=1e-9)


def test_nothing_seen_is_no_number_but_no_error() -> None:
    """A feature without observations, or no feature at all, raises no error."""
    observations, poses = scene(0)
    blind = WindowObservations(
        observations.ids[:1], np.full_like(observations.normalised[:1], np.nan), observations.sigma[:1]
    )
    assert np.isfinite(triangulate_window(blind, poses, CAMS)).all()
    assert marginalise_points(blind, poses, CAMS, np.zeros((1, 3))).freedom[0] == -3
    assert triangulate_window(observations.select(np.zeros(30, bool)), poses, CAMS).shape == (0, 3)


def starts_of(rng: np.random.Generator, points: int) -> np.ndarray:
    """First observation of each point, with two to five a point, and the number of all observations."""
    return np.concatenate([[0], np.cumsum(rng.integers(2, 6, points))])


@pytest.mark.parametrize("seed", range(3))
def test_points_of_ray_lists_are_those_of_least_squares(seed: int) -> None:
    """The rays are random; two are nearly parallel (0.1 degrees), and one has a weight of zero."""
    rng = np.random.default_rng(seed)
    starts = starts_of(rng, 12)
    x = np.repeat(rng.uniform(-20, 20, (12, 3)), np.diff(starts), axis=0)
    origins = rng.uniform(-20, 20, x.shape) + np.array([0.0, 0.0, 60.0])
    origins[starts[3]], origins[starts[3] + 1] = x[starts[3]] + [0, 0, 60.0], x[starts[3]] + [0.1, 0, 60.0]
    rays, weight = x - origins + 0.02 * rng.normal(size=x.shape), rng.uniform(0.2, 1.0, len(x))
    weight[starts[5]] = 0.0
    found = triangulate_rays(starts, rays, origins, weight)
    np.testing.assert_allclose(found, twins.nearest_to_rays(starts, rays, origins, weight), rtol=1e-6, atol=1e-6)
    assert triangulate_rays(starts[:1], rays[:0], origins[:0], weight[:0]).shape == (0, 3)


def test_eliminated_points_are_the_schur_complement_of_the_full_system() -> None:
    """Reduced matrix, right side and back substitution agree; one point is seen from one pose, one has no depth."""
    rng, poses = np.random.default_rng(4), 4
    starts = starts_of(rng, 9)
    m = int(starts[-1])
    pose = rng.integers(0, poses, m)
    pose[starts[2] : starts[3]] = 1
    residual, by_pose, by_point = rng.normal(size=(m, 2)), rng.normal(size=(m, 2, 6)), rng.normal(size=(m, 2, 3))
    by_point[starts[6] : starts[7], :, 2] = 0.0
    H, g, step = twins.schur(starts, residual, by_pose, by_point, 1e-4, pose, poses)
    segment, none = np.repeat(np.arange(9), np.diff(starts)), np.zeros((9, 3))
    points = SimpleNamespace(
        starts=starts, count=9, first=np.zeros(9, np.int64), exposure=pose, segment=segment, points=none
    )
    found = LinearisedSegments(cast(TrackSegments, points), residual, by_pose, by_point)
    full, right = found.reduced(0, 1, poses // 2)
    np.testing.assert_allclose(full, H, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(right, g, rtol=1e-8, atol=1e-6)
    found.move_points(np.zeros((poses, 6)))
    np.testing.assert_allclose(points.points, step, rtol=1e-7, atol=1e-6)
    moved, points.points = np.linalg.solve(H + np.eye(len(H)), g).reshape(poses, 6), np.zeros((9, 3))
    found.move_points(moved)
    predicted = np.einsum("nki,ni->nk", by_pose, moved[pose])
    left = twins.schur(starts, residual - predicted, by_pose, by_point, 1e-4, pose, poses)[2]
    np.testing.assert_allclose(points.points, left, rtol=1e-7, atol=1e-6)
