"""The tracker on synthetic pictures with exactly known motion."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from alight.geometry import Camera, Pose, so3_exp
from alight.records import Frame, Prediction, Rig, RigCamera
from alight.settings import TracksSettings as Settings
from alight.tracks import Tracker, corner_response, detect_corners, epipolar_distance, inverse_depth
from alight.tracks.global_alignment import likely_turns, relocate
from alight.tracks.patches import FeaturePatches
from alight.tracks.view_transfer import Lens

HEIGHT, FOCAL = 20.0, 300.0
CAMERA = Camera(320, 240, FOCAL, FOCAL, 159.5, 119.5)
DOWN = np.diag([1.0, -1.0, -1.0])  # world_from_cam: x right, y down the picture is south, looking down
RIG = Rig((RigCamera("left", CAMERA, Pose()), RigCamera("right", CAMERA, Pose(np.eye(3), [0.5, 0.0, 0.0]))))
SETTINGS = Settings(count=80)


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    """A textured plane with pixels of a centimetre and a half."""
    noise = np.random.default_rng(0).uniform(0, 255, (900, 1100)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip(128 + (soft - soft.mean()) * 40 / soft.std(), 0, 255).astype(np.float32)


def pose(x: float, y: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose(so3_exp([0.0, 0.0, yaw]) @ DOWN, [x, y, HEIGHT])


def picture(ground: np.ndarray, world_from_cam: Pose) -> np.ndarray:
    """Draw the plane z = 0 as seen by a camera."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = CAMERA.rays(np.stack([u, v], axis=-1)) @ world_from_cam.rotation.T
    points = world_from_cam.translation + rays * (-world_from_cam.translation[2] / rays[..., 2:])
    at_x, at_y = points[..., 0] * FOCAL / HEIGHT + 550, -points[..., 1] * FOCAL / HEIGHT + 450
    return np.round(cv2.remap(ground, at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_CUBIC)).astype(
        np.uint8
    )


def poses(left: Pose) -> tuple[Pose, Pose]:
    return left @ RIG.cameras[0].body_from_cam, left @ RIG.cameras[1].body_from_cam


def expected(left: Pose, cameras: int = 2) -> Prediction:
    return Prediction(poses(left)[:cameras])


def frame(ground: np.ndarray, k: int, left: Pose) -> Frame:
    return Frame(k * 100_000_000, tuple(picture(ground, p) for p in poses(left)))


def carried(pixels: np.ndarray, then: Pose, now: Pose) -> np.ndarray:
    """Return the pixels in another view of the ground points that are seen at `pixels`."""
    rays = CAMERA.rays(pixels) @ then.rotation.T
    points = then.translation + rays * (-then.translation[2] / rays[:, 2:])
    return CAMERA.project(now.inverse.apply(points))


def test_features_follow_the_ground(ground: np.ndarray) -> None:
    tracker, path = Tracker(RIG, SETTINGS), [pose(0.23 * k, 0.1 * k, 0.03 * k) for k in range(6)]
    seen = [tracker.feed(frame(ground, k, p), expected(p)) for k, p in enumerate(path)]
    first, last = seen[0], seen[-1]
    both, a, b = np.intersect1d(first.ids, last.ids, return_indices=True)
    assert len(both) > 40
    miss = last.pixels[b, 0] - carried(first.pixels[a, 0], path[0], path[-1])
    assert np.sqrt(np.median(miss**2)) < 0.04
    assert np.sqrt((miss**2).mean()) < 0.16
    assert np.abs(np.median(miss, axis=0)).max() < 0.03


def test_errors_do_not_add_up(ground: np.ndarray) -> None:
    """In twelve steps over noisy pictures, with turns, the error of a feature hardly grows from the second to the
    twelfth: it is matched with its first appearance (from picture to picture the error would be 2.4 times as much)."""
    tracker, path = Tracker(RIG, SETTINGS), [pose(0.1 * k, 0.05 * k, 0.02 * k) for k in range(13)]
    rng, seen = np.random.default_rng(3), []
    for k, p in enumerate(path):
        images = [np.clip(i + rng.normal(0, 4, i.shape), 0, 255) for i in frame(ground, k, p).images if i is not None]
        seen.append(tracker.feed(Frame(k, tuple(i.astype(np.uint8) for i in images)), expected(p)))
    miss = []
    for k in (2, 12):
        _, a, b = np.intersect1d(seen[0].ids, seen[k].ids, return_indices=True)
        off = seen[k].pixels[b, 0] - carried(seen[0].pixels[a, 0], path[0], path[k])
        miss.append(float(np.median(np.hypot(*off.T))))
    assert len(a) > 30
    assert miss[1] < 1.5 * miss[0]
    assert miss[1] < 0.1


def test_cameras_need_not_be_equally_bright(ground: np.ndarray) -> None:
    """Over pale ground the right camera is 3 levels brighter, less than a jump of the exposure: the disparity stays."""
    here, tracker = pose(0.0), Tracker(RIG, SETTINGS)
    pale = [140.0 + 0.15 * i.astype(np.float32) for i in frame(ground, 0, here).images if i is not None]
    images = tuple(np.round(i + more).astype(np.uint8) for i, more in zip(pale, (0.0, 3.0), strict=True))
    found = tracker.feed(Frame(0, images), expected(here))
    disparity = found.pixels[:, 0, 0] - found.pixels[:, 1, 0]
    off = disparity[np.isfinite(disparity)] - FOCAL * 0.5 / HEIGHT
    assert len(off) > 40
    assert np.median(np.abs(off)) < 0.03


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.45])
def test_turns_are_those_of_the_ground(tilt: float) -> None:
    """Warps agree with points of the plane projected through a distorted lens; a view along the ground has no plane."""
    camera = Camera(320, 240, FOCAL, FOCAL, 159.5, 119.5, "radial-tangential", (-0.1, 0.02, 1e-3, -5e-4))
    here = pose(0.0) @ Pose(so3_exp([tilt, 0.0, 0.0]))
    then = pose(0.4, -0.2, 0.1) @ Pose(so3_exp([tilt, 0.05, 0.0]))
    pixels = np.array([[160.0, 120.0], [60.0, 200.0], [250.0, 180.0]])
    depth, then_from_here = np.full(3, HEIGHT / np.cos(tilt)), then.inverse @ here

    def there(at: np.ndarray) -> np.ndarray:
        rays = camera.rays(at)
        world = rays @ here.rotation.T
        depth = HEIGHT / -world[:, 2] if tilt < 1.0 else np.full(len(at), HEIGHT / np.cos(tilt))
        return camera.project(then_from_here.apply(rays * depth[:, None]))

    R, t = np.tile(then.rotation, (3, 1, 1)), np.tile(then.translation, (3, 1))
    patches = replace(FeaturePatches.none(15), pixels=there(pixels), R=R, t=t)
    found = patches.warps(Lens(camera), pixels, Lens(camera), here, here.rotation[2], depth)
    for k, step in enumerate(np.eye(2)):
        wanted = (there(pixels + step) - there(pixels - step)) / 2
        np.testing.assert_allclose(found[:, :, k], wanted, atol=0.004)


def test_stereo_gives_the_disparity_of_the_plane(ground: np.ndarray) -> None:
    tracks = Tracker(RIG, SETTINGS).feed(frame(ground, 0, pose(0.0)), None)
    matched = np.isfinite(tracks.pixels[:, 1, 0])
    assert matched.mean() > 0.9
    disparity = tracks.pixels[matched, 0] - tracks.pixels[matched, 1]
    np.testing.assert_allclose(np.median(disparity, axis=0), [FOCAL * 0.5 / HEIGHT, 0.0], atol=0.02)
    assert np.abs(disparity - [FOCAL * 0.5 / HEIGHT, 0.0]).max() < 1.6
    rays = CAMERA.rays(tracks.pixels[:, 0])[:, :2]
    np.testing.assert_allclose(tracks.normalised[:, 0], rays)


def test_features_are_spread_and_bounded(ground: np.ndarray) -> None:
    tracker = Tracker(RIG, SETTINGS)
    for k in range(5):
        tracks = tracker.feed(frame(ground, k, pose(0.6 * k)), expected(pose(0.6 * k)))
        quarter = (tracks.pixels[:, 0, 0] > 160).astype(int) + 2 * (tracks.pixels[:, 0, 1] > 120)
        assert np.bincount(quarter, minlength=4).min() > 10
        assert len(tracks.ids) <= 3 * SETTINGS.count
        assert len(np.unique(tracks.ids)) == len(tracks.ids)


@pytest.mark.parametrize("cameras", [1, 2])
@pytest.mark.parametrize("predicted", [True, False])
def test_a_long_way_is_followed(ground: np.ndarray, predicted: bool, cameras: int) -> None:
    """110 px lie between two exposures, of one camera or two, with a prediction and without: the shift of the whole
    picture is found first, or with one camera the depth of the ground."""
    there, here = pose(0.0), pose(7.3)
    tracker = Tracker(Rig(RIG.cameras[:cameras]), SETTINGS)
    seen = []
    for k, p in enumerate((there, here)):
        whole = frame(ground, k, p)
        seen.append(tracker.feed(Frame(k, whole.images[:cameras]), expected(p, cameras) if predicted else None))
    both, a, b = np.intersect1d(seen[0].ids, seen[1].ids, return_indices=True)
    assert len(both) > 25
    assert np.median(np.abs(seen[1].pixels[b, 0] - carried(seen[0].pixels[a, 0], there, here))) < 0.1


def test_half_a_turn_that_nobody_predicted_is_found(ground: np.ndarray) -> None:
    tracker, there, here = Tracker(RIG, SETTINGS), pose(0.0), pose(3.0, 1.0, np.pi)
    first = tracker.feed(frame(ground, 0, there), expected(there))
    second = tracker.feed(frame(ground, 1, here), expected(pose(3.0, 1.0)))
    both, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(both) > 20
    assert np.median(np.abs(second.pixels[b, 0] - carried(first.pixels[a, 0], there, here))) < 0.15


@pytest.mark.parametrize("count", [1, 2, 30])
def test_a_shift_is_found_by_the_image_however_few_the_features(count: int) -> None:
    rng = np.random.default_rng(0)
    then = cv2.GaussianBlur(rng.integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 3)
    then = cv2.normalize(then, np.empty_like(then), 0, 255, cv2.NORM_MINMAX)
    now, pixels = np.roll(then, (12, 9), (0, 1)), rng.uniform(100, 380, (count, 2)).astype(np.float32)
    np.testing.assert_allclose(relocate(then, now, pixels, (0.0,)) - pixels, np.tile([9.0, 12.0], (count, 1)), atol=0.5)


def test_a_wrong_prediction_is_caught_by_the_pyramid(ground: np.ndarray) -> None:
    tracker, there, here = Tracker(RIG, SETTINGS), pose(0.0), pose(1.0)
    first = tracker.feed(frame(ground, 0, there), expected(there))
    second = tracker.feed(frame(ground, 1, here), expected(pose(0.6)))
    both, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(both) > 40
    assert np.abs(second.pixels[b, 0] - carried(first.pixels[a, 0], there, here)).mean() < 0.1


def moved_and(ground: np.ndarray, how: object) -> tuple[int, float]:
    """Follow features over 12 px into a picture changed by `how`; return their number and their errors (RMS, px)."""
    tracker, there, here = Tracker(RIG, SETTINGS), pose(0.0), pose(0.4, 0.2, 0.02)
    first = tracker.feed(frame(ground, 0, there), expected(there))
    images = [how(i.astype(np.float32)) for i in frame(ground, 1, here).images if i is not None]  # type: ignore[operator]
    changed = Frame(1, tuple(np.clip(np.round(i), 0, 255).astype(np.uint8) for i in images))
    second = tracker.feed(changed, expected(here))
    both, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
    miss = second.pixels[b, 0] - carried(first.pixels[a, 0], there, here)
    return len(both), float(np.sqrt((miss**2).mean()))


@pytest.mark.parametrize(("gain", "offset"), [(1.25, 0.0), (0.5, 0.0), (1.0, 50.0), (0.7, 30.0)])
def test_a_jump_of_the_exposure_costs_nothing(ground: np.ndarray, gain: float, offset: float) -> None:
    count, miss = moved_and(ground, lambda i: gain * i + offset)
    assert count > 75
    assert miss < 0.1


def test_motion_blur_of_nine_pixels_is_followed(ground: np.ndarray) -> None:
    count, miss = moved_and(ground, lambda i: cv2.blur(i, (9, 1)))
    assert count > 75
    assert miss < 0.25


def test_a_covered_lens_has_no_features_and_new_ones_come_after(ground: np.ndarray) -> None:
    tracker, dark = Tracker(RIG, SETTINGS), np.full((240, 320), 7, np.uint8)
    before = tracker.feed(frame(ground, 0, pose(0.0)))
    covered = tracker.feed(Frame(1, (dark, dark)))
    after = tracker.feed(frame(ground, 2, pose(0.0)))
    assert len(covered.ids) == 0
    assert len(after.ids) > 40
    assert not set(before.ids) & set(after.ids)


def test_features_wait_out_a_dropped_frame(ground: np.ndarray) -> None:
    tracker = Tracker(RIG, SETTINGS)
    before = tracker.feed(frame(ground, 0, pose(0.0)), expected(pose(0.0)))
    dropped = tracker.feed(Frame(1, (None, None)), expected(pose(0.2)))
    after = tracker.feed(frame(ground, 2, pose(0.4)), expected(pose(0.4)))
    assert len(dropped.ids) == 0
    assert len(np.intersect1d(before.ids, after.ids)) > 40


def test_the_right_camera_may_fail(ground: np.ndarray) -> None:
    whole = frame(ground, 0, pose(0.0))
    tracks = Tracker(RIG, SETTINGS).feed(Frame(0, (whole.images[0], None)))
    assert len(tracks.ids) > 40
    assert np.isnan(tracks.pixels[:, 1]).all()


def test_colour_and_grey_give_the_same(ground: np.ndarray) -> None:
    grey = picture(ground, pose(0.0))
    a = Tracker(Rig(RIG.cameras[:1]), SETTINGS).feed(Frame(0, (grey,)))
    b = Tracker(Rig(RIG.cameras[:1]), SETTINGS).feed(Frame(0, (np.dstack([grey] * 3),)))
    np.testing.assert_array_equal(a.pixels, b.pixels)


def test_corners_keep_clear_of_what_is_taken(ground: np.ndarray) -> None:
    image = picture(ground, pose(0.0))
    taken = np.array([[50.0, 60.0], [200.0, 100.0]], np.float32)
    found = detect_corners(image, taken, 30.0, 1e-5)
    distance = np.linalg.norm(found[:, None] - taken[None], axis=2)
    assert len(found) > 40
    assert distance.min() > 0.6 * 30.0


def test_strength_grows_with_contrast(ground: np.ndarray) -> None:
    image = picture(ground, pose(0.0))
    weak = (128 + (image.astype(float) - 128) / 4).astype(np.uint8)
    at = np.array([[100.0, 100.0], [-3.0, 500.0]], np.float32)  # outside, the value at the edge is used
    ratio = corner_response(image, at, 21) / corner_response(weak, at, 21)
    np.testing.assert_allclose(ratio, 16.0, rtol=0.15)


def test_two_views_triangulate_and_keep_to_the_epipolar_line() -> None:
    rng = np.random.default_rng(2)
    other_from_first = Pose(so3_exp([0.02, -0.03, 0.01]), [-0.5, 0.02, 0.01])
    points = np.column_stack([rng.uniform(-5, 5, (50, 2)), rng.uniform(5, 40, 50)])
    moved = other_from_first.apply(points)
    first, other = points[:, :2] / points[:, 2:], moved[:, :2] / moved[:, 2:]
    w, arm = inverse_depth(first, other, other_from_first)
    np.testing.assert_allclose(w, 1 / points[:, 2], rtol=1e-9)
    np.testing.assert_allclose(epipolar_distance(first, other, other_from_first), 0.0, atol=1e-12)
    # the sigma of the inverse depth is that of a coordinate over `arm`
    shifted, _ = inverse_depth(first, other + np.array([1e-6, 0.0]), other_from_first)
    np.testing.assert_allclose(np.median(np.abs(shifted - w) * arm), 1e-6, rtol=0.05)
    assert epipolar_distance(first, other + np.array([0.0, 1e-3]), other_from_first).min() > 5e-4


@pytest.mark.parametrize(
    ("sigma", "predicted", "count"), [(None, 0.0, 24), (0.01, 0.3, 1), (0.1, 0.0, 3), (3.0, 0.0, 24)]
)
def test_turns_that_the_prediction_excludes_are_not_tried(sigma: float | None, predicted: float, count: int) -> None:
    """Four sigmas of 0.1 rad reach the turns of 15 degrees to both sides; the predicted one comes first."""
    covariance = None if sigma is None else np.diag([1.0, 1.0, sigma**2, 1.0, 1.0, 1.0])
    turns = likely_turns(Pose(so3_exp([0.0, 0.0, predicted]), np.zeros(3)), covariance, 4.0)
    assert len(turns) == count
    assert turns[0] == pytest.approx(predicted)
