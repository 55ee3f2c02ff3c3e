"""The motion filter and its smoother on simulated points and sensors: without images, with all truth known."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from point_flight import RIG, START, PointFlight, fed, predicted, run
from pose_window import project

from alight.geometry import Pose, enu_from_flu, so3_exp, so3_log
from alight.motion import MotionFilter
from alight.motion.dynamics import Step, propagate
from alight.motion.ekf.health import GateCounts, Health
from alight.motion.ekf.initial_attitude import attitude_from_course
from alight.motion.ekf.state import AT, FilterState
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.preintegration import Preintegral, corrected, preintegrate
from alight.motion.smoother.track_segments import jacobians
from alight.records import Event, ImuSample, Motion, MotionState, NavSample, Rig, Tracks
from alight.settings import FilterSettings

MS = 1_000_000
BIAS = np.array([0.004, -0.003, 0.002, 0.08, -0.05, 0.03])  # rad/s, m/s^2
NAV_OFF, NAV_TURNED = np.array([0.8, -0.6, 1.4]), np.array([0.006, -0.005, 0.02])


def body(t: float) -> Pose:
    """True pose of the vehicle at `t` seconds: a winding flight 30 m up."""
    yaw, pitch, roll = 1.2 + 0.5 * np.sin(0.5 * t), 0.05 * np.sin(1.1 * t), 0.06 * np.sin(0.9 * t + 0.4)
    return Pose(enu_from_flu(yaw, pitch, roll), [4.0 * t, 3.0 * np.sin(0.6 * t), 30.0 + np.sin(0.7 * t)])


def velocity(t: float) -> np.ndarray:
    return (body(t + 1e-3).translation - body(t - 1e-3).translation) / 2e-3


def imu_at(t: float, rng: np.random.Generator) -> ImuSample:
    h = 1e-3
    R = body(t).rotation
    rate = so3_log(body(t - h).rotation.T @ body(t + h).rotation) / (2 * h)
    acceleration = (velocity(t + h) - velocity(t - h)) / (2 * h)
    force = R.T @ (acceleration + np.array([0, 0, 9.80665]))
    shake = rng.normal(size=6) * np.repeat([4e-4, 2.5e-3], 3) * np.sqrt(200)
    return ImuSample(START + round(t * 1e9), rate + BIAS[:3] + shake[:3], force + BIAS[3:] + shake[3:])


def nav_at(t: float, rng: np.random.Generator) -> NavSample:
    pose = body(t)
    return NavSample(
        START + round(t * 1e9),
        pose.translation + NAV_OFF + rng.normal(size=3) * 0.03,
        so3_exp(NAV_TURNED + rng.normal(size=3) * 0.001) @ pose.rotation,
        velocity(t) + 0.02 + rng.normal(size=3) * 0.02,
        None,
        np.array([1.0, 1.0, 1.5]),
        np.array([0.0087, 0.0087, 0.026]),
        np.array([0.05, 0.05, 0.05]),
    )


@dataclass
class World:
    """Points on rolling ground, seen with noise by the rig."""

    points: np.ndarray
    rng: np.random.Generator
    noise_px: float = 0.2

    def tracks(self, t: float) -> Tracks:
        pixels = np.stack(
            [c.camera.project((body(t) @ c.body_from_cam).inverse.apply(self.points)) for c in RIG.cameras],
            axis=1,
        )
        inside = ((pixels > 5) & (pixels < [634, 474])).all(axis=(1, 2))
        ids = np.flatnonzero(inside)
        seen = pixels[ids] + self.rng.normal(0.0, self.noise_px, (len(ids), 2, 2))
        rays = np.stack([c.camera.rays(seen[:, i])[:, :2] for i, c in enumerate(RIG.cameras)], axis=1)
        return Tracks(START + round(t * 1e9), ids, seen, rays)


def world(seed: int = 3) -> World:
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-25.0, -30.0], [60.0, 30.0], (1200, 2))
    return World(np.column_stack([xy, 1.5 * np.sin(0.2 * xy[:, 0]) + 0.5 * np.cos(0.5 * xy[:, 1])]), rng)


def events(seconds: float, seed: int = 3) -> list[Event | Tracks]:
    """Events, with half a second of GPS/INS and IMU before the first exposure; instants do not coincide."""
    w = world(seed)
    out: list[Event | Tracks] = [imu_at(t, w.rng) for t in np.arange(-0.5, seconds, 0.005)]
    out += [nav_at(t, w.rng) for t in np.arange(-0.487, seconds, 0.05)]
    out += [w.tracks(t) for t in np.arange(0.0, seconds, 0.1)]
    return sorted(out, key=lambda e: (e.t_ns, isinstance(e, Tracks)))


def fly(
    stream: list[Event | Tracks], settings: FilterSettings | None = None, rig: Rig = RIG
) -> tuple[MotionFilter, list[Motion | None]]:
    f = MotionFilter(rig, settings or FilterSettings())
    return f, fed(f, stream)


def seconds(m: Event | Tracks | Motion) -> float:
    return (m.t_ns - START) * 1e-9


def drift_px(a: Motion, b: Motion) -> float:
    """RMS error in pixels of points 30 m below, transferred from one exposure to the other."""
    x, y = np.meshgrid([-18.0, -6.0, 6.0, 18.0], [-13.0, 0.0, 13.0])
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 30.0)])
    cam = RIG.cameras[0].body_from_cam
    said = (b.world_from_cams[0].inverse @ a.world_from_cams[0]).apply(points)
    true = ((body(seconds(b)) @ cam).inverse @ (body(seconds(a)) @ cam)).apply(points)
    miss = 480.0 * (said[:, :2] / said[:, 2:] - true[:, :2] / true[:, 2:])
    return float(np.sqrt((miss**2).sum(axis=1).mean()))


def tilt(motions: list[Motion]) -> np.ndarray:
    """Mean roll and pitch of the estimated world against the true one, rad."""
    return np.mean([so3_log(m.world_from_body.rotation @ body(seconds(m)).rotation.T) for m in motions], axis=0)[:2]


@pytest.fixture(scope="module")
def flown() -> tuple[MotionFilter, list[Motion]]:
    f, out = fly(events(6.0))
    return f, [m for m in out if m is not None]


def test_every_exposure_has_a_motion_and_the_filter_settles(flown: tuple[MotionFilter, list[Motion]]) -> None:
    _, motions = flown
    assert len(motions) == 60
    assert motions[0].state is MotionState.INITIALISING
    assert all(m.state is MotionState.GOOD for m in motions[6:])
    assert min(m.tracks for m in motions[6:]) > 30


def test_the_keyframe_posterior_is_consistent_with_itself(flown: tuple[MotionFilter, list[Motion]]) -> None:
    f, motions = flown
    window = f.clone_window()
    assert window is not None
    keyframes = window.posterior().motions
    assert len(keyframes) == FilterSettings().clones
    assert keyframes[-1].t_ns == motions[-1].t_ns
    assert seconds(keyframes[-1]) - seconds(keyframes[0]) > 0.6
    assert drift_px(keyframes[0], keyframes[-1]) < 0.35


def test_the_joint_covariance_of_the_keyframes_belongs_to_its_poses(flown: tuple[MotionFilter, list[Motion]]) -> None:
    """The blocks are the covariances of the poses in the map; relative to each other, poses are known far better."""
    window = flown[0].clone_window()
    assert window is not None
    found = window.posterior()
    K, P = len(found.motions), found.covariance
    assert P.shape == (6 * K, 6 * K)
    np.testing.assert_allclose(P, P.T, atol=1e-12)
    for k, m in enumerate(found.motions):
        own = P[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        np.testing.assert_allclose(own[3:, 3:], m.covariance[3:, 3:], rtol=1e-9)  # the offset moves no rotation
    last, first = P[-6:, -6:], P[:6, :6]
    between = last + first - P[-6:, :6] - P[:6, -6:]
    assert np.linalg.eigvalsh(P).min() > -1e-12
    assert between[5, 5] < 0.1 * last[5, 5]  # heading


def test_gps_errors_do_not_shake_the_poses(flown: tuple[MotionFilter, list[Motion]]) -> None:
    _, motions = flown
    steps = [drift_px(a, b) for a, b in pairwise(motions[20:])]
    assert np.median(steps) < 0.35


def test_the_prediction_is_where_the_next_exposure_finds_the_cameras(flown: tuple[MotionFilter, list[Motion]]) -> None:
    f, motions = flown
    expected = predicted(f, START + 6000 * MS)
    assert expected is not None
    poses = expected.world_from_cams
    assert len(poses) == 2
    there = replace(motions[-1], t_ns=START + 6000 * MS, world_from_cams=poses)
    assert drift_px(motions[-1], there) < 2.0  # the vehicle went 0.4 m, 6 px
    early = predicted(f, START)
    assert early is not None
    assert np.isfinite(early.world_from_cams[0].matrix).all()  # the past is not predicted: the present pose is returned


def test_the_batch_makes_one_consistent_flight(flown: tuple[MotionFilter, list[Motion]]) -> None:
    f, motions = flown
    smoothed = list(f.refined().motions)
    assert [m.t_ns for m in smoothed] == [m.t_ns for m in motions]
    assert max(drift_px(a, b) for a, b in zip(smoothed, smoothed[10:], strict=False)) < 0.15
    assert np.abs(tilt(smoothed)).max() < 2e-3
    offset = np.array([m.world_from_body.translation - body(seconds(m)).translation for m in smoothed])
    assert np.abs(offset.std(axis=0)).max() < 0.12  # yaw is known to 5 mrad only, over 24 m
    assert np.abs(offset.mean(axis=0) / [1.0, 1.0, 1.5]).max() < 2.0


def test_without_imu_the_motion_still_holds() -> None:
    f, out = fly([e for e in events(5.0) if not isinstance(e, ImuSample)])
    assert out[-1] is not None
    assert out[-1].state is MotionState.GOOD
    smoothed = list(f.refined().motions)
    assert max(drift_px(a, b) for a, b in zip(smoothed, smoothed[10:], strict=False)) < 0.25


def test_one_camera_is_enough_with_gps() -> None:
    def left_only(t: Tracks) -> Tracks:
        return replace(t, pixels=t.pixels[:, :1], normalised=t.normalised[:, :1])

    f, _ = fly([left_only(e) if isinstance(e, Tracks) else e for e in events(5.0)], rig=Rig(RIG.cameras[:1]))
    smoothed = list(f.refined().motions)
    assert max(drift_px(a, b) for a, b in zip(smoothed, smoothed[10:], strict=False)) < 0.35


def blind(t: Tracks) -> Tracks:
    return replace(t, ids=t.ids[:0], pixels=t.pixels[:0], normalised=t.normalised[:0])


Damage = Callable[[Event | Tracks], Event | Tracks | None]


def damaged(how: Damage, length: float = 4.0) -> list[Motion | None]:
    return fly([e for e in map(how, events(length)) if e is not None])[1]


def test_a_gap_in_the_imu_while_it_swings(monkeypatch: pytest.MonkeyPatch) -> None:
    """No IMU for 1.7 s in gusts: the attitude follows GPS/INS and pictures. Seen in a campaign: the covariance did not
    count the gap from its begin, so that the filter rejected GPS/INS and ran away."""
    steady = body

    def swinging(t: float) -> Pose:
        turn = so3_exp([0.25 * np.sin(4.0 * t), 0.2 * np.sin(3.3 * t + 1.0), 0.3 * np.sin(1.5 * t)])
        return Pose(steady(t).rotation @ turn, steady(t).translation)

    monkeypatch.setattr(sys.modules[__name__], "body", swinging)
    out = damaged(lambda e: None if isinstance(e, ImuSample) and 2.0 < seconds(e) < 3.7 else e, 6.0)
    motions = [m for m in out if m is not None and seconds(m) > 1.0]
    off = [np.linalg.norm(so3_log(m.world_from_body.rotation @ body(seconds(m)).rotation.T)) for m in motions]
    assert max(off) < 0.25
    after = [i for i, m in enumerate(motions) if seconds(m) > 4.2]
    assert max(off[i] for i in after) < 0.05
    assert {motions[i].state for i in after} == {MotionState.GOOD}
    assert motions[-1].frame_id == motions[0].frame_id


def test_without_gps_there_is_no_motion() -> None:
    out = damaged(lambda e: None if isinstance(e, NavSample) else e, 1.0)
    assert out == [None] * len(out)


def test_gps_without_attitude_starts_from_the_pictures() -> None:
    """A camera that looks down and GPS positions are enough: the course in the pictures gives the heading."""
    out = damaged(lambda e: replace(e, world_from_body=None) if isinstance(e, NavSample) else e, 4.0)
    assert out[0] is None
    last = out[-1]
    assert last is not None
    assert last.state is MotionState.GOOD
    assert np.linalg.norm(so3_log(last.world_from_body.rotation @ body(seconds(last)).rotation.T)) < 0.06


def test_repeated_and_backward_times_are_left_out() -> None:
    stream = events(1.0)
    last = next(e for e in reversed(stream) if isinstance(e, Tracks))
    late = [last, replace(last, t_ns=last.t_ns - 500 * MS), stream[0], nav_at(0.2, world().rng)]
    f, out = fly([*stream, *late], FilterSettings(lateness=0.0))
    assert out[-1] is None
    assert out[-2] is None
    assert len(f.refined().motions) == len(out) - 2


def judged(health: Health, counts: Sequence[GateCounts], first: int = 0) -> list[MotionState]:
    """Health states after exposures, five a second, with GPS/INS that passes its gates."""
    known, out = FilterState(0, np.eye(3), np.zeros(31), np.eye(31) * 1e-4), []
    for k, seen in enumerate(counts, first):
        health.on_gps(k * 200 * MS, True, True)
        health.on_exposure(k * 200 * MS, seen)
        out.append(health.judge(known)[0])
    return out


@pytest.mark.parametrize(
    ("counts", "state"),
    [
        (GateCounts(20, 5, 1.0), MotionState.GOOD),
        (GateCounts(5, 0, 1.0), MotionState.GOOD),
        (GateCounts(5, 1, 1.0), MotionState.GOOD),
        (GateCounts(5, 2, 1.0), MotionState.DEGRADED),
        (GateCounts(3, 0, 1.0), MotionState.DEGRADED),
        (GateCounts(8, 9, 1.0), MotionState.DEGRADED),
    ],
)
def test_few_features_that_agree_hold_the_motion_of_a_landing(counts: GateCounts, state: MotionState) -> None:
    """Three metres above the ground, at five exposures a second, few features are observed three times."""
    assert judged(Health(2.0), [GateCounts(30, 0, 1.0)] * 5 + [counts] * 15)[-1] is state


def test_few_features_end_no_start() -> None:
    assert judged(Health(2.0), [GateCounts(5, 0, 1.0)] * 9)[-1] is MotionState.INITIALISING


@pytest.mark.parametrize("passed", [0, 3, 5])
def test_a_start_in_a_hover_ends_with_gps_ins_only_and_is_good_once_features_are_learned(passed: int) -> None:
    """A vehicle that hovers before its start has no parallax, and triangulates no features meanwhile."""
    states = judged(Health(2.0), [GateCounts(passed, 0, 1.0)] * 20 + [GateCounts(30, 0, 1.0)] * 10)
    assert states[:16] == [MotionState.INITIALISING] * 16
    assert states[16:20] == [MotionState.DEGRADED] * 4
    assert states[22:] == [MotionState.GOOD] * 8


def test_a_restart_begins_a_new_start() -> None:
    health = Health(2.0)
    assert judged(health, [GateCounts()] * 20)[-1] is MotionState.DEGRADED
    health.restart(20 * 200 * MS)
    assert judged(health, [GateCounts()], 20) == [MotionState.INITIALISING]


def test_scrambled_matches_are_gated_out() -> None:
    rng = np.random.default_rng(8)

    def scramble(e: Event | Tracks) -> Event | Tracks:
        if not isinstance(e, Tracks) or not 1.5 < (e.t_ns - START) * 1e-9 < 2.6:
            return e
        return replace(e, normalised=rng.permutation(e.normalised))

    out = damaged(scramble)
    assert any(m is not None and m.state is MotionState.DEGRADED for m in out[21:26])
    last = out[-1]
    assert last is not None
    assert last.state is MotionState.GOOD
    assert np.linalg.norm(tilt([last])) < 0.02


# -- parts ---------------------------------------------------------------------------------------------------------


def numeric(f: Callable[[np.ndarray], np.ndarray], n: int, h: float = 1e-6) -> np.ndarray:
    return np.stack([(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(n)], axis=-1)


def test_camera_jacobians_agree_with_differences() -> None:
    rng = np.random.default_rng(0)
    R, p, x = so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3)
    cam = Pose(so3_exp(rng.normal(size=3) * 0.1), [0.1, -0.2, 0.3])
    x = p + R @ (cam.rotation @ np.array([2.0, -3.0, 20.0]) + cam.translation)
    (by_pose,), (by_point,) = jacobians(R[None], p[None], cam, x[None])
    np.testing.assert_allclose(by_pose, numeric(lambda d: project(so3_exp(d[:3]) @ R, p + d[3:], cam, x), 6), atol=1e-8)
    np.testing.assert_allclose(by_point, numeric(lambda d: project(R, p, cam, x + d), 3), atol=1e-8)


def _summed(bias: np.ndarray) -> Preintegral:
    rng = np.random.default_rng(1)
    samples = ImuBuffer(imu_at(t, rng) for t in np.arange(0.0, 0.31, 0.005))
    return preintegrate(samples, START + 3 * MS, START + 292 * MS, bias, FilterSettings())


def test_preintegration_is_the_motion() -> None:
    m = _summed(BIAS)
    assert m.dt == pytest.approx(0.289)
    here = Step(body(0.003).rotation.copy(), body(0.003).translation, velocity(0.003))
    after, _, _ = propagate(here, np.zeros(3), m, m.dt, FilterSettings())
    assert np.linalg.norm(so3_log(after.R @ body(0.292).rotation.T)) < 5 * 4e-4 * np.sqrt(0.3)
    assert np.linalg.norm(after.position - body(0.292).translation) < 5 * 2.5e-3 * 0.3**1.5
    assert np.linalg.norm(after.velocity - velocity(0.292)) < 5 * 2.5e-3 * np.sqrt(0.3)


def test_preintegration_corrects_for_biases_to_first_order() -> None:
    d = np.array([1e-3, -2e-3, 1e-3, 0.02, 0.01, -0.03])
    there, found = _summed(d), corrected(_summed(np.zeros(6)), d)
    assert np.linalg.norm(so3_log(found.rotation.T @ there.rotation)) < 1e-6
    np.testing.assert_allclose(found.velocity, there.velocity, atol=1e-4)
    np.testing.assert_allclose(found.position, there.position, atol=1e-4)


def _difference(a: Step, b: Step) -> np.ndarray:
    return np.concatenate([so3_log(a.R @ b.R.T), a.position - b.position, a.velocity - b.velocity])


def test_transitions_agree_with_differences() -> None:
    x, v, zero = body(0.003), velocity(0.003), np.zeros(15)

    def there(d: np.ndarray) -> Step:
        return Step(so3_exp(d[0:3]) @ x.rotation, x.translation + d[3:6], v + d[6:9])

    def inertial(d: np.ndarray) -> tuple[Step, np.ndarray, np.ndarray]:
        m = _summed(BIAS + d[9:])
        return propagate(there(d), np.zeros(3), m, m.dt, FilterSettings())

    def constant(d: np.ndarray) -> tuple[Step, np.ndarray, np.ndarray]:
        return propagate(there(d), np.array([0.1, -0.2, 0.3]) + d[9:12], None, 0.1, FilterSettings())

    after, F, Q = inertial(zero)
    np.testing.assert_allclose(F[:9], numeric(lambda d: _difference(inertial(d)[0], after), 15, 1e-5), atol=2e-4)
    assert np.linalg.eigvalsh(Q[:9, :9]).min() > 0
    after, F, _ = constant(zero)
    np.testing.assert_allclose(F[:9], numeric(lambda d: _difference(constant(d)[0], after), 15, 1e-5), atol=1e-5)
    assert F[AT.gyro, AT.gyro].tolist() == np.eye(3).tolist()


@pytest.mark.parametrize("turn", [0.0, 1.2, np.pi])
def test_the_course_in_two_pictures_gives_the_attitude(turn: float) -> None:
    """A camera that looks down turns by any angle between two pictures; two in five matches are wrong (M26)."""
    rng, yaw = np.random.default_rng(9), 0.7
    first, second = (Pose(enu_from_flu(a, 0.0, 0.0), p) for a, p in ((yaw, [0, 0, 30]), (yaw + turn, [4.0, 9.0, 30.0])))
    cam = RIG.cameras[0].body_from_cam
    points = np.column_stack([rng.uniform(-8, 12, (90, 2)), rng.normal(size=90) * 0.1])
    seen = []
    for pose in (first, second):
        q = (pose @ cam).inverse.apply(points)
        z = (q[:, :2] / q[:, 2:])[:, None]
        seen.append(Tracks(0, np.arange(90), z, z))
    wrong = seen[1].normalised.copy()
    wrong[:36] = rng.uniform(-0.6, 0.6, (36, 1, 2))
    found = attitude_from_course(
        seen[0], replace(seen[1], normalised=wrong), (second.translation - first.translation)[:2], 0.0, cam
    )
    assert found is not None
    assert np.linalg.norm(so3_log(found.R @ second.rotation.T)) < 0.05


def test_the_posterior_follows_from_the_window_alone() -> None:
    """The posterior has the same bits if computed at once, after the filter has gone on, or on a pickled copy."""
    events = PointFlight(seed=4, seconds=2.0, count=40).events
    half = len(events) // 2
    estimator, _ = run(events[:half])
    at_once, later = estimator.clone_window(), estimator.clone_window()
    assert at_once is not None
    assert later is not None
    elsewhere = pickle.loads(pickle.dumps(later))
    wanted = at_once.posterior()
    fed(estimator, events[half:])
    for window in (later, elsewhere):
        found = window.posterior()
        np.testing.assert_array_equal(found.covariance, wanted.covariance)
        for a, b in zip(found.motions, wanted.motions, strict=True):
            np.testing.assert_array_equal(a.world_from_cams[0].matrix, b.world_from_cams[0].matrix)
            np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_measurement_that_makes_a_matrix_singular_is_left_out_and_counted() -> None:
    state = FilterState(0, np.eye(3), np.zeros(31), np.eye(31))
    before = state.P.copy()
    for residual, H in ((np.ones(1), np.full((1, 1), np.nan)), (np.full(1, np.nan), np.ones((1, 1)))):
        state.correct(residual, H, slice(0, 1))
    state.correct_by(np.ones(1), np.ones((1, 31)), np.full((1, 1), -5.0))
    assert state.refused == 3
    np.testing.assert_allclose(state.P, before)
