"""Kernels of the bundle adjustment against differences and their NumPy twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twins_bundle as twins

from alight.arrays import F64, I64
from alight.geometry import Camera, so3_exp
from alight.photos.bundle.adjustment_kernels import meet_rays, rays_of_pixels
from alight.photos.bundle.camera_kernels import distort, undistort
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.solver import (
    Adjustment,
    BundleState,
    NormalEquations,
    Priors,
    intersection_angle,
    project_points,
    residuals,
    triangulate_bundle,
)

PINHOLE = Camera(800, 640, 960.0, 950.0, 404.0, 311.0)
BROWN4 = replace(PINHOLE, model="radial-tangential", distortion=(-0.30, 0.12, 0.0008, -0.0005))
BROWN5 = replace(PINHOLE, model="radial-tangential", distortion=(0.18, -0.47, -0.0009, 0.0007, 0.4))
FISHEYE = Camera(800, 640, 420.0, 430.0, 396.0, 322.0, "equidistant", (0.02, -0.01, 0.004, -0.001))
LENSES = {"pinhole": PINHOLE, "radial-tangential": BROWN4, "with k3": BROWN5, "fisheye": FISHEYE}
SIGMA, LOSS, PHOTOS, POINTS = 0.7, 3.0, 5, 14


@pytest.fixture(params=LENSES)
def camera(request: pytest.FixtureRequest) -> Camera:
    return LENSES[request.param]


def coordinates() -> F64:
    """Ideal coordinates all over the picture, on the axes, close to the centre, and at the centre."""
    rng = np.random.default_rng(1)
    edge = np.array([[0.3, 0.0], [0.0, -0.2], [1e-5, 2e-5], [1e-8, 0.0], [1e-12, 1e-12], [0.0, 0.0]])
    return np.concatenate([rng.uniform(-0.45, 0.45, (40, 2)), edge])


def test_lens_derivatives_are_those_of_differences(camera: Camera) -> None:
    flat, by_xy, by_k, h = np.empty(2), np.empty((2, 2)), np.empty((2, 5)), 1e-6
    for at in coordinates():
        distort(at[0], at[1], camera.code, camera.coefficients, flat, by_xy, by_k)
        np.testing.assert_allclose(flat, camera.distort(at), rtol=1e-13, atol=1e-15)
        for k, step in enumerate(h * np.eye(2)):
            slope = (camera.distort(at + step) - camera.distort(at - step)) / (2 * h)
            np.testing.assert_allclose(by_xy[:, k], slope, atol=1e-8)
        for k, step in enumerate(h * np.eye(len(camera.distortion))):
            more, less = (replace(camera, distortion=tuple(camera.distortion + s * step)) for s in (1, -1))
            np.testing.assert_allclose(by_k[:, k], (more.distort(at) - less.distort(at)) / (2 * h), atol=1e-9)


def test_lenses_are_undone(camera: Camera) -> None:
    out, flat, by_xy, by_k = np.empty(2), np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    for at in coordinates():
        there = camera.distort(at)
        undistort(there[0], there[1], camera.code, camera.coefficients, out, flat, by_xy, by_k)
        np.testing.assert_allclose(out, at, atol=1e-12)


def test_beyond_the_fold_of_a_lens_there_is_no_way_back_but_a_number() -> None:
    out, flat, by_xy, by_k = np.empty(2), np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    undistort(3.0, -2.0, BROWN4.code, BROWN4.coefficients, out, flat, by_xy, by_k)
    assert np.isfinite(out).all()


def survey(
    cameras: tuple[Camera, ...], turning: float, seed: int = 3
) -> tuple[BundleState, BundleObservations, Priors]:
    """Photos from 40 m by the cameras in turn; two to five photos see each point, with errors of a few pixels."""
    rng = np.random.default_rng(seed)
    centres = np.column_stack([6.0 * np.arange(PHOTOS), rng.normal(0, 3, PHOTOS), 40 + rng.normal(0, 1, PHOTOS)])
    down = np.diag([1.0, -1.0, -1.0])
    rotations = np.array([so3_exp(rng.normal(0, 0.1, 3)) @ down for _ in range(PHOTOS)])
    points = np.column_stack([rng.uniform(4, 20, POINTS), rng.uniform(-6, 6, POINTS), rng.normal(0, 1, POINTS)])
    seen = [np.sort(rng.choice(PHOTOS, rng.integers(2, PHOTOS + 1), replace=False)) for _ in range(POINTS)]
    lenses = PhotoLenses(cameras, np.arange(PHOTOS) % len(cameras))
    numbers = lenses.parts[-1].stop
    lens = rng.normal(0, 1, numbers) * np.concatenate([_sizes(c) for c in cameras])
    turns = rng.normal(0, 1, (PHOTOS, 2, 3)) * turning
    state = BundleState(centres, rotations, points, lens, rng.normal(0, 0.01, 3), turns)
    photo, point = np.concatenate(seen), np.repeat(np.arange(POINTS), [len(s) for s in seen])
    velocity = rng.normal(0, 4, (PHOTOS, 3))
    obs = BundleObservations(
        photo.astype(np.int64), point, rng.uniform(0, 640, (len(photo), 2)), np.zeros(len(photo), bool)
    )
    pixels = twins.predicted(state, obs, lenses.moved(lens), velocity) + rng.normal(0, 2, obs.pixels.shape)
    free = rng.random(numbers) < 0.7
    priors = Priors(
        centres + rng.normal(0, 1, centres.shape), np.full((PHOTOS, 3), 2.0), rotations @ down.T,
        np.full((PHOTOS, 3), 0.05), down, 0.03, lenses, np.where(free, 0.1, 0.0), velocity, 0.02 if turning else 0.0,
    )  # fmt: skip
    return state, replace(obs, pixels=pixels), priors


def _sizes(camera: Camera) -> F64:
    """Errors of the lens numbers in the survey: scale aspect cu cv distortion... readout."""
    return np.array([0.01, 0.01, 3.0, 3.0, *[0.001] * len(camera.distortion), 0.1])


SETS = {**{name: (lens,) for name, lens in LENSES.items()}, "three cameras": (BROWN5, FISHEYE, PINHOLE)}


@pytest.fixture(params=SETS)
def cameras(request: pytest.FixtureRequest) -> tuple[Camera, ...]:
    return SETS[request.param]


def parts(system: Adjustment, blocks: NormalEquations) -> tuple[F64, F64]:
    """Return the normal equations in full: photos, free lens numbers, mounting, points."""
    p, obs = system.size, system.obs
    H, g = np.zeros((p + 3 * obs.points,) * 2), np.zeros(p + 3 * obs.points)
    H[:p, :p], g[:p] = np.tril(blocks.U) + np.tril(blocks.U, -1).T, blocks.b
    lens = np.arange(len(system.free)) + system.poses
    for k in range(obs.points):
        at = np.arange(3) + p + 3 * k
        H[np.ix_(at, at)], g[at] = blocks.information[k], blocks.gradient[k]
        H[np.ix_(at, lens)] = blocks.lens_coupling[k]
        for n in np.flatnonzero(obs.point == k):
            H[np.ix_(at, np.arange(system.each) + system.each * obs.photo[n])] = blocks.coupling[n]
    H[:p, p:] = H[p:, :p].T
    return H, g


def expected(system: Adjustment, state: BundleState) -> tuple[F64, F64]:
    """Return the normal equations from the twin's rows and the blocks of the priors."""
    p, each = system.size, system.each
    r, J = twins.rows(state, system.obs, system.priors, each)
    mounting = system.poses + len(system.free)
    J = np.concatenate([J[:, :mounting], np.zeros((len(r), p - mounting)), J[:, mounting:]], axis=1)
    w = twins.cauchy_weights(r, system.pixel_sigma, system.loss)
    H, g = J.T @ (w[:, None] * J), -J.T @ (w * r)
    U, b = system.prior_blocks(state)
    H[:p, :p] += U
    g[:p] += b
    return H, g


def close(found: F64, wanted: F64, size: F64, tolerance: float) -> None:
    """Assert equality up to a share of the sizes of the unknowns, for a matrix (p, p) or a right side (p,)."""
    unit = np.multiply.outer(size, size) if found.ndim == 2 else size * np.abs(wanted / size).max()
    np.testing.assert_allclose(found / unit, wanted / unit, atol=tolerance)


@pytest.mark.parametrize("turning", [0.0, 0.02])
def test_blocks_are_those_of_the_rows_written_out(cameras: tuple[Camera, ...], turning: float) -> None:
    """The blocks agree for every lens, with and without turns, and for several cameras with their own free numbers."""
    state, obs, priors = survey(cameras, turning)
    system = Adjustment(obs, priors, sigmas(obs), LOSS)
    blocks = system.linearise(state)
    H, g = parts(system, blocks)
    wanted, right = expected(system, state)
    size = np.sqrt(np.diag(wanted))
    close(H, wanted, size, 1e-6)
    close(g, right, size, 1e-6)


@pytest.mark.parametrize("turning", [0.0, 1e-7])
def test_rows_are_those_of_differences(cameras: tuple[Camera, ...], turning: float) -> None:
    """The twin's derivatives agree with differences of predicted pixels before and after steps of the unknowns.

    The turns are near zero: eq. 11 neglects the effect of one turn on the next.
    """
    state, obs, priors = survey(cameras, turning)
    each = 12 if turning else 6
    _, J = twins.rows(state, obs, priors, each)
    free = np.flatnonzero(priors.sigma_lens > 0)

    def moved(step: F64) -> F64:
        photos = step[: each * PHOTOS].reshape(PHOTOS, each)
        lens = state.lens.copy()
        lens[free] += step[each * PHOTOS : each * PHOTOS + len(free)]
        turned = np.array([so3_exp(w) for w in photos[:, 3:6]]) @ state.rotations
        turns = state.turns + photos[:, 6:].reshape(PHOTOS, 2, 3) if turning else state.turns
        x = state.points + step[each * PHOTOS + len(free) :].reshape(-1, 3)
        after = BundleState(state.centres + photos[:, :3], turned, x, lens, state.mounting, turns)
        return project_points(after, obs, priors).pixels.ravel()

    for k in range(J.shape[1]):
        step = 1e-6 * np.eye(J.shape[1])[k]
        np.testing.assert_allclose(J[:, k], (moved(step) - moved(-step)) / 2e-6, rtol=1e-5, atol=2e-3)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("turning", [0.0, 0.02])
def test_the_reduced_system_is_the_dense_schur_complement(
    cameras: tuple[Camera, ...], turning: float, damping: float
) -> None:
    """Matrix, right side and steps of the points agree with the solution of the whole system."""
    state, obs, priors = survey(cameras, turning)
    system = Adjustment(obs, priors, sigmas(obs), LOSS)
    blocks = system.linearise(state)
    H, g = parts(system, blocks)
    H += damping * np.diag(np.diag(H))
    p = system.size
    gain = np.linalg.solve(H[p:, p:], H[p:, :p]).T
    S, rhs, _ = system.reduce(blocks, damping)
    size = np.sqrt(np.diag(H))[:p]
    close(S, H[:p, :p] - gain @ H[p:, :p], size, 1e-9)
    close(rhs, g[:p] - gain @ g[p:], size, 1e-9)
    np.testing.assert_array_equal(S, S.T)
    after, step = system.step(state, blocks, damping), np.linalg.solve(H, g)
    np.testing.assert_allclose(after.points - state.points, step[p:].reshape(-1, 3), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(after.mounting - state.mounting, step[p - 3 : p], rtol=1e-5, atol=1e-9)


def test_a_point_behind_a_camera_is_far_off_and_no_reason_to_stop() -> None:
    state, obs, priors = survey((BROWN5,), 0.02)
    points = state.points.copy()
    points[3, 2] = 200.0
    state = replace(state, points=points)
    pixels, depth = project_points(state, obs, priors)
    behind = obs.point == 3
    assert (depth[behind] < 0).all()
    assert np.isnan(pixels[behind]).all()
    assert np.isfinite(pixels[~behind]).all()
    np.testing.assert_array_equal(residuals(state, obs, priors)[behind], twins.FAR)
    system = Adjustment(obs, priors, sigmas(obs), LOSS)
    assert np.isfinite(system.reduce(system.linearise(state), 1e-3).S).all()


@pytest.mark.parametrize("turning", [0.0, 0.02])
def test_predictions_and_rays_are_those_of_numpy(cameras: tuple[Camera, ...], turning: float) -> None:
    """Predicted pixels agree with NumPy, and so do directions and origins of the rays of observed pixels."""
    state, obs, priors = survey(cameras, turning)
    lenses = priors.lenses.moved(state.lens)
    pixels, _ = project_points(state, obs, priors)
    np.testing.assert_allclose(pixels, twins.predicted(state, obs, lenses, priors.velocity), atol=1e-9)
    ray, origin = np.empty((2, len(obs.photo), 3))
    rays_of_pixels(*state.for_kernels(obs, priors), ray, origin)
    for n, (photo, pixel) in enumerate(zip(obs.photo, obs.pixels, strict=True)):
        R, C, _ = twins.exposed(state, lenses, priors.velocity, int(photo), pixel[1])
        wanted = R @ lenses.of_photo(int(photo)).rays(pixel)
        np.testing.assert_allclose(ray[n], wanted / np.linalg.norm(wanted), atol=1e-9)
        np.testing.assert_allclose(origin[n], C, atol=1e-12)


def sigmas(obs: BundleObservations) -> F64:
    """Sigmas (N,) in px, some of features and some of patches."""
    return np.where(np.arange(len(obs.photo)) % 3, SIGMA, 0.2 * SIGMA)


def starts_of(obs: BundleObservations) -> I64:
    return np.append(obs.starts, len(obs.point))


def test_points_are_where_their_rays_meet() -> None:
    """The points are those of NumPy with the same reweighting; one ray is far off."""
    state, obs, priors = survey((BROWN4,), 0.02)
    obs.pixels[np.flatnonzero(np.bincount(obs.point)[obs.point] > 4)[0]] += [60.0, 0.0]
    lenses = priors.lenses.moved(state.lens)
    ray, origin = np.empty((2, len(obs.photo), 3))
    rays_of_pixels(*state.for_kernels(obs, priors), ray, origin)
    focal, out = lenses.focal(obs.photo)[:, 0], np.empty((POINTS, 3))
    meet_rays(starts_of(obs), ray, origin, focal, 4, 3.0, 1e-9, np.ones(len(ray)), out)
    wanted = twins.meeting_points(starts_of(obs), ray, origin, focal, 4, 3.0)
    np.testing.assert_allclose(out, wanted, atol=1e-6)
    np.testing.assert_array_equal(out, triangulate_bundle(state, obs, priors))


def test_angles_between_rays_are_those_of_numpy() -> None:
    state, obs, _ = survey((PINHOLE,), 0.0)
    d = state.points[obs.point] - state.centres[obs.photo]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(d[obs.starts][obs.point], d), axis=1)
    wanted = np.maximum.reduceat(np.arcsin(sine), obs.starts)
    np.testing.assert_allclose(intersection_angle(state.points, state.centres, obs), wanted, atol=1e-12)


def test_no_observation_is_no_error() -> None:
    state, obs, priors = survey((PINHOLE,), 0.0)
    none = obs.keep(np.zeros(len(obs.photo), bool))[0]
    empty = replace(state, points=np.empty((0, 3)))
    assert triangulate_bundle(empty, none, priors).shape == (0, 3)
    assert intersection_angle(empty.points, empty.centres, none).shape == (0,)
    system = Adjustment(none, priors, sigmas(none), LOSS)
    reduced = system.reduce(system.linearise(empty), 0.0)
    np.testing.assert_allclose(reduced.S, system.prior_blocks(empty)[0], atol=1e-10)
