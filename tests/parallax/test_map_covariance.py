"""Effect of pose errors on matched heights, against ray intersections, and the datum of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from point_flight import NOISE, PointFlight, run

from alight.arrays import F64
from alight.geometry import Camera, Grid, Pose, skew, so3_exp
from alight.motion.ekf.keyframe_posterior import relative_inflation, rigid_posterior
from alight.parallax.datum import Matched, sensitivity, steepness, with_datum
from alight.parallax.pose_refinement.gaussian import between, corrected_pose
from alight.records import ElevationMap, Flag, KeyframePosterior, Motion, View

CAMERA = Camera(640, 480, 480.0, 480.0, 319.5, 239.5)
BODY_FROM_CAM = Pose(so3_exp([0.02, 0.01, 0.0]) @ np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), [0.3, 0.1, -0.1])
GRID = Grid(-4.0, 4.0, 0.25, 33, 33)
STEP = 100_000_000  # ns


def motions_of(count: int = 6, seed: int = 0) -> tuple[Motion, ...]:
    """Motions of a weaving flight 30 m above the ground."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        place = np.array([2.0 * (k - 0.5 * (count - 1)), 0.0, 30.0]) + rng.normal(0, 0.5, 3)
        body = Pose(so3_exp(rng.normal(0, 0.05, 3)), place)
        out.append(Motion(STEP * k, body, (body @ BODY_FROM_CAM,), np.eye(6)))
    return tuple(out)


def views_of(motions: tuple[Motion, ...]) -> tuple[View, ...]:
    return tuple(View(m.t_ns, 0, np.empty((0, 0), np.uint8), CAMERA, m.world_from_cams[0]) for m in motions)


def together(motions: tuple[Motion, ...], turn: F64, move: F64) -> F64:
    """Errors (6K,) of poses that are turned about the origin and moved as one body."""
    return np.concatenate([np.r_[move + np.cross(turn, m.world_from_body.translation), turn] for m in motions])


def ground(rng: np.random.Generator, count: int = 20) -> F64:
    return np.column_stack([rng.uniform(-4, 4, (count, 2)), rng.normal(0, 0.5, count)])


def matched(motions: tuple[Motion, ...], error: F64, points: F64, true: Camera = CAMERA) -> F64:
    """Best intersections, in height and place, of the rays of estimated poses to true points: the twin, ray by ray."""
    rays = []
    for m, e in zip(motions, error.reshape(-1, 6), strict=True):
        body = corrected_pose(m.world_from_body, e)
        pixels = true.project((body @ BODY_FROM_CAM).inverse.apply(points))
        rays.append(CAMERA.rays(pixels) @ m.world_from_cams[0].rotation.T)
    out = np.empty_like(points)
    for i, p in enumerate(points):
        A, b = [], []
        for m, ray in zip(motions, rays, strict=True):
            slope = ray[i, :2] / ray[i, 2]
            centre = m.world_from_cams[0].translation
            A.append(np.column_stack([np.eye(2), -slope]))
            b.append(centre[:2] + slope * (p[2] - centre[2]))
        out[i] = np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0] + [0, 0, p[2]]
    return out


def test_poses_that_are_off_as_one_carry_the_ground_along() -> None:
    motions, points = motions_of(), ground(np.random.default_rng(1))
    J = sensitivity(points, views_of(motions), KeyframePosterior(motions, np.zeros((36, 36))))
    turn, move = np.array([2e-3, -1e-3, 3e-3]), np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(J @ together(motions, turn, move), -(move + np.cross(turn, points)), atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_any_errors_move_a_point_to_where_its_rays_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions, points = motions_of(seed=seed), ground(rng)
    error = rng.normal(size=36) * np.tile(np.repeat([1e-3, 1e-5], 3), 6)
    J = sensitivity(points, views_of(motions), KeyframePosterior(motions, np.zeros((36, 36))))
    np.testing.assert_allclose(J @ error, matched(motions, error, points) - points, atol=2e-5)


def test_a_lens_that_is_off_moves_the_ground_too() -> None:
    """With a true focal length longer by a thousandth, heights shrink towards the cameras by 3 cm."""
    motions, points = motions_of(), ground(np.random.default_rng(5))
    longer = replace(CAMERA, fu=CAMERA.fu * 1.001, fv=CAMERA.fv * 1.001)
    J = sensitivity(points, views_of(motions), KeyframePosterior(motions, np.zeros((37, 37)), ((longer,),)))
    found = matched(motions, np.zeros(36), points, longer) - points
    assert np.abs(found[:, 2]).mean() > 0.02
    np.testing.assert_allclose(J[:, :, 36], found, atol=2e-3)


def test_an_exposure_between_two_has_the_errors_of_both() -> None:
    motions, points = motions_of(), ground(np.random.default_rng(1))
    some, error = motions[::5], np.random.default_rng(3).normal(size=12) * 1e-4
    between = np.concatenate([error[:6] * (1 - k / 5) + error[6:] * k / 5 for k in range(6)])
    full = sensitivity(points, views_of(motions), KeyframePosterior(motions, np.zeros((36, 36)))) @ between
    thin = sensitivity(points, views_of(motions), KeyframePosterior(some, np.zeros((12, 12)))) @ error
    np.testing.assert_allclose(thin, full, atol=5e-4 * np.abs(full).max() + 2e-4 * 5)


def test_what_one_view_sees_is_not_known() -> None:
    motions = motions_of(2)
    far = np.array([[0.0, 0.0, 0.0], [500.0, 0.0, 0.0]])
    J = sensitivity(far, views_of(motions), KeyframePosterior(motions, np.zeros((12, 12))))
    assert np.isfinite(J[0]).all()
    assert np.isnan(J[1]).all()


def a_map(slope: float = 0.0) -> ElevationMap:
    e, _ = np.meshgrid(*GRID.xy())
    full = np.full(GRID.shape, 0.03, np.float32)
    few = np.zeros(GRID.shape, np.uint16)
    few[:4] = np.uint16(Flag.UNSEEN)
    rgb = np.zeros((*GRID.shape, 3), np.uint8)
    six = np.full(GRID.shape, 6, np.uint8)
    return ElevationMap(GRID, (slope * e).astype(np.float32), full, few, six, rgb, full, full)


def datum_of(covariance: F64, slope: float = 0.0) -> ElevationMap:
    motions = motions_of()
    return with_datum(a_map(slope), [Matched(GRID, views_of(motions))], KeyframePosterior(motions, covariance))


def rigid_covariance(sigma: F64) -> F64:
    """Covariance (36, 36) of poses that are turned about the origin (3,) and moved (3,) as one body."""
    F = np.column_stack([
        together(motions_of(), *np.split(np.eye(6)[k] * s, 2)) for k, s in enumerate(sigma)
    ])  # fmt: skip
    return F @ F.T


def test_a_common_tilt_of_the_poses_is_the_tilt_of_the_map() -> None:
    """A tilt about east raises the north; a plane contains all of it, so that no warp is left."""
    found = datum_of(rigid_covariance(np.array([3e-3, 1e-3, 0, 0, 0, 0.2])))
    assert found.datum is not None
    sigma = np.sqrt(np.diag(found.datum.covariance))
    assert sigma[1:] == pytest.approx([1e-3, 3e-3], rel=1e-3)
    assert sigma[0] == pytest.approx(
        np.hypot(0.2, np.hypot(3e-3 * found.datum.north, 1e-3 * found.datum.east)), rel=1e-3
    )
    assert found.warp is not None
    assert found.warp.max() < 1e-4


def test_a_heading_that_is_off_costs_height_where_the_map_is_steep() -> None:
    turned = rigid_covariance(np.array([0, 0, 0.01, 0, 0, 0]))
    level, steep = datum_of(turned), datum_of(turned, slope=0.3)
    assert level.warp is not None
    assert steep.warp is not None
    assert level.warp.max() < 1e-4
    far = np.hypot(2.75, 2.75) * 0.01 / np.sqrt(2) * 0.3  # a metre from the map's rim, where the slope is complete
    assert steep.warp[27, 27] == pytest.approx(far, rel=0.2)
    assert steep.warp[16, 16] < 0.3 * far
    assert (steep.relative_sigma > steep.sigma).any()


def test_errors_of_each_pose_bend_the_map_and_the_claim_holds() -> None:
    """Planes and residuals of 200 draws through the twin of the rays agree with the claimed covariance and warp."""
    motions, rng = motions_of(), np.random.default_rng(7)
    sigma = np.tile(np.repeat([5e-3, 1e-4], 3), 6)
    joint = KeyframePosterior(motions, np.diag(sigma**2))
    found = with_datum(a_map(), [Matched(GRID, views_of(motions))], joint)  # level: only the bend warps it
    assert found.datum is not None
    assert found.warp is not None
    rows, cols = (i[::7] for i in np.nonzero(found.trusted))
    e, n = GRID.xy()
    points = np.column_stack([e[cols], n[rows], np.zeros(len(rows))])
    B = np.column_stack([np.ones(len(points)), points[:, 0] - found.datum.east, points[:, 1] - found.datum.north])
    planes, left = [], []
    for _ in range(200):
        dz = (matched(motions, rng.normal(size=36) * sigma, points) - points)[:, 2]
        planes.append(np.linalg.lstsq(B, dz, rcond=None)[0])
        left.append(dz - B @ planes[-1])
    np.testing.assert_allclose(np.std(planes, axis=0), np.sqrt(np.diag(found.datum.covariance)), rtol=0.2)
    assert np.sqrt(np.mean(np.square(left))) == pytest.approx(np.sqrt(np.mean(found.warp[rows, cols] ** 2)), rel=0.2)


def test_too_little_map_has_no_datum() -> None:
    motions, found = motions_of(), a_map()
    unseen = replace(found, flags=np.full(GRID.shape, Flag.UNSEEN, np.uint16))
    joint = KeyframePosterior(motions, np.eye(36))
    assert with_datum(unseen, [Matched(GRID, views_of(motions))], joint) is unseen
    assert with_datum(found, [], joint) is found


def test_steepness_is_the_slope() -> None:
    assert steepness(a_map(0.3))[16, 16] == pytest.approx(0.3, rel=1e-3)
    holes = a_map(0.3)
    holes.height[::5, ::5] = np.nan
    assert np.isfinite(steepness(holes)).all()


def test_motions_given_out_one_by_one_are_off_as_one() -> None:
    motions = motions_of(3)
    joint = rigid_posterior(motions)
    assert joint is not None
    np.testing.assert_allclose(joint.covariance[-6:, -6:], np.eye(6))
    turn = np.zeros(6)
    turn[3:] = 1e-3, 2e-3, -1e-3
    follow = np.linalg.lstsq(joint.covariance[-6:, -6:], joint.covariance[-6:, :6], rcond=None)[0].T
    apart = motions[0].world_from_body.translation - motions[-1].world_from_body.translation
    np.testing.assert_allclose(follow @ turn, np.r_[skew(turn[3:]) @ apart, turn[3:]], atol=1e-12)
    assert rigid_posterior(()) is None


def test_relative_inflation_leaves_one_pose_and_a_common_motion() -> None:
    """A common motion of all poses is not inflated, but motion relative to the reference pose is."""
    motions = motions_of()
    p = np.array([m.world_from_body.translation for m in motions])
    common = together(motions, np.array([1e-3, 2e-3, 3e-3]), np.array([0.1, 0.2, 0.3])).reshape(-1, 6)
    swapped = common[:, [3, 4, 5, 0, 1, 2]].ravel()  # a clone's rows are rotation, position
    np.testing.assert_allclose(relative_inflation(p, 9.0, 2) @ swapped, swapped, atol=1e-12)
    alone = np.zeros(36)
    alone[:6] = 1.0
    np.testing.assert_allclose(relative_inflation(p, 9.0, 2) @ alone, 3.0 * alone, atol=1e-12)


def test_the_joint_covariance_of_a_recording() -> None:
    """The blocks are those of the motions if track errors are independent; otherwise the middle one keeps its own."""
    f = PointFlight(seed=5, seconds=2.0, count=60)
    plain, _ = run(f.events, NOISE.model_copy(update={"smooth": True, "smoother_repeat": 0.5}))
    refined = plain.refined()
    joint = refined.joint
    assert joint is not None
    assert [m.t_ns for m in joint.motions] == [m.t_ns for m in refined.motions]
    own = np.array([joint.covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(len(joint.motions))])
    np.testing.assert_allclose(own, [m.covariance for m in refined.motions], rtol=1e-6, atol=1e-12)
    repeated, _ = run(f.events, NOISE.model_copy(update={"smooth": True, "smoother_repeat": 20.0}))
    wide = repeated.refined().joint
    assert wide is not None
    k = len(own) // 2
    middle = slice(6 * k, 6 * k + 6)
    np.testing.assert_allclose(wide.covariance[middle, middle], own[k], rtol=1e-6, atol=1e-12)
    seen = np.zeros((3, len(wide.covariance)))
    seen[:, :3], seen[:, 6 * k : 6 * k + 3] = np.eye(3), -np.eye(3)
    arm = wide.motions[0].world_from_body.translation - wide.motions[k].world_from_body.translation
    seen[:, 6 * k + 3 : 6 * k + 6] = skew(arm)  # relative to the middle one, which turns with its frame
    before, after = (np.trace(seen @ j.covariance @ seen.T) for j in (joint, wide))
    assert after > 5.0 * before
    error = np.concatenate([between(m.world_from_body, f.truth(m.t_ns)) for m in joint.motions])
    assert 0.2 < error @ np.linalg.solve(joint.covariance, error) / len(error) < 5.0
