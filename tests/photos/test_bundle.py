"""Bundle adjustment on simulated observations: exact and noisy, wrong matches, wrong and missing tags."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from length import first
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

pytest.importorskip("pycolmap")


from alight.geometry import Camera, Pose, enu_from_flu, so3_exp, so3_log
from alight.photos.bundle.adjust import confirmed, joint_of, select, solve_bundle
from alight.photos.bundle.exposure import exposure_gains
from alight.photos.bundle.features import PhotoFeatures
from alight.photos.bundle.matching import BundleObservations, Pair, match_descriptors, neighbours, tracks, verify
from alight.photos.bundle.orientation import first_poses
from alight.photos.bundle.priors import make_priors, rolling_priors, velocities
from alight.photos.bundle.solver import (
    Adjustment,
    BundleState,
    Priors,
    covariance_of,
    residuals,
    solved_steps,
    triangulate_bundle,
)
from alight.photos.bundle.summary import Solved
from alight.records import Motion, NavSample, Rig, RigCamera
from alight.settings import BundleSettings
from alight.spread import robust_sigma

F64 = NDArray[np.float64]
CAMERA = Camera(800, 640, 960.0, 960.0, 404.0, 311.0, "radial-tangential", (-0.30, 0.12, 0.0008, -0.0005))
LOOKS_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # the optical axis is body x
HALF_TURN = np.diag([1.0, -1.0, -1.0])  # about body x
GPS_TURN = 4e-3  # rad: 2 cm of GPS noise on strips 11 m apart


@dataclass(frozen=True)
class Scene:
    centres: F64
    body: F64  # (n, 3, 3)
    points: F64
    features: list[PhotoFeatures]
    ids: list[NDArray[np.int64]]  # the point behind each feature
    pairs: list[Pair]
    observations: BundleObservations


def flight(strips: int, photos: int, pitch: float = -np.pi / 2) -> tuple[F64, F64]:
    """Photos at 40 m, down unless `pitch` is given, neighbouring strips flown there and back."""
    rng = np.random.default_rng(5)
    centres, body = [], []
    for s in range(strips):
        for k in range(photos):
            along = 6.0 * (k if s % 2 == 0 else photos - 1 - k)
            centres.append(np.array([along, 11.0 * s, 40.0]) + rng.normal(0, 0.4, 3))
            yaw = np.pi / 2 if s % 2 == 0 else -np.pi / 2
            body.append(so3_exp(rng.normal(0, 0.02, 3)) @ enu_from_flu(yaw, pitch, 0.0))
    return np.array(centres), np.array(body)


def a_photo(pixels: F64, colours: F64 | None = None) -> PhotoFeatures:
    """Return features without descriptors."""
    grey = np.full((len(pixels), 3), 100.0) if colours is None else colours
    return PhotoFeatures(pixels, np.empty((len(pixels), 128), np.uint8), grey.astype(np.float32))


def scene(
    strips: int = 2,
    photos: int = 6,
    noise: float = 0.0,
    wrong: float = 0.0,
    camera: Camera = CAMERA,
    pitch: float = -np.pi / 2,
) -> Scene:
    """Photos of random points over relief; a share of the matches is wrong."""
    rng = np.random.default_rng(11)
    centres, body = flight(strips, photos, pitch)
    xy = rng.uniform([-15, -13], [6.0 * photos + 10, 11.0 * strips + 5], (1500, 2))
    points = np.column_stack([xy, 2.5 * np.sin(xy[:, 0] / 5) + rng.normal(0, 0.4, len(xy))])
    features, ids = [], []
    for C, B in zip(centres, body, strict=True):
        px = camera.project((points - C) @ (B @ LOOKS_FORWARD))
        seen = np.flatnonzero(((px > 0) & (px < [camera.width - 1, camera.height - 1])).all(axis=1))
        features.append(a_photo(px[seen] + rng.normal(0, noise, (len(seen), 2))))
        ids.append(seen)
    pairs = []
    for i, j in neighbours(centres, 5):
        common, a, b = np.intersect1d(ids[i], ids[j], return_indices=True)
        spoilt = rng.random(len(common)) < wrong
        b[spoilt] = rng.permutation(b[spoilt])
        found = verify((camera, camera), features[i], features[j], np.stack([a, b], axis=1))
        pairs += [] if found is None else [Pair(i, j, *found)]
    return Scene(centres, body, points, features, ids, pairs, tracks(features, pairs))


def told(
    s: Scene,
    sigma: float = 0.02,
    mounting: F64 | None = None,
    camera: Camera = CAMERA,
    readout: float | None = None,
    **settings: object,
) -> Priors:
    """Priors by GPS (with noise), gimbal (with a mounting error) and the maker's calibration."""
    rng = np.random.default_rng(23)
    off = so3_exp(np.zeros(3) if mounting is None else mounting)
    nav = [
        NavSample(
            k, C + rng.normal(0, sigma, 3) if sigma else C, B @ off.T, sigma_position=np.full(3, max(sigma, 0.01))
        )
        for k, (C, B) in enumerate(zip(s.centres, s.body, strict=True))
    ]
    return make_priors(
        nav, Rig((RigCamera("cam0", camera, Pose(LOOKS_FORWARD), readout),)), BundleSettings.model_validate(settings)
    )


def solved(s: Scene, priors: Priors, seconds: F64 | None = None, **settings: object) -> Solved:
    out = solve_bundle(s.observations, s.pairs, priors, BundleSettings.model_validate(settings), seconds=seconds)
    assert out is not None
    return out


def misfit(out: Solved) -> float:
    """1-sigma of the observations about their predictions, px."""
    return robust_sigma(residuals(out.state, out.observations, out.priors))


def errors(s: Scene, out: Solved) -> tuple[float, float]:
    """RMS of centres (m) and largest rotation error (rad) over the registered photos."""
    k = out.registered
    d = out.state.centres[k] - s.centres[k]
    turn = [
        np.linalg.norm(so3_log(R @ (B @ LOOKS_FORWARD).T))
        for R, B in zip(out.state.rotations[k], s.body[k], strict=True)
    ]
    return float(np.sqrt((d**2).sum(axis=1).mean())), float(np.max(turn))


@pytest.fixture(scope="module")
def exact() -> Scene:
    return scene()


@pytest.fixture(scope="module")
def noisy() -> Scene:
    return scene(noise=0.4, wrong=0.02)


def test_exact_observations_give_the_exact_poses(exact: Scene) -> None:
    out = solved(exact, told(exact, sigma=0.0, lens="held"))
    centre, turn = errors(exact, out)
    assert list(out.registered) == list(range(12))
    assert centre < 2e-3
    assert turn < 1e-4


def test_noise_and_wrong_matches_cost_little(noisy: Scene) -> None:
    out = solved(noisy, told(noisy, lens="held"))
    centre, turn = errors(noisy, out)
    assert centre < 0.04
    assert turn < GPS_TURN


def test_the_covariance_is_honest(noisy: Scene) -> None:
    """The NEES of centres and rotations stays at the order of its 6 degrees of freedom."""
    out = solved(noisy, told(noisy, lens="held"))
    nees = []
    for i in out.registered:
        turn = so3_log(out.state.rotations[i] @ (noisy.body[i] @ LOOKS_FORWARD).T)
        e = np.concatenate([out.state.centres[i] - noisy.centres[i], turn])
        nees.append(e @ np.linalg.solve(out.covariance[i], e))
    assert 1.0 < np.mean(nees) < 15.0


def test_the_joint_covariance_holds_poses_and_lens_together(noisy: Scene) -> None:
    """Poses are in order of time, the lens in units of its own sigma; errors, also of the body, fit the covariance."""
    rig_lever = Pose(LOOKS_FORWARD, [0.2, 0.0, -0.1])
    out = solved(noisy, told(noisy, lens="free"))
    motions = []
    for i in out.registered:
        camera = Pose(out.state.rotations[i], out.state.centres[i])
        motions.append(Motion(100 - int(i), camera @ rig_lever.inverse, (camera,), out.covariance[i]))
    joint = joint_of(motions, told(noisy, lens="free"), out)
    K, L = len(motions), int(out.free.sum())
    assert L > 0
    assert [m.t_ns for m in joint.motions] == sorted(m.t_ns for m in motions)
    assert len(joint.lenses) == L
    assert joint.covariance.shape == (6 * K + L, 6 * K + L)
    np.testing.assert_allclose(np.diag(joint.covariance)[6 * K :], 1.0)
    error = []
    for m in joint.motions:
        i = 100 - m.t_ns
        true = Pose(noisy.body[i] @ LOOKS_FORWARD, noisy.centres[i]) @ rig_lever.inverse
        error += [true.translation - m.world_from_body.translation]
        error += [so3_log(true.rotation @ m.world_from_body.rotation.T)]
    sigma = np.sqrt(np.diag(out.joint)[6 * len(noisy.centres) :])
    e = np.concatenate([*error, -out.state.lens[out.free] / sigma])
    assert 0.2 < e @ np.linalg.solve(joint.covariance, e) / len(e) < 2.5


def test_the_mounting_of_the_camera_is_found(noisy: Scene) -> None:
    mounting = np.radians([2.0, 0.0, 0.7])
    out = solved(noisy, told(noisy, mounting=mounting, lens="held", attitude_sigma=0.005, heading_sigma=0.01))
    assert np.linalg.norm(out.state.mounting - mounting) < GPS_TURN
    assert errors(noisy, out)[1] < GPS_TURN


def test_tags_half_a_turn_off_are_turned_back(noisy: Scene) -> None:
    priors = told(noisy, lens="held")
    out = solved(noisy, replace(priors, world_from_body=priors.world_from_body @ HALF_TURN))
    assert list(out.first.turned) == list(range(12))
    assert errors(noisy, out)[1] < GPS_TURN


def test_headings_that_are_known_well_are_believed() -> None:
    """Headings known to 2 mrad, as by two antennas, are kept: GPS of 1.5 m determines them to some degrees only."""
    s = scene(strips=2, photos=4, noise=0.3)
    priors = replace(told(s, sigma=1.5), sigma_rotation=np.full((8, 3), 2e-3))
    assert errors(s, solved(s, priors))[1] < np.radians(0.4)


@pytest.mark.parametrize("degrees", first(1, [20.0, -50.0]))
def test_headings_that_are_all_off_alike_lose_against_gps(degrees: float) -> None:
    """With a compass that is off and GPS of 1.5 m, the map is neither turned nor shrunk, and a warning is given."""
    s = scene(strips=3, photos=8, noise=0.3)
    priors = told(s, sigma=1.5)
    off = so3_exp(np.array([0.0, 0.0, np.radians(degrees)]))
    out = solved(s, replace(priors, world_from_body=off @ priors.world_from_body))
    true = solved(s, priors)
    a, b = (x.state.centres[:, :2] - x.state.centres[:, :2].mean(axis=0) for x in (out, true))
    turn = np.degrees(np.angle(np.sum((a[:, 0] + 1j * a[:, 1]) * (b[:, 0] - 1j * b[:, 1]))))
    assert abs(turn) < 1.5
    assert abs(np.linalg.norm(a) / np.linalg.norm(b) - 1) < 0.01
    assert len(out.first.contradicted) == 0
    (warning,) = out.first.warnings
    found = re.search(r"([+-]\d+) degrees", warning)
    assert found is not None
    assert abs(int(found[1]) + degrees) <= 2
    assert not true.first.warnings


def test_one_nonsense_tag_is_ignored(noisy: Scene) -> None:
    priors = told(noisy, lens="held")
    attitude = priors.world_from_body.copy()
    attitude[4] = enu_from_flu(0.3, 0.2, 1.0)
    out = solved(noisy, replace(priors, world_from_body=attitude))
    assert list(out.first.contradicted) == [4]
    assert errors(noisy, out)[1] < GPS_TURN


@pytest.mark.parametrize("kind", ["zero", "ahead", "random"])
def test_tags_that_are_wrong_throughout_count_in_no_photo(noisy: Scene, kind: str) -> None:
    """They decide nothing: the cameras look down, as the pictures and GPS show."""
    priors, rng = told(noisy, lens="held"), np.random.default_rng(5)
    true = priors.world_from_body
    tags = {
        "zero": np.tile(np.eye(3), (12, 1, 1)),
        "ahead": true @ enu_from_flu(0.0, np.pi / 2, 0.0),
        "random": np.array([enu_from_flu(*rng.uniform(-1.0, 1.0, 3)) for _ in range(12)]),
    }[kind]
    found = first_poses(noisy.pairs, replace(priors, world_from_body=tags))
    assert found is not None
    assert list(found.contradicted) == list(range(12))
    np.testing.assert_allclose(found.rotations, np.array(noisy.body) @ LOOKS_FORWARD, atol=0.1)


def test_without_attitude_the_pictures_and_gps_suffice(noisy: Scene) -> None:
    priors = told(noisy, lens="held")
    out = solved(noisy, replace(priors, world_from_body=np.full_like(priors.world_from_body, np.nan)))
    assert errors(noisy, out)[1] < GPS_TURN


def test_oblique_photos_without_attitude_fit_gps_as_a_whole() -> None:
    s = scene(strips=4, noise=0.4, pitch=-np.radians(55))
    told_without = replace(told(s, sigma=1.0), world_from_body=np.full_like(s.body, np.nan))
    out = solved(s, told_without)
    found, gps = (c - c.mean(axis=0) for c in (out.state.centres, told_without.centres))
    # the best scale and rotation of the whole survey towards GPS are none
    turn, _ = Rotation.align_vectors(gps, found)
    assert turn.magnitude() < np.radians(0.1)
    assert (found * gps).sum() / (found**2).sum() == pytest.approx(1.0, abs=1e-3)


def test_a_photo_without_gps_and_one_with_a_jump(noisy: Scene) -> None:
    priors = told(noisy, lens="held")
    centres = priors.centres.copy()
    centres[3], centres[8] = np.nan, centres[8] + [25.0, -10.0, 4.0]
    out = solved(noisy, replace(priors, centres=centres))
    assert list(out.registered) == list(range(12))
    assert list(out.first.jumped) == [8]
    assert errors(noisy, out)[0] < 0.05


def test_consumer_gps_converges_within_its_sigma(noisy: Scene) -> None:
    out = solved(noisy, told(noisy, sigma=3.0, lens="held"))
    assert errors(noisy, out)[0] < 3.0
    assert np.abs(residuals(out.state, out.observations, told(noisy, lens="held"))).mean() < 0.5


def test_altitude_tags_that_climb_lose_against_the_pictures() -> None:
    """Three strips are flown at one height, without attitude; the pictures win against tags that climb by 60 m."""
    s = scene(strips=3, photos=5, noise=0.4)
    n = len(s.centres)
    priors = told(s, sigma=1.0)
    free = replace(priors, world_from_body=np.full_like(priors.world_from_body, np.nan))
    assert not solved(s, free).first.climbs
    centres = free.centres + np.column_stack([np.zeros((n, 2)), np.linspace(-30.0, 30.0, n)])
    out = solved(s, replace(free, centres=centres))
    assert out.first.climbs
    assert len(out.registered) == n
    off = out.state.centres[:, 2] - s.centres[:, 2]
    assert np.ptp(off) < 3.0  # the tags: 60 m
    common = float(np.std(np.linspace(-30.0, 30.0, n)))
    up = out.joint[2 : 6 * n : 6, 2 : 6 * n : 6]
    assert np.sqrt(up[0, 0]) == pytest.approx(common, rel=0.1)  # claimed for the height in the world
    assert np.sqrt(up[0, 0] + up[1, 1] - 2 * up[0, 1]) < 2.0  # and for one photo relative to another
    assert np.sqrt(out.joint[0, 0]) < 2.0


def test_a_straight_strip_is_held_by_the_gimbal() -> None:
    """Positions on a line leave the roll about it free: the attitude fixes it, and the covariance is larger there."""
    s = scene(strips=1, photos=7, noise=0.4)
    out = solved(s, told(s, lens="held"))
    sigma = np.sqrt(np.mean([np.diag(out.covariance[i])[3:] for i in out.registered], axis=0))
    assert errors(s, out)[1] < 0.03
    assert sigma[0] > 5 * sigma[2]  # about the line (east), against heading


def test_a_wrong_lens_is_found_by_many_photos() -> None:
    """With twelve photos or more, principal point and decentring are estimated well, and with them the poses."""
    s = scene(strips=2, photos=7, noise=0.3)
    maker = replace(CAMERA, cu=CAMERA.cu + 5.0, cv=CAMERA.cv - 4.0, distortion=(-0.31, 0.13, 0.0, 0.0))
    out = solved(s, told(s, camera=maker))
    assert errors(s, out)[0] < 0.05
    assert np.abs(out.state.lens[2:4] - [-5.0, 4.0]).max() < 1.5


def test_few_photos_hold_the_radial_distortion() -> None:
    s = scene(strips=1, photos=4)
    out = solved(s, told(s))
    assert list(out.free[4:6]) == [False, False]
    assert out.free[2:4].all()


def test_jacobians_agree_with_differences(exact: Scene) -> None:
    """The gradient of the linearised system is that of the cost, for every kind of unknown."""
    priors = told(exact, mounting=np.array([0.01, -0.02, 0.01]))
    rng = np.random.default_rng(2)
    priors = rolling_priors(priors, exact.centres, BETWEEN * np.arange(len(exact.centres)))
    priors = replace(priors, sigma_turn=0.01)
    obs = select(exact.observations, 30)
    true = BundleState(
        exact.centres,
        exact.body @ LOOKS_FORWARD,
        np.empty((0, 3)),
        np.zeros(9),
        np.zeros(3),
        np.zeros((len(exact.centres), 2, 3)),
    )
    start = triangulate_bundle(true, obs, priors)
    state = BundleState(
        exact.centres + rng.normal(0, 0.05, exact.centres.shape),
        np.array([so3_exp(rng.normal(0, 2e-3, 3)) @ B @ LOOKS_FORWARD for B in exact.body]),
        start,
        np.array([0, 0, 1.0, -1.0, 0.003, 0.002, 1e-4, -1e-4, 0.03]),
        np.array([0.003, 0.001, -0.002]),
        rng.normal(0, 0.005, (len(exact.centres), 2, 3)),
    )
    system = Adjustment(obs, priors, np.ones(len(obs.photo)), 3.0)
    equations = system.linearise(state)
    n = len(exact.centres)

    def cost(**moved: F64) -> float:
        return Adjustment(obs, priors, np.ones(len(obs.photo)), 3.0).cost(replace(state, **moved))

    def slope(field: str, at: tuple[int, ...], step: float) -> float:
        out = []
        for sign in (1, -1):
            value = getattr(state, field).copy()
            value[at] += sign * step
            out.append(cost(**{field: value}))
        return (out[0] - out[1]) / (2 * step)

    def turned(sign: float, axis: int) -> F64:
        rotations = state.rotations.copy()
        rotations[5] = so3_exp(sign * 1e-6 * np.eye(3)[axis]) @ rotations[5]
        return rotations

    for axis in range(3):
        assert slope("centres", (5, axis), 1e-5) == pytest.approx(-2 * equations.b[60 + axis], rel=1e-3, abs=0.5)
        rotation = (cost(rotations=turned(1, axis)) - cost(rotations=turned(-1, axis))) / 2e-6
        assert rotation == pytest.approx(-2 * equations.b[63 + axis], rel=1e-2, abs=5.0)
        for k in range(2):
            assert slope("turns", (5, k, axis), 1e-6) == pytest.approx(
                -2 * equations.b[66 + 3 * k + axis], rel=1e-2, abs=1.0
            )
        assert slope("points", (7, axis), 1e-5) == pytest.approx(-2 * equations.gradient[7, axis], rel=1e-3, abs=0.5)
        mounting = slope("mounting", (axis,), 1e-6)
        assert mounting == pytest.approx(-2 * equations.b[len(equations.b) - 3 + axis], rel=2e-2, abs=5.0)
    for k, number in enumerate(system.free):
        assert slope("lens", (int(number),), 1e-6) == pytest.approx(-2 * equations.b[12 * n + k], rel=1e-2, abs=1.0)


def test_many_photos_are_solved_as_a_sparse_matrix_with_the_same_steps() -> None:
    """A strip of 210 photos, each coupled with its neighbours, and lens numbers coupled with all photos."""
    rng = np.random.default_rng(3)
    n, k = 6 * 210, 5
    near = np.abs(np.arange(210)[:, None] - np.arange(210)) <= 3
    A = rng.normal(size=(n, n)) * np.kron(near, np.ones((6, 6)))
    S = np.zeros((n + k, n + k))
    S[:n, :n] = A @ A.T
    S[:n, n:] = rng.normal(size=(n, k))
    S[n:, :n] = S[:n, n:].T
    S += 50 * np.eye(n + k)
    rhs = rng.normal(size=n + k)
    np.testing.assert_allclose(solved_steps(S, rhs), np.linalg.solve(S, rhs), rtol=1e-8, atol=1e-10)
    with pytest.raises(np.linalg.LinAlgError):
        solved_steps(np.zeros((1300, 1300)), np.ones(1300))


def test_tracks_that_meet_a_photo_twice_are_dropped() -> None:
    features = [a_photo(np.arange(8.0).reshape(4, 2)) for _ in range(3)]
    none = np.eye(3), np.zeros(3)
    pairs = [
        Pair(0, 1, np.array([[0, 0], [1, 1]]), *none),
        Pair(1, 2, np.array([[0, 0], [1, 1]]), *none),
        Pair(0, 2, np.array([[0, 0], [2, 1]]), *none),  # photo 0 observes the second track twice, as 1 and as 2
    ]
    out = tracks(features, pairs)
    assert out.points == 1
    assert list(out.photo) == [0, 1, 2]
    assert np.array_equal(out.pixels, np.tile([0.0, 1.0], (3, 1)))


def test_match_is_mutual_and_clear() -> None:
    """The matches are those of the plain table of distances."""
    rng = np.random.default_rng(7)
    b = rng.normal(size=(700, 128)).astype(np.float32)
    a = np.concatenate(
        [
            b[100:400] + 0.4 * rng.normal(size=(300, 128)).astype(np.float32),
            rng.normal(size=(90, 128)).astype(np.float32),
        ]
    )
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
    distance = np.sqrt(2 - 2 * (a @ b.T).astype(np.float64))
    order = np.argsort(distance, axis=1)
    rows = np.arange(len(a))
    good = (distance[rows, order[:, 0]] < 0.8 * distance[rows, order[:, 1]]) & (
        distance.argmin(axis=0)[order[:, 0]] == rows
    )
    found = match_descriptors(a.astype(np.float32), b.astype(np.float32))
    assert good.sum() > 250
    assert np.array_equal(found, np.stack([rows[good], order[good, 0]], axis=1))


def test_neighbouring_strips_are_paired() -> None:
    centres = np.array([[2.0 * k, 15.0 * s, 40.0] for s in range(2) for k in range(12)])
    across = [(i, j) for i, j in neighbours(centres, 4) if i < 12 <= j]
    assert {i for i, _ in across} == set(range(12))
    assert len(neighbours(centres, 4)) < 24 * 23 / 2 / 2


def test_photos_without_position_are_paired_in_time() -> None:
    centres = np.array([[5.0 * k, 0.0, 40.0] for k in range(9)])
    centres[4] = np.nan
    assert {(2, 4), (3, 4), (4, 5), (4, 6)} <= set(neighbours(centres, 2))


# -- rolling shutter

READOUT = 0.08  # s
BETWEEN = 1.2  # s from photo to photo: 5 m/s, 10 px of motion during a readout


def rolled(s: Scene, way: F64, turn: F64, noise: float = 0.3) -> Scene:
    """Return the scene with cameras that move by `way` (n, 3) m and turn by `turn` (n, 2, 3) rad during the readout."""
    rng = np.random.default_rng(2)
    features = []
    for i in range(len(s.features)):
        R, points, t = s.body[i] @ LOOKS_FORWARD, s.points[s.ids[i]], np.zeros(len(s.ids[i]))
        for _ in range(8):
            turned = so3_exp(np.outer(t, turn[i, 0]) + np.outer(t**2 - 1 / 12, turn[i, 1]))
            in_camera = (points - s.centres[i] - np.outer(t, way[i])) @ R
            px = CAMERA.project(np.einsum("nji,nj->ni", turned, in_camera))
            t = (px[:, 1] + 0.5) / CAMERA.height - 0.5
        features.append(a_photo(px + rng.normal(0, noise, px.shape)))
    return replace(s, features=features, observations=tracks(features, s.pairs))


def velocity_of(s: Scene, seconds: F64) -> F64:
    return velocities(s.centres, seconds, np.zeros(len(seconds), np.int64))


@pytest.fixture(scope="module")
def survey() -> Scene:
    return scene(strips=3, photos=7)


@pytest.fixture(scope="module")
def small() -> Scene:
    return scene(strips=3, photos=5)


@pytest.mark.parametrize("turning", first(1, [0.03, 0.0]))
def test_rows_that_are_exposed_one_after_the_other(survey: Scene, turning: float) -> None:
    """Readout and poses are estimated, also of a camera that turns; without a readout the attitude is far off."""
    seconds = BETWEEN * np.arange(len(survey.centres))
    turn = np.random.default_rng(3).normal(0, turning, (len(seconds), 2, 3))
    seen = rolled(survey, velocity_of(survey, seconds) * READOUT, turn)
    by_rows, at_once = (solved(seen, told(seen, sigma=0.1), s, lens="free") for s in (seconds, None))
    readout = by_rows.priors.lenses.moved(by_rows.state.lens).readouts[0]
    assert abs(readout - READOUT) < (0.2 if turning else 0.1) * READOUT
    assert (by_rows.priors.sigma_turn > 0) == (turning > 0)
    assert misfit(by_rows) < 0.45
    assert misfit(at_once) > 1.1 * misfit(by_rows)
    assert errors(seen, by_rows)[1] < 0.5 * errors(seen, at_once)[1]


@pytest.mark.parametrize("readout", first(1, [READOUT, 0.0]))
def test_a_readout_that_the_maker_tells_is_held(small: Scene, readout: float) -> None:
    seconds = BETWEEN * np.arange(len(small.centres))
    turn = np.random.default_rng(3).normal(0, 0.03, (len(seconds), 2, 3))
    seen = rolled(small, velocity_of(small, seconds) * READOUT, turn)
    out = solved(seen, told(seen, sigma=0.1, readout=readout), seconds, lens="free")
    assert out.priors.lenses.moved(out.state.lens).readouts == (readout,)
    assert (misfit(out) < 0.45) == (readout > 0)


def test_a_readout_that_the_maker_tells_counts_with_a_held_lens_too(small: Scene) -> None:
    """The calibration is held, and its readout with it: rows are exposed one after the other."""
    seconds = BETWEEN * np.arange(len(small.centres))
    seen = rolled(small, velocity_of(small, seconds) * READOUT, np.zeros((len(seconds), 2, 3)))
    out = solved(seen, told(seen, sigma=0.1, readout=READOUT, lens="held"), seconds, lens="held")
    lenses = out.priors.lenses.moved(out.state.lens)
    assert lenses.readouts == (READOUT,)
    assert lenses.cameras == (CAMERA,)
    assert misfit(out) < 0.45


def test_rows_that_are_exposed_at_once_stay_so(small: Scene) -> None:
    """A readout that fits only noise is rejected, and no turns are estimated."""
    seconds = BETWEEN * np.arange(len(small.centres))
    seen = rolled(small, np.zeros((len(seconds), 3)), np.zeros((len(seconds), 2, 3)))
    out = solved(seen, told(seen, sigma=0.1), seconds, lens="free")
    assert not any(out.priors.lenses.moved(out.state.lens).readouts)
    assert not out.state.turns.any()
    assert out.priors.sigma_turn == 0


def test_velocity_is_told_by_the_photos_of_the_same_strip() -> None:
    """At the end of a strip the faster way gives the velocity; long pauses, other cameras and hovering give none."""
    centres = np.array([[0, 0, 9], [4, 0, 9], [8, 0, 9], [8, 3, 9], [4, 3, 9], [4, 3, 9]], float)
    seconds = np.array([0.0, 2, 4, 10, 12, 14])
    one = np.zeros(6, np.int64)
    np.testing.assert_allclose(
        velocities(centres, seconds, one)[:, :2], [[2, 0], [2, 0], [2, 0], [-2, 0], [-2, 0], [0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(velocities(centres, 100 * seconds, one), 0)
    np.testing.assert_allclose(velocities(centres, seconds / 1000, one), 0)
    np.testing.assert_allclose(velocities(centres, seconds, np.arange(6)), 0)
    np.testing.assert_allclose(velocities(centres, np.full(6, np.nan), one), 0)


def test_points_of_two_photos_count_only_beside_surer_ones() -> None:
    """A hundred wrong matches of two photos, 30 m above the ground, do not count; with few sure points all count."""
    rng = np.random.default_rng(4)
    ground = np.c_[rng.uniform(0, 100, (400, 2)), rng.normal(0, 1, 400)]
    wrong = np.c_[rng.uniform(40, 44, (100, 2)), rng.normal(30, 1, 100)]
    tree = np.array([[50.0, 50.0, 7.0]])
    points, photos = np.concatenate([ground, wrong, tree]), np.r_[np.tile([2, 3], 200), np.full(101, 2)]
    kept = confirmed(points, photos, 100.0)
    assert kept[:400].all()
    assert not kept[400:500].any()
    assert kept[500]
    assert confirmed(points[200:], photos[200:] // 2 + 1, 100.0).all()


def test_variances_are_positive_where_rounding_left_no_information() -> None:
    rng = np.random.default_rng(3)
    turn, _ = np.linalg.qr(rng.normal(size=(8, 8)))
    size = 10.0 ** rng.uniform(-2, 4, 8)
    usual = (turn * 10.0 ** rng.uniform(0, 2, 8)) @ turn.T * np.outer(size, size)
    np.testing.assert_array_equal(covariance_of(usual), np.linalg.inv(usual + 1e-9 * np.eye(8)))
    least = (turn * [1, 1, 1, 1, 1, 1, -1e-9, 1e-15]) @ turn.T * np.outer(size, size)
    found = covariance_of(least)
    assert (np.diag(found) > 0).all()
    assert np.linalg.eigvalsh(found / np.sqrt(np.outer(np.diag(found), np.diag(found)))).min() > -1e-9
    assert np.diag(found) @ size**2 > 1e8  # and large


def exposed(s: Scene, factors: F64) -> list[PhotoFeatures]:
    """Return the features with colours of the ground by the exposure of each photo (n, 3); some have another colour."""
    rng = np.random.default_rng(3)
    ground = rng.uniform(60, 120, (len(s.points), 3))
    out = []
    for f, seen, factor in zip(s.features, s.ids, factors, strict=True):
        colours = ground[seen] * factor * np.exp(rng.normal(0, 0.03, (len(seen), 1)))
        other = rng.random(len(seen)) < 0.05
        colours[other] = rng.uniform(10, 240, (other.sum(), 3))
        out.append(replace(f, colours=colours.astype(np.float32)))
    return out


def test_photos_of_any_exposure_show_the_same_ground_alike() -> None:
    s = scene(3, 8)
    factors = np.exp(np.random.default_rng(4).uniform(-0.6, 0.6, (len(s.features), 3)))
    gains = exposure_gains(exposed(s, factors), s.observations)
    assert gains.shape == factors.shape
    together = np.log(gains * factors)
    assert np.abs(together - together.mean(axis=0)).max() < 0.03  # 0.6 before
    assert np.abs(np.log(gains).mean(axis=0)).max() < 0.1  # the mean exposure of all photos stays


def test_a_photo_that_shares_nothing_keeps_its_exposure() -> None:
    s = scene()
    features = exposed(s, np.full((len(s.features), 3), 0.7))
    alone = s.observations.keep(s.observations.photo != 4)[0]
    gains = exposure_gains(features, alone)
    assert np.array_equal(gains[4], np.ones(3))
    assert np.abs(gains - 1.0).max() < 0.02
    dark = [replace(f, colours=np.zeros_like(f.colours)) for f in features]
    assert np.array_equal(exposure_gains(dark, s.observations), np.ones_like(gains))
    assert np.array_equal(
        exposure_gains(s.features[:3], s.observations.keep(s.observations.photo < 0)[0]), np.ones((3, 3))
    )
