"""Conversion between the autopilot's clock and ours: offset, drift, jumps; time-outs run on the autopilot's clock."""

from __future__ import annotations

import numpy as np
import pytest
from autopilot_rig import Rig

from alight.flight.autopilot.clock import TimeoutClock, VehicleClock
from alight.records import NoticeKind

SECOND = 1_000_000_000
MS = 1_000_000
OFFSET = 1_700_000_000 * SECOND


def exchange(clock: VehicleClock, theirs_s: float, there_s: float, back_s: float, drift: float = 0.0) -> None:
    """Exchange a TIMESYNC request that takes `there_s` to the autopilot, whose clock then shows `theirs_s`."""
    arrived = OFFSET + round(theirs_s / (1 + drift) * SECOND)
    asked = clock.request(arrived - round(there_s * SECOND))
    assert clock.add_answer(asked, round(theirs_s * SECOND), arrived + round(back_s * SECOND))


def error_ms(clock: VehicleClock, theirs_s: float, drift: float = 0.0) -> float:
    truth = OFFSET + round(theirs_s / (1 + drift) * SECOND)
    return (clock.ours_ns(round(theirs_s * SECOND)) - truth) / MS


@pytest.mark.parametrize("drift", [0.0, 40e-6, -40e-6])
def test_short_round_trips_decide(drift: float) -> None:
    """With unequal delays of 2 to 150 ms, the offset is known to 3 ms."""
    rng, clock = np.random.default_rng(3), VehicleClock()
    for k in range(120):
        there, back = 0.002 + rng.exponential(0.03, 2)
        exchange(clock, 5.0 + k, there, back, drift)
    assert abs(error_ms(clock, 124.0, drift)) < 3.0
    assert abs(error_ms(clock, 126.0, drift)) < 3.0
    assert clock.sigma < 0.01


def test_drift_is_followed_between_exchanges() -> None:
    clock, drift = VehicleClock(), 45e-6
    for k in range(60):
        exchange(clock, 100.0 + k, 0.001, 0.001, drift)
    assert abs(error_ms(clock, 179.0, drift)) < 0.3  # twenty seconds later; without the drift 0.9 ms


def test_an_answer_is_within_half_its_round_trip() -> None:
    clock = VehicleClock()
    exchange(clock, 10.0, 0.08, 0.0)
    assert abs(error_ms(clock, 10.0)) <= 40.0 + 1e-6
    exchange(clock, 11.0, 0.002, 0.002)
    assert abs(error_ms(clock, 11.0)) < 1.0


def test_only_our_own_questions_are_answered() -> None:
    clock = VehicleClock()
    asked = clock.request(OFFSET)
    assert not clock.add_answer(asked + 1, 5 * SECOND, OFFSET + 2 * MS)
    assert not clock.known
    clock.add_answer(asked, 5 * SECOND, OFFSET + 2 * MS)
    assert clock.known
    before = clock.ours_ns(0)
    clock.add_answer(asked, 9 * SECOND, OFFSET + 3 * MS)  # a copy of the answer, or somebody else's
    assert clock.ours_ns(0) == before


def test_a_jump_is_seen_and_the_new_offset_counts() -> None:
    clock = VehicleClock()
    for k in range(20):
        exchange(clock, 50.0 + k, 0.003, 0.004)
    for k in range(2):  # its clock was at 70 s and is at 2 s
        shifted = OFFSET + (70 + k) * SECOND
        asked = clock.request(shifted - 3 * MS)
        clock.add_answer(asked, (2 + k) * SECOND, shifted + 3 * MS)
    assert abs(clock.ours_ns(2 * SECOND) - (OFFSET + 70 * SECOND)) < MS


def test_one_late_clock_is_not_a_jump() -> None:
    """A simulated autopilot that waits for its machine is 80 ms late once, and again two answers later: no jump."""
    clock = VehicleClock()
    for k in range(20):
        arrived, late = OFFSET + (50 + k) * SECOND, 80 * MS if k in (12, 14) else 0
        clock.add_answer(clock.request(arrived - 3 * MS), (50 + k) * SECOND - late, arrived + 3 * MS)
        assert abs(error_ms(clock, 50.0 + k)) < 1.0


def test_there_and_back_is_the_same_instant() -> None:
    clock = VehicleClock()
    for k in range(30):
        exchange(clock, 50.0 + k, 0.003, 0.004, 30e-6)
    for theirs in (0, 79 * SECOND, 200 * SECOND):
        assert abs(clock.theirs_ns(clock.ours_ns(theirs)) - theirs) < 10_000


def test_an_unknown_clock_is_not_guessed() -> None:
    with pytest.raises(ValueError, match="not known"):
        VehicleClock().ours_ns(5)
    with pytest.raises(ValueError, match="not known"):
        VehicleClock().theirs_ns(5)


def test_patience_is_the_autopilots_own() -> None:
    """While the autopilot runs at a fifth of our speed, time-outs run on its clock; when it is silent, on ours."""
    pace, now = TimeoutClock(), OFFSET
    pace.tick(now)
    for k in range(100):
        now += SECOND // 10
        pace.add_stamp(5 * SECOND + k * SECOND // 50, now)
        pace.tick(now)
    assert pace.t_ns == pytest.approx(2 * SECOND, rel=0.06)
    before = pace.t_ns
    for _ in range(50):
        now += SECOND // 10
        pace.tick(now)
    assert pace.t_ns - before == pytest.approx(3.5 * SECOND, rel=0.01)  # five seconds less those it may be silent


def test_a_clock_that_goes_back_has_started_again() -> None:
    pace = TimeoutClock()
    assert not pace.add_stamp(100 * SECOND, 0)
    assert not pace.add_stamp(99_500 * MS, SECOND)  # overtaken
    assert pace.add_stamp(2 * SECOND, 2 * SECOND)
    assert not pace.add_stamp(3 * SECOND, 3 * SECOND)
    assert pace.t_ns == SECOND


@pytest.mark.parametrize("dialect", ["ardupilot", "px4"])
def test_rows_bear_the_instant_at_which_they_were_true(dialect: str) -> None:
    """Rows have the right stamps over a slow, uneven link with a drifting clock; at 5 m/s, 10 ms are 5 cm."""
    link = {"delay": 0.03, "jitter": 0.06, "loss": 0.1}
    rig = Rig(dialect, seed=2, link=link, step=0.01, drift=40e-6)

    def fly() -> None:
        rig.sim.vehicle.position = np.array([5.0 * (rig.t - start), 0.0, 30.0])
        rig.sim.vehicle.velocity = np.array([5.0, 0.0, 0.0])

    start = rig.t
    rig.each_step = fly
    rig.run(25)
    late = [s for s in rig.samples if s.position_world is not None and s.t_ns > (start + 12) * 1e9]
    assert len(late) > 80
    lag = [s.position_world[0] / 5.0 - (s.t_ns * 1e-9 - start) for s in late]
    assert np.abs(lag).max() < 0.025
    assert not rig.of(NoticeKind.REBOOT)
