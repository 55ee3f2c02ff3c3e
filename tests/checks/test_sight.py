"""The check of flight by sight: the way without GPS against GPS."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

from stereo_flight import SMALL, flight

from alight.checks.result import CheckResult, Judged
from alight.checks.sight import SightCheck
from alight.records import Event, NavSample
from alight.settings import load_settings


def checked(how: Callable[[Event], Event] = lambda e: e) -> CheckResult:
    f, events = flight()
    check = SightCheck(f.rig, load_settings("", [*SMALL]).stages(f.imu_noise), seconds=3.0)
    assert len(list(check.watch(how(e) for e in events))) == len(events)
    return check.result


def test_the_drift_is_a_small_share_of_the_way() -> None:
    result = checked()
    assert result.verdict is Judged.GOOD
    share = re.search(r"([\d.]+) % of the way", result.evidence)
    assert share
    assert float(share[1]) < 8.0  # GPS drifts by some of it


def test_gps_that_goes_another_way_is_named() -> None:
    def twice(e: Event) -> Event:
        known = isinstance(e, NavSample) and e.position_world is not None
        return replace(e, position_world=2.0 * e.position_world) if known else e  # type: ignore[arg-type, operator, union-attr]

    assert checked(twice).verdict is Judged.WARNING


def test_without_positions_it_cannot_tell() -> None:
    def nowhere(e: Event) -> Event:
        return replace(e, position_world=None) if isinstance(e, NavSample) else e

    assert checked(nowhere).verdict is Judged.UNKNOWN
