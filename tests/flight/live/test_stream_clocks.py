"""Stamps of sensors: jumps of a clock are corrected, and events that are late are not taken for one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from stereo_flight import flight

from alight.flight.live.stream_clocks import StreamClock, StreamClocks
from alight.records import Event, NavSample


def feed(clock: StreamClock, stamps: np.ndarray, arrivals: np.ndarray) -> list[int | None]:
    return [clock.stamp(round(s * 1e9), float(a)) for s, a in zip(stamps, arrivals, strict=True)]


def test_a_clock_that_jumps_ahead_is_put_back() -> None:
    said, t = list[str](), np.arange(0.0, 10.0, 0.1)
    stamps = t + 100.0
    stamps[50:] += 3600.0
    found = feed(StreamClock("frames", said.append), stamps, t + 0.02)
    assert None not in found
    np.testing.assert_allclose(np.array(found) * 1e-9, t + 100.0, atol=1e-6)
    assert said == ["frames: their clock jumped by +3600.0 s; it is put back, to about 20 ms"]


def test_a_clock_that_jumps_back_is_put_back_once_that_is_sure() -> None:
    """For two seconds the stamps could be those of late exposures, and these are left out."""
    said, t = list[str](), np.arange(0.0, 10.0, 0.1)
    stamps = t + 100.0
    stamps[50:] -= 7.0
    clock = StreamClock("frames", said.append)
    found = feed(clock, stamps, t + 0.02)
    assert [k for k, s in enumerate(found) if s is None] == list(range(50, 70))
    later = [k for k, s in enumerate(found) if s is not None]
    np.testing.assert_allclose([found[k] * 1e-9 for k in later], t[later] + 100.0, atol=1e-6)  # type: ignore[operator]
    assert clock.late == 20
    assert len(said) == 1


def test_a_burst_of_late_exposures_is_left_out_and_no_jump() -> None:
    """A link stalls for 5 s and then gives everything at once: exposures older than a second are late."""
    t = np.arange(0.0, 20.0, 0.1)
    arrivals = np.where((t > 5) & (t < 10), 10.0 + 0.001 * (t - 5), t) + 0.02
    said = list[str]()
    clock = StreamClock("frames", said.append)
    found = feed(clock, t, arrivals)
    assert said == []
    assert clock.late == sum((t > 5) & (arrivals - t > 1.02))
    assert all(s is None or abs(s * 1e-9 - x) < 1e-6 for s, x in zip(found, t, strict=True))


def backlog(t: np.ndarray, pace: float) -> np.ndarray:
    """Delays of exposures, of which after 5 s without any one comes each `pace` seconds."""
    return np.maximum(0.0, np.where(t > 5.0, 10.0 + pace * (t - 5.0) / 0.2 - t, 0.0))


@pytest.mark.parametrize(
    "delays",
    [
        lambda t: backlog(t, 0.1),  # the clock was shifted by 3 s for ever
        lambda t: backlog(t, 0.19),
        lambda t: 1.5 * np.clip(t / 10.0, 0.0, 1.0) + (t > 8.0) * (np.arange(len(t)) % 7 == 0),  # a slow camera
    ],
)
def test_exposures_that_are_late_shift_no_clock(delays: Callable[[np.ndarray], np.ndarray]) -> None:
    t = np.arange(0.0, 200.0, 0.2)
    late = delays(t) + 0.02
    found = feed(StreamClock("frames", pytest.fail), t, np.maximum.accumulate(t + late))
    kept = np.array([k for k, s in enumerate(found) if s is not None])
    assert len(kept) > 40
    np.testing.assert_allclose(np.array([found[k] for k in kept]) * 1e-9, t[kept], atol=1e-6)


def test_delays_of_300_ms_are_none_of_its_business() -> None:
    rng, t = np.random.default_rng(5), np.arange(0.0, 10.0, 0.1)
    found = feed(StreamClock("frames", pytest.fail), t, t + rng.uniform(0.0, 0.3, len(t)))
    np.testing.assert_array_equal(found, np.round(t * 1e9).astype(np.int64))


def test_each_stream_has_a_clock_of_its_own() -> None:
    """The telemetry's clock jumps by an hour, and the camera's does not."""
    said = list[str]()
    clocks = StreamClocks(said.append)
    out = list[Event | None]()
    for e in flight()[1]:
        jump = 3_600_000_000_000 if isinstance(e, NavSample) and e.t_ns > flight()[0].frame_times[10] else 0
        moved = NavSample(e.t_ns + jump, None, None) if isinstance(e, NavSample) else e
        out.append(clocks.stamped(moved, e.t_ns * 1e-9 + 0.01))
    assert [e.t_ns for e in out if e is not None] == [e.t_ns for e in flight()[1]]
    assert len(said) == 1
    assert said[0].startswith("GPS/INS rows: their clock jumped by +3600.0 s")
