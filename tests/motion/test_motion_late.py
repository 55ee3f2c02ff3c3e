"""Events that arrive out of sequence, and stamps with a constant offset."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from length import first_rows
from point_flight import CAMERA, DOWN, NOISE, RIG, PointFlight, best, error, fed, nees, predicted, run, seconds
from pose_window import clone_slice

from alight.geometry import Pose, so3_exp, so3_log
from alight.motion import MotionFilter
from alight.motion.ekf.state import AT, CORE, FilterState
from alight.records import Event, Motion, MotionState, NavSample, Rig, RigCamera, Tracks
from alight.settings import FilterSettings

SMALL = NOISE.model_copy(update={"points": 16})


def flown(events: list[Event | Tracks], settings: FilterSettings = SMALL) -> tuple[MotionFilter, list[Motion]]:
    """Run the filter for events out of sequence; return it and its motions."""
    f = MotionFilter(RIG, settings)

    def expected() -> Iterator[Event | Tracks]:
        for e in events:
            assert not isinstance(e, Tracks) or predicted(f, e.t_ns) is not None
            yield e

    return f, [m for m in fed(f, expected()) if m is not None]


def delayed(events: list[Event | Tracks], kind: type, by: float, share: float) -> list[Event | Tracks]:
    """Delay the arrival of some events of a kind."""
    rng = np.random.default_rng(5)

    def arrival(e: Event | Tracks) -> float:
        return seconds(e) + (by if isinstance(e, kind) and rng.random() < share and seconds(e) > 0.5 else 0.0)

    return sorted(events, key=arrival)


@cache
def in_order() -> tuple[PointFlight, list[Motion]]:
    """A flight, and its motions where nothing comes late."""
    f = PointFlight(seed=1, seconds=4.0, count=60)
    return f, flown(f.events)[1]


@pytest.mark.parametrize(("kind", "by"), [(Tracks, 0.25), (NavSample, 0.15), (Tracks, 0.72)])
def test_what_comes_late_is_used_in_its_place(kind: type, by: float) -> None:
    """A third of the exposures, or of the GPS/INS rows, comes up to 0.7 s late: none is lost, and at the end the filter
    has the state of events in order."""
    f, whole = in_order()
    late, motions = flown(delayed(f.events, kind, by, 0.3))
    assert late.too_late == 0
    assert {m.t_ns for m in motions} == {m.t_ns for m in whole}
    a, b = max(whole, key=lambda m: m.t_ns), max(motions, key=lambda m: m.t_ns)
    assert np.linalg.norm(best(a)[0] - best(b)[0]) < 0.03  # the IMU between two events is used a little better
    np.testing.assert_allclose(np.diag(a.covariance), np.diag(b.covariance), rtol=0.1)
    assert nees(b, f.truth(b.t_ns)) < 25.0


def test_in_order_the_lateness_changes_nothing() -> None:
    f, strict = PointFlight(seed=2, seconds=2.0, count=60), SMALL.model_copy(update={"lateness": 0.0})
    for a, b in zip(flown(f.events)[1], run(f.events, strict)[1], strict=True):
        assert a.world_from_body.matrix.tobytes() == b.world_from_body.matrix.tobytes()


def test_what_comes_too_late_is_counted_and_does_no_harm() -> None:
    f = PointFlight(seed=3, seconds=4.0, count=60)
    late, motions = flown(delayed(f.events, Tracks, 1.6, 0.2))
    assert late.too_late > 3
    assert len(motions) + late.too_late == 40
    assert max(nees(m, f.truth(m.t_ns)) for m in motions[-5:]) < 25.0


def test_the_batch_has_late_exposures_in_their_place() -> None:
    f = PointFlight(seed=4, seconds=2.0, count=60)
    settings = SMALL.model_copy(update={"smooth": True})
    late, _ = flown(delayed(f.events, Tracks, 0.25, 0.3), settings)
    whole, _ = flown(f.events, settings)
    a, b = late.refined().motions, whole.refined().motions
    assert [m.t_ns for m in a] == [m.t_ns for m in b]
    assert (
        max(
            np.linalg.norm(x.world_from_body.translation - y.world_from_body.translation)
            for x, y in zip(a, b, strict=True)
        )
        < 5e-3
    )


@pytest.mark.parametrize(("offset", "imu"), first_rows(2, [(0.04, True), (-0.03, False), (-0.03, True), (0.04, False)]))
def test_the_time_offset_is_found(offset: float, imu: bool) -> None:
    """The cameras' stamps are 40 ms ahead, or 30 ms behind: as a state the offset is estimated within its sigma, and
    the poses are those of the exposures, within their sigma."""
    f = PointFlight(seed=5, seconds=8.0, count=60, imu=imu, time_offset=offset)
    free = SMALL.model_copy(update={"time_offset_sigma": 0.05})
    found, motions = flown(f.events, free)
    state = found.state
    assert state is not None
    sigma = float(np.sqrt(state.P[AT.time, AT.time][0, 0]))
    off = float(state.core[AT.time][0]) - offset
    assert sigma < (0.004 if imu else 0.008)
    assert abs(off) < 4.0 * sigma
    assert motions[-1].state is MotionState.GOOD
    normalised = [np.abs(e / np.sqrt(np.diag(c))).max() for e, c in (error(m, f.truth(m.t_ns)) for m in motions[-20:])]
    assert max(normalised) < 4.0


def test_noise_of_the_gyro_does_not_count_as_time_offset() -> None:
    """A flight that hardly turns: the rate's own error at each exposure is allowed for in the sigma."""
    f = PointFlight(seed=2, seconds=6.0, count=40, time_offset=0.02)
    found = MotionFilter(RIG, NOISE.model_copy(update={"time_offset_sigma": 0.03}))
    fed(found, f.events)
    state = found.state
    assert state is not None
    sigma = float(np.sqrt(state.P[AT.time, AT.time][0, 0]))
    assert sigma < 0.008
    assert abs(float(state.core[AT.time][0]) - 0.02) < 2.0 * sigma


def test_a_pose_at_another_time_agrees_with_differences() -> None:
    """The derivative of a clone by the time offset is the negative derivative of the pose by time."""
    rng = np.random.default_rng(0)
    state = FilterState(0, so3_exp(rng.normal(size=3)), np.zeros(CORE), np.eye(CORE) * 1e-6, rate=rng.normal(size=3))
    state.core[AT.vel] = rng.normal(size=3) * 4
    state.P[AT.time, AT.time] = 1e-10
    state.add_clone(0)
    by_time = state.P[clone_slice(0), AT.time][:, 0] / 1e-10
    h = 1e-5
    turned = so3_log(state.R @ so3_exp(-h * state.rate) @ state.R.T) / h
    np.testing.assert_allclose(by_time, np.concatenate([turned, -state.core[AT.vel]]), rtol=1e-6)


def test_three_cameras_are_held_together() -> None:
    """A rig of three cameras is GOOD, and its poses fit their covariance."""
    middle = RigCamera("middle", CAMERA, Pose(DOWN @ so3_exp([0.0, 0.05, 0.0]), [0.3, 0.0, 0.1]))
    rig = Rig((*RIG.cameras, middle))
    f = PointFlight(seed=7, seconds=3.0, count=60, rig=rig)
    motions = run(f.events, SMALL, rig)[1]
    assert motions[-1].state is MotionState.GOOD
    assert len(motions[-1].world_from_cams) == 3
    assert np.mean([nees(m, f.truth(m.t_ns)) for m in motions[-10:]]) < 15.0


def test_a_time_offset_that_is_known_needs_no_state() -> None:
    f = PointFlight(seed=5, seconds=6.0, count=60, time_offset=0.04)
    known = flown(f.events, SMALL.model_copy(update={"time_offset": 0.04}))[1]
    ignored = flown(f.events)[1]

    def off(motions: list[Motion]) -> float:
        return float(np.mean([nees(m, f.truth(m.t_ns)) for m in motions[-20:]]))

    assert off(known) < 12.0
    assert off(ignored) > 1.5 * off(known)
