"""Position fixes that fall silent, jump, drift or come back, and the odometry given out meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from motion_scenarios import Sample, led_away, without_fix
from point_flight import RIG, PointFlight, blind, run, seconds

from alight.arrays import F64
from alight.motion.ekf import filter as filter_module
from alight.motion.ekf.fixes import FixWatch
from alight.records import GpsState, Motion, NavSample, Odometry, Tracks
from alight.settings import FilterSettings

BEGIN, END = 8.0, 13.0  # s of the damage
ONE = replace(RIG, cameras=RIG.cameras[:1])


@cache
def flight(seed: int = 3, rig_size: int = 2) -> PointFlight:
    return PointFlight(seed=seed, seconds=21.0, count=60, rig=RIG if rig_size == 2 else ONE)


def fly(how: Callable[[Sample, float], Sample], rig_size: int = 2) -> list[Motion]:
    f = flight(rig_size=rig_size)
    return run([how(e, seconds(e)) for e in f.events], rig=f.rig)[1]


def silent(e: Sample, t: float) -> Sample:
    return without_fix(e) if BEGIN <= t < END else e


def led(e: Sample, t: float) -> Sample:
    """Led away at 1 m/s, and held there from END on."""
    return led_away(e, min(t, END) - BEGIN, 1.0 if t < END else 0.0) if t < END else moved(e, END - BEGIN)


def moved(e: Sample, east: float) -> Sample:
    if not isinstance(e, NavSample) or e.position_world is None:
        return e
    return replace(e, position_world=e.position_world + np.array([east, 0.0, 0.0]))


def odometry(m: Motion) -> Odometry:
    assert m.odometry is not None
    return m.odometry


def states(motions: list[Motion], start: float, end: float) -> list[GpsState]:
    """States in their order, each once."""
    found = [odometry(m).gps for m in motions if start <= seconds(m) < end]
    return [s for k, s in enumerate(found) if k == 0 or found[k - 1] is not s]


def steps(motions: list[Motion]) -> F64:
    """(N,) m by which the position departs from its own velocity between exposures."""
    p = np.array([m.world_from_body.translation for m in motions])
    v = np.array([m.velocity_world for m in motions])
    return np.asarray(np.linalg.norm(np.diff(p, axis=0) - 0.05 * (v[1:] + v[:-1]), axis=1))


def test_with_good_gps_the_watch_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    class Unwatched(FixWatch):
        def compare(self, *_: object) -> None: ...

        def admit(self, *_: object) -> bool:
            return True

        def on_exposure(self, t_ns: int) -> bool:
            return False

    watched = fly(lambda e, _: e)
    monkeypatch.setattr(filter_module, "FixWatch", Unwatched)
    for a, b in zip(watched, fly(lambda e, _: e), strict=True):
        assert odometry(a).gps is GpsState.USED
        assert a.covariance.tobytes() == b.covariance.tobytes()
        assert a.world_from_body.matrix.tobytes() == b.world_from_body.matrix.tobytes()
        assert np.array_equal(a.velocity_world, b.velocity_world)
        assert (a.state, a.tracks, a.frame_id) == (b.state, b.tracks, b.frame_id)


@pytest.mark.parametrize("cameras", [2, 1])
def test_silent_gps(cameras: int) -> None:
    """No position for 5 s: LOST after `coast`; the covariance counts from there and covers the drift. The position
    does not jump when GPS comes back, and no reset is counted."""
    motions, truth = fly(silent, cameras), flight(rig_size=cameras).truth
    assert states(motions, 1.0, BEGIN + 1.9) == [GpsState.USED]
    assert states(motions, BEGIN + 2.1, END) == [GpsState.LOST]
    assert states(motions, END + 0.3, 21.0) == [GpsState.USED]
    lost = [m for m in motions if odometry(m).gps is GpsState.LOST]
    sigma = [float(np.sqrt(np.trace(odometry(m).covariance[:3, :3]))) for m in lost]
    assert sigma[0] < 0.01 < sigma[-1] < 0.5
    off = [m.world_from_body.translation - truth(m.t_ns).translation for m in (lost[0], lost[-1])]
    assert np.linalg.norm(off[1] - off[0]) < 3.5 * sigma[-1]
    assert odometry(lost[-1]).unaided == pytest.approx(END - BEGIN, abs=0.2)
    assert steps([m for m in motions if END - 0.3 < seconds(m) < END + 1.0]).max() < 0.06
    assert len({odometry(m).resets for m in motions if seconds(m) > 1.0}) == 1


def test_gps_that_is_led_away() -> None:
    """A drift of 1 m/s is named within 2 s and its speed is given; the position does not follow. Held 5 m off, GPS is
    used again after 5 s, as after a jump; the map does not move."""
    motions, good = fly(led), fly(lambda e, _: e)
    named = next(m for m in motions if odometry(m).gps is GpsState.DRIFTS)
    assert BEGIN < seconds(named) < BEGIN + 2.0
    last = next(m for m in reversed(motions) if seconds(m) < END)
    what, speed = odometry(last).gps_why.removesuffix(" m/s").split(" at ")
    assert what == "GPS drifts against the pictures"
    assert 0.7 < float(speed) < 1.3
    assert last.why.startswith("vision only")
    assert states(motions, END + 6.5, 21.0)[-1] is GpsState.USED
    follows = [np.linalg.norm(a.world_from_body.translation - b.world_from_body.translation)
               for a, b in zip(motions, good, strict=True)]  # fmt: skip
    assert max(follows) < 0.25


def test_gps_that_is_led_away_while_the_pictures_show_nothing() -> None:
    """A drift that was found goes on while the lens is covered, for longer than a jump takes to be used again."""

    def covered(e: Sample, t: float) -> Sample:
        return blind(e) if isinstance(e, Tracks) and 11.0 <= t < 18.0 else led_away(e, t - BEGIN)

    assert set(states(fly(covered), 11.0, 21.0)) == {GpsState.DRIFTS}


def test_gps_that_jumps() -> None:
    motions = fly(lambda e, t: moved(e, 5.0) if BEGIN <= t < END - 2.0 else e)
    assert states(motions, 1.0, 21.0)[:2] == [GpsState.USED, GpsState.JUMPED]
    assert states(motions, END - 1.5, 21.0) == [GpsState.USED]
    assert steps([m for m in motions if BEGIN < seconds(m) < END]).max() < 0.05


def test_gps_whose_sigma_grows() -> None:
    def vague(e: Sample, t: float) -> Sample:
        known = isinstance(e, NavSample) and e.sigma_position is not None and t >= BEGIN
        return replace(e, sigma_position=20.0 * e.sigma_position) if known else e  # type: ignore[arg-type, union-attr]

    assert states(fly(vague), 1.0, 21.0) == [GpsState.USED, GpsState.VAGUE]


def test_height_of_the_barometer() -> None:
    """Without GPS the height follows that of the barometer, up to the slow error that positions had."""
    motions, truth = fly(lambda e, t: without_fix(e) if t >= BEGIN else e, 1), flight(rig_size=1).truth
    up = [(m.world_from_body.translation - truth(m.t_ns).translation)[2] for m in motions if seconds(m) > BEGIN]
    assert np.ptp(up) < 0.6


def watch_of(
    velocity: Callable[[float], F64],
    late: Callable[[float], float],
    led: Callable[[float], F64] = lambda t: np.zeros(3),
    sigma: float = 0.5,
) -> list[tuple[float, GpsState]]:
    """Times and states of a watch of positions 10 times a second, of a sigma in metres, that are late or led away."""
    watch, out = FixWatch(FilterSettings()), list[tuple[float, GpsState]]()
    for k in range(200):
        t = 0.1 * k
        v = velocity(t)
        watch.compare(k * 100_000_000, led(t) - late(t) * v, v, np.eye(3) * 1e-4, np.full(3, sigma))
        watch.admit(k * 100_000_000, True, False)
        out.append((t, watch.state))
    return out


def climb(t: float) -> F64:
    return np.array([0.0, 0.0, 3.0 * np.clip((t - 5.0) / 1.5, 0.0, 1.0)])


def cruise(t: float) -> F64:
    return np.array([7.0 * np.clip((t - 2.0) / 2.5, 0.0, 1.0), 0.0, 0.0])


def brake(t: float) -> F64:
    return np.array([max(8.0 - 2.5 * max(t - 5.0, 0.0), 0.0), 0.0, 0.0])


@pytest.mark.parametrize("velocity", [climb, cruise, brake])
@pytest.mark.parametrize("kind", ["late", "any age", "later and later"])
def test_late_positions_are_no_drift(velocity: Callable[[float], F64], kind: str) -> None:
    rng = np.random.default_rng(1)
    late = {"late": lambda t: 0.2, "any age": lambda t: rng.uniform(0.0, 0.2), "later and later": lambda t: 0.01 * t}
    assert {state for _, state in watch_of(velocity, late[kind])} == {GpsState.USED}


@pytest.mark.parametrize("velocity", [climb, cruise])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("latest", [0.0, 0.2])
def test_a_drift_is_found_along_and_across_the_flight(
    velocity: Callable[[float], F64], axis: int, latest: float
) -> None:
    rng = np.random.default_rng(1)
    way = np.eye(3)[axis]
    states = watch_of(velocity, lambda t: rng.uniform(0.0, latest), lambda t: way * max(t - 9.0, 0.0))
    found = next(t for t, state in states if state is GpsState.DRIFTS)
    assert 9.0 < found < 14.0


def test_a_drift_that_was_found_is_not_lost_in_turns() -> None:
    """While the velocity changes, positions of any age could look so; half of the drift that was found is left."""

    def turns(t: float) -> F64:
        return np.array([6.0 * np.sin(t - 9.0), 0.0, 0.0]) if t > 9.0 else np.zeros(3)

    states = watch_of(turns, lambda t: 0.0, lambda t: np.array([max(t - 2.0, 0.0), 0.0, 0.0]), sigma=1.5)
    found = next(t for t, state in states if state is GpsState.DRIFTS)
    assert found < 9.0
    assert {state for t, state in states if t >= found} == {GpsState.DRIFTS}
