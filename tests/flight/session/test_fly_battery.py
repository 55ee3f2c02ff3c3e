"""The battery as the executive knows it: silence is no full battery."""

from __future__ import annotations

import math

import pytest

from alight.flight.session.inputs import SILENT, BatteryWatch
from alight.records import Telemetry
from alight.records.telemetry import Battery


def heard(share: float, age: float) -> Telemetry:
    return Telemetry("PX4", battery=Battery(share), ages={"SYS_STATUS": age})


def test_a_battery_that_was_never_reported_counts_as_full() -> None:
    watch = BatteryWatch()
    assert watch.share(Telemetry("PX4"), 100.0) == watch.share(heard(math.nan, 0.1), 200.0) == 1.0


def test_a_gap_keeps_the_last_report_and_a_long_one_makes_it_unknown() -> None:
    watch = BatteryWatch()
    assert watch.share(heard(0.5, 0.2), 10.0) == 0.5
    assert watch.share(heard(math.nan, 0.2), 15.0) == 0.5  # one message without a number
    assert watch.share(heard(0.5, SILENT + 0.5), 10.3 + SILENT) == pytest.approx(math.nan, nan_ok=True)
    assert watch.share(heard(0.4, 0.1), 60.0) == 0.4


@pytest.mark.parametrize(("age", "known"), [(0.3, True), (9.0, True), (11.0, False)])
def test_an_estimate_that_is_reported_no_more_is_no_position(age: float, known: bool) -> None:
    flags = Telemetry("ArduPilot", estimator_flags=16 | 32, ages={"EKF_STATUS_REPORT": age})
    assert flags.has_position is known
