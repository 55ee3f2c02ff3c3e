"""Poses refined with the map: the kernel and its twin, Jacobians, the prior of the poses, bad and good poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from ground_views import UP, Scene, Texture, plane
from numpy.testing import assert_allclose, assert_array_equal

from alight.elevation import TiledElevation
from alight.geometry import Grid, Pose, ground_projection, plane_on, so3_exp
from alight.parallax.pose_refinement import kernels
from alight.parallax.pose_refinement.alignment import Alignment
from alight.parallax.pose_refinement.gaussian import PoseGaussian, between, corrected_pose, regress_on
from alight.parallax.pose_refinement.kernels import PLANE, POSE
from alight.parallax.recursive import RecursiveParallax
from alight.pipeline.navigation.given import GivenLane
from alight.records import Datum, ElevationMap, Frame, Heights, KeyframePosterior, Motion, Rig, RigCamera, View
from alight.settings import MotionSettings, ParallaxSettings
from alight.spread import nmad

CELL = 0.2
GRID = Grid(-5.9, 4.5, CELL, 46, 60)
EAST, NORTH = np.meshgrid(*GRID.xy())
COUNT, SPACING = 9, 0.6
SIGMA = np.repeat([0.08, np.radians(0.4)], 3)  # of a pose: 1.2 px of this camera
PX = CELL * UP / (SPACING * (COUNT - 1))

F64 = np.ndarray


# -- the normal equations


def some_cells(seed: int) -> dict[str, np.ndarray]:
    """Random samples of five views of three exposures; some weights are zero, some cells unknown."""
    rng = np.random.default_rng(seed)
    n, rows, cols = 5, 4, 7
    weights = rng.uniform(0.2, 1.0, (n, rows, cols)).astype(np.float32)
    weights[rng.uniform(size=weights.shape) < 0.2] = 0.0
    weights[:, 1, 2] = 0.0
    mean = rng.normal(size=(5, rows, cols)).astype(np.float32)
    mean[1, 0, 3] = np.nan
    h = rng.normal(0, 0.5, (rows, cols)).astype(np.float32)
    samples = rng.normal(size=(n, rows, cols)).astype(np.float32)
    samples[weights == 0.0] = np.nan
    return {
        "samples": samples, "weights": weights, "mean": mean, "owner": np.array([0, 0, 1, 2, 2], np.int64),
        "centres": np.c_[rng.normal(0, 3, (n, 2)), rng.uniform(18, 22, n)],
        "pivots": np.c_[rng.normal(0, 3, (3, 2)), [20, 21, 19]], "precision": rng.uniform(5, 20, n),
        "xs": 1.0 + 0.6 * np.arange(cols), "ys": 2.0 - 0.6 * np.arange(rows), "h": h,
        "about": np.array([3.0, -1.0]), "arm": 0.2, "kappa": rng.uniform(0.5, 50, (rows, cols)).astype(np.float32),
    }  # fmt: skip


def twin(c: dict[str, np.ndarray]) -> tuple[F64, F64]:
    """Normal equations from every residual, with the plane, the poses, and each cell's own value and height."""
    M = PLANE + POSE * len(c["pivots"])
    A, b = np.zeros((M, M)), np.zeros(M)
    for r, y in enumerate(c["ys"]):
        for k, x in enumerate(c["xs"]):
            m = c["mean"][:, r, k].astype(np.float64)
            gx, gy = (m[1] - m[2]) / (2 * c["arm"]), (m[3] - m[4]) / (2 * c["arm"])
            seen = np.flatnonzero(c["weights"][:, r, k] > 0)
            if not np.isfinite(m[0] + gx + gy) or not len(seen):
                continue
            X, phi = np.array([x, y, float(c["h"][r, k])]), np.array([1.0, x - c["about"][0], y - c["about"][1]])
            J, e, w = np.zeros((len(seen) + 1, M + 2)), np.zeros(len(seen) + 1), np.ones(len(seen) + 1)
            for row, i in enumerate(seen):
                C, p = c["centres"][i], c["pivots"][c["owner"][i]]
                q = (gx * (x - C[0]) + gy * (y - C[1])) / (C[2] - X[2])
                g = np.array([gx, gy, q])
                at = PLANE + POSE * c["owner"][i]
                J[row, at : at + 6] = np.r_[g, np.cross(X - p, g)]
                J[row, M], J[row, M + 1] = 1.0, -q  # template value, height
                e[row], w[row] = c["samples"][i, r, k] - m[0], c["weights"][i, r, k] * c["precision"][i]
            J[-1, :PLANE], J[-1, M + 1], w[-1] = -phi, 1.0, c["kappa"][r, k]  # the height varies about the map's plane
            N, g = J.T @ (J * w[:, None]), J.T @ (w * e)
            inner = np.linalg.pinv(N[M:, M:])
            A += N[:M, :M] - N[:M, M:] @ inner @ N[M:, :M]
            b += g[:M] - N[:M, M:] @ inner @ g[M:]
    return A, b


def filled(c: dict[str, np.ndarray]) -> tuple[F64, F64]:
    M, rows = PLANE + POSE * len(c["pivots"]), len(c["ys"])
    A, b = np.full((rows, M, M), 7.0), np.full((rows, M), 7.0)
    c["about"].flags.writeable = False  # as of a pose: another type is compiled anew
    kernels.joint_normal_equations(*c.values(), A, b)
    assert not np.tril(A, -1).any()
    upper = A.sum(axis=0)
    return upper + np.triu(upper, 1).T, b.sum(axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_normal_equations_are_those_of_all_residuals_written_down(seed: int) -> None:
    c = some_cells(seed)
    A, b = filled(c)
    A_twin, b_twin = twin(c)
    assert_allclose(A, A_twin, rtol=1e-6, atol=1e-6 * np.abs(A_twin).max())
    assert_allclose(b, b_twin, rtol=1e-6, atol=1e-6 * np.abs(b_twin).max())


def test_a_pose_error_slides_the_ground_as_its_derivative_says() -> None:
    """A pixel's ray meets level ground from the assumed and from the true pose; the difference agrees with eq. 18."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        body = Pose(so3_exp(rng.normal(0, 0.1, 3)) @ np.diag([1.0, -1, -1]), np.array([*rng.normal(0, 2, 2), 20.0]))
        mount = Pose(so3_exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.3, 3))
        X = np.array([*rng.normal(0, 5, 2), rng.normal()])
        error = rng.normal(0, 1e-5, 6)

        def ground(pose: Pose, ray: F64, level: float) -> F64:
            d = pose.rotation @ ray
            return (pose.translation + d * (level - pose.translation[2]) / d[2])[:2]

        cam, true = body @ mount, corrected_pose(body, error) @ mount
        H, b = ground_projection(cam)
        ray = H @ [X[0], X[1], 1.0] + X[2] * b
        slide = ground(true, ray, X[2]) - ground(cam, ray, X[2])
        for g in np.eye(2):
            q = g @ (X[:2] - cam.translation[:2]) / (cam.translation[2] - X[2])
            full = np.array([*g, q])
            J = np.concatenate([full, np.cross(X - body.translation, full)])
            assert_allclose(J @ error, g @ slide, atol=1e-8)


ANY_CAMERA = Scene().camera


# -- prior of the poses


def motions(count: int, seed: int = 0) -> tuple[Motion, ...]:
    rng = np.random.default_rng(seed)
    poses = [Pose(so3_exp(rng.normal(0, 0.01, 3)), rng.normal(size=3)) for _ in range(count)]
    return tuple(Motion(k, p, (p,), np.eye(6)) for k, p in enumerate(poses))


def covariance(size: int, seed: int) -> F64:
    L = np.random.default_rng(seed).normal(size=(size, size))
    return 1e-4 * (L @ L.T + 0.1 * np.eye(size))


def test_a_posterior_replaces_the_distribution_and_the_rest_follows() -> None:
    """The update is the joint Gaussian: other unknowns keep their density given the replaced poses (eq. 23)."""
    ms = motions(4)
    first = PoseGaussian.none(np.array([0.3, 0.02, 0.01])).with_posterior(KeyframePosterior(ms[:3], covariance(18, 1)))
    P = covariance(PLANE + 18, 2)  # pictures have tied the plane and the poses
    first = first.corrected(np.zeros(len(P)), P)
    error = np.random.default_rng(3).normal(0, 0.01, 12)
    again = tuple(
        replace(m, world_from_body=corrected_pose(m.world_from_body, error[6 * k : 6 * k + 6]))
        for k, m in enumerate(ms[1:3])
    )
    Q = covariance(18, 4)
    then = first.with_posterior(KeyframePosterior((*again, ms[3]), Q))
    shared, rest = np.arange(9, 21), np.arange(9)  # exposures 1 and 2; the plane and exposure 0
    gain = P[np.ix_(rest, shared)] @ np.linalg.inv(P[np.ix_(shared, shared)])
    left = P[np.ix_(rest, rest)] - gain @ P[np.ix_(shared, rest)]
    T = np.zeros((27, 27))
    T[np.ix_(rest, shared)] = gain @ Q[:12, :12]
    T[np.ix_(rest, np.arange(21, 27))] = gain @ Q[:12, 12:]
    T[np.ix_(np.arange(9, 27), np.arange(9, 27))] = Q
    T[np.ix_(rest, rest)] = left + gain @ Q[:12, :12] @ gain.T
    T = np.triu(T) + np.triu(T, 1).T
    assert tuple(then.poses) == (0, 1, 2, 3)
    assert_allclose(then.covariance, T, atol=1e-10)
    assert np.linalg.eigvalsh(then.covariance).min() > 0
    assert_allclose(then.plane, (gain @ error)[:3], atol=1e-9)
    assert_allclose(between(ms[0].world_from_body, then.poses[0]), (gain @ error)[3:], atol=1e-6)
    assert_allclose(between(ms[1].world_from_body, then.poses[1]), error[:6], atol=1e-9)
    kept = then.kept({0, 3})
    rows = np.r_[0:9, 21:27]
    assert_array_equal(kept.covariance, then.covariance[np.ix_(rows, rows)])
    assert tuple(kept.poses) == (0, 3)


def test_poses_of_separate_posteriors_are_independent() -> None:
    ms = motions(2)
    joint = PoseGaussian.none(np.ones(3))
    for m in ms:
        joint = joint.with_posterior(KeyframePosterior((m,), m.covariance))
    assert_array_equal(joint.covariance, np.eye(15))


def test_errors_in_common_are_passed_on_whole() -> None:
    """The covariance is singular: the common error of all is predicted for the next one, too."""
    assert_allclose(regress_on(np.ones((3, 3)), np.ones((3, 1))), np.full((1, 3), 1 / 3), atol=1e-6)


def test_given_poses_have_a_posterior_when_the_settings_give_them_errors() -> None:
    rig = Rig((RigCamera("cam0", ANY_CAMERA, Pose()),))
    times = np.array([0, 10**8], np.int64), [Pose(), Pose(np.eye(3), np.ones(3))]
    frame = Frame(10**8, (np.zeros((120, 160), np.uint8),))
    exact, rough = (
        GivenLane(rig, times, MotionSettings(given_position_sigma=a, given_attitude_sigma=b))
        for a, b in ((0.0, 0.0), (0.05, 0.003))
    )
    known, found = exact.feed(frame), rough.feed(frame)
    assert known is not None
    assert known.posterior is None
    assert found is not None
    assert found.posterior is not None
    assert found.posterior.motions == (found.motion,)
    assert_allclose(np.sqrt(np.diag(found.posterior.covariance)), [0.05] * 3 + [0.003] * 3)


# -- flights


@cache
def scene() -> Scene:
    return Scene(surface=plane(0.05, 0.03, 0.1), top=0.8, spacing=SPACING, paint=Texture(1))


@cache
def true_views() -> tuple[View, ...]:
    return tuple(scene().views(COUNT))


def off(errors: F64) -> list[tuple[View, Motion]]:
    """Return the views and motions with these (COUNT, 6) errors in their poses."""
    out = []
    for v, e in zip(true_views(), errors, strict=True):
        pose = corrected_pose(v.world_from_cam, e)
        out.append((replace(v, world_from_cam=pose), Motion(v.t_ns, pose, (pose,), np.diag(SIGMA**2))))
    return out


def flown(
    errors: F64, refine: bool = True, posterior: Callable[[list[Motion]], KeyframePosterior] | None = None
) -> ElevationMap:
    """Return the recursive map with poses given one by one, or as what `posterior` makes of all so far."""
    estimator, elevation, seen = (
        RecursiveParallax(ParallaxSettings(), CELL, 0.1),
        TiledElevation(CELL, 64),
        list[Motion](),
    )
    datum: Datum | None = None
    for view, motion in off(errors):
        seen.append(motion)
        poses = posterior(seen) if posterior else KeyframePosterior((motion,), motion.covariance)
        estimator.push([view], poses if refine else None)
        parts = estimator.step(GRID, elevation.read(GRID), -4.0, 4.0)
        elevation.add_plane(estimator.alignment.plane, estimator.alignment.about)
        for part in parts:
            elevation.add(part, replace_all=True)
            datum = part.datum
    return replace(elevation.read(GRID), datum=datum)


def white(seed: int) -> F64:
    return np.random.default_rng(seed).normal(size=(COUNT, 6)) * SIGMA


NOTHING = np.zeros((COUNT, 6))


def shape(found: ElevationMap) -> tuple[float, F64]:
    """Spread of the errors about their plane, and the plane at the datum's centre."""
    about = np.zeros(2) if found.datum is None else np.array([found.datum.east, found.datum.north])
    ok = found.trusted
    e = (found.height - scene().surface(EAST, NORTH))[ok]
    A = np.c_[np.ones(len(e)), EAST[ok] - about[0], NORTH[ok] - about[1]]
    fit = np.linalg.lstsq(A, e, rcond=None)[0]
    rest = e - A @ fit
    return nmad(rest), fit


@cache
def perfect() -> float:
    return shape(flown(NOTHING, refine=False))[0]


def test_bad_poses_are_repaired() -> None:
    """Each exposure is off by more than a pixel: the shape is ruined without refinement, and good with it."""
    raw, mended = flown(white(1), refine=False), flown(white(1))
    assert raw.trusted.mean() < 0.5 or shape(raw)[0] > 3 * perfect()
    assert mended.trusted.mean() > 0.9
    assert shape(mended)[0] < 1.25 * perfect() < 0.1 * PX


def test_good_poses_are_left_alone() -> None:
    """With true poses and a claimed error, the shape stays, and the map's plane lies within its claimed covariance."""
    found = flown(NOTHING)
    spread, fit = shape(found)
    assert found.datum is not None
    assert spread < 1.1 * perfect()
    assert (np.abs(fit) < np.sqrt(np.diag(found.datum.covariance))).all()


def test_exact_poses_do_not_move() -> None:
    """With poses claimed exact to a tenth of a millimetre, the result is that without refinement."""
    exact = flown(NOTHING, posterior=lambda ms: KeyframePosterior((ms[-1],), 1e-8 * np.eye(6)))
    plain = flown(NOTHING, refine=False)
    both = exact.trusted & plain.trusted
    assert both.mean() > 0.95
    assert np.percentile(np.abs(exact.height - plain.height)[both], 95) < 0.05 * PX
    assert shape(exact)[0] < 1.05 * perfect()


def test_the_datum_follows_the_prior() -> None:
    """No picture shows the error that all poses share: the map is raised and tilted by it, and the datum covers it.

    The poses have a common error, and the joint covariance claims such an error.
    """
    common = np.repeat((2.0 * np.array([0.01, -0.02, 0.05, 0.002, -0.001, 0.001]))[None], COUNT, axis=0)

    def together(ms: list[Motion]) -> KeyframePosterior:
        n = len(ms)
        return KeyframePosterior(tuple(ms), np.kron(np.ones((n, n)) + 1e-4 * np.eye(n), np.diag(SIGMA**2)))

    found = flown(common, posterior=together)
    spread, fit = shape(found)
    assert found.datum is not None
    assert spread < 1.25 * perfect()
    assert fit[0] == pytest.approx(common[0, 2], abs=0.05)
    assert fit @ np.linalg.solve(found.datum.covariance, fit) < 16.3  # 99.9 % of chi squared of three
    sigma = np.sqrt(np.diag(found.datum.covariance))
    assert SIGMA[0] < sigma[0] < 4 * SIGMA[0]
    assert 0.5 * SIGMA[3] < sigma[1:].max() < 2 * SIGMA[3]


def test_the_datum_covers_what_the_map_is_off() -> None:
    for seed in (2, 3, 4):
        found = flown(white(seed))
        fit = shape(found)[1]
        assert found.datum is not None
        assert fit @ np.linalg.solve(found.datum.covariance, fit) < 16.3  # 99.9 %


def test_threads_do_not_matter(on_one_and_all: Callable[..., Any]) -> None:
    one, two = on_one_and_all(lambda: flown(white(5)))
    assert one.height.tobytes() == two.height.tobytes()
    assert one.datum is not None
    assert two.datum is not None
    assert_array_equal(one.datum.covariance, two.datum.covariance)


def test_pictures_of_nothing_change_nothing() -> None:
    """Pictures without texture, or each of another texture, leave poses and map as they are, without NaN.

    Cells that the map trusts have a sigma above the limit of a hundredth of the height.
    """
    rng = np.random.default_rng(0)
    for paint in (lambda: np.full((120, 160), 90, np.uint8), lambda: rng.integers(0, 255, (120, 160), dtype=np.uint8)):
        estimator, elevation = RecursiveParallax(ParallaxSettings(), CELL, 0.1), TiledElevation(CELL, 64)
        for view, motion in off(white(6)):
            estimator.push([replace(view, image=paint())], KeyframePosterior((motion,), motion.covariance))
            parts = estimator.step(GRID, elevation.read(GRID), -4.0, 4.0)
            assert np.isfinite(estimator.alignment.plane).all()
            for part in parts:
                elevation.add(part, replace_all=True)
        left = elevation.read(GRID)
        assert left.trusted.mean() < 0.01
        assert (left.sigma[left.trusted] > 0.01 * UP).all()


def test_the_map_leans_where_it_is_held() -> None:
    elevation = TiledElevation(CELL, 64)
    found = flown(NOTHING, refine=False)
    fields = {k: getattr(found, k) for k in ("height", "sigma", "flags", "views", "rgb", "residual", "sampling")}
    elevation.add(Heights(GRID, **fields), replace_all=True)
    before = elevation.read(GRID).height
    by, about = np.array([0.2, 0.01, -0.02]), np.array([1.0, 2.0])
    elevation.add_plane(by, about)
    after = elevation.read(GRID)
    known = np.isfinite(before)
    assert_allclose(after.height[known], (before + plane_on(*GRID.xy(), by, about))[known], atol=1e-5)
    assert np.isnan(after.height[~known]).all()


# -- the plane of the map, from keyframe to keyframe


def at(place: F64) -> KeyframePosterior:
    """The posterior of one keyframe."""
    pose = Pose(np.diag([1.0, -1.0, -1.0]), place)
    return KeyframePosterior((Motion(0, pose, (pose,), 1e-8 * np.eye(6)),), 1e-8 * np.eye(6))


def known_plane(posterior: KeyframePosterior) -> Alignment:
    """An alignment that knows its map's plane exactly."""
    out = Alignment(ParallaxSettings())
    out.update_posterior(posterior, {0}, UP)
    assert out.state is not None
    out.state, out.mapped = replace(out.state, covariance=np.zeros_like(out.state.covariance)), True
    return out


@pytest.mark.parametrize("away", [0.0, 100.0, 1000.0])
def test_new_ground_is_as_near_to_the_plane_of_the_map_however_far_the_flight_has_come(away: float) -> None:
    """Its tilt wanders about the vehicle. About the first keyframe, 2e-4 rad would be 0.2 m of height 1 km away."""
    lane, here = known_plane(at(np.array([3.0, -2.0, UP]))), np.array([3.0 + away, -2.0 + 0.5 * away])
    lane.state = lane.prior(UP, here)
    datum = lane.datum(Grid(here[0] - 1.9, here[1] + 1.9, 0.2, 20, 20))
    assert datum is not None
    wander = ParallaxSettings().poses.wander
    assert datum.offset_sigma == pytest.approx(wander[0] * UP, rel=1e-3)
    assert datum.tilt_sigma == pytest.approx(wander[1], rel=1e-6)
