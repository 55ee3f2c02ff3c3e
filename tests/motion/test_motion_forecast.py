"""The filter's prediction of the next exposure, and the search for features that is bounded by it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from point_flight import NOISE, RIG, PointFlight, fed, predicted

from alight.arrays import F64
from alight.geometry import Camera, Pose, so3_exp, so3_log
from alight.motion import MotionFilter
from alight.motion.ekf.prediction import MotionPredictor
from alight.motion.ekf.state import AT
from alight.motion.imu_buffer import ImuBuffer
from alight.records import Frame, ImuSample, Prediction, Rig, RigCamera, Tracks
from alight.settings import TracksSettings
from alight.tracks import Tracker
from alight.tracks.view_transfer import inside_search_region, pixel_covariance

STEP = 100_000_000  # ns between two exposures


def after(seconds: float, imu: bool = True) -> tuple[MotionFilter, int, int, list[ImuSample]]:
    """Return a filter in flight, its last exposure, the next exposure, and the IMU samples until then."""
    flight = PointFlight(seed=4, seconds=seconds, count=60, imu=imu)
    last = max(e.t_ns for e in flight.events if isinstance(e, Tracks))
    f = MotionFilter(RIG, NOISE.model_copy(update={"points": 16}))
    list(fed(f, [e for e in flight.events if e.t_ns <= last - STEP]))
    rows = [e for e in flight.events if isinstance(e, ImuSample)]
    return f, last - STEP, last, rows


def shift(now: Prediction) -> Pose:
    """Camera 0 now from camera 0 then."""
    assert now.earlier is not None
    return now.world_from_cams[0].inverse @ now.earlier[0]


def moved(f: MotionPredictor, error: F64) -> MotionPredictor:
    """Return a predictor with (24,) errors of the last rig, then of attitude, place, velocity, biases, mounting."""
    assert f.last is not None
    core = f.core.copy()
    core[AT.pos], core[AT.vel] = core[AT.pos] + error[9:12], core[AT.vel] + error[12:15]
    core[9:15], core[24:27] = core[9:15] + error[15:21], core[24:27] + error[21:24]
    last = replace(f.last, R=so3_exp(error[:3]) @ f.last.R, p=f.last.p + error[3:6])
    return replace(f, R=so3_exp(error[6:9]) @ f.R, core=core, last=last)


@pytest.mark.parametrize("imu", [True, False])
def test_the_change_of_the_pose_is_as_uncertain_as_the_state_makes_it(imu: bool) -> None:
    """The predicted covariance agrees with derivatives by each error of the state, to which time adds noise."""
    f, then, now, samples = after(2.0, imu)
    said = f.predictor()
    assert said is not None
    rows = ImuBuffer(samples)
    expected = said.cameras(now, then, rows)
    assert expected.covariance is not None
    J, h = np.empty((6, 24)), 1e-6
    for k, e in enumerate(np.eye(24)):
        a, b = (shift(moved(said, s * h * e).cameras(now, then, rows)) for s in (1.0, -1.0))
        J[:3, k] = so3_log(a.rotation @ b.rotation.T) / (2 * h)
        J[3:, k] = (a.translation - b.translation - np.cross(J[:3, k], shift(expected).translation) * 2 * h) / (2 * h)
    from_state = J @ said.P @ J.T
    added = expected.covariance - from_state
    assert np.linalg.eigvalsh(added).min() > -1e-3 * np.linalg.norm(expected.covariance)
    assert np.linalg.norm(added) < (0.5 if imu else 1.0) * np.linalg.norm(expected.covariance)


def test_without_imu_the_change_is_far_less_sure() -> None:
    found = []
    for imu in (True, False):
        f, then, now, rows = after(2.0, imu)
        for row in rows:
            f.feed(row)
        expected = predicted(f, now, then)
        assert expected is not None
        assert expected.covariance is not None
        found.append(np.sqrt(np.diag(expected.covariance)))
    assert (found[1] > 3.0 * found[0]).all()


def test_an_exposure_that_the_filter_has_not_heard_of_is_predicted_too() -> None:
    """When tracking runs ahead by one exposure, two steps start from one state, and are no more certain than one."""
    f, then, now, samples = after(2.0)
    said, rows = f.predictor(), ImuBuffer(samples)
    assert said is not None
    ahead = said.cameras(now + STEP, now, rows)
    assert ahead.earlier is not None
    assert ahead.covariance is not None
    np.testing.assert_array_equal(ahead.earlier[0].matrix, said.cameras(now, then, rows).world_from_cams[0].matrix)
    one = said.cameras(now, then, rows).covariance
    assert one is not None
    assert np.trace(ahead.covariance[3:, 3:]) > 0.9 * np.trace(one[3:, 3:])
    assert np.linalg.eigvalsh(ahead.covariance).min() > 0.0


def test_what_came_before_the_state_has_no_covariance() -> None:
    f, then, now, samples = after(2.0)
    said, rows = f.predictor(), ImuBuffer(samples)
    assert said is not None
    assert said.cameras(now, then - STEP, rows).covariance is None
    assert said.cameras(now, None, rows).earlier is None


# -- the search ----------------------------------------------------------------------------------------------------

HEIGHT, FOCAL = 20.0, 300.0
CAMERA = Camera(320, 240, FOCAL, FOCAL, 159.5, 119.5)
PAIR = Rig((RigCamera("left", CAMERA, Pose()), RigCamera("right", CAMERA, Pose(np.eye(3), [0.5, 0.0, 0.0]))))
DOWN = np.diag([1.0, -1.0, -1.0])


def test_pixels_scatter_as_poses_and_depths_do() -> None:
    """The covariance of transferred pixels agrees to a tenth with 4,000 draws of the pose and of the depth."""
    rng, at = np.random.default_rng(1), np.array([[1.0, -2.0, 20.0], [-4.0, 3.0, 30.0]])
    root = np.diag([2e-3, 1e-3, 3e-3, 0.02, 0.05, 0.1]) @ so3_pair(rng)
    deep = np.array([[0.2, 0.0, 0.5], [0.0, 0.1, -0.3]])
    said = pixel_covariance(at, deep, FOCAL, root @ root.T)
    for k in range(2):
        draw = rng.normal(size=(4000, 6)) @ root.T
        x = at[k] + rng.normal(size=(4000, 1)) * deep[k]
        x = x + np.cross(draw[:, :3], x) + draw[:, 3:]
        found = np.cov((FOCAL * x[:, :2] / x[:, 2:]).T)
        np.testing.assert_allclose(said[k], found, atol=0.1 * np.trace(found))


def so3_pair(rng: np.random.Generator) -> F64:
    """Return a random rotation in six dimensions."""
    return np.asarray(np.linalg.qr(rng.normal(size=(6, 6)))[0])


def test_within_is_an_ellipse() -> None:
    covariance = np.tile(np.diag([9.0, 0.0]), (4, 1, 1))
    off = np.array([[12.0, 0.0], [13.0, 0.0], [0.0, 3.9], [0.0, 4.1]], np.float32)
    assert inside_search_region(off, covariance, 4.0, 1.0).tolist() == [True, False, True, False]


def followed(sigma: float | None) -> tuple[int, int]:
    """Number of features followed over ground as predicted, and on a lorry that drives 7 px another way.

    Args:
        sigma: m, of the predicted way; None: unknown.
    """
    soft = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (400, 500)).astype(np.float32), (0, 0), 2.5)
    ground = np.clip(128 + (soft - soft.mean()) * 40 / soft.std(), 0, 255).astype(np.uint8)
    tracker, seen, before = Tracker(PAIR, TracksSettings(count=80)), [], None
    for k in range(3):
        picture, at = ground[60:300, 60 + 6 * k : 380 + 6 * k].copy(), 120 + 1 * k
        picture[80:180, at : at + 100] = ground[250:350, 200:300]
        right = cv2.warpAffine(picture, np.array([[1.0, 0.0, -0.5 * FOCAL / HEIGHT], [0.0, 1.0, 0.0]]), (320, 240))
        body = Pose(DOWN, [6 * k * HEIGHT / FOCAL, 0.0, HEIGHT])
        cams = tuple(body @ c.body_from_cam for c in PAIR.cameras)
        change = None if sigma is None else np.diag(np.repeat([1e-8, sigma**2], 3))
        seen.append(tracker.feed(Frame(k * STEP, (picture, right)), Prediction(cams, before, change)))
        before = cams
    _, a, b = np.intersect1d(seen[1].ids, seen[2].ids, return_indices=True)
    way = seen[2].pixels[b, 0, 0] - seen[1].pixels[a, 0, 0]
    return int((np.abs(way + 6.0) < 0.5).sum()), int((np.abs(way - 1.0) < 0.5).sum())


def test_a_sure_motion_leaves_the_lorry_and_a_vague_one_follows_it() -> None:
    """A centimetre of the way is 0.15 px, a metre 15 px: the search region grows with the uncertainty of the motion."""
    sure, vague, unknown = followed(0.01), followed(1.0), followed(None)
    assert sure[0] > 40
    assert sure[1] == 0
    for found in (vague, unknown):
        assert found[0] > 40
        assert found[1] > 4
